"""The laser as a picture shows it: the stripe where its sheet meets surfaces, and a faint veil where it passes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scancell.config.sensor import SensorDescription
from scancell.geometry import pose

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_LEAST_PX = 1.5  # half width of the drawn stripe at least, or it would break up into dots


@dataclass(frozen=True)
class LaserSheet:
    """A switched-on laser: the sheet x = 0 of the sensor frame, |y| <= `slope` * (z - `source_z`).

    Lengths in m. `half_width` is that of the stripe; pictures widen it to about a pixel. `far` is the end of the
    measuring range; light is drawn up to ten times as far. Curvature and misalignment of the sheet are too small to be
    seen in a picture of the cell and are left out.
    """

    world_from_sensor: Array
    source_z: float
    slope: float
    half_width: float
    far: float

    @property
    def source(self) -> Array:
        """Position (3,) of the source in the world, m."""
        return np.asarray(self.world_from_sensor[:3, 3] + self.source_z * self.world_from_sensor[:3, 2])

    def stripe(self, eye: Array, directions: Array, depth: Array, focal_px: float) -> tuple[Index, Array]:
        """Where the stripe is seen, shadows left aside: rows (k,) of rays and its brightness (k,), 0 to 1, there.

        Rays (n, 3) from `eye` (3,) meet surfaces at multiples `depth` (n,) of their directions, infinite for none;
        `focal_px` gives the width of a pixel there.
        """
        start, normal = self._across(eye)
        x = np.abs(start + np.where(np.isfinite(depth), depth, 0.0) * (directions @ normal))
        half = np.maximum(self.half_width, (_LEAST_PX / focal_px) * depth)
        rows = np.flatnonzero((x < 1.5 * half) & np.isfinite(depth))
        rows = rows[self._distance(eye + depth[rows, None] * directions[rows]) > 0]
        return rows, np.clip(1.5 - x[rows] / half[rows], 0.0, 1.0)

    def veil(self, eye: Array, directions: Array, depth: Array) -> tuple[Index, Array, Array]:
        """Where the sheet is seen before surfaces, shadows left aside; rays as for `stripe`.

        Returns rows (k,) of rays, the points (k, 3) where they cross it, and how much light (k,) is left of 1: it thins
        out from a quarter of the measuring range on.
        """
        start, normal = self._across(eye)
        with np.errstate(divide="ignore", invalid="ignore"):
            t = -start / (directions @ normal)
        rows = np.flatnonzero((t > 0) & (t < depth))
        points = eye + t[rows, None] * directions[rows]
        distance = self._distance(points)
        kept = np.flatnonzero(distance > 0)
        return rows[kept], points[kept], np.minimum(1.0, 0.25 * self.far / distance[kept])

    def _across(self, eye: Array) -> tuple[float, Array]:
        """Sensor x of the eye, and the direction (3,) in the world in which it grows."""
        normal = self.world_from_sensor[:3, 0]
        return float((eye - self.world_from_sensor[:3, 3]) @ normal), normal

    def _distance(self, points: Array) -> Array:
        """Distance (n,) along sensor z from the source of world points (n, 3) between the ends of the fan, else 0."""
        _, y, z = pose.transform_points(pose.inverse(self.world_from_sensor), points).T
        ahead = z - self.source_z
        return np.where((ahead <= 10 * self.far) & (np.abs(y) <= self.slope * ahead), ahead, 0.0)


def laser_sheet(sensor: SensorDescription, world_from_sensor: Array) -> LaserSheet:
    """The sheet of a described sensor at a pose (4, 4)."""
    laser = sensor.laser
    source = 1e-3 * laser.source_z_mm
    return LaserSheet(
        world_from_sensor,
        source,
        float(np.tan(np.radians(laser.fan_half_angle_deg))),
        2e-3 * laser.sheet_sigma_mm,
        1e-3 * sensor.range.far_mm,
    )
