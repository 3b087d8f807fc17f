"""The files of a study's results, and control scans of factors without detectable effect."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet

from scancell.errors import OutputError
from scancell.files import atomic_write, read_json
from scancell.output.run_folder import versions
from scancell.progress import NullProgress
from scancell.studies.analysis import analyse
from scancell.studies.engine import ExecutionTarget, Task, run_tasks
from scancell.studies.study import ROWS, Collected, Study, collect
from scancell.values import Result

KEYS = ("trial", "seed", "engine", "status", "message")
INDEX_KEYS = (
    *("scan", "part", "variant", "mesh", "mesh_sha256"),
    *("seed", "engine", "status", "message", "as_built", "scancell"),
)

# More control scans than one per this many trials are not worth their time.
_TRIALS_PER_CONTROL = 10
_EQUAL = {"rel_tol": 1e-9, "abs_tol": 1e-6}  # last digits differ between kinds of processors

_MOST_CONTRIBUTORS = 3


def results_table(rows: Sequence[dict[str, Any]], labels: Sequence[str]) -> pa.Table:
    """All rows by trial number: number, seed, engine, status, message, drawn values by factor, figures by name."""
    ordered = sorted(rows, key=lambda row: int(row["number"]))
    return _table(_columns(ordered, KEYS, labels))


def index_table(rows: Sequence[dict[str, Any]], labels: Sequence[str], folder: str) -> pa.Table:
    """All scans of a batch: their rows, and under ``file.NAME`` each file's path, which begins with `folder`."""
    columns = _columns(rows, INDEX_KEYS, labels)
    for name in sorted({file for row in rows for file in row["files"]}):
        columns[f"file.{name}"] = [f"{folder}/{row['scan']}/{name}" if name in row["files"] else None for row in rows]
    table = _table(columns)
    as_built = pa.array(columns["as_built"], pa.list_(pa.string()))  # lists that are all empty have no type
    return table.set_column(table.column_names.index("as_built"), "as_built", as_built)


def _columns(rows: Sequence[dict[str, Any]], keys: Sequence[str], labels: Sequence[str]) -> dict[str, list[Any]]:
    """The keys of the rows, drawn values by factor, figures by name; ``trial`` and ``variant`` are the row's number."""
    named = {"trial": "number", "variant": "number"}
    columns: dict[str, list[Any]] = {key: [row[named.get(key, key)] for row in rows] for key in keys}
    for j, label in enumerate(labels):
        columns[label] = _one_type([row["values"][j] for row in rows])
    for name in dict.fromkeys(name for row in rows for name in row["figures"]):
        columns[name] = _one_type([row["figures"].get(name) for row in rows])
    return columns


def _table(columns: dict[str, list[Any]]) -> pa.Table:
    return pa.table({name: pa.array(values) for name, values in columns.items()})


def timings_table(timings: Sequence[dict[str, Any]]) -> pa.Table:
    """Seconds by station, worker and its memory, by trial."""
    flat = [
        {
            **{key: value for key, value in row.items() if key != "seconds"},
            **{f"{name}_s": value for name, value in row["seconds"].items()},
        }
        for row in sorted(timings, key=lambda row: int(row["trial"]))
    ]
    names = list(dict.fromkeys(name for row in flat for name in row))
    return _table({name: [row.get(name) for row in flat] for name in names})


def write_table(table: pa.Table, path: Path) -> None:
    """Write Parquet atomically.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    with atomic_write(path) as temporary:
        pyarrow.parquet.write_table(table, temporary)


def _one_type(values: list[Any]) -> list[Any]:
    """Values of a column in one type: numbers unchanged, mixtures with text as text."""
    kinds = {type(value) for value in values if value is not None}
    if len(kinds) <= 1:
        return values
    if kinds <= {int, float}:
        return [None if value is None else float(value) for value in values]
    return [None if value is None else str(value) for value in values]


def factors_without_effect(
    study: Study,
    out: Path,
    rows: Sequence[dict[str, Any]],
    undetected: Sequence[str],
    target: ExecutionTarget | None = None,
) -> list[str]:
    """Factors among the `undetected` ones that change no figure at all.

    Parameters
    ----------
    rows
        Finished trials.
    target
        Where to run control scans that are missing: its scheduler, else this process; None: run none.
    """
    base = next((row for row in rows if row["status"] == "ok"), None)
    if base is None or len(undetected) * _TRIALS_PER_CONTROL > len(rows):
        return []
    tasks = {label: _control(base, rows, study.factors.labels.index(label)) for label in undetected}
    job = study.job(out)
    if target is not None:
        chosen = target if target.scheduler is not None else ExecutionTarget(shard=(1, 1))
        run_tasks(job, [task for task in tasks.values() if task is not None], chosen, NullProgress())
    return [
        label
        for label, task in tasks.items()
        if task is None
        or (
            job.store.holds(task.name, job.digest_of_task(task))
            and _same_figures(base, *read_json(job.store.path(task.name) / ROWS))
        )
    ]


def _control(base: Mapping[str, Any], rows: Sequence[dict[str, Any]], factor: int) -> Task | None:
    """The trial `base` with the most distant value of a factor; None where the factor has one value in all trials."""
    own = base["values"][factor]
    others = [row["values"][factor] for row in rows if row["values"][factor] != own]
    if not others:
        return None
    numbers = all(isinstance(value, int | float) for value in (own, *others))
    values = list(base["values"])
    values[factor] = max(others, key=lambda value: abs(value - own)) if numbers else others[0]
    trial = {key: base[key] for key in ("number", "seed", "engine")}
    return Task(f"control-{factor + 1:03d}", [{**trial, "values": values}])


def _same_figures(base: Mapping[str, Any], control: Mapping[str, Any]) -> bool:
    before, after = base["figures"], control["figures"]
    return (
        control["status"] == "ok"
        and before.keys() == after.keys()
        and all(
            value == after[name]
            or (value is not None and after[name] is not None and math.isclose(value, after[name], **_EQUAL))
            for name, value in before.items()
        )
    )


@dataclass(frozen=True, eq=False, repr=False)
class StudyReport(Result):
    """The `analysis` of a study, the rows `collected` for it, and the `files` written.

    Examples
    --------
    See the example of `study`.
    """

    analysis: dict[str, Any]
    collected: Collected
    files: list[str]

    @property
    def figures(self) -> dict[str, Any]:
        """Name, trials, failures, notes, missing trials, and sensitivities by engine."""
        figures = {key: self.analysis[key] for key in ("name", "trials", "failed", "notes", "engines")}
        return {**figures, "missing": len(self.collected.missing)}

    def summary(self) -> str:
        """Trials, the largest contributions to each figure, failures and files, as lines of text."""
        made, missing = self.analysis["trials"], len(self.collected.missing)
        lines = [f"{self.analysis['name']}: {made} trials" + (f", {missing} missing" if missing else "")]
        for engine, engine_analysis in self.analysis["engines"].items():
            for name, found in engine_analysis["sensitivity"].items():
                lines.extend(_figure_lines(engine, name, engine_analysis["figures"][name], found))
        lines.extend(
            f"  failed     trial {f['trial']} (seed {f['seed']}): {f['message']}" for f in self.analysis["failed"][:5]
        )
        return "\n".join([*lines, *(f"  {file}" for file in self.files)])


def write_report(
    study: Study, out: Path, failed: Mapping[str, str] | None = None, target: ExecutionTarget | None = None
) -> StudyReport:
    """Collect all finished trials of the folder in its tables, ``study.json`` and ``report.html``.

    Parameters
    ----------
    failed
        Messages of tasks that failed, by name.
    target
        Where to run control scans of factors without detectable effect, see `factors_without_effect`; None: run none.

    Raises
    ------
    OutputError
        If no trial is finished, or a file cannot be written.
    """
    from scancell.studies.page import study_page  # noqa: PLC0415  (needs the extra "studies")

    collected = collect(study, out, failed)
    if not collected.rows:
        raise OutputError("contains no finished trial yet", file=out)
    analysis = analyse(study.description, study.factors.labels, collected.rows)
    _note_effects(study, out, collected, analysis, target)
    write_table(results_table(collected.rows, study.factors.labels), out / "results.parquet")
    write_table(timings_table(collected.timings), out / "timings.parquet")
    content = {**analysis, "missing": len(collected.missing), "timing": _timing(collected), "versions": versions()}
    about = {"study": study.source, "part": str(study.part), "seed": str(study.description.seed), **versions()}
    for name, text in (
        ("study.json", json.dumps(content, indent=1, allow_nan=False) + "\n"),
        ("report.html", study_page(analysis, collected.rows, about)),
    ):
        with atomic_write(out / name) as temporary:
            temporary.write_text(text)
    names = ("results.parquet", "timings.parquet", "study.json", "report.html")
    return StudyReport(analysis, collected, [str(out / name) for name in names])


def _note_effects(
    study: Study, out: Path, collected: Collected, analysis: dict[str, Any], target: ExecutionTarget | None
) -> None:
    """Add the factors that change no figure to `analysis`, and notes about factors without detectable effect."""
    engine = study.description.engine
    undetected = analysis["engines"].get(engine, {}).get("undetected", [])
    rows = [row for row in collected.rows if row["engine"] == engine]
    none = factors_without_effect(study, out, rows, undetected, target)
    weak = [label for label in undetected if label not in none]
    analysis["without_effect"] = none
    if none:
        analysis["notes"].append(f"no effect on any result ({engine} engine): {', '.join(none)}")
    if weak:
        analysis["notes"].append(f"no detectable effect on any result: {', '.join(weak)}")


def _timing(collected: Collected) -> dict[str, Any]:
    """Seconds per trial by station, number of workers, and their memory."""
    timings = collected.timings
    stations = list(dict.fromkeys(name for row in timings for name in row["seconds"]))
    return {
        "workers": len({(row["host"], row["worker"]) for row in timings}),
        "largest_memory_mb": max((row["memory_mb"] for row in timings), default=None),
        "seconds_per_trial": {
            name: float(np.mean([row["seconds"].get(name, 0.0) for row in timings])) for name in stations
        },
    }


def _figure_lines(engine: str, name: str, statistics: dict[str, Any], found: dict[str, Any]) -> Iterator[str]:
    """Mean and interval of a figure, and its main contributors."""
    explained = f"   explained by the factors: {found['explained']:.0%}" if "explained" in found else ""
    mean = f"{statistics['mean'] or 0:.4g}{_interval(statistics['interval_symmetric'])}"
    yield f"  {engine:<10} {name:<24} {mean}{explained}"
    for row in found.get("budget", [])[:_MOST_CONTRIBUTORS]:
        share = f"{row['share']:.1%}{_interval(row['share_interval'], '.1%')} of the variance"
        uncertainty = f"{row['uncertainty']:.3g}{_interval(row['uncertainty_interval'], '.3g')}"
        yield f"    {row['factor']:<33} {share}, uncertainty {uncertainty}"
    for row in found.get("morris", [])[:_MOST_CONTRIBUTORS]:
        mean = f"{row['mean_magnitude']:.3g} +- {row['mean_magnitude_confidence']:.2g}"
        yield f"    {row['factor']:<33} mean magnitude of the effect {mean}"


def _interval(ends: Sequence[float] | None, form: str = ".4g") -> str:
    return f" [{ends[0]:{form}}, {ends[1]:{form}}]" if ends else ""
