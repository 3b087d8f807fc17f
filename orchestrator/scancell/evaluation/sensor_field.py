"""The part of the laser sheet in which a sensor measures."""

from __future__ import annotations

import json
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.config.resolved import sensor_json
from scancell.config.sensor import SensorDescription

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

POSITION_STEP = 5e-3
"""Distance between neighbouring points of a field, m."""


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
        resolved = sensor_json(description, seed=0)
        source_z, fan = resolved["laser"]["source_z"], np.tan(resolved["laser"]["fan_half_angle"])
        sensor = sensor_rt.Sensor(json.dumps(resolved))
        near, far = sensor.range
        z = np.arange(np.ceil(near / POSITION_STEP), np.floor(far / POSITION_STEP) + 1) * POSITION_STEP
        if len(z) == 0:
            z = np.array([(near + far) / 2])
        side = np.arange(np.ceil((far - source_z) * fan / POSITION_STEP) + 1) * POSITION_STEP
        y, z = (v.ravel() for v in np.meshgrid(np.concatenate([-side[:0:-1], side]), z))
        points = np.stack([0 * y, y, z], -1)
        seen = np.stack([_in_image(camera, points) for camera in sensor.cameras], -1)
        kept = seen.any(-1) & (np.abs(y) <= (z - source_z) * fan)
        centres = np.array([camera.sensor_from_camera[:3, 3] for camera in sensor.cameras])
        return cls(points[kept, 1:], seen[kept], centres, float(source_z))


def _in_image(camera: sensor_rt.Camera, points_in_sensor: Array) -> Flags:
    """(n,) whether points (n, 3) in front of the camera fall into its image."""
    size = np.array([camera.width_px, camera.height_px])
    return np.asarray((np.abs(camera.project(points_in_sensor) - (size - 1) / 2) < size / 2).all(-1))
