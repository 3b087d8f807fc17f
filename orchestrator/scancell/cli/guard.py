"""`scancell guard`: protect a robot from collisions."""

from __future__ import annotations

import sys
from ipaddress import ip_address
from pathlib import Path
from typing import Annotated

import typer

from scancell.cli.common import JsonOption, Outcome, ScanOption, run
from scancell.config.choices import LOOPBACK, TransportProtocol

guard_app = typer.Typer(help="Protect a robot from collisions.", no_args_is_help=True, rich_markup_mode=None)


@guard_app.callback()
def guard() -> None:
    """Protect a robot from collisions."""


@guard_app.command("serve")
def guard_serve(
    cell: Annotated[Path | None, typer.Argument(help="cell description (TOML)")] = None,
    part: Annotated[Path | None, typer.Option("--part", help="mesh of the part; without, the table is empty")] = None,
    unit: Annotated[str, typer.Option("--unit", help="unit of the mesh file: mm, m or inch")] = "mm",
    scan: ScanOption = None,
    host: Annotated[str, typer.Option("--host", help="address to listen on")] = LOOPBACK,
    port: Annotated[int, typer.Option("--port", min=0, max=65535, help="port to listen on; 0: any free one")] = 0,
    transport: Annotated[
        TransportProtocol, typer.Option("--transport", help="protocol that carries the packets")
    ] = "udp",
    as_json: JsonOption = False,
) -> None:
    """Answer the states of a cell (docs/guard_protocol.md) until Ctrl-C; no rated safety function."""

    def started(host: str, port: int) -> None:
        print(f"guard: {transport} {host} {port}", file=sys.stderr if as_json else sys.stdout, flush=True)
        if not ip_address(host).is_loopback:
            print("warning: other machines can reach the guard, and packets are not authenticated", file=sys.stderr)

    def work() -> Outcome:
        from scancell.guard.server import serve  # noqa: PLC0415
        from scancell.jobs.guard_job import guard_of  # noqa: PLC0415

        counts = serve(guard_of(cell, part, scan, unit=unit), host, port, transport, started)
        lines = [f"  {number:>10} packets {outcome}" for outcome, number in sorted(counts.items())]
        return Outcome(lines or ["  no packets"], {"packets": dict(counts)})

    run("guard serve", as_json, work)
