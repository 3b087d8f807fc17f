"""Panels of the cell: joints, jogging, poses of the tool, operation, gripper, conveyors, errors of the sensor."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from html import escape
from typing import Any, get_args

import numpy as np

from scancell.arrays import Array
from scancell.browser.panels.handles import ALARM, CALM, Debounce, Follower
from scancell.browser.panels.operator_commands import OperatorCommands, can_jog, can_move
from scancell.cell.driver import JogFrame, Operation
from scancell.config.choices import Engine
from scancell.config.sensor import SensorDescription
from scancell.errors import CommandError
from scancell.geometry import pose
from scancell.live.camera import CameraFeed
from scancell.live.state import (
    CloseGripper,
    JogJoints,
    JogSensor,
    LiveState,
    MoveAxis,
    MoveJoints,
    MoveLine,
    OpenGripper,
    RunConveyor,
    SetMonitorSpeed,
    SetOperation,
)
from scancell.nominal.cell import frame_names, tool_names, world_from_frame

_TURN_DEG = 360.0  # range of the slider of the table, which has no limits, to either side of a whole turn

_RATE = 10.0  # Hz, at which a held button renews its jog
_FRAMES = {"world": JogFrame.WORLD, "tool": JogFrame.SENSOR}
_SENSOR_AXES = ("along x", "along y", "along z", "about x", "about y", "about z")

_NEAREST = "nearest to the present one"
_TOOL = "tool"

_OPERATIONS = {"automatic": Operation.AUTOMATIC, "manual": Operation.MANUAL}
_MOST_WIDTH_MM, _MOST_FORCE, _MOST_SPEED_MM = 200.0, 200.0, 500.0


class JointPanel:
    """A slider moves the robot when it is released; at rest the sliders show the measured angles."""

    def __init__(self, gui: Any, operator: OperatorCommands, state: LiveState) -> None:
        self._operator, self._debounce = operator, Debounce()
        nominal = operator.nominal
        self._table, self._further = len(nominal.home), nominal.further_axes
        self._per_unit = np.array([np.pi / 180] * (self._table + 1) + [axis.per_unit for axis in self._further])
        limits = [*np.degrees(nominal.arm.limits).T.tolist(), [-_TURN_DEG, _TURN_DEG]]
        limits += [[axis.min / axis.per_unit, axis.max / axis.per_unit] for axis in self._further]
        names = [*(f"joint {i}, deg" for i in range(1, self._table + 1)), "table, deg"]
        names += [f"{axis.name}, {axis.unit}" for axis in self._further]
        self._limits = np.array([[-np.inf, np.inf] if i == self._table else pair for i, pair in enumerate(limits)]).T
        shown = self._shown(state)
        self._sliders = [
            gui.add_slider(name, low, high, 0.1, np.clip(value, low, high))
            for name, (low, high), value in zip(names, limits, shown, strict=True)
        ]
        self._sliders[self._table].visible = nominal.table_turns
        self._turn = 0  # whole turns of the table in the middle of its slider
        self._last = [slider.value for slider in self._sliders]
        self.show(state)
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
                self._move_changed(np.subtract(self._last, before), state)
            return
        if [slider.value for slider in self._sliders] != self._last:
            return  # a user has changed one, and its callback follows
        self._last = self._shown(state)
        self._follow_turns(self._last[self._table])
        for slider, value in zip(self._sliders, self._last, strict=True):
            if slider.value != value:
                slider.value = value

    def _follow_turns(self, table: float) -> None:
        """Shift the range of the slider of the table where it is at either end."""
        if abs(table - self._turn * _TURN_DEG) < _TURN_DEG:
            return
        self._turn = round(table / _TURN_DEG)
        slider = self._sliders[self._table]
        slider.min, slider.max = (self._turn - 1) * _TURN_DEG, (self._turn + 1) * _TURN_DEG

    def _shown(self, state: LiveState) -> list[float]:
        return [round(value, 1) for value in np.clip(state.axes / self._per_unit, *self._limits).tolist()]

    def _move_changed(self, changed: Any, state: LiveState) -> None:
        """Move the axes whose sliders have changed: joints and table together, then those beyond one by one."""
        of_further = np.flatnonzero(changed[self._table + 1 :])
        if changed[: self._table + 1].any() or not len(of_further):
            # The slider rounds: a table that nobody moves rests.
            turn = changed[self._table]
            table = state.table_angle + np.radians(turn) if turn else None
            self._move(np.radians(self._last[: self._table]), table)
        for number in of_further.tolist():
            axis = self._further[number]
            position = np.clip(self._last[self._table + 1 + number] * axis.per_unit, axis.min, axis.max)
            self._operator.submit(MoveAxis(axis.name, float(position), self._speed.value / 100))

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
        further = [axis.name for axis in operator.nominal.further_axes]
        self._axes = (*joints, "table", *further, *(f"tool {axis}" for axis in sensor_axes))
        self._first_sensor_axis = len(joints) + 1 + len(further)
        offered = tuple(name for name in self._axes if name != "table" or operator.nominal.table_turns)
        self._axis = gui.add_dropdown("axis", offered)
        self._tool = gui.add_dropdown("tool", tool_names(operator.nominal))
        self._frame = gui.add_dropdown("x, y, z of", (*_FRAMES, *frame_names(operator.nominal)))
        self._deflection = gui.add_slider("deflection, %", 1, 100, 1, 50)
        minus = gui.add_button("Hold to jog -", icon="minus", hint="or hold the key J")
        plus = gui.add_button("Hold to jog +", icon="plus", hint="or hold the key K")
        for button, sign in ((minus, -1), (plus, 1)):
            button.on_hold(operator.callback(partial(self._jog, sign)), callback_hz=_RATE)
        for key, name in zip("123456789", offered, strict=False):
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
        return self._operator.world_from_tool(self._tool.value, self._state.axes)

    def _reference(self) -> Array:
        if self._relative_to.value == _TOOL:
            return self._present()
        return world_from_frame(self._operator.nominal, self._relative_to.value, self._state.axes)

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


class CellPanel:
    """Inputs of the controller and of the devices."""

    def __init__(self, gui: Any, operator: OperatorCommands, state: LiveState) -> None:
        self._operator = operator
        self._operation = Follower(gui.add_dropdown("operation", tuple(_OPERATIONS)))
        self._monitor = Follower(gui.add_slider("monitor speed, %", 0, 100, 1, 100))
        operator.connect(
            self._operation.handle, lambda: operator.submit(SetOperation(_OPERATIONS[self._operation.value])), can_move
        )
        operator.connect(self._monitor.handle, lambda: operator.submit(SetMonitorSpeed(self._monitor.value / 100)))
        if state.gripper_width is not None:
            self._add_gripper(gui, state.gripper_width)
        for number, (speed, _) in enumerate(state.conveyors, start=1):
            slider = gui.add_slider(
                f"conveyor {number}, mm/s", -_MOST_SPEED_MM, _MOST_SPEED_MM, 1.0, round(1e3 * speed)
            )
            operator.connect(slider, partial(self._run_conveyor, number, slider), can_move)
        self.show(state)

    def show(self, state: LiveState) -> None:
        """Show the operation and the monitor speed that were chosen."""
        name = next(name for name, value in _OPERATIONS.items() if value is state.operation)
        self._operation.show(name)
        self._monitor.show(round(100 * state.monitor_speed))

    def _add_gripper(self, gui: Any, width: float) -> None:
        operator = self._operator
        field = gui.add_number("gripper width, mm", round(1e3 * width, 1), min=0.0, max=_MOST_WIDTH_MM, step=1.0)
        force = gui.add_number("gripper force, N", 20.0, min=0.0, max=_MOST_FORCE, step=1.0)
        operator.add_inputs([field, force])
        opened, closed = gui.add_button("Open the gripper"), gui.add_button("Close the gripper")
        operator.connect(opened, lambda: operator.submit(OpenGripper(1e-3 * field.value)), can_move)
        operator.connect(closed, lambda: operator.submit(CloseGripper(force.value)), can_move)

    def _run_conveyor(self, conveyor: int, slider: Any) -> None:
        self._operator.submit(RunConveyor(conveyor, 1e-3 * slider.value))


@dataclass(frozen=True)
class Perturbation:
    """A value of the true sensor from `low` to `high`, with its `nominal` value."""

    label: str
    key: str
    nominal: float
    low: float
    high: float
    step: float


def perturbations(sensor: SensorDescription) -> list[Perturbation]:
    """Perturbations that the panel offers."""
    laser, detector = sensor.laser, sensor.detector
    found = [
        _around("laser offset x, mm", "sensor.laser.offset_x_mm", laser.offset_x_mm, 1.0, 0.01),
        _around("laser turn y, deg", "sensor.laser.turn_y_deg", laser.turn_y_deg, 1.0, 0.01),
        _around("laser turn z, deg", "sensor.laser.turn_z_deg", laser.turn_z_deg, 2.0, 0.01),
    ]
    for number, camera in enumerate(sensor.camera, 1):
        key = f"sensor.camera[{number}]"
        found += [
            _around(f"{camera.name}: tilt, deg", f"{key}.tilt_deg", camera.tilt_deg, 0.5, 0.01),
            _around(f"{camera.name}: roll, deg", f"{key}.roll_deg", camera.roll_deg, 2.0, 0.01),
            _around(f"{camera.name}: offset y, mm", f"{key}.offset_y_mm", camera.offset_y_mm, 1.0, 0.01),
        ]
    noise, light = detector.read_noise_e, sensor.ambient.irradiance_w_m2
    return [
        *found,
        Perturbation("read noise, e-", "sensor.detector.read_noise_e", noise, 0.0, max(200.0, 2 * noise), 1.0),
        Perturbation("exposure, ms", "sensor.detector.exposure_ms", detector.exposure_ms, 0.01, 10.0, 0.01),
        Perturbation("ambient light, W/m²", "sensor.ambient.irradiance_w_m2", light, 0.0, max(20.0, 2 * light), 0.1),
    ]


def _around(label: str, key: str, nominal: float, reach: float, step: float) -> Perturbation:
    return Perturbation(label, key, nominal, round(nominal - reach, 3), round(nominal + reach, 3), step)


class SensorPanel:
    """Sliders for the true sensor; values that are not nominal perturb it."""

    def __init__(self, gui: Any, operator: OperatorCommands, feed: CameraFeed, sensor: SensorDescription) -> None:
        self._operator, self._feed, self._debounce = operator, feed, Debounce(delay=0.1)
        in_force = dict(word.split("=", 1) for word in feed.as_built)
        engine = gui.add_dropdown("engine", get_args(Engine), initial_value=feed.engine)
        operator.connect(engine, lambda: setattr(feed, "engine", engine.value))
        self._sliders = []
        for one in perturbations(sensor):
            value = float(in_force.pop(one.key, one.nominal))
            slider = gui.add_slider(one.label, one.low, one.high, one.step, min(max(value, one.low), one.high))
            self._sliders.append((one, operator.connect(slider, self._debounce.change)))
        others = " ".join(f"{key}={value}" for key, value in in_force.items())
        field = gui.add_text("others", others, hint="KEY=VALUE KEY=VALUE, as for --as-built")
        self._others = operator.connect(field, self._debounce.change)
        operator.connect(gui.add_button("All nominal"), self._restore)

    def show(self, state: LiveState) -> None:
        """Perturb the sensor when the sliders are released."""
        if self._debounce.take():
            self._operator.as_operator(lambda: self._feed.perturb(self._words()))

    def _words(self) -> list[str]:
        changed = [(one.key, slider.value) for one, slider in self._sliders if abs(slider.value - one.nominal) > 1e-9]
        return [*(f"{key}={value:g}" for key, value in changed), *self._others.value.split()]

    def _restore(self) -> None:
        for one, slider in self._sliders:
            slider.value = one.nominal
        self._others.value = ""
        self._feed.perturb(())
