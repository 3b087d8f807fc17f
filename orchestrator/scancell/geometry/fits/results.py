"""What fits return."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scancell.geometry.fits.elements import Array


@dataclass(frozen=True, kw_only=True)
class Fit:
    """What all fits have; lengths in the unit of the points (m inside the program), angles in rad.

    Attributes
    ----------
    residuals
        (n,) signed distances of the points from the element, positive on the side of the normal or outside.
    covariance
        (k, k) of `parameters`; its rank is the number of free parameters, because directions are unit vectors and
        points slide along an axis. NaN for minimum-zone fits, which extreme points alone decide, and where as many
        points as free parameters leave no residuals to estimate it from.
    """

    residuals: Array
    covariance: Array

    @property
    def parameters(self) -> Array:
        """(k,) point, direction and sizes, as far as the element has them."""
        raise NotImplementedError

    @property
    def count(self) -> int:
        """Number of points."""
        return len(self.residuals)

    @property
    def rms(self) -> float:
        """Root mean square of the residuals."""
        return float(np.sqrt(np.mean(self.residuals**2)))

    @property
    def form(self) -> float:
        """Form deviation: range of the residuals; of a minimum-zone fit the width of the zone."""
        return float(np.ptp(self.residuals))

    @property
    def standard_deviations(self) -> Array:
        """(k,) standard deviations of `parameters`."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))


@dataclass(frozen=True, kw_only=True)
class LineFit(Fit):
    """Line: `point` (3,) nearest to the centroid, unit `direction` (3,); residuals are distances, never negative.

    `parameters` are point and direction.
    """

    point: Array
    direction: Array

    @property
    def parameters(self) -> Array:
        """(6,) point, direction."""
        return np.concatenate([self.point, self.direction])


@dataclass(frozen=True, kw_only=True)
class PlaneFit(Fit):
    """Plane: `point` (3,) nearest to the centroid, unit `normal` (3,), whose largest component is positive."""

    point: Array
    normal: Array

    @property
    def parameters(self) -> Array:
        """(6,) point, normal."""
        return np.concatenate([self.point, self.normal])


@dataclass(frozen=True, kw_only=True)
class CircleFit(Fit):
    """Circle in the least-squares plane of the points: `centre` (3,), unit `normal` (3,), `radius`.

    `residuals` are radial, in the plane; `out_of_plane` (n,) are the distances from the plane.
    """

    centre: Array
    normal: Array
    radius: float
    out_of_plane: Array

    @property
    def parameters(self) -> Array:
        """(7,) centre, normal, radius."""
        return np.concatenate([self.centre, self.normal, [self.radius]])


@dataclass(frozen=True, kw_only=True)
class SphereFit(Fit):
    """Sphere: `centre` (3,), `radius`."""

    centre: Array
    radius: float

    @property
    def parameters(self) -> Array:
        """(4,) centre, radius."""
        return np.concatenate([self.centre, [self.radius]])


@dataclass(frozen=True, kw_only=True)
class CylinderFit(Fit):
    """Cylinder: `point` (3,) of the axis nearest to the centroid, unit `direction` (3,), `radius`."""

    point: Array
    direction: Array
    radius: float

    @property
    def parameters(self) -> Array:
        """(7,) point, direction, radius."""
        return np.concatenate([self.point, self.direction, [self.radius]])


@dataclass(frozen=True, kw_only=True)
class ConeFit(Fit):
    """Cone, as in the reference data of NIST.

    `point` (3,) of the axis nearest to the centroid, unit `direction` (3,) along which the cone opens, `distance` from
    the point to the surface, perpendicular to the surface, and `half_angle`.
    """

    point: Array
    direction: Array
    distance: float
    half_angle: float

    @property
    def parameters(self) -> Array:
        """(8,) point, direction, distance, half angle."""
        return np.concatenate([self.point, self.direction, [self.distance, self.half_angle]])

    @property
    def radius(self) -> float:
        """Radius of the section through `point`."""
        return float(self.distance / np.cos(self.half_angle))

    @property
    def apex(self) -> Array:
        """(3,) apex."""
        return np.asarray(self.point - self.distance / np.sin(self.half_angle) * self.direction)
