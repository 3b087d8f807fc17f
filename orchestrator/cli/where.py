"""Options that say who does the work of many scans."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
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


def tell_dashboard(link: str) -> None:
    """Print where Dask shows what it does."""
    print(f"dashboard: {link}", file=sys.stderr)
