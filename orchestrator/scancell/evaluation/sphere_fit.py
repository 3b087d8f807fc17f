"""Sphere fit for artefacts: centre, diameter and form deviation, after VDI/VDE 2634."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_ITERATIONS = 20
_MIN_POINTS = 10
# Quantiles between which the form deviation is taken, against outliers of a noisy cloud.
_FORM_QUANTILES = (0.025, 0.975)


@dataclass(frozen=True)
class Sphere:
    """Nominal sphere in the part frame, m; its points lie within `reach` of the surface and above z = `lowest`."""

    centre: Array
    radius: float
    reach: float
    lowest: float = -np.inf

    def selects(self, points_in_part: Array) -> NDArray[np.bool_]:
        """Whether points (n, 3) belong to the sphere, (n,)."""
        distance = np.linalg.norm(points_in_part - self.centre, axis=1)
        return np.asarray((np.abs(distance - self.radius) <= self.reach) & (points_in_part[:, 2] >= self.lowest))


@dataclass(frozen=True)
class SphereFigures:
    """Least-squares sphere, m: displacement (3,) of its centre and error of its diameter from nominal.

    `points` is the number of points, `form` the width of the interval of the central 95 % of the radial residuals,
    `rms` their root mean square.
    """

    points: int
    shift: Array
    diameter_error: float
    form: float
    rms: float


def fit_sphere(points_in_part: Array, nominal: Sphere) -> SphereFigures:
    """Least-squares sphere through points (n, 3), m, by Gauss-Newton from `nominal`; NaN for fewer than 10 points."""
    points = points_in_part[nominal.selects(points_in_part)] - nominal.centre
    if len(points) < _MIN_POINTS:
        return SphereFigures(len(points), np.full(3, np.nan), *([float("nan")] * 3))
    centre, radius = np.zeros(3), nominal.radius
    for _ in range(_ITERATIONS):
        radial = points - centre
        distance = np.linalg.norm(radial, axis=1)
        jacobian = np.column_stack([radial / distance[:, None], np.ones(len(points))])
        step = np.linalg.lstsq(jacobian.T @ jacobian, jacobian.T @ (distance - radius), rcond=None)[0]
        centre, radius = centre + step[:3], radius + step[3]
        if np.abs(step).max() < 1e-12:
            break
    residual = np.linalg.norm(points - centre, axis=1) - radius
    low, high = np.quantile(residual, _FORM_QUANTILES)
    error = 2 * (radius - nominal.radius)
    return SphereFigures(len(points), centre, float(error), float(high - low), float(np.sqrt(np.mean(residual**2))))
