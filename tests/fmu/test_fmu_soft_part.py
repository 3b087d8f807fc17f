"""Soft parts in the FMU: squeezing, lifting, slip, and exact states."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cell_fixture import CYCLE_US, Build, CellFmu, cell_description, rejection
from continue_from_state import assert_continues_exactly
from grasp_fixture import (
    BOX,
    GRAVITY,
    MASS,
    OVER_BOX,
    PAD_FRICTION,
    PLACE,
    TABLE,
    grasp_cell,
    grip,
    joints_at,
    move,
    part_in_gripper,
)

SOFT = {"stiffness": 800.0, "damping_ratio": 1.0, "longest_edge": 0.02}
FORCE = 10.0
LIFTED = joints_at(np.array([*PLACE, TABLE[2] + 0.12]))


def soft_cell(**part: Any) -> dict[str, Any]:
    return grasp_cell(soft={**SOFT, **part})


def slip(before: np.ndarray, cell: CellFmu) -> float:
    return float(np.linalg.norm((part_in_gripper(cell) - before)[:3, 3]))


def lifted_part(build: Build, tilt: float = 0.0) -> CellFmu:
    """Hang the part between the pads, with its weight at an angle (rad) to the fingers."""
    start, high = (joints_at(np.array([*PLACE, TABLE[2] + z]), np.pi / 2) for z in (0.005, 0.12))
    cell = build(3, grasp_cell(start, soft=SOFT))
    grip(cell, FORCE, start)
    move(cell, start, high, 0.8)
    tilted = high + np.array([0, 0, 0, 0, tilt, 0])
    move(cell, high, tilted, 0.8)
    cell.command(tilted)
    cell.step(CYCLE_US, 20)
    return cell


def test_soft_part_stands_on_its_points(build: Build) -> None:
    """The part compresses by its weight over the stiffness of the supporting points, at least its corners."""
    pose = build(3, soft_cell()).body("part[1]")
    np.testing.assert_allclose(pose[:2, 3], PLACE, atol=1e-9)
    np.testing.assert_allclose(pose[:3, :3], np.eye(3), atol=1e-6)
    assert 0 < TABLE[2] - pose[2, 3] < MASS * GRAVITY / (4 * SOFT["stiffness"])


def test_compression_is_proportional_to_grip_force(build: Build) -> None:
    cell = build(3, soft_cell())
    squeeze = []
    for force in (5.0, 10.0):
        grip(cell, force)
        width, felt = cell.get("measured.gripper.width", "measured.gripper.force")
        squeeze.append(BOX[0] - width)
        assert cell.get_int("measured.gripper.gripped")
        assert felt == pytest.approx(force, rel=1e-6)
    assert squeeze[0] > 1e-3
    assert squeeze[1] == pytest.approx(2 * squeeze[0], rel=0.02)


@pytest.mark.parametrize("version", [2, 3])
def test_lifted_soft_part_creeps_by_micrometres_per_second(build: Build, version: int) -> None:
    cell = build(version, soft_cell())
    grip(cell, FORCE)
    move(cell, OVER_BOX, LIFTED, 0.8)
    cell.step(CYCLE_US, 80)
    before = part_in_gripper(cell)
    cell.step(CYCLE_US, 60)
    assert slip(before, cell) < 5e-6
    assert cell.body("part[1]")[2, 3] > TABLE[2] + 0.098
    force = sum(cell.vector(f"truth.finger[{i}].contact_force", 3) for i in (1, 2))
    np.testing.assert_allclose(force, [0, 0, MASS * GRAVITY], atol=1e-3 * MASS * GRAVITY)


@pytest.mark.parametrize(("share", "slips"), [(0.98, False), (1.02, True)])
@pytest.mark.parametrize("tilt_deg", [0, 45])
def test_soft_part_slips_at_coulomb_limit(build: Build, share: float, slips: bool, tilt_deg: float) -> None:
    cell = lifted_part(build, np.radians(tilt_deg))
    before = part_in_gripper(cell)
    needed = MASS * GRAVITY / (2 * PAD_FRICTION)
    for force in np.linspace(FORCE, needed / share, 60):  # gently: the part follows the springs
        cell.set("command.gripper.force", force)
        cell.step(CYCLE_US)
    cell.step(CYCLE_US, 30)
    moved = slip(before, cell)
    assert moved > 2e-3 if slips else moved < 1e-5


def run_swing(cell: CellFmu) -> None:
    for k in range(20):
        cell.command(LIFTED + np.array([0.3 * np.sin(0.2 * k), 0, 0, 0, 0, 0]))
        cell.step(CYCLE_US)
    cell.step(330)


def test_state_continues_bit_exactly_in_a_new_process(build: Build, tmp_path: Path) -> None:
    cell = build(3, soft_cell())
    grip(cell, FORCE)
    move(cell, OVER_BOX, LIFTED, 0.8)
    assert_continues_exactly(cell, run_swing, tmp_path)


@pytest.mark.parametrize("version", [2, 3])
def test_log_warns_of_soft_part_limitations(build: Build, version: int) -> None:
    cell = build(version, soft_cell(), loggingOn=True)
    warnings = [text for text, (_, kind) in zip(cell.messages, cell.log, strict=True) if kind == "logStatusWarning"]
    assert len(warnings) == 1
    for words in ("soft parts ('box')", "collision detector for soft bodies", "creep", "longer"):
        assert words in warnings[0]


def test_too_stiff_or_too_many_points_are_rejected(build: Build) -> None:
    with pytest.raises(RuntimeError, match=r"part 'box': soft\.stiffness must be at most [0-9.]+ N/m"):
        build(3, soft_cell(stiffness=1e6))
    with pytest.raises(RuntimeError, match=r"part 'box': soft\.longest_edge = [0-9.]+ m needs more than 400 points"):
        build(3, soft_cell(longest_edge=1e-3))


def test_a_part_that_sinks_by_more_than_its_height_is_rejected_before_it_settles(build: Build) -> None:
    expected = r"part 'box': soft\.stiffness = 0\.001 N/m: the part sinks by [0-9.]+ m .* expected at least [0-9.]+ N/m"
    with pytest.raises(RuntimeError, match=expected):
        build(3, soft_cell(stiffness=1e-3))  # settling takes minutes, with all points in contact


@pytest.mark.parametrize(("key", "value"), [("stiffness", 0.0), ("damping_ratio", -1.0), ("longest_edge", None)])
def test_invalid_soft_key_is_named(key: str, value: float | None) -> None:
    assert f"parts[0].soft.{key}" in rejection(soft_cell(**{key: value}))


def test_soft_clamped_part_is_rejected() -> None:
    assert "parts[0].soft" in rejection(cell_description(soft=SOFT))
