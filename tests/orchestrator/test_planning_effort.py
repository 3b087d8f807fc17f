"""Effort of planning, in units of work: views that collide are refused early, and planning may be cancelled often."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from cells import block, planning_cell

from bench.planner_campaign import make_cell
from scancell.arrays import Array
from scancell.config.files import assets_dir
from scancell.config.loading import load_setup
from scancell.errors import CancelledError
from scancell.geometry import pose
from scancell.geometry.mesh import box_mesh
from scancell.nominal.cell import nominal_cell
from scancell.nominal.parts import Body
from scancell.planning.model import PlanningCell, SensorRange, Work
from scancell.planning.options import scan_options
from scancell.planning.planner import plan
from scancell.planning.views import paths
from scancell.planning.views.placement import Infeasible, PlacedPass, Placer
from scancell.planning.views.views import sample_part, seen_by
from scancell.progress import NullProgress
from scancell.scanning.world import make_sensor


class _CancelAfter(NullProgress):
    def __init__(self, calls: int) -> None:
        self.left = calls

    def advance(self, steps: float) -> None:
        self.left -= 1
        if self.left < 0:
            raise CancelledError


def _cell(name: str, work: Work) -> PlanningCell:
    """The cell with a plate over the part, through which no pass gets."""
    setup = load_setup(assets_dir() / "cells" / f"{name}.toml")
    nominal = nominal_cell(
        setup.cell, box_mesh((0.08, 0.06, 0.03), "part").transformed(pose.translation((0, 0, 0.015)))
    )
    plate = box_mesh((0.5, 0.5, 0.004), "plate").transformed(nominal.world_from_table @ pose.translation((0, 0, 0.14)))
    nominal = replace(nominal, bodies=(*nominal.bodies, Body("plate", "world", plate, nominal.bodies[0].material)))
    sensor_range = SensorRange.of(make_sensor(setup.sensor, 0))
    return PlanningCell(nominal, sensor_range, setup.cell.world.controller_cycle, work=work)


def test_passes_that_collide_need_no_inverse_kinematics_along_them() -> None:
    work, setup = Work(), load_setup()
    cell = _cell("offset_wrist", work)
    options = scan_options(setup.scan, setup.sensor)
    part = sample_part(cell.nominal.part, cell.nominal.table_from_part)
    views = paths.passes(part, cell.range, options)[:1]
    (found,) = Placer(cell, options.azimuth, options.clearance).passes(
        views, [40], 1e-3 * setup.scan.raster.speed_mm_s, None
    )
    assert isinstance(found, Infeasible) and "plate" in found.reason
    assert work.spent < 0.5


def test_pass_whose_middle_alone_is_out_of_reach_is_infeasible(monkeypatch: pytest.MonkeyPatch) -> None:
    cell, setup = planning_cell(block(0.08, 0.06, 0.03)), load_setup()
    options, along = scan_options(setup.scan, setup.sensor), PlanningCell.ik_along
    views = paths.passes(sample_part(cell.nominal.part, cell.nominal.table_from_part), cell.range, options)[:1]

    def placed() -> PlacedPass | Infeasible:
        (found,) = Placer(cell, options.azimuth, options.clearance).passes(views, [40], 0.05, None)
        return found

    def without_middle(*given: Any) -> Array:
        found = along(*given)
        found[:, 1] = np.nan
        return found

    assert isinstance(placed(), PlacedPass)
    monkeypatch.setattr(PlanningCell, "ik_along", without_middle)
    assert isinstance(placed(), Infeasible)


@pytest.mark.parametrize("calls", [0, 5])
def test_choice_of_side_sweeps_can_be_cancelled(calls: int) -> None:
    work, setup = Work(progress=_CancelAfter(calls)), load_setup()
    options, cell = scan_options(setup.scan, setup.sensor), _cell("default", Work())
    elevations = np.radians(setup.scan.sweep.elevations_deg).tolist()
    part = sample_part(cell.nominal.part, cell.nominal.table_from_part)
    seen = seen_by(paths.sweeps(part, cell.range, options, elevations), cell.range, part)
    with pytest.raises(CancelledError):
        paths.side_sweeps(part, cell.range, options, elevations, seen, work)
    assert np.isfinite(work.spent)


def test_sweeps_are_placed_at_azimuths_far_from_the_preferred_one() -> None:
    """A hook beside the preferred azimuth is in the way of the first 24 choices: three azimuths of eight branches."""
    _, _, _, setup, cell = make_cell(21)
    options = scan_options(setup.scan.replace(max_profiles=120), setup.sensor)
    assert not [text for text in plan(cell, options).warnings if "sweep at 60 deg" in text]


def test_passes_are_placed_where_the_first_choices_collide() -> None:
    """A beam is in the way of the arm in the branches of the first 24 choices."""
    _, _, _, setup, cell = make_cell(33)
    options = scan_options(setup.scan.replace(max_profiles=120, max_lost_share=1.0), setup.sensor)
    assert not [text for text in plan(cell, options).warnings if "pass at y = 27 mm" in text]
