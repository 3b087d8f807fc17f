"""Robot programs: Python files with a function `main` that receives the robot, and files in V+ and URScript."""

from __future__ import annotations

import importlib
import inspect
import io
import os
import re
import sys
import traceback
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from threading import RLock
from types import ModuleType
from typing import Any, Literal

from scancell.arguments import checked_arguments
from scancell.cell.instance import MotionLog
from scancell.cell.recording import Recording, write_recording
from scancell.config.choices import Engine
from scancell.errors import CommandError, ProgramError, ScancellError
from scancell.evaluation.deviation import deviation_from_mesh
from scancell.files import first_free, read_file
from scancell.live.cell import LiveCell
from scancell.live.scan import LiveChunk
from scancell.live.state import ContactWatch, JobStopped
from scancell.output.run_folder import RunFolder, command_words, manifest, resolved_toml, write_json
from scancell.programs.robot import Robot, Step
from scancell.programs.script import Script
from scancell.programs.urscript import UrScript
from scancell.programs.vplus import VPlus
from scancell.reconstruction.cloud import Cloud
from scancell.reconstruction.cloud_files import write_cloud
from scancell.scanning.session import ScanSession

_INTERVAL_US = 30_000  # between poses: an acceleration of 5 m/s² departs from their straight connection by 0.6 mm
CLOUD = "cloud.ply"

LANGUAGES: dict[str, type[Script]] = {".v2": VPlus, ".pg": VPlus, ".script": UrScript, ".urscript": UrScript}
_MODULE = "scancell_robot_program"

Stage = Literal["waiting", "running", "paused", "done", "stopped", "failed"]

_ACTIVE = ("waiting", "running", "paused")
_KEPT = 200  # lines of output
_LONGEST = 500  # characters of one


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
    """Run the program of a file; one in Python runs in this process, with all rights of its user.

    Parameters
    ----------
    program
        Python file with a function ``main`` that receives a `Robot`, or a program in V+ (``.v2``) or URScript
        (``.script``).
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

    script = read_script(program)

    def line() -> int:
        if script is not None:
            return script.line
        return next((line for frame, line in traceback.walk_stack(None) if frame.f_code.co_filename == file), 0)

    def on_step(step: Step) -> None:
        run.steps.append((line(), step))
        show(*run.steps[-1])

    watch = ContactWatch(session.cell, [body.name for body in session.true.bodies])
    recorder = ProgramRecorder(session) if recorded else None
    robot = Robot(session, engine, folder, on_step, lambda command: before(line(), command))
    try:
        if script is not None:
            script.run(robot, printed or print)
        else:
            with _loaded(program, printed) as module:
                _require_main(module, program)
                module.main(robot)
    except ProgramError:
        raise
    except JobStopped as stop:
        if script is not None:
            raise
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


def read_script(file: Path) -> Script | None:
    """The program of a file in a language of a controller, by its ending; None for one in Python.

    Raises `ProgramError` with the line of what is not in the subset.
    """
    language = LANGUAGES.get(file.suffix.lower())
    return None if language is None else language(file)


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


@dataclass(frozen=True)
class LiveProgramState:
    """State of the last program that was started.

    Attributes
    ----------
    file
        File of the program.
    source
        Its lines when it was started.
    stage
        ``waiting`` until the robot rests; ``paused`` while it rests in front of a command.
    line
        Line of the command that runs or, paused, comes next; line of the error after a failure; 0: none.
    output
        Commands that were carried out, with their lines, and printed text, the last ones; after success the
        simulated time and contacts of bodies.
    error
        Why it failed or was stopped; empty otherwise.
    folder
        Run folder; None while it runs, or without one.
    record
        Record of a program that ran to its end; else None.
    """

    file: Path
    source: tuple[str, ...]
    stage: Stage
    line: int
    output: tuple[str, ...]
    error: str
    folder: Path | None
    record: ProgramRun | None = None

    @property
    def is_active(self) -> bool:
        """Whether it has not ended."""
        return self.stage in _ACTIVE


class LiveProgram:
    """Runs program files in a live cell, one at a time, and records them. All methods are thread-safe.

    Parameters
    ----------
    live
        The cell.
    engine
        How profiles are measured.
    out
        Folder in which each run makes a run folder, the first of ``program_1``, ``program_2``, ... that does not exist.
    points_of_run
        Called when a program starts; the function that it returns receives the points of its scan lines, in the thread
        that senses.

    Attributes
    ----------
    started
        Number of programs that were started.
    """

    def __init__(
        self,
        live: LiveCell,
        engine: Engine,
        out: Path,
        points_of_run: Callable[[], Callable[[LiveChunk], object]] = lambda: lambda _chunk: None,
    ) -> None:
        self._live, self._engine, self._out, self._points_of_run = live, engine, out, points_of_run
        self._lock = RLock()
        self._run: _Run | None = None
        self.started = 0

    @property
    def state(self) -> LiveProgramState | None:
        """State of the last program; None before the first."""
        with self._lock:
            return None if self._run is None else self._run.state

    def start(self, file: Path, paused: bool = False) -> None:
        """Run the program of a file when nothing else moves the robot; `paused` in front of its first command.

        Raises
        ------
        CommandError
            If a program runs.
        ProgramError
            If the file cannot be read.
        """
        with self._lock:
            if self._run is not None and self._run.state.is_active:
                raise CommandError(f"{self._run.file.name} is running: end it first")
            self._run = run = _Run(file, self._engine, self._out, paused, self._points_of_run())
            self.started += 1
            run.future = self._live.perform(run.run, file.name)

    def pause(self) -> None:
        """Rest in front of the next command, until `resume` or `step`.

        Raises
        ------
        CommandError
            If no program runs.
        """
        self._active().pause()

    def resume(self) -> None:
        """Continue; errors as of `pause`."""
        self._active().resume()

    def step(self, file: Path) -> None:
        """Carry out one command and pause; start the program of `file`, paused, where none runs.

        Raises
        ------
        ProgramError
            If the file cannot be read.
        """
        with self._lock:
            if self._run is not None and self._run.state.is_active:
                self._run.step()
            else:
                self.start(file, paused=True)

    def _active(self) -> _Run:
        with self._lock:
            if self._run is None or not self._run.state.is_active:
                raise CommandError("no program is running")
            return self._run


class _Run:
    """One run of a program."""

    def __init__(
        self, file: Path, engine: Engine, out: Path, paused: bool, on_points: Callable[[LiveChunk], object]
    ) -> None:
        self._source = tuple(read_file(file, ProgramError).decode("utf-8", errors="replace").splitlines())
        self.file, self._engine, self._out, self._on_points = file, engine, out, on_points
        self.future: Future[ProgramRun] | None = None
        self._lock = RLock()
        self._paused, self._permitted = paused, 0  # commands that are carried out although it is paused
        self._begun, self._rests, self._line = False, False, 0
        self._folder: Path | None = None
        self._output: deque[str] = deque(maxlen=_KEPT)

    def pause(self) -> None:
        with self._lock:
            self._paused, self._permitted = True, 0

    def resume(self) -> None:
        with self._lock:
            self._paused, self._permitted = False, 0

    def step(self) -> None:
        """Permit one command more while the program rests; else rest in front of the next one."""
        with self._lock:
            self._paused, self._permitted = True, 1 if self._rests else 0

    @property
    def state(self) -> LiveProgramState:
        with self._lock:
            stage, error = self._end()
            line = 0 if stage == "done" else self._line
            if stage == "failed" and (place := re.match(re.escape(str(self.file)) + r":(\d+): ", error)):
                line = int(place[1])
            ended = stage not in _ACTIVE
            folder = self._folder if ended and self._folder is not None and self._folder.exists() else None
            record = self.future.result() if stage == "done" and self.future is not None else None
            return LiveProgramState(self.file, self._source, stage, line, tuple(self._output), error, folder, record)

    def _end(self) -> tuple[Stage, str]:
        """Stage, and the reason for an end other than that of the program."""
        future = self.future
        if future is None or not future.done():
            return ("paused" if self._rests else "running") if self._begun else "waiting", ""
        if future.cancelled():
            return "stopped", "stopped before it began"
        error = future.exception()
        if error is None:
            return "done", ""
        return "stopped" if isinstance(error, JobStopped) else "failed", str(error)

    # In the thread of the cell

    def run(self, session: ScanSession) -> ProgramRun:
        with self._lock:
            self._begun, self._folder = True, first_free(self._out, "program_{}")
        engine, folder = self._engine, self._folder
        before = lambda line, _command: self._before(session, line)  # noqa: E731
        session.on_points = partial(self._pass_on, session)
        try:
            done = run_program(
                self.file, session, engine, folder, self._after, self._note, recorded=True, before=before
            )
        finally:
            session.on_points = None
        contacts = f"contacts: {', '.join(done.contacts)}" if done.contacts else "no contact"
        self._note(f"done in {done.duration:.2f} s, {contacts}")
        return done

    def _pass_on(self, session: ScanSession, cloud: Cloud) -> None:
        if len(cloud):
            found = deviation_from_mesh(cloud, session.world.part_surface, session.pipeline.threads)
            self._on_points(LiveChunk.of(cloud, found.distance))

    def _before(self, session: ScanSession, line: int) -> None:
        """Rest in front of a command while the program is paused."""
        with self._lock:
            self._line = line
        try:
            while not self._goes_on():
                session.step()
        finally:
            self._rests = False

    def _goes_on(self) -> bool:
        with self._lock:
            self._rests = self._paused and self._permitted == 0
            self._permitted = max(0, self._permitted - 1)
            return not self._rests

    def _after(self, line: int, step: Step) -> None:
        self._note(f"line {line}: {step.command} {step.about}".rstrip())

    def _note(self, text: str) -> None:
        with self._lock:
            self._output += [line[:_LONGEST] for line in text.splitlines()[-_KEPT:]]
