"""Views of the part: motions of the sensor past it, and the samples of its surface that they see.

All poses are in the frame of the table at angle 0 (origin on the top face, z along the axis), in which the part rests:
a turn of the table counts as a turn of the sensor the other way. Where the arm holds the part before a sensor on a
post, the flange takes the place of the table here and in all that is made of views.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from scancell.arrays import Array, Flags
from scancell.errors import PlanningError
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh, sample_surface
from scancell.planning.model import SensorRange
from scancell.planning.options import Spacing

# At grazing incidence the stripe is wide and dim: up to 78 degrees from the normal it is usable.
MIN_COSINE = float(np.cos(np.radians(78)))


@dataclass(frozen=True)
class Surface:
    """Surface samples in the frame of the table at angle 0, m.

    Attributes
    ----------
    points, normals
        (n, 3) points of equal area shares and their unit normals.
    extremes
        (m, 3) sample points and mesh vertices, thinned to one per 0.5 mm cube: the extent of the part.
    """

    points: Array
    normals: Array
    extremes: Array

    def turned(self, angle: float) -> Surface:
        """The surface rotated by `angle` (rad) about the table's axis."""
        rotation = pose.rotation_about(2, angle)
        return Surface(self.points @ rotation.T, self.normals @ rotation.T, self.extremes @ rotation.T)


def sample_part(part: Mesh, table_from_part: Array, count: int = 12_000) -> Surface:
    """Area-stratified samples of the part (mesh in the part frame, m), the same for the same mesh.

    Normals of a closed mesh point outwards, whatever its winding; an open mesh is sampled on both sides.

    Parameters
    ----------
    table_from_part
        (4, 4) pose of the part on the table at angle 0.
    count
        Number of samples; an open mesh gets twice as many.
    """
    points, face = sample_surface(part, count, seed=0)
    normals = part.normals[face]
    # The area vectors of a closed surface cancel; their moment is three times its volume.
    area_vector = part.normals * part.areas[:, None]
    if np.linalg.norm(area_vector.sum(0)) > 1e-3 * part.areas.sum():
        points, normals = np.concatenate([points, points]), np.concatenate([normals, -normals])
    elif (area_vector * (part.vertices[part.faces[:, 0]] - part.bounds.mean(0))).sum() < 0:
        normals = -normals
    extremes = part.vertices[np.unique(part.faces)]
    points, extremes = (pose.transform_points(table_from_part, p) for p in (points, extremes))
    return Surface(points, normals @ table_from_part[:3, :3].T, _thinned(np.concatenate([extremes, points])))


def _thinned(points: Array, grid: float = 5e-4) -> Array:
    """The first of the points (n, 3) in each cube of edge length `grid` (m)."""
    cell = np.floor((points - points.min(0)) / grid).astype(np.int64)
    size = cell.max(0) + 1
    _, first = np.unique((cell[:, 0] * size[1] + cell[:, 1]) * size[2] + cell[:, 2], return_index=True)
    return np.asarray(points[first])


def lit_cosine(sensor_range: SensorRange, table_from_sensor: Array, points: Array, normals: Array) -> Array:
    """Cosine (n,) of the laser's angle of incidence at points (n, 3), 0 where the sensor does not see them.

    `table_from_sensor` (4, 4) or (n, 4, 4), m, has each point in the laser sheet: its x in the sensor frame is ignored;
    NaN where there is no such pose. A point is seen if it lies in the measuring range and at least one camera sees its
    front side at an angle up to 78 degrees. Occlusion is ignored.
    """
    rotation, origin = table_from_sensor[..., :3, :3], table_from_sensor[..., :3, 3]
    at = np.einsum("...ij,...i->...j", rotation, points - origin)
    normal = np.einsum("...ij,...i->...j", rotation, normals)
    y, z = at[:, 1], at[:, 2]
    in_sheet = np.stack([np.zeros_like(y), y, z], -1)
    cosine = -(normal * in_sheet).sum(-1) / np.maximum(np.linalg.norm(in_sheet, axis=-1), 1e-12)
    seen = np.zeros(len(points), bool)
    for camera in sensor_range.cameras:
        ray = camera - in_sheet
        seen |= (normal * ray).sum(-1) > MIN_COSINE * np.linalg.norm(ray, axis=-1)
    return np.where(seen & sensor_range.contains(y, z), np.maximum(cosine, 0.0), 0.0)


def crossing_angles(points: Array, offset: float) -> Array:
    """Table angles (2, n), rad, that move points (n, 3) into the plane y = `offset` (m).

    A point crosses the plane twice per turn: first at x > 0, on the sensor's side, and then at x < 0. NaN for points
    nearer to the axis than `offset`.
    """
    radius = np.hypot(points[:, 0], points[:, 1])
    with np.errstate(invalid="ignore", divide="ignore"):
        near = np.arcsin(offset / radius) if offset else np.zeros_like(radius)
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    return np.stack([near, np.pi - near]) - azimuth


class View(Protocol):
    """A way to move the sensor past the part. `crossings` decides what it sees."""

    @property
    def name(self) -> str:
        """Name in messages."""

    def exposures(self, spacing: Spacing) -> float:
        """Number of exposures at a spacing."""

    def crossings(self, points: Array) -> Array:
        """``table_from_sensor`` (k, n, 4, 4), m, when the laser sheet passes over each of the points (n, 3).

        NaN where it does so less than k times.
        """


def seen_by(views: Iterable[View], sensor_range: SensorRange, part: Surface) -> Flags:
    """Whether any of the views sees each surface sample (n,), occlusion ignored."""
    seen = np.zeros(len(part.points), bool)
    for view in views:
        for at in view.crossings(part.points):
            seen |= lit_cosine(sensor_range, at, part.points, part.normals) > MIN_COSINE
    return seen


@dataclass(frozen=True)
class Sweep:
    """A full turn of the table under a stationary sensor.

    `at_azimuth_zero` (4, 4) is ``table_from_sensor`` looking along -x at `target` (3,), m, with the laser sheet in a
    plane of constant y. Rotated about the table's axis it gives the same scan. `elevation` is in rad.
    """

    name: str
    at_azimuth_zero: Array
    target: Array
    elevation: float

    def at(self, azimuth: float, roll: float) -> Array:
        """``table_from_sensor`` (4, 4) at an azimuth (rad); `roll` (0 or pi) rotates the sensor about its Z axis."""
        turn = pose.from_rotation(pose.rotation_about(2, azimuth))
        return np.asarray(turn @ self.at_azimuth_zero @ pose.from_rotation(pose.rotation_about(2, roll)))

    def exposures(self, spacing: Spacing) -> float:
        """Number of exposures at a spacing."""
        count = 2 * np.pi / spacing.angle
        return float(np.floor(count + 1e-9)) if spacing.is_least_angle else count

    def crossings(self, points: Array) -> Array:
        """``table_from_sensor`` (2, n, 4, 4) at both crossings of the sheet, see `View`."""
        angle = crossing_angles(points, float(self.at_azimuth_zero[1, 3]))
        c, s = np.cos(angle)[..., None], np.sin(angle)[..., None]
        x, y, z, w = self.at_azimuth_zero
        result = np.empty((*angle.shape, 4, 4))
        # Rz(-angle) @ at_azimuth_zero, row by row.
        result[..., 0, :], result[..., 1, :] = c * x + s * y, c * y - s * x
        result[..., 2, :], result[..., 3, :] = z, w
        return result

    @property
    def lever(self) -> float:
        """Distance of the sensor from the axis of the table, m."""
        return float(np.hypot(*self.at_azimuth_zero[:2, 3]))

    def moved(self, elevation_change: float, distance_change: float) -> Sweep:
        """The sweep of the same target from a larger elevation (by rad) or a larger distance (by m)."""
        distance = float(np.linalg.norm(self.at_azimuth_zero[:3, 3] - self.target)) + distance_change
        elevation = self.elevation + elevation_change
        further = f"from {1e3 * distance_change:.0f} mm farther"
        how = further if distance_change else f"raised to {np.degrees(elevation):.0f} deg"
        return Sweep(f"{self.name}, {how}", sweep_pose(self.target, elevation, distance), self.target, elevation)


@dataclass(frozen=True)
class Pass:
    """A straight pass of the sensor, moving perpendicular to its laser sheet.

    `start` and `end` (4, 4) are ``table_from_sensor`` of the same orientation; travel is along the sensor's X.
    """

    name: str
    start: Array
    end: Array

    def at(self, path: Array) -> Array:
        """Sensor poses (n, 4, 4) at path coordinates (n,), m from the start; extrapolated beyond both ends."""
        return pose.interpolate_straight(self.start, self.end, path / self.length)

    def exposures(self, spacing: Spacing) -> float:
        """Number of exposures at a spacing."""
        count = self.length / spacing.pitch + 1
        return float(np.floor(count + 1e-9)) if spacing.is_least_pitch else count

    def crossings(self, points: Array) -> Array:
        """``table_from_sensor`` (1, n, 4, 4) where the pass is abreast of the points, see `View`."""
        travel = self.end[:3, 3] - self.start[:3, 3]
        share = (points - self.start[:3, 3]) @ travel / (travel @ travel)
        share[(share < 0.0) | (share > 1.0)] = np.nan
        return pose.from_rotation(self.start[:3, :3], self.start[:3, 3] + share[:, None] * travel)[None]

    @property
    def length(self) -> float:
        """Distance between the first and the last exposure, m."""
        return float(np.linalg.norm(self.end[:3, 3] - self.start[:3, 3]))


@dataclass(frozen=True)
class Turn:
    """A full turn of the table past a sensor in any pose.

    `table_from_sensor` (4, 4) is its pose at one angle of the table, m.
    """

    table_from_sensor: Array

    def crossings(self, points: Array) -> Array:
        """``table_from_sensor`` (2, n, 4, 4) at both crossings of the sheet, see `View`."""
        normal, origin = self.table_from_sensor[:3, 0], self.table_from_sensor[:3, 3]
        radius = np.hypot(points[:, 0], points[:, 1]) * np.hypot(normal[0], normal[1])
        with np.errstate(invalid="ignore", divide="ignore"):
            near = np.arccos((normal @ origin - points[:, 2] * normal[2]) / radius)
        azimuth = np.arctan2(points[:, 1], points[:, 0]) - np.arctan2(normal[1], normal[0])
        turn = pose.from_rotation(pose.rotation_about(2, azimuth - np.stack([near, -near])))
        return np.asarray(turn @ self.table_from_sensor)


@dataclass(frozen=True)
class Shift:
    """A straight motion of a sensor in any direction, from `start` to `end` (4, 4) of the same orientation, m."""

    start: Array
    end: Array

    def crossings(self, points: Array) -> Array:
        """``table_from_sensor`` (1, n, 4, 4) where the sheet passes over the points, see `View`."""
        normal, travel = self.start[:3, 0], self.end[:3, 3] - self.start[:3, 3]
        with np.errstate(invalid="ignore", divide="ignore"):
            share = (points - self.start[:3, 3]) @ normal / (travel @ normal)
        share[~((share >= 0.0) & (share <= 1.0))] = np.nan
        return pose.from_rotation(self.start[:3, :3], self.start[:3, 3] + share[:, None] * travel)[None]


def sweep_pose(target: Array, elevation: float, distance: float) -> Array:
    """``table_from_sensor`` (4, 4) at azimuth 0 that looks at `target` (3,) from `distance` (m), sheet vertical."""
    rotation = pose.looking_from(0.0, elevation)
    return pose.from_rotation(rotation, target - distance * rotation[:, 2])


def exposure_counts(views: Sequence[View], spacing: Spacing, max_profiles: int) -> list[int]:
    """Number of exposures of each view: at the requested spacing, or thinned by one factor to `max_profiles` in total.

    Raises `PlanningError` if `max_profiles` is less than two per view.
    """
    requested = [view.exposures(spacing) for view in views]

    def counts(factor: float) -> list[int]:
        return [max(2, int(np.ceil(r / factor - 1e-9))) for r in requested]

    if 2 * len(views) > max_profiles:
        raise PlanningError(
            f"{len(views)} views need two exposures each",
            key="scan.max_profiles",
            value=max_profiles,
            expected=f"at least {2 * len(views)}",
        )
    factor = max(1.0, sum(counts(1.0)) / max_profiles)
    while sum(counts(factor)) > max_profiles:
        factor *= 1.005
    return counts(factor)
