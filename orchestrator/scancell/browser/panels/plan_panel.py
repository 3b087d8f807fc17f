"""The plan of the scan: its configuration maps, its motion, and moves to its poses."""

from __future__ import annotations

from typing import Any

import numpy as np

from scancell.browser.panels.conditions import can_end, can_move
from scancell.browser.panels.handles import Follower, set_changed
from scancell.browser.panels.operator_commands import OperatorCommands
from scancell.browser.panels.plan_view import ALONG, ANGLE, map_html, pose_html, segments_html, state_html
from scancell.browser.panels.plans import Plans
from scancell.live.commands import Cancel
from scancell.live.state import LiveState
from scancell.planning.plan import Plan

_STEP = 0.01  # s of the slider


class PlanPanel:
    """Makes the plan, shows its poses as a ghost, and moves the robot to them."""

    def __init__(self, gui: Any, operator: OperatorCommands, plans: Plans) -> None:
        self._operator, self._plans = operator, plans
        self._shown: Plan | None = None
        self._drawn: tuple[object, ...] = ()
        self._followers: dict[str, Follower] = {}
        self._make = gui.add_button("Plan the scan")
        self._text = gui.add_html("")
        self._path = gui.add_dropdown("sensor path", ("-",), visible=False)
        self._branch = gui.add_dropdown("arm configuration", ("-",), visible=False)
        self._map = gui.add_html("", visible=False)
        self._along = gui.add_slider(ALONG, 0.0, 100.0, 0.1, 0.0, visible=False)
        self._angle = gui.add_slider(ANGLE, 0.0, 360.0, 0.1, 0.0, visible=False)
        self._segments = gui.add_html("", visible=False)
        self._segment = gui.add_dropdown("start of segment", ("-",), visible=False)
        self._time = gui.add_slider("time of the plan, s", 0.0, 1.0, _STEP, 0.0, visible=False)
        self._play = gui.add_button("Play the plan", icon="player-play", visible=False)
        self._go = gui.add_button("Go there", icon="route", hint="on a path without collision", visible=False)
        self._end = gui.add_button("End the motion", visible=False)
        self._hide = gui.add_button("Hide the ghost", visible=False)
        self._of_map = [self._path, self._branch, self._along, self._angle]
        self._of_plan = [self._segment, self._time, self._play, self._go, self._end, self._hide]
        self._connect()

    def _connect(self) -> None:
        operator, plans = self._operator, self._plans
        operator.add_inputs([*self._of_map, self._segment, self._time, self._play, self._hide])
        operator.add_inputs([self._make], lambda _: plans.hindrance)
        operator.add_inputs([self._go], lambda state: plans.unselected or can_move(state))
        operator.add_inputs([self._end], can_end)
        self._make.on_click(operator.operator_callback(plans.start))
        self._path.on_update(operator.operator_callback(lambda: plans.choose_map(self._number(self._path))))
        self._branch.on_update(
            operator.operator_callback(lambda: plans.choose_map(self._number(self._path), self._number(self._branch)))
        )
        for handle in (self._along, self._angle):
            handle.on_update(operator.operator_callback(self._pick))
        self._segment.on_update(operator.operator_callback(self._choose_segment))
        self._time.on_update(operator.operator_callback(lambda: plans.go_to_time(self._time.value)))
        self._play.on_click(operator.operator_callback(plans.play_or_pause))
        self._go.on_click(operator.operator_callback(plans.move_robot))
        self._end.on_click(operator.operator_callback(lambda: operator.submit(Cancel())))
        self._hide.on_click(operator.operator_callback(plans.hide))

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
        inputs = (self._path, self._branch, self._along, self._angle, self._segment, self._time)
        self._followers = {handle.label: Follower(handle) for handle in inputs}
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
