"""Alignment of a cloud to a nominal surface: none, best fit, or to datum planes.

Best fit minimises the squared signed distances of the points (point-to-surface ICP): each step is a least-squares
problem in a small rotation and translation, in which the distance of a point changes along its gradient: the normal of
the surface (Chen and Medioni, 1992), or the direction from an edge beyond which the point lies. Motions that the
surface does not determine, such as those of a plane in itself, stay zero.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import permutations, product
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from scancell.arrays import Array
from scancell.config.choices import Align
from scancell.errors import DescriptionError, FitError
from scancell.geometry import pose
from scancell.geometry.fits import fit_plane

# Signed distances (n,), m, of points (n, 3) from a surface, and their gradients (n, 3), unit vectors.
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
_BEST_STARTS = 8
_HOPELESS = 30.0  # mean distances in terms of the least one from which starts are not followed
_SAME = 0.02  # diagonals of the surface by which poses move its corners from which on they are different ones
_TURN = np.radians(15.0)  # between starts about one axis
_DIGITS = 9  # of mm and deg
_FREE = 1e-3  # component along a coordinate of a motion that the surface does not determine, from which it is unknown
_POSE = (*(("x", "mm", 1e3), ("y", "mm", 1e3), ("z", "mm", 1e3)), *((f"r{axis}", "deg", 180 / np.pi) for axis in "xyz"))


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
    found, turned = _search(some, distances, bounds, _turned_starts(some, bounds, _turns()))[0]
    if found < _BETTER * rest:
        angle = np.degrees(np.linalg.norm(pose.log_rotation(turned[:3, :3])))
        warnings.append(
            f"best fit: a mean distance of {_mm(rest)} remains from the given pose, {_mm(found)} from another start, "
            f"which is used: it turns the cloud by {angle:.0f} deg"
        )
        start, rest = turned, found
    mirror = np.diag([-1.0, 1.0, 1.0])
    mirrored = np.inf
    if rest > _WELL_FITTED * size:
        image = some @ mirror
        mirrored = _search(image, distances, bounds, _turned_starts(image, bounds, _turns()))[0][0]
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


def _search(points: Array, distances: Distances, bounds: Array, starts: list[Array]) -> list[tuple[float, Array]]:
    """Mean distances, m, and poses (4, 4) of the best fits from several starts, best first, of different poses.

    All points take part, so that few of them on the sides of a part tell where its large flat faces lie.
    """
    corners = np.stack(np.meshgrid(*bounds.T), -1).reshape(-1, 3)
    away = _SAME * float(np.linalg.norm(bounds[1] - bounds[0]))
    found: list[tuple[float, Array]] = []
    for count, iterations in _SEARCH:
        some = _thinned(points, count)
        if found:  # starts that do not come near the surface are not followed
            limit = max(_HOPELESS * found[0][0], _WELL_FITTED * float(np.linalg.norm(bounds[1] - bounds[0])))
            starts = [moved for mean, moved in found[:_BEST_STARTS] if mean <= limit]
        fitted = [
            (_mean_distance(some, distances, moved), moved)
            for moved in (best_fit(some, distances, start, iterations, np.inf) for start in starts)
        ]
        fitted.sort(key=lambda one: one[0])
        found = []
        for one in fitted:
            if all(_largest_motion(corners, one[1], other) > away for _, other in found):
                found.append(one)
    return found


def _largest_motion(corners: Array, one: Array, other: Array) -> float:
    """Largest distance (m) of corners (n, 3) of the surface by the points that two poses (4, 4) bring there."""
    moved = pose.transform_points(other @ pose.inverse(one), corners)
    return float(np.linalg.norm(moved - corners, axis=1).max())


def _turned_starts(points: Array, bounds: Array, turns: Sequence[Array], along: Array | None = None) -> list[Array]:
    """Poses (4, 4) that turn points (n, 3) and move the middle of their bounds to that of the surface, not `along`."""
    centre, starts = bounds.mean(0), []
    for turn in turns:
        turned = points @ turn.T
        move = centre - (turned.min(0) + turned.max(0)) / 2
        if along is not None:
            move = move - (move @ along) * along
        starts.append(pose.from_rotation(turn, move))
    return starts


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


def best_fit(
    points: Array,
    distances: Distances,
    start: Array | None = None,
    iterations: int = _ITERATIONS,
    outlier: float = _OUTLIER,
) -> Array:
    """Pose (4, 4) that moves points (n, 3) onto a surface: least sum of squared distances, without outliers.

    Points that are farther than `outlier` robust standard deviations (of the median) away are not used. `start` is the
    pose (4, 4) to begin with, by default that of the points.

    Raises `FitError` with fewer than six points.
    """
    if len(points) < _LEAST_POINTS:
        raise FitError(f"best fit: {len(points)} points; at least {_LEAST_POINTS} are needed")
    some = _thinned(points, MOST_POINTS)
    moved = np.eye(4) if start is None else start
    for _ in range(iterations):
        now = pose.transform_points(moved, some)
        signed, normal = distances(now)
        step, size = _step(now, signed, normal, outlier)
        moved = step @ moved
        if size < _SETTLED:
            break
    return moved


def _step(points: Array, signed: Array, normal: Array, outlier: float) -> tuple[Array, float]:
    """Pose (4, 4) of one least-squares step, and how far it moves the points, m."""
    kept = _kept(signed, outlier)
    centre = points[kept].mean(0)
    jacobian, length = _jacobian(points[kept] - centre, normal[kept])
    solution = np.linalg.lstsq(jacobian, -signed[kept], rcond=_UNDETERMINED)[0]
    rotation = pose.exp_rotation(solution[3:] / length)
    step = pose.from_rotation(rotation, centre + solution[:3] - rotation @ centre)
    return step, float(np.abs(solution).max())


def _kept(signed: Array, outlier: float) -> NDArray[np.bool_]:
    """Whether points (n,) at these distances are within `outlier` robust standard deviations, of the median."""
    size = np.abs(signed)
    if np.isinf(outlier):
        return np.ones(len(size), bool)
    return np.asarray(size <= max(outlier * 1.4826 * float(np.median(size)), _FLOOR))


def _jacobian(arm: Array, normal: Array) -> tuple[Array, float]:
    """Derivatives (n, 6) of distances by a translation and, in lengths of the arms (n, 3), a rotation; this length."""
    length = float(np.sqrt(np.square(arm).sum(1).mean())) or 1.0
    return np.hstack([normal, np.cross(arm / length, normal)]), length


@dataclass(frozen=True, eq=False)
class PartPlacement:
    """Pose of a part on what carries it, found by the best fit of its surface to measured points.

    Attributes
    ----------
    support
        Frame of what carries the part: ``table``, ``conveyor[1]`` … with the belt at the start, or the flange's link.
    support_from_part
        (4, 4) the pose found.
    covariance
        (6, 6) of the translation of the part's origin, m, and the rotation vector, rad, both along the axes of the
        support, by the scatter of the distances alone; 0 of what the points do not determine.
    determined
        (6,) whether the points determine these coordinates.
    rms, count
        Root mean square, m, of the distances of the points without outliers, and their number.
    others
        Other poses (4, 4) in which the part fits nearly as well: it is symmetric as far as it was seen.
    well_fitted
        Whether the mean distance is as small as noise and tolerances of a measured part explain.
    """

    support: str
    support_from_part: Array
    covariance: Array
    determined: NDArray[np.bool_]
    rms: float
    count: int
    others: tuple[Array, ...]
    well_fitted: bool

    @property
    def sigmas(self) -> Array:
        """Standard deviations (6,), m and rad; NaN of what the points do not determine."""
        return np.where(self.determined, np.sqrt(np.diag(self.covariance)), np.nan)

    def as_json(self) -> dict[str, Any]:
        """Poses with keys as in descriptions, standard deviations and figures, as plain data."""
        sigmas = {
            f"{name}_{unit}": None if np.isnan(sigma) else scale * float(sigma)
            for (name, unit, scale), sigma in zip(_POSE, self.sigmas, strict=True)
        }
        return {
            "frame": self.support,
            "pose": pose_values(self.support_from_part),
            "standard_deviation": sigmas,
            "covariance_si": self.covariance.tolist(),
            "rms_um": 1e6 * self.rms,
            "points": self.count,
            "is_ambiguous": bool(self.others),
            "others": [pose_values(other) for other in self.others],
        }

    def text(self) -> str:
        """The pose, with standard deviations in brackets, as a line."""
        values, small = pose_values(self.support_from_part), {"mm": "um", "deg": "mdeg"}
        parts = []
        for (name, unit, scale), sigma in zip(_POSE, self.sigmas, strict=True):
            value, spread = f"{name} {values[f'{name}_{unit}']:.4f} {unit}", f"{1e3 * scale * sigma:.3f} {small[unit]}"
            parts.append(f"{value} ({'not determined' if np.isnan(sigma) else spread})")
        return f"part on {self.support}: {', '.join(parts)}"

    @property
    def warnings(self) -> list[str]:
        """Warnings about a poor or ambiguous fit."""
        found = []
        if not self.well_fitted:
            found.append(
                f"pose of the part: an RMS distance of {_mm(self.rms)} remains from all starts: are these points of "
                "the part, and of it alone?"
            )
        if self.others:
            turns = [pose.log_rotation(self.support_from_part[:3, :3].T @ other[:3, :3]) for other in self.others]
            angles = ", ".join(f"{np.degrees(np.linalg.norm(turn)):.1f}" for turn in turns)
            found.append(
                f"pose of the part: it fits nearly as well in {len(self.others)} other poses, turned by {angles} deg: "
                "by the surface that was seen it is symmetric, and its pose is one of these"
            )
        return found


def pose_values(matrix: Array) -> dict[str, float]:
    """A pose (4, 4) with the keys of descriptions, ``x_mm`` … ``rz_deg``."""
    values = [*1e3 * matrix[:3, 3], *np.degrees(pose.euler_xyz_from_rotation(matrix[:3, :3]))]
    return {
        f"{name}_{unit}": round(float(value), _DIGITS) + 0.0
        for (name, unit, _), value in zip(_POSE, values, strict=True)
    }


def place_part(
    points_on_support: Array, distances: Distances, bounds: Array, support: str, nominal: Array
) -> PartPlacement:
    """The pose of a part on its support by points (n, 3) of its surface, from turns about the support's z.

    Where none of them fits, other faces may be down: all turns of a cube, and those between, are tried.

    Raises `FitError` with fewer than six points.

    Parameters
    ----------
    distances, bounds
        Of the surface in the part frame; (2, 3) its lower and upper corner.
    support, nominal
        Name of the frame of the support; pose (4, 4) of the part there, from which the turns start.
    """
    if len(points_on_support) < _LEAST_POINTS:
        raise FitError(f"pose of the part: {len(points_on_support)} points; at least {_LEAST_POINTS} are needed")
    points = pose.transform_points(pose.inverse(nominal), points_on_support)
    size, up = float(np.linalg.norm(bounds[1] - bounds[0])), nominal[2, :3]
    some = _thinned(points, _SEARCH[-1][0])
    about = [pose.exp_rotation(angle * up) for angle in np.arange(0.0, 2 * np.pi - 1e-9, _TURN)]
    found = _search(some, distances, bounds, _turned_starts(some, bounds, about, up))
    if found[0][0] > _WELL_FITTED * size:
        starts = [*_turned_starts(some, bounds, _turns()), *(moved for _, moved in found[:_BEST_STARTS])]
        found = _search(some, distances, bounds, starts)
    best = found[0][0]
    moved = best_fit(points, distances, found[0][1])
    others = [best_fit(some, distances, other) for mean, other in found[1:] if _BETTER * mean <= best]
    at = _thinned(pose.transform_points(moved, points), MOST_POINTS)
    signed, normal = distances(at)
    kept = _kept(signed, _OUTLIER)
    jacobian, length = _jacobian(at[kept], normal[kept])
    variance = float(np.square(signed[kept]).sum()) / max(int(kept.sum()) - 6, 1)
    values, vectors = np.linalg.eigh(jacobian.T @ jacobian)
    known = values > _UNDETERMINED**2 * values[-1]
    turned = np.zeros((6, 6))
    support_from_part = np.asarray(nominal @ pose.inverse(moved))
    turned[:3, :3] = turned[3:, 3:] = support_from_part[:3, :3]
    scale = np.array([1.0] * 3 + [1.0 / length] * 3)
    axes = turned @ vectors
    covariance = variance * (axes[:, known] / values[known]) @ axes[:, known].T
    return PartPlacement(
        support=support,
        support_from_part=support_from_part,
        covariance=covariance * np.outer(scale, scale),
        determined=np.abs(axes[:, ~known]).max(1, initial=0.0) < _FREE,
        rms=float(np.sqrt(np.square(signed[kept]).mean())),
        count=int(kept.sum()),
        others=tuple(np.asarray(nominal @ pose.inverse(other)) for other in others),
        well_fitted=best <= _WELL_FITTED * size,
    )


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
