"""Gripper of the FMU: picking a part from the table, smooth moves, and loss in a step move."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cell_fixture import CYCLE_US, Build, CellFmu, Parameters, all_reals, cell_description, pose, rejection
from continue_from_state import assert_continues_exactly
from grasp_fixture import (
    BOX,
    CYCLE,
    GRAVITY,
    MASS,
    OVER_BOX,
    PAD_FRICTION,
    PLACE,
    TABLE,
    grasp_cell,
    grip,
    gripper,
    joints_at,
    move,
    part_in_gripper,
    smooth,
)
from test_fmu_dynamic_arm import dynamic_cell

SINE = {"x": 1e-4, "y": -2e-4, "z": 3e-4, "frequency": 23.0, "phase": 0.7}
LIFTED = joints_at(np.array([*PLACE, TABLE[2] + 0.12]))


def with_drives(drives: str) -> dict[str, Any]:
    description = grasp_cell()
    if drives == "dynamic":
        description["robot"]["dynamics"] = dynamic_cell()["robot"]["dynamics"]
    return description


def velocity_on_flange(cell: CellFmu, body: str) -> np.ndarray:
    """Velocity (3,) of the flange at the origin of a body."""
    arm = cell.body(body)[:3, 3] - cell.body("link[6]")[:3, 3]
    turn = cell.vector("truth.link[6].angular_velocity", 3)
    return np.asarray(cell.vector("truth.link[6].velocity", 3) + np.cross(turn, arm))


def rotated_joint(joint: int, angle: float) -> np.ndarray:
    q = LIFTED.copy()
    q[joint] += angle
    return q


def test_gripper_moves_to_commanded_width(build: Build) -> None:
    cell = build(3, grasp_cell())
    assert cell.get("measured.gripper.width")[0] == pytest.approx(0.06, abs=1e-12)
    cell.command(OVER_BOX)
    cell.set("command.gripper.mode", 1)
    cell.set("command.gripper.width", 1.0)  # more than the stroke
    cell.step(CYCLE_US, 20)
    assert cell.get("measured.gripper.width")[0] == pytest.approx(0.08, abs=1e-6)
    fingers = [cell.body(f"finger[{i}]")[:3, 3] for i in (1, 2)]
    assert np.linalg.norm(fingers[0] - fingers[1]) == pytest.approx(0.08, abs=1e-6)


def test_gripper_closes_with_commanded_force(build: Build) -> None:
    cell = build(3, grasp_cell())
    assert not cell.get_int("measured.gripper.gripped")
    grip(cell, 30.0)
    assert cell.get_int("measured.gripper.gripped")
    width, force = cell.get("measured.gripper.width", "measured.gripper.force")
    assert width == pytest.approx(BOX[0], abs=2e-5)
    assert force == pytest.approx(30.0, rel=1e-6)
    assert [cell.get(f"truth.finger[{i}].normal_force")[0] for i in (1, 2)] == pytest.approx([30.0, 30.0], rel=1e-3)


@pytest.mark.parametrize("version", [2, 3])
def test_gripper_lifts_part_and_holds_its_weight(build: Build, version: int) -> None:
    cell = build(version, grasp_cell())
    grip(cell, 30.0)
    before = part_in_gripper(cell)
    move(cell, OVER_BOX, LIFTED, 0.8)
    cell.step(CYCLE_US, 10)
    assert cell.body("part[1]")[2, 3] == pytest.approx(TABLE[2] + 0.1, abs=1e-4)
    assert np.abs(part_in_gripper(cell) - before)[:3, 3].max() < 1e-5
    force = sum(cell.vector(f"truth.finger[{i}].contact_force", 3) for i in (1, 2))
    np.testing.assert_allclose(force, [0, 0, MASS * GRAVITY], atol=1e-3 * MASS * GRAVITY)


@pytest.mark.parametrize("drives", ["ideal", "dynamic"])
def test_both_pads_keep_contact_during_fast_moves(build: Build, drives: str) -> None:
    """In every step of a move of all joints and afterwards both pads keep contact and the part its pose."""
    cell = build(3, with_drives(drives))
    grip(cell, 30.0)
    move(cell, OVER_BOX, LIFTED, 0.8)
    cell.step(CYCLE_US, 20)
    before = part_in_gripper(cell)
    away = LIFTED + np.array([0.4, -0.08, 0.08, 0.3, -0.3, 0.5])
    for start, end in ((LIFTED, away), (away, LIFTED)):
        for share in [*smooth(np.arange(1, 51) / 50), *np.ones(20)]:
            cell.command(start + share * (end - start))
            for _ in range(CYCLE_US // 1000):
                cell.step(1000)
                assert cell.get_int("measured.gripper.gripped")
                # The inertia of the part along the closing direction shifts force from one pad to the other.
                pressed = [cell.get(f"truth.finger[{i}].normal_force")[0] for i in (1, 2)]
                assert pressed == pytest.approx([30.0, 30.0], abs=1.5)
    change = np.linalg.inv(before) @ part_in_gripper(cell)
    assert np.abs(change[:3, 3]).max() < 1e-6
    assert np.abs(change[:3, :3] - np.eye(3)).max() < 1e-5


@pytest.mark.parametrize("place", ["base", "flange"])
def test_gripped_part_vibrates_with_the_gripper(build: Build, place: str) -> None:
    """Also between the points of the dynamics grid, while the arm moves."""
    cell = build(3, grasp_cell(), parameters={f"as_built.vibration.{place}.{k}": v for k, v in SINE.items()})
    grip(cell, 30.0)
    move(cell, OVER_BOX, LIFTED, 0.8)
    before = part_in_gripper(cell)
    places = []
    for share in smooth(np.arange(1, 51) / 50):
        cell.command(LIFTED + share * (rotated_joint(0, 0.3) - LIFTED))
        cell.step(CYCLE_US // 2 + 330)
        places.append(part_in_gripper(cell) - before)
        np.testing.assert_allclose(
            cell.vector("truth.part[1].velocity", 3), velocity_on_flange(cell, "part[1]"), atol=1e-4
        )
        cell.step(CYCLE_US // 2 - 330)
    along, *across = np.array(places)[:, :3, 3].T
    assert np.abs(across).max() < 1e-12
    assert np.abs(along).max() < 1e-5  # the centring spring deflects by the arm's acceleration


@pytest.mark.parametrize("height", [0.0, 2e-4])
def test_opening_fingers_leave_part_in_place(build: Build, height: float) -> None:
    """Opening at once from full force, with the part on the table or slightly above it."""
    cell = build(3, grasp_cell())
    grip(cell, 30.0)
    move(cell, OVER_BOX, LIFTED, 0.8)
    move(cell, LIFTED, rotated_joint(0, 0.3), 0.8)
    move(cell, rotated_joint(0, 0.3), LIFTED, 0.8)
    let_go = joints_at(np.array([*PLACE, TABLE[2] + 0.02 + height]))
    move(cell, LIFTED, let_go, 0.8)
    before = cell.body("part[1]")
    cell.set("command.gripper.mode", 1)
    cell.set("command.gripper.width", 0.06)
    cell.step(CYCLE_US, 30)
    assert cell.get("measured.gripper.width")[0] == pytest.approx(0.06, abs=1e-6)
    shift = (cell.body("part[1]") - before)[:3, 3]
    assert np.abs(shift[:2]).max() < 5e-6


def test_part_is_kept_in_smooth_move_and_lost_in_step_move(build: Build) -> None:
    """A step of the set-points uses the full acceleration of the drive, more than friction can transmit."""
    slips = []
    description = grasp_cell()
    description["robot"]["joints"][0]["max_acceleration"] = 50.0
    for duration in (0.9, CYCLE):
        cell = build(3, description)
        grip(cell, 8.0)
        move(cell, OVER_BOX, LIFTED, 0.8)
        before = part_in_gripper(cell)
        move(cell, LIFTED, rotated_joint(0, np.pi / 2), duration)
        cell.step(CYCLE_US, round((1.2 - duration) / CYCLE))
        slips.append(np.linalg.norm((part_in_gripper(cell) - before)[:3, 3]))
    assert slips[0] < 1e-5
    assert slips[1] > 0.05


@pytest.mark.parametrize(("share", "slips"), [(0.98, False), (1.02, True)])
@pytest.mark.parametrize("tilt_deg", [0, 45])
def test_gripped_part_slips_at_coulomb_limit(build: Build, share: float, slips: bool, tilt_deg: float) -> None:
    """The weight along two directions of the pads' plane, the grip loosened to a share of what it needs.

    test_gripper.cpp has nine directions.
    The pads hold the box evenly about its centre of mass, so that its weight makes no moment.
    """
    start, lifted = (joints_at(np.array([*PLACE, TABLE[2] + z]), np.pi / 2) for z in (0.005, 0.12))
    cell = build(3, grasp_cell(start))
    grip(cell, 50.0, start)
    move(cell, start, lifted, 0.8)
    tilted = lifted.copy()
    tilted[4] += np.radians(tilt_deg)  # the axis of this joint is along the closing direction
    move(cell, lifted, tilted, 0.8)
    assert cell.body("link[6]")[2, 0] == pytest.approx(0.0, abs=1e-6)
    before = part_in_gripper(cell)
    grip(cell, MASS * GRAVITY / (2 * PAD_FRICTION) / share, tilted)
    assert (np.linalg.norm((part_in_gripper(cell) - before)[:3, 3]) > 1e-3) == slips


def test_approximate_contact_forces_are_counted_and_reported_once(build: Build) -> None:
    """Lifting the part is solved exactly; pressing it between pads and table is not."""
    cell = build(3, grasp_cell(), loggingOn=True)
    grip(cell, 30.0)
    move(cell, OVER_BOX, LIFTED, 0.8)
    assert cell.get_int("truth.contact.solver_fallbacks") == 0
    move(cell, LIFTED, joints_at(np.array([*PLACE, TABLE[2] + 0.018])), 0.8)
    state, time_us = cell.save(), cell.time_us
    count = cell.get_int("truth.contact.solver_fallbacks")
    cell.step(CYCLE_US, 20)
    assert cell.get_int("truth.contact.solver_fallbacks") >= count > 0
    warnings = [text for (status, _), text in zip(cell.log, cell.messages, strict=True) if status == 1]
    assert len(warnings) == 1
    assert "truth.contact.solver_fallbacks" in warnings[0]
    cell.restore(state, time_us)
    assert cell.get_int("truth.contact.solver_fallbacks") == count


def test_part_does_not_move_when_its_supporting_body_changes(build: Build) -> None:
    """From the table to the gripper and back, step by step: it follows the gripper, or it rests."""
    cell = build(3, grasp_cell())
    cell.set("command.gripper.mode", 2)
    cell.set("command.gripper.force", 30.0)
    lower = OVER_BOX
    upper = joints_at(np.array([*PLACE, TABLE[2] + 0.021]))
    path = [lower] * 40 + [lower + s * (upper - lower) for s in smooth(np.linspace(0, 1, 10))]
    before, bodies = cell.body("part[1]"), [cell.body("part[1]"), part_in_gripper(cell)]
    for k, q in enumerate([*path, *path[:39:-1], *path[40::-1]]):
        cell.command(q)
        if k == len(path) + 10:
            cell.set("command.gripper.mode", 1)
        for _ in range(CYCLE_US // 1000):
            cell.step(1000)
            now = [cell.body("part[1]"), part_in_gripper(cell)]
            across = [np.abs((a - b)[:2, 3]).max() for a, b in zip(now, bodies, strict=True)]
            assert min(across) < 2e-6
            bodies = now
    assert np.abs((cell.body("part[1]") - before)[:2, 3]).max() < 2e-5


VIBRATING: Parameters = {
    f"as_built.vibration.{place}.{key}": value
    for place, phase in (("base", 0.0), ("flange", 1.0), ("table", 2.5))
    for key, value in {"x": 1e-3, "y": -7e-4, "z": 5e-4, "frequency": 23.0, "phase": phase}.items()
}


def displacement_beyond_twist(cell: CellFmu, seconds: float, step_us: int = 250) -> tuple[float, float]:
    """Largest difference of the part's displacements in steps from its velocity times the step, and its path length."""
    position, worst, path = cell.vector("truth.part[1].position", 3), 0.0, 0.0
    for _ in range(round(seconds * 1e6 / step_us)):
        cell.step(step_us)
        now = cell.vector("truth.part[1].position", 3)
        predicted = cell.vector("truth.part[1].velocity", 3) * step_us * 1e-6
        worst, path = max(worst, float(np.abs(now - position - predicted).max())), path + float(np.ptp(now - position))
        position = now
    return worst, path


def test_true_pose_is_continuous_when_a_gripper_takes_and_releases_the_part(build: Build) -> None:
    """Base, flange and table vibrate by a millimetre; the twist is the derivative of the pose throughout."""
    cell = build(3, grasp_cell(), parameters=VIBRATING)
    upper = joints_at(np.array([*PLACE, TABLE[2] + 0.022]))
    cell.command(OVER_BOX)
    cell.set("command.gripper.mode", 2)
    cell.set("command.gripper.force", 30.0)
    found = [displacement_beyond_twist(cell, 0.5)]
    cell.command(upper)
    found.append(displacement_beyond_twist(cell, 0.1))
    cell.set("command.gripper.mode", 1)
    cell.set("command.gripper.width", 0.06)
    found.append(displacement_beyond_twist(cell, 0.3))
    assert max(worst for worst, _ in found) < 3e-6
    assert min(path for _, path in found) > 1e-3


def test_true_pose_is_continuous_when_the_part_slides_off_a_vibrating_table(build: Build) -> None:
    description = cell_description(fixture="free", support_from_part=pose([0.09, 0, 0]), friction=0.2)
    cell = build(3, description, parameters=VIBRATING)
    worst, _ = displacement_beyond_twist(cell, 0.1)
    cell.command(table=6.0)
    falling, _ = displacement_beyond_twist(cell, 0.9)
    assert cell.vector("truth.part[1].position", 3)[2] < 0.0  # below the table
    assert max(worst, falling) < 2e-5  # the table's acceleration, and impacts within a step


def run_swing(cell: CellFmu) -> None:
    for k in range(20):
        cell.command(rotated_joint(0, 0.3 * np.sin(0.2 * k)))
        cell.step(CYCLE_US)
    cell.step(330)


@pytest.mark.parametrize("drives", ["ideal", "dynamic"])
def test_state_during_grasp_continues_bit_exactly_in_a_new_process(build: Build, tmp_path: Path, drives: str) -> None:
    cell = build(3, with_drives(drives))
    grip(cell, 30.0)
    move(cell, OVER_BOX, LIFTED, 0.8)
    move(cell, LIFTED, rotated_joint(0, 0.2), 0.16)
    assert_continues_exactly(cell, run_swing, tmp_path)


def test_grasp_is_independent_of_communication_step(build: Build) -> None:
    final = []
    for size in (1000, 16000):
        cell = build(3, grasp_cell())
        cell.command(OVER_BOX)
        cell.set("command.gripper.mode", 2)
        cell.set("command.gripper.force", 30.0)
        cell.step(size, 320_000 // size)
        final.append(all_reals(cell)[1:])
    np.testing.assert_array_equal(final[0], final[1])


def test_cell_without_gripper_has_no_gripper_variables(build: Build) -> None:
    assert not [name for name in build(3).variables if "gripper" in name or "finger" in name]


@pytest.mark.parametrize(("key", "value"), [("stroke", 0.0), ("start", 0.2), ("friction", -1.0), ("max_force", None)])
def test_invalid_gripper_is_rejected(key: str, value: float | None) -> None:
    assert f"gripper.{key}" in rejection({**cell_description(), "gripper": {**gripper(), key: value}})


def test_lightest_part_survives_full_grip_force(build: Build) -> None:
    """A part of 1e-8 kg makes an assertion of the contact solver end the process; the smallest mass is far above."""
    description = grasp_cell()
    inertial = description["parts"][0]["inertial"]
    scale = 1e-6 / inertial["mass"]
    inertial["inertia"] = [[value * scale for value in row] for row in inertial["inertia"]]
    inertial["mass"] = 1e-6
    cell = build(3, description)
    grip(cell, 60.0)
    cell.step(CYCLE_US, 30)
    assert np.isfinite(all_reals(cell)).all()
