"""The measurements that the ray-traced sensor would make at the poses of real ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.calibration.cell.kinematics import AxisReadings
from scancell.config.loading import Setup
from scancell.progress import Progress
from scancell.reconstruction.reconstruct import ProfilePoints
from scancell.recorded.measurements import Measurements
from scancell.recorded.reconstruct import MeasuredCell
from scancell.scanning.exposures import build_scene, visible_bodies
from scancell.scanning.sense import expose, points_of
from scancell.scanning.world import Sensors, make_sensor

_BATCH = 16  # exposures at a time


def simulate(
    found: Measurements,
    readings: AxisReadings,
    measured: MeasuredCell,
    setup: Setup,
    seed: int,
    threads: int,
    progress: Progress,
) -> Measurements:
    """Simulate the described sensor at rest at the poses of measurements.

    Without the arm, whose joints poses of the flange do not state, and without a gripper and further parts.

    Raises `SensorError` if the sensor library reports an error.
    """
    sensor = make_sensor(setup.sensor, seed)
    sensors = Sensors(sensor, sensor, setup.sensor)
    cell = measured.cell
    count = len(readings)
    frames = {
        "world": np.broadcast_to(np.eye(4), (count, 4, 4)),
        "table": measured.world_from("table", readings),
        "part": measured.world_from("part", readings),
        "sensor": measured.world_from("sensor", readings),
    }
    bodies = [body for body in visible_bodies(cell) if body.moves_with in frames]
    scene = build_scene(bodies)
    progress.stage("simulating", count, "exposures")
    made: list[ProfilePoints] = []
    covariance: list[NDArray[np.float64]] = []
    for first in range(0, count, _BATCH):
        rows = slice(first, min(first + _BATCH, count))
        exposures = sensor_rt.Exposures(
            frames["sensor"][rows, None],
            np.stack([np.asarray(frames[body.moves_with])[rows] for body in bodies], 1)[:, :, None],
            np.full(rows.stop - first, sensor.exposure),
            np.arange(first + 1, rows.stop + 1, dtype=np.int64),
        )
        result = expose(scene, sensors, exposures, "ray-traced", threads, images=False)
        points = points_of(result.profiles, sensor, "ray-traced")
        # The library numbers exposures by trigger index. At rest all rows are seen from the same pose.
        frame = (np.asarray(points.frame, np.int64) - 1).astype(np.int32)
        made.append(replace(points, frame=frame, time_offset=np.zeros_like(points.time_offset)))
        covariance.append(np.array(result.profiles.covariance, float))
        progress.advance(rows.stop - first)
    return replace(
        found, readings=readings, profiles=ProfilePoints.concatenate(made), covariance=np.concatenate(covariance)
    )
