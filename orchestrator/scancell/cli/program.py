"""`scancell run`: robot programs."""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from scancell.cli.common import Outcome, run
from scancell.cli.interrupts import INTERRUPTS
from scancell.cli.options import CellOptions, with_options

if TYPE_CHECKING:
    from scancell.programs.robot import Step


@with_options(CellOptions)
def run_program(
    program: Annotated[Path, typer.Argument(help="Python file with a function main(robot)")],
    options: CellOptions,
    part: Annotated[Path | None, typer.Option("--part", help="mesh of the part; without, the table is empty")] = None,
    no_guard: Annotated[bool, typer.Option("--no-guard", help="run without the collision guard")] = False,
    out: Annotated[Path, typer.Option("--out", help="folder for the files that the program saves")] = Path("out/run"),
) -> None:
    """Run a robot program in the simulated cell, with the collision guard in force (docs/programs.md)."""

    def work() -> Outcome:
        from scancell.programs import program as programs  # noqa: PLC0415
        from scancell.scanner import Scanner  # noqa: PLC0415

        guarded, as_built = not no_guard, options.as_built or ()
        # What the program prints is no JSON.
        printed = contextlib.redirect_stdout(sys.stderr) if options.as_json else contextlib.nullcontext()
        with (
            printed,
            Scanner(setup=options.setup(), threads=options.threads) as scanner,
            scanner.session(part, unit=options.unit, as_built=as_built, seed=options.seed, guarded=guarded) as session,
        ):
            session.cell.on_step(INTERRUPTS.check)
            done = programs.run_program(program, session, options.engine, out, _show)
        figures = {
            "duration_s": done.duration,
            "contacts": done.contacts,
            "steps": [
                {"line": line, "command": step.command, "about": step.about, "begin_s": step.begin, "end_s": step.end}
                for line, step in done.steps
            ],
        }
        lines = [f"{program.name}: {len(done.steps)} commands, {done.duration:.2f} s of simulated time"]
        warnings = [f"contact: {pair}" for pair in done.contacts]
        return Outcome(lines, figures, [str(file) for file in done.files], warnings)

    run("run", options.as_json, work)


def _show(line: int, step: Step) -> None:
    print(f"{step.begin:8.3f} s  line {line:<4} {step.command} {step.about}".rstrip(), flush=True)
