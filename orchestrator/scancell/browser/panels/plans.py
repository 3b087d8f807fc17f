"""Plans of the workspace: their panel, their map and their motion."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable, Iterable
from functools import lru_cache
from html import escape
from pathlib import Path
from threading import RLock
from time import monotonic
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from scancell.arrays import Array
from scancell.browser.panels.handles import ALARM, CALM, DIMMED, MARKED, Follower, set_changed
from scancell.browser.panels.operator_commands import OperatorCommands, can_end, can_move
from scancell.browser.scene.scene import CellScene
from scancell.errors import CommandError
from scancell.live.plan import LivePlan, LivePlanState, MapPose
from scancell.live.state import Cancel, LiveState
from scancell.output.pictures import map_legend, map_pixels, motion_lines
from scancell.planning.path_map.configuration_map import ConfigurationMap
from scancell.planning.plan import Plan
from scancell.views.motion import ProgramMotion

ALONG, ANGLE = "along the path, %", "table angle, deg"  # inputs that a click on the map sets

_HEIGHT = 200  # px
_SEGMENTS = 7  # shown at a time: a scrolled list would jump back at every change
_NUMBER = "padding-right:0.5em;vertical-align:top"
_ONE_LINE = "max-width:0;width:100%;overflow:hidden;text-overflow:ellipsis;white-space:nowrap"
_RIGHT = "text-align:right;white-space:nowrap;padding-left:0.6em;vertical-align:top"
_TEXT = "padding:0 0.75em 0.4em;font-size:0.85em;line-height:1.4"
_CLICK = (
    Path(__file__).with_name("map.js").read_text(encoding="utf-8").replace("@ALONG@", ALONG).replace("@ANGLE@", ANGLE)
)

_STEP = 0.01  # s of the slider


class Plans:
    """Selects one pose of the plan: a cell of a map, or a time of the program. All methods are thread-safe.

    Parameters
    ----------
    plans
        Makes plans, and moves the robot.
    scene
        Shows the ghost.
    has_part
        Whether something stands on the table.
    clock
        s.

    Attributes
    ----------
    path, branch
        Numbers of the sensor path and arm branch whose map is selected.
    share, angle
        Selected cell of that map: share of the time along the path, 0 to 1, and angle of the table, rad.
    time
        Time of the program, s.
    """

    def __init__(
        self, plans: LivePlan, scene: CellScene, has_part: bool = True, clock: Callable[[], float] = monotonic
    ) -> None:
        self._plans, self._scene, self._has_part, self._clock = plans, scene, has_part, clock
        self._lock = RLock()
        self._plan: Plan | None = None
        self._motion: ProgramMotion | None = None
        self._picked: MapPose | None = None
        self._axes: Array | None = None
        self._what = ""
        self._playing, self._before = False, 0.0
        self.path = self.branch = 0
        self.share = self.angle = self.time = 0.0

    @property
    def state(self) -> LivePlanState:
        """Progress of the plan."""
        return self._plans.state

    @property
    def hindrance(self) -> str:
        """Reason why no plan can be made now; empty if one can."""
        if not self._has_part:
            return "the table is empty: open a part first"
        return "a plan is being made: wait for it" if self.state.stage in ("planning", "evaluating") else ""

    @property
    def plan(self) -> Plan | None:
        """The plan that is shown."""
        return self._plan

    @property
    def motion(self) -> ProgramMotion | None:
        """Motion of the plan."""
        return self._motion

    @property
    def picked(self) -> MapPose | None:
        """The selected cell of the map; None while a time is selected."""
        return self._picked

    @property
    def map(self) -> ConfigurationMap | None:
        """The selected map; None before it is evaluated."""
        return self._plans.map_of(self.path, self.branch)

    @property
    def plays(self) -> bool:
        """Whether playback of the plan is running."""
        return self._playing

    def start(self) -> None:
        """Make the plan; see `LivePlan.start`."""
        self._plans.start()

    def choose_map(self, path: int, branch: int | None = None) -> None:
        """Select the map of a path in a branch, by default the planned one; see `LivePlan.evaluate`."""
        if self._plan is None:
            raise CommandError("there is no plan: make one first")
        number = self._plan.paths[path].lattice.map.branch if branch is None else branch
        self._plans.evaluate(path, number)
        with self._lock:
            self.path, self.branch, self._picked = path, number, None

    def pick(self, share: float, angle: float) -> None:
        """Select a cell of the map; see `LivePlan.judge`."""
        picked = self._plans.judge(self.path, self.branch, share, angle)
        with self._lock:
            self.share, self.angle, self._picked, self._playing = share, angle, picked, False
            self._select(picked.axes, "the pose in the map", bool(picked.reason))

    def go_to_time(self, time: float) -> None:
        """Select a time of the program, s."""
        with self._lock:
            if self._motion is None or self._plan is None:
                raise CommandError("there is no plan: make one first")
            self.time, self._picked = float(np.clip(time, 0.0, self._motion.duration)), None
            name = self._plan.program.segments[self._motion.segment_at(self.time)].name
            self._select(self._motion.axes(self.time), f"{self.time:.1f} s of the plan ({name})", False)

    def play_or_pause(self) -> None:
        """Play the plan, from the start after its end, or pause."""
        with self._lock:
            if self._motion is None:
                raise CommandError("there is no plan: make one first")
            self._playing, self._before = not self._playing, self._clock()
            if self._playing:
                self.go_to_time(self.time if self.time < self._motion.duration else 0.0)

    def hide(self) -> None:
        """Hide the ghost."""
        with self._lock:
            self._playing, self._picked = False, None
            self._select(None, "", False)

    def move_robot(self) -> None:
        """Move the arm and the table to the selected pose; see `LivePlan.go_to`.

        Raises
        ------
        CommandError
            If no pose is selected, or it is out of reach.
        """
        with self._lock:
            self._playing = False
            axes, what = self._axes, self._what
        if axes is None:
            raise CommandError(self.unselected)
        self._plans.go_to(axes, what)

    @property
    def unselected(self) -> str:
        """Reason why no pose is selected to which the robot could move; empty if one is."""
        if self._axes is not None:
            return ""
        return self._picked.reason if self._picked is not None else "choose a pose of the plan first"

    def update(self) -> None:
        """Show a new plan, and advance the playback; one thread calls this periodically."""
        with self._lock:
            if self._plans.plan is not self._plan:
                self._take(self._plans.plan)
            if self._playing and self._motion is not None:
                now = self._clock()
                self.go_to_time(self.time + now - self._before)
                self._before = now
                self._playing = self.time < self._motion.duration

    def _take(self, plan: Plan | None) -> None:
        self.hide()
        self._plan, self.time, self.path = plan, 0.0, 0
        self._motion = None if plan is None else ProgramMotion(plan.program)
        if plan is not None and plan.paths:
            self.branch = plan.paths[0].lattice.map.branch

    def _select(self, axes: Array | None, what: str, forbidden: bool) -> None:
        self._axes, self._what = axes, what
        self._scene.show_preview(axes, forbidden)


def map_html(map_: ConfigurationMap, motion: NDArray[np.float64] | None, picked: MapPose | None) -> str:
    """A map whose time goes to the right and whose table angle goes upwards, with a motion (n,), rad, and a pose.

    A click sets the inputs `ALONG` and `ANGLE`.
    """
    lines = [] if motion is None else motion_lines(motion)
    drawn = [_line(line, "#222831", 2.5) for line in lines]
    if picked is not None:
        x, y = picked.share, 1 - picked.angle / (2 * np.pi)
        for colour, width in (("#ffffff", 3.0), ("#0b57d0", 1.2)):
            drawn += [_line([(x, 0.0), (x, 1.0)], colour, width), _line([(0.0, y), (1.0, y)], colour, width)]
    marks = "".join(
        f'<span style="display:inline-block;margin-right:0.8em"><span style="display:inline-block;width:0.8em;height:'
        f'0.8em;background:{colour};border:1px solid #7d8590"></span> {escape(name)}</span>'
        for name, colour in map_legend(map_)
    )
    return (
        f'<div style="{_TEXT}"><div>↑ table angle, 0 to 360°</div><svg viewBox="0 0 1 1" preserveAspectRatio="none" '
        f'data-map="" onclick="{escape(_CLICK)}" style="width:100%;height:{_HEIGHT}px;cursor:crosshair;display:block">'
        f'<image href="{_picture(map_)}" width="1" height="1" preserveAspectRatio="none" '
        f'style="image-rendering:pixelated"/>{"".join(drawn)}</svg>'
        f'<div style="text-align:right">along the path →</div>{marks}</div>'
    )


def pose_html(picked: MapPose) -> str:
    """Quality of a pose of the map, or the reason why it is forbidden."""
    colour = ALARM if picked.reason else CALM
    verdict = f"forbidden: {picked.reason}" if picked.reason else f"free, quality {picked.quality:.2f}"
    where = f"{100 * picked.share:.1f} % of the way, table at {np.degrees(picked.angle):.0f}°"
    return f'<div style="{_TEXT}">{where}<br><b style="color:{colour}">{escape(verdict)}</b></div>'


def state_html(state: LivePlanState, plan: Plan | None) -> str:
    """Progress and contents of a plan."""
    lines = []
    if state.stage in ("planning", "evaluating"):
        what = "planning" if state.stage == "planning" else f"evaluating the map, {state.share:.0%}"
        lines.append(f"<b>{what}</b>, {state.seconds:.0f} s")
    if state.error:
        lines.append(f'<b style="color:{ALARM}">{escape(state.error)}</b>')
    if plan is not None:
        count, program = len(plan.segment), plan.program
        lines.append(f"{count} exposures in {len(program.segments)} segments, {program.duration:.1f} s of motion")
        if plan.coverage is not None:
            lines.append(f"sees {plan.coverage:.1%} of the surface")
        lines += [escape(warning) for warning in plan.warnings]
    return f'<div style="{_TEXT}">{"<br>".join(lines or ["no plan yet"])}</div>'


def segments_html(plan: Plan, now: int) -> str:
    """A table of names, durations and numbers of exposures of the segments around `now` (index)."""
    segments, most = plan.program.segments, _SEGMENTS
    exposures = dict(zip(*(values.tolist() for values in np.unique(plan.segment, return_counts=True)), strict=True))
    first = max(0, min(now - most // 2, len(segments) - most))
    rows = [
        f'<tr style="{f"background:{MARKED}" if number == now + 1 else ""}"><td style="{_NUMBER}">{number}</td>'
        f'<td style="{"" if number == now + 1 else _ONE_LINE}" title="{escape(item.name)}">{escape(item.name)}</td>'
        f'<td style="{_RIGHT}">{item.times[-1]:.1f}</td>'
        f'<td style="{_RIGHT}">{exposures.get(item.id, "-")}</td></tr>'
        for number, item in enumerate(segments[first : first + most], start=first + 1)
    ]
    more = f"segments {first + 1} to {first + len(rows)} of {len(segments)}" if len(rows) < len(segments) else ""
    return (
        f'<div style="{_TEXT}"><table style="width:100%;border-spacing:0"><thead><tr style="color:{DIMMED}"><td></td>'
        f'<td>segment</td><td style="{_RIGHT}">time, s</td><td style="{_RIGHT}">exposures</td></tr></thead>'
        f"<tbody>{''.join(rows)}</tbody></table>{more}</div>"
    )


def _line(points: Iterable[tuple[float, float]], colour: str, width: float) -> str:
    places = " ".join(f"{x:.4f},{y:.4f}" for x, y in points)
    return (
        f'<polyline points="{places}" fill="none" stroke="{colour}" stroke-width="{width}" '
        'vector-effect="non-scaling-stroke"/>'
    )


@lru_cache(maxsize=16)
def _picture(map_: ConfigurationMap) -> str:
    """A map as a data address; it is complete when it is shown."""
    file = io.BytesIO()
    Image.fromarray(map_pixels(map_)).save(file, "PNG")
    return f"data:image/png;base64,{base64.b64encode(file.getvalue()).decode()}"


class PlanPanel:
    """Makes the plan, shows its poses as a ghost, and moves the robot to them."""

    def __init__(self, gui: Any, operator: OperatorCommands, plans: Plans) -> None:
        self._plans = plans
        self._shown: Plan | None = None
        self._drawn: tuple[object, ...] = ()
        self._followers: dict[str, Follower] = {}
        connect, number = operator.connect, self._number
        connect(gui.add_button("Plan the scan"), plans.start, lambda _: plans.hindrance)
        self._text = gui.add_html("")
        path = gui.add_dropdown("sensor path", ("-",), visible=False)
        self._path = connect(path, lambda: plans.choose_map(number(path)))
        branch = gui.add_dropdown("arm configuration", ("-",), visible=False)
        self._branch = connect(branch, lambda: plans.choose_map(number(path), number(branch)))
        self._map = gui.add_html("", visible=False)
        self._along = connect(gui.add_slider(ALONG, 0.0, 100.0, 0.1, 0.0, visible=False), self._pick)
        self._angle = connect(gui.add_slider(ANGLE, 0.0, 360.0, 0.1, 0.0, visible=False), self._pick)
        self._segments = gui.add_html("", visible=False)
        segment = gui.add_dropdown("start of segment", ("-",), visible=False)
        self._segment = connect(segment, self._choose_segment)
        time = gui.add_slider("time of the plan, s", 0.0, 1.0, _STEP, 0.0, visible=False)
        self._time = connect(time, lambda: plans.go_to_time(time.value))
        self._play = connect(gui.add_button("Play the plan", icon="player-play", visible=False), plans.play_or_pause)
        go = gui.add_button("Go there", icon="route", hint="on a path without collision", visible=False)
        connect(go, plans.move_robot, lambda state: plans.unselected or can_move(state))
        end = connect(gui.add_button("End the motion", visible=False), lambda: operator.submit(Cancel()), can_end)
        hide = connect(gui.add_button("Hide the ghost", visible=False), plans.hide)
        self._of_map = [self._path, self._branch, self._along, self._angle]
        self._of_plan = [self._segment, self._time, self._play, go, end, hide]

    def show(self, state: LiveState) -> None:
        """Show the plan and the selected pose."""
        plans = self._plans
        plan, motion = plans.plan, plans.motion
        set_changed(self._text, "content", state_html(plans.state, plan))
        if plan is None or motion is None:
            return
        if plan is not self._shown:
            self._open(plan, motion.duration)
        self._show_map(plan)
        number = motion.segment_at(plans.time)
        set_changed(self._segments, "content", segments_html(plan, number))
        self._follow(self._segment, self._segment.options[number])
        self._follow(self._time, round(plans.time, 2))
        set_changed(self._play, "label", "Pause" if plans.plays else "Play the plan")

    def _open(self, plan: Plan, duration: float) -> None:
        """Adapt the inputs to another plan."""
        self._shown, self._drawn = plan, ()
        self._followers = {handle.label: Follower(handle) for handle in (*self._of_map, self._segment, self._time)}
        self._segment.options = _numbered(item.name for item in plan.program.segments)
        self._time.max = float(np.ceil(duration / _STEP) * _STEP)
        if plan.paths:
            self._path.options = _numbered(item.view.name for item in plan.paths)
            self._branch.options = _numbered(plan.paths[0].branch_names)
        for handle in (*self._of_plan, self._segments):
            handle.visible = True
        for handle in (*self._of_map, self._map):
            handle.visible = bool(plan.paths)
        self._path.visible = len(plan.paths) > 1

    def _show_map(self, plan: Plan) -> None:
        plans = self._plans
        map_, picked = plans.map, plans.picked
        if map_ is None or not plan.paths:
            return
        self._follow(self._path, self._path.options[plans.path])
        self._follow(self._branch, self._branch.options[plans.branch])
        self._follow(self._along, round(100 * plans.share, 1))
        self._follow(self._angle, round(float(np.degrees(plans.angle)), 1))
        if self._drawn == (map_, picked):
            return
        placed = plan.paths[plans.path]
        motion = placed.motion.angle if map_.branch == placed.lattice.map.branch else None
        self._drawn = (map_, picked)
        self._map.content = map_html(map_, motion, picked) + ("" if picked is None else pose_html(picked))

    def _follow(self, handle: Any, value: object) -> None:
        self._followers[handle.label].show(value)

    def _pick(self) -> None:
        self._plans.pick(self._along.value / 100, float(np.radians(self._angle.value)))

    def _choose_segment(self) -> None:
        if self._plans.motion is not None:
            self._plans.go_to_time(float(self._plans.motion.begins[self._number(self._segment)]))

    @staticmethod
    def _number(dropdown: Any) -> int:
        return int(dropdown.options.index(dropdown.value))


def _numbered(names: Any) -> tuple[str, ...]:
    """Unique names."""
    return tuple(f"{number}: {name}" for number, name in enumerate(names, start=1))
