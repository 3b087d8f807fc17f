"""Leave-one-out residuals: where the measurements of each exposure lie, by a fit of all the others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scancell.calibration.least_squares import without
from scancell.calibration.variance_components import (
    Estimate,
    Moments,
    covariance_slopes,
    equations_of,
    half_widths,
    information_slopes,
    informations,
    weighted_by,
)

Array = NDArray[np.float64]

_LEAST_CURVATURE = 1e-6  # share of the information on a displacement alone: a straight profile leaves less


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
