"""`scancell study` and `scancell batch`: many scans, in parallel and resumable."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from scancell.cli.common import (
    KEY_VALUE,
    AsBuiltOption,
    CellOption,
    Options,
    Outcome,
    OutOption,
    ScanOption,
    SensorOption,
    SetOption,
    WorkersOption,
    command,
    show_progress,
)
from scancell.config.choices import Engine

if TYPE_CHECKING:
    from scancell.studies.batch import Batch
    from scancell.studies.engine import ExecutionTarget, RunOutcome
    from scancell.studies.report import StudyReport
    from scancell.studies.study import ScanSeries, Study

_MAX_LISTED = 5  # failures that are printed; the index has all

StudyArgument = Annotated[Path, "study description (TOML)"]
StudySetOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar=KEY_VALUE, help="override a key of the study: design.trials=20; repeatable"),
]
StudyOutOption = Annotated[Path | None, "folder of the results; default: out/NAME, the name in the study"]


@dataclass(frozen=True)
class ExecutionOptions(Options):
    """Options of the execution of many scans."""

    workers: WorkersOption = 0
    scheduler: Annotated[str | None, "address of a Dask scheduler"] = None
    shard: Annotated[str | None, "i/n: run only every n-th task from the i-th, in this process, without Dask"] = None

    @property
    def target(self) -> ExecutionTarget:
        """Where tasks run.

        Raises
        ------
        DescriptionError
            If the shard is not i/n.
        """
        from scancell.errors import DescriptionError  # noqa: PLC0415
        from scancell.studies.engine import ExecutionTarget  # noqa: PLC0415

        if self.shard is None:
            return ExecutionTarget(self.workers, self.scheduler)
        first, slash, count = self.shard.partition("/")
        if not (slash and first.isdecimal() and count.isdecimal() and 1 <= int(first) <= int(count)):
            raise DescriptionError(key="shard", value=self.shard, expected="i/n with 1 <= i <= n, for example 3/8")
        return ExecutionTarget(shard=(int(first), int(count)))


@dataclass(frozen=True)
class RunOptions(ExecutionOptions):
    """Options of commands that run trials."""

    settings: StudySetOption = None
    out: StudyOutOption = None


@command("study run", RunOptions)
def study_run(
    study: StudyArgument,
    options: RunOptions,
    trial: Annotated[int | None, typer.Option(min=1, help="run only this trial and print its row")] = None,
) -> Outcome:
    """Run all trials of a study and write its report."""
    from scancell.studies.study import begin_new, replay  # noqa: PLC0415

    opened, folder = _opened(study, options.settings, options.out)
    target = options.target
    opened.check()
    if trial is not None:
        row, watch = replay(opened, trial)
        return Outcome([json.dumps(row, indent=1)], row, timings=watch.seconds)
    target.check()
    if target.shard is None:
        begin_new(opened, folder)
    else:  # any shard of a job array may come first
        opened.begin(folder)
    return _run_study(opened, folder, target, options.as_json)


@command("study resume", RunOptions)
def study_resume(study: StudyArgument, options: RunOptions) -> Outcome:
    """Continue a study that was interrupted, killed, or got more trials; finished trials are kept."""
    opened, folder = _opened(study, options.settings, options.out)
    return _run_study(opened, folder, options.target, options.as_json)


@command("study report")
def study_report(study: StudyArgument, settings: StudySetOption = None, out: StudyOutOption = None) -> Outcome:
    """Report on the finished trials: results.parquet, study.json, report.html."""
    from scancell.studies.report import write_report  # noqa: PLC0415

    opened, folder = _opened(study, settings, out)
    warnings = opened.check_same(folder).warnings
    return _reported(write_report(opened, folder), {}, warnings)


@command("study show")
def study_show(study: StudyArgument, settings: StudySetOption = None, out: StudyOutOption = None) -> Outcome:
    """Check a study without running it: factors, trials, and how many of them are finished."""
    from scancell.studies.run_record import DESCRIPTION  # noqa: PLC0415
    from scancell.studies.study import collect  # noqa: PLC0415

    opened, folder = _opened(study, settings, out)
    opened.check()
    begun = (folder / DESCRIPTION).exists()
    warnings = opened.check_same(folder).warnings if begun else []
    trials, labels = opened.trials, opened.factors.labels
    finished = len(collect(opened, folder).rows) if begun else 0
    figures: dict[str, Any] = {
        "name": opened.description.name,
        "design": opened.description.design.kind,
        "trials": len(trials),
        "tasks": len(opened.tasks),
        "factors": labels,
        "folder": str(folder),
        "finished": finished,
    }
    first = ", ".join(f"{label} = {value}" for label, value in zip(labels, trials[0].values, strict=True))
    lines = [
        f"{figures['name']}: {len(trials)} trials in {figures['tasks']} tasks, {figures['design']}",
        *(f"  {label}" for label in labels),
        f"  trial 1: {first}",
        f"  {folder}: {f'{finished} of {len(trials)} trials finished' if begun else 'not begun'}",
    ]
    return Outcome(lines, figures, warnings=warnings)


def _opened(path: Path, words: list[str] | None, out: Path | None) -> tuple[Study, Path]:
    """The study and the folder of its results."""
    from scancell.files import name_for_file  # noqa: PLC0415
    from scancell.studies.study import open_study  # noqa: PLC0415

    study = open_study(path, words or [])
    return study, out or Path("out") / (name_for_file(study.description.name) or path.stem)


def _run_study(study: Study, folder: Path, target: ExecutionTarget, as_json: bool) -> Outcome:
    from scancell.studies.report import write_report  # noqa: PLC0415

    warnings = study.check_same(folder).warnings
    kept = f"finished trials are kept in {folder}; `scancell study resume` continues"
    made = _run_all(study, folder, target, as_json, kept)
    partly = _shard_outcome(made, target, "tasks", "`scancell study report` reports on all shards", warnings)
    return partly or _reported(write_report(study, folder, made.failed, target), _run_timings(made), warnings)


def _reported(report: StudyReport, timings: dict[str, float], warnings: list[str]) -> Outcome:
    from scancell.studies.run_record import mixed_build_warnings  # noqa: PLC0415

    failed = [f"{len(report.analysis['failed'])} trials failed"] if report.analysis["failed"] else []
    builds = mixed_build_warnings(row.get("scancell") for row in report.collected.timings)
    every = [*warnings, *builds, *report.analysis["notes"], *failed]
    return Outcome(report.summary().splitlines(), report.figures, report.files, every, timings)


@command("batch", ExecutionOptions)
def batch(
    parts: Annotated[
        list[Path], "meshes (STL, OBJ, PLY), CAD files (STEP, IGES, BREP), folders of them, or artefacts (TOML)"
    ],
    out: OutOption,
    options: ExecutionOptions,
    config: Annotated[Path | None, "batch description (TOML); options override its keys"] = None,
    variants: Annotated[int | None, typer.Option(min=1, help="number of scans of every part")] = None,
    engine: Annotated[Engine | None, "ray-traced: rendered camera images; geometric: ray intersections"] = None,
    formats: Annotated[
        str | None,
        typer.Option("--format", help="formats of the clouds, separated by commas: ply, npz, laz, e57, pcd, xyz"),
    ] = None,
    images: Annotated[bool | None, typer.Option("--images/--no-images", help="keep all camera images")] = None,
    truth: Annotated[bool | None, typer.Option("--truth/--no-truth", help="write the ground truth")] = None,
    cell: CellOption = None,
    sensor: SensorOption = None,
    scan: ScanOption = None,
    settings: SetOption = None,
    as_built: AsBuiltOption = None,
    ideal: Annotated[bool | None, typer.Option("--ideal/--noisy", help="switch off all noise but speckle")] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="random seed")] = None,
    unit: Annotated[str | None, "unit of the mesh files: mm, m or inch"] = None,
) -> Outcome:
    """Scan many parts in many variants: clouds, images, ground truth and an index. The same command resumes."""
    from scancell.config.study import load_batch  # noqa: PLC0415
    from scancell.reconstruction.cloud_files import parse_formats  # noqa: PLC0415
    from scancell.studies.batch import open_batch  # noqa: PLC0415

    changes = {
        **{"engine": engine, "images": images, "truth": truth, "ideal": ideal, "seed": seed, "unit": unit},
        **{kind: path and str(path.resolve()) for kind, path in (("cell", cell), ("sensor", sensor), ("scan", scan))},
    }
    given: dict[str, Any] = {key: value for key, value in changes.items() if value is not None}
    if formats is not None:
        given["formats"] = parse_formats(formats, "formats")
    description = load_batch(config, given, variants)
    added = {"set": (*description.set, *(settings or [])), "as_built": (*description.as_built, *(as_built or []))}
    opened = open_batch(description.model_copy(update=added), config, parts, out)
    target = options.target
    target.check()
    opened.check()
    opened.begin(out)
    return _run_batch(opened, out, target, options.as_json)


def _run_batch(opened: Batch, out: Path, target: ExecutionTarget, as_json: bool) -> Outcome:
    from scancell.errors import WorkersError  # noqa: PLC0415
    from scancell.studies.batch import INDEX, write_index  # noqa: PLC0415
    from scancell.studies.run_record import mixed_build_warnings  # noqa: PLC0415

    warnings = opened.check_same(out).warnings
    made = _run_all(opened, out, target, as_json, f"finished scans are kept in {out}; the same command resumes")
    partly = _shard_outcome(made, target, "scans", "the same command without --shard writes the index", warnings)
    if partly is not None:
        return partly
    collected = write_index(opened, out, made.failed)
    failed = collected.failed
    messages = [f"{row['scan']}: {row['message']}" for row in failed[:_MAX_LISTED]]
    if failed and len(failed) == len(collected.rows):
        raise WorkersError(f"all {len(failed)} scans failed, see {out / INDEX}; the first: {messages[0]}")
    figures = {**collected.figures, "parts": len(opened.parts), "new": len(made.done)}
    lines = [f"{figures['scans'] - figures['failed']} scans of {figures['parts']} parts in {out}"]
    worse = [f"{len(failed)} scans failed: {messages[0]}", *messages[1:]] if failed else []
    builds = mixed_build_warnings(row["scancell"] for row in collected.rows)
    return Outcome(lines, figures, [str(out / INDEX)], [*warnings, *builds, *worse], _run_timings(made))


def _run_all(series: ScanSeries, out: Path, target: ExecutionTarget, as_json: bool, kept: str) -> RunOutcome:
    """Run all tasks with progress and the address of Dask's dashboard; `kept` is printed when the user interrupts."""
    try:
        with show_progress(as_json) as progress:
            return series.run(out, target, progress, lambda link: print(f"dashboard: {link}", file=sys.stderr))
    except KeyboardInterrupt:
        print(kept, file=sys.stderr)
        raise


def _shard_outcome(
    made: RunOutcome, target: ExecutionTarget, unit: str, following: str, warnings: list[str]
) -> Outcome | None:
    """Outcome of one shard of several; None if this process ran all tasks."""
    if target.shard is None or target.shard[1] == 1:
        return None
    first, count = target.shard
    text = f"shard {first}/{count}: {len(made.done)} {unit} done, {len(made.present)} finished before"
    return Outcome([text, following], {"done": len(made.done)}, [], warnings, _run_timings(made))


def _run_timings(made: RunOutcome) -> dict[str, Any]:
    """Wall time of a run, of its start, and of the workers in tasks, in seconds."""
    return {"run": made.seconds, "start": made.start_seconds, "busy": made.busy_seconds}
