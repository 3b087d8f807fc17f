"""Plans: continuity from home to home, joint limits, collision freedom, exposures, error messages."""

from itertools import pairwise

import numpy as np
import pytest
import trimesh
from cells import CYCLE, RANGE, ball, block, mesh_of, planning_cell
from fcl_collisions import path_collisions
from planned_motion import assert_axis_limits, setpoints

from scancell.config.scan import ScanDescription
from scancell.config.sensor import SensorDescription
from scancell.errors import PlanningError
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh
from scancell.planning.motion.connection import Connector
from scancell.planning.options import scan_options
from scancell.planning.path_map.configuration_map import arm_metric, clearance, joint_range, product
from scancell.planning.planner import plan
from scancell.planning.views.views import sample_part


def scan(**changes) -> ScanDescription:
    return ScanDescription.model_validate(changes)


def planned(part: Mesh, description: ScanDescription | None = None, **placement: float):
    cell = planning_cell(part, **placement)
    return cell, plan(cell, scan_options(description or scan(), SensorDescription.default()))


@pytest.fixture(scope="module")
def off_axis():
    return planned(ball(), x_mm=20.0)


@pytest.fixture(scope="module", params=["ball off the axis", "block", "tall cylinder", "tube", "stop and look"])
def any_plan(request, off_axis):
    if request.param == "ball off the axis":
        return off_axis
    if request.param == "block":
        return planned(block(0.16, 0.1, 0.08))
    if request.param == "tall cylinder":
        return planned(mesh_of(trimesh.creation.cylinder(0.03, 0.25)))
    if request.param == "tube":
        return planned(mesh_of(trimesh.creation.annulus(0.05, 0.055, 0.06)))
    return planned(ball(), scan(mode="stop-and-look", max_profiles=60), x_mm=20.0)


def test_segments_are_continuous_from_home_to_home(any_plan):
    cell, result = any_plan
    segments = result.program.segments
    assert np.abs(segments[0].axes[0, :-1] - cell.nominal.home).max() < 1e-12
    assert np.abs(segments[-1].axes[-1, :-1] - cell.nominal.home).max() < 1e-12
    assert segments[0].axes[0, -1] == cell.table_start
    for before, after in pairwise(segments):
        assert np.abs(before.axes[-1] - after.axes[0]).max() < 1e-12
    assert [s.id for s in segments] == list(range(1, len(segments) + 1))
    for s in segments:
        assert np.abs(s.times - CYCLE * np.arange(len(s.axes))).max() < 1e-9


def test_segments_keep_axis_limits(any_plan):
    assert_axis_limits(*any_plan)


def test_setpoints_are_collision_free(any_plan):
    cell, result = any_plan
    # The planned clearance of 5 mm covers the motion between set-points.
    assert path_collisions(cell, setpoints(result)) == set()


def test_trigger_rules_reproduce_planned_exposures(any_plan):
    cell, result = any_plan
    for s in result.program.segments:
        mine = result.segment == s.id
        if s.trigger.kind == "off":
            assert not mine.any()
        elif s.trigger.kind == "request":
            assert mine.sum() == 1
            assert np.abs(result.q[mine][0] - s.axes[-1, :-1]).max() < 1e-12
            assert abs(result.table[mine][0] - s.axes[-1, -1]) < 1e-12
        else:
            fine = np.arange(s.trigger_from, s.trigger_to, 1e-4)
            table = np.interp(fine, s.times, s.axes[:, -1])
            q = np.column_stack([np.interp(fine, s.times, s.axes[:, i]) for i in range(6)])
            if s.trigger.kind == "table_angle":
                travelled = np.abs(table - table[0])
            else:
                origin = cell.nominal.world_from_sensor(q)[:, :3, 3]
                travelled = np.linalg.norm(origin - origin[0], axis=1)
            fired = [np.searchsorted(travelled, k * s.trigger.interval) for k in range(mine.sum() + 1)]
            assert fired[-1] == len(fine)  # no further trigger before `trigger_to`
            poses = cell.nominal.part_from_sensor(np.column_stack([q[fired[:-1]], table[fired[:-1]]]))
            assert np.abs(poses - exposed(cell, result)[mine]).max() < 2e-4


def test_speed_is_constant_during_exposures(off_axis):
    cell, result = off_axis
    for s in result.program.segments:
        if s.trigger.kind == "off":
            continue
        inside = (s.times >= s.trigger_from - CYCLE) & (s.times <= s.trigger_to + CYCLE)
        rate = np.diff(s.axes[inside, -1]) / CYCLE
        origin = cell.nominal.world_from_sensor(s.axes[inside])[:, :3, 3]
        velocity = np.diff(origin, axis=0) / CYCLE
        assert np.ptp(rate) < 1e-9
        assert np.abs(velocity - velocity[0]).max() < 1e-9
        if s.trigger.kind == "table_angle":
            assert rate[0] == pytest.approx(np.radians(40))
            assert np.abs(velocity).max() < 1e-12
        else:
            assert np.linalg.norm(velocity[0]) == pytest.approx(0.05)
            assert np.abs(rate).max() < 1e-12


def test_passes_keep_vertical_orientation(off_axis):
    cell, result = off_axis
    for s in result.program.segments:
        if s.trigger.kind == "path_distance":
            poses = cell.nominal.world_from_sensor(s.axes)
            assert np.abs(poses[:, :3, 2] - (0, 0, -1)).max() < 1e-12
            assert np.abs(poses[:, :3, :3] - poses[0, :3, :3]).max() < 1e-12


def exposed(cell, result) -> np.ndarray:
    """Planned poses ``part_from_sensor`` (m, 4, 4) of all exposures."""
    return cell.nominal.part_from_sensor(np.column_stack([result.q, result.table]))


def test_sweeps_make_one_turn_with_vertical_sheet(off_axis):
    cell, result = off_axis
    kinds = {s.id: s.trigger for s in result.program.segments}
    for number in np.unique(result.segment):
        if kinds[number].kind == "table_angle":
            table = result.table[result.segment == number]
            assert kinds[number].interval * len(table) == pytest.approx(2 * np.pi)
            x_axis = exposed(cell, result)[result.segment == number][:, :3, 0]
            assert np.abs(x_axis[:, 2]).max() < 1e-12


def test_part_is_in_range_at_exposures(off_axis):
    cell, result = off_axis
    part = sample_part(cell.nominal.part, np.eye(4))
    meets = []
    # A sheet offset from the axis misses an off-axis part during some of the turn.
    beside = [number for number, name in result.program.names.items() if "beside" in name]
    for at in exposed(cell, result)[~np.isin(result.segment, beside)]:
        x, y, z = pose.transform_points(pose.inverse(at), part.points).T
        near_sheet = np.abs(x) < 1e-3
        meets.append(RANGE.contains(y[near_sheet], z[near_sheet]).any())
    assert np.mean(meets) > 0.97
    assert result.coverage is not None
    # Upper limit for a sphere lit at 30 degrees of elevation, with incidence up to 78 degrees.
    assert 0.9 * (1 + np.sin(np.radians(48))) / 2 < result.coverage <= (1 + np.sin(np.radians(48.5))) / 2


def test_exposure_count_meets_budget(off_axis):
    _, result = off_axis
    assert 1250 <= len(result.segment) <= 1300
    assert len(result.q) == len(result.table) == len(result.segment)
    assert set(np.unique(result.segment)) <= set(result.program.names)


def test_scan_modes_share_exposure_poses():
    cell, moving = planned(ball(), scan(max_profiles=80), x_mm=20.0)
    _, still = planned(ball(), scan(mode="stop-and-look", max_profiles=80), x_mm=20.0)
    assert np.abs(exposed(cell, moving) - exposed(cell, still)).max() < 1e-9
    assert moving.program.settle == 0.0
    assert still.program.settle == pytest.approx(0.1)
    assert sum(s.trigger.kind == "request" for s in still.program.segments) == len(still.segment)


def test_given_poses_are_reached_exactly():
    down = {"rx_deg": 180.0, "z_mm": 130.0}
    inclined = {"x_mm": 100.0, "z_mm": 90.0, "ry_deg": -130.0}
    cell, result = planned(ball(), scan(pose=[down, inclined, down]))
    above = pose.from_euler_xyz((0, 0, 0.13), (np.pi, 0, 0))
    expected = np.stack([above, pose.from_euler_xyz((0.1, 0, 0.09), (0, np.radians(-130), 0)), above])
    assert np.abs(exposed(cell, result) - expected).max() < 1e-12
    assert result.coverage is None
    assert [s.trigger.kind for s in result.program.segments].count("request") == 3
    assert cell.nominal.arm.within_limits(result.q).all()


@pytest.mark.parametrize(
    ("description", "placement", "message"),
    [
        ({}, {"x_mm": 110.0}, r"part\.stl: too large for the table: .* 135\.0 mm from the axis, 15\.0 mm beyond"),
        ({}, {"z_mm": -3.0}, r"lowest point is 3\.000 mm below"),
        ({"max_profiles": 3}, {}, "scan.max_profiles = 3: 6 views need two exposures each; expected at least 12"),
        (
            {"pose": [{"rx_deg": 180.0, "z_mm": 130.0}, {"z_mm": 3000.0}]},
            {},
            r"pose 2: out of the arm's reach by \d+ mm",
        ),
        ({"pose": [{"rx_deg": 180.0, "z_mm": 26.0}]}, {}, "pose 1: sensor comes within .* of part"),
        ({"pose": [{"rx_deg": 180.0, "z_mm": 5.0}]}, {}, "pose 1: sensor hits part"),
        ({"pose": [{"z_mm": 150.0}]}, {}, r"pose 1: (joint \d would be .* deg outside its limits|.* hits .*)"),
        (
            {"max_profiles": 1, "pose": [{"z_mm": 130.0}, {"z_mm": 130.0}]},
            {},
            "scan.max_profiles = 1: 2 poses are given; expected at least 2",
        ),
    ],
)
def test_infeasible_scan_is_rejected(description, placement, message):
    with pytest.raises(PlanningError, match=message) as caught:
        planned(ball(), scan(**description), **placement)
    assert "\n" not in str(caught.value)


def test_error_states_loss_for_too_tall_part():
    pattern = r"% of the surface .* out of reach; scan\.max_lost_share = 0\.2 .*(by \d+ mm|outside its limits|hits)"
    with pytest.raises(PlanningError, match=pattern):
        planned(mesh_of(trimesh.creation.cylinder(0.03, 1.5)))


def test_colliding_views_are_replaced_with_warning():
    stem = trimesh.creation.cylinder(0.01, 0.06, transform=pose.translation((0, 0, 0.03)))
    cap = trimesh.creation.cylinder(0.08, 0.01, transform=pose.translation((0, 0, 0.065)))
    _, result = planned(mesh_of(trimesh.util.concatenate([stem, cap])))
    assert any("sensor hits part; replaced by the sweep" in warning for warning in result.warnings)


def test_connection_avoids_obstacle():
    cell, result = planned(mesh_of(trimesh.creation.cylinder(0.03, 0.2)), scan(pose=[{"rx_deg": 180.0, "z_mm": 300.0}]))
    down = cell.ik(pose.from_euler_xyz((0.0, 0.08, 0.1), (np.pi, 0, 0))[None], result.q[0])[0]
    other = cell.ik(pose.from_euler_xyz((0.0, -0.08, 0.1), (np.pi, 0, 0))[None], result.q[0])[0]
    branch = int(np.argmax(arm_metric(cell.nominal.arm, down) * arm_metric(cell.nominal.arm, other)))
    start, end = np.append(down[branch], 0.0), np.append(other[branch], 0.0)
    straight = np.linspace(start, end, 100)
    assert cell.clearance_violations(straight, 0.0025)
    motions = Connector(cell, 0.005).connect(start, end, "the other side")
    assert len(motions) > 1
    path = np.concatenate(motions)
    assert np.abs(path[0] - start).max() < 1e-12
    assert np.abs(path[-1] - end).max() < 1e-12
    assert path_collisions(cell, path) == set()


def test_joint_range_metric():
    lower, upper = np.radians(-170.0), np.radians(170.0)
    assert joint_range(0.0, lower, upper) == pytest.approx(1.0)
    assert joint_range(np.radians(85.0), lower, upper) == pytest.approx(np.sin(np.pi * 0.75))
    assert joint_range(np.radians(85.0), lower, upper, 0.5) == pytest.approx(np.sin(np.pi * 0.75) ** 0.5)
    for outside in (-3.1, 3.1, 9.0, lower, upper):
        assert joint_range(outside, lower, upper, 0.5) == 0.0


def test_metric_is_zero_with_two_joints_outside_limits():
    lower, upper = np.full(6, -1.0), np.full(6, 1.0)
    q = np.array([1.5, -1.5, 0.0, 0.0, 0.0, 0.0])
    assert product(*joint_range(q, lower, upper)) == 0.0
    assert product(np.nan, 1.0) == 0.0


def test_clearance_metric_is_continuous_and_monotonic():
    distance = np.linspace(0.0, 0.1, 1001)
    metric = clearance(distance, 0.01, 0.06, 1.5)
    assert (metric[distance <= 0.01] == 0).all()
    assert (metric[distance >= 0.06] == 1).all()
    assert (np.diff(metric) >= 0).all()
    assert np.diff(metric).max() < 0.01
    assert clearance(0.035, 0.01, 0.06) == pytest.approx(np.sin(np.pi / 4))
