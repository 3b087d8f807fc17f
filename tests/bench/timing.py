"""Wall-clock time of a piece of work on a machine that others use too."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Timing:
    """Seconds of the fastest repeat, and how much more the median took, relative to it."""

    best: float
    spread: float


def measure(work: Callable[[], object], repeats: int = 5) -> Timing:
    """Time `work`, after one run that warms caches and is not counted.

    Other processes only ever add time, and so the fastest repeat says most about the work.
    """
    work()
    seconds = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - start)
    best = min(seconds)
    return Timing(best, statistics.median(seconds) / best - 1.0)
