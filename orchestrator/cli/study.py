"""`scancell study`: run, resume, report, show."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from orchestrator.cli.common import JsonOption, Outcome, run, show_progress
from orchestrator.cli.where import SchedulerOption, ShardOption, WorkersOption, tell_dashboard, where_of

if TYPE_CHECKING:
    from orchestrator.studies.study import Study
    from orchestrator.studies.task import Where

study_app = typer.Typer(help="Many scans in which things vary: runs, sensitivities, reports.", no_args_is_help=True)

StudyArgument = Annotated[Path, typer.Argument(help="study (TOML)")]
SetOption = Annotated[
    list[str] | None, typer.Option("--set", help="change the study: design.trials=20; repeatable, as when it was run")
]
OutOption = Annotated[Path | None, typer.Option("--out", help="folder for the results; default: out/NAME")]


@study_app.command("run")
def study_run(
    study: StudyArgument,
    set_: SetOption = None,
    out: OutOption = None,
    workers: WorkersOption = 0,
    scheduler: SchedulerOption = None,
    shard: ShardOption = None,
    trial: Annotated[int | None, typer.Option("--trial", min=1, help="make this one alone and print its row")] = None,
    as_json: JsonOption = False,
) -> None:
    """Make all trials of a study, then its report."""

    def work() -> Outcome:
        from orchestrator.studies.study import begin, check_same, check_study, replay  # noqa: PLC0415

        opened, folder, where = _opened(study, set_), _folder(study, out), where_of(workers, scheduler, shard)
        check_study(opened)
        if trial is not None:
            row, watch = replay(opened, trial)
            return Outcome([json.dumps(row, indent=1)], row, timings=watch.seconds)
        if where.shard is None or not (folder / "description.json").exists():
            begin(opened, folder)  # of several shards the first one that comes
        warnings = check_same(opened, folder).warnings
        return _made(opened, folder, where, as_json, warnings)

    run("study run", as_json, work)


@study_app.command("resume")
def study_resume(
    study: StudyArgument,
    set_: SetOption = None,
    out: OutOption = None,
    workers: WorkersOption = 0,
    scheduler: SchedulerOption = None,
    shard: ShardOption = None,
    as_json: JsonOption = False,
) -> None:
    """Go on with a study that was interrupted or killed; what is finished is not made again."""

    def work() -> Outcome:
        from orchestrator.studies.study import check_same  # noqa: PLC0415

        opened, folder = _opened(study, set_), _folder(study, out)
        warnings = check_same(opened, folder).warnings
        return _made(opened, folder, where_of(workers, scheduler, shard), as_json, warnings)

    run("study resume", as_json, work)


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


def _made(study: Study, folder: Path, where: Where, as_json: bool, warnings: list[str]) -> Outcome:
    from orchestrator.studies.report import write_report  # noqa: PLC0415
    from orchestrator.studies.study import run_study  # noqa: PLC0415

    try:
        with show_progress(as_json) as progress:
            made = run_study(study, folder, where, progress, tell_dashboard)
    except KeyboardInterrupt:
        print(f"finished trials are kept in {folder}; `scancell study resume` goes on", file=sys.stderr)
        raise
    timings = {"run": made.seconds, "start": made.start_seconds, "busy": made.busy_seconds}
    if where.shard is not None and where.shard[1] > 1:
        text = f"shard {where.shard[0]}/{where.shard[1]}: {len(made.done)} tasks done, {len(made.present)} were there"
        lines = [text, "`scancell study report` gathers all shards"]
        return Outcome(lines, {"done": len(made.done)}, [], warnings, timings)
    return _reported(write_report(study, folder, made.failed), timings, warnings)


def _reported(report: Any, timings: dict[str, float], warnings: list[str]) -> Outcome:
    failed = [f"{len(report.analysis['failed'])} trials failed"] if report.analysis["failed"] else []
    figures = {key: report.analysis[key] for key in ("name", "trials", "failed", "engines")}
    figures["missing"] = len(report.collected.missing)
    return Outcome(report.lines(), figures, report.files, [*warnings, *failed], timings)
