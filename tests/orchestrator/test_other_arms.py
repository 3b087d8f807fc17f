"""Scans planned with the shipped arms without a spherical wrist and with seven joints."""

from __future__ import annotations

import numpy as np
import pytest
from cells import CYCLE, RANGE
from fcl_collisions import path_collisions
from planned_motion import assert_axis_limits, setpoints

from scancell.config.loading import assets_dir, load_setup
from scancell.errors import PlanningError
from scancell.geometry.mesh import load_mesh
from scancell.nominal.cell import nominal_cell
from scancell.nominal.plausibility import setup_warnings
from scancell.planning.model import PlanningCell
from scancell.planning.options import scan_options
from scancell.planning.plan import Plan
from scancell.planning.planner import plan

CLEARANCE = 0.8 * 5e-3  # m: what connections keep of the default clearance


def planned(name: str, *overrides: str) -> tuple[PlanningCell, Plan]:
    """The scan of the default part as it is described, in a shipped cell."""
    setup = load_setup(assets_dir() / "cells" / f"{name}.toml", settings=overrides)
    assert setup_warnings(setup) == []
    cell = PlanningCell(nominal_cell(setup.cell, load_mesh(assets_dir() / "parts" / "free_form.stl")), RANGE, CYCLE)
    return cell, plan(cell, scan_options(setup.scan, setup.sensor))


@pytest.fixture(scope="module", params=["offset_wrist", "seven_axis"])
def any_plan(request: pytest.FixtureRequest) -> tuple[PlanningCell, Plan]:
    return planned(request.param)


def test_all_views_of_the_default_arm_are_reached(any_plan: tuple[PlanningCell, Plan]) -> None:
    _, default = planned("default")
    _, result = any_plan
    assert result.warnings == ()
    assert result.coverage == pytest.approx(default.coverage)
    assert len(result.q) == len(default.q)


def test_sensor_is_where_the_views_have_it(any_plan: tuple[PlanningCell, Plan]) -> None:
    """Exposures of a sweep have one pose but for the turn of the table; those of a pass lie on a straight line."""
    cell, result = any_plan
    sensor = cell.support_from_sensor(result.q)
    for segment in result.program.segments:
        mine = sensor[result.segment == segment.id]
        if segment.name.startswith("sweep"):
            assert np.abs(mine - mine[0]).max() < 1e-9
        elif segment.name.startswith("pass"):
            assert np.abs(mine[:, :3, :3] - mine[0, :3, :3]).max() < 1e-9
            steps = np.diff(mine[:, :3, 3], axis=0)
            assert np.abs(steps - steps[0]).max() < 1e-9


def test_set_points_keep_limits(any_plan: tuple[PlanningCell, Plan]) -> None:
    assert_axis_limits(*any_plan)


def test_set_points_keep_clearance(any_plan: tuple[PlanningCell, Plan]) -> None:
    cell, result = any_plan
    path = setpoints(result)
    assert cell.clearance_violations(path, CLEARANCE) == []
    assert path_collisions(cell, path[::7]) == set()  # an independent library, at some of them


def test_held_joint_keeps_one_of_its_values() -> None:
    values = [-25.0, 10.0]
    _, result = planned("seven_axis", f"cell.robot.held[1].values_deg={values}", "scan.raster.enabled=false")
    distance = np.abs(np.degrees(result.q[:, 2])[:, None] - values).min(1)
    assert distance.max() < 1e-9


@pytest.mark.parametrize("arm", ["offset_wrist", "seven_axis"])
def test_out_of_reach_is_reported(arm: str) -> None:
    with pytest.raises(PlanningError, match="out of the arm's reach"):
        planned(arm, "cell.table.pose.x_mm=1500", "scan.raster.enabled=false")
