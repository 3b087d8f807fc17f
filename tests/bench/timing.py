"""Wall-clock time of a piece of work on a machine that others use too."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Timing:
    """Seconds of the fastest repeat, how much more the median took, relative to it, and processor seconds.

    Processor seconds, of all threads together, hardly know of other processes: they tell what an idle machine would do,
    up to the caches that others empty.
    """

    best: float
    spread: float
    processor: float


def scaled(timing: Timing, factor: float) -> Timing:
    """The same in another unit, or per item."""
    return Timing(factor * timing.best, timing.spread, factor * timing.processor)


def measure(work: Callable[[], object], repeats: int = 5) -> Timing:
    """Time `work`, after one run that warms caches and is not counted.

    Other processes only ever add time, and so the fastest repeat says most about the work.
    """
    work()
    seconds, processor = [], []
    for _ in range(repeats):
        start, start_processor = time.perf_counter(), time.process_time()
        work()
        seconds.append(time.perf_counter() - start)
        processor.append(time.process_time() - start_processor)
    best = min(seconds)
    return Timing(best, statistics.median(seconds) / best - 1.0, min(processor))
