"""`scancell study`: run, resume, report, show."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from scancell.cli.common import JsonOption, Outcome, run
from scancell.cli.execution import (
    SchedulerOption,
    ShardOption,
    WorkersOption,
    execution_target,
    run_many,
    run_timings,
    shard_outcome,
)
from scancell.cli.options import with_options

if TYPE_CHECKING:
    from scancell.studies.report import StudyReport
    from scancell.studies.study import Study
    from scancell.studies.task import ExecutionTarget

study_app = typer.Typer(
    help="Vary inputs over many scans: run, sensitivity analysis, report.", no_args_is_help=True, rich_markup_mode=None
)

StudyArgument = Annotated[Path, typer.Argument(help="study description (TOML)")]
SetOption = Annotated[
    list[str] | None, typer.Option("--set", help="override a key of the study: design.trials=20; repeatable")
]
OutOption = Annotated[
    Path | None, typer.Option("--out", help="folder of the results; default: out/NAME, the name in the study")
]


@dataclass(frozen=True)
class RunOptions:
    """Options of commands that run trials."""

    set_: SetOption = None
    out: OutOption = None
    workers: WorkersOption = 0
    scheduler: SchedulerOption = None
    shard: ShardOption = None
    as_json: JsonOption = False

    def opened(self, path: Path) -> tuple[Study, Path, ExecutionTarget]:
        """The study, its folder, and where its tasks run."""
        study, folder = _opened(path, self.set_, self.out)
        return study, folder, execution_target(self.workers, self.scheduler, self.shard)


@study_app.command("run")
@with_options(RunOptions)
def study_run(
    study: StudyArgument,
    options: RunOptions,
    trial: Annotated[int | None, typer.Option("--trial", min=1, help="run only this trial and print its row")] = None,
) -> None:
    """Run all trials of a study and write its report."""

    def work() -> Outcome:
        from scancell.studies.study import begin_new, replay  # noqa: PLC0415

        opened, folder, target = options.opened(study)
        opened.check()
        if trial is not None:
            row, watch = replay(opened, trial)
            return Outcome([json.dumps(row, indent=1)], row, timings=watch.seconds)
        target.check()
        if target.shard is None:
            begin_new(opened, folder)
        else:  # any shard of a job array may come first
            opened.begin(folder)
        return _run(opened, folder, target, options.as_json)

    run("study run", options.as_json, work)


@study_app.command("resume")
@with_options(RunOptions)
def study_resume(study: StudyArgument, options: RunOptions) -> None:
    """Continue a study that was interrupted, killed, or got more trials; finished trials are kept."""
    run("study resume", options.as_json, lambda: _run(*options.opened(study), options.as_json))


@study_app.command("report")
def study_report(
    study: StudyArgument, set_: SetOption = None, out: OutOption = None, as_json: JsonOption = False
) -> None:
    """Report on the finished trials: results.parquet, study.json, report.html."""

    def work() -> Outcome:
        from scancell.studies.report import write_report  # noqa: PLC0415

        opened, folder = _opened(study, set_, out)
        warnings = opened.check_same(folder).warnings
        return _reported(write_report(opened, folder), {}, warnings)

    run("study report", as_json, work)


@study_app.command("show")
def study_show(
    study: StudyArgument, set_: SetOption = None, out: OutOption = None, as_json: JsonOption = False
) -> None:
    """Check a study without running it: factors, trials, and how many of them are finished."""

    def work() -> Outcome:
        from scancell.studies.run_record import DESCRIPTION  # noqa: PLC0415
        from scancell.studies.study import collect  # noqa: PLC0415

        opened, folder = _opened(study, set_, out)
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

    run("study show", as_json, work)


def _opened(path: Path, words: list[str] | None, out: Path | None) -> tuple[Study, Path]:
    """The study and the folder of its results."""
    from scancell.files import name_for_file  # noqa: PLC0415
    from scancell.studies.study import open_study  # noqa: PLC0415

    study = open_study(path, words or [])
    return study, out or Path("out") / (name_for_file(study.description.name) or path.stem)


def _run(study: Study, folder: Path, target: ExecutionTarget, as_json: bool) -> Outcome:
    from scancell.studies.report import write_report  # noqa: PLC0415

    warnings = study.check_same(folder).warnings
    kept = f"finished trials are kept in {folder}; `scancell study resume` continues"
    made = run_many(lambda progress, announce: study.run(folder, target, progress, announce), as_json, kept)
    partly = shard_outcome(made, target, "tasks", "`scancell study report` reports on all shards", warnings)
    return partly or _reported(write_report(study, folder, made.failed, target), run_timings(made), warnings)


def _reported(report: StudyReport, timings: dict[str, float], warnings: list[str]) -> Outcome:
    from scancell.studies.run_record import mixed_build_warnings  # noqa: PLC0415

    failed = [f"{len(report.analysis['failed'])} trials failed"] if report.analysis["failed"] else []
    builds = mixed_build_warnings(row.get("scancell") for row in report.collected.timings)
    every = [*warnings, *builds, *report.analysis["notes"], *failed]
    return Outcome(report.summary().splitlines(), report.figures, report.files, every, timings)
