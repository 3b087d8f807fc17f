"""Modes of the controller by variables alone: jogs, monitor speed, and who moves the robot in which operation."""

from __future__ import annotations

import numpy as np
import pytest
from cell_fixture import CYCLE_US, MOTION, START_DEG, Array, Build, CellFmu

START = np.radians(START_DEG)
TARGET = START + np.array([0.3, 0.2, -0.3, 0.5, -0.2, 0.8])
MANUAL, AUTOMATIC = 0, 1
HOLD, SERVO, JOINT_MOVE, LINE_MOVE, JOINT_JOG, TOOL_JOG = range(6)
NOT_IN_MANUAL, NOT_IN_AUTOMATIC = 1, 2
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


def go(cell: CellFmu, target: Array, mode: int = JOINT_MOVE) -> None:
    cell.command(target, mode=mode)
    cell.set("command.start", cell.get_int("command.start") + 1)


@pytest.mark.parametrize(("axis", "share"), [(1, 1.0), (5, -0.5)])
def test_a_joint_jogs_alone_at_its_share_of_the_speed_allowed_by_hand(build: Build, axis: int, share: float) -> None:
    cell = build()
    jog(cell, JOINT_JOG, {axis: share})
    cell.step(CYCLE_US, 40)
    rates = np.zeros(6)
    rates[axis - 1] = share * MOTION["jog_joint_share"] * TOP_SPEED  # type: ignore[operator]
    np.testing.assert_allclose(cell.vector("measured.qd", 6), rates, atol=1e-9)
    jog(cell, JOINT_JOG, {})
    cell.step(CYCLE_US, 20)
    assert not cell.get_int("controller.moving")
    here = cell.vector("measured.q", 6)
    np.testing.assert_array_equal(np.delete(here, axis - 1), np.delete(START, axis - 1))
    np.testing.assert_array_equal(cell.vector("controller.destination.q", 6), here)


@pytest.mark.parametrize("frame", [0, 1])
@pytest.mark.parametrize("axis", [1, 2, 3])
def test_the_sensor_jogs_along_an_axis_at_the_speed_allowed_by_hand(build: Build, frame: int, axis: int) -> None:
    cell = build()
    begin = cell.body("sensor")
    along = np.eye(3)[axis - 1] if frame == 0 else begin[:3, axis - 1]
    jog(cell, TOOL_JOG, {axis: 0.2}, frame)
    cell.step(CYCLE_US, 25)
    velocity = cell.vector("truth.sensor.velocity", 3)
    np.testing.assert_allclose(velocity, 0.2 * MOTION["jog_speed"] * along, atol=2e-4)  # type: ignore[operator]
    end = cell.body("sensor")
    way = end[:3, 3] - begin[:3, 3]
    np.testing.assert_allclose(way, (way @ along) * along, atol=1e-6)
    np.testing.assert_allclose(end[:3, :3], begin[:3, :3], atol=1e-6)
    assert way @ along > 0.01


def test_the_sensor_jogs_about_its_own_origin(build: Build) -> None:
    cell = build()
    begin = cell.body("sensor")
    jog(cell, TOOL_JOG, {6: 0.3}, 1)
    cell.step(CYCLE_US, 25)
    end = cell.body("sensor")
    np.testing.assert_allclose(end[:3, 3], begin[:3, 3], atol=1e-6)
    np.testing.assert_allclose(end[:3, 2], begin[:3, 2], atol=1e-6)
    assert begin[:3, 0] @ end[:3, 0] < np.cos(0.05)


def test_half_the_monitor_speed_takes_a_move_twice_as_long(build: Build) -> None:
    times = []
    for monitor in (1.0, 0.5):
        cell = build()
        cell.set("command.monitor_speed", monitor)
        go(cell, TARGET)
        times.append(seconds_to_destination(cell))
        np.testing.assert_array_equal(cell.vector("truth.q", 6), TARGET)
    assert times[1] == pytest.approx(2 * times[0], abs=2 * CYCLE_US * 1e-6)


def test_the_monitor_speed_pauses_a_move_on_its_path(build: Build) -> None:
    cell = build()
    go(cell, TARGET)
    cell.step(CYCLE_US, 8)
    cell.set("command.monitor_speed", 0.0)
    cell.step(CYCLE_US, 30)
    assert [cell.get_int(f"controller.{n}") for n in ("moving", "at_destination", "error")] == [0, 0, 0]
    share = (cell.vector("measured.q", 6) - START) / (TARGET - START)
    np.testing.assert_allclose(share, share[0], atol=1e-9)
    assert 0.05 < share[0] < 0.95
    np.testing.assert_array_equal(cell.vector("controller.destination.q", 6), TARGET)
    cell.set("command.monitor_speed", 1.0)
    seconds_to_destination(cell)
    np.testing.assert_array_equal(cell.vector("measured.q", 6), TARGET)


@pytest.mark.parametrize("mode", [SERVO, JOINT_MOVE, LINE_MOVE])
def test_no_program_moves_the_robot_in_manual_operation(build: Build, mode: int) -> None:
    cell = build()
    cell.set("command.operation", MANUAL)
    cell.set("command.target.position[1]", 0.4)
    go(cell, TARGET, mode)
    cell.step(CYCLE_US, 20)
    assert [cell.get_int(f"controller.{n}") for n in ("mode", "error")] == [HOLD, NOT_IN_MANUAL]
    np.testing.assert_array_equal(cell.vector("truth.q", 6), START)


def test_no_program_changes_the_speed_in_manual_operation(build: Build) -> None:
    ways = []
    for speed in (1.0, 0.1):
        cell = build()
        jog(cell, JOINT_JOG, {1: 1.0})
        for name in ("command.speed", "command.monitor_speed"):
            cell.set(name, speed)
        cell.step(CYCLE_US, 20)
        ways.append(cell.vector("measured.q", 6))
    np.testing.assert_array_equal(ways[0], ways[1])
    assert ways[0][0] > START[0] + 0.05


def test_a_program_stops_on_its_path_when_a_person_takes_over(build: Build) -> None:
    cell = build()
    go(cell, TARGET)
    cell.step(CYCLE_US, 8)
    cell.set("command.operation", MANUAL)
    cell.step(CYCLE_US, 40)
    share = (cell.vector("measured.q", 6) - START) / (TARGET - START)
    np.testing.assert_allclose(share, share[0], atol=1e-9)
    assert [cell.get_int(f"controller.{n}") for n in ("moving", "error")] == [0, NOT_IN_MANUAL]


@pytest.mark.parametrize("mode", [JOINT_JOG, TOOL_JOG])
def test_nobody_jogs_the_robot_in_automatic_operation(build: Build, mode: int) -> None:
    cell = build()
    jog(cell, mode, {1: 1.0})
    cell.set("command.operation", AUTOMATIC)
    cell.step(CYCLE_US, 20)
    assert [cell.get_int(f"controller.{n}") for n in ("mode", "error")] == [HOLD, NOT_IN_AUTOMATIC]
    np.testing.assert_array_equal(cell.vector("truth.q", 6), START)


def test_one_program_moves_the_robot_at_a_time(build: Build) -> None:
    """The second of two programs begins where the first was stopped on its path, from rest."""
    cell = build()
    go(cell, TARGET)
    cell.step(CYCLE_US, 8)
    go(cell, START)
    rest = None
    for _ in range(600):
        cell.step(1000)
        if rest is None and not cell.vector("measured.qd", 6).any():
            rest = cell.vector("measured.q", 6)
    assert rest is not None
    share = (rest - START) / (TARGET - START)
    np.testing.assert_allclose(share, share[0], atol=1e-9)
    assert 0.05 < share[0] < 0.95
    np.testing.assert_array_equal(cell.vector("measured.q", 6), START)
