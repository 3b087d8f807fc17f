"""Servo controller: tracking, limits, hold."""

from __future__ import annotations

import numpy as np
import pytest
from cell_fixture import CYCLE_US, START, Array, Build, cell_description

CYCLE = CYCLE_US * 1e-6


def quadratic(t: float) -> Array:
    """Joints, then table."""
    rates = np.array([0.3, -0.2, 0.25, 0.4, -0.35, 0.5, 0.7])
    accelerations = np.array([1.0, 0.8, -0.9, 1.2, 0.7, -1.5, 2.0])
    return np.append(START, 0.0) + rates * t + accelerations * t * t / 2


def test_quadratic_trajectory_is_reproduced_one_cycle_later(build: Build) -> None:
    cell = build()
    for k in range(24):
        target = quadratic(k * CYCLE)
        cell.command(target[:6], target[6])
        for _ in range(4):
            cell.step(CYCLE_US // 4)
            if k < 12:
                continue  # the axes catch up with a stream that does not start from rest
            t = cell.time_us * 1e-6 - CYCLE
            expected, slope = quadratic(t), (quadratic(t + 1e-4) - quadratic(t - 1e-4)) / 2e-4
            np.testing.assert_allclose(cell.vector("truth.q", 6), expected[:6], atol=1e-13)
            np.testing.assert_allclose(cell.get("truth.table"), expected[6], atol=1e-13)
            np.testing.assert_allclose(cell.vector("measured.qd", 6), slope[:6], atol=1e-9)
            np.testing.assert_allclose(cell.get("measured.table_rate"), slope[6], atol=1e-9)


@pytest.mark.parametrize("joint", [1, 3, 6])
def test_position_limits_clamp_and_are_reported(build: Build, joint: int) -> None:
    cell = build()
    limit = cell_description()["robot"]["joints"][joint - 1]["max"]
    target = START.copy()
    target[joint - 1] = limit + 0.5
    highest = -np.inf
    for _ in range(150):
        cell.command(target)
        for _ in range(4):
            cell.step(CYCLE_US // 4)
            highest = max(highest, float(cell.get(f"truth.q[{joint}]")[0]))
    assert highest <= limit
    assert cell.get(f"truth.q[{joint}]")[0] == limit
    assert cell.get_int("controller.limit") == joint


def test_table_speed_limit_is_reported_and_table_arrives(build: Build) -> None:
    cell = build()
    cell.command(table=1.0)
    cell.step(CYCLE_US)
    assert cell.get_int("controller.limit") == 7
    assert cell.get_int("controller.moving") == 1
    cell.step(CYCLE_US, 30)
    assert cell.get("truth.table")[0] == pytest.approx(1.0, abs=1e-12)
    assert cell.get_int("controller.limit") == 0
    assert cell.get_int("controller.moving") == 0


def test_hold_brakes_with_maximum_acceleration(build: Build) -> None:
    cell = build()
    speed = 4.0
    for k in range(60):
        cell.command(table=speed * k * CYCLE)
        cell.step(CYCLE_US)
    before = cell.get("truth.table")[0]
    cell.set("command.mode", 0)
    cell.step(CYCLE_US, 40)
    assert cell.get("measured.table_rate")[0] == 0.0
    # Constant deceleration; the last cycle may brake more gently.
    stopping = speed**2 / (2 * 20.0)
    assert stopping <= cell.get("truth.table")[0] - before <= stopping + 20.0 * CYCLE**2
    here = cell.get("truth.table")[0]
    cell.command(table=100.0, mode=0)
    cell.step(CYCLE_US, 10)
    assert cell.get("truth.table")[0] == here


def test_axes_at_rest_do_not_move(build: Build) -> None:
    cell = build()
    cell.command(START, 0.0)
    poses = cell.body("sensor")
    cell.step(CYCLE_US, 50)
    np.testing.assert_array_equal(cell.body("sensor"), poses)
    np.testing.assert_array_equal(cell.vector("truth.sensor.velocity", 3), 0.0)
