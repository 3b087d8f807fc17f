"""Variance budgets: a regression fitted to the trials, and the share of each factor in the variance that it explains.

The trials give the coefficients of the regression; the distributions and correlations of the factors are known from the
design. A share therefore holds no correlation that the factors have in the sample by chance.

Shares are Shapley values. The variance that the terms of the factors S explain of ``y = x b`` is a quadratic form of
the coefficients, ``b' P(S) b`` with ``P(S) = C[:, S] C[S, S]⁻¹ C[S, :]`` and C the covariance of the terms. The share
of factor j is the mean gain, over all orders of the factors, when j is added (Lindeman, Merenda & Gold 1980, "LMG";
Owen 2014), which is another quadratic form. The forms of all factors add up to C.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import comb
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import fdtrc

from scancell.arrays import Array

MAX_EXACT_FACTORS = 10
_PERMUTATIONS = 256  # each is used forwards and backwards
_UNCORRELATED = 1e-12

_DRAWS = 4000
_MAX_INTERACTING = 8  # factors; the products of more take too long to attribute
_TRIALS_PER_TERM = 4  # a regression with fewer trials per term is not fitted, but the linear one
_BETTER = 0.01  # gain of the leave-one-out R² that justifies a regression with more terms
_NO_EFFECT_P = 0.01
_ROUNDING = 1e-12  # share of the variance below which a gain is rounding
_DETERMINED = 1e-9  # 1 - leverage below which a row alone determines a coefficient
_SINGULAR = 1e-10  # share of the largest singular value


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
        Seed of the sampled orders; up to `MAX_EXACT_FACTORS` factors with correlated terms all subsets are evaluated.
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


@dataclass(frozen=True)
class Terms:
    """Regressors of one factor: `linear` (n, m) of its values, `square` (n, 0 or 1) of its squared values.

    In the population all have mean 0 and variance 1, and are uncorrelated.
    """

    linear: Array
    square: Array

    @classmethod
    def of(cls, values: Sequence[Any], population: ArrayLike | None = None) -> Terms:
        """Value and square of numbers, indicators of words.

        Parameters
        ----------
        population
            Equally probable values of the factor; `values` themselves unless given.
        """
        drawn = np.asarray(values if population is None else population)
        if drawn.dtype.kind in "if":
            return cls._of_numbers(np.asarray(values, float), drawn.astype(float))
        words, counts = np.unique(drawn.astype(str), return_counts=True)
        shares = counts[1:] / counts.sum()
        indicators = np.array([[str(value) == word for word in words[1:]] for value in values], float)
        root = np.linalg.cholesky(np.diag(shares) - np.outer(shares, shares))
        return cls(np.linalg.solve(root, (indicators - shares).T).T, np.zeros((len(values), 0)))

    @classmethod
    def _of_numbers(cls, values: Array, population: Array) -> Terms:
        mean, std = population.mean(), population.std() or 1.0
        z = (population - mean) / std
        x = (values - mean) / std
        skewness = np.mean(z**3)
        scale = np.sqrt(np.mean((z**2 - 1.0 - skewness * z) ** 2))
        if min(len(np.unique(values)), len(np.unique(population))) < 3:  # a straight line goes through two values
            return cls(x[:, None], np.zeros((len(x), 0)))
        return cls(x[:, None], ((x**2 - 1.0 - skewness * x) / scale)[:, None])


@dataclass(frozen=True)
class Regression:
    """Regressors (n, p) of all factors, their covariance (p, p) in the population, and the factors of each.

    These `owners` are (j,) or, for a product, (i, j).
    """

    name: str
    matrix: Array
    covariance: Array
    owners: list[tuple[int, ...]]


def regressions(factors: Sequence[Terms], correlation: Array | None = None) -> Iterator[Regression]:
    """The linear regression, and those with squares and with products of factors that the number of trials allows.

    Parameters
    ----------
    correlation
        (factors, factors) in the population, with numbers below 1 between normally distributed factors only;
        independent factors unless given.
    """
    owner = [j for j, terms in enumerate(factors) for _ in range(terms.linear.shape[1])]
    x = np.hstack([terms.linear for terms in factors])
    between = np.eye(len(owner)) if correlation is None else correlation[np.ix_(owner, owner)]
    same_factor = np.equal.outer(owner, owner)
    between = np.where(same_factor, np.eye(len(owner)), between)

    def regression(name: str, columns: Sequence[Array], pairs: Sequence[tuple[int, int]]) -> Regression:
        matrix = np.column_stack([x, *columns])
        owners = [(j,) for j in owner] + [tuple(sorted({owner[a], owner[b]})) for a, b in pairs]
        covariance = np.zeros((len(owners), len(owners)))
        covariance[: len(owner), : len(owner)] = between
        covariance[len(owner) :, len(owner) :] = _covariance_of_products(between, pairs)
        return Regression(name, matrix, covariance, owners)

    yield regression("linear", [], [])
    squared = [(owner.index(j), terms.square) for j, terms in enumerate(factors) if terms.square.shape[1]]
    pairs, columns = [(a, a) for a, _ in squared], [square for _, square in squared]
    if len(x) < _TRIALS_PER_TERM * (len(owner) + len(pairs)):
        return
    yield regression("quadratic", columns, pairs)
    products = [(a, b) for a, b in combinations(range(len(owner)), 2) if owner[a] != owner[b]]
    if 1 < len(factors) <= _MAX_INTERACTING and len(x) >= _TRIALS_PER_TERM * (len(owner) + len(pairs) + len(products)):
        columns = [*columns, *(x[:, a] * x[:, b] for a, b in products)]
        yield regression("quadratic with interactions", columns, [*pairs, *products])


def _covariance_of_products(correlation: Array, pairs: Sequence[tuple[int, int]]) -> Array:
    """Covariance (q, q) of squares and products of pairs of normal variables; squares are scaled to variance 1.

    By Isserlis' theorem. It also holds for independent variables of other distributions.
    """
    a, b = np.array(pairs, np.intp).reshape(-1, 2).T
    across = (
        correlation[np.ix_(a, a)] * correlation[np.ix_(b, b)] + correlation[np.ix_(a, b)] * correlation[np.ix_(b, a)]
    )
    scale = np.where(a == b, np.sqrt(2.0), 1.0)
    return np.asarray(across / np.outer(scale, scale))


def variance_budget(
    factors: Sequence[Terms],
    outputs: Array,
    probability: float,
    seed: int,
    rows_per_sample: int = 1,
    correlation: Array | None = None,
) -> dict[str, Any]:
    """Share of each factor in the variance of `outputs` (n,), and what the regression leaves unexplained.

    Parameters
    ----------
    rows_per_sample
        Successive rows that depend on each other.
    correlation
        Correlation of the factors in the population, see `regressions`.

    Returns
    -------
    dict
        ``budget``: per factor ``share``, see `ShapleyForms`, and ``uncertainty`` (standard deviation that the factor
        causes), each with an interval. ``explained``: the sum of the shares; ``unexplained``: the rest, which is also
        given as ``residual`` like the factors; ``predicted``: leave-one-out R², None if undetermined; ``regression``:
        its name. Empty if the output does not vary, or with too few rows for the linear regression.
    """
    if not np.ptp(outputs) > 0:
        return {}
    fitted = {candidate.name: candidate for candidate in regressions(factors, correlation)}
    if len(outputs) < len(fitted["linear"].owners) + 2:
        return {}
    predicted = {name: leave_one_out_r2(candidate.matrix, outputs) for name, candidate in fitted.items()}
    name = next(name for name in predicted if predicted[name] >= max(predicted.values()) - _BETTER)
    chosen = fitted[name]
    forms = ShapleyForms(chosen.covariance, chosen.owners, len(factors), seed)
    rows = shares_of(fit(chosen.matrix, outputs, rows_per_sample), forms, probability, seed)
    residual = rows.pop()
    return {
        "budget": rows,
        "explained": 1.0 - residual["share"],
        "unexplained": residual["share"],
        "residual": residual,
        "predicted": predicted[name] if np.isfinite(predicted[name]) else None,
        "regression": name,
    }


@dataclass(frozen=True)
class Fit:
    """Coefficients (p,) of a regression with their covariance (p, p), variance of the residual, degrees of freedom."""

    coefficients: Array
    covariance: Array
    residual_variance: float
    degrees_of_freedom: int


def fit(matrix: Array, outputs: Array, rows_per_sample: int = 1) -> Fit:
    """Least squares with a covariance that holds for residuals of unequal variance.

    That of the jackknife (HC3 of MacKinnon & White 1985), with the sums over successive rows that depend on each other.
    """
    design = np.column_stack([np.ones(len(outputs)), matrix])
    left, sizes, right = np.linalg.svd(design, full_matrices=False)
    used = sizes > _SINGULAR * sizes[0]
    left, inverse = left[:, used], right[used].T / sizes[used]
    coefficients = inverse @ (left.T @ outputs)
    residual = outputs - design @ coefficients
    free = len(outputs) - int(used.sum())
    variance = float(residual @ residual) / free
    if variance <= (_ROUNDING * np.ptp(outputs)) ** 2:
        variance, residual = 0.0, np.zeros_like(residual)
    missing = 1.0 - (left**2).sum(1)
    # A row that alone determines a coefficient has no residual.
    without = np.where(missing > _DETERMINED, residual / np.maximum(missing, _DETERMINED), np.sqrt(variance))
    scores = ((inverse @ left.T) * without).reshape(len(inverse), -1, rows_per_sample).sum(2)
    freedom = min(free, scores.shape[1] - 1)
    return Fit(coefficients[1:], (scores @ scores.T)[1:, 1:], variance, max(freedom, 1))


def shares_of(fitted: Fit, forms: ShapleyForms, probability: float, seed: int) -> list[dict[str, Any]]:
    """``share`` and ``uncertainty`` with their intervals, of each factor and, last, of the residual.

    A factor's variance is estimated without what the uncertainty of its coefficients adds to it on average. Intervals
    are quantiles of generalised pivotal quantities (Weerahandi 1993): the root of a factor's variance moves with its
    coefficients, below 0 where these may have any sign, and the variance of the residual by its chi-squared
    distribution.
    """
    gradients = forms.gradients(fitted.coefficients)
    raw = np.maximum(gradients @ fitted.coefficients, 0.0)
    by_chance = forms.expected(fitted.covariance)
    variances = np.append(np.maximum(raw - by_chance, 0.0), fitted.residual_variance)

    rng = np.random.default_rng(seed)
    size, vectors = np.linalg.eigh(fitted.covariance)
    root = gradients @ (vectors * np.sqrt(np.maximum(size, 0.0))) / np.sqrt(np.where(raw > 0, raw, 1.0))[:, None]
    scale = rng.chisquare(fitted.degrees_of_freedom, (_DRAWS, 1)) / fitted.degrees_of_freedom
    moved = np.sqrt(raw) + rng.standard_normal((_DRAWS, root.shape[1])) @ root.T / np.sqrt(scale)
    # All coefficients of a factor but their combination along the root have added to its variance, too.
    drawn = np.sign(moved) * moved**2 - np.maximum(by_chance - (root**2).sum(1), 0.0)
    drawn = np.column_stack([np.maximum(drawn, 0.0), fitted.residual_variance / scale])
    ends = [(1 - probability) / 2, (1 + probability) / 2]
    share_ends = np.quantile(_part_of_sum(drawn), ends, axis=0)
    uncertainty_ends = np.sqrt(np.quantile(drawn, ends, axis=0))
    return [
        {
            "share": float(share),
            "share_interval": share_ends[:, j].tolist(),
            "uncertainty": float(np.sqrt(variances[j])),
            "uncertainty_interval": uncertainty_ends[:, j].tolist(),
        }
        for j, share in enumerate(_part_of_sum(variances))
    ]


def _part_of_sum(variances: Array) -> Array:
    total = variances.sum(-1, keepdims=True)
    return np.asarray(variances / np.where(total > 0, total, 1.0))


def leave_one_out_r2(matrix: Array, outputs: Array) -> float:
    """R² of predictions for each row by the regression on all other rows; it falls where terms fit noise."""
    vectors, sizes, _ = np.linalg.svd(np.column_stack([np.ones(len(outputs)), matrix]), full_matrices=False)
    basis = vectors[:, sizes > _SINGULAR * sizes[0]]
    leverage = (basis**2).sum(1)
    if leverage.max() > 1 - _DETERMINED:  # without this row a coefficient is undetermined
        return -np.inf
    residual = (outputs - basis @ (basis.T @ outputs)) / (1 - leverage)
    return float(1 - (residual**2).sum() / ((outputs - outputs.mean()) ** 2).sum())


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
