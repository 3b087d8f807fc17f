"""A robot program in a live cell: started, paused and stepped by operators, with its source and output for views."""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from threading import RLock
from typing import Literal

from scancell.config.choices import Engine
from scancell.errors import CommandError, ProgramError
from scancell.evaluation.deviation import deviation_from_mesh
from scancell.files import first_free, read_file
from scancell.live.cell import LiveCell
from scancell.live.scan import LiveChunk
from scancell.live.state import JobStopped
from scancell.programs.program import ProgramRun, run_program
from scancell.programs.robot import Step
from scancell.reconstruction.cloud import Cloud
from scancell.scanning.session import ScanSession

Stage = Literal["waiting", "running", "paused", "done", "stopped", "failed"]

_ACTIVE = ("waiting", "running", "paused")
_KEPT = 200  # lines of output
_LONGEST = 500  # characters of one


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
