"""Axes beside joints and table: motions, true poses in closed form, states, and a part that a lift carries."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cell_fixture import (
    AXES,
    CYCLE_US,
    START,
    Array,
    Build,
    CellFmu,
    box_hull,
    box_part,
    cell_description,
    pose,
    rejection,
)
from continue_from_state import assert_continues_exactly, assert_restores_exactly
from grasp_fixture import OVER_BOX, grasp_cell, grip, part_in_gripper
from test_fmu_dynamic_arm import CENTRES, MASSES, dynamic_cell

NAMES = ("track", "column", "lift")
CYCLE = CYCLE_US * 1e-6


def motion(cell: CellFmu, cycles: int = 60) -> None:
    """All axes move by streamed set-points, from where the last ones ended."""
    first = cell.time_us // CYCLE_US
    for k in range(first, first + cycles):
        cell.command(START + 0.1 * np.sin(0.1 * k), 0.02 * k)
        for name, start, size in (("track", 0.1, 0.05), ("column", 0.0, 0.1), ("lift", 0.0, 0.01)):
            cell.set(f"command.axis.{name}", start + size * np.sin(0.07 * k))
        cell.step(CYCLE_US)


def carried(track: float, column: float) -> Array:
    """Pose (4, 4) in the world of the frame that the column carries."""
    c, s = np.cos(column), np.sin(column)
    return np.array([[c, -s, 0, 0.02], [s, c, 0, track - 0.1], [0, 0, 1, 0.05], [0, 0, 0, 1]])


@pytest.mark.parametrize("version", [2, 3])
def test_arm_and_table_follow_the_axes_that_carry_them(build: Build, version: int) -> None:
    cell, fixed = (
        build(version, AXES),
        build(version, {**AXES, "axes": [{**axis, "start": 0.0} for axis in AXES["axes"]]}),
    )
    base_from_link = np.linalg.inv(carried(0.0, 0.0)) @ fixed.body("link[6]")
    assert cell.get(*(f"measured.axis.{name}" for name in NAMES)) == pytest.approx([0.1, 0.0, 0.0], abs=1e-5)
    cell.set("command.mode", 2)
    for name, target in zip(NAMES, (-0.2, 0.4, 0.05), strict=True):
        cell.set(f"command.axis.{name}", target)
    cell.set("command.start", 1)
    cell.step(CYCLE_US, 200)
    assert cell.get_int("controller.error") == 0
    track, column, lift = cell.get(*(f"truth.axis.{name}" for name in NAMES))
    assert (track, column, lift) == pytest.approx((-0.2, 0.4, 0.05), abs=1e-12)
    assert cell.body("axis_frame.column") == pytest.approx(carried(track, column), abs=1e-12)
    assert cell.body("link[6]") == pytest.approx(carried(track, column) @ base_from_link, abs=1e-12)
    assert cell.body("table")[:3, 3] == pytest.approx([0.45, 0.0, 0.1 + lift], abs=1e-12)


def test_free_part_is_carried_by_the_lift_of_the_table(build: Build) -> None:
    cell = build(3, AXES)
    before = np.linalg.inv(cell.body("table")) @ cell.body("part[1]")
    heights = []
    for k in range(150):
        cell.command()
        cell.set("command.axis.track", 0.1)
        cell.set("command.axis.lift", 0.05 * (1 - np.cos(min(k * CYCLE, 1.5) * np.pi / 1.5)))
        cell.step(CYCLE_US)
        heights.append(cell.body("part[1]")[2, 3])
    assert heights[-1] - heights[0] == pytest.approx(0.1, abs=2e-5)
    after = np.linalg.inv(cell.body("table")) @ cell.body("part[1]")
    assert np.abs(after - before)[:3, 3].max() < 20e-6


@pytest.mark.parametrize("version", [2, 3])
def test_states_hold_the_axes(build: Build, version: int, tmp_path: Path) -> None:
    cell = build(version, AXES, {"seed": 3, "as_built.axis.track.x": 1e-4, "as_built.axis.lift.ry": 1e-3})
    motion(cell)
    cell.trigger(2, 0.02, exposure=0.003)
    cell.step(20_250)
    assert_restores_exactly(cell, motion)
    assert_continues_exactly(cell, motion, tmp_path)


def test_records_state_the_axes_at_the_exposure(build: Build) -> None:
    cell = build(3, AXES)
    motion(cell, 10)
    cell.trigger(1, 0.008, exposure=0.001)
    motion(cell, 20)
    track, lift = cell.get("trigger.measured.axis.track", "trigger.measured.axis.lift")
    assert cell.vector("trigger.truth.axis_frame.lift.position", 3)[2] == pytest.approx(lift, abs=1e-9)
    # The track's encoder is 2 ms late.
    late = cell.vector("trigger.truth.axis_frame.track.position", 3)[1] + 0.1 - track
    assert 1e-5 < abs(late) < 0.5e-3


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"moves_with": "axis[2]"}, 'axes[0].moves_with: expected "world", or "axis[i]" of an axis that comes before'),
        ({"min": 0.7, "max": 0.6}, "axes[0].max"),
        ({"start": 0.61}, "axes[0].start"),
        ({"max_jerk": 0.0}, "axes[0].max_jerk"),
    ],
)
def test_wrong_axes_are_refused_by_their_key(change: dict[str, float], message: str) -> None:
    first, *others = AXES["axes"]
    assert message in rejection({**AXES, "axes": [{**first, **change}, *others]})
    assert "axes: expected" in rejection({**AXES, "axes": [*AXES["axes"], first]})


def motors_on_axes(**drive: float) -> dict[str, Any]:
    """The dynamic arm on a tilted column, which turns on the track; by default its gears are practically rigid."""
    rigid = {"gear_stiffness": 1e9, "motor_inertia": 1e4, "gear_damping": 1e6, "max_torque": 1e7, **drive}
    cell = dynamic_cell(**rigid)
    track, column, lift = AXES["axes"]
    tilted = {**column, "parent_from_joint": pose([0.1, 0.03, 0.0], [np.cos(0.2), np.sin(0.2), 0.0, 0.0])}
    return {**cell, "axes": [track, tilted, lift], "robot": {**cell["robot"], "moves_with": "axis[2]"}}


def rotation_vector(rotation: Array) -> Array:
    """Rotation vector (3,) of a small rotation (3, 3)."""
    skew = (rotation - rotation.T) / 2
    return np.array([skew[2, 1], skew[0, 2], skew[1, 0]])


def torques_at(frames: Sequence[Sequence[Array]], step: float) -> Array:
    """Torques (6,) of the joints by the weights and accelerations of the links (d'Alembert's principle).

    `frames` are those of base and links at three instants, `step` s apart; the torques are those of the second.
    """
    torques = np.zeros(6)
    for i, (mass, centre) in enumerate(zip(MASSES, CENTRES, strict=True), 1):
        centres = [placed[i][:3, :3] @ centre + placed[i][:3, 3] for placed in frames]
        force = mass * (np.diff(centres, 2, axis=0)[0] / step**2 + [0, 0, 9.80665])
        rates = [rotation_vector(frames[k + 1][i][:3, :3] @ frames[k][i][:3, :3].T) / step for k in range(2)]
        moment = 0.01 * mass * (rates[1] - rates[0]) / step  # of an isotropic inertia
        for j, axis in enumerate(frames[1][:i]):
            torques[j] += axis[:3, 2] @ (np.cross(centres[1] - axis[:3, 3], force) + moment)
    return torques


def test_motors_feel_the_accelerations_of_the_axes_that_carry_the_arm(build: Build) -> None:
    cell = build(3, motors_on_axes())
    names = ["axis_frame.column", *(f"link[{i}]" for i in range(1, 7))]
    cell.command()
    errors, effects = [], []
    for k in range(60):
        rise = min(1.0, k / 20) ** 3
        cell.set("command.axis.track", 0.1 + rise * 0.1 * np.sin(4 * k * CYCLE))
        cell.set("command.axis.column", rise * 0.3 * np.sin(3 * k * CYCLE + 0.5))
        frames, torques = [], []
        for _ in range(16):
            cell.step(1000)
            frames.append([cell.body(name) for name in names])
            torques.append(cell.vector("measured.torque", 6))
        # A motor shows the torque of its gear in the step before, which is that of the middle of this step.
        expected, still = torques_at(frames[6:9], 1e-3), torques_at([frames[7]] * 3, 1e-3)
        errors.append((torques[8] + torques[9]) / 2 - expected)
        effects.append(expected - still)
    assert np.abs(effects).max() > 5.0
    assert np.abs(errors).max() < 2e-3 * np.abs(effects).max()


def test_arm_with_motors_sags_with_the_tilt_of_its_base(build: Build) -> None:
    description = motors_on_axes(gear_stiffness=2e4, motor_inertia=1.0, gear_damping=50.0)
    description["axes"][1] |= {"start": 0.8}
    cell = build(3, description)
    frames = [cell.body(name) for name in ("axis_frame.column", *(f"link[{i}]" for i in range(1, 7)))]
    expected = torques_at([frames] * 3, 1.0)
    assert abs(expected[0]) > 1.0  # the first axis is not vertical
    sag = cell.vector("truth.q", 6) - START
    assert sag == pytest.approx(-expected / 2e4, abs=1e-9)
    cell.step(CYCLE_US, 60)
    assert cell.vector("truth.q", 6) - START == pytest.approx(sag, abs=1e-9)


@pytest.mark.parametrize(("friction", "holds"), [(40.0, True), (0.5, False)])
def test_static_friction_holds_the_joints_of_an_accelerated_arm(build: Build, friction: float, holds: bool) -> None:
    cell = build(3, motors_on_axes(gear_stiffness=2e4, motor_inertia=1.0, gear_damping=50.0, coulomb_friction=friction))
    start = cell.vector("truth.q", 6)
    cell.start_move()
    for name, target in (("track", -0.3), ("column", 0.5)):
        cell.set(f"command.axis.{name}", target)
    away, speed = 0.0, 0.0
    for _ in range(400):
        cell.step(1000)
        away = max(away, float(np.abs(cell.vector("truth.q", 6) - start).max()))
        speed = max(speed, abs(float(cell.get("measured.axis_rate.track")[0])))
    assert speed > 0.3
    assert away < 1e-12 if holds else away > 1e-5


@pytest.mark.parametrize("version", [2, 3])
def test_states_hold_an_arm_with_motors_and_gripper_on_axes(build: Build, version: int, tmp_path: Path) -> None:
    dynamic = motors_on_axes(gear_stiffness=2e4, motor_inertia=1.0, gear_damping=50.0, coulomb_friction=1.0)
    carried = {**grasp_cell(START), "axes": dynamic["axes"], "robot": dynamic["robot"]}
    assert_continues_exactly(build(version, carried), motion, tmp_path)


def track_at(y: float, **changes: Any) -> dict[str, Any]:
    """A track along y whose frame is at a point of the y axis, where it starts."""
    placed = {**AXES["axes"][0]["parent_from_joint"], "position": [0.0, y, 0.0]}
    return {**AXES["axes"][0], "parent_from_joint": placed, "start": 0.0, **changes}


def gripper_on_track(acceleration: float) -> dict[str, Any]:
    """The gripper around a box on the table, its arm on a track along y."""
    cell = grasp_cell()
    track = track_at(0.0, max_speed=2.0, max_acceleration=acceleration, max_jerk=1e3)
    return {**cell, "axes": [track], "robot": {**cell["robot"], "moves_with": "axis[1]"}}


@pytest.mark.parametrize(("acceleration", "holds"), [(1.0, True), (12.0, False)])
def test_gripper_on_a_track_carries_a_part_as_friction_holds_it(build: Build, acceleration: float, holds: bool) -> None:
    """Friction of 0.5 times 5.5 N on two pads holds the weight of 0.4 kg and 3.9 N along the pads: 9.6 m/s²."""
    cell = build(3, gripper_on_track(acceleration))
    grip(cell, 5.5)
    lifted = OVER_BOX + np.array([0, -0.15, 0, 0, 0, 0])
    for share in np.linspace(0, 1, 60):
        cell.command(OVER_BOX + share * (lifted - OVER_BOX))
        cell.step(CYCLE_US)
    before, finger = part_in_gripper(cell), np.linalg.inv(cell.body("link[6]")) @ cell.body("finger[1]")
    cell.start_move(lifted)
    cell.set("command.axis.track", 0.35)
    cell.step(CYCLE_US, 120)
    assert cell.get("truth.axis.track")[0] == pytest.approx(0.35, abs=1e-9)
    moved = np.abs(part_in_gripper(cell) - before)[:3, 3].max()
    assert moved < 50e-6 if holds else moved > 5e-3
    assert np.linalg.inv(cell.body("link[6]")) @ cell.body("finger[1]") == pytest.approx(finger, abs=2e-3)


def test_carriage_pushes_a_free_part_and_carries_what_lies_on_it(build: Build) -> None:
    """A block on a track: one part stands before it on the floor, another one lies on it."""
    cell = cell_description(fixture="free", stands_on="world", support_from_part=pose([0.0, 0.7, 0.0]))
    rider = box_part(0.05, 0.05, 0.02, 0.2, name="rider", fixture="free", stands_on="world")
    rider["support_from_part"] = pose([0.0, 0.5, 0.1])
    bodies = [
        {"name": "carriage", "frame": "axis[1]", "hull": box_hull(0.2, 0.2, 0.1)},
        {"name": "floor", "frame": "world", "hull": box_hull(4.0, 4.0, 0.1, -0.1)},
    ]
    contact, parts = {**cell["contact"], "bodies": bodies}, [*cell["parts"], rider]
    built = build(3, {**cell, "axes": [track_at(0.5)], "parts": parts, "contact": contact})
    start = [built.body(f"part[{i}]") for i in (1, 2)]
    built.start_move()
    built.set("command.axis.track", 0.3)
    built.step(CYCLE_US, 150)
    pushed, carried = (built.body(f"part[{i}]") for i in (1, 2))
    # 0.08 m lie between the carriage and the box, whose half depth is 0.02 m.
    assert pushed[1, 3] == pytest.approx(0.5 + 0.3 + 0.1 + 0.02, abs=2e-3)
    assert carried[:3, 3] - start[1][:3, 3] == pytest.approx([0, 0.3, 0], abs=50e-6)
