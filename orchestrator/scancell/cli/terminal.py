"""Progress on a terminal, and Ctrl-C that no finalizer or callback swallows."""

from __future__ import annotations

import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

from rich import progress as rich_progress
from rich.console import Console
from rich.progress import BarColumn, ProgressColumn, Task, TextColumn, TimeRemainingColumn
from rich.text import Text

from scancell.progress import Progress


class _Rate(ProgressColumn):
    """Steps per second in the stage's unit."""

    def render(self, task: Task) -> Text:
        speed = task.finished_speed or task.speed
        return Text("" if speed is None else f"{speed:,.1f} {task.fields['unit']}/s")


class TerminalProgress:
    """One line per stage on standard error."""

    def __init__(self) -> None:
        self._bars = rich_progress.Progress(
            TextColumn("{task.description:<12}"),
            BarColumn(),
            TextColumn("{task.completed:.0f}/{task.total:.0f} {task.fields[unit]}"),
            _Rate(),
            TimeRemainingColumn(),
            console=Console(stderr=True),
        )
        self._current = self._bars.add_task("starting", total=1, unit="")
        self._begun = False

    def stage(self, name: str, total: float, unit: str) -> None:
        """Begin a stage."""
        if self._begun:
            self._current = self._bars.add_task(name, total=total, unit=unit)
        else:
            self._bars.update(self._current, description=name, total=total, unit=unit)
            self._begun = True

    def advance(self, steps: float) -> None:
        """Move the bar of the present stage."""
        self._bars.advance(self._current, steps)

    def __enter__(self) -> Self:
        self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bars.stop()


class Interrupts:
    """Records the interrupts of this process."""

    _received = False

    def install(self) -> None:
        """Handle SIGINT, and SIGTERM as if it were SIGINT.  A second SIGINT during clean-up ends that, too."""
        self._received = False
        sys.unraisablehook = _report_dropped
        signal.signal(signal.SIGINT, self._handle)
        signal.signal(signal.SIGTERM, lambda *_: os.kill(os.getpid(), signal.SIGINT))

    def _handle(self, *_: Any) -> None:
        self._received = True
        raise KeyboardInterrupt

    @property
    def received(self) -> bool:
        """Whether SIGINT or SIGTERM has arrived since `install`."""
        return self._received

    def check(self) -> None:
        """Raise the interrupt that arrived, if any.

        Raises
        ------
        KeyboardInterrupt
            If SIGINT or SIGTERM has arrived since `install`.
        """
        if self._received:
            raise KeyboardInterrupt


def _report_dropped(dropped: sys.UnraisableHookArgs) -> None:
    if dropped.exc_type is not KeyboardInterrupt:  # recorded, not lost
        sys.__unraisablehook__(dropped)


INTERRUPTS = Interrupts()
EXIT_INTERRUPTED = 130


@contextmanager
def leaves_when_interrupted(within: float) -> Iterator[None]:
    """End the process when the block is interrupted, with status 130, at the latest `within` s after the signal.

    Python would wait for threads, or end those that compute in C++, which aborts the process. So nothing of Python is
    ended: the block has to free what must not stay. What takes longer than `within` is left as it is.
    """
    received, waker = socket.socketpair()
    waker.setblocking(False)

    def leave_later() -> None:
        with received:
            if received.recv(1):  # nothing if the other end is closed
                time.sleep(within)
                os._exit(EXIT_INTERRUPTED)

    with waker:
        before = signal.set_wakeup_fd(waker.fileno())
        threading.Thread(target=leave_later, name="interrupt", daemon=True).start()
        try:
            yield
        except BaseException:
            if INTERRUPTS.received:
                sys.stdout.flush()
                sys.stderr.flush()
                os._exit(EXIT_INTERRUPTED)
            raise
        finally:
            signal.set_wakeup_fd(before)


@contextmanager
def interruptible(shown: AbstractContextManager[Progress]) -> Iterator[Progress]:
    """Context manager of a progress whose reports raise the interrupts that Python dropped."""
    with shown as progress:
        yield _InterruptibleProgress(progress)


@dataclass(frozen=True)
class _InterruptibleProgress:
    progress: Progress

    def stage(self, name: str, total: float, unit: str) -> None:
        """Begin a stage."""
        INTERRUPTS.check()
        self.progress.stage(name, total, unit)

    def advance(self, steps: float) -> None:
        """Add steps."""
        INTERRUPTS.check()
        self.progress.advance(steps)
