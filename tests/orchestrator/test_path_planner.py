"""Planned sensor paths: they follow the path within all limits, keep all clearances, and say why there is none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from cells import CYCLE, RANGE, block, planning_cell
from fcl_collisions import path_collisions

from scancell.config.loading import assets_dir, load_setup
from scancell.config.scan import (
    PairQualityDescription,
    PathDescription,
    QualityDescription,
    SpiralDescription,
    WaypointDescription,
    WeightsDescription,
)
from scancell.errors import DescriptionError
from scancell.nominal.cell import nominal_cell
from scancell.planning.model import PlanningCell
from scancell.planning.motion import trajectory
from scancell.planning.path_map import configuration_map, path_planner
from scancell.planning.path_map.configuration_map import ConfigurationMap
from scancell.planning.path_map.path_planner import PathPlanner, PlacedPath
from scancell.planning.path_map.ray_shooting import best_motion
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


def offset_wrist() -> PlanningCell:
    """An arm whose inverse kinematics is numerical."""
    setup = load_setup(assets_dir() / "cells" / "offset_wrist.toml")
    return PlanningCell(nominal_cell(setup.cell, block(0.05, 0.04, 0.03)), RANGE, CYCLE)


@pytest.fixture(scope="module", params=["closed form", "numerical"])
def followed(request: pytest.FixtureRequest) -> tuple[PlanningCell, PlacedPath]:
    """The spiral by arms with named branches and without."""
    if request.param == "closed form":
        return request.getfixturevalue("cell"), request.getfixturevalue("spiral")
    cell = offset_wrist()
    made = placed(cell, PathDescription(speed_mm_s=100.0, spiral=SpiralDescription(turns=-0.5)))
    assert isinstance(made, PlacedPath)
    return cell, made


def test_set_points_lead_the_sensor_along_the_path(followed: tuple[PlanningCell, PlacedPath]) -> None:
    cell, spiral = followed
    placed = cell.nominal.tree.place(spiral.axes, ["table", "sensor"])
    table_from_sensor = np.linalg.inv(placed["table"]) @ placed["sensor"]
    np.testing.assert_allclose(
        table_from_sensor, spiral.view.at(spiral.run.at(CYCLE * np.arange(len(spiral.axes)))), atol=1e-9
    )


def test_all_axes_keep_their_limits_at_a_tenth_of_the_cycle(followed: tuple[PlanningCell, PlacedPath]) -> None:
    cell, spiral = followed
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


def test_motion_is_near_the_optimum_with_few_cells_evaluated(followed: tuple[PlanningCell, PlacedPath]) -> None:
    _, spiral = followed
    map_ = spiral.lattice.map
    assert map_.evaluated < 0.12 * map_.quality.size
    best = best_motion(spiral.lattice)
    assert best is not None
    assert best.cost <= spiral.motion.cost * (1 + 1e-6)
    assert spiral.motion.cost < 1.1 * best.cost


def test_an_independent_library_finds_no_collision(followed: tuple[PlanningCell, PlacedPath]) -> None:
    """python-fcl at 300 poses along the path, all pairs of the scene."""
    cell, spiral = followed
    setpoints = spiral.axes
    at = np.linspace(0, len(setpoints) - 1, 300)
    dense = np.stack([np.interp(at, np.arange(len(setpoints)), column) for column in setpoints.T], -1)
    assert path_collisions(cell, dense) == set()


def test_a_path_beyond_the_arms_reach_is_refused_with_its_place(cell: PlanningCell) -> None:
    far = tuple(WaypointDescription(x_mm=x, y_mm=0.0, z_mm=900.0) for x in (-20.0, 20.0))
    made = placed(cell, PathDescription(name="far", waypoint=far))
    assert isinstance(made, str)
    assert made.startswith("far: at 0 % of the way the pose is out of the arm's reach at every table angle")


def test_path_along_which_a_joint_would_jump_is_refused(cell: PlanningCell, monkeypatch: pytest.MonkeyPatch) -> None:
    own = ConfigurationMap.joints_for

    def jumping(map_: ConfigurationMap, time: np.ndarray, *others: object) -> np.ndarray:
        q = own(map_, time, *others)
        q[np.asarray(time) > 0.4 * map_.columns * 0.05, 5] += 0.3
        return q

    monkeypatch.setattr(ConfigurationMap, "joints_for", jumping)
    monkeypatch.setattr(path_planner, "_SLOWER", (1.0,))
    made = placed(cell, PathDescription(speed_mm_s=100.0, spiral=SpiralDescription(turns=-0.1)))
    assert isinstance(made, str)
    assert "joint 6 would jump" in made


def test_path_beyond_the_reach_of_an_arm_without_closed_form_is_refused() -> None:
    far = tuple(WaypointDescription(x_mm=x, y_mm=0.0, z_mm=1200.0) for x in (-20.0, 20.0))
    made = placed(offset_wrist(), PathDescription(name="far", waypoint=far))
    assert isinstance(made, str)
    assert made.startswith("far: at 0 % of the way the pose is out of the arm's reach at every table angle")


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
    corrected = configuration_map.clearance(at, low, high)
    printed = configuration_map.clearance(at, low, high, printed=True)
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


# --- [quality] ------------------------------------------------------------------------------------------------------


def quality_map(cell: PlanningCell, **quality: object) -> np.ndarray:
    """Qualities of the ends of a short spiral in the first branch."""
    described = QualityDescription.model_validate(quality)
    description = PathDescription(spiral=SpiralDescription(turns=-0.2), quality=described)
    (path,) = sensor_paths(description, cell.nominal.part, cell.nominal.table_from_part)
    map_ = next(iter(PathPlanner(cell, CLEARANCE).lattices(path))).map
    map_.require(*(x.ravel() for x in np.meshgrid([0, map_.columns - 1], np.arange(map_.rows))))
    return np.asarray(map_.quality[[0, -1]], float)


@pytest.fixture(scope="module")
def usual(cell: PlanningCell) -> np.ndarray:
    return quality_map(cell)


def test_defaults_of_the_quality_are_those_of_the_planner(cell: PlanningCell, usual: np.ndarray) -> None:
    given = quality_map(
        cell,
        joint_range_power=(1.0,) * 6,
        full_clearance_mm=50.0,
        arm_full_clearance_mm=10.0,
        singularity=(0.01, 0.1),
        clearance_power=1.0,
    )
    np.testing.assert_array_equal(given, usual)


@pytest.mark.parametrize(
    ("lower", "higher"),
    [
        ({"joint_range_power": (2.0, 1.0, 1.0, 1.0, 1.0, 1.0)}, {"joint_range_power": (0.5, 1.0, 1.0, 1.0, 1.0, 1.0)}),
        ({"full_clearance_mm": 200.0}, {"full_clearance_mm": 12.0}),
        ({"arm_full_clearance_mm": 100.0}, {"arm_full_clearance_mm": 1.0}),
        ({"singularity": (0.01, 1.0)}, {"singularity": (0.0, 0.02)}),
    ],
)
def test_constraints_that_begin_earlier_lower_the_quality(
    cell: PlanningCell, usual: np.ndarray, lower: dict[str, object], higher: dict[str, object]
) -> None:
    """Nowhere the other way round; the cells that are forbidden stay, but for the singularity."""
    low, high = quality_map(cell, **lower), quality_map(cell, **higher)
    assert (low <= usual + 1e-7).all() and (usual <= high + 1e-7).all()
    assert low.sum() < usual.sum() <= high.sum()
    if "singularity" not in lower:
        np.testing.assert_array_equal(low > 0, usual > 0)
        np.testing.assert_array_equal(high > 0, usual > 0)


def test_forbidden_singularities_grow_with_the_lower_bound(cell: PlanningCell, usual: np.ndarray) -> None:
    forbidden = quality_map(cell, singularity=(0.3, 0.31)) <= 0
    assert (forbidden | (usual > 0)).all()
    assert forbidden.sum() > (usual <= 0).sum()


def test_values_of_a_pair_change_its_factor_alone(cell: PlanningCell, usual: np.ndarray) -> None:
    """By far clearances, or exponents, of all pairs one by one, as of all pairs at once."""
    pairs = [tuple(pair) for pair in cell.proximity.pairs]
    all_at_once = quality_map(cell, clearance_power=2.0)
    each = quality_map(cell, pair=[PairQualityDescription(bodies=pair, clearance_power=2.0) for pair in pairs])
    np.testing.assert_allclose(each, all_at_once, rtol=1e-5)
    assert np.abs(all_at_once - usual).max() > 1e-3
    near = quality_map(cell, pair=[PairQualityDescription(bodies=("part", "sensor"), full_clearance_mm=200.0)])
    ratio = near[usual > 0] / usual[usual > 0]
    assert ratio.max() < 1
    # The sensor keeps its distance from the part at every table angle: one factor for each pose.
    for column, at in zip(near, usual, strict=True):
        assert np.ptp((column / np.where(at > 0, at, np.nan))[at > 0]) < 1e-4


@pytest.mark.parametrize(
    ("quality", "message"),
    [
        (
            {"joint_range_power": (1.0, 2.0)},
            r"path\.quality\.joint_range_power = \[1\.0, 2\.0\]: expected one value, or 6: one per joint",
        ),
        (
            {"pair": [{"bodies": ("part", "crane"), "clearance_power": 2.0}]},
            r"path\.quality\.pair\[1\]\.bodies = \['part', 'crane'\]: expected two of .*sensor",
        ),
        (
            {"pair": [{"bodies": ("part", "part"), "clearance_power": 2.0}]},
            r"path\.quality\.pair\[1\]\.bodies = \['part', 'part'\]: expected two of",
        ),
    ],
)
def test_quality_that_does_not_fit_the_cell_is_named(cell: PlanningCell, quality: dict, message: str) -> None:
    with pytest.raises(DescriptionError, match=message):
        quality_map(cell, **quality)


@pytest.mark.parametrize(
    ("word", "message"),
    [
        ("singularity=[0.2, 0.1]", r"singularity = \[0\.2, 0\.1\]: expected the first value below the second"),
        ("singularity=[0.1, 0.1]", r"expected the first value below the second"),
        ("singularity=[-0.1, 0.1]", r"singularity\S* = -0\.1: .*greater than or equal to 0"),
        ("singularity=0.1", r"singularity = 0\.1"),
        ("full_clearance_mm=0", r"full_clearance_mm = 0: .*greater than or equal to 0\.001"),
        ("joint_range_power=[1, 0]", r"joint_range_power"),
        ('pair=[{bodies=["part", "sensor"]}]', r"give full_clearance_mm, clearance_power or both"),
        ('pair=[{bodies=["part"], clearance_power=1}]', r"bodies"),
    ],
)
def test_wrong_values_of_the_quality_are_named(word: str, message: str) -> None:
    spiral = "scan.path=[{spiral={turns=0.1}, quality={" + word + "}}]"
    with pytest.raises(DescriptionError, match=message):
        load_setup(settings=[spiral])
