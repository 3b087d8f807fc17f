"""Start values of fits, from the points alone: principal axes and algebraic (linear) fits."""

from __future__ import annotations

from typing import TypeVar

import numpy as np

from scancell.arrays import Array
from scancell.geometry.fits.elements import (
    Circle,
    Cone,
    Cylinder,
    Line,
    Plane,
    Sphere,
    frame_about,
    least_squares,
)

_MOST_POINTS = 500  # used to choose a start
_DIRECTIONS = 60  # tried for cylinders and cones, spread over the half sphere
_CANDIDATES = 6  # of the directions from which the sum of squares is minimised
_TRIAL_ITERATIONS = 40  # of these trial fits
_LEAST_SLOPE = 1e-3  # of a cone at the start
_NONE = np.zeros(0)

Revolved = TypeVar("Revolved", Cylinder, Cone)


def line(points: Array) -> Line:
    """Line along the longest principal axis of points (n, 3) about the origin."""
    return Line(np.zeros(3), frame_about(_principal_axes(points)[0]), _NONE)


def plane(points: Array) -> Plane:
    """Plane across the shortest principal axis."""
    return Plane(np.zeros(3), frame_about(_principal_axes(points)[2]), _NONE)


def circle(points: Array) -> Circle:
    """Algebraic circle in the least-squares plane."""
    frame = frame_about(_principal_axes(points)[2])
    centre, radius = algebraic_sphere(points @ frame[:2].T)
    origin = centre @ frame[:2] + (points.mean(0) @ frame[2]) * frame[2]
    return Circle(origin, frame, np.array([radius]))


def sphere(points: Array) -> Sphere:
    """Algebraic sphere."""
    centre, radius = algebraic_sphere(points)
    return Sphere(centre, np.eye(3), np.array([radius]))


def cylinder(points: Array) -> Cylinder:
    """The best of short fits from the directions in which an algebraic circle suits the projected points best."""
    some = _thinned(points)
    candidates = []
    for direction in _directions(some):
        frame = frame_about(direction)
        centre, radius = algebraic_sphere(some @ frame[:2].T)
        candidates.append(Cylinder(centre @ frame[:2], frame, np.array([radius])))
    return _best(candidates, some)


def cone(points: Array) -> Cone:
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
