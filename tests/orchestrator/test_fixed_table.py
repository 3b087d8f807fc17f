"""Cells without a rotary table: the part stands on a bench."""

from __future__ import annotations

import numpy as np
import pytest

from scancell import Scanner, assets_dir, load_setup
from scancell.errors import CommandError, DescriptionError, PlanningError

CELL = assets_dir() / "cells/fixed_table.toml"
CONE = assets_dir() / "artefacts/cone.toml"
# Poses of the sensor in the part's frame, towards the cone from two sides.
PATH = "scan.path=[{pitch_mm=2, waypoint=[{x_mm=-18, y_mm=2, z_mm=45}, {x_mm=15, y_mm=6, z_mm=45, elevation_deg=80}]}]"
POSES = "scan.pose=[{x_mm=60, z_mm=150, rx_deg=180, ry_deg=-22}, {y_mm=70, z_mm=140, rx_deg=152, rz_deg=90}]"


@pytest.mark.parametrize(
    "settings",
    [
        ["scan.sweep.enabled=false", "scan.max_profiles=60"],
        [POSES, 'scan.mode="stop-and-look"'],
        [PATH, "scan.sweep.enabled=false", "scan.raster.enabled=false"],
    ],
)
def test_exact_part_is_measured_without_error_and_the_table_rests(settings: list[str]) -> None:
    with Scanner(setup=load_setup(CELL, settings=settings, ideal=True)) as scanner:
        result = scanner.scan(CONE, engine="geometric").evaluate()
    assert len(result.cloud) > 1000
    assert result.deviation.rms < 0.1e-6
    measured = result.recording.measured
    assert np.ptp(measured.axes[:, measured.names.index("table")]) == 0.0
    assert np.ptp(measured.axes[:, 0]) >= 0.0
    assert "of the whole surface" in result.summary()


def test_full_turns_are_infeasible_and_said() -> None:
    with Scanner(setup=load_setup(CELL)) as scanner:
        plan = scanner.plan(CONE)
    assert any("the table does not turn" in warning for warning in plan.warnings)
    alone = load_setup(CELL, settings=["scan.raster.enabled=false"])
    with Scanner(setup=alone) as scanner, pytest.raises(PlanningError, match="the table does not turn"):
        scanner.plan(CONE)


def test_choice_of_views_by_coverage_is_refused_by_key() -> None:
    setup = load_setup(CELL, settings=["scan.coverage.enabled=true"])
    with Scanner(setup=setup) as scanner, pytest.raises(DescriptionError, match=r"cell\.table\.turns"):
        scanner.plan(CONE)


def test_controller_refuses_to_turn_the_table() -> None:
    with Scanner(setup=load_setup(CELL)) as scanner, scanner.session() as session:
        with pytest.raises(CommandError, match="table"):
            session.turn_table(0.1)
        session.move_joints(session.joints + np.radians([4.0, -3.0, 2.0, 1.0, -2.0, 5.0]))
        assert session.commanded[len(session.joints)] == 0.0
