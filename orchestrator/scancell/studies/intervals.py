"""Statistics of a sample: mean, standard deviation, coverage intervals after JCGM 101:2008, convergence."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def symmetric_interval(sample: Array, probability: float) -> tuple[float, float] | None:
    """Probabilistically symmetric coverage interval of a sample (n,); None if it is too small.

    JCGM 101:2008, 7.7.2: of the values in rising order, y(r) and y(r + q) with q = p M, r = (M - q) / 2.
    """
    count, held = _held(sample, probability)
    if held is None:
        return None
    ordered = np.sort(sample)
    start = (count - held + 1) // 2
    return float(ordered[start - 1]), float(ordered[start + held - 1])


def shortest_interval(sample: Array, probability: float) -> tuple[float, float] | None:
    """Shortest coverage interval of a sample (n,); None if it is too small. JCGM 101:2008, 7.7.4."""
    count, held = _held(sample, probability)
    if held is None:
        return None
    ordered = np.sort(sample)
    start = int(np.argmin(ordered[held:] - ordered[: count - held]))
    return float(ordered[start]), float(ordered[start + held])


def _held(sample: Array, probability: float) -> tuple[int, int | None]:
    """Size of the sample, and the number of steps between its values that the interval spans; one stays outside."""
    held = int(probability * len(sample) + 0.5)
    return len(sample), held if 1 <= held < len(sample) else None


def summary(sample: Array, probability: float) -> dict[str, Any]:
    """Figures of a sample (n,) as plain data."""
    count = len(sample)
    std = float(sample.std(ddof=1)) if count > 1 else None
    return {
        "trials": count,
        "mean": float(sample.mean()) if count else None,
        "standard_deviation": std,
        "standard_error": None if std is None else std / count**0.5,
        "minimum": float(sample.min()) if count else None,
        "maximum": float(sample.max()) if count else None,
        "interval_symmetric": symmetric_interval(sample, probability),
        "interval_shortest": shortest_interval(sample, probability),
    }


def convergence(sample: Array, steps: int = 24) -> list[dict[str, float]]:
    """Mean, its standard error, and standard deviation of the first n values, for growing n."""
    if len(sample) < 2:
        return []
    counts = np.unique(np.geomspace(2, len(sample), steps).round().astype(int))
    rows = []
    for n in counts:
        std = float(sample[:n].std(ddof=1))
        rows.append(
            {
                "trials": int(n),
                "mean": float(sample[:n].mean()),
                "standard_error": std / n**0.5,
                "standard_deviation": std,
            }
        )
    return rows
