"""Panels that move the arm: joints, jogging and poses of the tool."""

from __future__ import annotations

from functools import partial
from html import escape
from typing import Any

import numpy as np

from scancell.arrays import Array
from scancell.browser.panels.handles import ALARM, CALM, Debounce
from scancell.browser.panels.operator_commands import OperatorCommands, can_jog, can_move
from scancell.cell.driver import JogFrame
from scancell.errors import CommandError
from scancell.geometry import pose
from scancell.live.commands import JogJoints, JogSensor, MoveJoints, MoveLine
from scancell.live.state import LiveState
from scancell.nominal.cell import frame_names, tool_names, world_from_frame

_TABLE_DEG = 360.0  # range of the slider; the table has no limits: beyond it, whole turns are left out

_RATE = 10.0  # Hz, at which a held button renews its jog
_FRAMES = {"world": JogFrame.WORLD, "tool": JogFrame.SENSOR}
_SENSOR_AXES = ("along x", "along y", "along z", "about x", "about y", "about z")

_NEAREST = "nearest to the present one"
_TOOL = "tool"


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
        home = operator.nominal.home
        operator.connect(gui.add_button("Move to home position"), lambda: self._move(home, None), can_move)
        for slider in self._sliders:
            slider.on_update(operator.callback(self._debounce.change))
        operator.add_inputs([*self._sliders, self._speed], can_move)

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

    def _move(self, joints: Any, table_angle: float | None) -> None:
        inside = np.clip(joints, *self._operator.nominal.arm.limits)  # a slider rounds beyond a limit
        self._operator.submit(MoveJoints(inside, table_angle, self._speed.value / 100))


class JogPanel:
    """Jogs one axis in manual operation; a lost connection ends the jog.

    Digits choose the axis; keys.js makes J and K hold the buttons, and names them as here.
    """

    def __init__(self, gui: Any, operator: OperatorCommands, state: LiveState) -> None:
        self._operator = operator
        joints = [f"joint {i}" for i in range(1, len(state.joints) + 1)]
        sensor_axes = _SENSOR_AXES if len(joints) >= len(_SENSOR_AXES) else ()
        self._axes = (*joints, "table", *(f"tool {axis}" for axis in sensor_axes))
        self._first_sensor_axis = len(joints) + 1
        self._axis = gui.add_dropdown("axis", self._axes)
        self._tool = gui.add_dropdown("tool", tool_names(operator.nominal))
        self._frame = gui.add_dropdown("x, y, z of", (*_FRAMES, *frame_names(operator.nominal)))
        self._deflection = gui.add_slider("deflection, %", 1, 100, 1, 50)
        minus = gui.add_button("Hold to jog -", icon="minus", hint="or hold the key J")
        plus = gui.add_button("Hold to jog +", icon="plus", hint="or hold the key K")
        for button, sign in ((minus, -1), (plus, 1)):
            button.on_hold(operator.callback(partial(self._jog, sign)), callback_hz=_RATE)
        for key, name in zip("123456789", self._axes, strict=False):
            choose = operator.callback(partial(setattr, self._axis, "value", name))
            gui.add_command(f"Choose {name}", hotkey=key).on_trigger(choose)
        operator.add_inputs([self._axis, self._tool, self._frame, self._deflection])
        operator.add_inputs([minus, plus], can_jog)

    def show(self, state: LiveState) -> None:
        """Do nothing: no input depends on the state."""

    def _jog(self, sign: int) -> None:
        number = self._axes.index(self._axis.value)
        share = sign * self._deflection.value / 100
        if number < self._first_sensor_axis:
            self._operator.submit(JogJoints(share * np.eye(self._first_sensor_axis)[number]))
        else:
            deflections = share * np.eye(len(_SENSOR_AXES))[number - self._first_sensor_axis]
            frame = _FRAMES.get(self._frame.value, self._frame.value)
            self._operator.submit(JogSensor(deflections, frame, self._tool.value))


class PosePanel:
    """Moves a tool to a pose relative to a frame of the cell or to the tool itself."""

    def __init__(self, gui: Any, scene: Any, operator: OperatorCommands, state: LiveState) -> None:
        self._operator, self._state = operator, state
        nominal, connect = operator.nominal, operator.connect
        self._tool = connect(gui.add_dropdown("tool", tool_names(nominal)), self._read)
        self._relative_to = connect(gui.add_dropdown("relative to", (*frame_names(nominal), _TOOL)), self._read)
        self._position = connect(gui.add_vector3("x, y, z, mm", (0.0, 0.0, 0.0), step=0.1), self._judge_typed)
        self._angles = connect(gui.add_vector3("XYZ' angles, deg", (0.0, 0.0, 0.0), step=0.01), self._judge_typed)
        configurations = (_NEAREST, *nominal.arm.branch_names)
        self._configuration = connect(gui.add_dropdown("configuration", configurations), self._judge_typed)
        self._straight = gui.add_checkbox("on a straight line", False)
        self._speed = gui.add_slider("speed, %", 1, 100, 1, 30)
        connect(gui.add_button("Move to this pose"), lambda: self._move(self._typed_pose()), can_move)
        connect(gui.add_button("Read the present pose"), self._read)
        self._dragged = gui.add_checkbox("drag the tool in the scene", False)
        self._verdict = gui.add_html("")
        self._gizmo = scene.add_transform_controls("/gizmo", scale=0.25, depth_test=False, visible=False)
        self._is_held = False
        self._gizmo.on_update(lambda event: operator.callback(lambda: self._drag(event.phase))(event))
        operator.add_inputs([self._straight, self._speed])
        operator.add_inputs([self._dragged], can_move)
        self._read()

    def show(self, state: LiveState) -> None:
        """Keep the gizmo at the tool unless it is dragged."""
        self._state = state
        shown = self._dragged.value and self._operator.is_operator
        if self._gizmo.visible != shown:
            self._gizmo.visible = shown
        if shown and not self._is_held and not state.moving:
            world_from_tool = self._present()
            if not np.allclose(self._gizmo.position, world_from_tool[:3, 3], atol=1e-5):
                self._gizmo.position = world_from_tool[:3, 3]
            self._gizmo.wxyz = pose.quaternion_from_rotation(world_from_tool[:3, :3])

    def _drag(self, phase: str) -> None:
        self._is_held = phase != "end"
        target = pose.pose(self._gizmo.position, self._gizmo.wxyz)
        if self._judge(target) and phase == "end":
            self._move(target)

    def _present(self) -> Array:
        return self._operator.world_from_tool(self._tool.value, self._state.joints)

    def _reference(self) -> Array:
        if self._relative_to.value == _TOOL:
            return self._present()
        axes = [*self._state.joints, self._state.table_angle]
        return world_from_frame(self._operator.nominal, self._relative_to.value, axes)

    def _typed_pose(self) -> Array:
        position, angles = np.array(self._position.value) * 1e-3, np.radians(self._angles.value)
        return np.asarray(self._reference() @ pose.from_euler_xyz(position, angles))

    def _read(self) -> None:
        relative = pose.inverse(self._reference()) @ self._present()
        self._position.value = tuple(np.round(1e3 * relative[:3, 3], 2).tolist())
        angles = np.degrees(pose.euler_xyz_from_rotation(relative[:3, :3]))
        self._angles.value = tuple(np.round(angles, 3).tolist())

    def _joints(self, target: Array) -> Array:
        wanted = self._configuration.value
        return self._operator.joints_for(target, self._tool.value, None if wanted == _NEAREST else wanted)

    def _judge_typed(self) -> None:
        self._judge(self._typed_pose())

    def _judge(self, target: Array) -> bool:
        """Show whether a pose can be reached."""
        try:
            self._joints(target)
        except CommandError as error:
            self._verdict.content = _coloured(ALARM, str(error))
            return False
        self._verdict.content = _coloured(CALM, "within reach and joint limits")
        return True

    def _move(self, target: Array) -> None:
        joints, speed = self._joints(target), self._speed.value / 100
        if self._straight.value:
            self._operator.submit(MoveLine(target, self._tool.value, speed))
        else:
            self._operator.submit(MoveJoints(joints, speed=speed))


def _coloured(colour: str, text: str) -> str:
    return f'<div style="color:{colour};padding:0 0.75em;font-size:0.9em">{escape(text)}</div>'
