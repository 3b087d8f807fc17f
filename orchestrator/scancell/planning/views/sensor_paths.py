"""Sensor paths over the part: spirals, contours, straight legs between waypoints, recorded poses."""

from __future__ import annotations

import csv
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import numpy as np
import trimesh
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from scancell.arrays import Array
from scancell.config.description import PoseDescription, si_value
from scancell.config.scan import (
    ContourDescription,
    PathDescription,
    QualityDescription,
    SpiralDescription,
    WaypointDescription,
    WeightsDescription,
)
from scancell.config.sensor import USUAL_STANDOFF_MM
from scancell.errors import DescriptionError, PlanningError
from scancell.files import require_file
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh
from scancell.nominal.parts import pose_matrix
from scancell.planning.options import Spacing

_STEP = 2e-3  # m between poses
_JOINED = 1e-6  # m: ends of segments of the section nearer than this are one point

_COLUMNS = ("x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg")
_SPIRAL_STEP = np.radians(3.0)
_LONGEST = 100.0  # m
_CROSSING_STEP = 2e-3  # m along a path at which the distance of points from the laser sheet is evaluated
_SHEET = 3e-3  # m: surface this near to the laser sheet counts for the stand-off
_SMOOTHING = 10  # steps of a spiral on either side over which the stand-off is smoothed
_EXTRA_KNOTS = 6  # beyond either end of a path; what a spline does at a knot decays by 0.27 at each further one
_LEAST_STEP = 1e-6  # m: poses nearer than this count as one place


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
    half = 1e-3 * contour.smoothing_mm / _STEP
    if half > count / 4:
        raise PlanningError(
            f"the contour is {1e3 * length[-1]:.4g} mm long",
            key="contour.smoothing_mm",
            value=contour.smoothing_mm,
            expected=f"at most {250 * length[-1]:.4g}, a quarter of it",
        )
    window = np.hanning(2 * max(1, round(half)) + 3)[1:-1]
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
    """Raise `PlanningError` if the sensor would move backwards anywhere along the contour."""
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


@dataclass(frozen=True)
class SensorPath:
    """A smooth path of the sensor at constant speed.

    Attributes
    ----------
    name
                Name in messages.
    poses
        (n, 4, 4) ``table_from_sensor`` with the table at angle 0, m, n >= 2.
    speed
        Speed of the sensor's origin relative to the part, m/s.
    pitch
        Distance of the sensor's origin between exposures, m.
    weights, quality
        How motions along it are judged.
    axis
        Names of the axes that move along it.
    """

    name: str
    poses: Array
    speed: float
    pitch: float
    weights: WeightsDescription = field(default_factory=WeightsDescription)
    quality: QualityDescription = field(default_factory=QualityDescription)
    axis: tuple[str, ...] = ("table",)

    @property
    def knots(self) -> Array:
        """Distance (n,), m, of each pose from the first one along the straight lines between them."""
        return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(self.poses[:, :3, 3], axis=0), axis=1))])

    @property
    def length(self) -> float:
        """Distance from the first to the last pose, m."""
        return float(self.knots[-1])

    @property
    def count(self) -> int:
        """Number of exposures, the first one at the first pose."""
        return int(self.length / self.pitch + 1e-9) + 1

    def at(self, distance: Array) -> Array:
        """Poses (k, 4, 4) at distances (k,), m, from the start: splines, continued straight beyond both ends."""
        position, rotation = self._splines
        inside = np.clip(distance, position.x[0], position.x[-1])
        beyond = (distance - inside)[:, None]
        turned = rotation(inside) * Rotation.from_rotvec(beyond * rotation(inside, 1))
        return pose.from_rotation(turned.as_matrix(), position(inside) + beyond * position(inside, 1))

    @cached_property
    def _splines(self) -> tuple[CubicSpline, RotationSpline]:
        """Splines with a few knots on the straight continuations, too: without them the acceleration would jump."""
        knots, rotation = self.knots, Rotation.from_matrix(self.poses[:, :3, :3])
        of_ends = CubicSpline(knots, self.poses[:, :3, 3]), RotationSpline(knots, rotation)
        ends, steps = knots[[0, -1]], np.array([knots[0] - knots[1], knots[-1] - knots[-2]])
        number = np.arange(1, _EXTRA_KNOTS + 1)
        beyond = (steps[:, None] * number)[..., None]
        position = of_ends[0](ends)[:, None] + beyond * of_ends[0](ends, 1)[:, None]
        turns = [
            of_ends[1](end) * Rotation.from_rotvec(by * of_ends[1](end, 1))
            for end, by in zip(ends, beyond, strict=True)
        ]
        x = np.concatenate([(ends[0] + beyond[0, ::-1, 0]), knots, ends[1] + beyond[1, :, 0]])
        return (
            CubicSpline(x, np.concatenate([position[0, ::-1], self.poses[:, :3, 3], position[1]])),
            RotationSpline(x, Rotation.concatenate([turns[0][::-1], rotation, turns[1]])),
        )

    def exposures(self, spacing: Spacing) -> float:
        """Number of exposures: a path has a pitch of its own."""
        return self.count

    def crossings(self, points: Array) -> Array:
        """``table_from_sensor`` (k, n, 4, 4) where the laser sheet passes over the points, see `View`."""
        distance = np.linspace(0.0, self.length, max(2, int(np.ceil(self.length / _CROSSING_STEP)) + 1))
        poses = self.at(distance)
        beside = np.einsum("ni,mi->mn", points, poses[:, :3, 0]) - (poses[:, :3, 3] * poses[:, :3, 0]).sum(1)[:, None]
        step, point = np.nonzero((beside[:-1] > 0) != (beside[1:] > 0))
        before, after = beside[step, point], beside[step + 1, point]
        at = distance[step] + before / (before - after) * distance[1]
        # Number of each crossing among those of its point.
        order = np.argsort(point, kind="stable")
        number = np.arange(len(point)) - np.searchsorted(point[order], point[order])
        found = np.full((int(number.max(initial=0)) + 1, len(points), 4, 4), np.nan)
        found[number, point[order]] = self.at(at[order])
        return found


def sensor_paths(description: PathDescription, part: Mesh, table_from_part: Array) -> list[SensorPath]:
    """Paths of a description: one, or one for each leg between waypoints.

    Raises `DescriptionError` if a file of recorded poses is missing or malformed, naming file, line and column;
    `PlanningError` if a path has no length.
    """
    # `scan_options` has put in the stand-off of the sensor, if there is one.
    standoff = 1e-3 * (USUAL_STANDOFF_MM if description.standoff_mm == "sensor" else description.standoff_mm)
    if description.spiral is not None:
        legs = [_spiral(description.spiral, part, standoff)]
    elif description.contour is not None:
        legs = [contour_poses(description.contour, part, standoff)]
    elif description.waypoint:
        stops = [_looking(point, standoff) for point in description.waypoint]
        legs = [np.stack(ends) for ends in pairwise(stops)]
    else:
        legs = [recorded_poses(Path(str(description.recorded)))]
    made = []
    for number, leg in enumerate(legs, start=1):
        name = description.name if len(legs) == 1 else f"{description.name}, leg {number}"
        path = SensorPath(
            name,
            table_from_part @ _apart(leg, name),
            1e-3 * description.speed_mm_s,
            si_value(description, "pitch_mm"),
            description.weights,
            description.quality,
            description.axis,
        )
        if path.length < path.pitch:
            least = f"at least its pitch_mm = {1e3 * path.pitch:g}"
            raise PlanningError(f"{1e3 * path.length:g} mm long", key=name, expected=least)
        if path.length > _LONGEST:
            raise PlanningError(f"{path.length:.3g} m long", key=name, expected=f"at most {_LONGEST:g} m")
        made.append(path)
    return made


def recorded_poses(file: Path) -> Array:
    """``part_from_sensor`` (n, 4, 4), m, from a CSV file with the columns x_mm, y_mm, z_mm, rx_deg, ry_deg, rz_deg.

    Raises `DescriptionError` if the file is missing, lacks a column or holds fewer than two poses, or a value is not a
    finite number.
    """
    require_file(file)
    try:
        with file.open(newline="", encoding="utf-8") as stream:
            rows = list(csv.DictReader(stream))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise DescriptionError(f"cannot be read as CSV: {error}", file=file) from None
    if len(rows) < 2:
        raise DescriptionError(f"{len(rows)} poses", file=file, expected="at least two")
    poses = []
    for number, row in enumerate(rows, start=2):
        values = {}
        for name in _COLUMNS:
            try:
                values[name] = float(row[name])
            except (KeyError, TypeError, ValueError):
                raise DescriptionError(
                    file=file, key=f"line {number}, column '{name}'", value=row.get(name), expected="a number"
                ) from None
            if not np.isfinite(values[name]):
                raise DescriptionError(
                    file=file, key=f"line {number}, column '{name}'", value=row[name], expected="a finite number"
                )
        poses.append(pose_matrix(PoseDescription(**values)))
    return np.stack(poses)


def _apart(poses: Array, name: str) -> Array:
    """The poses without those at the position of the one before."""
    step = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    kept = poses[np.concatenate([[True], step > _LEAST_STEP])]
    if len(kept) < 2:
        raise PlanningError("all poses are at one position", key=name, expected="a path")
    return np.asarray(kept)


def _looking(point: WaypointDescription, standoff: float) -> Array:
    looking = pose.looking_from(np.radians(point.azimuth_deg), np.radians(point.elevation_deg))
    rotation = looking @ pose.rotation_about(2, np.radians(point.roll_deg))
    target = 1e-3 * np.array([point.x_mm, point.y_mm, point.z_mm])
    return np.asarray(pose.from_rotation(rotation, target - standoff * rotation[:, 2]))


def _spiral(spiral: SpiralDescription, part: Mesh, standoff: float) -> Array:
    """Poses (n, 4, 4) in the part frame."""
    turn = 2 * np.pi * spiral.turns
    fraction = np.linspace(0.0, 1.0, max(2, int(np.ceil(abs(turn) / _SPIRAL_STEP))) + 1)
    azimuth = np.radians(spiral.start_deg) + turn * fraction
    elevation = np.radians(np.interp(fraction, [0, 1], spiral.elevation_deg))
    rotation = pose.looking_from(azimuth, elevation)
    middle = 1e3 * float(part.bounds[:, 2].mean())
    height = 1e-3 * np.interp(fraction, [0, 1], spiral.height_mm or (middle, middle))
    radius = 1e-3 * np.interp(fraction, [0, 1], spiral.radius_mm or (0.0, 0.0))
    target = np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), height], -1)
    distance = np.full(len(fraction), standoff)
    if spiral.radius_mm is None:
        distance += _smoothed(np.array([_nearest(part, t, r) for t, r in zip(target, rotation, strict=True)]))
    return pose.from_rotation(rotation, target - distance[:, None] * rotation[:, :, 2])


def _nearest(part: Mesh, target: Array, rotation: Array) -> float:
    """Extent of the part towards the sensor from `target`, near the laser sheet, m."""
    at = (part.vertices - target) @ rotation
    in_sheet = np.abs(at[:, 0]) <= _SHEET
    return float(-at[in_sheet, 2].min(initial=0.0))


def _smoothed(depth: Array) -> Array:
    """Largest of the neighbours, then their mean: never much nearer than the stand-off, without jerks."""
    window = np.lib.stride_tricks.sliding_window_view
    largest = window(np.pad(depth, _SMOOTHING, mode="edge"), 2 * _SMOOTHING + 1).max(-1)
    weights = np.hanning(2 * _SMOOTHING + 3)[1:-1]
    return np.asarray(window(np.pad(largest, _SMOOTHING, mode="edge"), 2 * _SMOOTHING + 1) @ (weights / weights.sum()))
