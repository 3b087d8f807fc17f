"""Alignment of a cloud to a nominal surface: none, best fit, or to datum planes.

Best fit minimises the squared signed distances of the points (point-to-surface ICP): each step is a least-squares
problem in a small rotation and translation, in which the distance of a point changes along the normal of the surface
(Chen and Medioni, 1992). Motions that the surface does not determine, such as those of a plane in itself, stay zero.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import permutations, product
from typing import get_args

import numpy as np

from scancell.arrays import Array
from scancell.config.choices import Align
from scancell.errors import DescriptionError, FitError
from scancell.geometry import pose
from scancell.geometry.fits import fit_plane

# Signed distances (n,), m, of points (n, 3) from a surface, and its unit normals (n, 3) there.
Distances = Callable[[Array], tuple[Array, Array]]

_ITERATIONS = 100
MOST_POINTS = 100_000  # that take part
_LEAST_POINTS = 6
_SETTLED = 1e-12  # m: largest motion of a point by a step that changes nothing
_UNDETERMINED = 1e-5  # singular values, relative to the largest, of motions that the surface does not determine
_OUTLIER = 5.0  # robust standard deviations from which on points do not take part
_FLOOR = 1e-9  # m: of this limit
_PARALLEL = 0.05  # least volume of three datum normals
# Mean distances, in diagonals of the surface: above the first, other starts are tried; above the second is a warning.
_WELL_FITTED, _BADLY_FITTED = 3e-4, 5e-3
_BETTER = 0.5  # of the mean distance: from which on another start, or the mirror image, fits better
_SEARCH = ((300, 12), (2000, 60))  # points and iterations for all starts, and for the best ones
_BEST_STARTS = 4


@dataclass(frozen=True)
class DatumPlane:
    """Nominal plane of a datum, m: a point (3,), the outward unit normal (3,)."""

    point: Array
    normal: Array


def check_request(points: Array, align: str) -> None:
    """Raise `DescriptionError` for an unknown alignment, or without points."""
    if align not in get_args(Align):
        raise DescriptionError(key="align", value=align, expected=", ".join(get_args(Align)))
    if not len(points):
        raise DescriptionError("holds no points", key="cloud", expected="at least one")


def best_fit_of_starts(points: Array, distances: Distances, bounds: Array) -> tuple[Array, list[str]]:
    """Best fit from the present pose of the points (n, 3) or, if poor, the best of several rotations; with warnings.

    Raises `FitError` with fewer than six points.

    Parameters
    ----------
    bounds
        (2, 3) lower and upper corner of the surface.
    """
    size, (count, iterations) = float(np.linalg.norm(bounds[1] - bounds[0])), _SEARCH[-1]
    some = _thinned(points, count)
    rest = _mean_distance(some, distances, best_fit(some, distances, iterations=iterations))
    if rest <= _WELL_FITTED * size:
        return best_fit(points, distances), []
    start, warnings = np.eye(4), []
    turned, found = _search(some, distances, bounds)
    if found < _BETTER * rest:
        angle = np.degrees(np.linalg.norm(pose.log_rotation(turned[:3, :3])))
        warnings.append(
            f"best fit: a mean distance of {_mm(rest)} remains from the given pose, {_mm(found)} from another start, "
            f"which is used: it turns the cloud by {angle:.0f} deg"
        )
        start, rest = turned, found
    mirror = np.diag([-1.0, 1.0, 1.0])
    mirrored = _search(some @ mirror, distances, bounds)[1] if rest > _WELL_FITTED * size else np.inf
    if mirrored < _BETTER * rest:
        warnings.append(
            f"best fit: the mirror image of the cloud fits with a mean distance of {_mm(mirrored)}, the cloud with "
            f"{_mm(rest)}: is an axis of the cloud or of the part mirrored?"
        )
    elif rest > _BADLY_FITTED * size:
        warnings.append(
            f"best fit: a mean distance of {_mm(rest)} remains from {len(_turns())} starts: is this a cloud of the "
            "part, and in the right unit?"
        )
    return best_fit(points, distances, start), warnings


def _search(points: Array, distances: Distances, bounds: Array) -> tuple[Array, float]:
    """The best fit (4, 4) from turns about the middle of the bounds, and its mean distance, m."""
    centre, starts = bounds.mean(0), []
    for turn in _turns():
        turned = points @ turn.T
        starts.append(pose.from_rotation(turn, centre - (turned.min(0) + turned.max(0)) / 2))
    fitted: list[tuple[float, Array]] = []
    for count, iterations in _SEARCH:
        some = _thinned(points, count)
        fitted = [
            (_mean_distance(some, distances, moved), moved)
            for moved in (best_fit(some, distances, start, iterations) for start in starts)
        ]
        fitted.sort(key=lambda one: one[0])
        starts = [moved for _, moved in fitted[:_BEST_STARTS]]
    return fitted[0][1], fitted[0][0]


def _turns() -> list[Array]:
    """The 24 rotations of a cube, and those turned further by 45 deg about each axis: (3, 3) each."""
    signed = [
        np.eye(3)[list(order)] * signs for order in permutations(range(3)) for signs in product((1, -1), repeat=3)
    ]
    cube = [rotation for rotation in signed if np.linalg.det(rotation) > 0]
    between = [np.eye(3), *(pose.rotation_about(axis, np.pi / 4) for axis in range(3))]
    return [turn @ rotation for turn in between for rotation in cube]


def _mean_distance(points: Array, distances: Distances, moved: Array) -> float:
    return float(np.abs(distances(pose.transform_points(moved, points))[0]).mean())


def _thinned(points: Array, count: int) -> Array:
    return points[:: max(1, len(points) // count)]


def _mm(metres: float) -> str:
    return f"{1e3 * metres:.3g} mm"


def best_fit(points: Array, distances: Distances, start: Array | None = None, iterations: int = _ITERATIONS) -> Array:
    """Pose (4, 4) that moves points (n, 3) onto a surface: least sum of squared distances, without outliers.

    Points that are farther than 5 robust standard deviations (of the median) away are not used. `start` is the pose
    (4, 4) to begin with, by default that of the points.

    Raises `FitError` with fewer than six points.
    """
    if len(points) < _LEAST_POINTS:
        raise FitError(f"best fit: {len(points)} points; at least {_LEAST_POINTS} are needed")
    some = _thinned(points, MOST_POINTS)
    moved = np.eye(4) if start is None else start
    for _ in range(iterations):
        now = pose.transform_points(moved, some)
        signed, normal = distances(now)
        step, size = _step(now, signed, normal)
        moved = step @ moved
        if size < _SETTLED:
            break
    return moved


def _step(points: Array, signed: Array, normal: Array) -> tuple[Array, float]:
    """Pose (4, 4) of one least-squares step, and how far it moves the points, m."""
    size = np.abs(signed)
    kept = size <= max(_OUTLIER * 1.4826 * float(np.median(size)), _FLOOR)
    centre = points[kept].mean(0)
    arm = points[kept] - centre
    length = float(np.sqrt(np.square(arm).sum(1).mean())) or 1.0
    jacobian = np.hstack([normal[kept], np.cross(arm / length, normal[kept])])
    solution = np.linalg.lstsq(jacobian, -signed[kept], rcond=_UNDETERMINED)[0]
    rotation = pose.exp_rotation(solution[3:] / length)
    step = pose.from_rotation(rotation, centre + solution[:3] - rotation @ centre)
    return step, float(np.abs(solution).max())


def datum_fit(regions: Sequence[tuple[DatumPlane, Array]], least: int = 3) -> Array:
    """Pose (4, 4) that brings up to three fitted planes onto the nominal ones, in order of precedence (ISO 5459).

    The primary plane fixes two rotations and its offset, the secondary the third rotation and its offset, the tertiary
    the last offset. Motions that fewer planes leave free stay as small as possible.

    Raises `FitError` if there are too few or too many planes, they are nearly parallel, or one has too few points.

    Parameters
    ----------
    regions
        Nominal planes, and the points (n, 3), m, measured on each.
    least
        Number of planes that are needed.
    """
    if not least <= len(regions) <= 3:
        raise FitError(f"datum: {len(regions)} planes; three are needed, none of them parallel")
    nominal = np.stack([plane.normal for plane, _ in regions])
    if np.prod(np.linalg.svd(nominal, compute_uv=False)) < _PARALLEL:
        raise FitError("datum: the planes do not meet in a point; planes of three directions are needed")
    fitted = [fit_plane(points) for _, points in regions]
    measured = np.stack([fit.normal * np.sign(fit.normal @ n) for fit, n in zip(fitted, nominal, strict=True)])
    rotation = _axes(nominal) @ _axes(measured).T if len(regions) > 1 else _shortest_turn(measured[0], nominal[0])
    centroids = np.stack([fit.point for fit in fitted])
    centre = centroids.mean(0)  # which moves as little as the planes allow
    turned = centre + (centroids - centre) @ rotation.T
    offsets = [(plane.point - at) @ plane.normal for (plane, _), at in zip(regions, turned, strict=True)]
    moved = np.linalg.lstsq(nominal, np.array(offsets))[0]
    return pose.from_rotation(rotation, centre - rotation @ centre + moved)


def _shortest_turn(source: Array, target: Array) -> Array:
    """Rotation (3, 3) by the smallest angle that turns one unit vector (3,) into another less than 90 deg from it."""
    axis = np.cross(source, target)
    sine = float(np.linalg.norm(axis))
    return np.asarray(pose.exp_rotation(axis / sine * np.arcsin(min(sine, 1.0)))) if sine > 0 else np.eye(3)


def _axes(normals: Array) -> Array:
    """Axes (3, 3) as columns: the first normal, the second made perpendicular to it, and their cross product."""
    first = normals[0]
    second = normals[1] - (normals[1] @ first) * first
    second = second / np.linalg.norm(second)
    return np.stack([first, second, np.cross(first, second)], 1)
