"""Poses of the tool, entered as numbers or dragged in the scene."""

from __future__ import annotations

from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell.browser.panels.colours import ALARM, CALM
from scancell.browser.panels.conditions import can_move
from scancell.browser.panels.operator_commands import OperatorCommands
from scancell.errors import CommandError
from scancell.geometry import pose
from scancell.live.commands import MoveJoints, MoveLine
from scancell.live.state import LiveState
from scancell.nominal.tools import frame_names, tool_names, world_from_frame

Array = NDArray[np.float64]

_NEAREST = "nearest to the present one"
_TOOL = "tool"


class PosePanel:
    """Moves a tool to a pose relative to a frame of the cell or to the tool itself."""

    def __init__(self, gui: Any, scene: Any, operator: OperatorCommands, state: LiveState) -> None:
        self._operator, self._state = operator, state
        self._tool = gui.add_dropdown("tool", tool_names(operator.nominal))
        self._relative_to = gui.add_dropdown("relative to", (*frame_names(operator.nominal), _TOOL))
        self._position = gui.add_vector3("x, y, z, mm", (0.0, 0.0, 0.0), step=0.1)
        self._angles = gui.add_vector3("XYZ' angles, deg", (0.0, 0.0, 0.0), step=0.01)
        self._configuration = gui.add_dropdown("configuration", (_NEAREST, *operator.nominal.arm.branch_names))
        self._straight = gui.add_checkbox("on a straight line", False)
        self._speed = gui.add_slider("speed, %", 1, 100, 1, 30)
        move, here = gui.add_button("Move to this pose"), gui.add_button("Read the present pose")
        self._dragged = gui.add_checkbox("drag the tool in the scene", False)
        self._verdict = gui.add_html("")
        self._gizmo = scene.add_transform_controls("/gizmo", scale=0.25, depth_test=False, visible=False)
        self._is_held = False
        move.on_click(operator.callback(lambda: self._move(self._typed_pose())))
        here.on_click(operator.callback(self._read))
        for handle in (self._tool, self._relative_to):
            handle.on_update(operator.callback(self._read))
        for handle in (self._position, self._angles, self._configuration):
            handle.on_update(operator.callback(lambda: self._judge(self._typed_pose())))
        self._gizmo.on_update(lambda event: operator.callback(lambda: self._drag(event.phase))(event))
        inputs = (self._tool, self._relative_to, self._position, self._angles, self._configuration, self._straight)
        operator.add_inputs([*inputs, self._speed, here])
        operator.add_inputs([move, self._dragged], can_move)
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
