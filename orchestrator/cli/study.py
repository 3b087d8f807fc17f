"""`scancell study`: run, resume, report, show."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from orchestrator.cli.common import JsonOption, Outcome, run
from orchestrator.cli.options import with_options
from orchestrator.cli.where import (
    SchedulerOption,
    ShardOption,
    WorkersOption,
    run_many,
    run_timings,
    shard_outcome,
    where_of,
)

if TYPE_CHECKING:
    from orchestrator.studies.report import StudyReport
    from orchestrator.studies.study import Study
    from orchestrator.studies.task import Where

study_app = typer.Typer(help="Many scans in which things vary: runs, sensitivities, reports.", no_args_is_help=True)

StudyArgument = Annotated[Path, typer.Argument(help="study (TOML)")]
SetOption = Annotated[
    list[str] | None, typer.Option("--set", help="change the study: design.trials=20; repeatable, as when it was run")
]
OutOption = Annotated[Path | None, typer.Option("--out", help="folder for the results; default: out/NAME")]


@dataclass(frozen=True)
class RunOptions:
    """Options of commands that make trials."""

    set_: SetOption = None
    out: OutOption = None
    workers: WorkersOption = 0
    scheduler: SchedulerOption = None
    shard: ShardOption = None
    as_json: JsonOption = False

    def opened(self, path: Path) -> tuple[Study, Path, Where]:
        """The study, its folder, and who does the work."""
        return _opened(path, self.set_), _folder(path, self.out), where_of(self.workers, self.scheduler, self.shard)


@study_app.command("run")
@with_options(RunOptions)
def study_run(
    study: StudyArgument,
    options: RunOptions,
    trial: Annotated[int | None, typer.Option("--trial", min=1, help="make this one alone and print its row")] = None,
) -> None:
    """Make all trials of a study, then its report."""

    def work() -> Outcome:
        from orchestrator.studies.study import begin, check_study, replay  # noqa: PLC0415

        opened, folder, where = options.opened(study)
        check_study(opened)
        if trial is not None:
            row, watch = replay(opened, trial)
            return Outcome([json.dumps(row, indent=1)], row, timings=watch.seconds)
        begin(opened, folder, join=where.shard is not None)
        return _made(opened, folder, where, options.as_json)

    run("study run", options.as_json, work)


@study_app.command("resume")
@with_options(RunOptions)
def study_resume(study: StudyArgument, options: RunOptions) -> None:
    """Go on with a study that was interrupted or killed; what is finished is not made again."""
    run("study resume", options.as_json, lambda: _made(*options.opened(study), options.as_json))


@study_app.command("report")
def study_report(
    study: StudyArgument, set_: SetOption = None, out: OutOption = None, as_json: JsonOption = False
) -> None:
    """Gather what is finished: results.parquet, study.json, report.html."""

    def work() -> Outcome:
        from orchestrator.studies.report import write_report  # noqa: PLC0415
        from orchestrator.studies.study import check_same  # noqa: PLC0415

        opened, folder = _opened(study, set_), _folder(study, out)
        warnings = check_same(opened, folder).warnings
        return _reported(write_report(opened, folder), {}, warnings)

    run("study report", as_json, work)


@study_app.command("show")
def study_show(study: StudyArgument, set_: SetOption = None, as_json: JsonOption = False) -> None:
    """Check a study and tell what it would do, without doing it."""

    def work() -> Outcome:
        from orchestrator.studies.study import check_study  # noqa: PLC0415

        opened = _opened(study, set_)
        check_study(opened)
        described = opened.description
        figures: dict[str, Any] = {
            "name": described.name,
            "design": described.design.kind,
            "trials": len(opened.trials),
            "tasks": len(opened.tasks),
            "factors": opened.factors.labels,
        }
        first = ", ".join(f"{k} = {v}" for k, v in zip(opened.factors.labels, opened.trials[0].values, strict=True))
        lines = [
            f"{described.name}: {figures['trials']} trials in {figures['tasks']} tasks, {described.design.kind}",
            *(f"  {label}" for label in opened.factors.labels),
            f"  trial 1: {first}",
        ]
        return Outcome(lines, figures)

    run("study show", as_json, work)


def _opened(path: Path, words: list[str] | None) -> Study:
    from orchestrator.studies.study import open_study  # noqa: PLC0415

    return open_study(path, words or [])


def _folder(path: Path, out: Path | None) -> Path:
    return out if out is not None else Path("out") / path.stem


def _made(study: Study, folder: Path, where: Where, as_json: bool) -> Outcome:
    from orchestrator.studies.report import write_report  # noqa: PLC0415
    from orchestrator.studies.study import check_same, run_study  # noqa: PLC0415

    warnings = check_same(study, folder).warnings
    kept = f"finished trials are kept in {folder}; `scancell study resume` goes on"
    made = run_many(lambda progress, tell: run_study(study, folder, where, progress, tell), as_json, kept)
    partly = shard_outcome(made, where, "tasks", "`scancell study report` gathers all shards", warnings)
    return partly or _reported(write_report(study, folder, made.failed), run_timings(made), warnings)


def _reported(report: StudyReport, timings: dict[str, float], warnings: list[str]) -> Outcome:
    from orchestrator.studies.run_record import told_builds  # noqa: PLC0415

    failed = [f"{len(report.analysis['failed'])} trials failed"] if report.analysis["failed"] else []
    figures = {key: report.analysis[key] for key in ("name", "trials", "failed", "engines")}
    figures["missing"] = len(report.collected.missing)
    builds = told_builds(row.get("scancell") for row in report.collected.timings)
    return Outcome(report.lines(), figures, report.files, [*warnings, *builds, *failed], timings)
