"""Sliders of the joints and the table."""

from __future__ import annotations

from typing import Any

import numpy as np

from scancell.browser.panels.conditions import can_move
from scancell.browser.panels.debounce import Debounce
from scancell.browser.panels.operator_commands import OperatorCommands
from scancell.live.commands import MoveJoints
from scancell.live.state import LiveState

_TABLE_DEG = 360.0  # range of the slider; the table has no limits: beyond it, whole turns are left out


class JointPanel:
    """A slider moves the robot when it is released; at rest the sliders show the measured angles."""

    def __init__(self, gui: Any, operator: OperatorCommands, state: LiveState) -> None:
        self._operator, self._debounce = operator, Debounce()
        self._limits = np.degrees(operator.nominal.arm.limits)
        limits = [*self._limits.T.tolist(), [-_TABLE_DEG, _TABLE_DEG]]
        names = [*(f"joint {i}, deg" for i in range(1, len(limits))), "table, deg"]
        shown = self._shown(state)
        self._sliders = [
            gui.add_slider(name, low, high, 0.1, value)
            for name, (low, high), value in zip(names, limits, shown, strict=True)
        ]
        self._last = shown
        self._speed = gui.add_slider("speed, %", 1, 100, 1, 30)
        home = gui.add_button("Move to home position")
        for slider in self._sliders:
            slider.on_update(operator.callback(self._debounce.change))
        home.on_click(operator.callback(self._move_home))
        operator.add_inputs([*self._sliders, self._speed, home], can_move)

    def show(self, state: LiveState) -> None:
        """Show a state, and move to the values of released sliders."""
        if self._debounce.is_pending:
            if not state.moving and self._debounce.take():
                before, self._last = self._last, [slider.value for slider in self._sliders]
                turn = self._last[-1] - before[-1]
                # A table that nobody moves keeps its whole turns.
                table = state.table_angle + np.radians(turn) if turn else None
                self._move(np.radians(self._last[:-1]), table)
            return
        if [slider.value for slider in self._sliders] != self._last:
            return  # a user has changed one, and its callback follows
        self._last = self._shown(state)
        for slider, value in zip(self._sliders, self._last, strict=True):
            if slider.value != value:
                slider.value = value

    def _shown(self, state: LiveState) -> list[float]:
        joints = np.clip(np.degrees(state.joints), *self._limits)
        table = np.degrees(state.table_angle)
        if abs(table) > _TABLE_DEG:
            table -= 360.0 * round(table / 360.0)
        return [round(value, 1) for value in (*joints.tolist(), float(table))]

    def _move_home(self) -> None:
        self._move(self._operator.nominal.home, None)

    def _move(self, joints: Any, table_angle: float | None) -> None:
        inside = np.clip(joints, *self._operator.nominal.arm.limits)  # a slider rounds beyond a limit
        self._operator.submit(MoveJoints(inside, table_angle, self._speed.value / 100))
