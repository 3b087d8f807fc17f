"""Ctrl-C that no finalizer or callback swallows.

Python prints and drops an exception that is raised inside a finalizer, a weak reference's callback or a function called
from C.  A `KeyboardInterrupt` that arrives there, during an import for example, would let the command run on.  So the
signal handler also records the interrupt, and the next report of progress raises it again.
"""

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
from typing import Any

from scancell.progress import Progress


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
