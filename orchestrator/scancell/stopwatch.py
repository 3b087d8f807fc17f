"""Wall time by pipeline step, and steps by the wall clock."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field


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
        Of a step, s.
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
