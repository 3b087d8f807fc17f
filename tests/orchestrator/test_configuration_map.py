"""Configuration map: constraints by definition, table speeds against finite differences, laziness."""

from __future__ import annotations

import numpy as np
import pytest
from cells import block, planning_cell

from scancell.geometry import pose
from scancell.planning.model import QUERY, PlanningCell
from scancell.planning.path_map import configuration_map
from scancell.planning.path_map.configuration_map import (
    CLEARANCE,
    FREE,
    JOINT_RANGE,
    REACH,
    SINGULARITY,
    USER,
    ConfigurationMap,
    StaticConstraints,
    singularity_distance,
)
from scancell.planning.path_map.numbered_branches import NumberedBranches
from scancell.planning.views.views import sweep_pose

PERIOD = 0.05
ROWS = 24


@pytest.fixture(scope="module")
def cell() -> PlanningCell:
    return planning_cell(block(0.05, 0.04, 0.03))


def circle(columns: int = 21, elevation: float = 45.0, distance: float = 0.09) -> np.ndarray:
    """A quarter turn of the sensor around the table's axis."""
    start = sweep_pose(np.array([0.02, 0.0, 0.02]), np.radians(elevation), distance)
    turns = pose.rotation_about(2, np.radians(np.linspace(0, 90, columns)))
    return np.asarray(pose.from_rotation(turns) @ start)


def static(cell: PlanningCell, **changes: object) -> StaticConstraints:
    return StaticConstraints((0.01, 0.1), cell.clearance_ranges(0.005, 0.05, 0.01), **changes)  # type: ignore[arg-type]


def a_map(cell: PlanningCell, branch: int = 0, **changes: object) -> ConfigurationMap:
    return ConfigurationMap(cell, circle(), PERIOD, branch, ROWS, static(cell, **changes))


def test_queries_of_evaluated_cells_are_work_too(cell: PlanningCell) -> None:
    judged = a_map(cell)
    judged.require([0], [0])
    before = cell.work.spent
    for _ in range(100):
        judged.require([0], [0])
    assert cell.work.spent - before == pytest.approx(100 * QUERY)


def test_the_quality_is_the_product_of_all_factors(cell: PlanningCell) -> None:
    judged = a_map(cell)
    judged.require_all()
    checked = 0
    for column, row in np.argwhere(judged.quality > 0)[::17]:
        angle = float(judged.angle(row))
        q = judged.joints([column], [angle])[0]
        distance = cell.proximity.distances(cell.nominal.body_poses(np.array([[*q, angle]])), np.inf)[0]
        low, high = cell.clearance_ranges(0.005, 0.05, 0.01).T
        expected = configuration_map.arm_metric(cell.nominal.arm, q)
        expected = expected * configuration_map.clearance(distance, low, high).prod()
        regular = singularity_distance(np.linalg.inv(cell.nominal.arm.jacobian(q)))
        expected = expected * configuration_map.clearance(regular, 0.01, 0.1)
        assert judged.quality[column, row] == pytest.approx(float(expected), rel=1e-5)
        checked += 1
    assert checked > 10


def test_exponents_of_joints_and_pairs_by_definition(cell: PlanningCell) -> None:
    """Each factor has its own exponent; equal ones are those of a single value."""
    pairs = len(cell.proximity.pairs)
    of_joints = (0.5, 1.0, 2.0, 0.25, 1.5, 3.0)
    of_pairs = np.random.default_rng(1).uniform(0.3, 3.0, pairs)
    judged, same = a_map(cell, joint_range_power=of_joints, clearance_power=of_pairs), a_map(cell)
    equal = a_map(cell, joint_range_power=(1.0,) * 6, clearance_power=np.ones(pairs))
    for map_ in (judged, same, equal):
        map_.require_all()
    np.testing.assert_array_equal(equal.cause, same.cause)
    np.testing.assert_allclose(equal.quality, same.quality, rtol=1e-6)
    np.testing.assert_array_equal(judged.cause, same.cause)  # no exponent forbids or frees a cell
    low, high = cell.clearance_ranges(0.005, 0.05, 0.01).T
    arm = cell.nominal.arm
    for column, row in np.argwhere(judged.quality > 0)[::29]:
        angle = float(judged.angle(row))
        q = judged.joints([column], [angle])[0]
        distance = cell.proximity.distances(cell.nominal.body_poses(np.array([[*q, angle]])), np.inf)[0]
        share = np.clip((distance - low) / (high - low), 0, 1)
        factors = [float(configuration_map.joint_range(a, *limits)) for a, *limits in zip(q, *arm.limits, strict=True)]
        regular = singularity_distance(np.linalg.inv(arm.jacobian(q)))
        expected = np.prod(np.power(factors, of_joints)) * np.prod(np.sin(np.pi / 2 * share) ** of_pairs)
        expected *= configuration_map.clearance(regular, 0.01, 0.1)
        assert judged.quality[column, row] == pytest.approx(float(expected), rel=1e-5)


def test_the_singularity_distance_bounds_the_smallest_singular_value(cell: PlanningCell) -> None:
    arm = cell.nominal.arm
    q = np.random.default_rng(3).uniform(*arm.limits, (200, 6))
    jacobian = arm.jacobian(q)
    weights = np.array([1, 1, 1, 0.3, 0.3, 0.3])[:, None]
    smallest = np.linalg.svd(weights * jacobian)[1][:, -1] / 0.3
    bound = singularity_distance(np.linalg.inv(jacobian))
    assert (bound <= smallest * (1 + 1e-9)).all()
    assert (bound >= smallest / np.sqrt(6) * (1 - 1e-9)).all()


def test_table_speeds_beyond_the_interval_make_a_joint_too_fast(cell: PlanningCell) -> None:
    judged = a_map(cell)
    judged.require_all()
    speed = cell.nominal.arm.max_speed
    checked = 0
    for column, row in np.argwhere(judged.quality > 0)[::29]:
        if not 0 < column < judged.columns - 1:
            continue
        angle, dt, path = float(judged.angle(row)), 1e-4, circle()
        low, high = float(judged.lowest_rate[column, row]), float(judged.highest_rate[column, row])
        reference = judged.joints([column], [angle])[0]
        for rate, within in ((low, True), (high, True), (low - 0.3, False), (high + 0.3, False)):
            ends = []
            for side in (-1, 1):
                # The sensor a moment earlier and later, between its neighbours on the path.
                at = np.array([0.5 + side * dt / (4 * PERIOD)])
                along = pose.interpolate_straight(path[column - 1], path[column + 1], at)
                turned = pose.from_rotation(pose.rotation_about(2, angle + side * rate * dt / 2)) @ along
                ends.append(cell.ik(turned, reference=reference)[0, 0])
            used = np.abs(ends[1] - ends[0]) / dt / speed
            assert (used.max() < 1.02) == within
        checked += 1
    assert checked > 5


def test_cells_say_which_constraint_forbids_them(cell: PlanningCell) -> None:
    far = ConfigurationMap(cell, circle(distance=0.6), PERIOD, 0, ROWS, static(cell))
    far.require_all()
    assert (far.cause == REACH).any()
    low = ConfigurationMap(cell, circle(elevation=0.0, distance=0.03), PERIOD, 0, ROWS, static(cell))
    low.require_all()
    assert (low.cause == CLEARANCE).any()
    never = a_map(cell, user=(lambda q, table: np.where(table < np.pi, 0.0, 1.0),))
    never.require_all()
    assert set(np.unique(never.cause[:, : ROWS // 2])) <= {REACH, JOINT_RANGE, SINGULARITY, CLEARANCE, USER}
    assert (never.quality[:, : ROWS // 2] == 0).all()
    assert (never.quality[:, ROWS // 2 :] == a_map_all(cell)[:, ROWS // 2 :]).all()


def a_map_all(cell: PlanningCell) -> np.ndarray:
    judged = a_map(cell)
    judged.require_all()
    assert (judged.cause[judged.quality > 0] == FREE).all()
    return judged.quality


def test_cells_evaluated_on_demand_are_those_of_the_whole_map(cell: PlanningCell) -> None:
    lazy = a_map(cell)
    rng = np.random.default_rng(1)
    for _ in range(5):
        lazy.require(rng.integers(0, lazy.columns, 20), rng.integers(0, ROWS, 20))
    known = np.isfinite(lazy.quality)
    assert known.sum() == lazy.evaluated <= 100
    np.testing.assert_allclose(lazy.quality[known], a_map_all(cell)[known], rtol=0, atol=1e-6)


def numbered(cell: PlanningCell, columns: int = 8, rows: int = 120) -> tuple[NumberedBranches, np.ndarray]:
    """Branches along a part of the circle, found by small steps, and the poses (columns, rows, 4, 4) of the map."""
    path = circle(6 * columns)[:columns]
    turns = pose.from_rotation(pose.rotation_about(2, np.arange(rows) * 2 * np.pi / rows))
    targets = turns @ path[:, None]
    return NumberedBranches(cell, lambda column, row: targets[column, row], np.ones(rows, bool), columns), targets


def test_branches_found_by_small_steps_are_those_of_the_closed_form(cell: PlanningCell) -> None:
    branches, targets = numbered(cell)
    named = cell.ik(targets.reshape(-1, 4, 4)).reshape(*targets.shape[:2], 8, 6)
    names = set()
    for number in range(8):
        q = branches[number]
        if q is None:
            break
        cells = np.isfinite(q[..., 0])
        assert cells.any(1).all()  # it reaches every pose of the path
        with np.errstate(invalid="ignore"):
            same = np.abs(np.remainder(named - q[:, :, None] + np.pi, 2 * np.pi) - np.pi).max(-1) < 1e-6
        (name,) = {int(one) for one in same[cells].argmax(-1)}
        assert same[cells].any(-1).all()
        # One joint configuration may be several regions of the map.
        names.add(name)
        assert np.abs(np.diff(q, axis=0)[cells[1:] & cells[:-1]]).max() < 0.2
    reached = {int(b) for b in range(8) if np.isfinite(named[:, :, b, 0]).any(1).all()}
    assert names == reached
    assert branches[8 * 3] is None


def test_joints_between_the_cells_of_a_numbered_branch_reach_the_pose(cell: PlanningCell) -> None:
    branches, targets = numbered(cell)
    q, rng = branches[0], np.random.default_rng(1)
    assert q is not None
    column, row = np.argwhere(np.isfinite(q[:-1, :, 0])).T
    some = rng.choice(len(column), 50)
    at, beside = column[some] + rng.uniform(-0.4, 0.4, 50), row[some] + rng.uniform(-0.4, 0.4, 50)
    turn = pose.from_rotation(pose.rotation_about(2, beside * 2 * np.pi / targets.shape[1]))
    wanted = turn @ targets[column[some], 0]
    found = branches.near(0, at, beside, wanted)
    met = np.isfinite(found[:, 0])
    assert met.mean() > 0.9  # others are beyond the limits of joints
    assert np.abs(cell.support_from_sensor(found[met]) - wanted[met]).max() < 1e-9
    assert np.isnan(branches.near(99, at, beside, wanted)).all()
