"""Jobs for the thread that owns a live cell."""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from scancell.cell.controller import Operation
from scancell.errors import ScancellError
from scancell.progress import CallbackProgress, Progress
from scancell.scanning.session import ScanSession

T = TypeVar("T")

CLOSED = "the cell is closed"  # why a job ends with the cell


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
