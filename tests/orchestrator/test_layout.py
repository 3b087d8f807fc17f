"""Layouts: within their bounds, planned as they are stated, ranked beside the present one, the same for a seed."""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import trimesh
from cells import mesh_of

import scancell
from scancell.cli.common import app
from scancell.config.loading import load_setup
from scancell.errors import DescriptionError, PlanningError
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh
from scancell.planning.layout import (
    DEFAULT_RANGES,
    WORTH,
    Layouts,
    layout_bounds,
    ranking,
    sampled,
)
from scancell.planning.views import coverage
from scancell.progress import NullProgress
from scancell.scanner import Scanner
from scancell.scanning import pipeline
from scancell.visibility import measurable_surface

FAST = {"scan.raster.enabled": False, "scan.coverage.share": 0.7}
BOUNDS = {"table.pose.x_mm": (380.0, 520.0), "table.pose.y_mm": (-80.0, 120.0), "robot.base.rz_deg": (-20.0, 30.0)}


def angle() -> Mesh:
    """An L of two unequal blocks, without any symmetry."""
    blocks = [
        trimesh.creation.box((0.06, 0.03, 0.01), pose.translation((0.0, 0.0, 0.005))),
        trimesh.creation.box((0.015, 0.025, 0.04), pose.translation((0.02, -0.002, 0.02))),
    ]
    return mesh_of(trimesh.boolean.union(blocks, engine="manifold"))


@pytest.fixture(scope="module", autouse=True)
def coarse() -> Iterator[None]:
    """Fewer samples of the surface, in the plans, too."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(coverage, "_MOST_SAMPLES", 600)
        patch.setattr(pipeline, "measurable_surface", partial(measurable_surface, samples=1200))
        yield


@pytest.fixture(scope="module")
def found() -> Layouts:
    with Scanner(settings=FAST) as scanner:
        return scanner.layout(angle(), BOUNDS, samples=10, plans=2, seed=3)


def test_proposals_are_within_the_bounds_and_the_present_layout_is_ranked(found: Layouts) -> None:
    assert [layout.name for layout in found.chosen] == ["layout_1", "layout_2"]
    for layout in found.chosen:
        assert layout.values.keys() == BOUNDS.keys()
        for key, (low, high) in BOUNDS.items():
            assert low <= layout.values[key] <= high
        assert layout.cell == load_setup(settings=layout.settings).cell
        assert all(0.0 < scan.reach <= 1.0 and scan.scanned <= scan.measurable for scan in layout.scans)
        assert layout.scans[0].clearance >= 0.8 * 5e-3 - 1e-6  # planning keeps this share of scan.clearance_mm
    assert found.present.cell == load_setup().cell
    assert found.present.values == {"table.pose.x_mm": 450.0, "table.pose.y_mm": 0.0, "robot.base.rz_deg": 0.0}
    assert sorted(layout.name for layout in found.ranked) == ["layout_1", "layout_2", "present"]
    most = max(layout.scanned for layout in found.ranked)
    enough = [layout for layout in found.ranked if layout.scanned >= most - WORTH]
    assert found.ranked[: len(enough)] == tuple(sorted(enough, key=lambda layout: layout.time))


def test_figures_are_those_of_the_plan_of_the_proposed_cell(found: Layouts, tmp_path: Path) -> None:
    layout, part = found.chosen[0], angle()
    layout.cell.to_toml(tmp_path / "cell.toml")
    assert scancell.CellDescription.from_toml(tmp_path / "cell.toml") == layout.cell
    with Scanner(tmp_path / "cell.toml", settings={**FAST, "scan.coverage.enabled": True}) as scanner:
        plan = scanner.plan(part)
    assert plan.report is not None
    assert plan.program.duration == pytest.approx(layout.time)
    seen = plan.report.share * plan.report.measurable_area / part.areas.sum()
    assert seen == pytest.approx(layout.scanned)
    assert np.asarray(plan.axes) == pytest.approx(np.asarray(layout.scans[0].plan.axes), abs=1e-9)


def test_table_and_figures_state_every_layout(found: Layouts) -> None:
    lines = found.summary().splitlines()
    assert [line.split()[0] for line in lines[2:]] == [layout.name for layout in found.ranked]
    listed = json.loads(json.dumps(found.figures))["layouts"]
    assert [layout["name"] for layout in listed] == [layout.name for layout in found.ranked]
    assert listed[0]["time_s"] == pytest.approx(found.ranked[0].time)


def test_same_seed_gives_the_same_layouts_at_any_thread_count(found: Layouts) -> None:
    with Scanner(settings=FAST, threads=1) as scanner:
        again = scanner.layout(angle(), [f"{k}={a}:{b}" for k, (a, b) in BOUNDS.items()], samples=10, plans=2, seed=3)
    assert [layout.values for layout in again.ranked] == [layout.values for layout in found.ranked]
    for one, other in zip(again.ranked, found.ranked, strict=True):
        assert one.time == pytest.approx(other.time)
        assert one.scanned == pytest.approx(other.scanned)
    assert sampled(BOUNDS, 4, 0) != sampled(BOUNDS, 4, 1)


def test_layout_of_two_parts_adds_times_and_states_the_worst_coverage() -> None:
    parts = [angle(), scancell.box_mesh((0.05, 0.03, 0.02))]
    estimated = {"cell.estimated.table.x_mm": 0.3}  # of the table where it stands
    with Scanner(settings={**FAST, **estimated}) as scanner:
        both = scanner.layout(parts, {"table.pose.x_mm": (400.0, 500.0)}, samples=2, plans=1)
    (layout,) = both.chosen
    assert layout.cell.estimated is None
    assert both.present.cell.estimated is not None
    assert len(layout.scans) == 2
    assert layout.time == pytest.approx(sum(scan.plan.program.duration for scan in layout.scans))
    assert layout.scanned == min(scan.scanned for scan in layout.scans)
    assert layout.figures["measurable"] == min(scan.measurable for scan in layout.scans)


@pytest.mark.parametrize(("x_mm", "problem"), [(3000.0, "measurable"), (0.0, "intersect")])
def test_present_layout_that_cannot_scan_is_listed_last_with_the_reason(x_mm: float, problem: str) -> None:
    with Scanner(settings={**FAST, "cell.table.pose.x_mm": x_mm}) as scanner:
        found = scanner.layout(angle(), {"table.pose.x_mm": (400.0, 500.0)}, samples=2, plans=1)
    assert found.ranked[-1] is found.present
    assert problem in found.present.problem
    assert f"present: {found.present.problem}" in found.summary()
    assert found.figures["layouts"][-1]["time_s"] is None


@pytest.mark.parametrize(
    ("vary", "message"),
    [
        (["table.pose.q_mm=1:2"], "`vary` table.pose.q_mm=1:2: table.pose.q_mm: unknown key"),
        (["nothing=1:2"], "`vary` nothing=1:2: nothing: unknown key"),
        (["table=1:2"], "`vary` table=1:2: table = 1.0: "),
        (["name=1:2"], "name = 1.0: must be a valid string"),
        (["obstacle[1].pose.x_mm=0:9"], r"index \[1\] does not exist, there are 0"),
        (["table.pose.x_mm=700:300"], "vary = 'table.pose.x_mm=700:300': the range of table.pose.x_mm is empty"),
        (["table.pose.x_mm=300:300"], "the range of table.pose.x_mm is empty"),
        (["table.pose.x_mm=300"], "vary = 'table.pose.x_mm=300': expected KEY=LOW:HIGH"),
        (["table.pose.x_mm=a:b"], "expected KEY=LOW:HIGH"),
        (["table.pose.x_mm=0:inf"], "expected KEY=LOW:HIGH"),
        (["=1:2"], "expected KEY=LOW:HIGH"),
        (["table.pose.x_mm=1:2", "table.pose.x_mm=3:4"], "table.pose.x_mm is given twice"),
        (["tool.fixture.reach_mm=-20:90"], "tool.fixture.reach_mm = -20.0: must be greater than or equal to 0"),
        (["tool.flange_from_sensor.x_mm=0:9"], "give exactly one of flange_from_sensor, fixture and pose"),
        ({"table.pose.x_mm": (5.0, 2.0)}, "the range of table.pose.x_mm is empty"),
        ({"table.pose.x_mm": 5.0}, "vary"),
        ("table.pose.x_mm=1:2", "vary"),
        ([], "parts = .*expected at least one part"),
    ],
)  # fmt: skip
def test_wrong_bounds_are_refused_with_their_key(vary: object, message: str) -> None:
    with Scanner(settings=FAST) as scanner, pytest.raises(DescriptionError, match=message):
        scanner.layout([] if vary == [] else angle(), vary)  # type: ignore[arg-type]


def test_value_that_is_not_valid_between_valid_bounds_is_refused_with_the_layout() -> None:
    with Scanner(settings=FAST) as scanner, pytest.raises(DescriptionError, match=r"the layout world.time_step_us = "):
        scanner.layout(angle(), {"world.time_step_us": (500, 1000)}, samples=2)


@pytest.mark.parametrize(
    ("bounds", "message"),
    [
        ((2000.0, 3000.0), "can scan the parts: 5 of 5 by screening: part.stl: no view is within reach of the arm"),
        ((-20.0, 20.0), "can scan the parts: 5 of 5 by screening: at the home position: base hits part"),
    ],
    ids=["reach", "collision"],
)
def test_bounds_without_a_layout_state_what_limits(bounds: tuple[float, float], message: str) -> None:
    with Scanner(settings=FAST) as scanner, pytest.raises(PlanningError, match=message):
        scanner.layout(angle(), {"table.pose.x_mm": bounds}, samples=5, plans=1)


@pytest.mark.parametrize(
    ("key", "value"),
    [("pose", [{"z_mm": 100.0}]), ("coverage.feature", [{"faces": ["1"], "share": 0.5}])],
)
def test_scan_without_a_choice_of_views_by_coverage_of_the_surface_is_refused(key: str, value: object) -> None:
    with (
        Scanner(settings={f"scan.{key}": value}) as scanner,
        pytest.raises(DescriptionError, match=f"scan.{key}.*expected none"),
    ):
        scanner.layout(angle())


@pytest.mark.parametrize(
    ("cell", "key"),
    [("fixed_table", r"table\.turns = False"), ("held_part", r"part\.moves_with = 'flange'"),
     ("belt_post", r"tool\.moves_with = 'world'")],
)  # fmt: skip
def test_cell_of_another_kind_is_refused_with_the_key(cell: str, key: str) -> None:
    with (
        Scanner(scancell.assets_dir() / "cells" / f"{cell}.toml", settings=FAST) as scanner,
        pytest.raises(DescriptionError, match=f"cell\\.{key}: expected a sensor on the flange and a part on a table"),
    ):
        scanner.layout(angle(), {"robot.base.rz_deg": (-5.0, 5.0)})


@pytest.mark.parametrize("cell", ["default", "offset_wrist", "track", "tilt_turn"])
def test_screening_finds_less_in_reach_the_farther_the_table_is(cell: str) -> None:
    with Scanner(scancell.assets_dir() / "cells" / f"{cell}.toml", settings=FAST) as scanner:
        planner = scanner._layout_planner([angle()], NullProgress())
        x = scanner.setup.cell.table.pose.x_mm
        steps = (0.0, 350.0, 500.0, 600.0, 2500.0)
        found = [planner.screen({"table.pose.x_mm": x + step}) for step in (steps[0], steps[-1])]
        reach = [planner.reach({"table.pose.x_mm": x + step})[0] for step in steps]
    assert reach[0] > reach[-1] == 0.0
    assert reach == sorted(reach, reverse=True)
    assert found[0].scanned > 0.0
    assert np.isfinite(found[0].time)
    assert "no view is within reach of the arm" in found[-1].problem
    assert (found[-1].scanned, found[-1].time) == (0.0, np.inf)


def test_screening_states_what_planning_in_full_finds_where_the_same_surface_is_measurable() -> None:
    with Scanner(settings=FAST) as scanner:
        planner = scanner._layout_planner([angle()], NullProgress())
        for values in ({}, {"table.pose.y_mm": 60.0, "table.pose.z_mm": 130.0}, {"robot.base.rz_deg": 20.0}):
            screened, planned = planner.screen(values), planner.planned("", values)
            assert screened.time == pytest.approx(planned.time, rel=1e-6)
            assert screened.scanned == pytest.approx(planned.scanned, abs=WORTH)


def test_moving_table_and_arm_together_changes_nothing() -> None:
    with Scanner(settings=FAST) as scanner:
        planner = scanner._layout_planner([angle()], NullProgress())
        here = planner.screen({})
        moved = planner.screen({f"{owner}.{axis}_mm": value + 1e3 * offset
                                for owner, x, z in (("table.pose", 450, 100), ("robot.base", 0, 0))
                                for axis, value, offset in (("x", x, 0.2), ("z", z, 0.3))})  # fmt: skip
    assert (moved.scanned, moved.time) == pytest.approx((here.scanned, here.time), abs=1e-6)


def test_default_bounds_are_of_the_keys_that_the_cell_has() -> None:
    cell = load_setup().cell
    bounds = layout_bounds(cell, ())
    assert bounds["table.pose.x_mm"] == (300.0, 600.0)
    assert {key for key in bounds if key.startswith("tool")} == {"tool.fixture.reach_mm", "tool.fixture.tilt_deg"}
    direct = cell.replace({"tool": {"flange_from_sensor": {"z_mm": 80.0}}, "robot.base": {"yaw_deg": 5.0,
                           "pitch_deg": 0.0, "roll_deg": 0.0}})  # fmt: skip
    keys = set(layout_bounds(direct, ()))
    assert keys == set(DEFAULT_RANGES) - {"robot.base.rz_deg", "tool.fixture.reach_mm", "tool.fixture.tilt_deg"}


def test_ranking_is_by_time_among_those_that_scan_enough() -> None:
    scanned, time = [0.9, 0.905, 0.5, 0.6, 0.9 - WORTH], [30.0, 20.0, 1.0, 2.0, 5.0]
    assert ranking(scanned, time) == [1, 0, 4, 3, 2]
    assert ranking([], []) == []
    rng = np.random.default_rng(0)
    for _ in range(50):
        share, duration = rng.uniform(size=8), rng.uniform(size=8)
        order = ranking(share.tolist(), duration.tolist())
        enough = share[order] >= share.max() - WORTH
        assert not (np.diff(enough.astype(int)) > 0).any()
        assert (np.diff(duration[order][enough]) >= 0).all()
        assert (np.diff(share[order][~enough]) <= 0).all()


def test_command_writes_cells_pictures_and_figures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    part, out = tmp_path / "angle.stl", tmp_path / "layouts"
    mesh = angle()
    trimesh.Trimesh(1e3 * mesh.vertices, mesh.faces).export(part)
    words = ["layout", str(part), "--vary", "table.pose.x_mm=400:500", "--samples", "3", "--out", str(out), "--json"]
    words += [word for key, value in FAST.items() for word in ("--set", f"{key}={json.dumps(value)}")]
    app([*words, "--plans", "2"], standalone_mode=False)
    answer = json.loads(capsys.readouterr().out.splitlines()[-1])
    names = {f"{name}.{suffix}" for name in ("layout_1", "layout_2") for suffix in ("toml", "png")}
    assert {file.name for file in out.iterdir()} == names | {"present.png", "layouts.json", "manifest.json"}
    assert json.loads((out / "layouts.json").read_text()) == answer["figures"]
    by_name = {one["name"]: one for one in answer["figures"]["layouts"]}
    for name in ("layout_1", "layout_2"):
        cell = scancell.CellDescription.from_toml(out / f"{name}.toml")
        assert cell.table.pose.x_mm == by_name[name]["values"]["table.pose.x_mm"]
    app([*words, "--plans", "1"], standalone_mode=False)
    assert {file.name for file in out.glob("*.toml")} == {"layout_1.toml"}
