"""The plan in the workspace: what is looked at, its play-back and what pages show of it, without a browser."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from scancell.browser.panels.plans import map_html, pose_html, segments_html, state_html
from scancell.cell.program import Program, Segment, TriggerRule
from scancell.errors import CommandError
from scancell.live.plan import LivePlanState, MapPose
from scancell.output.pictures import map_pixels
from scancell.planning.path_map.configuration_map import CLEARANCE, ConfigurationMap
from scancell.planning.plan import Plan

pytest.importorskip("viser")

from scancell.browser.panels.plans import Plans

COLUMNS, ROWS = 41, 360
BRANCH = 3


class KnownMap(ConfigurationMap):
    """All cells are free but those at table angles up to 90 degrees."""

    def __init__(self) -> None:
        self.quality = np.full((COLUMNS, ROWS), 0.5, np.float32)
        self.quality[:, :90] = 0.0
        self.cause = np.where(self.quality > 0, 0, CLEARANCE).astype(np.int8)


class KnownPlans:
    """Stands for a `LivePlan`: cells of `KnownMap`, whose joints are the share of the way."""

    def __init__(self) -> None:
        self.plan: Plan | None = None
        self.went: list[tuple[np.ndarray, str]] = []
        self.map = KnownMap()

    def map_of(self, _path: int, branch: int) -> ConfigurationMap | None:
        return self.map if branch == BRANCH else None

    def evaluate(self, _path: int, _branch: int) -> None:
        """Everything is known."""

    def judge(self, _path: int, branch: int, share: float, angle: float) -> MapPose:
        if self.map_of(0, branch) is None:
            raise CommandError("the map is not evaluated yet")
        free = angle >= np.pi / 2
        axes = np.array([share, angle]) if share < 0.9 else None
        return MapPose(share, angle, 0.5 * free, "" if free else "sensor hits part", axes)

    def go_to(self, axes: np.ndarray, purpose: str) -> None:
        self.went.append((axes, purpose))


class KnownScene:
    """Keeps what it would show."""

    def __init__(self) -> None:
        self.axes: np.ndarray | None = None
        self.forbidden = False

    def show_preview(self, axes: np.ndarray | None, forbidden: bool) -> None:
        self.axes, self.forbidden = axes, forbidden


def segment(number: int, first: float, last: float, name: str, rule: str = "off") -> Segment:
    axis = np.linspace(first, last, 5)
    return Segment(number, np.linspace(0.0, 1.0, 5), np.column_stack([axis, -axis]), TriggerRule(rule), name=name)


def plan_of(paths: tuple[object, ...] = ()) -> Plan:
    program = Program(
        (segment(1, 0.0, 1.0, "to <view>"), segment(2, 1.0, 3.0, "view", "time"), segment(3, 3, 0, "home"))
    )
    return Plan(program, np.array([2, 2, 2]), np.zeros((3, 2)), 0.5, ("one & two",), paths)  # type: ignore[arg-type]


class Rig:
    """Plans with a clock that a test advances."""

    def __init__(self) -> None:
        self.made, self.scene, self.now = KnownPlans(), KnownScene(), 10.0
        self.plans = Plans(self.made, self.scene, clock=lambda: self.now)  # type: ignore[arg-type]

    def open(self, paths: tuple[object, ...] = ()) -> None:
        self.made.plan = plan_of(paths)
        self.plans.update()

    def wait(self, seconds: float) -> None:
        self.now += seconds
        self.plans.update()


@pytest.fixture
def rig() -> Iterator[Rig]:
    made = Rig()
    made.open((SimpleNamespace(lattice=SimpleNamespace(map=SimpleNamespace(branch=BRANCH))),))
    yield made


# --- play-back ------------------------------------------------------------------------------------------------------


def test_ghost_follows_the_program(rig: Rig) -> None:
    rig.plans.go_to_time(1.5)
    np.testing.assert_allclose(rig.scene.axes, [2.0, -2.0])
    assert not rig.scene.forbidden


def test_plan_plays_in_real_time_and_ends_with_the_program(rig: Rig) -> None:
    rig.plans.play_or_pause()
    rig.wait(0.5)
    rig.wait(0.75)
    assert rig.plans.time == pytest.approx(1.25)
    np.testing.assert_allclose(rig.scene.axes, [1.5, -1.5])
    rig.wait(10.0)
    assert rig.plans.time == pytest.approx(3.0)
    assert not rig.plans.plays
    rig.plans.play_or_pause()
    assert rig.plans.time == 0.0


def test_paused_plan_stays(rig: Rig) -> None:
    rig.plans.play_or_pause()
    rig.wait(0.5)
    rig.plans.play_or_pause()
    rig.wait(5.0)
    assert rig.plans.time == pytest.approx(0.5)


# --- places ---------------------------------------------------------------------------------------------------------


def test_map_of_the_planned_branch_is_looked_at_first(rig: Rig) -> None:
    assert rig.plans.map is rig.made.map


def test_free_cell_is_shown_and_reached(rig: Rig) -> None:
    rig.plans.pick(0.25, np.pi)
    np.testing.assert_allclose(rig.scene.axes, [0.25, np.pi])
    assert not rig.scene.forbidden
    rig.plans.move_robot()
    np.testing.assert_allclose(rig.made.went[0][0], [0.25, np.pi])


def test_forbidden_cell_is_red(rig: Rig) -> None:
    rig.plans.pick(0.25, 0.1)
    assert rig.scene.forbidden


def test_cell_out_of_reach_has_no_ghost_and_is_refused(rig: Rig) -> None:
    rig.plans.pick(0.95, 0.1)
    assert rig.scene.axes is None
    with pytest.raises(CommandError, match="sensor hits part"):
        rig.plans.move_robot()
    assert rig.made.went == []


def test_robot_goes_to_the_start_of_a_segment(rig: Rig) -> None:
    rig.plans.go_to_time(float(rig.plans.motion.begins[2]))
    rig.plans.move_robot()
    axes, purpose = rig.made.went[0]
    np.testing.assert_allclose(axes, [3.0, -3.0])
    assert "home" in purpose


def test_another_plan_hides_the_ghost_of_the_first(rig: Rig) -> None:
    rig.plans.pick(0.25, np.pi)
    rig.open()
    assert rig.scene.axes is None
    assert rig.plans.picked is None
    with pytest.raises(CommandError, match="choose a pose"):
        rig.plans.move_robot()


def test_without_a_plan_commands_say_so() -> None:
    plans = Rig().plans
    for act in (plans.play_or_pause, lambda: plans.go_to_time(1.0), lambda: plans.choose_map(0)):
        with pytest.raises(CommandError, match="there is no plan"):
            act()


# --- HTML -----------------------------------------------------------------------------------------------------------


def lines(html: str) -> list[np.ndarray]:
    """Points (n, 2) of the lines of a map, 0 to 1 from its upper left corner."""
    found = re.findall(r'<polyline points="([^"]*)"', html)
    return [np.array([[float(v) for v in place.split(",")] for place in line.split()]) for line in found]


def test_motion_is_drawn_at_its_table_angles() -> None:
    angle = np.linspace(np.pi, 3 * np.pi, COLUMNS)  # leaves the map above in the middle, and comes back below
    drawn = lines(map_html(KnownMap(), angle, None))
    assert len(drawn) == 2
    for line in drawn:
        expected = np.mod(np.pi + 2 * np.pi * line[:, 0], 2 * np.pi)
        np.testing.assert_allclose(2 * np.pi * (1 - line[:, 1]), expected, atol=2e-3)


def test_cross_hair_is_where_the_pose_is() -> None:
    drawn = np.concatenate(lines(map_html(KnownMap(), None, MapPose(0.25, np.pi / 2, 0.5, "", None))))
    upright, level = drawn[drawn[:, 0] == 0.25], drawn[drawn[:, 1] == 0.75]
    assert set(upright[:, 1]) == {0.0, 1.0}
    assert set(level[:, 0]) == {0.0, 1.0}


def test_legend_names_the_colours_of_the_map() -> None:
    html = map_html(KnownMap(), None, None)
    red = "#" + "".join(f"{int(c):02x}" for c in map_pixels(KnownMap())[-1, 0])  # table angle 0
    assert re.search(f"background:{red}[^<]*</span> clearance<", html)
    assert "reach<" not in html


def test_texts_of_a_plan_are_escaped() -> None:
    plan = plan_of()
    assert "to &lt;view&gt;" in segments_html(plan, 0)
    assert "one &amp; two" in state_html(LivePlanState("ready", 0.0, 0.0, ""), plan)
    assert "&lt;b&gt;" in state_html(LivePlanState("failed", 0.0, 0.0, "<b>"), None)
    assert "&lt;i&gt;" in pose_html(MapPose(0.5, 1.0, 0.0, "<i>", None))


def rows(plan: Plan, now: int) -> list[list[str]]:
    """Words in the rows of the table of segments."""
    body = segments_html(plan, now).partition("<tbody>")[2]
    return [re.sub("<[^>]*>", " ", row).split() for row in re.findall(r"<tr[^>]*>(.*?)</tr>", body)]


def test_segments_say_how_long_they_take_and_what_they_expose() -> None:
    assert rows(plan_of(), 1)[1:] == [["2", "view", "1.0", "3"], ["3", "home", "1.0", "-"]]


@pytest.mark.parametrize(("now", "first"), [(0, 1), (10, 8), (19, 14)])
def test_only_segments_around_the_current_one_are_listed(now: int, first: int) -> None:
    many = tuple(segment(number, 0.0, 0.0, "view") for number in range(1, 21))
    plan = replace(plan_of(), program=Program(many))
    assert [int(row[0]) for row in rows(plan, now)] == list(range(first, first + 7))
    assert f"segments {first} to {first + 6} of 20" in segments_html(plan, now)
