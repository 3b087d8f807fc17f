"""Planned sensor paths: they follow the path within all limits, keep all clearances, and say why there is none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from cells import CYCLE, RANGE, block, planning_cell
from fcl_collisions import path_collisions

from scancell.config.loading import assets_dir, load_setup
from scancell.config.path import (
    PathDescription,
    QualityDescription,
    SpiralDescription,
    WaypointDescription,
    WeightsDescription,
)
from scancell.nominal.cell import nominal_cell
from scancell.planning.model import PlanningCell
from scancell.planning.motion import trajectory
from scancell.planning.path_map import constraints
from scancell.planning.path_map.optimum import best_motion
from scancell.planning.path_map.path_planner import PathPlanner, PlacedPath
from scancell.planning.views.sensor_paths import sensor_paths

CLEARANCE = 0.005


@pytest.fixture(scope="module")
def cell() -> PlanningCell:
    return planning_cell(block(0.05, 0.04, 0.03))


def placed(cell: PlanningCell, description: PathDescription) -> PlacedPath | str:
    (path,) = sensor_paths(description, cell.nominal.part, cell.nominal.table_from_part)
    return PathPlanner(cell, CLEARANCE).place(path)


@pytest.fixture(scope="module")
def spiral(cell: PlanningCell) -> PlacedPath:
    made = placed(cell, PathDescription(speed_mm_s=100.0, spiral=SpiralDescription(turns=-0.5)))
    assert isinstance(made, PlacedPath)
    return made


def test_set_points_lead_the_sensor_along_the_path(cell: PlanningCell, spiral: PlacedPath) -> None:
    world = cell.nominal.world_from_part(spiral.table) @ np.linalg.inv(cell.nominal.table_from_part)
    table_from_sensor = np.linalg.inv(world) @ cell.nominal.world_from_sensor(spiral.q)
    np.testing.assert_allclose(
        table_from_sensor, spiral.path.at(spiral.run.at(CYCLE * np.arange(len(spiral.q)))), atol=1e-9
    )


def test_all_axes_keep_their_limits_at_a_tenth_of_the_cycle(cell: PlanningCell, spiral: PlacedPath) -> None:
    fine = spiral.at(np.arange(-3 * CYCLE, spiral.run.duration + 3 * CYCLE, CYCLE / 10))
    assert np.ptp(fine[[0, 20]], axis=0).max() < 1e-12  # at rest before the start
    assert trajectory.limit_fractions(fine, cell.axis_limits, CYCLE / 10).max() <= 1.0
    assert cell.nominal.arm.within_limits(fine[:, :-1]).all()


def test_path_too_fast_for_a_joint_is_slowed_to_its_limit(cell: PlanningCell, spiral: PlacedPath) -> None:
    """Half the jerk that the spiral needs: the factor is the cube root, and the limit is just reached."""
    peak = trajectory.limit_fractions(fine_positions(spiral), cell.axis_limits, CYCLE / 10)[2, :6]
    worst = int(np.argmax(peak))
    nominal, arm = cell.nominal, cell.nominal.arm
    joints = tuple(replace(j, max_jerk=peak.max() / 2 * j.max_jerk) for j in arm.joints)
    weak = replace(cell, nominal=replace(nominal, arm=replace(arm, joints=joints)))
    made = placed(weak, PathDescription(speed_mm_s=100.0, spiral=SpiralDescription(turns=-0.5)))
    assert isinstance(made, PlacedPath)
    assert f"jerk limit of joint {worst + 1}" in made.note
    assert made.run.speed == pytest.approx(spiral.run.speed / 2 ** (1 / 3), rel=5e-3)
    used = trajectory.limit_fractions(fine_positions(made), weak.axis_limits, CYCLE / 10)
    assert 0.98 < used[2, worst] <= 1.0
    np.testing.assert_allclose(made.exposures, spiral.exposures, atol=1e-9)


def fine_positions(made: PlacedPath) -> np.ndarray:
    return made.at(np.arange(-3 * CYCLE, made.run.duration + 3 * CYCLE, CYCLE / 10))


def test_motion_is_near_the_optimum_with_few_cells_evaluated(spiral: PlacedPath) -> None:
    map_ = spiral.lattice.map
    assert map_.evaluated < 0.12 * map_.quality.size
    best = best_motion(spiral.lattice)
    assert best is not None
    assert best.cost <= spiral.motion.cost * (1 + 1e-6)
    assert spiral.motion.cost < 1.1 * best.cost


def test_an_independent_library_finds_no_collision(cell: PlanningCell, spiral: PlacedPath) -> None:
    """python-fcl at 300 poses along the path, all pairs of the scene."""
    at = np.linspace(0, len(spiral.table) - 1, 300)
    setpoints = np.column_stack([spiral.q, spiral.table])
    dense = np.stack([np.interp(at, np.arange(len(setpoints)), column) for column in setpoints.T], -1)
    assert path_collisions(cell, dense) == set()


def test_a_path_beyond_the_arms_reach_is_refused_with_its_place(cell: PlanningCell) -> None:
    far = tuple(WaypointDescription(x_mm=x, y_mm=0.0, z_mm=900.0) for x in (-20.0, 20.0))
    made = placed(cell, PathDescription(name="far", waypoint=far))
    assert isinstance(made, str)
    assert made.startswith("far: at 0 % of the way the pose is out of the arm's reach at every table angle")


def test_an_arm_without_named_branches_is_refused() -> None:
    setup = load_setup(assets_dir() / "cells" / "offset_wrist.toml")
    other = PlanningCell(nominal_cell(setup.cell, block(0.05, 0.04, 0.03)), RANGE, CYCLE)
    assert "closed form" in str(placed(other, PathDescription(spiral=SpiralDescription())))


def test_a_path_through_the_table_is_refused_with_its_cause(cell: PlanningCell) -> None:
    low = tuple(WaypointDescription(x_mm=x, y_mm=0.0, z_mm=-85.0, elevation_deg=89.0) for x in (-20.0, 20.0))
    made = placed(cell, PathDescription(name="low", waypoint=low))
    assert isinstance(made, str)
    assert "no motion in branch" in made
    assert "at 0 % of the way every table angle is forbidden: clearance between sensor and " in made


def test_a_weight_on_scanning_time_trades_speed_for_quality(cell: PlanningCell) -> None:
    """Slower motions have the better quality: the time's weight decides, and the fastest one needs no weight."""
    half_turn = SpiralDescription(turns=-0.5)
    speeds = []
    for weight in (0.0, 100.0):
        weights = WeightsDescription(scanning_time=weight)
        made = placed(cell, PathDescription(speed_mm_s=150.0, spiral=half_turn, weights=weights))
        assert isinstance(made, PlacedPath)
        speeds.append(made.run.speed)
    assert speeds[0] < speeds[1]


def test_printed_equation_8_forbids_where_the_clearance_is_just_full() -> None:
    low, high = 0.01, 0.05
    at = np.array([0.005, low, 0.03, high - 1e-9, high, 0.1])
    corrected = constraints.clearance(at, low, high)
    printed = constraints.clearance(at, low, high, printed=True)
    np.testing.assert_allclose(corrected, [0, 0, np.sin(np.pi / 4), 1, 1, 1], atol=1e-7)
    np.testing.assert_allclose(printed, [0, 0, 1, 0, 1, 1], atol=1e-6)


def test_the_printed_equation_makes_another_map(cell: PlanningCell) -> None:
    quality = QualityDescription(equations="printed")
    descriptions = [
        PathDescription(spiral=SpiralDescription(turns=-0.2), quality=q) for q in (QualityDescription(), quality)
    ]
    maps = []
    for description in descriptions:
        (path,) = sensor_paths(description, cell.nominal.part, cell.nominal.table_from_part)
        map_ = next(iter(PathPlanner(cell, CLEARANCE).lattices(path))).map
        map_.require(*(x.ravel() for x in np.meshgrid([0, map_.columns - 1], np.arange(map_.rows))))
        maps.append(map_.quality[[0, -1]])
    assert np.abs(maps[0] - maps[1]).max() > 0.01
