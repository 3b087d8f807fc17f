"""Noise of calibration data: errors of points, and errors that all points of an exposure share.

The size of each is a variance component, found by restricted maximum likelihood (REML; Patterson & Thompson 1971).
Every exposure enters by the second moments of its points alone, so that the cost does not depend on their number.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scancell.calibration.least_squares import NormalEquations

Array = NDArray[np.float64]

# Bounds of logarithms of variances: of points relative to the stated one; of modes, 1 nm or nrad to 1 m or rad.
_BOUNDS_OF_POINTS = (-12.0, 12.0)
_BOUNDS_OF_MODES = (2 * np.log(1e-9), 0.0)
_FARTHEST = 18.0  # of the search from its start; variances without a limit make the equations singular
_STEP = 0.05  # of logarithms of variances, for the curvature of the likelihood
_FLAT = 1e-6  # share of the largest curvature: a variance near 0 has none, and no effect


@dataclass(frozen=True)
class Moments:
    """Linearised residuals of n exposures: ``r = -design @ x + modes @ error + noise``.

    Attributes
    ----------
    second
        (n, k + 1, k + 1) sums over points of the products of (k regressors, residual), weighted by inverse variances.
    design
        (n, k, p) regressors as multiples of the p unknowns.
    modes
        For each kind of shared error (n, k, d), as multiples of the regressors.
    points
        Number of points.
    """

    second: Array
    design: Array
    modes: tuple[Array, ...]
    points: int


@dataclass(frozen=True)
class Weighted:
    """Second moments weighted by the whole covariance: the shared errors are eliminated by the Woodbury identity.

    Attributes
    ----------
    second
        (n, k + 1, k + 1), as those of `Moments`.
    by_mode
        (n, d, k + 1) products of the modes of all kinds, times their standard deviations, with regressors and residual.
    modes
        (n, k, d) modes of all kinds, times their standard deviations.
    kind
        (d,) kind of each mode.
    log_determinant
        Logarithm of the covariance's determinant.
    """

    second: Array
    by_mode: Array
    modes: Array
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
        (1 + kinds,) logarithms of the variances of points and of each kind of mode.
    uncertainty
        (1 + kinds, 1 + kinds) covariance of these logarithms.
    slopes
        (1 + kinds, p, p) derivatives of the covariance by these logarithms.
    """

    covariance: Array
    log_variances: Array
    uncertainty: Array
    slopes: Array

    def degrees_of_freedom(self, variances: Array, slopes: Array) -> Array:
        """Degrees of freedom (q,) of variances (q,) with derivatives (1 + kinds, q).

        Satterthwaite's approximation: ``2 v² / var(v)``.
        """
        spread = np.einsum("kq,kl,lq->q", slopes, self.uncertainty, slopes)
        return np.asarray(np.clip(2.0 * variances**2 / np.maximum(spread, 1e-30 * variances**2), 1.0, None))


def estimate(moments: Moments) -> Estimate:
    """Generalised least squares at the variances that maximise the restricted likelihood.

    The search starts at `equal_shares`.
    """
    from scipy.optimize import minimize  # noqa: PLC0415  (half a second)

    kinds, start = len(moments.modes), equal_shares(moments)
    lowest, highest = np.transpose([_BOUNDS_OF_POINTS, *[_BOUNDS_OF_MODES] * kinds])
    bounds = np.column_stack([np.maximum(lowest, start - _FARTHEST), np.minimum(highest, start + _FARTHEST / 2)])
    found = minimize(
        lambda t: _criterion(moments, t), start, jac=True, method="L-BFGS-B", bounds=bounds,
        options={"ftol": 1e-15, "gtol": 1e-7, "maxiter": 500},
    )  # fmt: skip
    log_variances = np.asarray(found.x)
    steps = _STEP * np.eye(1 + kinds)
    slopes = [_criterion(moments, log_variances + s)[1] - _criterion(moments, log_variances - s)[1] for s in steps]
    curvature = np.array(slopes) / (2 * _STEP)
    values, vectors = np.linalg.eigh((curvature + curvature.T) / 2)
    inverse = np.where(values > _FLAT * values[-1], 2.0 / np.maximum(values, 1e-300), 0.0)
    covariance = np.asarray(np.linalg.inv(normal_equations(moments, log_variances).information), float)
    return Estimate(
        covariance,
        log_variances,
        (vectors * inverse) @ vectors.T,
        covariance_slopes(covariance, shares(moments, log_variances).sum(1)),
    )


def equal_shares(moments: Moments) -> Array:
    """Logarithms (1 + kinds,) of the variances at which points and each kind of mode explain equal shares."""
    k, kinds = moments.design.shape[1], len(moments.modes)
    squares = float(moments.second[:, k, k].sum()) / (1 + kinds)
    effects = [np.einsum("nkd,nkl,nld->", mode, moments.second[:, :k, :k], mode) for mode in moments.modes]
    variances = squares / np.maximum([moments.points, *effects], 1e-300)
    lowest, highest = np.transpose([_BOUNDS_OF_POINTS, *[_BOUNDS_OF_MODES] * kinds])
    return np.clip(np.log(np.maximum(variances, 1e-300)), lowest, highest)


def shares(moments: Moments, log_variances: Array) -> Array:
    """Derivatives (kinds, n, p, p) of the information from each exposure by the logarithms of the modes' variances."""
    weighted = weighted_by(moments, log_variances)
    by_mode = weighted.by_mode[:, :, :-1] @ moments.design
    each = [by_mode[:, weighted.kind == kind] for kind in range(len(moments.modes))]
    p = moments.design.shape[-1]
    return np.array([-one.swapaxes(1, 2) @ one for one in each]).reshape(-1, len(moments.second), p, p)


def covariance_slopes(covariance: Array, information_slopes: Array) -> Array:
    """Derivatives (1 + kinds, p, p) of a covariance by logarithms of variances, from those of the information by modes.

    All variances together scale the covariance.
    """
    by_modes = -covariance @ information_slopes @ covariance
    return np.concatenate([(covariance - by_modes.sum(0))[None], by_modes])


def informations(moments: Moments, log_variances: Array) -> Array:
    """Information (n, p, p) on the unknowns from each exposure."""
    k = moments.design.shape[1]
    second = weighted_by(moments, log_variances).second
    return np.asarray(moments.design.swapaxes(1, 2) @ second[:, :k, :k] @ moments.design)


def weighted_by(moments: Moments, log_variances: Array) -> Weighted:
    """Second moments weighted by the covariance of points and shared errors."""
    second = moments.second * np.exp(-log_variances[0])
    n, k = moments.design.shape[:2]
    deviations = np.exp(0.5 * log_variances[1:])
    each = [mode * deviation for mode, deviation in zip(moments.modes, deviations, strict=True)]
    modes = np.concatenate([np.zeros((n, k, 0)), *each], -1)
    across = second[:, :, :k] @ modes
    inner = np.eye(modes.shape[-1]) + modes.swapaxes(1, 2) @ across[:, :k]
    by_mode = np.linalg.solve(inner, across.swapaxes(1, 2))
    kind = np.repeat(np.arange(len(each)), [mode.shape[-1] for mode in each])
    log_determinant = moments.points * float(log_variances[0]) + float(np.linalg.slogdet(inner)[1].sum())
    return Weighted(second - across @ by_mode, by_mode, modes, kind, log_determinant)


def normal_equations(moments: Moments, log_variances: Array) -> NormalEquations:
    """Those of the unknowns, the shared errors eliminated; see `Estimate` for `log_variances`."""
    return equations_of(moments, weighted_by(moments, log_variances))


def equations_of(moments: Moments, weighted: Weighted) -> NormalEquations:
    """Normal equations of the unknowns by weighted moments."""
    k, second = moments.design.shape[1], weighted.second
    by_unknown = moments.design.swapaxes(1, 2) @ second[:, :k]
    information = (by_unknown[:, :, :k] @ moments.design).sum(0)
    squares = float(second[:, k, k].sum())
    return NormalEquations(information, -by_unknown[:, :, k].sum(0), squares, squares)


def _criterion(moments: Moments, log_variances: Array) -> tuple[float, Array]:
    """Minus twice the logarithm of the restricted likelihood, up to a constant, and its gradient (1 + kinds,).

    That of a mode is the trace of its projected covariance minus the square of its projected residual (Harville 1977);
    that of the points follows from the scale of all variances together.
    """
    weighted = weighted_by(moments, log_variances)
    normal = equations_of(moments, weighted)
    covariance = np.linalg.inv(normal.information)
    x = covariance @ normal.gradient
    squares = normal.squares - float(normal.gradient @ x)
    value = weighted.log_determinant + float(np.linalg.slogdet(normal.information)[1]) + squares
    by_unknown = weighted.by_mode[:, :, :-1] @ moments.design
    trace = np.einsum("ndk,nkd->d", weighted.by_mode[:, :, :-1], weighted.modes)
    trace -= np.einsum("ndp,pq,ndq->d", by_unknown, covariance, by_unknown, optimize=True)
    rest = weighted.by_mode[:, :, -1] + by_unknown @ x
    of_modes = np.bincount(weighted.kind, trace - (rest**2).sum(0), len(moments.modes))
    of_points = moments.points - len(x) - squares - of_modes.sum()
    return value, np.concatenate([[of_points], of_modes])
