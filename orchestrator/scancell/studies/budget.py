"""Variance budgets: a regression fitted to the trials, and the share of each factor in what it explains."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from scancell.studies.shapley import shapley_shares

Array = NDArray[np.float64]

_RESAMPLES = 200
_MAX_GROUPS = 1000
_MAX_INTERACTING = 8  # factors; the products of more take too long to attribute
_TRIALS_PER_TERM = 4  # a regression with fewer trials per term is not fitted, but the linear one
_BETTER = 0.01  # gain of the leave-one-out R² that justifies a regression with more terms
_NO_EFFECT_P = 0.01
_ROUNDING = 1e-12  # share of the variance below which a gain is rounding


@dataclass(frozen=True)
class Terms:
    """Regressors of one factor, centred: `linear` (n, m) of its values, `square` (n, 0 or 1) of its squared values."""

    linear: Array
    square: Array

    @classmethod
    def of(cls, values: Sequence[Any]) -> Terms:
        """Value and square of numbers, indicators of words."""
        if all(isinstance(value, int | float) and not isinstance(value, bool) for value in values):
            x = np.asarray(values, float)
            x = (x - x.mean()) / (x.std() or 1.0)
            squared = x**2 - np.mean(x**2)
            return cls(x[:, None], squared[:, None] if len(np.unique(x)) > 2 else np.zeros((len(x), 0)))
        words = sorted(set(map(str, values)))
        indicators = np.array([[str(value) == word for word in words[1:]] for value in values], float)
        return cls(indicators - indicators.mean(0), np.zeros((len(values), 0)))


@dataclass(frozen=True)
class Regression:
    """Regressors (n, p) of all factors; `owners` has the factors of each, (j,) or, for a product, (i, j)."""

    name: str
    matrix: Array
    owners: list[tuple[int, ...]]


def regressions(factors: Sequence[Terms]) -> Iterator[Regression]:
    """The linear regression, and those with squares and with products of factors that the number of trials allows."""
    groups: dict[tuple[int, ...], Array] = {(j,): terms.linear for j, terms in enumerate(factors)}
    yield _regression("linear", groups)
    trials = len(factors[0].linear)
    groups = {(j,): np.hstack([terms.linear, terms.square]) for j, terms in enumerate(factors)}
    quadratic = _regression("quadratic", groups)
    if trials < _TRIALS_PER_TERM * len(quadratic.owners):
        return
    yield quadratic
    for i, j in combinations(range(len(factors)), 2):
        products = factors[i].linear[:, :, None] * factors[j].linear[:, None, :]
        groups[(i, j)] = products.reshape(trials, -1)
    count = sum(group.shape[1] for group in groups.values())
    if 1 < len(factors) <= _MAX_INTERACTING and trials >= _TRIALS_PER_TERM * count:
        yield _regression("quadratic with interactions", groups)


def _regression(name: str, groups: dict[tuple[int, ...], Array]) -> Regression:
    owners = [factors for factors, group in groups.items() for _ in range(group.shape[1])]
    return Regression(name, np.hstack(list(groups.values())), owners)


def variance_budget(
    factors: Sequence[Terms], outputs: Array, probability: float, seed: int, rows_per_sample: int = 1
) -> dict[str, Any]:
    """Share of each factor in the variance of `outputs` (n,), and what the regression leaves unexplained.

    Parameters
    ----------
    rows_per_sample
        Successive rows that depend on each other and are resampled together.

    Returns
    -------
    dict
        ``budget``: per factor ``share`` (Shapley value of R², see `shapley`), ``share_interval`` (percentile bootstrap;
        an end that a factor without effect reaches by chance is given as 0) and ``uncertainty`` (standard deviation
        that the factor causes). ``explained``: R², the sum of the shares; ``unexplained``: the rest;
        ``predicted``: leave-one-out R², None if undetermined; ``regression``: its name. Empty if the output does not
        vary, or with too few rows for the linear regression.
    """
    if not np.ptp(outputs) > 0:
        return {}
    fitted = {candidate.name: candidate for candidate in regressions(factors)}
    if len(outputs) < len(fitted["linear"].owners) + 2:
        return {}
    predicted = {name: leave_one_out_r2(candidate.matrix, outputs) for name, candidate in fitted.items()}
    name = next(name for name in predicted if predicted[name] >= max(predicted.values()) - _BETTER)
    chosen = fitted[name]
    correlation = _correlations(np.column_stack([chosen.matrix, outputs]), rows_per_sample, seed)
    shares, *drawn = shapley_shares(correlation, chosen.owners, len(factors), seed)
    ends = np.quantile(drawn, [(1 - probability) / 2, (1 + probability) / 2], axis=0)
    by_chance = [sum(1 / len(terms) for terms in chosen.owners if j in terms) for j in range(len(factors))]
    ends[0, ends[0] <= 2 * np.array(by_chance) / len(outputs)] = 0.0
    explained = float(shares.sum())
    return {
        "budget": [
            {
                "share": float(share),
                "share_interval": ends[:, j].tolist(),
                "uncertainty": float(np.sqrt(max(share, 0.0)) * outputs.std()),
            }
            for j, share in enumerate(shares)
        ],
        "explained": explained,
        "unexplained": 1.0 - explained,
        "predicted": predicted[name] if np.isfinite(predicted[name]) else None,
        "regression": name,
    }


def leave_one_out_r2(matrix: Array, outputs: Array) -> float:
    """R² of predictions for each row by the regression on all other rows; it falls where terms fit noise."""
    vectors, sizes, _ = np.linalg.svd(np.column_stack([np.ones(len(outputs)), matrix]), full_matrices=False)
    basis = vectors[:, sizes > 1e-10 * sizes[0]]
    leverage = (basis**2).sum(1)
    if leverage.max() > 1 - 1e-9:  # without this row a coefficient is undetermined
        return -np.inf
    residual = (outputs - basis @ (basis.T @ outputs)) / (1 - leverage)
    return float(1 - (residual**2).sum() / ((outputs - outputs.mean()) ** 2).sum())


def _correlations(columns: Array, rows_per_sample: int, seed: int) -> Array:
    """Correlation matrices (1 + b, q, q) of columns (n, q): of all rows, then of each bootstrap sample.

    A column without variance has zeros. Where there are many samples, random groups of them are resampled as one.
    """
    rng = np.random.default_rng(seed)
    samples = (columns - columns.mean(0)).reshape(-1, rows_per_sample, columns.shape[1])
    groups = np.array_split(rng.permutation(len(samples)), min(len(samples), _MAX_GROUPS))
    rows = [samples[group].reshape(-1, columns.shape[1]) for group in groups]
    counts = [np.bincount(rng.integers(0, len(rows), len(rows)), minlength=len(rows)) for _ in range(_RESAMPLES)]
    weights = np.array([np.ones(len(rows)), *counts])
    size = (weights @ [len(own) for own in rows])[:, None]
    mean = weights @ np.array([own.sum(0) for own in rows]) / size
    second = np.tensordot(weights, np.array([own.T @ own for own in rows]), 1) / size[..., None]
    covariance = second - mean[:, :, None] * mean[:, None, :]
    variance = np.diagonal(covariance, axis1=1, axis2=2)
    usable = variance > _ROUNDING * np.diagonal(second, axis1=1, axis2=2) + _ROUNDING**2 * (columns**2).mean(0)
    scale = np.where(usable, 1.0, 0.0) / np.sqrt(np.where(usable, variance, 1.0))
    return np.asarray(covariance * scale[:, :, None] * scale[:, None, :])


def undetected_factors(factors: Sequence[Terms], figures: Sequence[Array]) -> list[int]:
    """Factors without a significant effect on any of the figures (n,): F-tests of the regression without their terms.

    The level is that of Bonferroni over the figures. Empty with fewer than two rows per term.
    """
    *_, chosen = regressions(factors)
    varying = [values for values in figures if np.ptp(values) > 0]
    free = len(factors[0].linear) - np.linalg.matrix_rank(chosen.matrix) - 1
    if free < max(1, len(chosen.owners)):
        return []
    outputs = np.column_stack(varying) if varying else np.zeros((len(factors[0].linear), 0))
    total = ((outputs - outputs.mean(0)) ** 2).sum(0)
    residual = _residual(chosen.matrix, outputs)
    undetected = []
    for factor in range(len(factors)):
        kept = [c for c, terms in enumerate(chosen.owners) if factor not in terms]
        gain = _residual(chosen.matrix[:, kept], outputs) - residual
        terms = len(chosen.owners) - len(kept)
        real = gain > _ROUNDING * total
        ratio = np.where(real, gain / terms / np.maximum(residual / free, 1e-300 + 1e-30 * total), 0.0)
        if not np.any(fdtrc(terms, free, ratio) * len(varying) < _NO_EFFECT_P):
            undetected.append(factor)
    return undetected


def _residual(matrix: Array, outputs: Array) -> Array:
    """Sums (f,) of the squared residuals of outputs (n, f)."""
    design = np.column_stack([np.ones(len(outputs)), matrix])
    coefficients = np.linalg.lstsq(design, outputs, rcond=None)[0]
    return np.asarray(((outputs - design @ coefficients) ** 2).sum(0))
