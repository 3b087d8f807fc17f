"""Commands to a running cell that take effect while it is stepped; nothing here steps it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from scancell.cell.controller import GripperMode, JogFrame, Mode, Operation
from scancell.cell.instance import CellInstance
from scancell.cell.readings import Array, CellReadings, Tool
from scancell.errors import CommandError
from scancell.geometry import pose
from scancell.nominal.cell import NominalCell

_STARTED_BY = {Mode.JOINT_MOVE: "move_joints", Mode.LINE_MOVE: "move_line"}


class CellCommands(CellReadings):
    """Sets the inputs of a cell; the controller looks at them at the beginning of its next cycle."""

    def __init__(self, cell: CellInstance, nominal: NominalCell) -> None:
        super().__init__(cell, nominal)
        axes = cell.axis_names("command.")
        self._targets = cell.real_group(axes)
        self._line = cell.real_group(
            [*(f"command.target.position[{i}]" for i in (1, 2, 3)),
             *(f"command.target.orientation[{i}]" for i in (1, 2, 3, 4))]
        )  # fmt: skip
        self._jog = cell.real_group([f"command.jog[{i}]" for i in range(1, len(axes) + 1)])

    # Motion

    def start_move_joints(self, joints: ArrayLike, table_angle: float | None = None, *, speed: float = 1.0) -> None:
        """Begin to move all joints to `joints` (joints,) and the table to `table_angle` (where given), rad.

        `speed` is the share (above 0, at most 1) of the full speed of the slowest axis.

        Raises
        ------
        CommandError
            If there are more or fewer angles than joints, one is not finite, or `speed` is out of its range.
        """
        if np.shape(joints) != (self._targets.count - 1,) or not np.isfinite(joints).all():
            raise CommandError(f"move_joints: joints = {joints!r}: expected {self._targets.count - 1} angles")
        end = self.destination[-1] if table_angle is None else table_angle
        if not np.isfinite(end):
            raise CommandError(f"move_joints: table_angle = {end!r}: expected an angle")
        self._cell.set(self._targets, np.append(np.asarray(joints, float), end))
        self._start(Mode.JOINT_MOVE, speed)

    def start_move_tool(self, world_from_tool: ArrayLike, tool: Tool = "sensor", *, speed: float = 1.0) -> None:
        """Begin to move `tool` to the pose `world_from_tool` (4, 4), all joints together; the table rests.

        `speed` is the share (above 0, at most 1) of the full speed of the slowest axis.

        Raises
        ------
        CommandError
            As of `joints_for` and `start_move_joints`.
        """
        self.start_move_joints(self.joints_for(world_from_tool, tool), speed=speed)

    def start_move_line(self, world_from_tool: ArrayLike, tool: Tool = "sensor", *, speed: float = 1.0) -> None:
        """Begin to move `tool` straight to the pose `world_from_tool` (4, 4); the table rests.

        `speed` is the share (above 0, at most 1) of the line speed of the robot's description.

        Raises
        ------
        CommandError
            If there is no such tool, `world_from_tool` is no pose, or `speed` is out of its range.
        """
        sensor = self._world_from_flange(world_from_tool, tool) @ self._nominal.flange_from_sensor
        self._cell.set(self._targets, self.destination)
        self._cell.set(self._line, np.append(sensor[:3, 3], pose.quaternion_from_rotation(sensor[:3, :3])))
        self._start(Mode.LINE_MOVE, speed)

    def start_jog_joints(self, deflections: ArrayLike) -> None:
        """Begin to jog joints and table: `deflections` (at most joints + 1,) -1 to 1, the others are 0.

        Raises
        ------
        CommandError
            If there are more, or one is not finite.
        """
        values = np.asarray(deflections, float)
        if values.ndim != 1 or values.size > self._jog.count or not np.isfinite(values).all():
            raise CommandError(f"jog_joints: deflections = {deflections!r}: expected at most {self._jog.count} numbers")
        self._start_jog(Mode.JOINT_JOG, values)

    def start_jog_sensor(self, deflections: ArrayLike, frame: JogFrame = JogFrame.WORLD) -> None:
        """Begin to jog the sensor: `deflections` (6,) along x, y, z and about x, y, z of `frame`, -1 to 1.

        Raises
        ------
        CommandError
            If the arm has fewer than six joints, or there are not six finite deflections.
        """
        values = np.asarray(deflections, float)
        if values.shape != (6,) or not np.isfinite(values).all():
            raise CommandError(f"jog_sensor: deflections = {deflections!r}: expected 6 numbers")
        if self._jog.count <= 6:
            raise CommandError(f"jog_sensor: the arm has {self._jog.count - 1} joints: expected at least 6")
        self._cell.set_integer("command.jog_frame", frame)
        self._start_jog(Mode.CARTESIAN_JOG, values)

    def renew_heartbeat(self) -> None:
        """Tell the controller's watchdog that a jog is still wanted."""
        self._cell.set_integer("command.heartbeat", self._next("command.heartbeat"))

    def hold(self) -> None:
        """Let go of a jog, or give up a motion: the axes come to rest."""
        self._cell.set(self._jog, np.zeros(self._jog.count))
        self._cell.set_integer("command.mode", Mode.HOLD)

    # Operation and emergency stop

    def request_operation(self, operation: Operation) -> None:
        """Change to manual or automatic `operation`; whatever moves comes to rest."""
        self.hold()
        self._cell.set_integer("command.operation", operation)

    def set_monitor_speed(self, share: float) -> None:
        """Scale the speed of moves and programs by `share` (0 to 1) while they run, on their paths; 0 pauses them."""
        self._set_number("command.monitor_speed", share, "set_monitor_speed: share")

    def press_emergency_stop(self) -> None:
        """Press the button; the stop stays in force until `release_emergency_stop` when all axes rest."""
        self._cell.set_boolean("command.emergency_stop", True)

    def release_emergency_stop(self) -> None:
        """Release the button and reset the controller; what was stopped does not go on."""
        self._cell.set_boolean("command.emergency_stop", False)
        self.hold()
        self._cell.set_integer("command.reset", self._next("command.reset"))

    # Devices

    def run_conveyor(self, conveyor: int, speed: float) -> None:
        """Give conveyor number `conveyor` (from 1) the `speed`, m/s; its belt accelerates while the cell steps."""
        self._set_number(f"command.conveyor[{conveyor}].speed", speed, "run_conveyor: speed")

    def start_open_gripper(self, width: float) -> None:
        """Begin to bring the pads `width` apart, m."""
        self._set_number("command.gripper.width", width, "open_gripper: width")
        self._cell.set_integer("command.gripper.mode", GripperMode.WIDTH)

    def start_close_gripper(self, force: float) -> None:
        """Begin to close the gripper with `force`, N each finger."""
        self._set_number("command.gripper.force", force, "close_gripper: force")
        self._cell.set_integer("command.gripper.mode", GripperMode.FORCE)

    def _set_number(self, variable: str, value: float, name: str) -> None:
        """Set a real input; a value that is not finite would end the FMU."""
        group = self._cell.real_group([variable])
        if not np.isfinite(value):
            raise CommandError(f"{name} = {value!r}: expected a finite number")
        self._cell.set(group, np.array([value]))

    def _start_jog(self, mode: Mode, deflections: Array) -> None:
        self._cell.set(self._jog, np.append(deflections, np.zeros(self._jog.count - deflections.size)))
        self._cell.set_integer("command.mode", mode)

    def _start(self, mode: Mode, speed: float) -> None:
        if not 0.0 < speed <= 1.0:
            raise CommandError(f"{_STARTED_BY[mode]}: speed = {speed!r}: expected a number above 0, at most 1")
        self._set_number("command.speed", speed, f"{_STARTED_BY[mode]}: speed")
        self._cell.set_integer("command.mode", mode)
        self._cell.set_integer("command.start", self._next("command.start"))

    def _next(self, counter: str) -> int:
        return self._cell.get_integer(counter) + 1
