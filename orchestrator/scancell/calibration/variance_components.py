"""Noise of calibration data: errors of measurements, and errors that all measurements of an exposure share.

The size of each is a variance component, found by restricted maximum likelihood (REML; Patterson & Thompson 1971).
Every exposure enters by the second moments of its measurements alone, so that the cost does not depend on their number.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scancell.arrays import Array
from scancell.geometry.least_squares import NormalEquations, without

# Bounds of logarithms of variances: of measurements relative to the stated one, and of modes in their units.
_BOUNDS_OF_GROUPS = (-12.0, 12.0)
_BOUNDS_OF_MODES = (2 * np.log(1e-9), 2 * np.log(1e3))
_FARTHEST = 18.0  # of the search from its start; variances without a limit make the equations singular
_STEP = 0.05  # of logarithms of variances, for the curvature of the likelihood
_FLAT = 1e-6  # share of the largest curvature: a variance near 0 has none, and no effect
_LEAST_CURVATURE = 1e-6  # share of the information on a displacement alone: a straight profile leaves less


@dataclass(frozen=True)
class Moments:
    """Linearised residuals of n exposures: ``r = -design @ x + modes @ error + noise``.

    Attributes
    ----------
    second
        (g, n, k + 1, k + 1) sums over the measurements of each group of the products of (k regressors, residual),
        weighted by inverse variances; a group has a noise of its own, such as points, or corners and stripes.
    design
        (n, k, p) regressors as multiples of the p unknowns.
    modes
        For each kind of shared error (n, k, d), as multiples of the regressors.
    count
        (g,) number of measurements.
    """

    second: Array
    design: Array
    modes: tuple[Array, ...]
    count: NDArray[np.intp]

    @staticmethod
    def of_exposures(rows: Array, frame: NDArray[np.intp], count: int) -> Array:
        """Second moments (n, k + 1, k + 1) of weighted rows (m, k + 1), each of an exposure `frame` (m,) of `count`."""
        order = np.argsort(frame, kind="stable")
        parts = np.split(rows[order], np.searchsorted(frame[order], np.arange(1, count)))
        return np.stack([part.T @ part for part in parts])

    def by_basis(self, basis: Array) -> Moments:
        """The moments of unknowns (r,) of which the p unknowns are multiples, `basis` (p, r)."""
        return replace(self, design=self.design @ basis)


@dataclass(frozen=True)
class Weighted:
    """Second moments weighted by the whole covariance: the shared errors are eliminated by the Woodbury identity.

    Attributes
    ----------
    second
        (n, k + 1, k + 1), as those of `Moments`, of all groups.
    by_mode
        (n, d, k + 1) products of the modes of all kinds, times their standard deviations, with regressors and residual.
    modes
        (n, k, d) modes of all kinds, times their standard deviations.
    inner
        (n, d, d) inverse of the covariance of the shared errors, in their standard deviations, for known unknowns.
    kind
        (d,) kind of each mode.
    log_determinant
        Logarithm of the covariance's determinant.
    """

    second: Array
    by_mode: Array
    modes: Array
    inner: Array
    kind: NDArray[np.intp]
    log_determinant: float


@dataclass(frozen=True)
class Estimate:
    """Generalised least squares at the most likely variances.

    Attributes
    ----------
    covariance
        (p, p) of the unknowns.
    log_variances
        (g + kinds,) logarithms of the variances of each group of measurements and of each kind of mode.
    uncertainty
        (g + kinds, g + kinds) covariance of these logarithms.
    slopes
        (g + kinds, p, p) derivatives of the covariance by these logarithms.
    """

    covariance: Array
    log_variances: Array
    uncertainty: Array
    slopes: Array

    def degrees_of_freedom(self, variances: Array, slopes: Array) -> Array:
        """Degrees of freedom (q,) of variances (q,) with derivatives (g + kinds, q).

        Satterthwaite's approximation: ``2 v² / var(v)``.
        """
        spread = np.einsum("kq,kl,lq->q", slopes, self.uncertainty, slopes)
        return np.asarray(np.clip(2.0 * variances**2 / np.maximum(spread, 1e-30 * variances**2), 1.0, None))

    def of_values(self, derivative: Array) -> tuple[Array, Array]:
        """Variances (q,) of values with a `derivative` (q, p) by the unknowns, and their degrees of freedom."""
        variances = np.einsum("qi,ij,qj->q", derivative, self.covariance, derivative)
        slopes = np.einsum("qi,kij,qj->kq", derivative, self.slopes, derivative, optimize=True)
        return variances, self.degrees_of_freedom(variances, slopes)

    def half_widths(self, derivative: Array, probability: float = 0.95) -> Array:
        """Half widths (q,) of the intervals of such values that contain the true ones with `probability`."""
        variances, degrees = self.of_values(derivative)
        return half_widths(np.sqrt(variances), degrees, probability)


def half_widths(standard_deviations: Array, degrees_of_freedom: Array, probability: float) -> Array:
    """Half widths of the intervals about estimates that contain the true values with `probability` each.

    By Student's distribution with the degrees of freedom of the variances, of the same shape.
    """
    from scipy.special import stdtrit  # noqa: PLC0415  (slow to import)

    return np.asarray(stdtrit(degrees_of_freedom, 0.5 + probability / 2) * standard_deviations)


def estimate(moments: Moments) -> Estimate:
    """Generalised least squares at the variances that maximise the restricted likelihood.

    The search starts at `equal_shares`.
    """
    from scipy.optimize import minimize  # noqa: PLC0415  (half a second)

    start, (lowest, highest) = equal_shares(moments), _bounds(moments)
    bounds = np.column_stack([np.maximum(lowest, start - _FARTHEST), np.minimum(highest, start + _FARTHEST / 2)])
    found = minimize(
        lambda t: _criterion(moments, t), start, jac=True, method="L-BFGS-B", bounds=bounds,
        options={"ftol": 1e-15, "gtol": 1e-7, "maxiter": 500},
    )  # fmt: skip
    log_variances = np.asarray(found.x)
    steps = _STEP * np.eye(len(start))
    slopes = [_criterion(moments, log_variances + s)[1] - _criterion(moments, log_variances - s)[1] for s in steps]
    curvature = np.array(slopes) / (2 * _STEP)
    values, vectors = np.linalg.eigh((curvature + curvature.T) / 2)
    inverse = np.where(values > _FLAT * values[-1], 2.0 / np.maximum(values, 1e-300), 0.0)
    covariance = np.asarray(np.linalg.inv(normal_equations(moments, log_variances).information), float)
    return Estimate(
        covariance,
        log_variances,
        (vectors * inverse) @ vectors.T,
        covariance_slopes(covariance, information_slopes(moments, log_variances).sum(1)),
    )


def equal_shares(moments: Moments) -> Array:
    """Logarithms (g + kinds,) of the variances at which measurements and each kind of mode explain equal shares."""
    k, kinds = moments.design.shape[1], len(moments.modes)
    squares = moments.second[:, :, k, k].sum(1) / (1 + kinds)
    inner = moments.second[:, :, :k, :k].sum(0)
    effects = [np.einsum("nkd,nkl,nld->", mode, inner, mode) for mode in moments.modes]
    shares = np.concatenate([squares, np.full(kinds, squares.sum())])
    variances = shares / np.maximum([*moments.count, *effects], 1e-300)
    return np.asarray(np.clip(np.log(np.maximum(variances, 1e-300)), *_bounds(moments)))


def _bounds(moments: Moments) -> tuple[Array, Array]:
    lowest, highest = np.transpose(
        [*[_BOUNDS_OF_GROUPS] * len(moments.count), *[_BOUNDS_OF_MODES] * len(moments.modes)]
    )
    return lowest, highest


def information_slopes(moments: Moments, log_variances: Array) -> Array:
    """Derivatives (g + kinds, n, p, p) of the information from each exposure by the logarithms of the variances.

    All variances together scale the information, which gives that of the last group.
    """
    weighted = weighted_by(moments, log_variances)
    k, last = moments.design.shape[1], len(moments.count) - 1
    by_mode = weighted.by_mode[:, :, :k] @ moments.design
    rest = moments.design - weighted.modes @ by_mode
    of_groups = np.einsum("nkp,gnkl,nlq->gnpq", rest, moments.second[:last, :, :k, :k], rest, optimize=True)
    of_groups *= np.exp(-log_variances[:last])[:, None, None, None]
    each = [by_mode[:, weighted.kind == kind] for kind in range(len(moments.modes))]
    others = np.concatenate([of_groups, *((one.swapaxes(1, 2) @ one)[None] for one in each)])
    return -np.insert(others, last, informations(moments, log_variances) - others.sum(0), axis=0)


def covariance_slopes(covariance: Array, slopes: Array) -> Array:
    """Derivatives (g + kinds, p, p) of a covariance by the logarithms of the variances, from those of its inverse."""
    return np.asarray(-covariance @ slopes @ covariance)


def informations(moments: Moments, log_variances: Array) -> Array:
    """Information (n, p, p) on the unknowns from each exposure."""
    k = moments.design.shape[1]
    second = weighted_by(moments, log_variances).second
    return np.asarray(moments.design.swapaxes(1, 2) @ second[:, :k, :k] @ moments.design)


def weighted_by(moments: Moments, log_variances: Array) -> Weighted:
    """Second moments weighted by the covariance of measurements and shared errors."""
    groups, (n, k) = len(moments.count), moments.design.shape[:2]
    second = np.tensordot(np.exp(-log_variances[:groups]), moments.second, 1)
    deviations = np.exp(0.5 * log_variances[groups:])
    each = [mode * deviation for mode, deviation in zip(moments.modes, deviations, strict=True)]
    modes = np.concatenate([np.zeros((n, k, 0)), *each], -1)
    across = second[:, :, :k] @ modes
    inner = np.eye(modes.shape[-1]) + modes.swapaxes(1, 2) @ across[:, :k]
    by_mode = np.linalg.solve(inner, across.swapaxes(1, 2))
    kind = np.repeat(np.arange(len(each)), [mode.shape[-1] for mode in each])
    log_determinant = float(moments.count @ log_variances[:groups]) + float(np.linalg.slogdet(inner)[1].sum())
    return Weighted(second - across @ by_mode, by_mode, modes, inner, kind, log_determinant)


def normal_equations(moments: Moments, log_variances: Array) -> NormalEquations:
    """Normal equations of the unknowns, the shared errors eliminated; see `Estimate` for `log_variances`."""
    return equations_of(moments, weighted_by(moments, log_variances))


def equations_of(moments: Moments, weighted: Weighted) -> NormalEquations:
    """Normal equations of the unknowns by weighted moments."""
    k, second = moments.design.shape[1], weighted.second
    by_unknown = moments.design.swapaxes(1, 2) @ second[:, :k]
    information = (by_unknown[:, :, :k] @ moments.design).sum(0)
    squares = float(second[:, k, k].sum())
    return NormalEquations(information, -by_unknown[:, :, k].sum(0), squares, squares)


def equations_at(
    moments: Moments, squares: Array, errors: Array, log_variances: Array
) -> tuple[NormalEquations, Callable[[Array], Array]]:
    """Normal equations about given shared errors, for `minimise`; and these errors (n, d) after a step of the unknowns.

    Parameters
    ----------
    moments
        About the unknowns and the errors; its residuals are those without errors, to first order.
    squares
        (g,) sums of squares of the residuals with the errors, weighted as the moments.
    errors
        (n, d) as multiples of the modes; (n, 0) for none.
    """
    weighted, groups = weighted_by(moments, log_variances), len(moments.count)
    inverse = np.exp(-log_variances[groups:])[weighted.kind]
    total = float(squares @ np.exp(-log_variances[:groups]))
    if errors.shape[1]:
        total += float(np.sum(errors**2 * inverse))

    def errors_after(step: Array) -> Array:
        rest = weighted.by_mode[:, :, -1] + weighted.by_mode[:, :, :-1] @ moments.design @ step
        return np.asarray(rest / np.sqrt(inverse))

    return replace(equations_of(moments, weighted), squares=total), errors_after


def _criterion(moments: Moments, log_variances: Array) -> tuple[float, Array]:
    """Minus twice the logarithm of the restricted likelihood, up to a constant, and its gradient (g + kinds,).

    That of a variance is its trace in the projected covariance minus the square of the projected residual (Harville
    1977).
    """
    weighted, groups = weighted_by(moments, log_variances), len(moments.count)
    normal = equations_of(moments, weighted)
    covariance = np.asarray(np.linalg.inv(normal.information), float)
    x = covariance @ normal.gradient
    squares = normal.squares - float(normal.gradient @ x)
    value = weighted.log_determinant + float(np.linalg.slogdet(normal.information)[1]) + squares
    by_unknown = weighted.by_mode[:, :, :-1] @ moments.design
    trace = np.einsum("ndk,nkd->d", weighted.by_mode[:, :, :-1], weighted.modes)
    trace -= np.einsum("ndp,pq,ndq->d", by_unknown, covariance, by_unknown, optimize=True)
    error = weighted.by_mode[:, :, -1] + by_unknown @ x
    of_modes = np.bincount(weighted.kind, trace - (error**2).sum(0), len(moments.modes))
    of_groups = _of_groups(moments, weighted, log_variances, covariance, x) if groups > 1 else np.zeros(0)
    # All variances together are a scale, which tells that of the last group without cancellation.
    last = moments.count.sum() - len(x) - squares - of_modes.sum() - of_groups.sum()
    return value, np.concatenate([of_groups, [last], of_modes])


def _of_groups(moments: Moments, weighted: Weighted, log_variances: Array, covariance: Array, x: Array) -> Array:
    """Gradient (g - 1,) of the criterion by the logarithms of the variances of all groups but the last."""
    by_unknown = weighted.by_mode[:, :, :-1] @ moments.design
    error = weighted.by_mode[:, :, -1] + by_unknown @ x
    # Residuals of the measurements are the regressors times `rest`, with covariance `spread`.
    rest = moments.design @ x - np.einsum("nkd,nd->nk", weighted.modes, error)
    rest = np.column_stack([rest, np.ones(len(rest))])
    design = moments.design - weighted.modes @ by_unknown
    spread = design @ covariance @ design.swapaxes(1, 2)
    spread += weighted.modes @ np.linalg.solve(weighted.inner, weighted.modes.swapaxes(1, 2))
    second = moments.second[:-1]
    spent = np.einsum("gnkl,nlk->g", second[:, :, :-1, :-1], spread)
    left = np.einsum("gnkl,nk,nl->g", second, rest, rest, optimize=True)
    return np.asarray(moments.count[:-1] - (spent + left) * np.exp(-log_variances[: len(second)]))


@dataclass(frozen=True)
class LeftOut:
    """Displacements of what exposures show from where the other exposures predict it.

    Attributes
    ----------
    exposure
        (n,) row of each exposure that determines its displacement.
    displacement
        (n, q) measured minus predicted: of the centre of a circle along y and z of the sensor, m, for example.
    standard_deviation, degrees_of_freedom
        (n, q) of the displacement to be expected, and of its variance.
    """

    exposure: NDArray[np.intp]
    displacement: Array
    standard_deviation: Array
    degrees_of_freedom: Array

    def half_widths(self, probability: float = 0.95) -> Array:
        """Half widths (n, q) of the intervals about 0 that contain the displacements with `probability` each."""
        return half_widths(self.standard_deviation, self.degrees_of_freedom, probability)

    def rows(self, probability: float) -> Iterator[tuple[int, Array, Array]]:
        """Row, displacement (q,) and half widths (q,) of each exposure."""
        return zip(self.exposure.tolist(), self.displacement, self.half_widths(probability), strict=True)


def left_out(moments: Moments, fit: Estimate, by_displacement: Array, count: int) -> LeftOut:
    """The displacement of each exposure, by one linear step from the fit of all.

    Parameters
    ----------
    by_displacement
        (n, k, q) regressors as multiples of the displacements sought, which come first, and of others that are fitted
        with them, such as an offset of a profile along its normals, by which a circle keeps its centre.
    count
        Number of displacements sought.
    """
    k, p = moments.design.shape[1:]
    groups = len(moments.count)
    weighted = weighted_by(moments, fit.log_variances)
    normal = equations_of(moments, weighted)
    own, own_slopes = informations(moments, fit.log_variances), information_slopes(moments, fit.log_variances)
    gradient = -(moments.design.swapaxes(1, 2) @ weighted.second[:, :k, k:])[:, :, 0]
    each = moments.second * np.exp(-fit.log_variances[:groups])[:, None, None, None]
    rows, found = [], []
    for i, second in enumerate(each.sum(0)):
        across = by_displacement[i].T @ second[:k]
        inner = across[:, :k] @ by_displacement[i]
        length = np.sqrt(np.maximum(np.diag(inner), 1e-300))
        scaled = inner / np.outer(length, length)
        if not np.linalg.eigvalsh(without(scaled, count))[0] > _LEAST_CURVATURE:
            continue
        rest = normal.information - own[i]
        if np.linalg.matrix_rank(rest, hermitian=True) < p:
            continue
        covariance = np.linalg.inv(rest)
        x = covariance @ (normal.gradient - gradient[i])
        inverse = (np.linalg.pinv(scaled, hermitian=True) / np.outer(length, length))[:count]
        by_regressor = inverse @ across
        by_unknown = by_regressor[:, :k] @ moments.design[i]
        displacement = by_regressor[:, k] + by_unknown @ x
        by_mode = (by_regressor[:, :k] @ weighted.modes[i]) ** 2
        of_modes = np.array([by_mode[:, weighted.kind == kind].sum(1) for kind in range(len(moments.modes))])
        of_groups = [
            np.diag(inverse @ by_displacement[i].T @ group[i, :k, :k] @ by_displacement[i] @ inverse.T)
            for group in each
        ]
        of_noise = np.concatenate([of_groups, of_modes.reshape(-1, count)])
        slopes = covariance_slopes(covariance, own_slopes.sum(1) - own_slopes[:, i])
        slopes = np.einsum("ap,kpq,aq->ka", by_unknown, slopes, by_unknown) + of_noise
        variance = np.einsum("ap,pq,aq->a", by_unknown, covariance, by_unknown) + of_noise.sum(0)
        rows.append(i)
        found.append([displacement, np.sqrt(variance), fit.degrees_of_freedom(variance, slopes)])
    arrays = np.array(found).reshape(-1, 3, count)
    return LeftOut(np.array(rows, np.intp), arrays[:, 0], arrays[:, 1], arrays[:, 2])
