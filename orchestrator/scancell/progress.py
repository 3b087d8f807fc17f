"""Progress of long work, and its cancellation."""

from __future__ import annotations

from collections.abc import Callable
from types import TracebackType
from typing import Protocol, Self, runtime_checkable

import numpy as np

from scancell.errors import CancelledError

# Called with the stage, the steps done in it and their total; cancels by returning False.
ProgressCallback = Callable[[str, float, float], object]


@runtime_checkable
class Progress(Protocol):
    """Receives the stages of a piece of work and the steps done in them.

    Any object with these two methods will do, and so will a function ``callback(stage, done, total)``. What a method
    raises ends the work; a callback cancels it by returning False.

    Examples
    --------
    >>> class Stages:
    ...     def stage(self, name, total, unit):
    ...         print(name)
    ...     def advance(self, steps):
    ...         pass
    >>> plan = scancell.plan("part.stl", progress=Stages())
    planning
    """

    def stage(self, name: str, total: float, unit: str) -> None:
        """Begin the stage `name` of `total` steps of `unit`."""

    def advance(self, steps: float) -> None:
        """Add `steps` to the current stage."""


class NullProgress:
    """Ignores progress."""

    def stage(self, name: str, total: float, unit: str) -> None:
        """Begin a stage."""

    def advance(self, steps: float) -> None:
        """Add steps."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End."""


class CallbackProgress:
    """Passes progress to a function ``callback(stage, done, total)``.

    Raises
    ------
    CancelledError
        From `stage` and `advance`, when the callback returns False.
    """

    def __init__(self, callback: ProgressCallback) -> None:
        self._callback = callback
        self._name, self._done, self._total = "", 0.0, 0.0

    def stage(self, name: str, total: float, unit: str) -> None:
        """Begin a stage."""
        self._name, self._done, self._total = name, 0.0, total
        self.advance(0.0)

    def advance(self, steps: float) -> None:
        """Add steps."""
        self._done += steps
        answer = self._callback(self._name, self._done, self._total)
        if isinstance(answer, bool | np.bool_) and not answer:
            raise CancelledError(f"cancelled while {self._name} ({self._done:.0f} of {self._total:.0f})")


def as_progress(given: Progress | ProgressCallback | None) -> Progress:
    """A `Progress` from an object, a callback, or None."""
    if given is None:
        return NullProgress()
    if isinstance(given, NullProgress) or hasattr(given, "advance"):
        return given  # type: ignore[return-value]
    return CallbackProgress(given)
