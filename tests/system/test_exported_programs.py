"""Planned scans as programs of controllers: executed by their readers in the cell they are the plan."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from bench.program_export import ENDINGS, compare
from scancell import Scanner, export_program
from scancell.arrays import Array
from scancell.cell.program import Program, Segment, TriggerRule
from scancell.config.loading import assets_dir
from scancell.errors import DescriptionError, ProgramError
from scancell.geometry import pose
from scancell.planning.plan import Plan
from scancell.programs.export import _Exporter
from scancell.programs.program import run_program
from scancell.programs.robot import deg, location, mm
from scancell.views.recorded_run import open_run

PART = assets_dir() / "parts" / "step_block.stl"
EXAMPLE = Path(__file__).parents[2] / "docs" / "examples" / "scan_passes.v2"
FEW = {"scan.max_profiles": 60, "scan.sweep.elevations_deg": [60.0], "scan.sweep.speed_deg_s": 90.0}


@pytest.fixture(scope="module")
def scanner() -> Iterator[Scanner]:
    with Scanner(settings=FEW, ideal=True, threads=1) as scanner:
        yield scanner


@pytest.fixture(scope="module")
def plan(scanner: Scanner) -> Plan:
    return scanner.plan(PART)


@pytest.mark.parametrize("language", ENDINGS)
def test_executed_program_is_the_plan(scanner: Scanner, plan: Plan, language) -> None:
    kinds = {segment.trigger.kind for segment in plan.program.segments}
    assert {"table_angle", "path_distance", "off"} <= kinds
    done = compare(scanner, PART, plan, language)
    assert done.number == len(plan.axes)
    assert done.stops < 0.01 * mm
    assert done.exposures < 0.01 * mm
    assert done.path < 0.1 * mm
    assert done.contacts == []


@pytest.mark.parametrize("language", ENDINGS)
def test_exposures_at_rest_are_those_of_the_plan(language) -> None:
    poses = [{"z_mm": 130.0, "rx_deg": 180.0}, {"x_mm": 5.0, "z_mm": 130.0, "rx_deg": 170.0}]
    with Scanner(settings={"scan.mode": "stop-and-look", "scan.pose": poses}, ideal=True, threads=1) as scanner:
        plan = scanner.plan(PART)
        done = compare(scanner, PART, plan, language)
    assert done.number == 2
    assert done.exposures < 0.01 * mm
    assert done.contacts == []


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("time", r"segment 2 \(.*\): triggers by time; expected table_angle, path_distance or exposures at rest"),
        ("path_distance", r"segment 2 .* no straight line .*; expected .*stop-and-look"),
    ],
)
def test_other_triggers_are_refused_with_segment(scanner: Scanner, plan: Plan, kind, message: str) -> None:
    first, second, *others = plan.program.segments
    other = replace(second, trigger=TriggerRule(kind, 0.01))
    changed = replace(plan, program=Program((first, other, *others), plan.program.settle))
    with pytest.raises(DescriptionError, match=message):
        export_program(changed, scanner, PART, "v2")


def test_corners_in_free_space_are_rounded(scanner: Scanner) -> None:
    """Moves of the arm without exposures in between have a zone; the first from home and the last do not."""
    with scanner.session(PART) as session:
        home, above = session.home, location(450 * mm, 0, 350 * mm, rx=180 * deg)
        over = session.joints_for(above)
        aside = session.joints_for(location(0, 100 * mm, 0) @ above, near=over)
    points = [np.append(one, 0.0) for one in (home, over, aside, home)]
    share = np.linspace(0.0, 1.0, 201)[:, None]
    smooth = 10 * share**3 - 15 * share**4 + 6 * share**5
    segments = tuple(
        Segment(number, 0.016 * np.arange(201), start + smooth * (end - start), name="leg")
        for number, (start, end) in enumerate(pairwise(points), 1)
    )
    plan = Plan(Program(segments), np.zeros(0, np.int64), np.zeros((0, 7)), None, ())
    lines = export_program(plan, scanner, PART, "urscript").splitlines()
    moves = [line for line in lines if "movej(" in line]
    assert [bool(re.search(r", r=0\.0\d+\)", move)) for move in moves] == [False, True, True, False]
    assert ".PROGRAM" in export_program(plan, scanner, PART, "v2")


@pytest.mark.parametrize("seed", range(20))
def test_zone_contains_no_place_without_proof(seed: int) -> None:
    """A point of joint space that is not free is in no triangle that the zone of a corner allows."""
    rng = np.random.default_rng(seed)
    before, corner, after = rng.uniform(-1, 1, (3, 3))
    before[-1] = corner[-1] = after[-1] = 0.0
    shares = rng.uniform(0, 0.3) * rng.dirichlet([1, 1, 1])
    bad = corner + shares[0] * (before - corner) + shares[1] * (after - corner)

    class AllButOne:
        """Every chord is free, with its deviation, that does not meet the bad point."""

        def first_clashes(self, start: Array, end: Array, slack: Array) -> list[object]:
            way = start[:, None] + np.linspace(0, 1, 2001)[:, None] * (end - start)[:, None]
            meets = (np.abs(way - bad) <= slack + 1e-3).all(-1).any(1)
            return ["clash" if one else None for one in meets]

    def base_from_tool(axes: Array) -> Array:
        return pose.translation(0.1 * axes[:, :3])

    exporter = SimpleNamespace(
        _motions=AllButOne(), _base_from_tool=base_from_tool, _plan=SimpleNamespace(program=SimpleNamespace(further=()))
    )
    exporter._at_radius = lambda *given: _Exporter._at_radius(exporter, *given)
    radius = _Exporter._radius(exporter, before, corner, after)
    if radius:
        ends = [exporter._at_radius(corner, leg, radius) for leg in (before, after)]
        inside = np.linalg.lstsq(np.transpose([end - corner for end in ends])[:2], (bad - corner)[:2], rcond=None)[0]
        assert inside.min() < 0 or inside.sum() > 1


def test_arm_and_table_take_turns_in_steps_as_fine_as_the_proof_needs() -> None:
    start, end = np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 2.0])

    class Diagonal:
        """Free near the straight motion alone."""

        def first_clashes(self, begin: Array, stop: Array) -> list[object]:
            share = (np.vstack([begin, stop]) - start) / (end - start)
            return [None if np.ptp(share, axis=1).max() < 0.2 else "clash"]

    points = _Exporter._in_turn(SimpleNamespace(_motions=Diagonal()), start, end)
    steps = np.diff(np.array([start, *points]), axis=0)
    assert len(points) == 16
    np.testing.assert_array_equal(points[-1], end)
    assert all((step[:-1].any()) != (step[-1] != 0) for step in steps)
    assert (steps * (end - start) >= 0).all()


def test_example_runs_in_the_cell_and_is_played_back(tmp_path: Path) -> None:
    with Scanner(threads=1) as scanner, scanner.session(PART, guarded=True) as session:
        done = run_program(EXAMPLE, session, "geometric", tmp_path / "run", printed=lambda _: None, recorded=True)
    assert done.contacts == []
    assert [step.command for _, step in done.steps].count("scan_line") == 2
    run = open_run(tmp_path / "run")
    assert len(run.motion.exposures) == 2 * 81 + 2
    assert np.ptp(run.motion.times) == pytest.approx(done.duration, abs=0.1)
    assert run.cloud is not None


def test_guard_stops_program_with_line(tmp_path: Path) -> None:
    file = tmp_path / "into_table.v2"
    file.write_text(".PROGRAM main()\n  MOVE TRANS(450, 0, 300, 0, 180)\n  MOVES TRANS(450, 0, 50, 0, 180)\n.END\n")
    with Scanner(threads=1) as scanner, scanner.session(guarded=True) as session:
        with pytest.raises(ProgramError, match=r"into_table\.v2:3: MOVES .*: move_line: held by the guard .*sensor"):
            run_program(file, session, "geometric", tmp_path)
        assert not session.cell.get_boolean("controller.moving")
