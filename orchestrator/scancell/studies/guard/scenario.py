"""Motions that an operator or a program commands, each from where the robot has come to rest."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np

from scancell.arrays import Array
from scancell.cell.driver import GripperMode, JogFrame, Mode, Operation
from scancell.cell.instance import CellInstance
from scancell.cell.program import Program, Segment, program_data
from scancell.geometry import pose
from scancell.nominal.cell import NominalCell, world_from_tool


class Kind(StrEnum):
    """Kinds of motions."""

    JOINT_MOVE = "joint move"
    LINE_MOVE = "line move"
    PROGRAM = "program"
    SHORT_PROGRAM = "short program"  # of two or three set-points
    SERVO = "servo"
    TABLE_MOVE = "table move"
    JOINT_JOG = "joint jog"
    BASE_JOG = "base jog"
    TOOL_JOG = "tool jog"
    TABLE_JOG = "table jog"
    AXIS_MOVE = "axis move"  # of one axis beyond the table
    AXIS_JOG = "axis jog"


FURTHER = (Kind.AXIS_MOVE, Kind.AXIS_JOG)
JOGGED = (Kind.JOINT_JOG, Kind.BASE_JOG, Kind.TOOL_JOG, Kind.TABLE_JOG, Kind.AXIS_JOG)
MOVED = tuple(kind for kind in Kind if kind not in JOGGED)
_MODES = {
    **dict.fromkeys((Kind.JOINT_MOVE, Kind.TABLE_MOVE, Kind.AXIS_MOVE), Mode.JOINT_MOVE),
    **dict.fromkeys((Kind.PROGRAM, Kind.SHORT_PROGRAM), Mode.PROGRAM),
    **dict.fromkeys((Kind.JOINT_JOG, Kind.TABLE_JOG, Kind.AXIS_JOG), Mode.JOINT_JOG),
    **dict.fromkeys((Kind.BASE_JOG, Kind.TOOL_JOG), Mode.CARTESIAN_JOG),
    Kind.LINE_MOVE: Mode.LINE_MOVE,
    Kind.SERVO: Mode.SERVO,
}  # fmt: skip


class Event(StrEnum):
    """Event between two motions."""

    RESET = "reset"  # of the controller
    OPERATION = "operation"  # to the other one, and back with the next motion
    SESSION = "session"  # a new one with the guard
    RESTART = "restart"  # of the guard, and a new session
    GRIPPER = "gripper"  # another width of the fingers
    GRIP = "grip"  # closes with a force, and waits
    RELEASE = "release"  # opens, and waits


@dataclass(frozen=True)
class Motion:
    """A motion from where the robot is.

    Attributes
    ----------
    kind
        What moves it.
    by
        Travel (axes,), rad or m, by which a move, a program or servo mode moves the axes (of a line move: by which it
        would if it were none); axes beyond the table end at their limits. Deflections (axes,), -1 to 1, of a jog.
    speed
        Share of the full speed.
    duration
        Time for which a jog is held, or that a program or servo mode takes, s.
    pause
        Time before it, s.
    event
        What happens before it; None: nothing.
    width
        Width of the fingers from the event on, m.
    length
        Largest travel (rad or m) of an axis.
    """

    kind: Kind
    by: Array
    speed: float
    duration: float = 0.0
    pause: float = 0.0
    event: Event | None = None
    width: float = 0.0
    length: float = 0.0

    @property
    def operation(self) -> Operation:
        """In which it is possible."""
        return Operation.MANUAL if self.kind in JOGGED else Operation.AUTOMATIC


@dataclass(frozen=True)
class Scenario:
    """Motions one after the other from a start (axes,), rad or m, on, for at most `duration` s."""

    start: Array
    motions: tuple[Motion, ...]
    duration: float


@dataclass(frozen=True)
class Begun:
    """A motion that has begun at `time`, s, at the earliest at the begin of the next cycle, and took some `cycles`."""

    motion: Motion
    time: float
    cycles: int


_EMERGENCY_STOP = 3  # of controller.state
_GUARD_TIMEOUT = 11  # of controller.error
_RESET_CYCLES = 3  # of the controller, from a reset to the next command
_TRIES = 12  # cycles between resets
_LOST = 6  # resets without effect, after which the operator opens a new session
_HELD = 0.02  # rate of the path clock
_PATIENCE = 0.35  # s for which a held motion is waited for
_RAMP = 0.15  # share of the time in which the speed of a program rises, and falls
_GRIP = 0.8, 30.0  # s and N
POSE_KEYS = (*(f"position[{i}]" for i in (1, 2, 3)), *(f"orientation[{i}]" for i in (1, 2, 3, 4)))
_BETWEEN = 0.05  # s, in which a change of operation takes effect


class Operator:
    """Gives the motions of a scenario to a cell; to be called once a cycle.

    Whatever stops the robot, the operator resets the controller and goes on with the next motion, with a new session
    where the guard does not answer any more. A move that the guard holds is given up after a while.

    Parameters
    ----------
    cell
        A running instance.
    nominal
        Its kinematics.
    scenario
        The motions.
    cycle
        Cycle of the controller, s.
    folder
        For the files of programs.
    renew
        Opens a new session with the guard, which is restarted if the argument is true.

    Attributes
    ----------
    begun
        Motions that have begun.
    resets, sessions
        Numbers of resets and of new sessions.
    given_up_at
        Time at which the operator has first given up a motion that the guard holds, s; None: never.
    """

    def __init__(
        self,
        cell: CellInstance,
        nominal: NominalCell,
        scenario: Scenario,
        cycle: float,
        folder: Path,
        renew: Callable[[bool], None] = lambda _: None,
    ) -> None:
        self._cell, self._nominal, self._cycle, self._folder, self._renew = cell, nominal, cycle, folder, renew
        self._left = list(scenario.motions)
        axes = cell.axis_names("command.")
        self._targets = cell.real_group(axes)
        self._line = cell.real_group([f"command.target.{key}" for key in POSE_KEYS])
        self._commanded = cell.path_ahead(1)
        self._jog = cell.real_group([f"command.jog[{i}]" for i in range(1, len(axes) + 1)])
        self._speed, self._rate = cell.real_group(["command.speed"]), cell.real_group(["controller.rate"])
        self._has_gripper = nominal.flange_from_finger is not None
        self._gripper = (
            cell.real_group(["command.gripper.width", "command.gripper.force"]) if self._has_gripper else None
        )
        self._now: Motion | None = None
        self._from = self._by = np.zeros(len(axes))
        self._since = self._free_at = 0.0
        self._stuck = self._recovering = 0
        self._held_since: float | None = None
        self._prepared = False
        self._operation = self._left[0].operation if self._left else Operation.AUTOMATIC
        self.begun: list[Begun] = []
        self.resets = self.sessions = 0
        self.given_up_at: float | None = None
        cell.set_integer("command.operation", self._operation)

    @property
    def done(self) -> bool:
        """Whether all motions were given and have ended."""
        return not self._left and self._now is None

    @property
    def jogs(self) -> bool:
        """Whether a jog is pressed."""
        return self._now is not None and self._now.kind in JOGGED

    def act(self, state: int) -> None:
        """Do what is due in this cycle."""
        time = self._cell.time_us * 1e-6
        error = self._cell.get_integer("controller.error")
        if state == _EMERGENCY_STOP or error == _GUARD_TIMEOUT:
            self._recover(time)
            return
        self._recovering = self._stuck = 0
        if self._now is not None:
            if self._now.kind is Kind.SERVO:
                self._stream(time)
            if not self._is_over(time, error):
                return
            self._end(time)
        if self._left and time >= self._free_at:
            motion = self._left[0]
            if not self._prepared:
                self._prepared = True
                self._free_at = time + motion.pause + self._prepare(motion)
            if time >= self._free_at:
                self._prepared = False
                self._begin(self._left.pop(0), time)

    def _recover(self, time: float) -> None:
        """Let go, and reset the controller as soon as the robot rests."""
        if self._now is not None:
            self._end(time)
        if self._recovering == 0:
            self._hold()
        elif self._recovering % _TRIES == _RESET_CYCLES and not self._cell.get_boolean("controller.moving"):
            self._stuck += 1
            if self._stuck % _LOST == 0:
                self.sessions += 1
                self._renew(False)
            self._reset()
        self._recovering += 1
        self._free_at = max(self._free_at, time + _RESET_CYCLES * self._cycle)

    def _hold(self) -> None:
        self._cell.set(self._jog, np.zeros(self._jog.count))
        self._cell.set_integer("command.mode", Mode.HOLD)

    def _reset(self) -> None:
        self.resets += 1
        self._cell.set_integer("command.reset", self.resets)

    def _is_over(self, time: float, error: int) -> bool:
        motion = self._now
        assert motion is not None
        if motion.kind in JOGGED or motion.kind is Kind.SERVO:
            return time >= self._since + motion.duration - 1e-9
        if error != 0 or self._cell.get_boolean("controller.at_destination"):
            return True
        if self._cell.get(self._rate)[0] > _HELD:
            self._held_since = None
            return False
        if self._held_since is None:
            self._held_since = time
        if time < self._held_since + _PATIENCE:
            return False
        self.given_up_at = time if self.given_up_at is None else self.given_up_at
        return True

    def _end(self, time: float) -> None:
        assert self._now is not None
        self.begun[-1] = Begun(self._now, self._since, round((time - self._since) / self._cycle))
        follows = bool(self._left) and self._left[0].pause == 0.0 and self._left[0].kind is self._now.kind
        if not (follows and self._now.kind in JOGGED) and self._now.kind in (*JOGGED, Kind.SERVO):
            self._hold()
        self._now = None

    def _prepare(self, motion: Motion) -> float:
        """Let the event before a motion happen; returns the time, s, that it takes."""
        event = motion.event
        if event is Event.RESET:
            self._hold()
            self._reset()
        elif event is Event.OPERATION:
            self._hold()
            self._set_operation(Operation(1 - self._operation))
            return _BETWEEN
        elif event in (Event.SESSION, Event.RESTART):
            self.sessions += 1
            self._renew(event is Event.RESTART)
        elif event is not None and self._gripper is not None:
            force = event is Event.GRIP
            self._cell.set(self._gripper, np.array([motion.width, _GRIP[1]]))
            self._cell.set_integer("command.gripper.mode", GripperMode.FORCE if force else GripperMode.WIDTH)
            return 0.0 if event is Event.GRIPPER else _GRIP[0]
        return 0.0

    def _set_operation(self, operation: Operation) -> None:
        self._operation = operation
        self._cell.set_integer("command.operation", operation)

    def _begin(self, motion: Motion, time: float) -> None:
        """Give a motion; a change of operation comes in the same cycle."""
        if motion.operation is not self._operation:
            self._set_operation(motion.operation)
        self._now, self._since, self._held_since = motion, time, None
        self.begun.append(Begun(motion, time, 0))
        self._cell.set_integer("command.mode", _MODES[motion.kind])
        if motion.kind in JOGGED:
            frame = JogFrame.SENSOR if motion.kind is Kind.TOOL_JOG else JogFrame.WORLD
            self._cell.set_integer("command.jog_frame", frame)
            self._cell.set(self._jog, motion.by)
            return
        self._from = self._cell.get(self._commanded)[: self._targets.count].copy()
        self._by = self._within_limits(motion.by)
        if motion.kind is Kind.SERVO:
            self._stream(time)
            return
        self._cell.set(self._speed, np.array([motion.speed]))
        target = self._from + self._by
        if motion.kind is Kind.LINE_MOVE:
            end = world_from_tool(self._nominal, target)
            self._cell.set(self._line, np.append(end[:3, 3], pose.quaternion_from_rotation(end[:3, :3])))
        self._cell.set(self._targets, target)
        if _MODES[motion.kind] is Mode.PROGRAM:
            self._load(self._from + set_points(replace(motion, by=self._by), self._cycle))
        self._cell.set_integer("command.start", self._cell.get_integer("command.start") + 1)

    def _stream(self, time: float) -> None:
        """The next set-point of servo mode."""
        assert self._now is not None
        # The axes follow one cycle later.
        takes = max(self._now.duration - 3 * self._cycle, self._cycle)
        share = min(1.0, (time - self._since + self._cycle) / takes)
        self._cell.set(self._targets, self._from + share * self._by)

    def _within_limits(self, by: Array) -> Array:
        """The travel (axes,) of a motion that ends no further than the axes beyond the table can go."""
        by, first = by.copy(), len(self._nominal.home) + 1
        for number, axis in enumerate(self._nominal.further_axes, first):
            by[number] = np.clip(self._from[number] + by[number], axis.min, axis.max) - self._from[number]
        return by

    def _load(self, points: Array) -> None:
        times = np.asarray(self._cycle * np.arange(len(points)), np.float64)
        path = (self._folder / f"program{len(self.begun)}.json").absolute()
        path.write_text(json.dumps(moving_program(times, points, len(self._nominal.home))))
        self._cell.set_string("command.program", str(path))
        self._cell.set_integer("command.segment", 1)


def moving_program(times: Array, points: Array, joints: int) -> dict[str, Any]:
    """Data of a program of one segment through set-points (n, axes) at `times` (n,), s, in which all axes may move."""
    first, further = np.split(points, [joints + 1], 1)
    data = program_data(Program((Segment(1, times, first),)))
    if further.size:
        data["segments"][0]["further"] = further.tolist()
    return data


def set_points(motion: Motion, cycle: float) -> Array:
    """Set-points (n, axes), rad or m, of a program from its start on, one per controller cycle.

    The speed rises smoothly from rest, is even, and falls to rest; two or three points are equidistant.
    """
    count = max(round(motion.duration / cycle), 1)
    share = np.linspace(0.0, 1.0, count + 1)
    return np.asarray((share if count < 3 else _eased(share))[:, None] * motion.by)


def _eased(share: Array) -> Array:
    """Course (n,) from 0 to 1, at rest with no acceleration at both ends; even but for the `_RAMP` at each end."""
    ramp = np.clip(np.minimum(share, 1.0 - share) / _RAMP, 0.0, 1.0)
    gained = _RAMP * ramp**3 * (1.0 - ramp / 2)  # integral of the speed ramp² (3 - 2 ramp)
    even = gained + np.clip(np.minimum(share, 1.0 - share) - _RAMP, 0.0, None)
    total = 1.0 - _RAMP
    return np.asarray(np.where(share < 0.5, even, total - even) / total)


def program_duration(by: Array, speed: float, max_speed: Array, max_acceleration: Array, cycle: float) -> float:
    """Time (s) that a program along `by` (axes,) takes at a share of the full speed, in whole cycles."""
    within = 0.9  # of the limits
    by_speed = float((np.abs(by) / (within * speed * (1.0 - _RAMP) * max_speed)).max())
    # Largest slope of ramp² (3 - 2 ramp), 1.5, over the ramp.
    bend = 1.5 / (_RAMP * (1.0 - _RAMP))
    by_bend = float(np.sqrt(bend * np.abs(by) / (within * max_acceleration)).max())
    return cycle * max(int(np.ceil(max(by_speed, by_bend) / cycle)), 8)


def short_program_length(points: int, by: Array, max_acceleration: Array, cycle: float) -> float:
    """Largest factor of `by` (axes,) of a program of two or three set-points within the accelerations."""
    most = (1.0 / 6.0, 1.0 / 1.5)[points - 2] * 0.98 * max_acceleration * cycle**2
    return float(np.min(most / np.maximum(np.abs(by), 1e-12)))
