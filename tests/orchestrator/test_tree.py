"""Poses and Jacobians of trees against homogeneous matrices, and the frames and axes of cells."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import scancell
from scancell.geometry import pose
from scancell.geometry.tree import Joint, Tree

KINDS = ("fixed", "revolute", "prismatic")


def random_pose(rng: np.random.Generator) -> np.ndarray:
    return pose.from_rotation(Rotation.random(random_state=rng).as_matrix(), rng.uniform(-0.3, 0.3, 3))


def random_tree(rng: np.random.Generator, count: int = 7) -> Tree:
    """Branches of any depth; two joints share their axis."""
    joints = []
    for i in range(count):
        parent = f"frame {int(rng.integers(i))}" if i and rng.uniform() < 0.8 else "world"
        kind = KINDS[int(rng.integers(3))]
        joint = Joint(f"frame {i}", parent, kind, "" if kind == "fixed" else f"axis {i}", float(rng.normal()))
        joints.append(replace(joint, parent_from_joint=random_pose(rng), joint_from_frame=random_pose(rng)))
    moving = [i for i, joint in enumerate(joints) if joint.kind != "fixed"]
    if len(moving) > 1:
        joints[moving[-1]] = replace(joints[moving[-1]], axis=joints[moving[0]].axis)
    return Tree(joints)


def placed(tree: Tree, positions: np.ndarray) -> dict[str, np.ndarray]:
    """One matrix product after the other, with rotations of SciPy."""
    frames = {"world": np.eye(4)}
    for joint in tree.joints:
        motion = np.eye(4)
        if joint.kind != "fixed":
            value = positions[tree.axes.index(joint.axis)] + joint.zero
            if joint.kind == "revolute":
                motion[:3, :3] = Rotation.from_rotvec([0, 0, value]).as_matrix()
            else:
                motion[2, 3] = value
        frames[joint.frame] = frames[joint.parent] @ joint.parent_from_joint @ motion @ joint.joint_from_frame
    return frames


@pytest.mark.parametrize("seed", range(30))
def test_frames_are_where_products_of_matrices_place_them(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tree = random_tree(rng)
    positions = rng.uniform(-3, 3, (2, 3, len(tree.axes)))
    found = tree.place(positions)
    for row in np.ndindex(2, 3):
        for frame, at in placed(tree, positions[row]).items():
            assert found[frame][row] == pytest.approx(at, abs=1e-12)
    assert list(found) == ["world", *(joint.frame for joint in tree.joints)]
    (single,) = tree.place(positions[0, 0], ["frame 6"]).values()
    assert single == pytest.approx(found["frame 6"][0, 0], abs=1e-15)


@pytest.mark.parametrize("seed", range(30))
def test_jacobian_is_the_derivative_of_the_pose(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tree, step = random_tree(rng), 1e-6
    at = rng.uniform(-3, 3, len(tree.axes))
    for joint in tree.joints:
        found = tree.jacobian(joint.frame, at)
        for k, axis in enumerate(tree.axes):
            before, after = (placed(tree, at + sign * step * np.eye(len(at))[k])[joint.frame] for sign in (-1, 1))
            turn = Rotation.from_matrix(after[:3, :3] @ before[:3, :3].T).as_rotvec()
            expected = np.concatenate([after[:3, 3] - before[:3, 3], turn]) / (2 * step)
            assert found[:, k] == pytest.approx(expected, abs=1e-8)
            assert axis in tree.axes_of(joint.frame) or not expected.any()


def test_axes_that_are_not_stated_are_at_zero() -> None:
    tree = random_tree(np.random.default_rng(4))
    count = len(tree.axes)
    assert count > 2
    some = np.array([0.3, -0.2])
    padded = tree.place([*some, *np.zeros(count - 2)])
    for frame, at in tree.place(some).items():
        assert np.array_equal(at, padded[frame])


@pytest.mark.parametrize("axes", [(), ("axis 1",), ("axis 0", "axis 3", "axis 5")])
def test_carrier_is_the_last_frame_that_some_axes_move(axes: tuple[str, ...]) -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        tree = random_tree(rng)
        positions = np.where([axis in axes for axis in tree.axes], rng.uniform(-2, 2, len(tree.axes)), 0.0)
        at = placed(tree, positions)
        for joint in tree.joints:
            carrier, carrier_from_frame = tree.carrier_of(joint.frame, axes)
            assert carrier == "world" or tree[carrier].axis in axes
            assert at[carrier] @ carrier_from_frame == pytest.approx(at[joint.frame], abs=1e-12)


def test_axis_of_a_wobbling_table_is_tilted_with_its_angle() -> None:
    tilt = np.array([2e-4, -1e-4, 3e-4, 5e-5])
    table = Tree([Joint("table", kind="revolute", axis="table", wobble=(*tilt,))])
    for angle in np.linspace(-7, 7, 9):
        rx, ry = tilt[:2] @ [np.cos(angle), np.sin(angle)], tilt[2:] @ [np.cos(angle), np.sin(angle)]
        expected = Rotation.from_euler("XYZ", [rx, ry, angle]).as_matrix()
        assert table.place([angle])["table"][:3, :3] == pytest.approx(expected, abs=1e-14)


def test_axes_of_cells_are_joints_table_and_conveyors() -> None:
    setup = scancell.load_setup(scancell.assets_dir() / "cells/pick_and_place.toml")
    cell = scancell.nominal_cell(setup.cell, scancell.load_part(scancell.assets_dir() / "parts/step_block.stl"))
    joints = tuple(f"joint[{i}]" for i in range(1, 7))
    assert cell.tree.axes == (*joints, "table", "conveyor[1]")
    assert cell.axes == (*joints, "table")
    assert cell.tree.axes_of("sensor") == cell.tree.axes_of("finger[1]") == joints
    assert cell.tree.axes_of("part") == ("table",)
    riding = cell.on_belt()
    assert riding.tree.axes_of("part") == ("conveyor[1]",)
    moved = [riding.world_from("part", [*cell.home, 0.4, travel]) for travel in (0.0, 0.25)]
    along = riding.world_from("conveyor[1]")[:3, 0]
    assert moved[1][:3, 3] - moved[0][:3, 3] == pytest.approx(0.25 * along, abs=1e-15)
    assert np.array_equal(moved[0][:3, :3], moved[1][:3, :3])
