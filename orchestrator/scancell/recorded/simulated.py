"""The measurements that the ray-traced sensor would make at the poses of real ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from scancell.calibration.cell.kinematics import AxisReadings
from scancell.config.loading import Setup
from scancell.progress import Progress
from scancell.reconstruction.reconstruct import ProfilePoints
from scancell.recorded.measurements import Measurements
from scancell.recorded.reconstruct import MeasuredCell
from scancell.scanning.sense import expose
from scancell.scanning.world import build_scene, make_sensor, still_exposures, visible_bodies

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
        index = np.arange(first + 1, rows.stop + 1, dtype=np.int64)
        placed = {name: poses[rows] for name, poses in frames.items()}
        exposures = still_exposures(placed, bodies, index, np.array([sensor.exposure]))
        sensed = expose(scene, sensor, sensor, exposures, index, "ray-traced", covariance=True, threads=threads)
        points, frame = sensed.points, (sensed.points.frame + first).astype(np.int32)
        # At rest all rows are seen from the same pose.
        made.append(replace(points, frame=frame, time_offset=np.zeros_like(points.time_offset)))
        assert sensed.covariance is not None
        covariance.append(sensed.covariance)
        progress.advance(rows.stop - first)
    return replace(
        found, readings=readings, profiles=ProfilePoints.concatenate(made), covariance=np.concatenate(covariance)
    )
