"""A ball measured by its points: place, size and form, as VDI/VDE 2634 asks of artefacts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_ITERATIONS = 20
_FEWEST = 10
# Ends of the form: single outliers of a noisy cloud are no form.
_FORM_SHARE = (0.025, 0.975)


@dataclass(frozen=True)
class Sphere:
    """Nominal ball in the part frame, and which points are its own: within `reach` of its surface, above `lowest`."""

    centre: Array
    radius: float
    reach: float
    lowest: float = -np.inf

    def owns(self, points_in_part: Array) -> NDArray[np.bool_]:
        """(n,) which of the points (n, 3) belong to the ball."""
        distance = np.linalg.norm(points_in_part - self.centre, axis=1)
        return np.asarray((np.abs(distance - self.radius) <= self.reach) & (points_in_part[:, 2] >= self.lowest))


@dataclass(frozen=True)
class SphereFigures:
    """Gaussian ball through the points: shift (3,) of its centre and excess of its diameter over nominal, m.

    `form` is the range of radial residuals that holds the middle 95 % of them, `rms` their root mean square.
    """

    points: int
    shift: Array
    diameter_error: float
    form: float
    rms: float


def fit_sphere(points_in_part: Array, nominal: Sphere) -> SphereFigures:
    """Least squares of radial distances by Gauss-Newton from the nominal ball; NaN for fewer than 10 points."""
    points = points_in_part[nominal.owns(points_in_part)] - nominal.centre
    if len(points) < _FEWEST:
        return SphereFigures(len(points), np.full(3, np.nan), *([float("nan")] * 3))
    centre, radius = np.zeros(3), nominal.radius
    for _ in range(_ITERATIONS):
        way = points - centre
        distance = np.linalg.norm(way, axis=1)
        jacobian = np.column_stack([way / distance[:, None], np.ones(len(points))])
        step = np.linalg.lstsq(jacobian.T @ jacobian, jacobian.T @ (distance - radius), rcond=None)[0]
        centre, radius = centre + step[:3], radius + step[3]
        if np.abs(step).max() < 1e-12:
            break
    residual = np.linalg.norm(points - centre, axis=1) - radius
    low, high = np.quantile(residual, _FORM_SHARE)
    error = 2 * (radius - nominal.radius)
    return SphereFigures(len(points), centre, float(error), float(high - low), float(np.sqrt(np.mean(residual**2))))
