"""Loads of the flange: joint torques of planning and of the FMU against a recursive Newton-Euler of the test's own."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from cells import block, cell_file

from scancell import NominalCell, Scanner, assets_dir, load_setup, nominal_cell
from scancell.cell.fmu_file import dynamics_json
from scancell.config.cell import CellDescription
from scancell.geometry import pose
from scancell.nominal.cell import arm_of
from scancell.nominal.plausibility import payload_warnings
from scancell.planning.motion.trajectory import TorqueLimits, arm_skeleton, joint_torques

# An asymmetric sensor, and a gripper beside it.
LOADED = [
    "cell.tool.fixture={ plate_mm = 10.0, reach_mm = 60.0, offset_mm = 35.0, tilt_deg = 25.0, rotation_deg = 40.0 }",
    "cell.tool.inertia.mass_kg=1.3", "cell.tool.inertia.centre_of_mass_mm=[30.0, -20.0, -45.0]",
    "cell.tool.inertia.inertia_kg_m2=[0.006, 0.009, 0.004]",
    "cell.tool.inertia.products_kg_m2=[0.001, -0.0015, 0.0007]",
    "cell.gripper.pose={ x_mm = -60.0, y_mm = 15.0, z_mm = 20.0, rx_deg = 20.0 }", "cell.gripper.stroke_mm=60.0",
    "cell.gripper.start_mm=44.0", "cell.gripper.finger_length_mm=50.0", "cell.gripper.finger_width_mm=18.0",
    "cell.gripper.finger_thickness_mm=8.0", "cell.gripper.finger_mass_kg=0.2",
    "cell.gripper.housing_mm=[80.0, 40.0, 50.0]", 'cell.robot.drive="dynamic"',
]  # fmt: skip
RNG = np.random.default_rng(11)

Load = tuple[float, np.ndarray, np.ndarray]  # mass, centre of mass and inertia about it, in the frame of the flange


def newton_euler(cell: CellDescription, loads: Sequence[Load], q: np.ndarray, qd: np.ndarray, qdd: np.ndarray,
                 arm=None) -> np.ndarray:  # fmt: skip
    """Joint torques (joints,) of links and loads by Newton-Euler's equations in world axes, link by link."""
    arm = arm_of(cell.robot) if arm is None else arm
    frames = arm.link_poses(q)
    links = [(link["mass"], np.array(link["centre_of_mass"]), np.array(link["inertia"])) for link in bare(cell)]
    bodies = [[link] for link in links]
    bodies[-1] += list(loads)
    rate, turning = np.zeros(3), np.zeros(3)
    acceleration, origin = np.array([0.0, 0.0, 9.80665]), frames[0][:3, 3]
    wrenches = []
    for i in range(len(q)):
        axis = frames[i][:3, 2]
        turning = turning + axis * qdd[i] + np.cross(rate, axis * qd[i])
        rate = rate + axis * qd[i]
        lever = frames[i + 1][:3, 3] - origin
        acceleration = acceleration + np.cross(turning, lever) + np.cross(rate, np.cross(rate, lever))
        origin, rotation = frames[i + 1][:3, 3], frames[i + 1][:3, :3]
        for mass, centre, inertia in bodies[i]:
            at, about = rotation @ centre, rotation @ inertia @ rotation.T
            force = mass * (acceleration + np.cross(turning, at) + np.cross(rate, np.cross(rate, at)))
            moment = about @ turning + np.cross(rate, about @ rate)
            wrenches.append((i, origin + at, force, moment))
    torques = np.zeros(len(q))
    for i, point, force, moment in wrenches:
        for j in range(i + 1):
            torques[j] += frames[j][:3, 2] @ (np.cross(point - frames[j][:3, 3], force) + moment)
    return torques


def bare(cell: CellDescription) -> list[dict]:
    """Links of the arm without what the flange carries."""
    tool = cell.tool.model_copy(update={"inertia": None})
    return dynamics_json(cell.model_copy(update={"tool": tool, "sensor_mesh": None, "gripper": None}))["links"]


def placed(load: Load, flange_from_body: np.ndarray) -> Load:
    mass, centre, inertia = load
    turn = flange_from_body[:3, :3]
    return mass, turn @ centre + flange_from_body[:3, 3], turn @ inertia @ turn.T


def box(mass: float, size: Sequence[float], centre: Sequence[float]) -> Load:
    x, y, z = size
    return mass, np.array(centre), np.diag([y * y + z * z, x * x + z * z, x * x + y * y]) * mass / 12


def carried(cell: CellDescription) -> list[Load]:
    """Sensor, housing and fingers, from the numbers above."""
    tool = pose.from_rotation(pose.rotation_about(2, np.radians(40))) @ pose.translation((0.035, 0, 0.07))
    tool = tool @ pose.from_rotation(pose.rotation_about(1, np.radians(25)))
    tensor = np.array([[6.0, 1.0, -1.5], [1.0, 9.0, 0.7], [-1.5, 0.7, 4.0]]) * 1e-3
    gripper = pose.from_euler_xyz((-0.06, 0.015, 0.02), (np.radians(20), 0, 0))
    density = cell.robot.link_density_kg_m3
    turned = pose.from_rotation(np.diag([-1.0, -1.0, 1.0]))
    finger = box(0.2, (0.008, 0.018, 0.05), (0.022 + 0.004, 0, 0.025))
    return [
        placed((1.3, np.array([0.03, -0.02, -0.045]), tensor), tool),
        placed(box(density * 0.08 * 0.04 * 0.05, (0.08, 0.04, 0.05), (0, 0, -0.025)), gripper),
        placed(finger, gripper),
        placed(finger, gripper @ turned),
    ]


ON_FLANGE = ['cell.part.moves_with="flange"', "cell.part.rx_deg=30", "cell.part.z_mm=100", "cell.part.x_mm=10"]
SIZE = (0.06, 0.04, 0.02)  # m, of the part


def part_load(cell: CellDescription, flange_from_part: np.ndarray) -> Load:
    mass = cell.part.density_kg_m3 * float(np.prod(SIZE))
    return placed(box(mass, SIZE, (0.0, 0.0, SIZE[2] / 2)), flange_from_part)


def test_planned_torques_are_those_of_arm_and_loads() -> None:
    setup = load_setup(settings=[*LOADED, *ON_FLANGE])
    cell, nominal = setup.cell, nominal_cell(setup.cell, block(*SIZE))
    placed_frames = nominal.tree.place(nominal.start)
    flange_from_part = pose.inverse(placed_frames[nominal.arm.flange]) @ placed_frames["part"]
    loads = [*carried(cell), part_load(cell, flange_from_part)]
    q, qd, qdd = RNG.uniform(-2, 2, (3, 8, 6))
    torques = joint_torques(arm_skeleton(cell, nominal), q, qd, qdd)
    expected = np.array([newton_euler(cell, loads, *row) for row in zip(q, qd, qdd, strict=True)])
    light = np.array([newton_euler(cell, loads[:1], *row) for row in zip(q, qd, qdd, strict=True)])
    assert np.abs(expected - light).max() > 2.0
    assert np.abs(torques - expected).max() < 1e-9 * np.abs(expected).max()
    # The last joint, which moves the loads alone, has small torques.
    assert np.abs(torques - expected)[:, 5].max() < 1e-9 * np.abs(expected[:, 5]).max()


def test_planner_on_a_tilted_column_knows_the_direction_of_gravity(tmp_path) -> None:
    """The arm stands on an axis about y that rests at 50 degrees."""
    axis = """
[[axis]]
name = "cant"
kind = "revolute"
along = "y"
min_deg = -90.0
max_deg = 90.0
start_deg = 50.0
max_speed_deg_s = 40.0
max_acceleration_deg_s2 = 90.0
"""
    setup = load_setup(cell_file(tmp_path, axis), settings=[*LOADED, 'cell.robot_moves_with="cant"'])
    cell, nominal = setup.cell, nominal_cell(setup.cell, block(*SIZE))
    q, still = RNG.uniform(-1, 1, (4, 6)), np.zeros(6)
    torques = joint_torques(arm_skeleton(cell, nominal), q, np.zeros((4, 6)), np.zeros((4, 6)))
    arm = nominal.with_axes_held().arm
    expected = np.array([newton_euler(cell, carried(cell), row, still, still, arm) for row in q])
    assert np.abs(expected[:, 0]).min() > 1.0
    assert np.abs(torques - expected).max() < 1e-9 * np.abs(expected).max()


def test_motors_of_the_simulated_cell_hold_arm_and_loads() -> None:
    setup = load_setup(settings=LOADED)
    with Scanner(setup=setup) as scanner, scanner.session(block(*SIZE)) as session:
        names = ([f"truth.q[{i}]" for i in range(1, 7)], [f"measured.torque[{i}]" for i in range(1, 7)])
        q, torques = (session.cell.get(session.cell.real_group(group)).copy() for group in names)
    expected = newton_euler(setup.cell, carried(setup.cell), q, np.zeros(6), np.zeros(6))
    bare_arm = newton_euler(setup.cell, [], q, np.zeros(6), np.zeros(6))
    assert np.abs(expected - bare_arm).max() > 3.0
    assert torques == pytest.approx(expected, abs=1e-6 * np.abs(expected).max())


def test_payload_slows_a_motion_down_and_may_be_too_heavy_to_hold() -> None:
    part, q = block(0.15, 0.15, 0.1), np.linspace([0, -1.2, 2.6, 0, 0.4, 0], [1.5, -0.2, 3.6, 1.0, 1.2, 1.0], 40)
    weak = [f"cell.robot.joint[{i}].drive.max_torque_n_m=95" for i in (2, 3)]
    setup = load_setup(settings=[*LOADED, *ON_FLANGE, *weak, "cell.part.density_kg_m3=1000"])
    light = nominal_cell(setup.cell, block(0.01, 0.01, 0.01))
    heavy = nominal_cell(setup.cell, part)
    factors = [TorqueLimits(setup.cell, one).needed_slowdown(q, 0.01)[0] for one in (light, heavy)]
    assert factors[1] > 1.05 * factors[0] > 0
    lead = setup.cell.replace({"part.density_kg_m3": 11000})
    factor, joint = TorqueLimits(lead, heavy).needed_slowdown(q, 0.01)
    assert (factor, joint) == (np.inf, 1)


def test_loads_beyond_the_rated_payload_are_stated() -> None:
    rated = "cell.robot.payload_kg=2.0"
    assert payload_warnings(load_setup(settings=LOADED).cell, nominal_of(LOADED)) == []
    # Sensor 1.3 kg, housing 0.32 kg, fingers of 0.2 kg each.
    (text,) = payload_warnings(load_setup(settings=[*LOADED, rated]).cell, nominal_of(LOADED))
    assert text == (
        "cell.robot.payload_kg = 2: the flange carries 2.02 kg"
        " (sensor 1.3 kg, gripper 0.32 kg, finger1 0.2 kg, finger2 0.2 kg)"
    )
    free = [*LOADED, 'cell.part.fixture="free"', "cell.robot.payload_kg=2.1"]
    (text,) = payload_warnings(load_setup(settings=free).cell, nominal_of(free))
    assert text.endswith("finger2 0.2 kg, and part 0.13 kg if the gripper holds it)")
    assert "carries 2.15 kg" in text
    assert payload_warnings(load_setup(settings=[*free[:-1], "cell.robot.payload_kg=2.2"]).cell, nominal_of(free)) == []


def nominal_of(settings: Sequence[str]) -> NominalCell:
    return nominal_cell(load_setup(settings=list(settings)).cell, block(*SIZE))


def test_scan_states_a_payload_beyond_the_rated_one() -> None:
    settings = ["cell.robot.payload_kg=0.2", "scan.max_profiles=20"]
    with Scanner(settings=settings) as scanner:
        result = scanner.scan(assets_dir() / "artefacts/cone.toml", engine="geometric")
    assert [text for text in result.warnings if text.startswith("cell.robot.payload_kg = 0.2: the flange carries")]
