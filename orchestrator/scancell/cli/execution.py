"""Options that say where many scans run."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Any

import typer

from scancell.cli.common import Outcome, show_progress

if TYPE_CHECKING:
    from scancell.progress import Progress
    from scancell.studies.engine import RunOutcome
    from scancell.studies.task import ExecutionTarget

WorkersOption = Annotated[int, typer.Option("--workers", min=0, help="processes on this machine; 0: one per core")]
SchedulerOption = Annotated[str | None, typer.Option("--scheduler", help="address of a Dask scheduler")]
ShardOption = Annotated[
    str | None,
    typer.Option("--shard", help="i/n: run only every n-th task from the i-th, in this process, without Dask"),
]


def execution_target(workers: int, scheduler: str | None, shard: str | None) -> ExecutionTarget:
    """ExecutionTarget the options say that tasks run.

    Raises
    ------
    DescriptionError
        If the shard is not i/n.
    """
    from scancell.errors import DescriptionError  # noqa: PLC0415
    from scancell.studies.task import ExecutionTarget  # noqa: PLC0415

    if shard is None:
        return ExecutionTarget(workers, scheduler)
    first, slash, count = shard.partition("/")
    if not (slash and first.isdigit() and count.isdigit() and 1 <= int(first) <= int(count)):
        raise DescriptionError(key="shard", value=shard, expected="i/n with 1 <= i <= n, for example 3/8")
    return ExecutionTarget(shard=(int(first), int(count)))


def run_many(work: Callable[[Progress, Callable[[str], None]], RunOutcome], as_json: bool, kept: str) -> RunOutcome:
    """Run tasks with progress and the address of Dask's dashboard; `kept` is printed when the user interrupts."""
    try:
        with show_progress(as_json) as progress:
            return work(progress, lambda link: print(f"dashboard: {link}", file=sys.stderr))
    except KeyboardInterrupt:
        print(kept, file=sys.stderr)
        raise


def shard_outcome(
    made: RunOutcome, target: ExecutionTarget, unit: str, following: str, warnings: list[str]
) -> Outcome | None:
    """Outcome of one shard of several; None if this process ran all tasks."""
    if target.shard is None or target.shard[1] == 1:
        return None
    first, count = target.shard
    text = f"shard {first}/{count}: {len(made.done)} {unit} done, {len(made.present)} finished before"
    return Outcome([text, following], {"done": len(made.done)}, [], warnings, run_timings(made))


def run_timings(made: RunOutcome) -> dict[str, Any]:
    """Wall time of a run, of its start, and of the workers in tasks, in seconds."""
    return {"run": made.seconds, "start": made.start_seconds, "busy": made.busy_seconds}
