"""A pendant: the robot moves while a button is held."""

from __future__ import annotations

from typing import Any

import numpy as np

from scancell.browser.panels.conditions import can_jog
from scancell.browser.panels.operator_commands import OperatorCommands
from scancell.cell.controller import JogFrame
from scancell.live.commands import JogJoints, JogSensor
from scancell.live.state import LiveState
from scancell.nominal.tools import frame_names, tool_names

_RATE = 10.0  # Hz, at which a held button renews its jog
_FRAMES = {"world": JogFrame.WORLD, "tool": JogFrame.SENSOR}
_SENSOR_AXES = ("along x", "along y", "along z", "about x", "about y", "about z")


class JogPanel:
    """Jogs one axis in manual operation; a lost connection ends the jog.

    Digits choose the axis; keys.js makes J and K hold the buttons, and names them as here.
    """

    def __init__(self, gui: Any, operator: OperatorCommands, state: LiveState) -> None:
        self._operator = operator
        joints = [f"joint {i}" for i in range(1, len(state.joints) + 1)]
        self._sensor_axes = _SENSOR_AXES if len(joints) >= len(_SENSOR_AXES) else ()
        self._axes = (*joints, "table", *(f"tool {axis}" for axis in self._sensor_axes))
        self._first_sensor_axis = len(joints) + 1
        self._axis = gui.add_dropdown("axis", self._axes)
        self._tool = gui.add_dropdown("tool", tool_names(operator.nominal))
        self._frame = gui.add_dropdown("x, y, z of", (*_FRAMES, *frame_names(operator.nominal)))
        self._deflection = gui.add_slider("deflection, %", 1, 100, 1, 50)
        minus = gui.add_button("Hold to jog -", icon="minus", hint="or hold the key J")
        plus = gui.add_button("Hold to jog +", icon="plus", hint="or hold the key K")
        for button, sign in ((minus, -1), (plus, 1)):
            button.on_hold(operator.callback(self._jog(sign)), callback_hz=_RATE)
        for key, name in zip("123456789", self._axes, strict=False):
            gui.add_command(f"Choose {name}", hotkey=key).on_trigger(operator.callback(self._choose(name)))
        operator.add_inputs([self._axis, self._tool, self._frame, self._deflection])
        operator.add_inputs([minus, plus], can_jog)

    def show(self, state: LiveState) -> None:
        """Do nothing: no input depends on the state."""

    def _choose(self, name: str) -> Any:
        def choose() -> None:
            self._axis.value = name

        return choose

    def _jog(self, sign: int) -> Any:
        def jog() -> None:
            number = self._axes.index(self._axis.value)
            share = sign * self._deflection.value / 100
            if number < self._first_sensor_axis:
                self._operator.submit(JogJoints(share * np.eye(self._first_sensor_axis)[number]))
            else:
                deflections = share * np.eye(len(_SENSOR_AXES))[number - self._first_sensor_axis]
                frame = _FRAMES.get(self._frame.value, self._frame.value)
                self._operator.submit(JogSensor(deflections, frame, self._tool.value))

        return jog
