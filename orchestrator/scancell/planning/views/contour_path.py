"""Sensor paths around the contour of a part at one height: constant stand-off and incidence, from the mesh."""

from __future__ import annotations

import numpy as np
import trimesh
from numpy.typing import NDArray

from scancell.config.path import ContourDescription
from scancell.errors import PlanningError
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh

Array = NDArray[np.float64]

_STEP = 2e-3  # m between poses
_JOINED = 1e-6  # m: ends of segments of the section nearer than this are one point


def contour_poses(contour: ContourDescription, part: Mesh, standoff: float) -> Array:
    """Poses (n, 4, 4) in the part frame: once around the outermost contour, the laser line upright.

    The sensor looks at the contour against its outward normal, raised by the elevation. Normals are averaged along the
    contour, so that the sensor turns evenly around edges.

    Raises `PlanningError` if the height is not within the part, or the contour is more concave than the stand-off
    allows.
    """
    height = 1e-3 * contour.height_mm
    points = _outermost(part, height)
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    count = max(8, int(np.ceil(length[-1] / _STEP)))
    at = np.linspace(0.0, length[-1], count, endpoint=False)
    fine = np.stack([np.interp(at, length, points[:, k]) for k in (0, 1)], -1)
    tangent = np.roll(fine, -1, axis=0) - np.roll(fine, 1, axis=0)
    window = np.hanning(2 * max(1, round(1e-3 * contour.smoothing_mm / _STEP)) + 3)[1:-1]
    # Counterclockwise: the outward normal is to the right of the tangent.
    normal = _averaged(np.stack([tangent[:, 1], -tangent[:, 0]], -1), window)
    azimuth = np.arctan2(normal[:, 1], normal[:, 0])
    start = int(np.argmin(np.abs(np.angle(np.exp(1j * (azimuth - np.radians(contour.start_deg)))))))
    order = np.roll(np.arange(count), -start)
    order = np.append(order, order[0]) if contour.turns > 0 else np.append(order, order[0])[::-1]
    # Rolled by half a turn: the sensor's x points counterclockwise.
    looking = pose.looking_from(azimuth, np.radians(contour.elevation_deg))
    rotation = (looking @ np.diag([-1.0, -1.0, 1.0]))[order]
    target = np.column_stack([_averaged(fine, window / window.sum()), np.full(count, height)])[order]
    origin = target - standoff * rotation[:, :, 2]
    _refuse_loops(origin, target, contour)
    return pose.from_rotation(rotation, origin)


def _averaged(values: Array, window: Array) -> Array:
    """Weighted means (n, 2) of neighbours around a closed curve."""
    half = len(window) // 2
    around = np.concatenate([values[-half:], values, values[:half]]) if half else values
    return np.stack([np.convolve(around[:, k], window, mode="valid") for k in (0, 1)], -1)


def _refuse_loops(origin: Array, target: Array, contour: ContourDescription) -> None:
    """The sensor must go forward wherever the contour does."""
    forward = (np.diff(origin, axis=0) * np.diff(target, axis=0)).sum(1)
    if (forward < 0).any():
        x, y = 1e3 * target[int(np.argmin(forward)), :2]
        raise PlanningError(
            f"at ({x:.0f}, {y:.0f}) mm it is more concave than the stand-off allows",
            key="contour at height_mm",
            value=contour.height_mm,
            expected="a larger smoothing_mm or a smaller standoff_mm",
        )


def _outermost(part: Mesh, height: float) -> Array:
    """The closed contour (n, 2), counterclockwise, m, that encloses the largest area at a height of the part."""
    solid = trimesh.Trimesh(part.vertices, part.faces, process=False)
    pieces = trimesh.intersections.mesh_plane(solid, [0.0, 0.0, 1.0], [0.0, 0.0, height])[..., :2]
    loops = [loop for loop in _chained(pieces) if np.allclose(loop[0], loop[-1], atol=_JOINED)]
    if not loops:
        low, high = 1e3 * part.bounds[:, 2]
        raise PlanningError(
            f"the part has no closed contour there (it extends from {low:g} to {high:g} mm)",
            key="contour at height_mm",
            value=float(f"{1e3 * height:g}"),
        )
    areas = [_area(loop) for loop in loops]
    largest = int(np.argmax(np.abs(areas)))
    return loops[largest] if areas[largest] > 0 else loops[largest][::-1]


def _area(loop: Array) -> float:
    return float((loop[:-1, 0] * loop[1:, 1] - loop[1:, 0] * loop[:-1, 1]).sum() / 2)


def _chained(pieces: Array) -> list[Array]:
    """Curves (n, 2) of segments (k, 2, 2) that share ends."""
    keys = [[tuple(np.rint(end / _JOINED).astype(np.int64).tolist()) for end in piece] for piece in pieces]
    at_end: dict[tuple[int, ...], set[int]] = {}
    for number, (a, b) in enumerate(keys):
        if a != b:
            at_end.setdefault(a, set()).add(number)
            at_end.setdefault(b, set()).add(number)
    curves: list[Array] = []
    left = {number for number, (a, b) in enumerate(keys) if a != b}
    while left:
        number = min(left)
        side, curve = 0, [pieces[number][0]]
        while number in left:
            left.remove(number)
            curve.append(pieces[number][1 - side])
            key = keys[number][1 - side]
            following = min(at_end[key] & left, default=None)
            if following is None:
                break
            number, side = following, keys[following].index(key)
        curves.append(np.array(curve))
    return curves
