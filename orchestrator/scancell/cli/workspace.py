"""`scancell workspace`: the cell in a browser."""

from __future__ import annotations

import sys
from ipaddress import ip_address
from pathlib import Path
from typing import Annotated, Literal

import typer

from scancell.cli.common import JsonOption, Outcome, ThreadsOption, run
from scancell.config.choices import LOOPBACK


def workspace(
    run_folder: Annotated[Path, typer.Argument(metavar="RUN", help="run folder of a scan")],
    host: Annotated[str, typer.Option("--host", help="address to listen on")] = LOOPBACK,
    port: Annotated[int, typer.Option("--port", min=1, max=65535, help="port; a taken one: the next free one")] = 8080,
    colour: Annotated[
        Literal["deviation", "intensity"], typer.Option("--colour", help="what the colours of the cloud show")
    ] = "deviation",
    threads: ThreadsOption = 0,
    as_json: JsonOption = False,
) -> None:
    """Play a recorded run back in a browser, until Ctrl-C: the cell, and the cloud as it was measured."""

    def started(address: str) -> None:
        print(f"workspace: open {address}", file=sys.stderr if as_json else sys.stdout, flush=True)
        if not ip_address(host).is_loopback:
            print("warning: other machines can reach the workspace, and anyone there controls it", file=sys.stderr)

    def work() -> Outcome:
        from scancell.workspace.browser.playback import serve_playback  # noqa: PLC0415
        from scancell.workspace.recorded_run import open_run  # noqa: PLC0415

        serve_playback(open_run(run_folder), host=host, port=port, colour=colour, threads=threads, started=started)
        return Outcome([], {}, [])

    run("workspace", as_json, work)
