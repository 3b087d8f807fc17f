"""Gripper: conversion for the FMU, recorded poses, bodies of the scene, collision checks of the planner."""

from __future__ import annotations

import numpy as np
import pytest
from cells import CYCLE, GRIPPER, RANGE
from fmu_cells import drive

from scancell.cell.fmu_file import cell_json
from scancell.cell.program import TriggerRule
from scancell.config.loading import load_setup
from scancell.geometry.mesh import box_mesh
from scancell.nominal.cell import nominal_cell, with_table
from scancell.planning.model import PlanningCell
from scancell.scanning.world import exposures_from_truth, visible_bodies

BLOCK = box_mesh((0.04, 0.03, 0.02), "block")
WORDS = [*GRIPPER, "cell.gripper.start_mm=30"]


def test_gripper_json_is_in_si_units() -> None:
    setup = load_setup(settings=WORDS)
    gripper = cell_json(setup.cell, nominal_cell(setup.cell, BLOCK), 0)["gripper"]
    assert gripper["flange_from_gripper"]["position"] == [0.06, 0.0, 0.05]
    expected = {"stroke": 0.05, "start": 0.03, "finger_length": 0.04, "finger_thickness": 0.01, "max_speed": 0.1}
    assert {key: gripper[key] for key in expected} == pytest.approx(expected)
    assert (gripper["centring_stiffness"], gripper["max_force"], gripper["finger_mass"]) == (20e3, 60.0, 0.1)


def test_gripper_is_optional() -> None:
    setup = load_setup()
    nominal = nominal_cell(setup.cell, BLOCK)
    assert cell_json(setup.cell, nominal, 0)["gripper"] is None
    assert "finger[1]" not in nominal.frame_poses(nominal.home)


def test_finger_poses_match_description(tmp_path) -> None:
    setup = load_setup(settings=WORDS, ideal=True)
    nominal = nominal_cell(setup.cell, BLOCK)
    recording = drive(tmp_path, setup.cell, nominal, np.zeros(12), TriggerRule("time", 0.05))
    first = nominal.frame_poses(nominal.home)
    truth = recording.truth
    for frame in ("finger[1]", "finger[2]"):
        np.testing.assert_allclose(truth.world_from_frame[frame][0, 0], first[frame], atol=1e-9)
    between = np.linalg.inv(first["finger[1]"]) @ first["finger[2]"]
    np.testing.assert_allclose(between[:3, 3], [-0.03, 0, 0], atol=1e-12)
    bodies = visible_bodies(nominal)
    assert {"gripper", "finger1", "finger2"} <= {body.name for body in bodies}
    assert exposures_from_truth(truth, recording.measured.index, bodies) is not None


def test_planner_checks_fingers_against_table_and_part() -> None:
    """A finger inside the table is a collision; tools on the same flange are not checked against each other."""
    setup = load_setup(settings=WORDS)
    cell = PlanningCell(nominal_cell(setup.cell, BLOCK), RANGE, CYCLE)
    pairs = {frozenset(pair) for pair in cell.proximity.pairs}
    for around in ("table", "part", "base"):
        assert frozenset(("finger1", around)) in pairs
    q = cell.nominal.home
    assert not cell.clearance_violations(with_table(q, 0.0), 0.01)
    world_from_finger = cell.nominal.frame_poses(q)["finger[1]"]
    target = np.eye(4)
    target[:3, :3] = np.diag([1.0, -1.0, -1.0])
    target[:3, 3] = cell.nominal.world_from_table[:3, 3] + np.array([-0.05, 0.05, 0.02])
    flange_from_finger = np.linalg.inv(cell.nominal.arm.fk(q)) @ world_from_finger
    reached = cell.nominal.arm.ik(target @ np.linalg.inv(flange_from_finger))[0]
    reached = reached[~np.isnan(reached).any(1)]
    assert len(reached)
    clashes = cell.clearance_violations(with_table(reached[:1], 0.0), 0.001)
    assert {"finger1", "table"} in [{c.body_a, c.body_b} for c in clashes]
