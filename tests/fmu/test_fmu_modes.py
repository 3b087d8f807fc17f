"""Controller modes through FMU variables: jogs and monitor speed."""

from __future__ import annotations

import numpy as np
import pytest
from cell_fixture import CYCLE_US, MOTION, START, Build, CellFmu

TARGET = START + np.array([0.3, 0.2, -0.3, 0.5, -0.2, 0.8])
MANUAL = 0
JOINT_MOVE, LINE_MOVE, JOINT_JOG, TOOL_JOG = 2, 3, 4, 5
TOP_SPEED = 5.0  # rad/s, of every joint of the test cell


def jog(cell: CellFmu, mode: int, deflections: dict[int, float], frame: int = 0) -> None:
    cell.set("command.operation", MANUAL)
    cell.set("command.mode", mode)
    cell.set("command.jog_frame", frame)
    for axis in range(1, 8):
        cell.set(f"command.jog[{axis}]", deflections.get(axis, 0.0))


def seconds_to_destination(cell: CellFmu) -> float:
    begin = cell.time_us
    cell.step(CYCLE_US)
    while not cell.get_int("controller.at_destination"):
        cell.step(1000)
        assert cell.time_us - begin < 60_000_000
    return (cell.time_us - begin) * 1e-6


@pytest.mark.parametrize(("axis", "fraction"), [(1, 1.0), (5, -0.5)])
def test_joint_jog_moves_one_joint_at_jog_speed(build: Build, axis: int, fraction: float) -> None:
    cell = build()
    jog(cell, JOINT_JOG, {axis: fraction})
    cell.step(CYCLE_US, 40)
    rates = np.zeros(6)
    rates[axis - 1] = fraction * MOTION["jog_joint_share"] * TOP_SPEED  # type: ignore[operator]
    np.testing.assert_allclose(cell.vector("measured.qd", 6), rates, atol=1e-9)
    jog(cell, JOINT_JOG, {})
    cell.step(CYCLE_US, 20)
    assert not cell.get_int("controller.moving")
    here = cell.vector("measured.q", 6)
    np.testing.assert_array_equal(np.delete(here, axis - 1), np.delete(START, axis - 1))
    np.testing.assert_array_equal(cell.vector("controller.destination.q", 6), here)


@pytest.mark.parametrize("frame", [0, 1])
@pytest.mark.parametrize("axis", [1, 2, 3])
def test_cartesian_jog_moves_along_axis_at_jog_speed(build: Build, frame: int, axis: int) -> None:
    cell = build()
    begin = cell.body("sensor")
    along = np.eye(3)[axis - 1] if frame == 0 else begin[:3, axis - 1]
    jog(cell, TOOL_JOG, {axis: 0.2}, frame)
    cell.step(CYCLE_US, 25)
    velocity = cell.vector("truth.sensor.velocity", 3)
    np.testing.assert_allclose(velocity, 0.2 * MOTION["jog_speed"] * along, atol=2e-4)  # type: ignore[operator]
    end = cell.body("sensor")
    travel = end[:3, 3] - begin[:3, 3]
    np.testing.assert_allclose(travel, (travel @ along) * along, atol=1e-6)
    np.testing.assert_allclose(end[:3, :3], begin[:3, :3], atol=1e-6)
    assert travel @ along > 0.01


def test_cartesian_jog_rotates_about_sensor_origin(build: Build) -> None:
    cell = build()
    begin = cell.body("sensor")
    jog(cell, TOOL_JOG, {6: 0.3}, 1)
    cell.step(CYCLE_US, 25)
    end = cell.body("sensor")
    np.testing.assert_allclose(end[:3, 3], begin[:3, 3], atol=1e-6)
    np.testing.assert_allclose(end[:3, 2], begin[:3, 2], atol=1e-6)
    assert begin[:3, 0] @ end[:3, 0] < np.cos(0.05)


def test_zero_monitor_speed_pauses_move_on_path(build: Build) -> None:
    cell = build()
    cell.start_move(TARGET)
    cell.step(CYCLE_US, 8)
    cell.set("command.monitor_speed", 0.0)
    cell.step(CYCLE_US, 30)
    assert [cell.get_int(f"controller.{n}") for n in ("moving", "at_destination", "error")] == [0, 0, 0]
    fraction = (cell.vector("measured.q", 6) - START) / (TARGET - START)
    np.testing.assert_allclose(fraction, fraction[0], atol=1e-9)
    assert 0.05 < fraction[0] < 0.95
    np.testing.assert_array_equal(cell.vector("controller.destination.q", 6), TARGET)
    cell.set("command.monitor_speed", 1.0)
    seconds_to_destination(cell)
    np.testing.assert_array_equal(cell.vector("measured.q", 6), TARGET)


def test_monitor_speed_does_not_scale_jogs_in_manual_operation(build: Build) -> None:
    positions = []
    for speed in (1.0, 0.1):
        cell = build()
        jog(cell, JOINT_JOG, {1: 1.0})
        for name in ("command.speed", "command.monitor_speed"):
            cell.set(name, speed)
        cell.step(CYCLE_US, 20)
        positions.append(cell.vector("measured.q", 6))
    np.testing.assert_array_equal(positions[0], positions[1])
    assert positions[0][0] > START[0] + 0.05
