"""Sensitivity by designs made for it: Sobol' indices, Morris's elementary effects, slopes one factor at a time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell.extras import require
from scancell.studies.budget import Fit, ShapleyForms, shares_of
from scancell.studies.designs import morris_problem

Array = NDArray[np.float64]

_RESAMPLES = 500


def sobol_indices(
    outputs: Array, factors: int, probability: float, seed: int
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """First-order and total indices with bootstrap intervals, and their convergence.

    Parameters
    ----------
    outputs
        (n (factors + 2),) in the order of Saltelli's scheme (`designs`); NaN for trials that failed, whose whole base
        sample is excluded.

    Returns
    -------
    tuple
        Per factor ``first``, ``total`` and their intervals; and, for growing n, lists of ``first`` and ``total``.

    Notes
    -----
    First order by Saltelli et al. 2010, table 2 (b); total by Jansen 1999, table 2 (f) of the same.
    """
    table = outputs.reshape(-1, factors + 2)
    table = table[np.isfinite(table).all(1)]
    if len(table) < 4 or not np.ptp(table) > 0:
        return [], []
    first, total = _saltelli(table)
    rng = np.random.default_rng(seed)
    drawn = [_saltelli(table[rng.integers(0, len(table), len(table))]) for _ in range(_RESAMPLES)]
    tails = [(1 - probability) / 2, (1 + probability) / 2]
    first_ends, total_ends = (np.quantile([d[k] for d in drawn], tails, axis=0) for k in (0, 1))
    rows = [
        {
            "first": float(first[j]),
            "first_interval": first_ends[:, j].tolist(),
            "total": float(total[j]),
            "total_interval": total_ends[:, j].tolist(),
        }
        for j in range(factors)
    ]
    counts = [n for n in 2 ** np.arange(3, 24) if n < len(table)] + [len(table)]
    growing = [(int(n), *_saltelli(table[:n])) for n in counts]
    return rows, [{"base_samples": n, "first": f.tolist(), "total": t.tolist()} for n, f, t in growing]


def _saltelli(table: Array) -> tuple[Array, Array]:
    """First-order and total indices (k,) from outputs (n, k + 2): A, A with column j of B, B."""
    a, mixed, b = table[:, 0], table[:, 1:-1].T, table[:, -1]
    variance = np.var(np.concatenate([a, b]))
    if variance == 0:
        return np.zeros(len(mixed)), np.zeros(len(mixed))
    centred = b - np.mean(np.concatenate([a, b]))
    first = (centred * (mixed - a)).mean(1) / variance
    total = ((a - mixed) ** 2).mean(1) / (2 * variance)
    return first, total


def morris_effects(
    unit_cube: Array, outputs: Array, levels: int, probability: float, seed: int
) -> list[dict[str, Any]]:
    """Elementary effects of each factor: mean, mean of magnitudes with its confidence, spread.

    `unit_cube` (n, k) and `outputs` (n,) are whole trajectories of k + 1 rows; those with a failed trial (NaN) are
    excluded.
    """
    morris = require("SALib.analyze.morris", "studies")
    factors = unit_cube.shape[1]
    whole = np.isfinite(outputs.reshape(-1, factors + 1)).all(1).repeat(factors + 1)
    if whole.sum() < 2 * (factors + 1):
        return []
    found = morris.analyze(
        morris_problem(factors), unit_cube[whole], outputs[whole], conf_level=probability, num_levels=levels, seed=seed
    )
    names = {"mean": "mu", "mean_magnitude": "mu_star", "mean_magnitude_confidence": "mu_star_conf", "spread": "sigma"}
    return [{name: float(found[key][j]) for name, key in names.items()} for j in range(factors)]


def one_at_a_time_budget(
    values: Sequence[Array],
    outputs: Array,
    levels: Sequence[int],
    spreads: Sequence[float],
    probability: float,
    seed: int,
) -> list[dict[str, Any]]:
    """Slope of each factor through its levels, times its standard uncertainty, combined as in GUM 5.1.

    The shares are those of the combined variance of independent factors with linear effects and add up to 1. Intervals
    have the scatter of the outputs about all slopes; they are None where two levels per factor leave none.

    Parameters
    ----------
    outputs
        (1 + sum of levels,), first the trial in which all factors are at their median.
    spreads
        Standard deviation of each factor.
    """
    slopes, precisions, squares, free, start = [], [], 0.0, 0, 1
    for j, count in enumerate(levels):
        chosen = slice(start, start + count)
        good = np.isfinite(outputs[chosen])
        x, y = values[j][chosen][good], outputs[chosen][good]
        fitted = len(x) > 1 and np.ptp(x) > 0
        coefficients = np.polyfit(x, y, 1) if fitted else np.full(2, np.nan)
        slopes.append(float(coefficients[0]))
        precisions.append(float(((x - x.mean()) ** 2).sum()) if fitted else np.inf)
        if fitted:
            squares += float(((y - np.polyval(coefficients, x)) ** 2).sum())
            free += len(x) - 2
        start += count
    known = np.isfinite(slopes)
    scatter = squares / free if free else 0.0
    effects = np.where(known, slopes, 0.0) * spreads
    covariance = np.diag(scatter * np.square(spreads) / precisions)
    forms = ShapleyForms(np.eye(len(slopes)), [(j,) for j in range(len(slopes))], len(slopes))
    *rows, _ = shares_of(Fit(effects, covariance, 0.0, max(free, 1)), forms, probability, seed)
    missing = {} if free else {"share_interval": None, "uncertainty_interval": None}
    return [{"slope": slope, **row, **missing} for slope, row in zip(slopes, rows, strict=True)]
