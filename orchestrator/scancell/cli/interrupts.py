"""Ctrl-C that is not lost.

Python prints and drops an exception that is raised inside a finalizer, a weak reference's callback or a function called
from C.  A `KeyboardInterrupt` that arrives there, during an import for example, would let the command run on.  So the
signal handler also records the interrupt, and the next report of progress raises it again.
"""

from __future__ import annotations

import os
import signal
import sys
from contextlib import AbstractContextManager
from types import TracebackType
from typing import Any, Self

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


class InterruptibleProgress:
    """Passes progress on and raises interrupts that Python dropped."""

    def __init__(self, shown: AbstractContextManager[Progress]) -> None:
        self._shown = shown
        self._progress: Progress

    def stage(self, name: str, total: float, unit: str) -> None:
        """Begin a stage."""
        INTERRUPTS.check()
        self._progress.stage(name, total, unit)

    def advance(self, steps: float) -> None:
        """Add steps."""
        INTERRUPTS.check()
        self._progress.advance(steps)

    def __enter__(self) -> Self:
        self._progress = self._shown.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._shown.__exit__(kind, error, trace)
