"""Geometric elements under adjustment: distances of points, their derivatives, and how a step changes an element.

An element has a reference point, a frame whose third axis is its direction, and sizes. A step changes it in a minimal
parametrisation about its present state: shifts (a, b, c) of the point along the axes u, v, w of the frame, tilts
(alpha, beta) of the direction towards u and v, and changes of the sizes. Directions stay unit vectors by construction.

Derivatives: with x, y, z the coordinates of a point in the frame and r = √(x² + y²), a step changes them to first order
by dx = -a - z alpha, dy = -b - z beta, dz = -c + x alpha + y beta, and r by dr = (x dx + y dy) / r.
Distances after Forbes, "Least-squares best-fit geometric elements", NPL report DITC 140/89 (1991).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar, Self, TypeVar

import numpy as np

from scancell.arrays import Array
from scancell.geometry.least_squares import LinearResiduals, minimise

_TINY = 1e-300  # keeps quotients finite at points on the axis


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


E = TypeVar("E", bound=Element)

_ITERATIONS = 500
_ROUNDING = 1e-15  # of the extent of the points: steps that move the surface less change nothing
_ZONE_ITERATIONS = 60
_ZONE_PRECISION = 1e-11  # relative decrease of the zone below which the search ends
_WORKING_SET = 400  # points of the first linear program of a step
_TRUST = 0.1  # first limit of a step, of the extent


def least_squares(element: E, points: Array, iterations: int = _ITERATIONS) -> E:
    """Element with the least sum of squared distances from points (n, 3) of extent about 1."""

    def linearised(at: E) -> tuple[LinearResiduals, Callable[[Array], E]]:
        return LinearResiduals(*at.linearised(points)), at.moved

    return minimise(linearised, element, iterations, settled=len(points) * _ROUNDING**2)[0]


def minimum_zone(element: E, points: Array) -> E:
    """Element with the least largest distance from points (n, 3) of extent about 1, from one that is near.

    Successive linear programs: the distances are linearised, the largest is minimised within a limit of the step,
    and the limit adapts to how well the prediction holds (Anthony, Anthony, Cox and Forbes, "Chebyshev reference
    software for the evaluation of coordinate measuring machine data", 1993).
    """
    residual, jacobian = element.linearised(points)
    zone, limit = float(np.abs(residual).max()), _TRUST
    for _ in range(_ZONE_ITERATIONS):
        if zone < _ROUNDING:
            break
        step, predicted = _chebyshev_step(residual, jacobian, zone, limit)
        moved = element.moved(step)
        new_residual, new_jacobian = moved.linearised(points)
        new_zone = float(np.abs(new_residual).max())
        gain, promised = zone - new_zone, zone - predicted
        if promised <= _ZONE_PRECISION * zone:
            break
        limit *= 2.0 if gain > 0.75 * promised else 0.25 if gain < 0.25 * promised else 1.0
        if gain > 0:
            element, residual, jacobian, zone = moved, new_residual, new_jacobian, new_zone
        elif limit < _ROUNDING:
            break
    return element


def _chebyshev_step(residual: Array, jacobian: Array, zone: float, limit: float) -> tuple[Array, float]:
    """Step (k,) that minimises the largest linearised distance, and that distance.

    The linear program holds few of the points; those that its solution violates are added until there is none.
    """
    from scipy.optimize import linprog  # noqa: PLC0415  (half a second)

    size = jacobian.shape[1]
    scaled = residual / zone
    chosen = np.argsort(-np.abs(scaled), kind="stable")[:_WORKING_SET]
    goal = np.append(np.zeros(size), 1.0)
    bounds = [(-limit / zone, limit / zone)] * size + [(0.0, None)]
    options = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}
    while True:
        rows, right, one = jacobian[chosen], scaled[chosen], np.ones((len(chosen), 1))
        matrix = np.concatenate([np.hstack([rows, -one]), np.hstack([-rows, -one])])
        found = linprog(goal, matrix, np.concatenate([-right, right]), bounds=bounds, method="highs", options=options)
        if found.x is None:
            return np.zeros(size), zone
        distance = np.abs(scaled + jacobian @ found.x[:-1])
        outside = np.flatnonzero(distance > found.x[-1] + 1e-9)
        missing = np.setdiff1d(outside, chosen)
        if len(missing) == 0:
            return zone * found.x[:-1], zone * float(distance.max())
        worst = missing[np.argsort(-distance[missing], kind="stable")[:_WORKING_SET]]
        chosen = np.concatenate([chosen, worst])
