"""Noise of calibration data: errors of points, and pose errors that all points of an exposure share.

The size of each is a variance component, found by restricted maximum likelihood (REML; Patterson & Thompson 1971).
Every exposure enters by the second moments of its points alone, so that the cost does not depend on their number.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Bounds of logarithms of variances: of points relative to the stated one; of modes, 1 nm or nrad to 10 mm or mrad.
_BOUNDS_OF_POINTS = (-12.0, 12.0)
_BOUNDS_OF_MODES = (2 * np.log(1e-9), 2 * np.log(1e-2))
_STEP = 0.05  # of logarithms of variances, for derivatives


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
        For each kind of pose error (n, k, d), as multiples of the regressors.
    points
        Number of points.
    """

    second: Array
    design: Array
    modes: tuple[Array, ...]
    points: int


@dataclass(frozen=True)
class Estimate:
    """Covariance (p, p) of least squares, logarithms of the variances (of points, of each mode), and degrees of
    freedom (p,) of the unknowns' variances.
    """

    covariance: Array
    log_variances: Array
    degrees_of_freedom: Array


def estimate(moments: Moments, start: Array) -> Estimate:
    """Generalised least squares at the variances that maximise the restricted likelihood.

    Parameters
    ----------
    start
        (1 + modes,) logarithms of the variance of points, relative to their stated one, and of each mode, SI.
    """
    from scipy.optimize import minimize  # noqa: PLC0415  (half a second)

    bounds = [_BOUNDS_OF_POINTS, *[_BOUNDS_OF_MODES] * len(moments.modes)]
    found = minimize(lambda t: _criterion(moments, t), start, method="L-BFGS-B", bounds=bounds, options={"eps": 1e-4})
    log_variances = np.asarray(found.x)
    covariance = np.asarray(np.linalg.inv(normal_equations(moments, log_variances)[0]), float)
    return Estimate(covariance, log_variances, _degrees_of_freedom(moments, log_variances, covariance))


def informations(moments: Moments, log_variances: Array) -> Array:
    """Information (n, p, p) on the unknowns from each exposure."""
    each, _ = _without_pose_errors(moments, log_variances)
    k = moments.design.shape[1]
    return np.asarray(moments.design.swapaxes(1, 2) @ each[:, :k, :k] @ moments.design)


def pose_errors(moments: Moments, log_variances: Array) -> Array:
    """Most likely pose errors (n, k), as multiples of the regressors."""
    second, scaled = _scaled(moments, log_variances)
    if not moments.modes:
        return np.zeros(moments.design.shape[:2])
    k = moments.design.shape[1]
    transposed = scaled.swapaxes(1, 2)
    inner = np.eye(scaled.shape[-1]) + transposed @ second[:, :k, :k] @ scaled
    return np.asarray((scaled @ np.linalg.solve(inner, transposed @ second[:, :k, k:]))[:, :, 0])


def _scaled(moments: Moments, log_variances: Array) -> tuple[Array, Array]:
    """Second moments by the variance of points, and modes (n, k, d) times standard deviations."""
    second = moments.second * np.exp(-log_variances[0])
    deviations = np.exp(0.5 * log_variances[1:])
    scaled = [mode * deviation for mode, deviation in zip(moments.modes, deviations, strict=True)]
    n, k = moments.design.shape[:2]
    return second, np.concatenate(scaled, -1) if scaled else np.zeros((n, k, 0))


def _without_pose_errors(moments: Moments, log_variances: Array) -> tuple[Array, float]:
    """Second moments (n, k + 1, k + 1) weighted by the whole covariance, and the logarithm of its determinant.

    The pose errors are eliminated by the Woodbury identity.
    """
    second, scaled = _scaled(moments, log_variances)
    k = moments.design.shape[1]
    log_determinant = moments.points * log_variances[0]
    if scaled.shape[-1]:
        across = second[:, :, :k] @ scaled
        inner = np.eye(scaled.shape[-1]) + scaled.swapaxes(1, 2) @ across[:, :k]
        second = second - across @ np.linalg.solve(inner, np.swapaxes(across, 1, 2))
        log_determinant += float(np.linalg.slogdet(inner)[1].sum())
    return second, log_determinant


def normal_equations(moments: Moments, log_variances: Array) -> tuple[Array, Array, float, float]:
    """Information (p, p), gradient (p,), sum of squares of the residual, logarithm of the covariance's determinant.

    See `estimate` for `log_variances`.
    """
    second, log_determinant = _without_pose_errors(moments, log_variances)
    k = moments.design.shape[1]
    weighted = moments.design.swapaxes(1, 2) @ second[:, :k]
    information = (weighted[:, :, :k] @ moments.design).sum(0)
    gradient = -weighted[:, :, k].sum(0)
    return information, gradient, float(second[:, k, k].sum()), log_determinant


def _criterion(moments: Moments, log_variances: Array) -> float:
    """Minus twice the logarithm of the restricted likelihood, up to a constant."""
    information, gradient, squares, log_determinant = normal_equations(moments, log_variances)
    explained = float(gradient @ np.linalg.solve(information, gradient))
    return log_determinant + float(np.linalg.slogdet(information)[1]) + squares - explained


def _degrees_of_freedom(moments: Moments, at: Array, covariance: Array) -> Array:
    """Of each unknown's variance (p,), by Satterthwaite's approximation: ``2 v² / var(v)``."""
    steps = _STEP * np.eye(len(at))
    variances = np.diag(covariance)

    def variances_at(shift: Array) -> Array:
        return np.asarray(np.diag(np.linalg.inv(normal_equations(moments, at + shift)[0])))

    slopes = np.stack([(variances_at(step) - variances_at(-step)) / (2 * _STEP) for step in steps])
    curvature = np.array([[_second_difference(moments, at, a, b) for a in steps] for b in steps])
    # A variance near 0 has no curvature and no effect.
    uncertainty = 2.0 * np.linalg.pinv(curvature, rcond=1e-6, hermitian=True)
    spread = np.einsum("kp,kl,lp->p", slopes, uncertainty, slopes)
    return np.asarray(np.clip(2.0 * variances**2 / np.maximum(spread, 1e-30 * variances**2), 1.0, None))


def _second_difference(moments: Moments, at: Array, a: Array, b: Array) -> float:
    corners = (((1, 1), 1), ((1, -1), -1), ((-1, 1), -1), ((-1, -1), 1))
    total = sum(sign * _criterion(moments, at + i * a + j * b) for (i, j), sign in corners)
    return float(total / (4 * _STEP**2))
