"""Gripper: conversion for the FMU, recorded poses, bodies of the scene, collision checks of the planner."""

from __future__ import annotations

import numpy as np
import pytest
from cells import CYCLE, RANGE

from scancell.cell.driver import DriveOptions, Driver
from scancell.cell.fmu_file import cell_json, make_temporary_fmu
from scancell.cell.instance import CellInstance
from scancell.cell.program import Program, Segment, TriggerRule
from scancell.config.loading import load_setup
from scancell.errors import DescriptionError
from scancell.geometry.mesh import box_mesh
from scancell.nominal.cell import nominal_cell
from scancell.planning.model import PlanningCell
from scancell.scanning.exposures import exposures_from_truth, visible_bodies

BLOCK = box_mesh((0.04, 0.03, 0.02), "block")
GRIPPER = [
    "cell.gripper.pose={ x_mm = 60.0, z_mm = 50.0 }",
    "cell.gripper.stroke_mm=50",
    "cell.gripper.start_mm=30",
    "cell.gripper.finger_length_mm=40",
    "cell.gripper.finger_width_mm=16",
    "cell.gripper.housing_mm=[70, 40, 45]",
]


def test_gripper_json_is_in_si_units() -> None:
    setup = load_setup(settings=GRIPPER)
    gripper = cell_json(setup.cell, nominal_cell(setup.cell, BLOCK), 0)["gripper"]
    assert gripper["flange_from_gripper"]["position"] == [0.06, 0.0, 0.05]
    expected = {"stroke": 0.05, "start": 0.03, "finger_length": 0.04, "finger_thickness": 0.01, "max_speed": 0.1}
    assert {key: gripper[key] for key in expected} == pytest.approx(expected)
    assert (gripper["centring_stiffness"], gripper["max_force"], gripper["finger_mass"]) == (20e3, 60.0, 0.1)


def test_gripper_is_optional() -> None:
    setup = load_setup()
    nominal = nominal_cell(setup.cell, BLOCK)
    assert cell_json(setup.cell, nominal, 0)["gripper"] is None
    assert "finger[1]" not in nominal.frame_poses(nominal.home, 0.0)


def test_finger_poses_match_description(tmp_path) -> None:
    setup = load_setup(settings=GRIPPER, ideal=True)
    nominal = nominal_cell(setup.cell, BLOCK)
    fmu = make_temporary_fmu(cell_json(setup.cell, nominal, 0), tmp_path / "fmu", 3)
    times = np.arange(12) * 0.016
    segment = Segment(
        1, times, np.tile(nominal.home, (12, 1)), np.zeros(12), TriggerRule("time", 0.05), times[2], times[-2]
    )
    with CellInstance(fmu) as cell:
        recording = Driver(cell, DriveOptions(16_000, 1e-3)).run(Program((segment,)))
    first = nominal.frame_poses(nominal.home, 0.0)
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
    setup = load_setup(settings=GRIPPER)
    cell = PlanningCell(nominal_cell(setup.cell, BLOCK), RANGE, CYCLE)
    pairs = {frozenset(pair) for pair in cell.proximity.pairs}
    for around in ("table", "part", "base"):
        assert frozenset(("finger1", around)) in pairs
    q = cell.nominal.home
    assert not cell.clearance_violations(q[None], np.zeros(1), 0.01)
    world_from_finger = cell.nominal.frame_poses(q, 0.0)["finger[1]"]
    target = np.eye(4)
    target[:3, :3] = np.diag([1.0, -1.0, -1.0])
    target[:3, 3] = cell.nominal.world_from_table[:3, 3] + np.array([-0.05, 0.05, 0.02])
    flange_from_finger = np.linalg.inv(cell.nominal.arm.fk(q)) @ world_from_finger
    reached = cell.nominal.arm.ik(target @ np.linalg.inv(flange_from_finger))[0]
    reached = reached[~np.isnan(reached).any(1)]
    assert len(reached)
    clashes = cell.clearance_violations(reached[:1], np.zeros(1), 0.001)
    assert {"finger1", "table"} in [{c.body_a, c.body_b} for c in clashes]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            ["cell.gripper.start_mm=60"],
            "with `settings` cell.gripper.stroke_mm=50 with `settings` cell.gripper.start_mm=60: gripper: start_mm",
        ),
        (["cell.gripper.stroke_mm=0"], "stroke_mm"),
        (["cell.gripper.housing_mm=[1, 2]"], "housing_mm"),
        (["cell.gripper.grip=1"], "grip"),
    ],
)
def test_invalid_gripper_is_rejected(words, said) -> None:
    with pytest.raises(DescriptionError, match=said):
        load_setup(settings=[*GRIPPER, *words])
