"""Hands the cell and the sensor's range to the planner."""

from __future__ import annotations

import numpy as np

import sensor_rt
from orchestrator.cell.nominal import NominalCell
from orchestrator.config.loading import Setup
from orchestrator.planning.model import PlanningCell, SensorRange
from orchestrator.planning.options import scan_options
from orchestrator.planning.planner import Plan, plan


def sensor_range(sensor: sensor_rt.Sensor) -> SensorRange:
    """The part of the measuring range that every camera sees, within the limits of the description."""
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


def make_plan(nominal: NominalCell, sensor: sensor_rt.Sensor, setup: Setup) -> Plan:
    """Plan the described scan of the part.

    Raises
    ------
    PlanningError
        Naming the poses that cannot be reached, or what hits what.
    """
    cycle = setup.cell.world.controller_cycle_us * 1e-6
    return plan(PlanningCell(nominal, sensor_range(sensor), cycle), scan_options(setup.scan))
