"""Poses and Jacobians of trees against homogeneous matrices, and the frames and axes of cells."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from cells import cell_file
from scipy.spatial.transform import Rotation

from scancell import DescriptionError, Scanner, assets_dir, load_part, load_setup, nominal_cell
from scancell.geometry import pose
from scancell.geometry.mesh import box_mesh
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
    setup = load_setup(assets_dir() / "cells/pick_and_place.toml")
    cell = nominal_cell(setup.cell, load_part(assets_dir() / "parts/step_block.stl"))
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


# A track along world y that carries the arm, a second sensor on the carriage, and the part on the flange.
GANTRY = """
[[axis]]
name = "track"
kind = "prismatic"
pose = { x_mm = 100.0, z_mm = 50.0, rx_deg = -90.0 }
min_mm = -100.0
max_mm = 900.0
max_speed_mm_s = 300.0
max_acceleration_mm_s2 = 600.0

[[further_sensor]]
name = "second"
moves_with = "track"
pose = { x_mm = 10.0, y_mm = 20.0, z_mm = 30.0 }
"""
ON_TRACK = ['cell.robot_moves_with="track"', 'cell.part.moves_with="flange"', "cell.part.z_mm=5"]
PLATE = box_mesh((0.06, 0.04, 0.01), "plate")


def test_prismatic_axis_second_sensor_and_part_on_the_flange_are_placed_in_closed_form(tmp_path) -> None:
    setup = load_setup(cell_file(tmp_path, GANTRY), settings=ON_TRACK)
    cell = nominal_cell(setup.cell, PLATE)
    assert cell.tree.axes == (*(f"joint[{i}]" for i in range(1, 7)), "table", "track")
    q, table, travel = np.radians([20, -60, 150, 10, -40, 70]), 0.3, 0.7
    frames = cell.frame_poses([*q, table, travel])

    # The z axis of the track is turned to +y, its x stays: the carriage is at (100, travel, 50) mm.
    turned = Rotation.from_euler("x", -90, degrees=True)
    carriage = np.array([0.1, travel, 0.05])
    assert frames["sensor[2]"][:3, 3] == pytest.approx(carriage + turned.apply([0.01, 0.02, 0.03]), abs=1e-12)
    base = setup.cell.robot.base
    at, turn = np.array([base.x_mm, base.y_mm, base.z_mm]) * 1e-3, turned
    at = carriage + turn.apply(at)
    for joint, angle in zip(setup.cell.robot.joint, q, strict=True):
        turn = turn * Rotation.from_euler("z", angle + np.radians(joint.theta_deg))
        at = at + turn.apply([1e-3 * joint.a_mm, 0.0, 1e-3 * joint.d_mm])
        turn = turn * Rotation.from_euler("x", joint.alpha_deg, degrees=True)
    assert frames["link[6]"][:3, 3] == pytest.approx(at, abs=1e-12)
    # The plate lies with its lowest point 5 mm before the flange.
    assert frames["part"][:3, 3] == pytest.approx(at + turn.apply([0.0, 0.0, 0.005 + 0.005]), abs=1e-12)
    assert frames["part"][:3, :3] == pytest.approx(turn.as_matrix(), abs=1e-12)
    poses = dict(zip((body.name for body in cell.bodies), cell.body_poses([*q, table, travel]), strict=True))
    (mesh,) = (body.mesh for body in cell.bodies if body.name == "base")
    at_rest = load_setup().cell
    (standing,) = (body.mesh for body in nominal_cell(at_rest, None).bodies if body.name == "base")
    moved = pose.transform_points(poses["base"], mesh.vertices)
    assert moved == pytest.approx(carriage + turned.apply(standing.vertices.copy()), abs=1e-9)
    assert frames["table"][:3, 3] == pytest.approx(cell.world_from_table[:3, 3])


def test_arm_that_carries_both_part_and_sensor_cannot_scan() -> None:
    setup = load_setup(settings=['cell.part.moves_with="flange"'])
    with pytest.raises(
        DescriptionError, match=r"cell\.part\.moves_with = 'flange': the arm carries both part and sensor"
    ):
        Scanner(setup=setup).scan(PLATE, engine="geometric")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (['cell.robot_moves_with="rail"'], r"robot_moves_with = 'rail': expected world, track"),
        (['cell.table.moves_with="link[2]"'], r"table\.moves_with = 'link\[2\]': expected world, track"),
        (['cell.axis[1].moves_with="track"'], "expected world: an axis is listed after what carries it"),
        (
            ['cell.further_sensor[1].moves_with="rail"'],
            r"further_sensor\[1\]\.moves_with = 'rail': expected world, track",
        ),
        (["cell.axis[1].start_mm=901"], r"start_mm = 901: expected a position from -100 to 900"),
        (["cell.axis[1].min_mm=900"], r"min_mm \(900\) must be below max_mm \(900\)"),
        (['cell.axis[1].kind="revolute"'], "min_deg"),
        (['cell.axis[1].name="table"'], "expected a name of no other frame or column"),
        (['cell.axis[1].name="q7"'], "expected a name of no other frame or column"),
        (['cell.axis[1].name="Track 1"'], "axis"),
    ],
)
def test_carriers_that_do_not_exist_or_carry_themselves_are_refused(tmp_path, words, message) -> None:
    with pytest.raises(DescriptionError, match=message):
        load_setup(cell_file(tmp_path, GANTRY), settings=words)
