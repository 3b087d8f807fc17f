"""Robot programs: Python files with a function `main` that receives the robot."""

from __future__ import annotations

import importlib
import inspect
import io
import os
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

from scancell.arguments import checked_arguments
from scancell.cell.instance import MotionLog
from scancell.cell.recording import Recording, write_recording
from scancell.config.choices import Engine
from scancell.errors import ProgramError, ScancellError
from scancell.files import read_file
from scancell.live.state import ContactWatch, JobStopped
from scancell.output.run_files import write_json
from scancell.output.run_folder import RunFolder, command_words, manifest, resolved_toml
from scancell.programs.robot import Robot, Step
from scancell.reconstruction.cloud import Cloud
from scancell.reconstruction.cloud_files import write_cloud
from scancell.scanning.session import ScanSession

_INTERVAL_US = 30_000  # between poses: an acceleration of 5 m/s² departs from their straight connection by 0.6 mm
CLOUD = "cloud.ply"

_MODULE = "scancell_robot_program"


class ProgramRecorder:
    """Records poses, exposures and clouds of a session from now on until `end`."""

    def __init__(self, session: ScanSession) -> None:
        self._session, self._listener = session, session.on_exposures
        self._motion = MotionLog(session.cell, _INTERVAL_US)
        self._exposures: list[Recording] = []
        self._clouds: list[Cloud] = []
        session.on_exposures = self._receive

    def _receive(self, recording: Recording, cloud: Cloud | None) -> None:
        self._exposures.append(recording)
        if cloud is not None:
            self._clouds.append(cloud)
        self._listener(recording, cloud)

    def end(self) -> None:
        """End the recording."""
        self._motion.end()
        self._session.on_exposures = self._listener

    def save(self, target: Path, program: Path, engine: Engine, with_cloud: bool) -> list[Path]:
        """Write the run folder of `program` and return its files; none if no simulated time has passed.

        ``cloud.ply`` holds the points of all clouds `with_cloud`.

        Raises
        ------
        OutputError
            If the folder cannot be written.
        """
        motion, world = self._motion.recording, self._session.world
        if len(motion) < 2:
            return []
        has_part = any(body.moves_with == "part" for body in self._session.nominal.bodies)
        file = world.part_file
        run = {
            "program": str(program.absolute()),
            "part": str(file.absolute()) if file is not None else world.part if has_part else "",
            "unit": world.unit,
            "engine": engine,
            "as_built": list(world.as_built),
            "seed": world.seed,
            "command_line": command_words(None),
        }
        inputs = [program.absolute(), *([] if file is None else [file])]
        with RunFolder(target) as folder:
            write_recording(motion, folder.path("motion.parquet"))
            write_recording(Recording.joined([motion[:0], *self._exposures]), folder.path("recording.parquet"))
            if with_cloud and self._clouds:
                comments = (f"scancell run of {program.name}", "frame part")
                write_cloud(folder.path(CLOUD), Cloud.concatenate(self._clouds), comments)
            elif with_cloud:
                (target / CLOUD).unlink(missing_ok=True)  # of an earlier run
            folder.path("resolved.toml").write_text(resolved_toml(world.setup, run))
            write_json(folder.path("manifest.json"), manifest(world.setup, inputs, run))
        return folder.paths


@dataclass
class ProgramRun:
    """Run record of a program.

    Attributes
    ----------
    steps
        Commands that were carried out, with the lines of the program.
    duration
        Simulated time, s.
    contacts
        Pairs of bodies that came into contact, gripped parts excluded.
    files
        Written by the program, those of the run folder last.
    """

    steps: list[tuple[int, Step]] = field(default_factory=list)
    duration: float = 0.0
    contacts: list[str] = field(default_factory=list)
    files: list[Path] = field(default_factory=list)


@checked_arguments
def run_program(
    program: str | Path,
    session: ScanSession,
    engine: Engine = "ray-traced",
    folder: str | Path | None = None,
    show: Callable[[int, Step], None] = lambda _line, _step: None,
    printed: Callable[[str], None] | None = None,
    recorded: bool = False,
    before: Callable[[int, str], None] = lambda _line, _command: None,
) -> ProgramRun:
    """Run the program of a file; it runs in this process, with all rights of its user.

    Parameters
    ----------
    program
        Python file with a function ``main`` that receives a `Robot`.
    session
        A running cell, guarded or not.
    engine
        How profiles are measured.
    folder
        Where the program saves clouds; None: the current folder.
    show
        Receives each command that was carried out, after the line of the program that gave it.
    printed
        Receives the text that the program prints; None: it goes to standard output.
    recorded
        Whether `folder` becomes a run folder, which `picture` and `animate` take, also if the program fails; a
        program in which no simulated time passes leaves none.
    before
        Receives each command before it is carried out, with the line of the program that gives it; the program
        continues when it returns. It may step the session.

    Returns
    -------
    ProgramRun
        With ``steps`` (line of the program and command), ``duration`` in simulated time, s, ``contacts`` of bodies, and
        ``files`` that the program wrote, those of the run folder last.

    Raises
    ------
    ProgramError
        With file and line, for any error in the program: a command that the controller rejects, a stop by the
        guard, an error of Python.
    JobStopped
        With file and line, where the program ran in a `LiveCell` and was ended.
    OutputError
        If the run folder cannot be written.

    Examples
    --------
    >>> from pathlib import Path
    >>> length = Path("turn.py").write_text("def main(robot): robot.turn_table(0.5)")
    >>> with scancell.Scanner() as scanner, scanner.session("part.stl", guarded=True) as session:
    ...     done = scancell.run_program("turn.py", session, "geometric")
    >>> [(line, step.command, step.about) for line, step in done.steps], done.contacts
    ([(1, 'turn_table', '28.65 deg')], [])
    """
    program = Path(program)
    file, run, begin = str(program), ProgramRun(), session.time
    written: list[Path] = []

    def line() -> int:
        return next((line for frame, line in traceback.walk_stack(None) if frame.f_code.co_filename == file), 0)

    def on_step(step: Step) -> None:
        run.steps.append((line(), step))
        show(*run.steps[-1])

    watch = ContactWatch(session.cell, [body.name for body in session.true.bodies])
    recorder = ProgramRecorder(session) if recorded else None
    robot = Robot(session, engine, folder, on_step, lambda command: before(line(), command))
    try:
        with _loaded(program, printed) as module:
            _require_main(module, program)
            module.main(robot)
    except ProgramError:
        raise
    except JobStopped as stop:
        raise JobStopped(f"{_place(stop, file)}: {stop}") from stop
    except (Exception, SystemExit) as error:
        raise ProgramError(_message(error, file)) from error
    finally:
        watch.end()
        if recorder is not None:
            recorder.end()
            target = Path(folder or ".")
            written = recorder.save(target, program, engine, with_cloud=target / CLOUD not in robot.files)
    run.duration, run.contacts, run.files = session.time - begin, list(watch.pairs), [*robot.files, *written]
    return run


def _require_main(module: ModuleType, program: Path) -> None:
    main = getattr(module, "main", None)
    if not callable(main):
        raise ProgramError("has no function main", file=program, expected="def main(robot)")
    try:
        inspect.signature(main).bind(None)
    except TypeError:
        raise ProgramError(
            "main does not take the robot",
            file=program,
            expected="def main(robot); a script that makes a cell of its own is run by Python itself",
        ) from None


@contextmanager
def _loaded(program: Path, printed: Callable[[str], None] | None) -> Iterator[ModuleType]:
    """The program as a module; it may import modules from its folder, which are read again in every run."""
    source = read_file(program, ProgramError)
    module = ModuleType(_MODULE)
    module.__file__ = str(program)
    if printed is not None:
        module.__dict__["print"] = _printing_to(printed)
    folder = str(program.resolve().parent)
    before, keeps_bytecode = set(sys.modules), sys.dont_write_bytecode
    sys.path.insert(0, folder)
    sys.dont_write_bytecode = True  # that of a module changed within a second would be taken for its own
    importlib.invalidate_caches()
    sys.modules[_MODULE] = module  # dataclasses look their module up
    try:
        exec(compile(source, str(program), "exec"), module.__dict__)
        yield module
    finally:
        sys.path.remove(folder)
        sys.dont_write_bytecode = keeps_bytecode
        del sys.modules[_MODULE]
        for name in set(sys.modules) - before:
            top, file = name.partition(".")[0], getattr(sys.modules[name], "__file__", None) or ""
            if file.startswith((f"{folder}{os.sep}{top}.py", f"{folder}{os.sep}{top}{os.sep}")):
                del sys.modules[name]


def _printing_to(printed: Callable[[str], None]) -> Callable[..., None]:
    """A replacement of `print`."""

    def print_(*values: object, file: Any = None, **options: Any) -> None:
        text = io.StringIO()
        print(*values, file=text if file is None else file, **options)
        if file is None:
            printed(text.getvalue().rstrip("\n"))

    return print_


def _message(error: BaseException, file: str) -> str:
    """Message of an error that the program raised, with the innermost line of the program."""
    if isinstance(error, SyntaxError) and error.filename == file:
        return f"{file}:{error.lineno}: {error.msg}"
    what = str(error) if isinstance(error, ScancellError) else f"{type(error).__name__}: {error}"
    return f"{_place(error, file)}: {what}"


def _place(error: BaseException, file: str) -> str:
    """File, and the innermost line of the program where it has one in the trace."""
    lines = [line for frame, line in traceback.walk_tb(error.__traceback__) if frame.f_code.co_filename == file]
    return f"{file}:{lines[-1]}" if lines else file
