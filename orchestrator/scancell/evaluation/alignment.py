"""Alignment of a cloud to a nominal surface: none, best fit, or to datum planes.

Best fit minimises the squared signed distances of the points (point-to-surface ICP): each step is a least-squares
problem in a small rotation and translation, in which the distance of a point changes along the normal of the surface
(Chen and Medioni, 1992). Motions that the surface does not determine, such as those of a plane in itself, stay zero.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scancell.errors import FitError
from scancell.geometry import pose
from scancell.geometry.fits import fit_plane

Array = NDArray[np.float64]

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


@dataclass(frozen=True)
class DatumPlane:
    """Nominal plane of a datum, m: a point (3,), the outward unit normal (3,)."""

    point: Array
    normal: Array


def best_fit(points: Array, distances: Distances) -> Array:
    """Pose (4, 4) that moves points (n, 3) onto a surface: least sum of squared distances, without outliers.

    Points that are farther than 5 robust standard deviations (of the median) away do not take part.

    Raises
    ------
    FitError
        With fewer than six points.
    """
    if len(points) < _LEAST_POINTS:
        raise FitError(f"best fit: {len(points)} points; at least {_LEAST_POINTS} are needed")
    some = points[:: max(1, len(points) // MOST_POINTS)]
    moved = np.eye(4)
    for _ in range(_ITERATIONS):
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


def datum_fit(regions: Sequence[tuple[DatumPlane, Array]]) -> Array:
    """Pose (4, 4) that brings three fitted planes onto the nominal ones, in order of precedence (ISO 5459).

    The primary plane fixes two rotations and its offset, the secondary the third rotation and its offset, the tertiary
    the last offset.

    Parameters
    ----------
    regions
        Nominal planes, and the points (n, 3), m, measured on each.

    Raises
    ------
    FitError
        If there are not three planes, they are nearly parallel, or one has too few points.
    """
    if len(regions) != 3:
        raise FitError(f"datum: {len(regions)} planes; three are needed, none of them parallel")
    nominal = np.stack([plane.normal for plane, _ in regions])
    if abs(np.linalg.det(nominal)) < _PARALLEL:
        raise FitError("datum: the three planes do not meet in a point; planes of three directions are needed")
    fitted = [fit_plane(points) for _, points in regions]
    measured = np.stack([fit.normal * np.sign(fit.normal @ n) for fit, n in zip(fitted, nominal, strict=True)])
    rotation = _axes(nominal) @ _axes(measured).T
    centroids = np.stack([fit.point for fit in fitted]) @ rotation.T
    offsets = [(plane.point - at) @ plane.normal for (plane, _), at in zip(regions, centroids, strict=True)]
    return pose.from_rotation(rotation, np.linalg.solve(nominal, offsets))


def _axes(normals: Array) -> Array:
    """Axes (3, 3) as columns: the first normal, the second made perpendicular to it, and their cross product."""
    first = normals[0]
    second = normals[1] - (normals[1] @ first) * first
    second = second / np.linalg.norm(second)
    return np.stack([first, second, np.cross(first, second)], 1)
