"""Commands of scripts to a running cell: each steps the cell until it is done, or raises an error with the reason.

::

    with CellInstance(fmu) as cell:
        session = CellSession(cell, nominal, cycle_us)
        session.run_conveyor(1, 0.1)
        session.wait_until(lambda: session.presence(1), "part in front of presence sensor 1", timeout=10)
        session.run_conveyor(1, 0.0)
        session.move_tool(world_from_gripper, "gripper")
        session.close_gripper(20.0)

Times are simulated seconds, everything else SI units and radians. A session reads only sensors and encoders of the
cell.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.arguments import Count, Duration, Length, Share, checked_arguments, checked_value
from scancell.arrays import Array
from scancell.cell.driver import (
    TRIGGER_INTERVALS,
    TRIGGER_MODES,
    BeltSpeed,
    Deflections,
    Driver,
    Force,
    GripperMode,
    JogFrame,
    JointAngles,
    Mode,
    MonitorSpeed,
    Operation,
    SensorDeflections,
    TableAngle,
    Tool,
    Width,
    WorldFromTool,
    axis_in_words,
    refusal,
    state_in_words,
)
from scancell.cell.instance import CellInstance, RealGroup, RecordBatches, RecordCollector, snapshot
from scancell.cell.program import Program, TriggerRule
from scancell.cell.readings import CellReadings
from scancell.cell.recording import Recording
from scancell.errors import CommandError, DescriptionError
from scancell.geometry import pose
from scancell.nominal.cell import NominalCell, world_from_frame

_AT_START = 1e-6  # rad
_MOST_STOPPING = 5.0  # s; the slowest axis of any sensible cell brakes faster
_MOST_HELD_US = 1_000_000  # without progress, after which a move that a guard holds fails


class CellSession(CellReadings):
    """A running cell that takes one command after another.

    Each command steps the cell until it is done; those that begin with ``start_`` do not step it. Lengths are in
    metres, angles in radians, times in simulated seconds. Devices are numbered from 1; `CellError` where the cell has
    no such device. `Scanner.session` makes a session that also measures.

    Parameters
    ----------
    cell
        Running instance; it may be at any time, at rest.
    nominal
        Its nominal geometry.
    cycle_us
        The controller's cycle, µs, the grain of a session: commands are taken and answers looked at once a cycle.

    Examples
    --------
    >>> setup = scancell.load_setup()
    >>> nominal = scancell.nominal_cell(setup.cell, None)
    >>> fmu = scancell.make_temporary_fmu(scancell.cell_json(setup.cell, nominal, seed=0), "fmu")
    >>> with scancell.CellInstance(fmu) as cell:
    ...     session = scancell.CellSession(cell, nominal, setup.cell.world.controller_cycle_us)
    ...     session.move_joints(session.home + 0.1, table_angle=0.5, speed=0.5)
    ...     print(f"joint 1 moved by {session.joints[0] - session.home[0]:.2f} rad")
    joint 1 moved by 0.10 rad

    A part comes on the belt:

    >>> cell = scancell.assets_dir() / "cells" / "pick_and_place.toml"
    >>> with scancell.Scanner(cell) as scanner, scanner.session("part.stl") as session:
    ...     session.run_conveyor(1, 0.15)
    ...     session.wait_until(lambda: session.presence(1), "a part at the gate", timeout=10)
    ...     session.run_conveyor(1, 0.0)
    ...     print(f"after {session.time:.1f} s and {session.conveyor_travel(1):.2f} m")
    after 1.9 s and 0.27 m
    """

    @checked_arguments
    def __init__(self, cell: CellInstance, nominal: NominalCell, cycle_us: int) -> None:
        super().__init__(cell, nominal)
        axes = cell.axis_names("command.")
        self._targets = cell.real_group(axes)
        self._tool, self._line = (
            cell.real_group(
                [*(f"command.{what}.position[{i}]" for i in (1, 2, 3)),
                 *(f"command.{what}.orientation[{i}]" for i in (1, 2, 3, 4))]
            )
            for what in ("tool", "target")
        )  # fmt: skip
        self._jog = cell.real_group([f"command.jog[{i}]" for i in range(1, len(axes) + 1)])
        self._cycle_us = cycle_us
        self._snapshots = 0
        self._step_to = cell.step_to

    # Commands that take effect in the next cycles: nothing here steps the cell

    @checked_arguments
    def start_move_joints(self, joints: JointAngles, table_angle: TableAngle | None = None, speed: Share = 1.0) -> None:
        """Start a motion with the arguments of `CellSession.move_joints`."""
        count = len(self.home)
        if np.size(joints) != count:
            raise CommandError(f"move_joints: joints = {joints!r}: expected {count} angles")
        target = self.destination
        target[:count] = joints
        if table_angle is not None:
            target[count] = table_angle
        self._start_move(target, speed)

    @checked_arguments
    def start_move_axis(self, name: str, position: float, speed: Share = 1.0) -> None:
        """Start a motion with the arguments of `CellSession.move_axis`."""
        further = [axis.name for axis in self._nominal.further_axes]
        if name not in further:
            raise DescriptionError(key="name", value=name, expected=", ".join(further) or "an axis: the cell has none")
        target = self.destination
        target[len(self.home) + 1 + further.index(name)] = position
        self._start_move(target, speed)

    def _start_move(self, target: Array, speed: float) -> None:
        self._cell.set(self._targets, target)
        self._start(Mode.JOINT_MOVE, speed)

    def start_move_tool(self, world_from_tool: WorldFromTool, tool: Tool = "sensor", speed: Share = 1.0) -> None:
        """Start a motion with the arguments of `CellSession.move_tool`."""
        self.start_move_joints(self.joints_for(world_from_tool, tool), speed=speed)

    @checked_arguments
    def start_move_line(self, world_from_tool: WorldFromTool, tool: Tool = "sensor", speed: Share = 1.0) -> None:
        """Start a motion with the arguments of `CellSession.move_line`."""
        self.start_line_of(self.flange_from_tool(tool), world_from_tool, speed)

    @checked_arguments
    def start_line_of(
        self, flange_from_point: WorldFromTool, world_from_point: WorldFromTool, speed: Share = 1.0
    ) -> None:
        """Start a straight motion of any frame that is fixed to the flange.

        Parameters
        ----------
        flange_from_point
            Pose (4, 4) of the frame on the flange.
        world_from_point
            Pose (4, 4) of the frame at the end.
        speed
            That of `CellSession.move_line`.
        """
        self._set_pose(self._tool, np.asarray(flange_from_point, float))
        self._set_pose(self._line, np.asarray(world_from_point, float))
        self._cell.set(self._targets, self.destination)
        self._start(Mode.LINE_MOVE, speed)

    @checked_arguments
    def start_servo(self, joints: JointAngles) -> None:
        """Stream set-points: the joints follow `joints` (joints,), rad, one cycle later, within their limits.

        To be repeated in every cycle; table and further axes rest. A guard permits no streamed set-points.
        """
        count = len(self.home)
        if np.size(joints) != count:
            raise CommandError(f"servo: joints = {joints!r}: expected {count} angles")
        target = self.destination
        target[:count] = joints
        self._cell.set(self._targets, target)
        self._cell.set_integer("command.mode", Mode.SERVO)
        self.renew_heartbeat()

    @checked_arguments
    def start_jog_joints(self, deflections: Deflections) -> None:
        """Start to jog axes with the `deflections` of `CellSession.jog_joints`."""
        values = np.asarray(deflections, float)
        if values.size > self._jog.count:
            raise CommandError(f"jog_joints: deflections = {deflections!r}: expected at most {self._jog.count} numbers")
        self._start_jog(Mode.JOINT_JOG, values)

    @checked_arguments
    def start_jog_sensor(
        self, deflections: SensorDeflections, frame: JogFrame | str = JogFrame.WORLD, tool: Tool = "sensor"
    ) -> None:
        """Start to jog a tool with the arguments of `CellSession.jog_sensor`.

        Another tool than that of a running jog brings the axes to rest first.
        """
        if len(self.home) < 6:
            raise CommandError(f"jog_sensor: the arm has {len(self.home)} joints: expected at least 6")
        wanted = np.asarray(deflections, float)
        if not isinstance(frame, JogFrame):
            # By the commanded angle of the table: encoder noise would change the direction of a renewed jog.
            axes = world_from_frame(self._nominal, frame, self.destination)[:3, :3]
            wanted, frame = _in_world(axes, wanted), JogFrame.WORLD
        self._set_pose(self._tool, self.flange_from_tool(tool))
        self._cell.set_integer("command.jog_frame", frame)
        self._start_jog(Mode.CARTESIAN_JOG, wanted)

    def renew_heartbeat(self) -> None:
        """Renew the heartbeat for the controller's watchdog, so that a jog continues."""
        self._cell.set_integer("command.heartbeat", self._next("command.heartbeat"))

    def hold(self) -> None:
        """End a jog or a motion: the axes come to rest."""
        self._cell.set(self._jog, np.zeros(self._jog.count))
        self._cell.set_integer("command.mode", Mode.HOLD)

    @checked_arguments
    def request_operation(self, operation: Operation) -> None:
        """Change to manual or automatic `operation`; all axes come to rest."""
        self.hold()
        self._cell.set_integer("command.operation", operation)

    @checked_arguments
    def set_monitor_speed(self, share: MonitorSpeed) -> None:
        """Scale the speed of moves and programs by `share` (0 to 1) while they run, on their paths; 0 pauses them."""
        self._set_real("command.monitor_speed", share)

    def press_emergency_stop(self) -> None:
        """Press the button; the stop stays in force until `release_emergency_stop` when all axes rest."""
        self._cell.set_boolean("command.emergency_stop", True)

    def release_emergency_stop(self) -> None:
        """Release the button and reset the controller; stopped motions do not continue."""
        self._cell.set_boolean("command.emergency_stop", False)
        self.hold()
        self._cell.set_integer("command.reset", self._next("command.reset"))

    @checked_arguments
    def run_conveyor(self, conveyor: Count, speed: BeltSpeed) -> None:
        """Give conveyor number `conveyor` (from 1) the `speed`, m/s; its belt accelerates while the cell steps.

        Raises
        ------
        CommandError
            If the cell has no such conveyor.
        """
        count = sum(name.startswith("command.conveyor[") for name in self._cell.names)
        if conveyor > count:
            raise CommandError(f"run_conveyor: conveyor = {conveyor}: expected 1 to {count}")
        self._set_real(f"command.conveyor[{conveyor}].speed", speed)

    @checked_arguments
    def start_open_gripper(self, width: Width) -> None:
        """Start to bring the pads `width` apart, m; raises `CommandError` if the cell has no gripper."""
        self.flange_from_tool("gripper")
        self._set_real("command.gripper.width", width)
        self._cell.set_integer("command.gripper.mode", GripperMode.WIDTH)

    @checked_arguments
    def start_close_gripper(self, force: Force) -> None:
        """Start to close the gripper with `force`, N each finger; raises `CommandError` if the cell has no gripper."""
        self.flange_from_tool("gripper")
        self._set_real("command.gripper.force", force)
        self._cell.set_integer("command.gripper.mode", GripperMode.FORCE)

    # Commands that step the cell until they are done

    def move_joints(
        self, joints: ArrayLike, table_angle: float | None = None, *, speed: float = 1.0, timeout: float = 60.0
    ) -> None:
        """Move all joints, and the table, together.

        Parameters
        ----------
        joints
            Angles (joints,), rad.
        table_angle
            Angle of the table (not wrapped), rad; None: it rests.
        speed
            Share (above 0, at most 1) of the full speed of the slowest axis.
        timeout
            Longest duration, s.

        Raises
        ------
        CommandError
            If there are more or fewer angles than joints, the controller refuses or stops the move, a guard holds it
            for 1 s, or it takes longer than `timeout`.
        DescriptionError
            If an argument is out of its range.
        """
        self.start_move_joints(joints, table_angle, speed=speed)
        self._finish_move("move_joints", timeout)

    def turn_table(self, table_angle: float, *, speed: float = 1.0, timeout: float = 60.0) -> None:
        """Turn the table to `table_angle` (not wrapped), rad; `speed`, `timeout` and errors as of `move_joints`."""
        self.start_move_joints(self.destination[: len(self.home)], table_angle, speed=speed)
        self._finish_move("turn_table", timeout)

    def move_axis(self, name: str, position: float, *, speed: float = 1.0, timeout: float = 60.0) -> None:
        """Move an axis beside joints and table, such as a track, while all others rest.

        Parameters
        ----------
        name
            Its name in the description (``[[axis]]``).
        position
            Target, rad or m.
        speed, timeout
            As of `move_joints`, as are the errors.
        """
        self.start_move_axis(name, position, speed=speed)
        self._finish_move("move_axis", timeout)

    def move_tool(
        self, world_from_tool: ArrayLike, tool: Tool = "sensor", *, speed: float = 1.0, timeout: float = 60.0
    ) -> None:
        """Move `tool` to the pose `world_from_tool` (4, 4), all joints together: not on a straight line.

        The table rests. `tool` is that of `flange_from_tool`; `speed`, `timeout` and errors are those of `move_joints`
        and `joints_for`.
        """
        self.start_move_tool(world_from_tool, tool, speed=speed)
        self._finish_move("move_tool", timeout)

    def move_line(
        self, world_from_tool: ArrayLike, tool: Tool = "sensor", *, speed: float = 1.0, timeout: float = 60.0
    ) -> None:
        """Move `tool` straight to the pose `world_from_tool` (4, 4), turning evenly, by the arm's nominal geometry.

        The table rests. `speed` is the share (above 0, at most 1) of the line speed of the robot's description; `tool`
        is that of `flange_from_tool`, `timeout` and errors are those of `move_joints`.
        """
        self.start_move_line(world_from_tool, tool, speed=speed)
        self._finish_move("move_line", timeout)

    @checked_arguments
    def record_line(
        self,
        world_from_sensor: WorldFromTool,
        spacing: Length,
        exposure: Length,
        *,
        speed: Share = 1.0,
        timeout: float = 60.0,
        batches: RecordBatches | None = None,
    ) -> Recording:
        """Move the sensor as in `move_line`, with exposures on the way; the first one begins at the start.

        Parameters
        ----------
        world_from_sensor
            Pose (4, 4) at the end.
        spacing
            Length of the path, in the frame of the table, from one exposure to the next, m.
        exposure
            Duration of each, s.
        speed, timeout
            Speed and longest duration of `move_line`.
        batches
            Receiver of the records, see `run_program`.

        Raises
        ------
        CommandError
            If the motion fails as in `move_line`.
        DescriptionError
            If the pose or the speed is invalid, or `spacing` or `exposure` is not a positive number.
        """
        return self._record(
            lambda: self.move_line(world_from_sensor, speed=speed, timeout=timeout),
            TriggerRule("path_distance", spacing),
            exposure,
            batches,
        )

    @checked_arguments
    def record_table(
        self,
        table_angle: TableAngle,
        spacing: Length,
        exposure: Length,
        *,
        speed: Share = 1.0,
        timeout: float = 60.0,
        batches: RecordBatches | None = None,
    ) -> Recording:
        """Turn the table as in `turn_table`, with exposures on the way; the first one begins at the start.

        Errors are those of `record_line`, and so are `exposure` and `batches`.

        Parameters
        ----------
        table_angle, speed, timeout
            As in `turn_table`.
        spacing
            Turn from one exposure to the next, rad.
        """
        return self._record(
            lambda: self.turn_table(table_angle, speed=speed, timeout=timeout),
            TriggerRule("table_angle", spacing),
            exposure,
            batches,
        )

    def _record(
        self, move: Callable[[], None], rule: TriggerRule, exposure: float, batches: RecordBatches | None
    ) -> Recording:
        """Exposures by a rule during a motion."""
        collector = RecordCollector(self._cell, self._cycle_us, exposure, batches)
        self._set_real(TRIGGER_INTERVALS[rule.kind], rule.interval)
        self._cell.set_integer("command.trigger.mode", TRIGGER_MODES[rule.kind])
        self._step_to = collector.step_to
        try:
            move()
        finally:
            self._step_to = self._cell.step_to
            self._cell.set_integer("command.trigger.mode", TRIGGER_MODES["off"])
        return collector.finish()

    def jog_joints(self, deflections: ArrayLike, duration: float) -> None:
        """Jog joints, table and further axes by hand for `duration`, s, then come to rest; needs manual operation.

        `deflections` of the first axes are -1 to 1 of the speed that the description allows each axis by hand;
        those that are missing are 0.

        Raises
        ------
        CommandError
            If there are more deflections than axes, the controller refuses, or the guard holds the robot in front of a
            body; stopping before a limit is no error.
        DescriptionError
            If an argument is out of its range.
        """
        self.start_jog_joints(deflections)
        self._finish_jog(Mode.JOINT_JOG, "jog_joints", duration)

    def jog_sensor(
        self, deflections: ArrayLike, duration: float, frame: JogFrame | str = JogFrame.WORLD, tool: Tool = "sensor"
    ) -> None:
        """Jog the sensor, or another tool, by hand for a time, then come to rest; needs manual operation.

        Parameters
        ----------
        deflections
            (6,) along x, y, z and about x, y, z, -1 to 1 of the speeds that the description allows.
        duration
            Time until the axes come to rest, s.
        frame
            Whose axes these are: a `JogFrame`, or the name of a frame as in `world_from_frame`.
        tool
            See `flange_from_tool`. Rotations are about its origin.

        Raises
        ------
        CommandError
            If the jog fails as in `jog_joints`, or the arm has fewer than six joints.
        DescriptionError
            If there are not six deflections, one is out of its range, or there is no such frame or tool.
        """
        self.start_jog_sensor(deflections, frame, tool)
        self._finish_jog(Mode.CARTESIAN_JOG, "jog_sensor", duration)

    def run_program(self, program: Program, exposure: float, batches: RecordBatches | None = None) -> Recording:
        """Run a program, which must start at the present joint and table angles.

        The monitor speed in force scales its speed, and may change while it runs (`on_step` of the instance).

        Parameters
        ----------
        program
            Program of a plan (``Plan.program``).
        exposure
            Duration of the exposures, s.
        batches
            Receives the records while they come; None: they are only returned.

        Raises
        ------
        CommandError
            If the controller refuses or stops the program, or the axes are not where it starts.
        CellError
            If the FMU reports an error, or a requested exposure never comes.
        """
        self.check_start(program)
        recording = Driver(self._cell, self._cycle_us, exposure, batches).run(program)
        self._cell.set_integer("command.mode", Mode.HOLD)
        return recording

    def check_start(self, program: Program) -> None:
        """Raise `CommandError` if the controller would reject `program` at the present joint and table angles."""
        self._cell.set_integer("command.mode", Mode.PROGRAM)
        self.wait(0.0)
        self._refuse("run_program")
        away = np.abs(self.commanded - (*program.start, *program.further))
        number = int(away.argmax())
        if away[number] > _AT_START:
            further = number - len(self.home) - 1
            slides = further >= 0 and self._nominal.further_axes[further].joint.kind == "prismatic"
            off = f"{1e3 * away[number]:.3f} mm" if slides else f"{np.degrees(away[number]):.3f} deg"
            raise CommandError(f"the program starts elsewhere: {axis_in_words(self._cell, number + 1)} is off by {off}")

    @checked_arguments
    def snapshot(self, exposure: Length) -> Recording:
        """The present poses as a recording of one exposure of `exposure` seconds, whose middle is now.

        It costs no simulated time and takes no trigger record; the cell may be moving.

        Raises
        ------
        DescriptionError
            If `exposure` is not a positive number.
        """
        self._snapshots += 1
        return snapshot(self._cell, exposure, self._snapshots)

    def set_operation(self, operation: Operation) -> None:
        """Change to manual or automatic `operation`, and wait until all axes rest."""
        self.request_operation(operation)
        self._wait_for_rest("set_operation")

    def come_to_rest(self) -> NDArray[np.float64]:
        """Stop the robot and wait until it rests; commanded positions (axes,), rad or m."""
        self.hold()
        self._wait_for_rest("come_to_rest")
        return self.commanded

    def emergency_stop(self) -> None:
        """Press the button and wait until all axes rest; the stop stays in force until `reset`."""
        self.press_emergency_stop()
        self._wait_for_rest("emergency_stop")

    def reset(self) -> None:
        """Release the emergency stop; stopped motions do not continue.

        Raises
        ------
        CommandError
            If the controller stays in the emergency stop.
        """
        self.release_emergency_stop()
        self.wait(0.0)
        self._refuse("reset")

    def open_gripper(self, width: float, *, timeout: float = 5.0) -> None:
        """Bring the pads of the gripper `width` apart, m.

        Raises
        ------
        CommandError
            If they do not get there within `timeout`, s (the stroke is too short, or something is in between).
        """
        self.start_open_gripper(width)
        self.wait_until(lambda: abs(self.gripper_width - width) < 1e-4, f"pads {width * 1e3:.1f} mm apart", timeout)

    def close_gripper(self, force: float, *, timeout: float = 5.0) -> None:
        """Close the gripper with `force` (N, each finger) until it holds something.

        Raises
        ------
        CommandError
            If they hold nothing within `timeout`, s.
        """
        self.start_close_gripper(force)
        self.wait_until(
            lambda: self._cell.get_boolean("measured.gripper.gripped"), "something between the pads", timeout
        )

    # Time

    @property
    def cycle(self) -> float:
        """The controller's cycle, s."""
        return self._cycle_us * 1e-6

    def step(self) -> None:
        """Step to the end of the next controller cycle that begins now or later: a program may end inside one."""
        started = -(-self._cell.time_us // self._cycle_us)
        self._step_to((started + 1) * self._cycle_us)

    @checked_arguments
    def wait(self, duration: Duration) -> None:
        """Step on for `duration`, s, at least one cycle; `DescriptionError` if it is negative or not finite."""
        for _ in range(max(1, round(duration * 1e6 / self._cycle_us))):
            self.step()

    def wait_until(self, condition: Callable[[], bool], what: str, timeout: float = 60.0) -> None:
        """Step on until `condition`, evaluated in every controller cycle, holds; `what` names it in messages.

        Raises
        ------
        CommandError
            If it does not hold within `timeout`, s.
        """
        end = self._end(timeout)
        while not condition():
            if self._cell.time_us >= end:
                raise CommandError(f"timed out after {timeout:g} s waiting for {what}; {state_in_words(self._cell)}")
            self.step()

    # Implementation

    def _end(self, timeout: float) -> int:
        checked: float = checked_value("timeout", timeout, Duration)
        return self._cell.time_us + round(checked * 1e6)

    def _refuse(self, command: str) -> None:
        reason = refusal(self._cell)
        if reason is not None:
            guard_text = self._guard_text()
            raise CommandError(f"{command}: {guard_text}; {reason}" if guard_text else f"{command}: {reason}")

    def _guard_text(self) -> str:
        """Reason why the guard stops or slows the robot; empty if it does neither, or without a guard."""
        return self._cell.get_string("command.pendant.text")

    def _wait_for_rest(self, command: str) -> None:
        self.wait(0.0)
        still = f"rest after {command}"
        self.wait_until(lambda: not self._cell.get_boolean("controller.moving"), still, _MOST_STOPPING)

    def _finish_move(self, command: str, timeout: float) -> None:
        end, progress, progressed_us = self._end(timeout), -1.0, self._cell.time_us
        is_guarded = self.value("command.guard.max_age") > 0
        while True:
            self.step()
            self._refuse(command)
            if self._cell.get_boolean("controller.at_destination"):
                return
            if (now := self.value("controller.progress")) != progress:
                progress, progressed_us = now, self._cell.time_us
            elif is_guarded and self._guard_text() and self._cell.time_us - progressed_us >= _MOST_HELD_US:
                raise CommandError(f"{command}: held by the guard {now:.0%} of the way: {self._guard_text()}")
            if self._cell.time_us >= end:
                monitor = self.value("command.monitor_speed")
                raise CommandError(
                    f"{command}: not at its destination after {timeout:g} s ({now:.0%} of the way done, monitor speed "
                    f"{monitor:g}); {state_in_words(self._cell)}"
                )

    def _finish_jog(self, mode: Mode, command: str, duration: float) -> None:
        end = self._end(duration)
        try:
            while self._cell.time_us < end:
                self.renew_heartbeat()
                self.step()
                if refusal(self._cell) is not None and self._cell.get_integer("controller.mode") != mode:
                    self._refuse(command)
            is_held = self.value("command.guard.max_age") > 0 and self.value("command.monitor_speed") == 0
            guard_text = self._guard_text()
        finally:
            self.hold()
        self._wait_for_rest(command)
        if is_held:
            raise CommandError(f"{command}: held by the guard: {guard_text}")

    def _set_pose(self, variables: RealGroup, target_from_source: Array) -> None:
        quaternion = pose.quaternion_from_rotation(target_from_source[:3, :3])
        self._cell.set(variables, np.append(target_from_source[:3, 3], quaternion))

    def _set_real(self, variable: str, value: float) -> None:
        self._cell.set(self._cell.real_group([variable]), np.array([value]))

    def _start_jog(self, mode: Mode, deflections: Array) -> None:
        self._cell.set(self._jog, np.append(deflections, np.zeros(self._jog.count - deflections.size)))
        self._cell.set_integer("command.mode", mode)

    def _start(self, mode: Mode, speed: float) -> None:
        self._set_real("command.speed", speed)
        self._cell.set_integer("command.mode", mode)
        self._cell.set_integer("command.start", self._next("command.start"))

    def _next(self, counter: str) -> int:
        return self._cell.get_integer(counter) + 1


def _in_world(world_from_axes: Array, deflections: Array) -> Array:
    """Deflections (6,) along the axes of a rotation (3, 3) as those of the world; those of a vector have norms up to 1.

    The controller limits the norms in the same way.
    """
    vectors = deflections.reshape(2, 3) @ world_from_axes.T
    return np.asarray((vectors / np.maximum(1.0, np.linalg.norm(vectors, axis=1, keepdims=True))).ravel())
