"""Progress of long work, and its cancellation."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import TracebackType
from typing import Protocol, Self, runtime_checkable

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
        import numpy as np  # noqa: PLC0415  (half of the time of `scancell --help`)

        if isinstance(answer, bool | np.bool_) and not answer:
            raise CancelledError(f"cancelled while {self._name} ({self._done:.0f} of {self._total:.0f})")


def as_progress(given: Progress | ProgressCallback | None) -> Progress:
    """A `Progress` from an object, a callback, or None."""
    if given is None:
        return NullProgress()
    if isinstance(given, NullProgress) or hasattr(given, "advance"):
        return given  # type: ignore[return-value]
    return CallbackProgress(given)


@dataclass
class Stopwatch:
    """Accumulates wall time (s) by name."""

    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def measure(self, name: str) -> Iterator[None]:
        """Context manager: adds the duration of the block to `name`."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start


class Pace:
    """Keeps steps of equal duration to a clock; a delay of less than a period is caught up.

    So sleep that takes a little too long each time does not add up, and there is no burst of steps after a long delay.

    Parameters
    ----------
    period
        Period of a step, s.
    clock, sleep
        s; those of the machine.
    """

    def __init__(
        self, period: float, clock: Callable[[], float] = time.monotonic, sleep: Callable[[float], None] = time.sleep
    ) -> None:
        self._period, self._clock, self._sleep = period, clock, sleep
        self._due = clock()

    def wait(self) -> None:
        """Wait until a period after the last step was due, or not at all if that is over."""
        now = self._clock()
        self._due = max(self._due + self._period, now - self._period)
        if self._due > now:
            self._sleep(self._due - now)
