"""From the finished trials to the files that a person opens."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from orchestrator.errors import OutputError
from orchestrator.evaluation.manifest import versions
from orchestrator.files import atomic_write
from orchestrator.studies.analysis import analyse
from orchestrator.studies.page import study_page
from orchestrator.studies.results import results_table, timings_table, write_table
from orchestrator.studies.study import Collected, Study, collect


@dataclass(frozen=True)
class StudyReport:
    """What the files of a study say, for people and programs."""

    analysis: dict[str, Any]
    collected: Collected
    files: list[str]

    def lines(self) -> list[str]:
        """For people."""
        made, missing = self.analysis["trials"], len(self.collected.missing)
        lines = [f"{self.analysis['name']}: {made} trials" + (f", {missing} missing" if missing else "")]
        for engine, said in self.analysis["engines"].items():
            for name, closer in said["closer"].items():
                lines.append(_line(engine, name, said["figures"][name], closer))
        lines.extend(
            f"  failed     trial {f['trial']} (seed {f['seed']}): {f['message']}" for f in self.analysis["failed"][:5]
        )
        return [*lines, *(f"  {file}" for file in self.files)]


def write_report(study: Study, out: Path, failed: Mapping[str, str] | None = None) -> StudyReport:
    """Gather all finished trials of the folder into its tables, ``study.json`` and ``report.html``.

    Raises
    ------
    OutputError
        If nothing is finished yet, or a file cannot be written.
    """
    collected = collect(study, out, failed)
    if not collected.rows:
        raise OutputError(f"{out}: holds no finished trial yet")
    analysis = analyse(study.description, study.factors.labels, collected.rows)
    write_table(results_table(collected.rows, study.factors.labels), out / "results.parquet")
    write_table(timings_table(collected.timings), out / "timings.parquet")
    content = {**analysis, "missing": len(collected.missing), "timing": _timing(collected), "versions": versions()}
    about = {"study": str(study.source), "part": str(study.part), "seed": str(study.description.seed), **versions()}
    for name, text in (
        ("study.json", json.dumps(content, indent=1, allow_nan=False) + "\n"),
        ("report.html", study_page(analysis, collected.rows, about)),
    ):
        with atomic_write(out / name) as temporary:
            temporary.write_text(text)
    names = ("results.parquet", "timings.parquet", "study.json", "report.html")
    return StudyReport(analysis, collected, [str(out / name) for name in names])


def _timing(collected: Collected) -> dict[str, Any]:
    """Seconds per trial by station, and how many workers took part."""
    timings = collected.timings
    stations = list(dict.fromkeys(name for row in timings for name in row["seconds"]))
    return {
        "workers": len({(row["host"], row["worker"]) for row in timings}),
        "largest_memory_mb": max((row["memory_mb"] for row in timings), default=None),
        "seconds_per_trial": {
            name: float(np.mean([row["seconds"].get(name, 0.0) for row in timings])) for name in stations
        },
    }


def _line(engine: str, name: str, said: dict[str, Any], closer: dict[str, Any]) -> str:
    ends = said["interval_symmetric"]
    interval = f" [{ends[0]:.4g}, {ends[1]:.4g}]" if ends else ""
    ranked = closer.get("budget", closer.get("morris", []))
    key = "share" if "budget" in closer else "mean_magnitude"
    leaders = ", ".join(
        f"{row['factor']} {row[key]:.0%}" if key == "share" else f"{row['factor']} {row[key]:.3g}" for row in ranked[:2]
    )
    return f"  {engine:<10} {name:<24} {said['mean'] or 0:.4g}{interval}" + (f"   most: {leaders}" if leaders else "")
