"""Shapley values: the share of each factor in the variance that a regression explains.

The variance that the terms of the factors S explain of ``y = x b`` is a quadratic form of the coefficients,
``b' P(S) b`` with ``P(S) = C[:, S] C[S, S]⁻¹ C[S, :]`` and C the covariance of the terms. The share of factor j is the
mean, over all orders of the factors, of what is gained when j is added (Lindeman, Merenda & Gold 1980, "LMG"; Owen
2014), so another quadratic form. The forms of all factors add up to C.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import comb

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MAX_EXACT_FACTORS = 10
_PERMUTATIONS = 256  # each is used forwards and backwards
_UNCORRELATED = 1e-12
_SINGULAR = 1e-10


@dataclass(frozen=True)
class _Part:
    """Terms `columns` (c,) that are correlated with no others, and the forms (f, c, c) of their `factors` (f,)."""

    columns: NDArray[np.intp]
    factors: NDArray[np.intp]
    forms: Array


class ShapleyForms:
    """Quadratic forms of the shares.

    Parameters
    ----------
    covariance
        (p, p) of the terms.
    owners
        The factors (rising) of each term: (j,) or, for a product, (i, j); it counts once all of them are in S.
    factors
        Number of factors.
    seed
        Of the sampled orders; up to `MAX_EXACT_FACTORS` factors with correlated terms all subsets are evaluated.
    """

    def __init__(self, covariance: Array, owners: Sequence[tuple[int, ...]], factors: int, seed: int = 0) -> None:
        from scipy.sparse.csgraph import connected_components  # noqa: PLC0415  (slow to import)

        count, labels = connected_components(np.abs(covariance) > _UNCORRELATED, directed=False)
        order = np.argsort(labels, kind="stable")
        groups = np.split(order, np.flatnonzero(np.diff(labels[order])) + 1) if count else []
        self._shape = (factors, len(owners))
        self._parts = [_part(covariance[np.ix_(own, own)], own, owners, seed) for own in groups]

    def gradients(self, coefficients: Array) -> Array:
        """Half the derivative (factors, p) of each share by the coefficients (p,); times these, the shares."""
        found = np.zeros(self._shape)
        for part in self._parts:
            found[np.ix_(part.factors, part.columns)] = part.forms @ coefficients[part.columns]
        return found

    def expected(self, covariance: Array) -> Array:
        """Expected shares (factors,) of coefficients with mean 0 and this covariance (p, p)."""
        found = np.zeros(self._shape[0])
        for part in self._parts:
            found[part.factors] += (part.forms * covariance[np.ix_(part.columns, part.columns)]).sum((1, 2))
        return found


def _part(covariance: Array, columns: NDArray[np.intp], owners: Sequence[tuple[int, ...]], seed: int) -> _Part:
    players = sorted({factor for column in columns for factor in owners[column]})
    needed = np.array([sum(1 << players.index(factor) for factor in owners[column]) for column in columns])

    def explained(subset: int) -> Array:
        chosen = np.flatnonzero((needed & subset) == needed)
        across = covariance[:, chosen]
        return np.asarray(across @ np.linalg.pinv(across[chosen], _SINGULAR, True) @ across.T)

    forms = np.zeros((len(players), *covariance.shape))
    if len(players) <= MAX_EXACT_FACTORS:
        for subset in range(1, 2 ** len(players)):
            gain, size = explained(subset), subset.bit_count()
            for player in range(len(players)):
                if subset >> player & 1:
                    forms[player] += gain / (len(players) * comb(len(players) - 1, size - 1))
                else:
                    forms[player] -= gain / (len(players) * comb(len(players) - 1, size))
        return _Part(columns, np.array(players), forms)
    rng = np.random.default_rng(seed)
    forwards = [rng.permutation(len(players)).tolist() for _ in range(_PERMUTATIONS)]
    for order in [*forwards, *(order[::-1] for order in forwards)]:
        subset, before = 0, np.zeros_like(covariance)
        for player in order:
            subset |= 1 << player
            after = explained(subset)
            forms[player] += (after - before) / (2 * _PERMUTATIONS)
            before = after
    return _Part(columns, np.array(players), forms)
