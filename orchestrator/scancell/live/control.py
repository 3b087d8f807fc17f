"""Execution of the commands of operators, from cycle to cycle."""

from __future__ import annotations

import ctypes
import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from scancell.cell.driver import Operation
from scancell.errors import CommandError, DescriptionError, ScancellError
from scancell.live.commands import Cancel, Command, CommandAtRest, Jog, Move, SetOperation
from scancell.progress import CallbackProgress, Progress
from scancell.scanning.session import SEEN, ScanSession

_SEEN_US = round(SEEN * 1e6)

T = TypeVar("T")

CLOSED = "the cell is closed"  # why a job ends with the cell


class LiveControl:
    """Commands a session that another object steps; see `LiveCell` for the parameters.

    Moves wait for the one that runs. A change of operation and a reset wait until the robot rests.
    """

    def __init__(self, session: ScanSession, hold_time: float, clock: Callable[[], float]) -> None:
        self._session, self._cell = session, session.cell
        self._hold_time, self._clock = hold_time, clock
        self._moves: deque[Move] = deque()
        self._jog_until: float | None = None
        self._at_rest: CommandAtRest | None = None
        self._settled_us = 0
        self._moving = False  # a move that was begun has not ended

    def cancel_motion(self) -> None:
        """Drop all moves and jogs; the robot stops."""
        self._moves.clear()
        self._jog_until, self._at_rest, self._moving = None, None, False
        self._session.hold()

    def press_emergency_stop(self) -> None:
        """Cancel the motion and press the emergency stop."""
        self.cancel_motion()
        self._session.press_emergency_stop()

    @property
    def is_free(self) -> bool:
        """Whether nothing moves the robot and no motion is queued."""
        waits = self._moves or self._moving or self._jog_until is not None or self._is_settling
        return not waits and not self._cell.get_boolean("controller.moving")

    def apply(self, command: Command) -> None:
        """Start a command, or queue it.

        Raises
        ------
        CommandError
            If it cannot be carried out.
        """
        match command:
            case Jog():
                self._jog(command)
            case Move():
                self._moves.append(command)
            case CommandAtRest():
                self.cancel_motion()
                self._at_rest = command
            case Cancel():
                self.cancel_motion()
            case _:
                command.start(self._session)

    def begin_cycle(self) -> None:
        """Start what is due in the next cycle.

        Raises
        ------
        CommandError
            If a move cannot be started; the queued moves are dropped.
        """
        self._act_at_rest()
        self._keep_jog()
        self._begin_move()

    def end_cycle(self) -> None:
        """Update whether a move has ended."""
        self._moving = self._moving and not self._move_ended()

    def _jog(self, command: Jog) -> None:
        """Start or renew a jog, but not before the guard has seen the robot at rest in manual operation."""
        operation = Operation(self._cell.get_integer("command.operation"))
        if self._is_settling:
            return
        if operation is not Operation.MANUAL:
            reason = "the cell is in automatic operation: change to manual operation first"
            raise CommandError(f"{command.name}: {reason}")
        command.start(self._session)
        self._jog_until = self._clock() + self._hold_time

    def _keep_jog(self) -> None:
        """Renew the heartbeat while the jog is renewed, else end the jog."""
        if self._jog_until is None:
            return
        if self._clock() < self._jog_until:
            self._session.renew_heartbeat()
        else:
            self._jog_until = None
            self._session.hold()

    def _act_at_rest(self) -> None:
        if self._at_rest is None or self._cell.get_boolean("controller.moving"):
            return
        self._at_rest.start(self._session)
        # A reset needs the next cycle of the controller, another operation the next answer of the guard.
        self._settled_us = self._cell.time_us + (_SEEN_US if isinstance(self._at_rest, SetOperation) else 1)
        self._at_rest = None

    @property
    def _is_settling(self) -> bool:
        """Whether nothing may move the robot yet."""
        return self._at_rest is not None or self._cell.time_us < self._settled_us

    def _begin_move(self) -> None:
        if not self._moves or self._moving or self._is_settling:
            return
        move = self._moves.popleft()
        try:
            move.start(self._session)
        except (CommandError, DescriptionError):
            self._moves.clear()
            raise
        self._moving = True

    def _move_ended(self) -> bool:
        """Whether a move is done or was rejected; a rejected one drops the queued moves."""
        if self._cell.get_integer("controller.error") != 0:
            self._moves.clear()
            return True
        return self._cell.get_boolean("controller.at_destination")


class JobStopped(BaseException):
    """Ends a job of a `LiveCell` out of the step in which it is stopped.

    It is not an `Exception`, so that a program which catches errors of its commands does not continue.

    Parameters
    ----------
    why
        What ended it.

    Examples
    --------
    >>> with scancell.Scanner() as scanner, scanner.session(guarded=True) as session:
    ...     live = scancell.LiveCell(session)
    ...     job = live.perform(lambda session: live.submit(scancell.Cancel()) or session.wait(60), "wait")
    ...     live.run(job.done, realtime=False)
    >>> job.exception()
    JobStopped('cancelled')
    """

    def __init__(self, why: str = "stopped") -> None:
        super().__init__(why)


def interrupt(thread: int) -> None:
    """Raise `JobStopped` in a thread, by its identifier, when it next runs Python code."""
    ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread), ctypes.py_object(JobStopped))


def withdraw_interrupt(thread: int) -> None:
    """Drop an interrupt that has not been raised."""
    ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread), None)


class SubmittedJob(Generic[T]):
    """Work with its result, which another thread may wait for."""

    def __init__(self, name: str, work: Callable[[ScanSession], T]) -> None:
        self.name, self._work = name, work
        self.future: Future[T] = Future()

    def refuse(self, error: ScancellError) -> None:
        """Give the error as the result, unless the work was cancelled."""
        if self.future.set_running_or_notify_cancel():
            self.future.set_exception(error)

    def run(self, session: ScanSession) -> str:
        """Run the work unless it was cancelled, and return its error message or an empty string.

        Raises
        ------
        BaseException
            An interrupt of the process, which is no error of the work.
        """
        if not self.future.set_running_or_notify_cancel():
            return ""
        try:
            result = self._work(session)
        except BaseException as error:
            self.future.set_exception(error)
            if not isinstance(error, Exception | SystemExit | JobStopped):
                raise
            is_own = isinstance(error, ScancellError | JobStopped)
            return str(error) if is_own else f"{type(error).__name__}: {error}"
        self.future.set_result(result)
        return ""


Work = SubmittedJob[Any]


def ready_to_move(session: ScanSession) -> NDArray[np.float64]:
    """Change to automatic operation, where it is not in force, and come to rest; the positions (axes,) there, rad."""
    if session.cell.get_integer("command.operation") != Operation.AUTOMATIC:
        session.set_operation(Operation.AUTOMATIC)
    return session.come_to_rest()


def while_stepping(session: ScanSession, work: Callable[[Progress], T]) -> T:
    """Step a session in a job while another thread does `work`, and return its result or raise its error.

    If the job is stopped, or the process ends, the progress that `work` gets cancels it.
    """
    future: Future[T] = Future()
    stopped = threading.Event()

    def do() -> None:
        try:
            future.set_result(work(CallbackProgress(lambda *_: not stopped.is_set() and process_goes_on())))
        except BaseException as error:
            future.set_exception(error)

    # No daemon: Python ends these when the process ends, which aborts it where they compute in C++.
    threading.Thread(target=do, name="plan").start()
    try:
        while not future.done():
            session.step()
    finally:
        stopped.set()
    return future.result()


def process_goes_on(*_: object) -> bool:
    """Whether the main thread has not ended; a callback of progress that cancels the work of other threads then."""
    return threading.main_thread().is_alive()
