"""Fits of line, plane, circle, sphere, cylinder and cone to points, by least squares or minimum zone.

Least squares minimises the sum of squared perpendicular (orthogonal) distances, without weights, as ISO 10360-6 and the
NIST Algorithm Testing and Evaluation Program define the reference elements. The minimum zone (Chebyshev element)
minimises the largest distance. No start value is needed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from scancell.arrays import Array
from scancell.errors import FitError
from scancell.geometry.fits import starts
from scancell.geometry.fits.elements import Circle, CircleInPlane, Element, least_squares, minimum_zone

Criterion = Literal["least squares", "minimum zone"]
E = TypeVar("E", bound=Element)

_FLAT = 1e-9  # of the extent: points that lie closer to a point, line or plane lie in it
_SINGULAR = 1e-9  # smallest singular value of derivatives by parameters that are determined
_SPANS = ("at one point", "on one line", "in one plane")


@dataclass(frozen=True, kw_only=True)
class Fit:
    """Result of a fit; lengths in the unit of the points (m inside the program), angles in rad.

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
        """(k,) point, direction and sizes, of elements that have them."""
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


def fit_line(points: ArrayLike, sigma: ArrayLike | None = None) -> LineFit:
    """Least-squares line through points (n, 3).

    Raises `FitError` if the points do not determine the element; the message states what is missing. This holds for all
    fits.

    Parameters
    ----------
    sigma
        Standard deviation of the points, one or (n,), for the covariance; by default it is estimated from the
        residuals.
    """
    found, residual, covariance = _fitted(points, sigma, "least squares", starts.line, 1)
    distance = np.linalg.norm(residual.reshape(2, -1), axis=0)
    return LineFit(residuals=distance, covariance=covariance, point=found.origin, direction=found.frame[2])


def fit_plane(points: ArrayLike, sigma: ArrayLike | None = None, *, criterion: Criterion = "least squares") -> PlaneFit:
    """Plane through points (n, 3); parameters and errors as for `fit_line`."""
    found, residual, covariance = _fitted(points, sigma, criterion, starts.plane, 2)
    return PlaneFit(residuals=residual, covariance=covariance, point=found.origin, normal=found.frame[2])


def fit_circle(
    points: ArrayLike, sigma: ArrayLike | None = None, *, criterion: Criterion = "least squares"
) -> CircleFit:
    """Circle through points (n, 3) in space: the best one in their least-squares plane, as in the NIST reference fits.

    Parameters and errors as for `fit_line`.
    """
    found, residual, covariance = _fitted(points, sigma, criterion, starts.circle, 2)
    radial, axial = residual.reshape(2, -1)
    return CircleFit(
        residuals=radial,
        covariance=covariance,
        out_of_plane=axial,
        centre=found.origin,
        normal=found.frame[2],
        radius=float(found.sizes[0]),
    )


def fit_sphere(
    points: ArrayLike, sigma: ArrayLike | None = None, *, criterion: Criterion = "least squares"
) -> SphereFit:
    """Sphere through points (n, 3); parameters and errors as for `fit_line`."""
    found, residual, covariance = _fitted(points, sigma, criterion, starts.sphere, 3)
    return SphereFit(residuals=residual, covariance=covariance, centre=found.origin, radius=float(found.sizes[0]))


def fit_cylinder(
    points: ArrayLike, sigma: ArrayLike | None = None, *, criterion: Criterion = "least squares"
) -> CylinderFit:
    """Cylinder through points (n, 3); parameters and errors as for `fit_line`."""
    found, residual, covariance = _fitted(points, sigma, criterion, starts.cylinder, 3)
    return CylinderFit(
        residuals=residual,
        covariance=covariance,
        point=found.origin,
        direction=found.frame[2],
        radius=float(found.sizes[0]),
    )


def fit_cone(points: ArrayLike, sigma: ArrayLike | None = None, *, criterion: Criterion = "least squares") -> ConeFit:
    """Cone through points (n, 3); parameters and errors as for `fit_line`."""
    found, residual, covariance = _fitted(points, sigma, criterion, starts.cone, 3)
    return ConeFit(
        residuals=residual,
        covariance=covariance,
        point=found.origin,
        direction=found.frame[2],
        distance=float(found.sizes[0]),
        half_angle=float(found.sizes[1]),
    )


def _fitted(
    points: ArrayLike, sigma: ArrayLike | None, criterion: Criterion, start: Callable[[Array], E], dimensions: int
) -> tuple[E, Array, Array]:
    """Element, its residuals and the covariance; the points must span this number of `dimensions`."""
    given = np.asarray(points, float)
    kind = start.__name__
    if given.ndim != 2 or given.shape[1] != 3 or not np.isfinite(given).all():
        raise FitError(f"fit of a {kind}: shape {given.shape}", expected="finite points of shape (n, 3)")
    if len(given) < dimensions + 1:
        raise FitError(f"fit of a {kind}: {len(given)} points; at least {dimensions + 1} are needed")
    centre = given.mean(0)
    extent = float(np.sqrt(np.square(given - centre).sum(1).mean()))
    scaled = (given - centre) / (extent or 1.0)
    spread = np.linalg.svd(np.linalg.qr(scaled, mode="r"), compute_uv=False) / np.sqrt(len(given))
    spanned = int((spread > _FLAT).sum())
    if spanned < dimensions:
        raise FitError(f"fit of a {kind}: all {len(given)} points lie {_SPANS[spanned]}; points off it are needed")
    first = start(scaled)
    free = len(first.motions) + len(first.sizes)
    if len(given) < _least_points(first):
        raise FitError(f"fit of a {kind}: {len(given)} points; at least {_least_points(first)} are needed")
    element = _adjusted(first, scaled, "least squares")
    _check_determined(element, scaled)
    if criterion == "minimum zone":
        element = _adjusted(element, scaled, criterion)
    element = element.placed(centre, extent).normalised(centre)
    residual, jacobian = element.linearised(given)
    if criterion == "minimum zone":
        size = len(element.parameters_by_step)
        return element, residual, np.full((size, size), np.nan)
    return element, residual, _covariance(element, residual, jacobian, sigma, len(residual) - free)


def _least_points(element: Element) -> int:
    """Number of points that determine an element; each of a line or circle gives two distances."""
    return {"line": 2, "circle": 3}.get(element.kind, len(element.motions) + len(element.sizes))


def _adjusted(element: E, points: Array, criterion: Criterion) -> E:
    if isinstance(element, Circle):
        flat = _adjusted(CircleInPlane(element.origin, element.frame, element.sizes), points, criterion)
        return replace(element, origin=flat.origin, sizes=flat.sizes)
    return minimum_zone(element, points) if criterion == "minimum zone" else least_squares(element, points)


def _check_determined(element: Element, points: Array) -> None:
    _, jacobian = element.linearised(points)
    _, value, axes = np.linalg.svd(np.linalg.qr(jacobian / np.linalg.norm(jacobian, axis=0), mode="r"))
    if value[-1] > _SINGULAR * value[0]:
        return
    names = [("position", "position", "position", "direction", "direction")[motion] for motion in element.motions]
    names += ["radius" if length else "angle" for length in element.lengths]
    free = dict.fromkeys(name for name, share in zip(names, axes[-1], strict=True) if abs(share) > 0.1)
    raise FitError(
        f"fit of a {element.kind}: the {len(points)} points leave its {' and '.join(free)} undetermined; "
        "points elsewhere on the surface are needed"
    )


def _covariance(element: Element, residual: Array, jacobian: Array, sigma: ArrayLike | None, freedom: int) -> Array:
    """Covariance of the parameters: C J' diag(sigma²) J C with C = (J' J)^-1 (propagation after JCGM 102)."""
    length = np.linalg.norm(jacobian, axis=0)
    inverse = np.linalg.pinv(jacobian / length) / length[:, None]
    if sigma is not None:
        deviation = np.broadcast_to(np.asarray(sigma, float), len(residual) // _components(element))
        weighted = inverse * np.tile(deviation, _components(element))
    elif freedom > 0:
        weighted = inverse * np.sqrt(residual @ residual / freedom)
    else:
        weighted = np.full_like(inverse, np.nan)
    by_step = element.parameters_by_step
    whole = by_step @ weighted
    return np.asarray(whole @ whole.T)


def _components(element: Element) -> int:
    return 2 if element.kind in {"line", "circle"} else 1
