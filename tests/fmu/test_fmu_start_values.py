"""Inputs start at the home pose of the loaded cell, and values set by an importer are kept."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from cell_fixture import CYCLE_US, START, Array, Build, CellFmu, cell_description
from grasp_fixture import grasp_cell

HOME = START
OTHER_HOME = HOME + np.radians([10, -5, 5, 20, -10, 30])
OTHER_TABLE = 0.4
LINE_MOVE = 3


def cell_with_other_home() -> dict[str, object]:
    """The test cell with another home pose."""
    cell = cell_description()
    for joint, angle in zip(cell["robot"]["joints"], OTHER_HOME, strict=True):
        joint["start"] = float(angle)
    cell["table"]["start"] = OTHER_TABLE
    return cell


@pytest.fixture
def other_file(tmp_path: Path) -> str:
    file = tmp_path / "other.json"
    file.write_text(json.dumps(cell_with_other_home()))
    return str(file)


def set_points(cell: CellFmu) -> Array:
    return np.append(cell.vector("command.q", 6), cell.get("command.table"))


def sensor_target(cell: CellFmu) -> Array:
    return np.concatenate([cell.vector("command.target.position", 3), cell.vector("command.target.orientation", 4)])


def sensor_pose(cell: CellFmu) -> Array:
    return np.concatenate([cell.vector("truth.sensor.position", 3), cell.vector("truth.sensor.orientation", 4)])


@pytest.mark.parametrize("version", [2, 3])
def test_setting_one_set_point_keeps_others_at_home(build: Build, version: int) -> None:
    cell = build(version)
    cell.set("command.q[2]", HOME[1] + 0.05)
    cell.set("command.mode", 1)
    cell.step(CYCLE_US, 20)
    expected = HOME + np.array([0, 0.05, 0, 0, 0, 0])
    np.testing.assert_array_equal(cell.vector("truth.q", 6), expected)
    assert cell.get("truth.table")[0] == 0.0


@pytest.mark.parametrize("version", [2, 3])
def test_model_description_start_values_are_home_pose(build: Build, version: int) -> None:
    cell = build(version, cell_with_other_home())
    joints = [float(cell.variables[f"command.q[{i}]"].start) for i in range(1, 7)]
    np.testing.assert_array_equal(joints, OTHER_HOME)
    assert float(cell.variables["command.table"].start) == OTHER_TABLE
    names = [*(f"position[{i}]" for i in range(1, 4)), *(f"orientation[{i}]" for i in range(1, 5))]
    target = [float(cell.variables[f"command.target.{name}"].start) for name in names]
    np.testing.assert_allclose(target, sensor_pose(cell), atol=1e-15)
    np.testing.assert_array_equal(sensor_target(cell), target)


def test_line_move_to_start_target_does_not_move(build: Build) -> None:
    cell = build()
    before = sensor_pose(cell)
    cell.set("command.mode", LINE_MOVE)
    cell.set("command.start", 1)
    cell.step(CYCLE_US, 5)
    assert cell.get_int("controller.error") == 0
    assert cell.get_int("controller.at_destination") == 1
    np.testing.assert_allclose(sensor_pose(cell), before, atol=1e-12)


def test_open_gripper_stays_open_with_start_width(build: Build) -> None:
    cell = build(3, grasp_cell())
    before = float(cell.get("measured.gripper.width")[0])
    cell.set("command.gripper.mode", 1)
    cell.step(CYCLE_US, 20)
    assert cell.get("measured.gripper.width")[0] == pytest.approx(before, abs=1e-9)


@pytest.mark.parametrize("version", [2, 3])
def test_unset_inputs_follow_home_of_another_cell_file(build: Build, version: int, other_file: str) -> None:
    cell = build(version, parameters={"cell.file": other_file})
    np.testing.assert_array_equal(set_points(cell), np.append(OTHER_HOME, OTHER_TABLE))
    np.testing.assert_allclose(sensor_target(cell), sensor_pose(cell), atol=1e-15)
    cell.set("command.q[1]", OTHER_HOME[0] + 0.02)
    cell.set("command.mode", 1)
    cell.step(CYCLE_US, 10)
    np.testing.assert_array_equal(cell.vector("truth.q", 6), OTHER_HOME + np.array([0.02, 0, 0, 0, 0, 0]))
    assert cell.get("truth.table")[0] == OTHER_TABLE


@pytest.mark.parametrize("version", [2, 3])
def test_inputs_follow_cell_after_every_reset(build: Build, version: int, other_file: str) -> None:
    cell = build(version)
    cell.set("command.q[3]", 1.0)
    for parameters, home in (({"cell.file": other_file}, OTHER_HOME), ({}, HOME)):
        cell.slave.reset()
        cell.initialize(parameters)
        np.testing.assert_array_equal(cell.vector("command.q", 6), home)
        np.testing.assert_allclose(sensor_target(cell), sensor_pose(cell), atol=1e-15)


@pytest.mark.parametrize("order", [["command.q[2]", "cell.file"], ["cell.file", "command.q[2]"]])
def test_inputs_set_before_loading_are_kept(build: Build, other_file: str, order: list[str]) -> None:
    """Even a value equal to the home value of the FMU's own cell."""
    values: dict[str, float | str] = {"command.q[2]": float(HOME[1]), "cell.file": other_file}
    cell = build(3, parameters={name: values[name] for name in order})
    expected = OTHER_HOME.copy()
    expected[1] = HOME[1]
    np.testing.assert_array_equal(cell.vector("command.q", 6), expected)


def test_state_contains_which_inputs_were_set(build: Build, other_file: str) -> None:
    """Saved before the cell was loaded, restored in another instance, then used with another cell."""
    folder_cell = cell_description()
    first, second = build(3, folder_cell), build(3, folder_cell)
    for cell in (first, second):
        cell.slave.reset()
    first.set("command.q[2]", float(HOME[1]))
    second.restore(second.deserialize(first.serialize(first.save())), 0)
    second.initialize({"cell.file": other_file})
    expected = OTHER_HOME.copy()
    expected[1] = HOME[1]
    np.testing.assert_array_equal(second.vector("command.q", 6), expected)
