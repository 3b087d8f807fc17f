"""Measuring range of a sensor for planning."""

from __future__ import annotations

import numpy as np

from scancell import sensor as sensor_rt
from scancell.planning.model import SensorRange


def sensor_range(sensor: sensor_rt.Sensor) -> SensorRange:
    """Measuring range that all cameras see, within the limits of the description."""
    near, far = sensor.range
    corners = np.array([sensor.trapezoid(k) for k in range(len(sensor.cameras))])
    by_range = [camera[np.argsort(camera[:, 1])] for camera in corners]
    seen_near = max(near, *(camera[0, 1] for camera in by_range))
    seen_far = min(far, *(camera[-1, 1] for camera in by_range))
    halves = [
        min(float(np.interp(z, camera[[0, 2], 1], np.abs(camera[[0, 2], 0]))) for camera in by_range)
        for z in (seen_near, seen_far)
    ]
    centres = np.array([camera.sensor_from_camera[:3, 3] for camera in sensor.cameras])
    return SensorRange(float(seen_near), float(seen_far), halves[0], halves[1], centres)
