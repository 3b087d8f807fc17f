"""True poses and twists against an independent Denavit-Hartenberg product."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from cell_fixture import BODIES, CYCLE_US, START, Array, Build, CellFmu, cell_description, pose
from scipy.spatial.transform import Rotation


def translation(x: float = 0, y: float = 0, z: float = 0) -> Array:
    matrix = np.eye(4)
    matrix[:3, 3] = x, y, z
    return matrix


def rotation(axis: str, angle: float) -> Array:
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler(axis, angle).as_matrix()
    return matrix


def from_json(pose_json: dict[str, list[float]]) -> Array:
    matrix = translation(*pose_json["position"])
    w, x, y, z = pose_json["quaternion"]
    matrix[:3, :3] = Rotation.from_quat([x, y, z, w]).as_matrix()
    return matrix


def expected_poses(cell: dict[str, Any], q: Array, table: float, delta: dict[str, float]) -> dict[str, Array]:
    """World poses of all bodies from the definition of the geometry."""

    def deviation(name: str) -> float:
        return delta.get(f"as_built.{name}", 0.0)

    here = from_json(cell["robot"]["world_from_base"])
    poses = {}
    for i, joint in enumerate(cell["robot"]["joints"], start=1):
        row = {key: joint[key] + deviation(f"dh[{i}].{key}") for key in ("a", "d", "alpha", "theta")}
        here = here @ rotation("z", q[i - 1] + row["theta"])
        here = here @ translation(row["a"], 0, row["d"]) @ rotation("x", row["alpha"])
        here = here @ rotation("y", joint.get("beta", 0.0) + deviation(f"dh[{i}].beta"))
        poses[f"link[{i}]"] = here
    tool = translation(*(deviation(f"tool.{k}") for k in "xyz"))
    for axis in "xyz":
        tool = tool @ rotation(axis, deviation(f"tool.r{axis}"))
    poses["sensor"] = here @ from_json(cell["tool"]["flange_from_sensor"]) @ tool
    axis = from_json(cell["table"]["world_from_table"]) @ translation(*(deviation(f"table.{k}") for k in "xyz"))
    axis = axis @ rotation("x", deviation("table.rx")) @ rotation("y", deviation("table.ry"))
    wobble = deviation("table.wobble_amplitude") * np.cos(table + deviation("table.wobble_phase"))
    direction = rotation("z", deviation("table.wobble_direction"))
    axis = axis @ direction @ rotation("x", wobble) @ np.linalg.inv(direction)
    platter = axis @ rotation("z", table) @ translation(deviation("platter.x"), deviation("platter.y"))
    poses["table"] = platter
    poses["part[1]"] = platter @ from_json(cell["parts"][0]["support_from_part"])
    return poses


def as_built_names() -> list[str]:
    names = [f"as_built.dh[{i}].{key}" for i in range(1, 7) for key in ("a", "d", "alpha", "theta")]
    names += ["as_built.dh[2].beta", *(f"as_built.tool.{k}" for k in ("x", "y", "z", "rx", "ry", "rz"))]
    return [*names, *(f"as_built.table.{k}" for k in ("x", "y", "z", "rx", "ry")), *platter_names()]


def platter_names() -> list[str]:
    wobble = [f"as_built.table.wobble_{key}" for key in ("amplitude", "phase", "direction")]
    return ["as_built.platter.x", "as_built.platter.y", *wobble]


def tilted_cell() -> dict[str, Any]:
    """A cell in which no transform is trivial."""
    x, y, z, w = Rotation.from_euler("XYZ", [0.3, -0.2, 0.5]).as_quat()
    cell = cell_description(support_from_part=pose([0.02, -0.03, 0.01], [w, x, y, z]))
    cell["robot"]["world_from_base"] = pose([0.1, -0.2, 0.3], [w, -x, y, -z])
    cell["table"]["world_from_table"] = pose([0.5, 0.1, 0.05], [w, y, -x, z])
    for i, joint in enumerate(cell["robot"]["joints"]):
        joint["theta"] = 0.1 * (i - 2.5)
    cell["robot"]["joints"][1] |= {"alpha": 0.004, "beta": -0.007}  # nearly parallel axes
    return cell


def move(cell: CellFmu, until_us: int) -> None:
    """A motion of all axes."""
    while cell.time_us < until_us:
        command_motion(cell)
        cell.step(CYCLE_US)


def command_motion(cell: CellFmu) -> None:
    t = cell.time_us * 1e-6
    cell.command(START + 0.3 * np.sin(np.arange(1, 7) * t), 0.8 * t + 0.1 * np.sin(5 * t))


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("deviates", [False, True])
def test_poses_match_denavit_hartenberg_product(build: Build, version: int, deviates: bool) -> None:
    rng = np.random.default_rng(7)
    delta = {name: float(rng.normal(0, 0.01)) for name in as_built_names()} if deviates else {}
    description = tilted_cell()
    cell = build(version, description, delta)
    for until_us in (0, 320_000, 1_600_000):
        move(cell, until_us)
        q, table = cell.vector("truth.q", 6), cell.get("truth.table")[0]
        for name, expected in expected_poses(description, q, table, delta).items():
            np.testing.assert_allclose(cell.body(name), expected, atol=1e-12, err_msg=name)


def test_joint_zero_error_is_invisible_to_encoder(build: Build) -> None:
    nominal = build()
    offset = build(parameters={"as_built.dh[3].theta": np.radians(0.05)})
    np.testing.assert_array_equal(offset.vector("measured.q", 6), nominal.vector("measured.q", 6))
    # First order: a turn about joint 3's axis moves the sensor by axis x lever.
    frame = nominal.body("link[2]")
    lever = nominal.body("sensor")[:3, 3] - frame[:3, 3]
    moved = offset.body("sensor")[:3, 3] - nominal.body("sensor")[:3, 3]
    np.testing.assert_allclose(moved, np.radians(0.05) * np.cross(frame[:3, 2], lever), atol=3e-7)


@pytest.mark.parametrize("fixture", ["clamped", "free"])
def test_twists_are_pose_derivatives(build: Build, fixture: str) -> None:
    wobble = {"as_built.table.wobble_amplitude": 0.002, "as_built.table.wobble_direction": 0.4}
    cell = build(3, cell_description(fixture=fixture), wobble)
    move(cell, 800_000)
    command_motion(cell)
    cell.step(7_300)
    h_us = 20
    before = {name: cell.body(name) for name in BODIES}
    cell.step(h_us)
    twists = {
        name: (cell.vector(f"truth.{name}.velocity", 3), cell.vector(f"truth.{name}.angular_velocity", 3))
        for name in BODIES
    }
    cell.step(h_us)
    for name in BODIES:
        after = cell.body(name)
        velocity = (after - before[name])[:3, 3] / (2 * h_us * 1e-6)
        rotation = Rotation.from_matrix(after[:3, :3] @ before[name][:3, :3].T).as_rotvec() / (2 * h_us * 1e-6)
        np.testing.assert_allclose(twists[name][0], velocity, atol=2e-8, err_msg=name)
        np.testing.assert_allclose(twists[name][1], rotation, atol=2e-8, err_msg=name)
        assert np.linalg.norm(rotation) > 0.1, "the test needs motion"
