"""Robot programs as data: named points, and steps that an operator adds, edits and reorders."""

from __future__ import annotations

import keyword
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from itertools import count
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from scancell.arguments import Within
from scancell.cell.controller import Tool
from scancell.errors import DescriptionError
from scancell.geometry import pose

Array = NDArray[np.float64]
Command = Literal["move_joints", "move_line", "scan_line", "turn_table", "open_gripper", "close_gripper", "wait"]
COMMANDS: tuple[Command, ...] = get_args(Command)

MAX_STEPS = 1000
RESERVED = frozenset({"Robot", "deg", "location", "mm", "main", "robot"})  # names in the text of a program
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,39}")
_SPEED = Within(0.001, 1.0)  # the text has three digits
_COORDINATES = Within(-100.0, 100.0)  # m and rad
_SAME_ANGLE = math.radians(0.01)  # of the table; beyond the noise of its encoder


@dataclass(frozen=True)
class JointPoint:
    """Joint angles (joints,), rad."""

    joints: tuple[float, ...]


@dataclass(frozen=True)
class PosePoint:
    """Pose of a tool in the world: position (3,), m, and XYZ' Euler angles (3,), rad."""

    position: tuple[float, ...]
    angles: tuple[float, ...]

    @classmethod
    def of(cls, world_from_tool: Array) -> PosePoint:
        """The point of a pose (4, 4)."""
        angles = pose.euler_xyz_from_rotation(world_from_tool[:3, :3])
        return cls(tuple(world_from_tool[:3, 3].tolist()), tuple(angles.tolist()))

    @property
    def world_from_tool(self) -> Array:
        """The pose (4, 4)."""
        return pose.from_euler_xyz(self.position, self.angles)


Point = JointPoint | PosePoint


@dataclass(frozen=True)
class Words:
    """Arguments of a command of `Robot`.

    Attributes
    ----------
    point
        Type of the point that it moves to; None: it moves to none.
    value
        Name of its number; empty if it has none.
    bounds
        Of the number, SI.
    unit
        In which texts state the number.
    moves
        Whether it has a speed.
    """

    point: type[JointPoint] | type[PosePoint] | None = None
    value: str = ""
    bounds: Within = field(default_factory=Within)
    unit: str = ""
    moves: bool = False


WORDS: dict[Command, Words] = {
    "move_joints": Words(JointPoint, "table_angle", Within(-1e4, 1e4), "deg", moves=True),
    "move_line": Words(PosePoint, moves=True),
    "scan_line": Words(PosePoint, "spacing", Within(1e-5, 1.0), "mm", moves=True),
    "turn_table": Words(None, "table_angle", Within(-1e4, 1e4), "deg", moves=True),
    "open_gripper": Words(None, "width", Within(0.0, 10.0), "mm"),
    "close_gripper": Words(None, "force", Within(0.0, 1e4), "N"),
    "wait": Words(None, "duration", Within(0.0, 3600.0), "s"),
}


@dataclass(frozen=True)
class TaughtStep:
    """One command of `Robot`.

    Parameters
    ----------
    command
        Its name.
    point
        Name of the point that it moves to.
    value
        Its number, see `WORDS`; SI.
    speed
        Share of the full speed, 0.001 to 1; 1 for a command that moves nothing.
    tool
        Tool that a line moves; ``sensor`` for every other command.

    Raises
    ------
    DescriptionError
        If the value or the speed is out of its range, or the command has none.
    """

    command: Command
    point: str = ""
    value: float | None = None
    speed: float = 1.0
    tool: Tool = "sensor"

    def __post_init__(self) -> None:
        words = WORDS[self.command]
        if self.value is not None and not words.value:
            raise DescriptionError(f"{self.command} has no number")
        if words.value and (self.value is None or not _is_within(self.value, words.bounds)):
            expected = f"a finite number{words.bounds} (SI unit)"
            raise DescriptionError(key=f"{self.command}: {words.value}", value=self.value, expected=expected)
        if not words.moves and self.speed != 1.0:
            raise DescriptionError(f"{self.command} has no speed")
        if not _is_within(self.speed, _SPEED):
            raise DescriptionError(key="speed", value=self.speed, expected=f"a finite number{_SPEED}")


@dataclass(frozen=True)
class TaughtProgram:
    """Named points, and the steps that use them; every edit returns another program.

    Points that no step uses are dropped. Indices of steps count from 0.

    Raises
    ------
    DescriptionError
        If a name or a number is not valid, a step has no point of its type, or there are more than `MAX_STEPS`.
    """

    points: Mapping[str, Point] = field(default_factory=dict)
    steps: tuple[TaughtStep, ...] = ()

    def __post_init__(self) -> None:
        if len(self.steps) > MAX_STEPS:
            raise DescriptionError(f"{len(self.steps)} steps", expected=f"at most {MAX_STEPS}")
        used = {step.point for step in self.steps if step.point}
        for step in self.steps:
            self._check_point(step)
        object.__setattr__(self, "points", {name: point for name, point in self.points.items() if name in used})

    def _check_point(self, step: TaughtStep) -> None:
        kind, point = WORDS[step.command].point, self.points.get(step.point)
        if kind is None:
            return
        _check_name(step.point)
        if not isinstance(point, kind):
            expected = "joint angles" if kind is JointPoint else "a location"
            raise DescriptionError(f"{step.command}: the point {step.point} is not there or no {expected}")
        _check_coordinates(step.point, point)

    def step(self, index: int) -> TaughtStep:
        """Step number `index`.

        Raises
        ------
        DescriptionError
            If there is none.
        """
        if not 0 <= index < len(self.steps):
            raise DescriptionError(f"there is no step {index + 1}", expected=f"1 to {len(self.steps)}")
        return self.steps[index]

    def free_name(self) -> str:
        """The first of p1, p2, ... that no point has."""
        return next(name for number in count(1) if (name := f"p{number}") not in self.points)

    def table_angle_before(self, index: int) -> float | None:
        """Angle to which the steps before step `index` turn the table, rad; None: none of them does."""
        angles = [step.value for step in self.steps[:index] if WORDS[step.command].value == "table_angle"]
        return angles[-1] if angles else None

    def with_step(self, index: int, step: TaughtStep, point: Point | None = None) -> TaughtProgram:
        """Insert `step` before step `index`, and define its `point`.

        Raises
        ------
        DescriptionError
            If there is a point of this name.
        """
        if point is None:
            return self._changed((*self.steps[:index], step, *self.steps[index:]))
        if step.point in self.points:
            raise DescriptionError(key="name", value=step.point, expected="a name that no other point has")
        return self._changed((*self.steps[:index], step, *self.steps[index:]), {step.point: point})

    def with_line(self, index: int, step: TaughtStep, point: Point, table_angle: float) -> TaughtProgram:
        """Insert a line as of `with_step`, and before it a turn of the table unless it is at `table_angle`, rad."""
        before = self.table_angle_before(index)
        if before is not None and abs(before - table_angle) < _SAME_ANGLE:
            return self.with_step(index, step, point)
        turn = TaughtStep("turn_table", value=table_angle, speed=step.speed)
        return self.with_step(index, turn).with_step(index + 1, step, point)

    def with_copy(self, index: int) -> TaughtProgram:
        """Insert a copy of step `index`, with the same point, after it."""
        return self.with_step(index + 1, self.step(index))

    def without(self, index: int) -> TaughtProgram:
        """Delete step `index`."""
        self.step(index)
        return self._changed(self.steps[:index] + self.steps[index + 1 :])

    def moved(self, index: int, by: int) -> TaughtProgram:
        """Move step `index` by a number of positions, or as far as the list goes."""
        step, steps = self.step(index), list(self.steps)
        del steps[index]
        steps.insert(max(index + by, 0), step)
        return self._changed(tuple(steps))

    def renamed(self, old: str, new: str) -> TaughtProgram:
        """Rename the point `old`, in all steps.

        Raises
        ------
        DescriptionError
            If `new` is not valid, or the name of another point.
        """
        if new != old and new in self.points:
            raise DescriptionError(key="name", value=new, expected="a name that no other point has")
        points = {new if name == old else name: point for name, point in self.points.items()}
        steps = (replace(step, point=new) if step.point == old else step for step in self.steps)
        return TaughtProgram(points, tuple(steps))

    def with_speed(self, index: int, speed: float) -> TaughtProgram:
        """Change the speed of step `index`."""
        return self._replaced(index, replace(self.step(index), speed=speed))

    def with_value(self, index: int, value: float) -> TaughtProgram:
        """Change the number of step `index`; SI."""
        return self._replaced(index, replace(self.step(index), value=value))

    def with_point(self, name: str, point: Point) -> TaughtProgram:
        """Change the point `name`, for all steps."""
        return self._changed(self.steps, {name: point})

    def _replaced(self, index: int, step: TaughtStep) -> TaughtProgram:
        return self._changed((*self.steps[:index], step, *self.steps[index + 1 :]))

    def _changed(self, steps: tuple[TaughtStep, ...], points: Mapping[str, Point] | None = None) -> TaughtProgram:
        return TaughtProgram({**self.points, **(points or {})}, steps)


def _check_name(name: str) -> None:
    if not _NAME.fullmatch(name) or keyword.iskeyword(name) or name in RESERVED:
        expected = "a Python name: a letter, then letters, digits and _, at most 40"
        raise DescriptionError(key="name", value=name[:60], expected=expected)


def _check_coordinates(name: str, point: Point) -> None:
    numbers: Iterable[float] = point.joints if isinstance(point, JointPoint) else point.position + point.angles
    if point == JointPoint(()) or not all(_is_within(number, _COORDINATES) for number in numbers):
        raise DescriptionError(key=name, value=point, expected=f"finite numbers{_COORDINATES}, m and rad")


def _is_within(value: float, bounds: Within) -> bool:
    return math.isfinite(value) and value in bounds
