"""Runs programs on the FMU's controller and collects a record for every exposure."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from enum import IntEnum
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from scancell.arguments import Rigid, Shape, Within
from scancell.arrays import Array
from scancell.cell.instance import PATIENCE_US, CellInstance, RecordBatches, RecordCollector
from scancell.cell.program import BeltRun, Program, Segment, TriggerKind, temporary_program_file
from scancell.cell.recording import Recording
from scancell.config.cell import CellDescription
from scancell.config.description import PoseDescription
from scancell.config.devices import ConveyorDescription, GripperDescription, PresenceSensorDescription
from scancell.config.loading import Setup
from scancell.config.sensor import exposure_span
from scancell.errors import CellError, CommandError, DescriptionError
from scancell.geometry import pose
from scancell.nominal.cell import NominalCell, flange_from_tool
from scancell.nominal.parts import pose_matrix

# Arguments of commands, SI units and radians.
Tool = str  # whose pose is commanded: sensor, gripper, or a tool of the description
JointAngles = Annotated[ArrayLike, Shape((None,))]
TableAngle = Annotated[float, Within(-1e4, 1e4)]
WorldFromTool = Annotated[ArrayLike, Rigid()]
Deflections = Annotated[ArrayLike, Shape((None,), within=Within(-1.0, 1.0))]
SensorDeflections = Annotated[ArrayLike, Shape((6,), within=Within(-1.0, 1.0))]
MonitorSpeed = Annotated[float, Within(0.0, 1.0)]
Width = Annotated[float, Within(0.0, 1e4)]
Force = Annotated[float, Within(0.0, 1e4)]
BeltSpeed = Annotated[float, Within(-10.0, 10.0)]

TRIGGER_MODES: dict[TriggerKind, int] = {
    "off": 0,
    "time": 1,
    "table_angle": 2,
    "path_distance": 3,
    "request": 4,
    "belt_travel": 5,
}
TRIGGER_INTERVALS: dict[TriggerKind, str] = {
    "time": "command.trigger.period",
    "table_angle": "command.trigger.angle",
    "path_distance": "command.trigger.distance",
}

# While a requested exposure is awaited: several steps in a controller cycle.
_REQUEST_STEPS = 4

SequenceStep = Mapping[str, float | int]

_BELT_SPEED = 0.15  # m/s
_BELT_REACTION = 0.032  # s from the detection of the part to the braking of the belt
_OPENING = 0.005  # m, of the gripper on both sides of the part
_GRIP_HEIGHT = 0.004  # m, of the finger tips above the support of the part
_LIFT = 0.08  # m
_DROP = 0.0002  # m above the table, where the part is released
_GRIP_FORCE = 30.0  # N
_TABLE_SPEED = math.radians(45.0)  # rad/s
_INTERVAL = math.radians(2.0)  # rad of the table between exposures
_HELD_TURN = math.radians(90.0)  # of the last joint
_PERIOD = 0.02  # s between exposures
_DEFLECTION = 0.5
_JOG = 0.4  # s


class Mode(IntEnum):
    """Numbers of ``command.mode`` and ``controller.mode``: what moves the robot.

    Attributes
    ----------
    HOLD
        Nothing: the axes brake and rest.
    SERVO
        Streamed set-points of the axes.
    JOINT_MOVE
        All axes together from start to end.
    LINE_MOVE
        A tool straight to a pose.
    JOINT_JOG
        Axes by hand.
    CARTESIAN_JOG
        A tool by hand, along and about the axes of a `JogFrame`.
    PROGRAM
        A segment of a program.

    Examples
    --------
    >>> with scancell.Scanner() as scanner, scanner.session("part.stl") as session:
    ...     session.move_joints(session.home)
    ...     scancell.Mode(session.cell.get_integer("controller.mode"))
    <Mode.JOINT_MOVE: 2>
    """

    HOLD = 0
    SERVO = 1
    JOINT_MOVE = 2
    LINE_MOVE = 3
    JOINT_JOG = 4
    CARTESIAN_JOG = 5
    PROGRAM = 6


class Operation(IntEnum):
    """Numbers of ``command.operation``: what may move the robot.

    Attributes
    ----------
    MANUAL
        Jogs alone.
    AUTOMATIC
        Moves and programs alone; so a cell begins.

    Examples
    --------
    >>> with scancell.Scanner() as scanner, scanner.session("part.stl") as session:
    ...     session.set_operation(scancell.Operation.MANUAL)
    ...     session.move_joints(session.home)
    Traceback (most recent call last):
        ...
    scancell.errors.CommandError: move_joints: the cell is in manual operation, ...
    """

    MANUAL = 0
    AUTOMATIC = 1


class JogFrame(IntEnum):
    """Numbers of ``command.jog_frame``: the frame whose axes a Cartesian jog follows.

    Attributes
    ----------
    WORLD
        The axes of the world.
    SENSOR
        The axes of the jogged tool, by default the sensor; its z is the direction of the laser.

    Examples
    --------
    At home the sensor looks down:

    >>> with scancell.Scanner() as scanner, scanner.session("part.stl") as session:
    ...     session.set_operation(scancell.Operation.MANUAL)
    ...     start = session.world_from_tool()[2, 3]
    ...     session.jog_sensor([0, 0, 0.5, 0, 0, 0], duration=0.2, frame=scancell.JogFrame.SENSOR)
    ...     bool(session.world_from_tool()[2, 3] < start)
    True
    """

    WORLD = 0
    SENSOR = 1


class GripperMode(IntEnum):
    """Numbers of ``command.gripper.mode``: keep the last command, open to a width, close with a force."""

    KEEP = 0
    WIDTH = 1
    FORCE = 2


GUARD_TOO_OLD = "the last message of the guard is too old: reset the controller when it sends again"

_REFUSALS = {
    1: "the cell is in manual operation, which runs no programs: change to automatic operation first",
    2: "the cell is in automatic operation, which has no jogging: change to manual operation first",
    3: "an emergency stop is in force: release the stop button and reset the controller first",
    4: "no heartbeat came within command.max_age",
    5: "the target of {axis} is outside its limits",
    6: "the way leads {axis} beyond its limits",
    7: "the target is out of reach, or the way leads through a singular position",
    8: "the program cannot be read, or has no such segment",
    9: "{axis} is not where the segment starts",
    10: "the segment moves {axis} faster than its limits of speed and acceleration allow",
    11: GUARD_TOO_OLD,
    15: "a guard is in force, which permits no streamed set-points: it does not know where they lead",
}


def refusal(cell: CellInstance) -> str | None:
    """Reason why the controller rejects its command; None if it does not."""
    reason = cell.get_integer("controller.error")
    if reason == 0:
        return None
    number = cell.get_integer("controller.limit")
    return _REFUSALS[reason].format(axis=axis_in_words(cell, number) if number else "an axis")


def axis_in_words(cell: CellInstance, number: int) -> str:
    """Name of an axis, counted from 1, in a message."""
    name = cell.axis_names("")[number - 1]
    if name == "table":
        return "the table"
    return f"the axis {name.removeprefix('axis.')}" if name.startswith("axis.") else f"joint {number}"


def state_in_words(cell: CellInstance) -> str:
    """State and mode of the controller, for messages."""
    state = ("at rest", "moving", "braking", "in an emergency stop")[cell.get_integer("controller.state")]
    mode = Mode(cell.get_integer("controller.mode")).name.lower().replace("_", " ")
    return f"the controller is {state} (mode {mode})"


class Driver:
    """Runs programs on one cell instance with its controller cycle (µs) and the duration of exposures (s).

    `batches` receives the records as they arrive.

    The controller executes each segment as a whole, at the monitor speed in force. A communication step lasts at most
    one controller cycle.
    """

    def __init__(
        self, cell: CellInstance, cycle_us: int, exposure: float, batches: RecordBatches | None = None
    ) -> None:
        self._cell = cell
        self._cycle_us = cycle_us
        self._clock = cell.real_group(["controller.clock"])
        self._gate = ["command.trigger.from", "command.trigger.to"]
        self._requests, self._starts = cell.get_integers(["command.trigger.request", "command.start"])
        self._records = RecordCollector(cell, cycle_us, exposure, batches)
        cell.set_integer("command.mode", Mode.PROGRAM)

    def run(self, program: Program, progress: Callable[[float], None] | None = None) -> Recording:
        """Drive `program` from start to end; `progress` gets the seconds of each segment.

        Raises
        ------
        CommandError
            If the controller does not start or finish a segment.
        CellError
            If the FMU reports an error, or a requested exposure is not taken.
        """
        try:
            with temporary_program_file(program, self._cell.folder) as file:
                self._cell.set_string("command.program", str(file))
                for segment in program.segments:
                    self._drive(segment)
                    if segment.trigger.kind == "request":
                        self._expose_at_rest(segment, program.settle)
                    elif segment.belt is not None:
                        self._run_belt(segment, segment.belt)
                    if progress:
                        progress(float(segment.times[-1]))
        except BaseException:
            self._records.pass_on()
            raise
        finally:
            self._disarm_trigger()
        return self._records.finish()

    def _drive(self, segment: Segment) -> None:
        """Run one segment to its end; how long it takes depends on the monitor speed."""
        self._arm_trigger(segment)
        self._starts += 1
        self._cell.set_integer("command.segment", segment.id)
        self._cell.set_integer("command.start", self._starts)
        clock, remaining, patience = 0.0, float(segment.times[-1]), self._cell.time_us + PATIENCE_US
        while remaining > 0.0:
            earliest = self._cell.time_us + round(remaining * 1e6)  # at full speed
            while self._cell.time_us < min(earliest, patience):
                self._cycle()
            reason = refusal(self._cell)
            if reason is not None:
                raise CommandError(f"segment {segment.id}: {reason}")
            now = float(self._cell.get(self._clock)[0])
            if now > clock:
                clock, patience = now, self._cell.time_us + PATIENCE_US
            elif self._cell.time_us >= patience:
                raise CommandError(
                    f"segment {segment.id}: no motion for {PATIENCE_US / 1e6:g} s, {clock:.3f} s after its start at "
                    "full speed: the monitor speed is 0, or the arm is held"
                )
            remaining = (
                0.0
                if self._cell.get_boolean("controller.at_destination")
                else max(float(segment.times[-1]) - clock, 1e-6)
            )

    def _arm_trigger(self, segment: Segment) -> None:
        kind = segment.trigger.kind
        if kind not in TRIGGER_INTERVALS:
            return self._disarm_trigger()
        inputs = self._cell.real_group([TRIGGER_INTERVALS[kind], *self._gate])
        self._cell.set(inputs, np.array([segment.trigger.interval, segment.trigger_from, segment.trigger_to]))
        self._cell.set_integer("command.trigger.mode", TRIGGER_MODES[kind])
        return None

    def _disarm_trigger(self) -> None:
        self._cell.set_integer("command.trigger.mode", TRIGGER_MODES["off"])

    def _expose_at_rest(self, segment: Segment, settle: float) -> None:
        end = self._cell.time_us + max(self._cycle_us, round(settle * 1e6))
        while self._cell.time_us < end:
            self._cycle(end)
        self._cell.set_integer("command.trigger.mode", TRIGGER_MODES["request"])
        self._requests += 1
        self._cell.set_integer("command.trigger.request", self._requests)
        before, limit = len(self._records), self._cell.time_us + PATIENCE_US
        while len(self._records) == before:
            if self._cell.time_us > limit:
                raise CellError(
                    f"segment {segment.id}: timed out after {PATIENCE_US / 1e6:g} s waiting for the exposure;"
                    " expected a shorter as_built.trigger.latency_ms"
                )
            self._records.step_to(self._cell.time_us + self._cycle_us // _REQUEST_STEPS)

    def _run_belt(self, segment: Segment, belt: BeltRun) -> None:
        """Run the belt past its range of exposures, and stop it; the arm holds the end of the segment."""
        conveyor, cell = f"conveyor[{belt.conveyor}]", self._cell
        speed = cell.real_group([f"command.{conveyor}.speed"])
        state = cell.real_group([f"measured.{conveyor}.travel", f"measured.{conveyor}.speed"])
        direction = np.copysign(1.0, belt.speed)
        passed = direction * (float(cell.get(state)[0]) - belt.trigger_from)
        if passed > 0.0:
            raise CommandError(
                f"segment {segment.id}: {conveyor} has travelled {1e3 * passed:.1f} mm beyond the first exposure: "
                "the part has passed the sensor, or is about to"
            )
        cell.set(cell.real_group(["command.trigger.travel"]), np.array([direction * segment.trigger.interval]))
        cell.set_integer("command.trigger.conveyor", belt.conveyor)

        def run_while(condition: Callable[[float, float], bool]) -> None:
            """Step while `condition` holds for travel along the motion (m) and speed (m/s)."""
            farthest, patience = -np.inf, cell.time_us + PATIENCE_US
            while condition(*(now := direction * cell.get(state))):
                if now[0] > farthest:
                    farthest, patience = now[0], cell.time_us + PATIENCE_US
                elif cell.time_us >= patience:
                    raise CommandError(f"segment {segment.id}: {conveyor} has not moved for {PATIENCE_US / 1e6:g} s")
                self._cycle()

        try:
            cell.set(speed, np.array([belt.speed]))
            run_while(lambda travel, _: travel < direction * belt.trigger_from)
            cell.set_integer("command.trigger.mode", TRIGGER_MODES["belt_travel"])
            run_while(lambda travel, _: travel < direction * belt.trigger_to)
        finally:
            self._disarm_trigger()
            cell.set(speed, np.array([0.0]))
        run_while(lambda _, now: now > 0.0)

    def _cycle(self, end: int | None = None) -> None:
        """Step to the end of a controller cycle, or to `end` where that is earlier."""
        cycle_ends = (self._cell.time_us // self._cycle_us + 1) * self._cycle_us
        self._records.step_to(cycle_ends if end is None else min(cycle_ends, end))


class Until(IntEnum):
    """Numbers of ``step[k].until`` of the sequencer: what ends a step after its duration."""

    TIME = 0
    MOTION = 1
    PRESENCE = 2
    GRIPPED = 3


class _Sequence:
    """Steps, each with the inputs of the one before except those that it changes."""

    def __init__(self, nominal: NominalCell) -> None:
        self.nominal = nominal
        self.steps: list[SequenceStep] = []
        self.joints = nominal.home
        self._inputs: dict[str, float | int] = {"start": 0, "table": 0.0, "operation": int(Operation.AUTOMATIC)}

    def set(self, changes: SequenceStep) -> None:
        """Inputs from the next step on."""
        self._inputs |= changes

    def add(self, changes: SequenceStep, until: Until = Until.TIME, duration: float = 0.0) -> None:
        self.set(changes)
        self.steps.append({"duration": duration, "until": int(until), **self._inputs})

    def move(self, mode: Mode, targets: SequenceStep, speed: float) -> None:
        """A motion to its end."""
        start = self._inputs["start"] + 1
        self.add({"mode": int(mode), "start": start, "speed": speed, **targets}, Until.MOTION)

    def move_joints(self, joints: Array, table: float = 0.0, speed: float = 0.5) -> None:
        self.joints = joints
        self.move(Mode.JOINT_MOVE, {**_numbered("q", joints), "table": table}, speed)

    def move_line(self, world_from_flange: Array, speed: float = 0.1) -> None:
        self.joints = self.joints_for(world_from_flange)
        world_from_tool = world_from_flange @ flange_from_tool(self.nominal)
        quaternion = pose.quaternion_from_rotation(world_from_tool[:3, :3])
        targets = _numbered("target.position", world_from_tool[:3, 3])
        self.move(Mode.LINE_MOVE, targets | _numbered("target.orientation", quaternion), speed)

    def joints_for(self, *world_from_flange: Array) -> Array:
        """Joint angles (joints,) at one of several poses, nearest to those of the last move.

        Raises `CommandError` if the arm reaches none of the poses.
        """
        branches = np.concatenate([self.nominal.arm.ik(target, self.joints)[0] for target in world_from_flange])
        found = branches[np.isfinite(branches).all(-1)]
        if not len(found):
            position = ", ".join(f"{x * 1e3:.1f}" for x in world_from_flange[0][:3, 3])
            raise CommandError(f"the flange cannot be brought to ({position}) mm to pick, place or scan the part")
        return np.asarray(found[np.argmin(np.abs(found - self.joints).max(-1))])


def _numbered(name: str, values: Array) -> dict[str, float | int]:
    return {f"{name}[{i}]": float(value) for i, value in enumerate(values, 1)}


def example_sequence(setup: Setup, nominal: NominalCell) -> list[SequenceStep]:
    """Steps of the example: pick, scan, jog.

    Where the cell has a gripper, and the part comes on conveyor 1 with presence sensor 1 at it, the belt runs until
    the sensor detects the part, which is picked and placed on the table. Then the table turns once under the sensor,
    with exposures at the stand-off of the scan description. At last the arm is jogged in manual operation.

    Returns
    -------
    list of dict
        For each step ``duration`` (s), ``until`` (`Until`), and values of inputs of the cell (SI), by their names
        without ``command.``.

    Raises
    ------
    CommandError
        If the arm does not reach the part on the belt or on the table, or the pose of the scan.
    DescriptionError
        If the part does not fit between the fingers.
    """
    sequence, cell = _Sequence(nominal), setup.cell
    arrival, gripper = cell.part.arrival, cell.gripper
    if arrival is not None and arrival.conveyor == 1 and gripper is not None and cell.presence_sensor:
        _pick_and_place(sequence, cell, arrival.pose, gripper)
    if nominal.holds_part != nominal.carries_sensor:
        _scan(sequence, setup)
    _jog(sequence)
    return sequence.steps


def _pick_and_place(
    sequence: _Sequence, cell: CellDescription, arrival: PoseDescription, gripper: GripperDescription
) -> None:
    nominal, belt = sequence.nominal, cell.conveyor[0]
    belt_from_part = pose_matrix(arrival)
    on_belt = pose.transform_points(belt_from_part, nominal.part.vertices)
    width = float(np.ptp(on_belt[:, 0])) + 2 * _OPENING
    if width > gripper.stroke_mm * 1e-3:
        raise DescriptionError(
            key="gripper.stroke_mm", value=gripper.stroke_mm, expected=f"at least {width * 1e3:.1f}, to grip the part"
        )
    world_from_belt = pose_matrix(belt.pose)
    travel = pose.translation((_travel(belt, cell.presence_sensor[0], float(on_belt[:, 0].max())), 0.0, 0.0))
    world_from_part = world_from_belt @ travel @ belt_from_part
    middle = np.append(on_belt[:, :2].min(0) + on_belt[:, :2].max(0), 2 * on_belt[:, 2].min()) / 2

    closing = world_from_belt[:3, 0]
    down = np.stack([closing, np.cross([0.0, 0.0, -1.0], closing), [0.0, 0.0, -1.0]], 1)
    reach = np.array([0.0, 0.0, _GRIP_HEIGHT + gripper.finger_length_mm * 1e-3])
    grip = pose.from_rotation(down, (world_from_belt @ travel @ np.append(middle, 1.0))[:3] + reach)
    part_from_flange = pose.inverse(world_from_part) @ grip @ pose.inverse(flange_from_tool(nominal, "gripper"))
    world_from_drop = pose.translation((0.0, 0.0, _DROP)) @ nominal.world_from("part")

    opened = {"gripper.mode": int(GripperMode.WIDTH), "gripper.width": width}
    sequence.add({**opened, "conveyor[1].speed": _BELT_SPEED}, Until.PRESENCE)
    sequence.add({"conveyor[1].speed": 0.0}, duration=_BELT_SPEED / (belt.max_acceleration_mm_s2 * 1e-3) + 0.1)
    _above(sequence, world_from_part @ part_from_flange)
    closed = {"gripper.mode": int(GripperMode.FORCE), "gripper.force": _GRIP_FORCE}
    sequence.add(closed, Until.GRIPPED)
    sequence.move_line(_lifted(world_from_part @ part_from_flange))
    _above(sequence, world_from_drop @ part_from_flange)
    sequence.add(opened, duration=0.5)
    sequence.move_line(_lifted(world_from_drop @ part_from_flange))


def _travel(belt: ConveyorDescription, sensor: PresenceSensorDescription, front: float) -> float:
    """Travel of the belt (m) until it rests after the sensor detected a part whose front was at `front` on the belt."""
    belt_from_sensor = pose.inverse(pose_matrix(belt.pose)) @ pose_matrix(sensor.pose)
    size = np.array([sensor.x_size_mm, sensor.y_size_mm, sensor.z_size_mm]) * 1e-3
    edge = belt_from_sensor[0, 3] - np.abs(belt_from_sensor[0, :3]) @ size / 2
    braking = _BELT_SPEED**2 / (2 * belt.max_acceleration_mm_s2 * 1e-3)
    return float(edge - front + _BELT_SPEED * _BELT_REACTION + braking)


def _above(sequence: _Sequence, world_from_flange: Array) -> None:
    """Move above a pose and straight down to it."""
    sequence.move_joints(sequence.joints_for(_lifted(world_from_flange)))
    sequence.move_line(world_from_flange, speed=0.05)


def _lifted(world_from_flange: Array) -> Array:
    return np.asarray(pose.translation((0.0, 0.0, _LIFT)) @ world_from_flange)


def _scan(sequence: _Sequence, setup: Setup) -> None:
    """Turn the table under the sensor, whose laser line crosses the axis of the table, the part within its range.

    A part on the flange is turned by the last joint instead, in front of the sensor on its post.
    """
    nominal = sequence.nominal
    if nominal.holds_part:
        _turn_held_part(sequence, setup)
        return
    top = pose.transform_points(nominal.world_from("part"), nominal.part.vertices)[:, 2].max()
    standoff = 1e-3 * setup.sensor.range.standoff_mm(setup.scan.sweep.standoff_mm)
    above = np.append(nominal.world_from_table[:2, 3], top + standoff)
    down = pose.rotation_about(0, math.pi)
    flange = pose.inverse(nominal.flange_from_sensor)
    turns = [pose.rotation_about(2, angle) @ down for angle in np.linspace(0.0, 2 * math.pi, 12, endpoint=False)]
    sequence.move_joints(nominal.home)
    sequence.move_joints(sequence.joints_for(*(pose.from_rotation(turn, above) @ flange for turn in turns)))
    full = math.radians(setup.cell.table.max_speed_deg_s)
    speed = min(_TABLE_SPEED, nominal.table_max_speed, full) / full
    interval = {"trigger.mode": TRIGGER_MODES["table_angle"], "trigger.angle": _INTERVAL}
    sequence.set({**interval, "exposure": exposure_span(setup.sensor), "segment": 1})
    sequence.move_joints(sequence.joints, 2 * math.pi, speed)
    sequence.set({"trigger.mode": TRIGGER_MODES["off"]})
    sequence.move_joints(nominal.home, 2 * math.pi)


def _turn_held_part(sequence: _Sequence, setup: Setup) -> None:
    nominal = sequence.nominal
    top = float(pose.transform_points(nominal.table_from_part, nominal.part.vertices)[:, 2].max())
    standoff = 1e-3 * setup.sensor.range.standoff_mm(setup.scan.sweep.standoff_mm)
    down = pose.from_rotation(pose.rotation_about(0, math.pi), (0.0, 0.0, top + standoff))
    turns = pose.from_rotation(pose.rotation_about(2, np.linspace(0.0, 2 * math.pi, 12, endpoint=False)))
    sequence.move_joints(nominal.home)
    sequence.move_joints(sequence.joints_for(*nominal.world_from_flange(turns @ down, frame=nominal.support)))
    end, last = sequence.joints.copy(), nominal.arm.joints[-1]
    end[-1] += _HELD_TURN if end[-1] + _HELD_TURN < last.max else -_HELD_TURN
    interval = {"trigger.mode": TRIGGER_MODES["time"], "trigger.period": _PERIOD}
    sequence.set({**interval, "exposure": exposure_span(setup.sensor), "segment": 1})
    sequence.move_joints(end, speed=0.2)
    sequence.set({"trigger.mode": TRIGGER_MODES["off"]})
    sequence.move_joints(nominal.home)


def _jog(sequence: _Sequence) -> None:
    """Joint 1 there and the sensor up, each to rest before the mode changes."""
    rest = {"mode": int(Mode.HOLD), "jog[1]": 0.0, "jog[3]": 0.0}
    jogs = [(Mode.JOINT_JOG, "jog[1]")]
    if len(sequence.nominal.home) >= 6:
        jogs.append((Mode.CARTESIAN_JOG, "jog[3]"))
    for mode, axis in jogs:
        sequence.add({"mode": int(mode), "operation": int(Operation.MANUAL), axis: _DEFLECTION}, duration=_JOG)
        sequence.add(rest, duration=_JOG)
    sequence.add({"operation": int(Operation.AUTOMATIC)})
