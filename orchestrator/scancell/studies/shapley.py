"""Shapley values of R²: the share of each factor in the variance that a linear regression explains.

With v(S) the R² of the regression on the terms of the factors S alone, the share of factor j is the mean, over all
orders of the factors, of what R² gains when j is added (Lindeman, Merenda & Gold 1980, "LMG"; for independent factors
the Shapley effects of Owen 2014). Shares are not negative and add up to the R² of all factors, correlated or not.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import comb

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MAX_EXACT_FACTORS = 10
_PERMUTATIONS = 256  # each is used forwards and backwards
_PIVOT = 1e-9  # share of a term's variance below which the earlier terms determine it
_BATCH_BYTES = 64e6


def shapley_shares(correlation: Array, owners: Sequence[tuple[int, ...]], factors: int, seed: int) -> Array:
    """Shares (b, factors) of the variance of an output.

    Parameters
    ----------
    correlation
        (b, p + 1, p + 1) correlation matrices of p regressors and, last, the output; a regressor without variance has
        zeros.
    owners
        The factors (rising) of each regressor: (j,) or, for a product, (i, j); a regressor counts once all are in S.
    seed
        Of the sampled orders; with at most `MAX_EXACT_FACTORS` factors all subsets are evaluated.
    """
    if factors > MAX_EXACT_FACTORS:
        return _by_orders(correlation, owners, factors, seed)
    order = sorted(range(len(owners)), key=lambda c: owners[c][-1])
    columns = [*order, len(owners)]
    sorted_owners = [owners[c] for c in order]
    size = max(1, int(_BATCH_BYTES / (2**factors * 8 * (factors + 2) ** 2)))
    parts = [
        _by_subsets(correlation[start : start + size][:, columns][:, :, columns], sorted_owners, factors)
        for start in range(0, len(correlation), size)
    ]
    return np.concatenate(parts)


def _by_subsets(correlation: Array, owners: list[tuple[int, ...]], factors: int) -> Array:
    """All subsets at once: factor by factor, the matrices of the subsets with and without it, its terms eliminated."""
    matrices = correlation[None]  # (subsets, b, columns left, columns left); bit j of the index: factor j is in S
    for factor in range(factors):
        count = sum(terms[-1] == factor for terms in owners)
        owners = owners[count:]
        without = matrices[..., count:, count:].copy()
        products = [c for c, terms in enumerate(owners) if factor in terms]
        without[..., products, :] = 0.0
        without[..., :, products] = 0.0
        for _ in range(count):
            matrices = _eliminated(matrices)
        matrices = np.concatenate([without, matrices])
    explained = 1.0 - matrices[..., 0, 0]  # (2^factors, b)
    subsets = np.arange(2**factors)
    sizes = np.array([int(subset).bit_count() for subset in subsets])
    shares = []
    for factor in range(factors):
        before = subsets[subsets >> factor & 1 == 0]
        weight = 1.0 / (factors * np.array([comb(factors - 1, size) for size in sizes[before]]))
        shares.append(weight @ (explained[before | 1 << factor] - explained[before]))
    return np.stack(shares, 1)


def _eliminated(matrices: Array) -> Array:
    """Residual matrices after regression on the first column, which is dropped, unless it has no variance."""
    pivot = matrices[..., 0, 0]
    usable = pivot > _PIVOT
    scale = np.where(usable, 1.0, 0.0) / np.where(usable, pivot, 1.0)
    row = matrices[..., 0, 1:]
    return np.asarray(matrices[..., 1:, 1:] - (row * scale[..., None])[..., :, None] * row[..., None, :])


def _by_orders(correlation: Array, owners: Sequence[tuple[int, ...]], factors: int, seed: int) -> Array:
    """Mean over random orders, each also reversed: the last row of a Cholesky factor holds the gains of R²."""
    rng = np.random.default_rng(seed)
    forwards = [rng.permutation(factors) for _ in range(_PERMUTATIONS)]
    shares = np.zeros((len(correlation), factors))
    ridge = _PIVOT * np.eye(len(owners) + 1)
    for order in [*forwards, *(order[::-1] for order in forwards)]:
        rank = np.argsort(order)
        last = np.array([max(terms, key=lambda factor: rank[factor]) for terms in owners])
        columns = np.argsort(rank[last], kind="stable")
        placed = [*columns.tolist(), len(owners)]
        gains = np.linalg.cholesky(correlation[:, placed][:, :, placed] + ridge)[:, -1, :-1] ** 2
        for column, factor in enumerate(last[columns]):
            shares[:, factor] += gains[:, column]
    return np.asarray(shares / (2 * _PERMUTATIONS))
