"""Sensor paths along which another axis than the table moves, or the table and another one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from cells import block
from test_stands import assert_sound, cell_of, planned

from scancell import DescriptionError, PlanningError, Scanner, Setup
from scancell.geometry import pose
from scancell.output.pictures import map_picture
from scancell.planning.path_map.path_planner import PlacedPath
from scancell.planning.path_map.ray_shooting import best_motion

ACROSS = (
    "waypoint=[{ x_mm = -20, y_mm = 0, z_mm = 30, azimuth_deg = 0, elevation_deg = 60 },"
    " { x_mm = 20, y_mm = 0, z_mm = 30, azimuth_deg = 40, elevation_deg = 80 }]"
)
ALONG = (
    "waypoint=[{ x_mm = 0, y_mm = -250, z_mm = 20, elevation_deg = 80, roll_deg = 90 },"
    " { x_mm = 0, y_mm = 250, z_mm = 20, elevation_deg = 80, roll_deg = 90 }]"
)
PART, BAR = block(0.05, 0.04, 0.03), block(0.06, 0.55, 0.02)


def path_cell(cell: str, path: str, *words: str) -> Setup:
    only = ["scan.sweep.enabled=false", "scan.raster.enabled=false"]
    return cell_of(cell, *only, f"scan.path=[{{ speed_mm_s = 60, pitch_mm = 2, {path} }}]", *words)


def assert_joint_rates_bound_the_axis(placed: PlacedPath) -> None:
    """Speeds of the axis between the rates of a cell keep the joints' limits, and those beyond do not."""
    map_, period = placed.lattice.map, placed.lattice._period
    arm, h = map_._cell.nominal.arm, 1e-5
    rows = placed.lattice.row(np.rint((placed.motion.angle - map_.drive.low) / placed.lattice._angle))
    for column in range(3, map_.columns - 3, 5):
        row = int(rows[column])
        map_.require([column], [row])
        if not map_.quality[column, row] > 0:
            continue
        at = float(map_.angle(row))
        for rate in (map_.lowest_rate[column, row], map_.highest_rate[column, row]):
            poses = [_path_at(placed, column + sign * h / period) for sign in (-1, 1)]
            q = [
                _joints(placed, column * period + sign * h, at + sign * h * rate, one)
                for sign, one in zip((-1, 1), poses, strict=True)
            ]
            used = np.abs(q[1] - q[0]) / (2 * h) / arm.max_speed
            assert used.max() == pytest.approx(1.0, abs=0.03)


def _path_at(placed: PlacedPath, column: float) -> np.ndarray:
    """Pose of the map's path between its columns, as straight as its finite differences take it."""
    path, middle = placed.lattice.map._path, round(column)
    share = (column - middle + 1) / 2
    return pose.interpolate_straight(path[middle - 1], path[middle + 1], np.array([share]))[0]


def _joints(placed: PlacedPath, time: float, position: float, target: np.ndarray) -> np.ndarray:
    map_ = placed.lattice.map
    nominal = map_._cell.nominal
    rows = map_.drive.positions(nominal, np.array([time]), np.array([position]))
    carried = map_.drive.carried(nominal, rows)
    return map_._cell.ik(carried @ target)[0, map_.branch]


@pytest.mark.parametrize("axes", ['["tilt"]', '["tilt", "table"]', '["table", "tilt"]'])
def test_tilt_moves_along_a_path_and_the_part_is_measured_without_error(tmp_path, axes: str) -> None:
    setup = path_cell("tilt_turn", f"axis = {axes}, {ACROSS}")
    with Scanner(setup=setup) as scanner:
        plan = scanner.plan(PART)
        (placed,) = plan.paths
        assert np.ptp(placed.axes[:, -1]) > 0.05
        assert_sound(setup, plan, PART)
        result = scanner.scan(PART, engine="geometric", plan=plan.save(tmp_path / "plan.json"))
    measured = result.recording.measured
    assert measured.axes == pytest.approx(plan.axes, abs=2e-3)
    assert np.ptp(measured.axes[:, -1]) > 0.04
    assert result.evaluate().deviation.rms < 0.1e-6
    assert placed.motion.cost <= 1.05 * best_motion(placed.lattice).cost
    assert_joint_rates_bound_the_axis(placed)
    map_picture(placed.lattice.map, "path", placed.branch_name, 1.0, placed.motion).write(tmp_path / "map.png")
    assert (tmp_path / "map.png").stat().st_size > 10_000


def test_tilt_moves_along_a_path_of_an_arm_without_closed_form() -> None:
    setup, other = path_cell("tilt_turn", f'axis = ["tilt"], {ACROSS}'), cell_of("offset_wrist").cell
    cell = setup.cell.model_copy(update={"robot": other.robot, "tool": other.tool})
    setup = replace(setup, cell=cell)
    plan = planned(setup, PART)
    (placed,) = plan.paths
    assert np.ptp(placed.axes[:, -1]) > 0.05
    assert np.ptp(placed.axes[:, -2]) == 0.0
    assert_sound(setup, plan, PART)


def test_two_axes_cost_no_more_than_the_table_alone() -> None:
    alone, both = (
        planned(path_cell("tilt_turn", f"axis = {axes}, {ACROSS}"), PART).paths[0]
        for axes in ('["table"]', '["table", "tilt"]')
    )
    assert both.cost < 0.95 * alone.cost


@pytest.mark.parametrize("mode", ["dynamic", "stop-and-look"])
def test_track_follows_a_bar_longer_than_the_reach(mode: str) -> None:
    wide = ["cell.table.radius_mm=300", f'scan.mode="{mode}"']
    setup = path_cell("track", f'axis = ["track"], {ALONG}', *wide)
    (path,) = setup.scan.path
    setup = replace(setup, scan=setup.scan.replace(path=(path.replace(pitch_mm=20.0),)))
    plan = planned(setup, BAR)
    (placed,) = plan.paths
    assert np.ptp(placed.axes[:, -1]) > 0.2
    assert np.ptp(placed.axes[:, -2]) == 0.0
    assert len(plan.axes) == 26
    assert_sound(setup, plan, BAR)


def test_short_range_of_an_axis_is_kept() -> None:
    setup = path_cell("tilt_turn", f'axis = ["tilt"], {ACROSS}', "cell.axis[1].min_deg=-1", "cell.axis[1].max_deg=1.5")
    plan = planned(setup, PART)
    assert_sound(setup, plan, PART)


@pytest.mark.parametrize(
    ("axes", "error", "message"),
    [
        ('["lift"]', DescriptionError, r"path\.axis = \['lift'\]: expected table, tilt"),
        ('["table", "table"]', DescriptionError, "expected the table and another axis where there are two"),
        ('["tilt", "lift"]', DescriptionError, "expected the table and another axis where there are two"),
        ("[]", DescriptionError, r"path\[1\]\.axis"),
    ],
)
def test_wrong_axes_are_refused(axes: str, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        planned(path_cell("tilt_turn", f"axis = {axes}, {ACROSS}"), PART)


def test_path_out_of_reach_names_the_axis() -> None:
    far = ACROSS.replace("z_mm = 30", "z_mm = 1500")
    with pytest.raises(PlanningError, match="the pose is out of the arm's reach at every position of tilt"):
        planned(path_cell("tilt_turn", f'axis = ["tilt"], {far}'), PART)


def test_axis_that_carries_a_free_part_does_not_move_along_a_path() -> None:
    with pytest.raises(DescriptionError, match=r"path\.axis = 'tilt': carries cell\.part, which friction alone holds"):
        planned(path_cell("tilt_turn", f'axis = ["tilt"], {ACROSS}', 'cell.part.fixture="free"'), PART)
