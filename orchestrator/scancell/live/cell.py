"""A running cell that operators command, without a view."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import Future
from typing import Annotated, TypeVar

from scancell.arguments import Count, Within, checked_arguments
from scancell.errors import CommandError, DescriptionError
from scancell.live.state import (
    CLOSED,
    Command,
    CommandKind,
    JobStopped,
    LiveControl,
    LiveState,
    StateReader,
    SubmittedJob,
    Work,
    interrupt,
    withdraw_interrupt,
)
from scancell.progress import NullProgress, Pace
from scancell.scanning.session import ScanSession

T = TypeVar("T")

_LOST = 1.0  # s without reading commands, after which a job can be interrupted


class LiveCell:
    """Steps a running cell in whole controller cycles, and takes commands between them.

    `submit`, `perform`, `between_cycles`, `emergency_stop` and `state` may be used from any thread; `step` and `run`
    from one alone, which owns the cell. All motion goes through the cell's controller. Moves wait for the one that
    runs; other commands take effect in the next cycle. A stop comes before everything that was submitted, and drops
    it.

    A job commands the session as a script does. However it steps the cell, at the end of each controller cycle the
    state is read, the pace is kept, and a stop or `Cancel` ends the job out of its step. A job that continues
    nevertheless is ended again in every cycle, and the emergency stop pressed. A job that does not step the cell holds
    up everything until it does; a second stop, when it has not stepped for a second, interrupts its Python code.

    Parameters
    ----------
    session
        A running cell, guarded or not, that nothing else steps.
    hold_time
        Time for which a jog continues without being renewed, s of `clock`.
    clock
        Function that returns the time, s; by default that of the machine.
    state_cycles
        Number of cycles from one `state` to the next.

    Examples
    --------
    >>> with scancell.Scanner() as scanner, scanner.session("part.stl", guarded=True) as session:
    ...     live = scancell.LiveCell(session)
    ...     done = live.perform(lambda session: session.turn_table(0.5), "turn the table")
    ...     live.run(done.done, realtime=False)
    ...     print(f"{live.state.controller}, table at {live.state.table_angle:.2f} rad")
    at rest, table at 0.50 rad

    Jogs need manual operation, and go on while they are renewed. A command checks its arguments when it is made:

    >>> with scancell.Scanner() as scanner, scanner.session(guarded=True) as session:
    ...     live = scancell.LiveCell(session)
    ...     live.submit(scancell.SetOperation(scancell.Operation.MANUAL))
    ...     live.run(lambda: session.time > 0.3, realtime=False)
    ...     live.submit(scancell.JogSensor([0, 0, 0.5, 0, 0, 0], scancell.JogFrame.SENSOR))
    ...     live.run(lambda: live.state.moving, realtime=False)
    >>> scancell.JogJoints([2.0])
    Traceback (most recent call last):
        ...
    scancell.errors.DescriptionError: deflections = ...: expected finite numbers of shape (n,) from -1 to 1

    Moves wait for the one that runs; a reset ends an emergency stop:

    >>> above = scancell.location(0.45, 0.0, 0.25, rx=np.pi)
    >>> lower = scancell.location(0.45, 0.0, 0.23, rx=np.pi)
    >>> with scancell.Scanner() as scanner, scanner.session(guarded=True) as session:
    ...     live = scancell.LiveCell(session)
    ...     live.submit(scancell.MoveTool(above))
    ...     live.submit(scancell.MoveLine(lower, speed=0.5))
    ...     live.run(lambda: np.allclose(session.world_from_tool(), lower, atol=1e-4), realtime=False)
    ...     live.emergency_stop()
    ...     live.run(lambda: live.state.controller == "emergency stop", realtime=False)
    ...     live.submit(scancell.Reset())
    ...     live.run(lambda: live.state.controller == "at rest", realtime=False)

    With another thread for ``live.run(ended.is_set)``, where ``ended`` is a ``threading.Event``, the cell goes on while
    this one commands it.
    """

    @checked_arguments
    def __init__(
        self,
        session: ScanSession,
        hold_time: Annotated[float, Within(0.0)] = 0.3,
        clock: Callable[[], float] = time.monotonic,
        state_cycles: Count = 1,
    ) -> None:
        self._session, self._clock, self._state_cycles = session, clock, state_cycles
        self._control = LiveControl(session, hold_time, clock)
        self._cycles = 0
        self._lock = threading.Lock()
        self._submitted: deque[Command | Work] = deque()
        self._callbacks: deque[Work] = deque()
        self._stop_pressed = False
        self._job: Work | None = None  # runs, or waits until nothing else moves the robot
        self._running = False
        self._ending = ""  # why the job has to end
        self._owner = 0  # thread that runs the job
        self._commands_read = clock()  # time of the last reading of commands
        self._between_cycles = False
        self._message = ""
        self._pace: Pace | None = None
        self._ended: Callable[[], bool] = lambda: False
        self._reader = StateReader(session)
        self._state = self._reader.read()
        session.progress = _StoppableProgress(self._look_at_job)
        session.cell.on_cycle(round(session.cycle * 1e6), self._end_cycle)

    # From any thread

    @property
    def state(self) -> LiveState:
        """The last state: angles, poses of all bodies, controller, sensors, messages; read-only."""
        return self._state

    def submit(self, command: Command) -> None:
        """Submit a `command` (`MoveJoints`, `JogSensor` …).

        Its result is in ``state.refusal`` and ``state.message``.
        """
        with self._lock:
            self._submitted.append(command)

    def perform(self, job: Callable[[ScanSession], T], name: str = "a program") -> Future[T]:
        """Submit a job, which runs in the thread that owns the cell when nothing else moves the robot.

        Until it has ended, other commands than `SetMonitorSpeed` and `Cancel` are refused, and so are other jobs. Its
        errors are in the result and in ``state.message``; a stop or `Cancel` ends it with `JobStopped`.

        Parameters
        ----------
        job
            Function that gets the session and commands it; it must not keep it.
        name
            For ``state.job`` and messages.

        Returns
        -------
        Future
            Future of the result of `job`.
        """
        submitted = SubmittedJob(name, job)
        with self._lock:
            self._submitted.append(submitted)
        return submitted.future

    def between_cycles(self, work: Callable[[ScanSession], T]) -> Future[T]:
        """Run `work` at the end of the present cycle, also during a job; returns the future of its result.

        `work` gets the session, and must not step the cell.
        """
        submitted = SubmittedJob("between_cycles", work)
        with self._lock:
            self._callbacks.append(submitted)
        return submitted.future

    def emergency_stop(self) -> None:
        """Press the emergency stop, end the job, and drop all submitted commands and jobs; `Reset` ends the stop."""
        with self._lock:
            dropped, self._submitted = self._submitted, deque()
            if self._stop_pressed and self._running and self._clock() - self._commands_read > _LOST:
                interrupt(self._owner)
            self._stop_pressed = True
        _cancel(dropped)

    # From the thread that owns the cell

    def run(self, ended: Callable[[], bool], realtime: bool = True) -> None:
        """Run cycle by cycle.

        At the end a job is stopped, and submitted work that has not begun is cancelled.

        Parameters
        ----------
        ended
            Function that is called in every cycle; the end is when it returns True.
        realtime
            Run by the wall clock, else as fast as possible. A machine that is too slow makes the cell's time slow.

        Raises
        ------
        CellError
            If the FMU reports an error.
        """
        self._pace, self._ended = Pace(self._session.cycle) if realtime else None, ended
        try:
            while not ended():
                self.step()
        finally:
            self._pace, self._ended = None, lambda: False
            with self._lock:
                dropped, self._submitted, self._callbacks = [*self._submitted, *self._callbacks], deque(), deque()
            _cancel(dropped)
            self._end_job(CLOSED)

    def step(self) -> None:
        """Apply commands, then step one controller cycle, or run a job to its end."""
        self._take_commands()
        try:
            self._control.begin_cycle()
        except (CommandError, DescriptionError) as error:
            self._message = str(error)
        if self._job is not None and self._control.is_free:
            self._run_job(self._job)
        else:
            self._session.step()

    def _take_commands(self) -> None:
        with self._lock:
            commands, self._submitted = self._submitted, deque()
            stopped, self._stop_pressed = self._stop_pressed, False
            self._commands_read = self._clock()
        if stopped:
            self._control.press_emergency_stop()
            self._end_job("stopped")
        for command in commands:
            try:
                self._apply(command)
                self._message = ""
            except (CommandError, DescriptionError) as error:
                self._message = str(error)

    def _end_cycle(self) -> None:
        """Called at the end of every controller cycle, however the cell is stepped."""
        if self._between_cycles:
            raise CommandError("between_cycles: the work steps the cell, which it must not")
        self._between_cycles = True
        try:
            self._control.end_cycle()
            if self._running:
                self._attend_job()
            self._cycles += 1
            if self._cycles % self._state_cycles == 0:
                self._read()
            self._run_callbacks()
        finally:
            self._between_cycles = False
        if self._pace is not None:
            self._pace.wait()
        if self._ending:
            raise JobStopped(self._ending)

    def _run_callbacks(self) -> None:
        with self._lock:
            callbacks, self._callbacks = self._callbacks, deque()
        for callback in callbacks:
            callback.run(self._session)

    def _read(self) -> None:
        self._state = self._reader.read(self._message, None if self._job is None else self._job.name)

    # Jobs

    def _run_job(self, job: Work) -> None:
        self._owner = threading.get_ident()
        self._running = True
        try:
            self._message = job.run(self._session)
        finally:
            with self._lock:
                ended, self._running, self._ending, self._job = bool(self._ending), False, "", None
                withdraw_interrupt(self._owner)
            if self._message or ended:
                self._session.hold()
            self._read()

    def _attend_job(self) -> None:
        """Apply commands in a cycle of a job, and check whether it has to end."""
        if self._ending:  # the job goes on although it was ended
            self._session.press_emergency_stop()
        self._take_commands()
        if self._ended() and not self._ending:
            self._end_job(CLOSED)

    def _end_job(self, why: str) -> None:
        if self._running:
            self._ending = why
            self._session.hold()
        elif self._job is not None:
            self._job.future.cancel()
            self._job = None

    def _look_at_job(self) -> None:
        """Apply commands while a job measures, which does not step the cell."""
        if not self._running or self._between_cycles:
            return
        self._attend_job()
        self._between_cycles = True
        try:
            self._run_callbacks()
        finally:
            self._between_cycles = False
        if self._ending:
            raise JobStopped(self._ending)

    def _take_job(self, job: Work) -> None:
        if self._job is not None:
            error = CommandError(f"{job.name}: {self._job.name} is running: cancel it first")
            job.refuse(error)
            raise error
        self._job = job

    def _apply(self, command: Command | Work) -> None:
        if isinstance(command, SubmittedJob):
            self._take_job(command)
        elif command.kind is CommandKind.CANCEL:
            self._end_job("cancelled")
            self._control.apply(command)
        elif self._job is not None and command.name != "set_monitor_speed":
            raise CommandError(f"{command.name}: {self._job.name} is running: cancel it first")
        else:
            self._control.apply(command)


class _StoppableProgress(NullProgress):
    """Checks at every step of a measurement whether its job has to end."""

    def __init__(self, look: Callable[[], None]) -> None:
        self._look = look

    def advance(self, _steps: float) -> None:
        """Check."""
        self._look()


def _cancel(dropped: Iterable[Command | Work]) -> None:
    for one in dropped:
        if isinstance(one, SubmittedJob):
            one.future.cancel()
