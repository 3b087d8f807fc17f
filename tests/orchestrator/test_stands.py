"""Stands: plans in which axes beside joints and table rest at other positions than at the start."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from cells import RANGE, block, cell_file, export_mm
from fcl_collisions import path_collisions
from test_further_axes import STACKED

from scancell import (
    DescriptionError,
    Plan,
    PlanningError,
    Scanner,
    Setup,
    assets_dir,
    load_part,
    load_setup,
    nominal_cell,
)
from scancell.planning.model import PlanningCell
from scancell.planning.motion import trajectory
from scancell.planning.motion.connection import Stands, candidate_positions
from scancell.planning.motion.trajectory import TorqueLimits
from scancell.planning.options import ScanOptions, scan_options
from scancell.planning.views.coverage import CoveragePlanner, CoverageReport, Sight
from scancell.planning.views.views import sample_part
from scancell.visibility import measurable_surface

FAR = "cell.table.pose.y_mm=750"  # beyond the reach of an arm that does not move
ALONG_TRACK = 'scan.axis=[{ name = "track", step_mm = 300 }]'
FEW = ["scan.max_profiles=60", "scan.sweep.enabled=false"]
DOWN = "scan.pose=[{ z_mm = 130.0, rx_deg = 180.0 }]"


def cell_of(name: str, *words: str) -> Setup:
    return load_setup(assets_dir() / f"cells/{name}.toml", settings=[*words], ideal=True)


def planned(setup: Setup, part: object = None) -> Plan:
    with Scanner(setup=setup) as scanner:
        return scanner.plan(block(0.05, 0.04, 0.03) if part is None else part)


def positions_of(plan: Plan) -> np.ndarray:
    """All axes (n, axes)."""
    return np.concatenate([segment.all_axes for segment in plan.program.segments])


def stops(plan: Plan) -> list[tuple[float, ...]]:
    """Positions of the further axes during the exposures, in order, each once."""
    joints = plan.q.shape[1] + 1
    return list(dict.fromkeys(tuple(row) for row in plan.axes[:, joints:].round(6)))


def assert_sound(setup: Setup, plan: Plan, part: object = None) -> None:
    """Python-fcl finds no contact of any two bodies; the motion is continuous, within all limits, and a round trip."""
    nominal = nominal_cell(setup.cell, block(0.05, 0.04, 0.03) if part is None else part)
    cell = PlanningCell(nominal, RANGE, setup.cell.world.controller_cycle)
    path = positions_of(plan)
    assert path_collisions(cell, path[::3]) == set()
    turns = np.zeros(len(nominal.axes))
    turns[len(nominal.home)] = path[-1, len(nominal.home)]
    assert path[0] == pytest.approx(nominal.start, abs=1e-9)
    assert path[-1] - turns == pytest.approx(nominal.start, abs=1e-9)
    for before, after in zip(plan.program.segments, plan.program.segments[1:], strict=False):
        assert after.all_axes[0] == pytest.approx(before.all_axes[-1], abs=1e-9)
    for segment in plan.program.segments:
        ends = [3 * [segment.all_axes[:1]], [segment.all_axes], 3 * [segment.all_axes[-1:]]]
        at_rest = np.concatenate([one for group in ends for one in group])
        assert trajectory.limit_fractions(at_rest, cell.axis_limits, cell.cycle).max() <= 1 + 1e-6, segment.name
    for number, axis in enumerate(nominal.further_axes, len(nominal.home) + 1):
        assert path[:, number].min() >= axis.min
        assert path[:, number].max() <= axis.max


def test_candidates_lead_from_the_start_to_both_limits_in_steps() -> None:
    nominal = nominal_cell(cell_of("track", "cell.axis[1].start_mm=-350").cell, None)
    described = load_setup(settings=[ALONG_TRACK]).scan.axis
    found = np.array(candidate_positions(nominal, described))[:, 0]
    assert found[0] == nominal.start[-1]
    assert sorted(found) == pytest.approx([-0.6, -0.35, -0.05, 0.25, 0.55, 0.6])
    assert (np.diff(np.abs(found - found[0])) >= 0).all()
    assert candidate_positions(nominal, ()) == [(nominal.start[-1],)]
    wide = load_setup(settings=['scan.axis=[{ name = "track", step_mm = 5000 }]']).scan.axis
    assert [at for (at,) in sorted(candidate_positions(nominal, wide))] == pytest.approx([-0.6, -0.35, 0.6])
    at_limit = nominal_cell(cell_of("track", "cell.axis[1].start_mm=600").cell, None)
    assert [at for (at,) in sorted(candidate_positions(at_limit, wide))] == pytest.approx([-0.6, 0.6])


@pytest.mark.parametrize(
    ("axes", "message"),
    [
        (
            '[{ name = "tilt", step_deg = 5 }]',
            r"scan\.axis\[1\]\.name = 'tilt': expected one of rail, column, lift, each",
        ),
        ('[{ name = "rail", step_deg = 5 }]', r"scan\.axis\[1\] = 'rail': expected step_mm, as the axis is prismatic"),
        (
            '[{ name = "column", step_mm = 5 }]',
            r"scan\.axis\[1\] = 'column': expected step_deg, as the axis is revolute",
        ),
        ('[{ name = "rail", step_mm = 300 }, { name = "rail", step_mm = 9 }]', r"scan\.axis\[2\]\.name = 'rail'"),
        (
            '[{ name = "rail", step_mm = 1 }]',
            r"scan\.axis: 1201 positions of the axes; expected larger steps: at most 500",
        ),
        ('[{ name = "rail", step_mm = 1, step_deg = 1 }]', r"give exactly one of step_mm and step_deg"),
        ('[{ name = "rail" }]', r"give exactly one of step_mm and step_deg"),
    ],
)
def test_wrong_candidates_are_refused(tmp_path, axes: str, message: str) -> None:
    on = ['cell.robot_moves_with="column"', 'cell.table.moves_with="lift"']
    with pytest.raises(DescriptionError, match=message):
        planned(load_setup(cell_file(tmp_path, STACKED), settings=[*on, *FEW, f"scan.axis={axes}"]))


def test_axes_of_a_cell_without_any_are_refused() -> None:
    with pytest.raises(DescriptionError, match=r"scan\.axis\[1\]\.name = 'track': expected a cell with \[\[axis\]\]"):
        planned(load_setup(settings=[*FEW, ALONG_TRACK]))


def test_track_brings_the_arm_to_a_part_that_it_does_not_reach_from_the_start() -> None:
    with pytest.raises(PlanningError, match=r"out of the arm's reach"):
        planned(cell_of("track", FAR, *FEW))
    setup = cell_of("track", FAR, *FEW, ALONG_TRACK)
    plan = planned(setup)
    assert not plan.warnings
    assert stops(plan) == [(0.3,)]
    assert_sound(setup, plan)


@pytest.mark.parametrize("mode", ["dynamic", "stop-and-look"])
def test_views_that_need_it_are_taken_at_other_positions_and_measure_without_error(tmp_path, mode: str) -> None:
    """Sweeps that the arm reaches from the start are made there; passes from farther along the track."""
    words = ["scan.max_profiles=60", "scan.sweep.elevations_deg=[30]", f'scan.mode="{mode}"', ALONG_TRACK]
    setup = cell_of("track", FAR, *words)
    part = load_part(assets_dir() / "artefacts/cone.toml")
    with Scanner(setup=setup) as scanner:
        plan = scanner.plan(part)
        assert len(stops(plan)) == 2
        assert_sound(setup, plan, part)
        again = Plan.load(plan.save(tmp_path / "plan.json"))
        assert np.array_equal(again.axes, plan.axes)
        assert again.program == plan.program
        result = scanner.scan(part, engine="geometric", plan=again)
    measured = result.recording.measured
    assert len(measured.axes) == len(plan.axes)
    assert measured.axes[:, -1] == pytest.approx(plan.axes[:, -1], abs=1e-9)
    assert result.evaluate().deviation.rms < 0.1e-6


def moved(plan: Plan, number: int, change: object) -> Plan:
    segments = list(plan.program.segments)
    segments[number] = replace(segments[number], further=change(segments[number].further))
    return replace(plan, program=replace(plan.program, segments=tuple(segments)), source="plan.json")


def test_saved_plans_with_other_motions_of_an_axis_are_refused() -> None:
    setup = cell_of("track", FAR, *FEW, ALONG_TRACK)
    plan = planned(setup)
    travel = next(i for i, one in enumerate(plan.program.segments) if np.ptp(one.further) > 0.1)
    cases = [
        (
            moved(plan, -1, lambda at: at + 0.01),
            r"starts 10\.000 mm from where the motion before it ends \(the axis track",
        ),
        (moved(plan, travel, lambda at: at * 2.5), r"leaves the limits of the axis track"),
        (
            moved(plan, travel, lambda at: at + 0.1 * np.sin(np.linspace(0, 40 * np.pi, len(at)))[:, None]),
            "the axis track",
        ),
        (moved(plan, 0, lambda at: at[:, :0]), r"further = \[\]: expected \[0\.0\], where the further axes"),
    ]
    with Scanner(setup=setup) as scanner:
        for bad, message in cases:
            with pytest.raises((PlanningError, DescriptionError), match=message):
                scanner.scan(block(0.05, 0.04, 0.03), engine="geometric", plan=bad)


def test_pose_that_no_position_reaches_says_so() -> None:
    far = "scan.pose=[{ x_mm = 0, y_mm = 0, z_mm = 2500, rx_deg = 180 }]"
    with pytest.raises(
        PlanningError, match=r"pose 1: out of the arm's reach.*; nor is it feasible elsewhere \(4 positions"
    ):
        planned(cell_of("track", far, ALONG_TRACK))


def test_position_that_an_obstacle_blocks_is_left_out_with_the_reason(tmp_path) -> None:
    """A post beside the track, and a carriage that would meet it; the other way is free."""
    words = []
    for name, on, at in (("carriage", "track", "y_mm = 0"), ("post", "world", "y_mm = 300")):
        file = export_mm(block(0.1, 0.1, 0.2), tmp_path / f"{name}.stl")
        words.append(f'{{ name = "{name}", mesh = "{file}", moves_with = "{on}", pose = {{ x_mm = -400, {at} }} }}')
    words = [*FEW, ALONG_TRACK, f"cell.obstacle=[{', '.join(words)}]"]
    setup = cell_of("track", "cell.table.pose.y_mm=-750", *words)
    plan = planned(setup)
    (warning,) = plan.warnings
    assert warning.startswith("2 of 4 positions of the axes are not reached with the arm at home: track at 300 mm: ")
    assert "carriage comes within 3.1 mm of post" in warning
    assert stops(plan) == [(-0.3,)]
    assert_sound(setup, plan)
    with pytest.raises(PlanningError, match="out of the arm's reach"):
        planned(cell_of("track", FAR, *words))


def test_axes_move_one_after_another_where_the_straight_way_is_blocked(tmp_path) -> None:
    """A beam on the lift passes over a post only if the lift rises before the rail moves."""
    beam, post = (
        export_mm(block(*size), tmp_path / f"{i}.stl") for i, size in enumerate([(0.05, 0.05, 0.05), (0.05, 0.05, 0.1)])
    )
    axes = """
[[axis]]
name = "rail"
kind = "prismatic"
along = "y"
min_mm = -300.0
max_mm = 300.0
max_speed_mm_s = 400.0
max_acceleration_mm_s2 = 900.0

[[axis]]
name = "lift"
kind = "prismatic"
moves_with = "rail"
min_mm = 0.0
max_mm = 100.0
max_speed_mm_s = 400.0
max_acceleration_mm_s2 = 900.0
"""
    obstacles = [
        f'{{ name = "beam", mesh = "{beam}", moves_with = "lift", pose = {{ x_mm = -500, z_mm = 30 }} }}',
        f'{{ name = "post", mesh = "{post}", pose = {{ x_mm = -500, y_mm = 80 }} }}',
    ]
    words = [
        f"cell.obstacle=[{', '.join(obstacles)}]",
        'cell.robot_moves_with="rail"',
        "cell.table.pose.y_mm=750",
        *FEW,
    ]
    described = 'scan.axis=[{ name = "rail", step_mm = 300 }, { name = "lift", step_mm = 100 }]'
    setup = load_setup(cell_file(tmp_path, axes), settings=[*words, described], ideal=True)
    plan = planned(setup)
    assert stops(plan) == [(0.3, 0.1)]
    travel = [one.further for one in plan.program.segments if np.ptp(one.further, axis=0).any()]
    assert [np.flatnonzero(np.ptp(one, axis=0)).tolist() for one in travel] == [[1], [0], [0], [1]]
    assert_sound(setup, plan)


def test_three_stacked_axes_are_chosen_together(tmp_path) -> None:
    words = ['cell.robot_moves_with="column"', 'cell.table.moves_with="lift"', "cell.table.pose.y_mm=900", *FEW]
    axes = [
        f'{{ name = "{name}", step_{unit} = {step} }}'
        for name, unit, step in (("rail", "mm", 400), ("column", "deg", 40), ("lift", "mm", 200))
    ]
    setup = load_setup(cell_file(tmp_path, STACKED), settings=[*words, f"scan.axis=[{', '.join(axes)}]"], ideal=True)
    plan = planned(setup)
    assert len(stops(plan)) == 1
    assert stops(plan)[0][0] > 0.3
    assert_sound(setup, plan)


def test_coverage_counts_what_is_measurable_from_any_position() -> None:
    setup = cell_of("track", "cell.table.pose.y_mm=900", "scan.coverage.share=0.5", ALONG_TRACK)
    part = load_part(assets_dir() / "parts/sphere_on_foot.stl")
    cell, options = PlanningCell(nominal_cell(setup.cell, part), RANGE, 0.016), scan_options(setup.scan, setup.sensor)

    def chosen(options: ScanOptions) -> tuple[CoverageReport, set[tuple[float, ...]]]:
        sight = Sight(cell.nominal.with_axes_held(), setup.sensor, lambda n, s: measurable_surface(n, s, 300))
        planner = CoveragePlanner(Stands(cell, options), sight, options)
        views, report = planner.choose(sample_part(part, cell.nominal.table_from_part), 500)
        return report, {placed.further for placed, _ in views}

    report, positions = chosen(options)
    assert report.share >= 0.5
    assert (0.0,) not in positions
    with pytest.raises(PlanningError, match="nothing of the part is measurable: no pose that the arm reaches"):
        chosen(replace(options, scan=options.scan.model_copy(update={"axis": ()})))


def test_axis_that_carries_a_part_without_a_fixture_is_refused() -> None:
    words = ['cell.part.fixture="free"', 'scan.axis=[{ name = "tilt", step_deg = 30 }]', *FEW]
    message = (
        r"scan\.axis\[1\]\.name = 'tilt': carries cell\.part, which friction alone holds; expected cell\.part\.fixture"
    )
    with pytest.raises(DescriptionError, match=message):
        planned(cell_of("tilt_turn", *words))
    planned(cell_of("track", 'cell.part.fixture="free"', ALONG_TRACK, *FEW))  # it carries the arm


def test_motors_keep_their_torques_where_the_table_tilts() -> None:
    """A table at the edge of the reach: its part is seen from above only where it is tilted towards the arm."""
    words = ['cell.axis[1].along="y"', "cell.axis[1].pose.x_mm=800", 'scan.axis=[{ name = "tilt", step_deg = 60 }]']
    setup = cell_of("tilt_turn", *words, DOWN, 'cell.robot.drive="dynamic"')
    plan = planned(setup)
    assert np.degrees(stops(plan)).ravel() == pytest.approx([-60.0], abs=1e-3)
    assert_sound(setup, plan)
    limits = TorqueLimits(setup.cell)
    for segment in plan.program.segments:
        assert limits.needed_slowdown(segment.axes[:, :-1], 0.016)[0] < 1.05, segment.name
