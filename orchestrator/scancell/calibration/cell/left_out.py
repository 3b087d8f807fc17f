"""Leave-one-out residuals: where the profile of each exposure lies in the laser's plane, by a fit of all the others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scancell.calibration.cell.noise import (
    Estimate,
    Moments,
    covariance_slopes,
    equations_of,
    informations,
    shares,
    weighted_by,
)

Array = NDArray[np.float64]

_LEAST_CURVATURE = 1e-6  # share of the largest information on a displacement: a straight profile has less


@dataclass(frozen=True)
class LeftOut:
    """Displacements of profiles from where the other exposures predict them, such as those of a circle's centre.

    Attributes
    ----------
    exposure
        (n,) row of each exposure with a profile that determines its displacement.
    displacement
        (n, 2) along y and z of the sensor, measured minus predicted, m.
    standard_deviation, degrees_of_freedom
        (n, 2) of the displacement to be expected, and of its variance.
    """

    exposure: NDArray[np.intp]
    displacement: Array
    standard_deviation: Array
    degrees_of_freedom: Array

    def half_widths(self, probability: float = 0.95) -> Array:
        """Half widths (n, 2) of the intervals about 0 that contain the displacements with `probability` each."""
        from scipy.special import stdtrit  # noqa: PLC0415  (slow to import)

        return np.asarray(stdtrit(self.degrees_of_freedom, 0.5 + probability / 2) * self.standard_deviation)


def left_out(moments: Moments, fit: Estimate, platter_from_sensor: Array) -> LeftOut:
    """The displacement of each exposure, by one linear step from the fit of all.

    A profile is displaced along y and z, and offset along its normals, so that a circle keeps its centre when its
    radius is wrong. The first regressors are those of a wrench and this offset.
    """
    k, p = moments.design.shape[1:]
    weighted = weighted_by(moments, fit.log_variances)
    normal = equations_of(moments, weighted)
    own, own_slopes = informations(moments, fit.log_variances), shares(moments, fit.log_variances)
    gradient = -(moments.design.swapaxes(1, 2) @ weighted.second[:, :k, k:])[:, :, 0]
    rows, found = [], []
    for i, second in enumerate(moments.second):
        of_profile = np.zeros((k, 3))
        of_profile[:3, :2], of_profile[6, 2] = platter_from_sensor[i, :3, 1:3], 1.0
        inner = of_profile.T @ second[:k, :k] @ of_profile
        if not np.linalg.eigvalsh(inner)[0] > _LEAST_CURVATURE * np.trace(inner):
            continue
        rest = normal.information - own[i]
        if np.linalg.matrix_rank(rest, hermitian=True) < p:
            continue
        covariance = np.linalg.inv(rest)
        x = covariance @ (normal.gradient - gradient[i])
        by_regressor = np.linalg.solve(inner, of_profile.T @ second[:k, :k])[:2]
        by_unknown = by_regressor @ moments.design[i]
        displacement = np.linalg.solve(inner, of_profile.T @ second[:k, k])[:2] + by_unknown @ x
        by_mode = (by_regressor @ weighted.modes[i]) ** 2
        of_points = np.exp(fit.log_variances[0]) * np.diag(np.linalg.inv(inner))[:2]
        of_modes = np.array([by_mode[:, weighted.kind == kind].sum(1) for kind in range(len(moments.modes))])
        slopes = covariance_slopes(covariance, (own_slopes.sum(1) - own_slopes[:, i]).reshape(-1, p, p))
        slopes = np.einsum("ap,kpq,aq->ka", by_unknown, slopes, by_unknown)
        slopes += np.concatenate([of_points[None], of_modes.reshape(-1, 2)])
        variance = np.einsum("ap,pq,aq->a", by_unknown, covariance, by_unknown) + of_points + of_modes.sum(0)
        rows.append(i)
        found.append([displacement, np.sqrt(variance), fit.degrees_of_freedom(variance, slopes)])
    each = np.array(found).reshape(-1, 3, 2)
    return LeftOut(np.array(rows, np.intp), each[:, 0], each[:, 1], each[:, 2])
