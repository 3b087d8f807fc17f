"""Example sequence for the sequencer FMU: pick the part from the belt, scan it on the table, jog the arm."""

from __future__ import annotations

import math
from collections.abc import Mapping
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from scancell.cell.controller import GripperMode, Mode, Operation
from scancell.cell.driver import TRIGGER_MODES
from scancell.config.cell import CellDescription
from scancell.config.description import PoseDescription
from scancell.config.devices import ConveyorDescription
from scancell.config.exposure_times import exposure_span
from scancell.config.gripper import GripperDescription
from scancell.config.loading import Setup
from scancell.config.sensing import PresenceSensorDescription
from scancell.errors import CommandError, DescriptionError
from scancell.geometry import pose
from scancell.nominal.cell import NominalCell
from scancell.nominal.poses import pose_matrix
from scancell.nominal.tools import flange_from_tool

Array = NDArray[np.float64]
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
_DEFLECTION = 0.5
_JOG = 0.4  # s


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
        world_from_sensor = world_from_flange @ self.nominal.flange_from_sensor
        quaternion = pose.quaternion_from_rotation(world_from_sensor[:3, :3])
        targets = _numbered("target.position", world_from_sensor[:3, 3])
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
    """Turn the table under the sensor, whose laser line crosses the axis of the table, the part within its range."""
    nominal = sequence.nominal
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
