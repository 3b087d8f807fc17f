"""Views of the part: what planning needs to know of a way to move the sensor past it.

All poses are in the frame of the table at angle 0 (origin on the top face, z along the axis), in which the part rests:
a turn of the table counts as a turn of the sensor the other way.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from scancell.errors import PlanningError
from scancell.geometry import pose
from scancell.planning.model import SensorRange
from scancell.planning.options import Spacing
from scancell.planning.views import surface
from scancell.planning.views.surface import MIN_COSINE, Surface

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]


class View(Protocol):
    """A way to move the sensor past the part. `crossings` decides what it sees."""

    @property
    def name(self) -> str:
        """Name for people."""

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
            seen |= surface.lit_cosine(sensor_range, at, part.points, part.normals) > MIN_COSINE
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
        return 2 * np.pi / spacing.angle

    def crossings(self, points: Array) -> Array:
        """``table_from_sensor`` (2, n, 4, 4) at both crossings of the sheet, see `View`."""
        angle = surface.crossing_angles(points, float(self.at_azimuth_zero[1, 3]))
        c, s = np.cos(angle)[..., None], np.sin(angle)[..., None]
        x, y, z, w = self.at_azimuth_zero
        result = np.empty((*angle.shape, 4, 4))
        # Rz(-angle) @ at_azimuth_zero, row by row.
        result[..., 0, :], result[..., 1, :] = c * x + s * y, c * y - s * x
        result[..., 2, :], result[..., 3, :] = z, w
        return result

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
        return self.length / spacing.pitch + 1

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
