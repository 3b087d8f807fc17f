"""`scancell workspace`: the cell in a browser."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from scancell.cli.common import Outcome, PathOption, ScanOption, run
from scancell.cli.interrupts import leaves_when_interrupted
from scancell.cli.options import CellOptions, with_options
from scancell.config.choices import LOOPBACK
from scancell.errors import ProgramError

if TYPE_CHECKING:
    from scancell.browser.server.workspace import WorkspaceSettings
    from scancell.config.loading import Setup
    from scancell.scanning.session import ScanSession

Started = Callable[[str], None]

_LEAVES = 1.8  # s after an interrupt


@with_options(CellOptions)
def workspace(
    options: CellOptions,
    target: Annotated[
        Path | None, typer.Argument(metavar="[PART|RUN]", help="mesh or artefact, or run folder of a scan")
    ] = None,
    scan: ScanOption = None,
    path: PathOption = None,
    host: Annotated[str, typer.Option("--host", help="address to listen on")] = LOOPBACK,
    port: Annotated[int, typer.Option("--port", min=1, max=65535, help="port; a taken one: the next free one")] = 8080,
    no_guard: Annotated[bool, typer.Option("--no-guard", help="run without the collision guard")] = False,
    program: Annotated[
        Path | None, typer.Option("--program", help="robot program to run from the browser (docs/programs.md)")
    ] = None,
    out: Annotated[Path, typer.Option("--out", help="folder for the runs that are saved")] = Path("out/workspace"),
    colour: Annotated[
        Literal["deviation", "intensity"], typer.Option("--colour", help="what the colours of a run's cloud show")
    ] = "deviation",
) -> None:
    """Open the running cell in a browser, or play a recorded run back, until Ctrl-C (docs/workspace.md)."""

    def started(address: str) -> None:
        from scancell.browser.server.quiet import is_loopback  # noqa: PLC0415

        if not is_loopback(host):
            print("warning: other machines can reach the workspace, and anyone there controls it", file=sys.stderr)
        print(f"workspace: open {address}", file=sys.stderr if options.as_json else sys.stdout, flush=True)

    def work() -> Outcome:
        if target is not None and target.is_dir():
            _play_back(target, host, port, colour, options.threads, started)
        else:
            from scancell.browser.server.workspace import WorkspaceSettings  # noqa: PLC0415
            from scancell.config.loading import with_path  # noqa: PLC0415

            if program is not None and not program.is_file():
                raise ProgramError("no such file", file=program)
            settings = WorkspaceSettings(out, options.engine, program)
            setup = with_path(options.setup(scan), path)
            _run_cell(target, setup, options, host, port, not no_guard, settings, started)
        return Outcome()

    with leaves_when_interrupted(_LEAVES):
        run("workspace", options.as_json, work)


def _play_back(
    folder: Path, host: str, port: int, colour: Literal["deviation", "intensity"], threads: int, started: Started
) -> None:
    from scancell.browser.panels.playback import serve_playback  # noqa: PLC0415
    from scancell.views.recorded_run import open_run  # noqa: PLC0415

    serve_playback(open_run(folder), host=host, port=port, colour=colour, threads=threads, started=started)


def _run_cell(
    part: Path | None,
    setup: Setup,
    options: CellOptions,
    host: str,
    port: int,
    guarded: bool,
    settings: WorkspaceSettings,
    started: Started,
) -> None:
    from scancell.browser.server.serve import PartFile, serve_workspace  # noqa: PLC0415
    from scancell.scanner import Scanner  # noqa: PLC0415

    as_built = options.as_built or ()
    with Scanner(setup=setup, threads=options.threads) as scanner:

        def open_session(file: PartFile | None) -> AbstractContextManager[ScanSession]:
            path, unit = (None, "mm") if file is None else (file.path, file.unit)
            return scanner.session(path, unit=unit, as_built=as_built, seed=options.seed, guarded=guarded)

        first = None if part is None else PartFile(part, options.unit)
        serve_workspace(open_session, first, host=host, port=port, settings=settings, started=started)
