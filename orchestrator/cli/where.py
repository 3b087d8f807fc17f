"""Options that say who does the work of many scans."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Any

import typer

from orchestrator.cli.common import Outcome, show_progress

if TYPE_CHECKING:
    from orchestrator.progress import Progress
    from orchestrator.studies.engine import RunOutcome
    from orchestrator.studies.task import Where

WorkersOption = Annotated[int, typer.Option("--workers", min=0, help="processes on this machine; 0: one per core")]
SchedulerOption = Annotated[str | None, typer.Option("--scheduler", help="address of a Dask scheduler")]
ShardOption = Annotated[
    str | None, typer.Option("--shard", help="i/n: only every n-th task from the i-th, in this process, without Dask")
]


def where_of(workers: int, scheduler: str | None, shard: str | None) -> Where:
    """Who does the work.

    Raises
    ------
    DescriptionError
        If the shard is none.
    """
    from orchestrator.errors import DescriptionError  # noqa: PLC0415
    from orchestrator.studies.task import Where  # noqa: PLC0415

    if shard is None:
        return Where(workers, scheduler)
    first, slash, count = shard.partition("/")
    if not (slash and first.isdigit() and count.isdigit() and 1 <= int(first) <= int(count)):
        raise DescriptionError(f"--shard {shard}: expected i/n with 1 <= i <= n, for example 3/8")
    return Where(shard=(int(first), int(count)))


def run_many(work: Callable[[Progress, Callable[[str], None]], RunOutcome], as_json: bool, kept: str) -> RunOutcome:
    """Run tasks with progress and the address of Dask's dashboard; `kept` is what an interrupted person should know."""
    try:
        with show_progress(as_json) as progress:
            return work(progress, lambda link: print(f"dashboard: {link}", file=sys.stderr))
    except KeyboardInterrupt:
        print(kept, file=sys.stderr)
        raise


def shard_outcome(made: RunOutcome, where: Where, unit: str, following: str, warnings: list[str]) -> Outcome | None:
    """What one shard of several has to say; None where all work was done here."""
    if where.shard is None or where.shard[1] == 1:
        return None
    first, count = where.shard
    text = f"shard {first}/{count}: {len(made.done)} {unit} done, {len(made.present)} were there"
    return Outcome([text, following], {"done": len(made.done)}, [], warnings, run_timings(made))


def run_timings(made: RunOutcome) -> dict[str, Any]:
    """Seconds of a run."""
    return {"run": made.seconds, "start": made.start_seconds, "busy": made.busy_seconds}
