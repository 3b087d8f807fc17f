"""Fits of line, plane, circle, sphere, cylinder and cone to points, by least squares or minimum zone.

Least squares minimises the sum of squared perpendicular (orthogonal) distances, without weights, as ISO 10360-6 and the
NIST Algorithm Testing and Evaluation Program define the reference elements. The minimum zone (Chebyshev element)
minimises the largest distance. No start value is needed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from scancell.arrays import Array
from scancell.errors import FitError
from scancell.geometry.least_squares import LinearResiduals, minimise

_TINY = 1e-300  # keeps quotients finite at points on the axis

Criterion = Literal["least squares", "minimum zone"]

_FLAT = 1e-9  # of the extent: points that lie closer to a point, line or plane lie in it
_SINGULAR = 1e-9  # smallest singular value of derivatives by parameters that are determined
_SPANS = ("at one point", "on one line", "in one plane")


@dataclass(frozen=True)
class Element:
    """Reference point (3,), frame (3, 3) with the axes u, v, w as rows, sizes (k,).

    `motions` are the shifts (0, 1, 2) and tilts (3, 4) that change the element, `lengths`: which sizes are lengths
    and not angles.
    """

    origin: Array
    frame: Array
    sizes: Array

    kind: ClassVar[str]
    motions: ClassVar[tuple[int, ...]]
    lengths: ClassVar[tuple[bool, ...]] = ()

    def linearised(self, points: Array) -> tuple[Array, Array]:
        """Distances (m,) of points (n, 3) and their derivatives (m, k) by the step.

        m is n, or 2 n for elements with two components of distance for each point.
        """
        raise NotImplementedError

    def moved(self, step: Array) -> Self:
        """The element after a step (k,)."""
        motion = np.zeros(5)
        motion[list(self.motions)] = step[: len(self.motions)]
        u, v, w = self.frame
        direction = _unit(w + motion[3] * u + motion[4] * v)
        side = _unit(u - (u @ direction) * direction)
        frame = np.stack([side, np.cross(direction, side), direction])
        return replace(
            self,
            origin=self.origin + motion[:3] @ self.frame,
            frame=frame,
            sizes=self.sizes + step[len(self.motions) :],
        )

    def placed(self, centre: Array, scale: float) -> Self:
        """The element of the points ``centre + scale * points``."""
        sizes = np.where(self.lengths, scale * self.sizes, self.sizes)
        return replace(self, origin=centre + scale * self.origin, sizes=sizes)

    def normalised(self, centroid: Array) -> Self:
        """The same element with its reference point next to the centroid, and a sense of direction by convention."""
        return self

    @property
    def parameters_by_step(self) -> Array:
        """Derivative (p, k) of point, direction (for elements that have one) and sizes by the step."""
        u, v, w = self.frame
        tilts = [motion for motion in self.motions if motion > 2]
        shifts = [(u, v, w)[motion] for motion in self.motions if motion <= 2]
        rows, columns = 3 + (3 if tilts else 0), len(self.motions)
        whole = np.zeros((rows + len(self.sizes), columns + len(self.sizes)))
        whole[:3, : len(shifts)] = np.stack(shifts, 1)
        for place, motion in enumerate(tilts, len(shifts)):
            whole[3:6, place] = (u, v)[motion - 3]
        whole[rows:, columns:] = np.eye(len(self.sizes))
        return whole

    def _local(self, points: Array) -> tuple[Array, Array, Array]:
        x, y, z = self.frame @ (points - self.origin).T
        return x, y, z

    def _with_direction_by_convention(self, origin: Array) -> Self:
        """Sense of an axis without one of its own: its largest component is positive."""
        w = self.frame[2]
        turn = np.diag([1.0, -1.0, -1.0]) if w[np.abs(w).argmax()] < 0 else np.eye(3)
        return replace(self, origin=origin, frame=turn @ self.frame)


class Line(Element):
    """Straight line; the two components of the distance are x and y."""

    kind = "line"
    motions = (0, 1, 3, 4)

    def linearised(self, points: Array) -> tuple[Array, Array]:
        x, y, z = self._local(points)
        one, zero = np.ones_like(x), np.zeros_like(x)
        along_x = np.stack([-one, zero, -z, zero], 1)
        along_y = np.stack([zero, -one, zero, -z], 1)
        return np.concatenate([x, y]), np.concatenate([along_x, along_y])

    def normalised(self, centroid: Array) -> Self:
        w = self.frame[2]
        return self._with_direction_by_convention(self.origin + ((centroid - self.origin) @ w) * w)


class Plane(Element):
    """Plane; the direction is its normal."""

    kind = "plane"
    motions = (2, 3, 4)

    def linearised(self, points: Array) -> tuple[Array, Array]:
        x, y, z = self._local(points)
        return z, np.stack([-np.ones_like(x), x, y], 1)

    def normalised(self, centroid: Array) -> Self:
        w = self.frame[2]
        return self._with_direction_by_convention(centroid - ((centroid - self.origin) @ w) * w)


class Circle(Element):
    """Circle in space; the components of the distance are r - R in its plane and z across."""

    kind = "circle"
    motions = (0, 1, 2, 3, 4)
    lengths = (True,)

    def linearised(self, points: Array) -> tuple[Array, Array]:
        x, y, z = self._local(points)
        r = np.hypot(x, y)
        cos, sin = x / (r + _TINY), y / (r + _TINY)
        one, zero = np.ones_like(x), np.zeros_like(x)
        radial = np.stack([-cos, -sin, zero, -z * cos, -z * sin, -one], 1)
        axial = np.stack([zero, zero, -one, x, y, zero], 1)
        return np.concatenate([r - self.sizes[0], z]), np.concatenate([radial, axial])

    def normalised(self, centroid: Array) -> Self:
        return self._with_direction_by_convention(self.origin)


class CircleInPlane(Element):
    """Circle in a fixed plane; the distance is r - R."""

    kind = "circle"
    motions = (0, 1)
    lengths = (True,)

    def linearised(self, points: Array) -> tuple[Array, Array]:
        x, y, _ = self._local(points)
        r = np.hypot(x, y)
        return r - self.sizes[0], np.stack([-x / (r + _TINY), -y / (r + _TINY), -np.ones_like(x)], 1)


class Sphere(Element):
    """Sphere; the frame has no meaning."""

    kind = "sphere"
    motions = (0, 1, 2)
    lengths = (True,)

    def linearised(self, points: Array) -> tuple[Array, Array]:
        radial = points - self.origin
        r = np.sqrt(np.einsum("ni,ni->n", radial, radial))
        return r - self.sizes[0], np.column_stack([-(radial @ self.frame.T) / (r + _TINY)[:, None], -np.ones_like(r)])


class Cylinder(Element):
    """Cylinder without ends."""

    kind = "cylinder"
    motions = (0, 1, 3, 4)
    lengths = (True,)

    def linearised(self, points: Array) -> tuple[Array, Array]:
        x, y, z = self._local(points)
        r = np.hypot(x, y)
        cos, sin = x / (r + _TINY), y / (r + _TINY)
        return r - self.sizes[0], np.stack([-cos, -sin, -z * cos, -z * sin, -np.ones_like(x)], 1)

    def normalised(self, centroid: Array) -> Self:
        w = self.frame[2]
        return self._with_direction_by_convention(self.origin + ((centroid - self.origin) @ w) * w)


class Cone(Element):
    """Cone that opens along its direction; sizes: distance from the reference point to the surface, half angle psi.

    The distance of a point is ``r cos psi - z sin psi - s``, which stays regular when the apex is far away.
    """

    kind = "cone"
    motions = (0, 1, 3, 4)
    lengths = (True, False)

    def linearised(self, points: Array) -> tuple[Array, Array]:
        x, y, z = self._local(points)
        r = np.hypot(x, y)
        cos, sin = x / (r + _TINY), y / (r + _TINY)
        c, s = np.cos(self.sizes[1]), np.sin(self.sizes[1])
        tilt = -(c * z + s * r)
        columns = [-c * cos, -c * sin, tilt * cos, tilt * sin, -np.ones_like(x), -(r * s + z * c)]
        return r * c - z * s - self.sizes[0], np.stack(columns, 1)

    def normalised(self, centroid: Array) -> Self:
        distance, angle = self.sizes
        frame = self.frame
        if angle < 0:
            frame, angle = np.diag([1.0, -1.0, -1.0]) @ frame, -angle
        along = (centroid - self.origin) @ frame[2]
        sizes = np.array([distance + along * np.sin(angle), angle])
        return replace(self, origin=self.origin + along * frame[2], frame=frame, sizes=sizes)


def frame_about(direction: Array) -> Array:
    """Right-handed frame (3, 3) with rows u, v, w and w along `direction` (3,)."""
    w = _unit(direction)
    u = _unit(np.cross(w, np.eye(3)[np.abs(w).argmin()]))
    return np.stack([u, np.cross(w, u), w])


def _unit(vector: Array) -> Array:
    return np.asarray(vector / np.linalg.norm(vector))


class Adjustable(Protocol):
    """Protocol of the shapes that fits adjust to points: an `Element`, or a nominal surface with its motions."""

    def linearised(self, points: Array) -> tuple[Array, Array]:
        """Distances of points (n, 3), and their derivatives by the step."""

    def moved(self, step: Array) -> Self:
        """The same after a step."""


E = TypeVar("E", bound=Element)
Z = TypeVar("Z", bound=Adjustable)

_ITERATIONS = 500
_ROUNDING = 1e-15  # of the extent of the points: steps that move the surface less change nothing
_ZONE_ITERATIONS = 60
_ZONE_PRECISION = 1e-11  # relative decrease of the zone below which the search ends
_WORKING_SET = 400  # points of the first linear program of a step
_TRUST = 0.1  # first limit of a step, of the extent


def least_squares(element: Z, points: Array, iterations: int = _ITERATIONS) -> Z:
    """Element with the least sum of squared distances from points (n, 3) of extent about 1."""

    def linearised(at: Z) -> tuple[LinearResiduals, Callable[[Array], Z]]:
        return LinearResiduals(*at.linearised(points)), at.moved

    return minimise(linearised, element, iterations, settled=len(points) * _ROUNDING**2)[0]


def minimum_zone(element: Z, points: Array, sides: tuple[int, ...] = (1, -1), limit: float = _TRUST) -> Z:
    """Element with the least largest distance from points (n, 3) of extent about 1, from one that is near.

    Successive linear programs: the distances are linearised, the largest is minimised within a limit of the step,
    and the limit adapts to how well the prediction holds (Anthony, Anthony, Cox and Forbes, "Chebyshev reference
    software for the evaluation of coordinate measuring machine data", 1993).

    Parameters
    ----------
    sides
        1 and -1: the largest absolute distance; 1 alone: the largest, for circumscribed elements; -1 alone: that of the
        other sign, for inscribed ones.
    limit
        First limit of the step.
    """

    def largest(residual: Array) -> float:
        return max(float((side * residual).max()) for side in sides)

    residual, jacobian = element.linearised(points)
    zone = largest(residual)
    for _ in range(_ZONE_ITERATIONS):
        middle = 0.0 if len(sides) > 1 else float(residual.mean())
        scale = float(np.abs(residual - middle).max())
        if scale < _ROUNDING:
            break
        step, predicted = _chebyshev_step(residual - middle, jacobian, scale, limit, sides)
        predicted += sides[0] * middle
        moved = element.moved(step)
        new_residual, new_jacobian = moved.linearised(points)
        new_zone = largest(new_residual)
        gain, promised = zone - new_zone, zone - predicted
        if promised <= _ZONE_PRECISION * scale:
            break
        limit *= 2.0 if gain > 0.75 * promised else 0.25 if gain < 0.25 * promised else 1.0
        if gain > 0:
            element, residual, jacobian, zone = moved, new_residual, new_jacobian, new_zone
        elif limit < _ROUNDING:
            break
    return element


def _chebyshev_step(
    residual: Array, jacobian: Array, zone: float, limit: float, sides: tuple[int, ...]
) -> tuple[Array, float]:
    """Step (k,) that minimises the largest linearised distance, and that distance.

    The linear program holds few of the points; those that its solution violates are added until there is none.
    """
    from scipy.optimize import linprog  # noqa: PLC0415  (half a second)

    size = jacobian.shape[1]
    scaled = residual / zone
    rank = np.abs(scaled) if len(sides) > 1 else sides[0] * scaled
    chosen = np.argsort(-rank, kind="stable")[:_WORKING_SET]
    goal = np.append(np.zeros(size), 1.0)
    bounds = [(-limit / zone, limit / zone)] * size + [(0.0 if len(sides) > 1 else None, None)]
    options = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}
    while True:
        rows, right, one = jacobian[chosen], scaled[chosen], np.ones((len(chosen), 1))
        matrix = np.concatenate([np.hstack([side * rows, -one]) for side in sides])
        bound = np.concatenate([-side * right for side in sides])
        found = linprog(goal, matrix, bound, bounds=bounds, method="highs", options=options)
        if found.x is None:
            return np.zeros(size), zone * max(float((side * scaled).max()) for side in sides)
        linear = scaled + jacobian @ found.x[:-1]
        distance = np.max([side * linear for side in sides], axis=0)
        outside = np.flatnonzero(distance > found.x[-1] + 1e-9)
        missing = np.setdiff1d(outside, chosen)
        if len(missing) == 0:
            return zone * found.x[:-1], zone * float(distance.max())
        worst = missing[np.argsort(-distance[missing], kind="stable")[:_WORKING_SET]]
        chosen = np.concatenate([chosen, worst])


_MOST_POINTS = 500  # used to choose a start
_DIRECTIONS = 60  # tried for cylinders and cones, spread over the half sphere
_CANDIDATES = 6  # of the directions from which the sum of squares is minimised
_TRIAL_ITERATIONS = 40  # of these trial fits
_LEAST_SLOPE = 1e-3  # of a cone at the start
_NONE = np.zeros(0)

Revolved = TypeVar("Revolved", Cylinder, Cone)


def start_line(points: Array) -> Line:
    """Line along the longest principal axis of points (n, 3) about the origin."""
    return Line(np.zeros(3), frame_about(_principal_axes(points)[0]), _NONE)


def start_plane(points: Array) -> Plane:
    """Plane across the shortest principal axis."""
    return Plane(np.zeros(3), frame_about(_principal_axes(points)[2]), _NONE)


def start_circle(points: Array) -> Circle:
    """Algebraic circle in the least-squares plane."""
    frame = frame_about(_principal_axes(points)[2])
    centre, radius = algebraic_sphere(points @ frame[:2].T)
    origin = centre @ frame[:2] + (points.mean(0) @ frame[2]) * frame[2]
    return Circle(origin, frame, np.array([radius]))


def start_sphere(points: Array) -> Sphere:
    """Algebraic sphere."""
    centre, radius = algebraic_sphere(points)
    return Sphere(centre, np.eye(3), np.array([radius]))


def start_cylinder(points: Array) -> Cylinder:
    """The best of short fits from the directions in which an algebraic circle suits the projected points best."""
    some = _thinned(points)
    candidates = []
    for direction in _directions(some):
        frame = frame_about(direction)
        centre, radius = algebraic_sphere(some @ frame[:2].T)
        candidates.append(Cylinder(centre @ frame[:2], frame, np.array([radius])))
    return _best(candidates, some)


def start_cone(points: Array) -> Cone:
    """The best of short fits from the directions in which an algebraic cone suits the points best."""
    some = _thinned(points)
    return _best([_algebraic_cone(some, frame_about(direction)) for direction in _directions(some)], some)


def _best(candidates: list[Revolved], points: Array) -> Revolved:
    def cost(candidate: Revolved) -> float:
        return float(np.square(candidate.linearised(points)[0]).sum())

    costs = [cost(candidate) for candidate in candidates]
    order = np.argsort(np.where(np.isfinite(costs), costs, np.inf), kind="stable")
    return min((least_squares(candidates[int(i)], points, _TRIAL_ITERATIONS) for i in order[:_CANDIDATES]), key=cost)


def _principal_axes(points: Array) -> Array:
    """Principal axes (3, 3) as rows, the longest first."""
    return np.asarray(np.linalg.svd(np.linalg.qr(points - points.mean(0), mode="r"))[2])


def _thinned(points: Array) -> Array:
    return points[:: max(1, len(points) // _MOST_POINTS)]


def _directions(points: Array) -> Array:
    """Principal axes, and directions spread evenly over the half sphere (spherical Fibonacci lattice)."""
    index = np.arange(_DIRECTIONS) + 0.5
    height, turn = 1 - index / _DIRECTIONS, np.pi * (1 + 5**0.5) * index
    flat = np.sqrt(1 - height**2)
    return np.concatenate([_principal_axes(points), np.stack([flat * np.cos(turn), flat * np.sin(turn), height], 1)])


def algebraic_sphere(points: Array) -> tuple[Array, float]:
    """Centre and radius of the circle or sphere |p|² = 2 c·p + k, by linear least squares; points (n, 2 or 3)."""
    square = np.einsum("ni,ni->n", points, points)
    solution = np.linalg.lstsq(np.column_stack([2 * points, np.ones(len(points))]), square, rcond=None)[0]
    centre = solution[:-1]
    return centre, float(np.sqrt(max(solution[-1] + centre @ centre, 1e-12)))


def _algebraic_cone(points: Array, frame: Array) -> Cone:
    """Cone about an axis along w: x² + y² = 2 a x + 2 b y + t² z² + 2 k t z + k² - a² - b², linear in its terms."""
    x, y, z = frame @ points.T
    matrix = np.column_stack([2 * x, 2 * y, z**2, z, np.ones_like(x)])
    a, b, slope2, product, constant = np.linalg.lstsq(matrix, x**2 + y**2, rcond=None)[0]
    slope = max(np.sqrt(max(slope2, 0.0)), _LEAST_SLOPE)
    # The radius at z = 0 from the constant term; its sign, and on which side the cone opens, from the linear term.
    radius = np.sqrt(max(constant + a**2 + b**2, 0.0)) * (1.0 if product >= 0 else -1.0)
    if np.mean(radius + slope * z) < 0:
        frame, radius, b = np.diag([1.0, -1.0, -1.0]) @ frame, -radius, -b
    angle = np.arctan(slope)
    return Cone(a * frame[0] + b * frame[1], frame, np.array([radius * np.cos(angle), angle]))


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
    found, residual, covariance = _fitted(points, sigma, "least squares", start_line, 1)
    distance = np.linalg.norm(residual.reshape(2, -1), axis=0)
    return LineFit(residuals=distance, covariance=covariance, point=found.origin, direction=found.frame[2])


def fit_plane(points: ArrayLike, sigma: ArrayLike | None = None, *, criterion: Criterion = "least squares") -> PlaneFit:
    """Plane through points (n, 3); parameters and errors as for `fit_line`."""
    found, residual, covariance = _fitted(points, sigma, criterion, start_plane, 2)
    return PlaneFit(residuals=residual, covariance=covariance, point=found.origin, normal=found.frame[2])


def fit_circle(
    points: ArrayLike, sigma: ArrayLike | None = None, *, criterion: Criterion = "least squares"
) -> CircleFit:
    """Circle through points (n, 3) in space: the best one in their least-squares plane, as in the NIST reference fits.

    Parameters and errors as for `fit_line`.
    """
    found, residual, covariance = _fitted(points, sigma, criterion, start_circle, 2)
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
    found, residual, covariance = _fitted(points, sigma, criterion, start_sphere, 3)
    return SphereFit(residuals=residual, covariance=covariance, centre=found.origin, radius=float(found.sizes[0]))


def fit_cylinder(
    points: ArrayLike, sigma: ArrayLike | None = None, *, criterion: Criterion = "least squares"
) -> CylinderFit:
    """Cylinder through points (n, 3); parameters and errors as for `fit_line`."""
    found, residual, covariance = _fitted(points, sigma, criterion, start_cylinder, 3)
    return CylinderFit(
        residuals=residual,
        covariance=covariance,
        point=found.origin,
        direction=found.frame[2],
        radius=float(found.sizes[0]),
    )


def fit_cone(points: ArrayLike, sigma: ArrayLike | None = None, *, criterion: Criterion = "least squares") -> ConeFit:
    """Cone through points (n, 3); parameters and errors as for `fit_line`."""
    found, residual, covariance = _fitted(points, sigma, criterion, start_cone, 3)
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
    kind = start.__name__.removeprefix("start_")
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
