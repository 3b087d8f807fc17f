"""Tools of linear moves and jogs: straight lines and rotations of a tool, by the true pose of the flange."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from cell_fixture import CYCLE_US, MOTION, Array, Build, CellFmu, all_reals, cell_description, pose
from continue_from_state import assert_continues_exactly

LINE_MOVE, JOINT_JOG, CARTESIAN_JOG = 3, 4, 5
WORLD, TOOL = 0, 1
INVALID_ORIENTATION = 12
# A tip 0.25 m away from the sensor, tilted.
POSITION, ORIENTATION = np.array([0.12, 0.05, 0.2]), np.array([0.9, 0.3, -0.1, 0.3])  # a unit quaternion


def rotation(quaternion: Array) -> Array:
    w, vector = quaternion[0], quaternion[1:]
    cross = np.cross(np.eye(3), vector)
    return np.asarray(np.eye(3) + 2 * w * cross + 2 * cross @ cross)


FLANGE_FROM_TIP = np.eye(4)
FLANGE_FROM_TIP[:3, :3], FLANGE_FROM_TIP[:3, 3] = rotation(ORIENTATION), POSITION


def set_pose(cell: CellFmu, name: str, position: Array, orientation: Array) -> None:
    for i, value in enumerate(position, 1):
        cell.set(f"command.{name}.position[{i}]", float(value))
    for i, value in enumerate(orientation, 1):
        cell.set(f"command.{name}.orientation[{i}]", float(value))


def get_pose(cell: CellFmu, name: str) -> Array:
    return np.append(cell.vector(f"command.{name}.position", 3), cell.vector(f"command.{name}.orientation", 4))


def tip(cell: CellFmu) -> Array:
    """True pose (4, 4) of the tip."""
    return np.asarray(cell.body("link[6]") @ FLANGE_FROM_TIP)


def quaternion(matrix: Array) -> Array:
    """Of a rotation by less than a half turn."""
    w = np.sqrt(1 + np.trace(matrix)) / 2
    turn = matrix - matrix.T
    return np.array([w, *(np.array([turn[2, 1], turn[0, 2], turn[1, 0]]) / (4 * w))])


def start_line_of_tip(cell: CellFmu, displacement: Array, turn: Array) -> Array:
    """Start a line of the tip with a rotation `turn` (3, 3, world); the target (4, 4)."""
    target = tip(cell)
    target[:3, :3], target[:3, 3] = turn @ target[:3, :3], target[:3, 3] + displacement
    set_pose(cell, "tool", POSITION, ORIENTATION)
    set_pose(cell, "target", target[:3, 3], quaternion(target[:3, :3]))
    cell.set("command.mode", LINE_MOVE)
    cell.set("command.speed", 0.2)
    cell.set("command.start", cell.get_int("command.start") + 1)
    return target


def jog_tip(cell: CellFmu, deflections: dict[int, float], frame: int, mode: int = CARTESIAN_JOG) -> None:
    set_pose(cell, "tool", POSITION, ORIENTATION)
    cell.set("command.operation", 0)
    cell.set("command.mode", mode)
    cell.set("command.jog_frame", frame)
    for axis in range(1, 8):
        cell.set(f"command.jog[{axis}]", deflections.get(axis, 0.0))


def while_moving(cell: CellFmu, look: Callable[[], object]) -> None:
    cell.step(CYCLE_US)
    while cell.get_int("controller.moving"):
        cell.step(1000)
        look()
        assert cell.time_us < 60_000_000


def off_line(points: list[Array], start: Array, along: Array) -> float:
    travel = np.array(points) - start
    return float(np.linalg.norm(travel - np.outer(travel @ along, along) / (along @ along), axis=1).max())


@pytest.mark.parametrize("version", [2, 3])
def test_tool_is_the_sensor_at_the_start_also_of_another_cell_file(build: Build, version: int, tmp_path: Path) -> None:
    mount = cell_description()["tool"]["flange_from_sensor"]
    cell = build(version)
    np.testing.assert_allclose(get_pose(cell, "tool"), [*mount["position"], *mount["quaternion"]], atol=1e-15)
    other = cell_description()
    other["tool"]["flange_from_sensor"] = pose([0.0, 0.01, 0.12], [1.0, 0.0, 0.0, 0.0])
    (tmp_path / "other.json").write_text(json.dumps(other))
    cell = build(version, parameters={"cell.file": str(tmp_path / "other.json")})
    np.testing.assert_allclose(get_pose(cell, "tool"), [0.0, 0.01, 0.12, 1.0, 0.0, 0.0, 0.0], atol=1e-15)


@pytest.mark.parametrize("version", [2, 3])
def test_line_with_rotation_keeps_tool_on_a_straight_line(build: Build, version: int) -> None:
    cell = build(version)
    start, of_sensor = tip(cell), cell.body("sensor")
    displacement, turn = np.array([0.03, -0.06, 0.04]), rotation(np.array([np.cos(0.2), 0.0, np.sin(0.2), 0.0]))
    target = start_line_of_tip(cell, displacement, turn)
    of_tip: list[Array] = []
    positions: list[Array] = []

    def look() -> None:
        of_tip.append(tip(cell)[:3, 3])
        positions.append(cell.vector("truth.sensor.position", 3))

    while_moving(cell, look)
    assert cell.get_int("controller.error") == 0
    np.testing.assert_allclose(tip(cell), target, atol=1e-9)
    assert off_line(of_tip, start[:3, 3], displacement) < 1e-6
    along = positions[-1] - of_sensor[:3, 3]
    assert off_line(positions, of_sensor[:3, 3], along) > 1e-3  # the sensor is not on one


@pytest.mark.parametrize("axis", [4, 5, 6])
def test_jog_about_axes_of_tool_leaves_its_origin(build: Build, axis: int) -> None:
    cell = build()
    start = tip(cell)
    jog_tip(cell, {axis: 0.3}, TOOL)
    cell.step(CYCLE_US, 25)
    end = tip(cell)
    np.testing.assert_allclose(end[:3, 3], start[:3, 3], atol=1e-6)
    np.testing.assert_allclose(end[:3, axis - 4], start[:3, axis - 4], atol=1e-6)
    assert start[:3, axis % 3] @ end[:3, axis % 3] < np.cos(0.05)
    assert np.linalg.norm(cell.vector("truth.sensor.velocity", 3)) > 0.01


@pytest.mark.parametrize("frame", [WORLD, TOOL])
def test_jog_moves_tool_along_axes_of_frame_at_jog_speed(build: Build, frame: int) -> None:
    cell = build()
    start = tip(cell)
    along = np.eye(3)[0] if frame == WORLD else start[:3, 0]
    jog_tip(cell, {1: 0.2}, frame)
    cell.step(CYCLE_US, 25)
    travel = tip(cell)[:3, 3] - start[:3, 3]
    np.testing.assert_allclose(travel, (travel @ along) * along, atol=1e-6)
    assert travel @ along > 0.01
    expected = 0.2 * MOTION["jog_speed"] * along  # type: ignore[operator]
    np.testing.assert_allclose(cell.vector("truth.sensor.velocity", 3), expected, atol=2e-4)


def test_joint_jog_keeps_jog_speed_at_tool(build: Build) -> None:
    """At the end of a long tool, which is faster than the sensor."""
    cell = build()
    jog_tip(cell, {1: 1.0}, WORLD, JOINT_JOG)
    end = np.array([0.0, -0.4, 0.0, 1.0])
    set_pose(cell, "tool", end[:3], np.array([1.0, 0.0, 0.0, 0.0]))
    cell.step(CYCLE_US, 60)
    start = cell.body("link[6]") @ end
    cell.step(1000)
    speed = np.linalg.norm(cell.body("link[6]") @ end - start) / 1e-3
    rate = cell.vector("measured.qd", 6)[0]
    assert speed == pytest.approx(MOTION["jog_speed"], rel=1e-3)
    assert rate < 0.9 * MOTION["jog_joint_share"] * 5.0  # type: ignore[operator]


def test_path_ahead_of_a_jog_follows_tool(build: Build) -> None:
    cell = build(variants=["--ahead"])
    jog_tip(cell, {2: 0.2, 6: 0.2}, TOOL)
    cell.step(CYCLE_US, 40)
    ahead = cell.path_ahead()[2, :6]  # at full speed, five times that of the jog
    begin = cell.vector("truth.q", 6)
    cell.step(CYCLE_US, 10)
    q = cell.vector("truth.q", 6)
    np.testing.assert_allclose(ahead, q, atol=1e-6)
    assert np.abs(q - begin).max() > 0.01


def test_change_of_tool_during_jog_comes_to_rest_first(build: Build) -> None:
    cell = build()
    sensor = get_pose(cell, "tool")
    jog_tip(cell, {6: 0.3}, TOOL)
    set_pose(cell, "tool", sensor[:3], sensor[3:])
    cell.step(CYCLE_US, 25)
    assert cell.get_int("controller.moving")
    set_pose(cell, "tool", POSITION, ORIENTATION)
    moved = []
    for _ in range(60):
        cell.step(CYCLE_US)
        moved.append(cell.get_int("controller.moving"))
        if not moved[-1]:
            break
    assert not moved[-1]
    start = tip(cell)
    cell.step(CYCLE_US, 25)
    end = tip(cell)
    np.testing.assert_allclose(end[:3, 3], start[:3, 3], atol=1e-6)
    assert start[:3, 0] @ end[:3, 0] < np.cos(0.05)


def test_tool_of_a_line_is_that_of_its_start(build: Build) -> None:
    """A change during the move does not bend it."""
    cell = build()
    start, displacement = tip(cell)[:3, 3], np.array([0.0, -0.08, 0.03])
    target = start_line_of_tip(cell, displacement, rotation(np.array([np.cos(0.1), np.sin(0.1), 0.0, 0.0])))
    cell.step(CYCLE_US, 5)
    set_pose(cell, "tool", np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
    points: list[Array] = []
    while_moving(cell, lambda: points.append(tip(cell)[:3, 3]))
    assert off_line(points, start, displacement) < 1e-6
    np.testing.assert_allclose(tip(cell), target, atol=1e-9)


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("mode", [LINE_MOVE, CARTESIAN_JOG])
def test_tool_orientation_is_normalised_or_rejected(build: Build, version: int, mode: int) -> None:
    cell = build(version, loggingOn=True)
    begin = tip(cell)
    for scale in (0.0, 0.98, 1.005):
        if mode == LINE_MOVE:
            start_line_of_tip(cell, np.array([0.0, 0.0, 0.02]), np.eye(3))
        else:
            jog_tip(cell, {3: 0.2}, WORLD)
        set_pose(cell, "tool", POSITION, scale * ORIENTATION)
        cell.step(CYCLE_US, 40)
        accepted = scale > 1
        assert cell.get_int("controller.error") == (0 if accepted else INVALID_ORIENTATION)
        travel = tip(cell)[:3, 3] - begin[:3, 3]
        np.testing.assert_allclose(travel[:2], 0.0, atol=1e-6)
        assert (travel[2] > 1e-3) == accepted
    assert any("command.tool.orientation or command" in text for text in cell.messages)


def step_on(cell: CellFmu) -> None:
    cell.step(CYCLE_US, 20)


@pytest.mark.parametrize("mode", [LINE_MOVE, CARTESIAN_JOG])
def test_state_holds_tool_of_running_motion(build: Build, mode: int, tmp_path: Path) -> None:
    cell = build()
    if mode == LINE_MOVE:
        start_line_of_tip(cell, np.array([0.03, -0.06, 0.04]), np.eye(3))
    else:
        jog_tip(cell, {2: 0.3, 5: 0.2}, TOOL)
    cell.step(CYCLE_US, 10)
    assert cell.get_int("controller.moving")
    assert_continues_exactly(cell, step_on, tmp_path)


def test_tool_that_is_written_as_the_sensor_changes_no_bit(build: Build) -> None:
    results = []
    for rounding in (None, 3e-16):
        cell = build()
        if rounding is not None:
            sensor = get_pose(cell, "tool")
            set_pose(cell, "tool", sensor[:3], sensor[3:] * (1 + rounding))
        for i, value in enumerate(cell.vector("truth.sensor.position", 3) + np.array([0.02, 0.03, -0.01]), 1):
            cell.set(f"command.target.position[{i}]", float(value))
        cell.set("command.mode", LINE_MOVE)
        cell.set("command.start", 1)
        cell.step(CYCLE_US, 30)
        results.append(np.delete(all_reals(cell), [i for i, name in enumerate(reals(cell)) if ".tool." in name]))
    np.testing.assert_array_equal(results[0], results[1])


def reals(cell: CellFmu) -> list[str]:
    """Names of the values of `all_reals`."""
    return [name for name, variable in cell.variables.items() if variable.type in {"Real", "Float64"}]
