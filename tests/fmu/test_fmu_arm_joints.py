"""Arms of 4 to 8 joints: variables, poses, motion, limits and rejected descriptions."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cell_fixture import CYCLE_US, Array, Build, CellFmu, cell_description, rejection

from scancell.geometry.arm import Arm, Joint

# a, d in m, alpha in quarter turns; the first rows of an arm with alternating axes in the size of a small one.
ROWS = [
    (0.0, 0.34, -1), (0.0, 0.0, 1), (0.0, 0.4, 1), (0.0, 0.0, -1),
    (0.0, 0.4, -1), (0.0, 0.0, 1), (0.0, 0.1, 1), (0.05, 0.0, 0),
]  # fmt: skip
START = np.array([1.3, -1.4, 0.1, 1.4, -0.1, 0.9, -0.2, -0.7])
HELD = {7: [3], 8: [3, 8]}


def arm_cell(count: int, **robot: Any) -> dict[str, Any]:
    """The test cell with an arm of `count` joints; keyword arguments override keys of the robot."""
    cell = cell_description()
    template = cell["robot"]["joints"][0]
    cell["robot"]["joints"] = [
        {**template, "a": a, "d": d, "alpha": turns * np.pi / 2, "min": -2.8, "max": 2.8, "start": start}
        for (a, d, turns), start in zip(ROWS[:count], START[:count], strict=True)
    ]
    cell["robot"]["held_joints"] = HELD.get(count, [])
    cell["robot"].update(robot)
    return cell


def arm_of(joints: int) -> Arm:
    return Arm([Joint(a, d, turns * np.pi / 2) for a, d, turns in ROWS[:joints]])


def joints_of(cell: CellFmu, name: str, joints: int) -> Array:
    return cell.vector(f"{name}.q", joints)


def move(cell: CellFmu, mode: int) -> None:
    """Start a move and run it to its end."""
    cell.set("command.mode", mode)
    cell.set("command.start", cell.get_int("command.start") + 1)
    for _ in range(2000):
        cell.step(CYCLE_US)
        assert cell.get_int("controller.error") == 0
        if cell.get_int("controller.at_destination") and not cell.get_int("controller.moving"):
            return
    raise AssertionError("the move did not end")


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("joints", [4, 5, 7, 8])
def test_variables_match_the_number_of_joints(build: Build, version: int, joints: int) -> None:
    cell = build(version, arm_cell(joints))
    for name in ("command.q", "measured.q", "measured.qd", "truth.q", "controller.destination.q", "as_built.dh"):
        numbered = {variable.split("]")[0] for variable in cell.variables if variable.startswith(name + "[")}
        assert numbered == {f"{name}[{i}" for i in range(1, joints + 1)}, name
    assert f"truth.link[{joints}].position[1]" in cell.variables
    assert f"truth.link[{joints + 1}].position[1]" not in cell.variables
    assert f"command.jog[{joints + 1}]" in cell.variables  # the table
    assert f"command.jog[{joints + 2}]" not in cell.variables
    # Only the last joint of this arm has an axis that is parallel to the next one, which does not exist.
    assert not [name for name in cell.variables if name.endswith(".beta")]
    np.testing.assert_allclose(joints_of(cell, "measured", joints), START[:joints], atol=1e-12)
    np.testing.assert_allclose(joints_of(cell, "command", joints), START[:joints], atol=1e-12)


@pytest.mark.parametrize("joints", [4, 5, 7, 8])
def test_joint_move_ends_at_target_with_links_at_computed_poses(build: Build, joints: int) -> None:
    cell = build(2, arm_cell(joints))
    target = START[:joints] + np.linspace(-0.5, 0.4, joints)
    cell.command(target, 0.7, mode=2)
    move(cell, 2)
    np.testing.assert_allclose(joints_of(cell, "truth", joints), target, atol=1e-9)
    assert cell.get("truth.table")[0] == pytest.approx(0.7, abs=1e-9)
    expected = arm_of(joints).link_poses(target)
    for i in range(1, joints + 1):
        np.testing.assert_allclose(cell.body(f"link[{i}]"), expected[i], atol=1e-9)


@pytest.mark.parametrize("joints", [7, 8])
def test_line_move_of_redundant_arm_keeps_held_joints_still(build: Build, joints: int) -> None:
    cell = build(2, arm_cell(joints))
    start = cell.body("sensor")
    target = start.copy()
    target[:3, 3] += [0.03, -0.05, 0.04]
    for i in range(3):
        cell.set(f"command.target.position[{i + 1}]", float(target[i, 3]))
    cell.set("command.table", 0.2)
    cell.set("command.mode", 3)
    cell.set("command.start", 1)
    travel = target[:3, 3] - start[:3, 3]
    held = [number - 1 for number in HELD[joints]]
    for _ in range(400):
        cell.step(4_000)
        here = cell.body("sensor")
        off = here[:3, 3] - start[:3, 3]
        assert np.linalg.norm(off - travel * (off @ travel) / (travel @ travel)) < 5e-6  # the cubics between two cycles
        np.testing.assert_allclose(joints_of(cell, "truth", joints)[held], START[held], atol=1e-12)
    assert cell.get_int("controller.at_destination")
    np.testing.assert_allclose(cell.body("sensor"), target, atol=1e-8)


def test_cartesian_jog_of_redundant_arm_moves_sensor_along_one_axis(build: Build) -> None:
    cell = build(2, arm_cell(7))
    cell.set("command.operation", 0)
    cell.set("command.mode", 5)
    cell.set("command.jog[2]", 0.5)
    start = cell.body("sensor")
    cell.step(CYCLE_US, 30)
    travel = cell.body("sensor") - start
    assert travel[1, 3] > 0.01
    np.testing.assert_allclose(travel[[0, 2], 3], 0, atol=2e-6)
    np.testing.assert_allclose(travel[:3, :3], 0, atol=1e-5)
    assert joints_of(cell, "truth", 7)[2] == pytest.approx(START[2], abs=1e-12)


@pytest.mark.parametrize("joints", [4, 8])
def test_limit_is_reported_with_number_of_its_axis(build: Build, joints: int) -> None:
    cell = build(2, arm_cell(joints))
    target = START[:joints].copy()
    target[-1] = 3.0
    cell.start_move(target, 0.0)
    cell.step(CYCLE_US, 2)
    assert (cell.get_int("controller.error"), cell.get_int("controller.limit")) == (5, joints)
    # In servo mode a table that is too fast is the axis after the last joint.
    cell.command(START[:joints], 50.0, mode=1)
    cell.step(CYCLE_US, 2)
    assert cell.get_int("controller.limit") == joints + 1


@pytest.mark.parametrize("joints", [4, 8])
def test_restored_state_continues_exactly(build: Build, joints: int) -> None:
    cell = build(2, arm_cell(joints))
    cell.command(START[:joints] + 0.1, 0.5)
    cell.step(CYCLE_US, 5)
    state, time_us = cell.save(), cell.time_us
    data = cell.serialize(state)
    names = [f"truth.q[{i}]" for i in range(1, joints + 1)] + ["truth.table"]
    cell.step(CYCLE_US, 5)
    expected = cell.get(*names)
    cell.restore(cell.deserialize(data), time_us)
    cell.step(CYCLE_US, 5)
    assert (cell.get(*names) == expected).all()


def links(joints: int) -> list[dict[str, Any]]:
    return [{"mass": 1.0, "centre_of_mass": [0, 0, 0], "inertia": np.diag([0.01] * 3).tolist()}] * joints


def drives(joints: int) -> list[dict[str, float]]:
    drive = {"motor_inertia": 0.5, "max_torque": 500.0, "gear_stiffness": 2e4, "gear_damping": 20.0}
    return [{**drive, "backlash": 0.0, "coulomb_friction": 0.0, "viscous_friction": 0.0}] * joints


@pytest.mark.parametrize("joints", [5, 8])
def test_gravity_loads_the_dynamic_drives_of_every_joint(build: Build, joints: int) -> None:
    """The motor torques at rest are the static moments of the links' weights about the axes."""
    cell = build(2, arm_cell(joints, dynamics={"links": links(joints), "drives": drives(joints)}))
    cell.step(CYCLE_US, 3)
    frames = arm_of(joints).link_poses(joints_of(cell, "truth", joints))
    expected = [
        sum(np.cross(link[:3, 3] - axis[:3, 3], [0, 0, 9.80665]) @ axis[:3, 2] for link in frames[i + 1 :])
        for i, axis in enumerate(frames[:-1])
    ]
    np.testing.assert_allclose(cell.vector("measured.torque", joints), expected, atol=2e-4)


@pytest.mark.parametrize(
    ("robot", "message"),
    [
        ({"joints": arm_cell(4)["robot"]["joints"][:3]}, "robot.joints: expected an array of length 4 to 8"),
        ({"held_joints": [1]}, "robot.held_joints: expected an array of length 0"),
        ({"joints": arm_cell(8)["robot"]["joints"], "held_joints": [2, 2]}, "robot.held_joints[1]: expected a joint"),
        ({"joints": arm_cell(7)["robot"]["joints"], "held_joints": [8]}, "robot.held_joints[0]: expected an integer"),
    ],
)
def test_invalid_arms_are_rejected(robot: dict[str, Any], message: str) -> None:
    assert message in rejection(arm_cell(6, **robot))


def test_cell_file_with_another_number_of_joints_is_rejected(build: Build, tmp_path: Path) -> None:
    file = tmp_path / "cell.json"
    file.write_text(json.dumps(arm_cell(7)))
    with pytest.raises(RuntimeError, match="7 joints instead of 6"):
        build(2, cell_description(), {"cell.file": str(file)})
