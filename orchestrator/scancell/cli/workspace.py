"""`scancell workspace`, `run` and `program export`: the running cell in a browser, and robot programs."""

from __future__ import annotations

import contextlib
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

import scancell
from scancell.cli.common import (
    CellOptions,
    NoGuardOption,
    Outcome,
    PartOptions,
    PathOption,
    ScanOption,
    TablePartOption,
    command,
)
from scancell.cli.interrupts import INTERRUPTS, leaves_when_interrupted
from scancell.config.choices import LOOPBACK
from scancell.errors import DescriptionError, ProgramError

if TYPE_CHECKING:
    from scancell.exercises import Exercise
    from scancell.programs.robot import Step
    from scancell.scanning.session import ScanSession

_Language = Literal["urscript", "v2"]
_Colour = Literal["deviation", "intensity"]

_LEAVES = 1.8  # s after an interrupt


@command("workspace", CellOptions, around=lambda: leaves_when_interrupted(_LEAVES))
def workspace(
    options: CellOptions,
    target: Annotated[
        Path | None, typer.Argument(metavar="[PART|RUN]", help="mesh or artefact, or run folder of a scan")
    ] = None,
    scan: ScanOption = None,
    path: PathOption = None,
    host: Annotated[str, "address to listen on"] = LOOPBACK,
    port: Annotated[int, typer.Option(min=1, max=65535, help="port; the next free one if it is in use")] = 8080,
    no_guard: NoGuardOption = False,
    program: Annotated[Path | None, "robot program to run from the browser (docs/programs.md)"] = None,
    exercise: Annotated[
        str | None, typer.Option(metavar="N|NAME|list", help="open an exercise (docs/exercises.md), or list them")
    ] = None,
    out: Annotated[Path, "folder of saved runs, taught programs and result sheets"] = Path("out/workspace"),
    colour: Annotated[_Colour, "quantity that the colours of a run's cloud show"] = ("deviation"),
) -> Outcome:
    """Open the running cell in a browser, or play a recorded run back, until Ctrl-C (docs/workspace.md)."""
    if exercise == "list":
        return _exercise_list()
    from scancell.browser.server.gate import is_loopback  # noqa: PLC0415
    from scancell.browser.server.serve import PartFile, serve_workspace  # noqa: PLC0415
    from scancell.browser.server.workspace import WorkspaceSettings  # noqa: PLC0415

    chosen = None if exercise is None else _exercise(exercise, target, options)

    def started(address: str) -> None:
        if not is_loopback(host):
            print("warning: other machines can reach the workspace, and anyone there controls it", file=sys.stderr)
        print(f"workspace: open {address}", file=sys.stderr if options.as_json else sys.stdout, flush=True)

    if target is not None and target.is_dir():
        from scancell.browser.panels.scans import serve_playback  # noqa: PLC0415
        from scancell.views.recorded_run import open_run  # noqa: PLC0415

        run = open_run(target)
        serve_playback(run, host=host, port=port, colour=colour, threads=options.threads, started=started)
    else:
        if program is not None and not program.is_file():
            raise ProgramError("no such file", file=program)
        settings = WorkspaceSettings(out, options.engine, program, chosen)
        as_built, guarded = options.as_built or (), not no_guard
        if chosen is not None:
            target, options = chosen.part_file, replace(options, cell=chosen.cell_file)
        changes = [] if chosen is None else chosen.settings(options.seed)
        with scancell.Scanner(setup=options.setup(scan, path, changes), threads=options.threads) as scanner:

            def open_session(file: PartFile | None) -> contextlib.AbstractContextManager[ScanSession]:
                mesh, unit = (None, "mm") if file is None else (file.path, file.unit)
                return scanner.session(mesh, unit=unit, as_built=as_built, seed=options.seed, guarded=guarded)

            first = None if target is None else PartFile(target, options.unit)
            serve_workspace(open_session, first, host=host, port=port, settings=settings, started=started)
    return Outcome()


def _exercise_list() -> Outcome:
    from scancell.exercises import EXERCISES  # noqa: PLC0415

    lines = [f"{one.number}  {one.name:<12}{one.title}" for one in EXERCISES]
    return Outcome(lines, {"exercises": {one.name: one.title for one in EXERCISES}})


def _exercise(selected: str, target: Path | None, options: CellOptions) -> Exercise:
    """The exercise, which has a cell and a part of its own."""
    from scancell.exercises import find_exercise  # noqa: PLC0415

    exercise = find_exercise(selected)
    for key, value in (("part", target), ("cell", options.cell)):
        if value is not None:
            expected = f"none: exercise {exercise.number} has a {key} of its own"
            raise DescriptionError(key=key, value=str(value), expected=expected)
    return exercise


@command("run", CellOptions)
def run_program(
    program: Annotated[Path, "Python file with a function main(robot), or program in V+ (.v2) or URScript (.script)"],
    options: CellOptions,
    part: TablePartOption = None,
    no_guard: NoGuardOption = False,
    out: Annotated[Path, "run folder, also for the files that the program saves"] = Path("out/run"),
) -> Outcome:
    """Run a robot program in the simulated cell, with the collision guard active (docs/programs.md)."""
    from scancell.programs import program as programs  # noqa: PLC0415

    guarded, as_built = not no_guard, options.as_built or ()
    # Output of the program must not mix with the JSON object.
    printed = contextlib.redirect_stdout(sys.stderr) if options.as_json else contextlib.nullcontext()
    with (
        printed,
        scancell.Scanner(setup=options.setup(), threads=options.threads) as scanner,
        scanner.session(part, unit=options.unit, as_built=as_built, seed=options.seed, guarded=guarded) as session,
    ):
        session.cell.on_step(INTERRUPTS.check)
        done = programs.run_program(program, session, options.engine, out, _show, recorded=True)
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


@command("program export", PartOptions)
def export(
    plan: Annotated[Path, "plan of `scancell plan --out`, or run folder of a scan, which states cell and part"],
    options: PartOptions,
    to: Annotated[_Language, typer.Option(help="URScript (Universal Robots) or V+ (Adept)")],
    out: Annotated[Path, typer.Option(help="file for the program")],
    part: Annotated[Path | None, "part of the plan; not for a run folder"] = None,
    scan: ScanOption = None,
) -> Outcome:
    """Write a planned scan as a program of a robot controller (docs/programs.md)."""
    from scancell.config.loading import load_resolved  # noqa: PLC0415
    from scancell.files import atomic_write  # noqa: PLC0415

    unit, setup = options.unit, None
    if plan.is_dir():
        given = {"part": part, "cell": options.cell, "sensor": options.sensor, "scan": scan, "set": options.settings}
        for key, value in given.items():
            if value is not None:
                raise DescriptionError(key=key, value=str(value), expected="none: the run folder states it")
        setup, made = load_resolved(plan / "resolved.toml")
        part, unit, plan = Path(made["part"]), made["unit"], plan / "plan.json"
    elif part is None:
        raise DescriptionError(key="part", expected="the part of the plan, or a run folder in its place")
    setup = setup or options.setup(scan)
    with scancell.Scanner(setup=setup, threads=options.threads) as scanner:
        text = scancell.export_program(plan, scanner, part, to, unit=unit)
    with atomic_write(out) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return Outcome([f"{out}: {len(text.splitlines())} lines"], {"lines": len(text.splitlines())}, [str(out)])


def _show(line: int, step: Step) -> None:
    print(f"{step.begin:8.3f} s  line {line:<4} {step.command} {step.about}".rstrip(), flush=True)
