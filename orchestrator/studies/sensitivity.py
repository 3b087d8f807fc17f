"""Which factor matters: Sobol' indices, Morris's elementary effects, uncertainty budgets."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.studies.designs import morris_problem

Array = NDArray[np.float64]

_RESAMPLES = 500
# With fewer rows per regressor a drawn sample may determine the model no more, and its shares mean nothing.
_ROWS_PER_REGRESSOR = 4


def sobol_indices(
    outputs: Array, factors: int, probability: float, seed: int
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """First-order and total indices with bootstrap intervals, and their convergence.

    Parameters
    ----------
    outputs
        (n (factors + 2),) in the order of Saltelli's scheme (`designs`); NaN for trials that failed, whose base sample
        is left out as a whole.

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
    left out.
    """
    from SALib.analyze import morris  # noqa: PLC0415

    factors = unit_cube.shape[1]
    whole = np.isfinite(outputs.reshape(-1, factors + 1)).all(1).repeat(factors + 1)
    if whole.sum() < 2 * (factors + 1):
        return []
    found = morris.analyze(
        morris_problem(factors), unit_cube[whole], outputs[whole], conf_level=probability, num_levels=levels, seed=seed
    )
    names = {"mean": "mu", "mean_magnitude": "mu_star", "mean_magnitude_confidence": "mu_star_conf", "spread": "sigma"}
    return [{name: float(found[key][j]) for name, key in names.items()} for j in range(factors)]


def regression_budget(
    columns: Sequence[Array], outputs: Array, probability: float, seed: int
) -> tuple[list[dict[str, Any]], float]:
    """Share of each factor in the variance of `outputs` (n,), by an additive model, and the share that it explains.

    Parameters
    ----------
    columns
        Per factor its regressors (n, m): value and square of a number, indicators of a word.

    Returns
    -------
    tuple
        Per factor ``share``, its bootstrap interval (where there are rows enough) and ``uncertainty`` (standard
        deviation of its part); and R². What is not explained is interaction, stronger nonlinearity, and noise.
    """
    needed = sum(column.shape[1] for column in columns) + 2
    spread = outputs.std()
    if len(outputs) < needed or not spread > 0:
        return [], float("nan")
    deviations, explained = _parts(columns, outputs)
    rows: list[dict[str, Any]] = [
        {"share": float(part / spread) ** 2, "uncertainty": float(part)} for part in deviations
    ]
    if len(outputs) >= _ROWS_PER_REGRESSOR * needed:
        for row, ends in zip(rows, _share_intervals(columns, outputs, probability, seed), strict=True):
            row["share_interval"] = ends.tolist()
    return rows, explained


def _share_intervals(columns: Sequence[Array], outputs: Array, probability: float, seed: int) -> Array:
    """(k, 2) ends of the bootstrap intervals of the factors' shares."""
    rng = np.random.default_rng(seed)
    drawn = []
    for _ in range(_RESAMPLES // 2):
        rows = rng.integers(0, len(outputs), len(outputs))
        parts, _ = _parts([column[rows] for column in columns], outputs[rows])
        drawn.append((parts / max(outputs[rows].std(), 1e-300)) ** 2)
    return np.asarray(np.quantile(drawn, [(1 - probability) / 2, (1 + probability) / 2], axis=0).T)


def _parts(columns: Sequence[Array], outputs: Array) -> tuple[Array, float]:
    """Standard deviation of each factor's part of the fitted additive model, and R²."""
    matrix = np.column_stack([np.ones(len(outputs)), *columns])
    coefficients = np.linalg.lstsq(matrix, outputs, rcond=None)[0]
    residual = outputs - matrix @ coefficients
    edges = np.cumsum([1, *(column.shape[1] for column in columns)])
    parts = [
        (column @ coefficients[start : start + column.shape[1]]).std()
        for column, start in zip(columns, edges[:-1], strict=True)
    ]
    variance = outputs.var()
    return np.array(parts), float(1 - residual.var() / variance) if variance > 0 else float("nan")


def regressors(values: Sequence[Any], quadratic: bool) -> Array:
    """(n, m) columns that stand for a factor in the additive model, centred and scaled."""
    if all(isinstance(value, int | float) and not isinstance(value, bool) for value in values):
        x = np.asarray(values, float)
        x = (x - x.mean()) / (x.std() or 1.0)
        many = len(np.unique(x)) > 2 and quadratic
        return np.column_stack([x, x**2 - 1]) if many else x[:, None]
    kinds = sorted(set(map(str, values)))
    return np.array([[str(value) == kind for kind in kinds[1:]] for value in values], float)


def one_at_a_time_budget(
    values: Sequence[Array], outputs: Array, levels: Sequence[int], spread_of: Callable[[int], float]
) -> list[dict[str, Any]]:
    """Sensitivity of each factor (slope through its levels) times its standard uncertainty, as GUM 5.1 combines them.

    `outputs` (1 + sum of levels,) begin with the trial in which all factors are at their median; `spread_of` tells the
    standard deviation of a factor.
    """
    rows, start = [], 1
    for j, count in enumerate(levels):
        chosen = slice(start, start + count)
        good = np.isfinite(outputs[chosen])
        x, y = values[j][chosen][good], outputs[chosen][good]
        slope = float(np.polyfit(x, y, 1)[0]) if len(x) > 1 and np.ptp(x) > 0 else float("nan")
        rows.append({"slope": slope, "uncertainty": abs(slope) * spread_of(j)})
        start += count
    combined = float(np.sqrt(np.nansum([row["uncertainty"] ** 2 for row in rows])))
    for row in rows:
        row["share"] = row["uncertainty"] ** 2 / combined**2 if combined > 0 else 0.0
    return rows
