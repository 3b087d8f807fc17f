"""Rates of values over the wall clock."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from time import monotonic


class Rate:
    """Mean change of a value per second of wall time; a value that decreases begins anew.

    Parameters
    ----------
    span
        Of wall time for the mean, s.
    clock
        s.
    """

    def __init__(self, span: float = 3.0, clock: Callable[[], float] = monotonic) -> None:
        self._span, self._clock = span, clock
        self._values: deque[tuple[float, float]] = deque()

    def add(self, value: float) -> None:
        """Add the present value."""
        if self._values and value < self._values[-1][1]:
            self._values.clear()
        now = self._clock()
        self._values.append((now, value))
        while len(self._values) > 2 and self._values[1][0] <= now - self._span:
            self._values.popleft()

    @property
    def per_second(self) -> float | None:
        """The mean change; None before there are values of a whole span."""
        if not self._values:
            return None
        (first, low), (last, high) = self._values[0], self._values[-1]
        return (high - low) / (last - first) if last - first >= self._span else None
