"""Commands of operators to a `LiveCell`; each checks its values where it is made.

Each is named like the command of a session that does the same, with its parameters.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.cell.controller import JogFrame, Operation, Tool
from scancell.errors import CommandError

_RIGID = 1e-6  # by which a rotation matrix may deviate from one


@dataclass(frozen=True, eq=False)
class JogJoints:
    """Jog joints and table by hand for as long as it is renewed: `deflections` (at most joints + 1,), -1 to 1."""

    deflections: ArrayLike

    def __post_init__(self) -> None:
        _deflections(self, (None,))


@dataclass(frozen=True, eq=False)
class JogSensor:
    """Jog the sensor along and about the axes of `frame` for as long as it is renewed: `deflections` (6,), -1 to 1."""

    deflections: ArrayLike
    frame: JogFrame = JogFrame.WORLD

    def __post_init__(self) -> None:
        _deflections(self, (6,))


@dataclass(frozen=True, eq=False)
class MoveJoints:
    """Move all joints to `joints` (joints,), rad, and the table to `table_angle`, where given."""

    joints: ArrayLike
    table_angle: float | None = None
    speed: float = 1.0

    def __post_init__(self) -> None:
        _array(self, "joints", (None,))
        _number(self, "speed", 1e-6, 1.0)
        if self.table_angle is not None:
            _number(self, "table_angle", -1e4, 1e4)


@dataclass(frozen=True, eq=False)
class _PoseCommand:
    world_from_tool: ArrayLike
    tool: Tool = "sensor"
    speed: float = 1.0

    def __post_init__(self) -> None:
        target = _array(self, "world_from_tool", (4, 4))
        rotation = target[:3, :3]
        is_pose = np.abs(rotation @ rotation.T - np.eye(3)).max() < _RIGID and np.linalg.det(rotation) > 0
        if not is_pose or not np.array_equal(target[3], [0, 0, 0, 1]):
            raise CommandError(f"{name_of(self)}: world_from_tool = {target.tolist()}: expected a rigid transform")
        _number(self, "speed", 1e-6, 1.0)


class MoveTool(_PoseCommand):
    """Move a tool to a pose (4, 4), all joints together."""


class MoveLine(_PoseCommand):
    """Move a tool straight to a pose (4, 4)."""


@dataclass(frozen=True)
class SetMonitorSpeed:
    """Scale the speed of moves, 0 to 1; never beyond what the guard allows."""

    share: float

    def __post_init__(self) -> None:
        _number(self, "share", 0.0, 1.0)


@dataclass(frozen=True)
class SetOperation:
    """Come to rest, then change between manual and automatic operation."""

    operation: Operation


@dataclass(frozen=True)
class Cancel:
    """End the job that runs or waits, or the moves; come to rest."""


@dataclass(frozen=True)
class Reset:
    """Leave an emergency stop when all axes rest."""


@dataclass(frozen=True)
class OpenGripper:
    """Bring the pads of the gripper `width` apart, m."""

    width: float

    def __post_init__(self) -> None:
        _number(self, "width", 0.0, 1e4)


@dataclass(frozen=True)
class CloseGripper:
    """Close the gripper with `force`, N each finger."""

    force: float

    def __post_init__(self) -> None:
        _number(self, "force", 0.0, 1e4)


@dataclass(frozen=True)
class RunConveyor:
    """Give conveyor number `conveyor` (from 1) another speed, m/s."""

    conveyor: int
    speed: float

    def __post_init__(self) -> None:
        _number(self, "speed", -10.0, 10.0)


Command = (
    JogJoints
    | JogSensor
    | MoveJoints
    | MoveTool
    | MoveLine
    | SetMonitorSpeed
    | SetOperation
    | Cancel
    | Reset
    | OpenGripper
    | CloseGripper
    | RunConveyor
)


def name_of(command: object) -> str:
    """Name of a command in messages, as of a session's: ``move_joints``."""
    return re.sub(r"(?<!^)(?=[A-Z])", "_", type(command).__name__).lower()


def _deflections(command: JogJoints | JogSensor, shape: tuple[int | None, ...]) -> None:
    values = _array(command, "deflections", shape)
    if np.abs(values).max(initial=0.0) > 1.0:
        raise CommandError(f"{name_of(command)}: deflections = {values}: expected numbers from -1 to 1")


def _number(command: object, name: str, low: float, high: float) -> None:
    value = getattr(command, name)
    if not (isinstance(value, int | float) and low <= value <= high):
        raise CommandError(f"{name_of(command)}: {name} = {value!r}: expected a number from {low:g} to {high:g}")


def _array(command: object, name: str, shape: tuple[int | None, ...]) -> NDArray[np.float64]:
    value = getattr(command, name)
    expected = " x ".join("n" if size is None else str(size) for size in shape)
    try:
        array = np.asarray(value, float)
    except (TypeError, ValueError) as error:
        raise CommandError(f"{name_of(command)}: {name} = {value!r}: expected {expected} numbers") from error
    fits = array.ndim == len(shape) and all(s in (None, n) for s, n in zip(shape, array.shape, strict=True))
    if not (fits and np.isfinite(array).all()):
        raise CommandError(f"{name_of(command)}: {name} = {value!r}: expected {expected} finite numbers")
    return array
