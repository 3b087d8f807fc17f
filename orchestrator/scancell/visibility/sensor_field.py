"""The part of the laser sheet in which a sensor measures."""

from __future__ import annotations

import json
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.config.sensor import SensorDescription, sensor_json

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

POSITION_STEP = 5e-3
"""Distance between neighbouring points of a field, m."""


@dataclass(frozen=True)
class SensorOptics:
    """Where a sensor measures: within its range, the fan of its laser, and the image of a camera; sensor frame, m.

    Attributes
    ----------
    sensor
        Its range and cameras.
    source_z
        The laser's source is at (0, 0, source_z).
    fan
        Tangent of the half angle of the laser's fan.
    """

    sensor: sensor_rt.Sensor
    source_z: float
    fan: float

    @classmethod
    def of(cls, description: SensorDescription) -> SensorOptics:
        """The optics of a described sensor."""
        resolved = sensor_json(description, seed=0)
        sensor = sensor_rt.Sensor(json.dumps(resolved))
        laser = resolved["laser"]
        return cls(sensor, float(laser["source_z"]), float(np.tan(laser["fan_half_angle"])))

    @property
    def cameras(self) -> Array:
        """(cameras, 3) centres of projection."""
        return np.array([camera.sensor_from_camera[:3, 3] for camera in self.sensor.cameras])

    def contains(self, points_in_sheet: Array) -> Flags:
        """(n, cameras) whether points (n, 3) of the laser sheet are in range, in the fan and in a camera's image."""
        y, z = points_in_sheet[:, 1], points_in_sheet[:, 2]
        near, far = self.sensor.range
        # Rounding must not exclude points of a grid that ends at the limits.
        within = (z > near - 1e-12) & (z < far + 1e-12) & (np.abs(y) <= (z - self.source_z) * self.fan)
        return within[:, None] & np.stack([_in_image(camera, points_in_sheet) for camera in self.sensor.cameras], -1)


@dataclass(frozen=True)
class SensorField:
    """Where the sensor measures, sensor frame, metres.

    Attributes
    ----------
    points
        (m, 2) y and z in the laser sheet X = 0, in steps of `POSITION_STEP`.
    seen
        (m, cameras) whether the point lies in the camera's image.
    cameras
        (cameras, 3) centres of projection.
    source_z
        The laser's source is at (0, 0, source_z).
    """

    points: Array
    seen: Flags
    cameras: Array
    source_z: float

    @classmethod
    def of(cls, description: SensorDescription) -> SensorField:
        """The field of a sensor: within the range, the fan of the laser and the image of at least one camera."""
        optics = SensorOptics.of(description)
        near, far = optics.sensor.range
        z = np.arange(np.ceil(near / POSITION_STEP), np.floor(far / POSITION_STEP) + 1) * POSITION_STEP
        if len(z) == 0:
            z = np.array([(near + far) / 2])
        side = np.arange(np.ceil((far - optics.source_z) * optics.fan / POSITION_STEP) + 1) * POSITION_STEP
        y, z = (v.ravel() for v in np.meshgrid(np.concatenate([-side[:0:-1], side]), z))
        points = np.stack([0 * y, y, z], -1)
        seen = optics.contains(points)
        kept = seen.any(-1)
        return cls(points[kept, 1:], seen[kept], optics.cameras, optics.source_z)


def _in_image(camera: sensor_rt.Camera, points_in_sensor: Array) -> Flags:
    """(n,) whether points (n, 3) in front of the camera fall into its image."""
    size = np.array([camera.width_px, camera.height_px])
    return np.asarray((np.abs(camera.project(points_in_sensor) - (size - 1) / 2) < size / 2).all(-1))
