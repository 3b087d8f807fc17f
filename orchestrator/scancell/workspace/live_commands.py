"""Commands of operators to a `LiveCell`; each checks its values where it is made."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.cell.controller import JogFrame, Mode, Operation
from scancell.cell.readings import Tool
from scancell.errors import CommandError

_RIGID = 1e-6  # by which a rotation matrix may deviate from one


@dataclass(frozen=True, eq=False)
class Jog:
    """Jog by hand for as long as it is renewed: `deflections` -1 to 1, joints and table, or x, y, z and about them."""

    mode: Mode
    deflections: ArrayLike
    frame: JogFrame = JogFrame.WORLD

    def __post_init__(self) -> None:
        values = _array("jog", "deflections", self.deflections, (None,))
        if self.mode not in (Mode.JOINT_JOG, Mode.CARTESIAN_JOG):
            raise CommandError(f"jog: mode = {self.mode!r}: expected JOINT_JOG or TOOL_JOG")
        if np.abs(values).max(initial=0.0) > 1.0 or (self.mode is Mode.CARTESIAN_JOG and len(values) != 6):
            raise CommandError(f"jog: deflections = {values}: expected numbers from -1 to 1, 6 for the tool")


@dataclass(frozen=True, eq=False)
class MoveJoints:
    """Move all joints to `q` (joints,), rad, and the table to `table`, where given."""

    q: ArrayLike
    table: float | None = None
    speed: float = 1.0

    def __post_init__(self) -> None:
        _array("move", "q", self.q, (None,))
        _number("move", "speed", self.speed, 1e-6, 1.0)
        if self.table is not None:
            _number("move", "table", self.table, -1e4, 1e4)


@dataclass(frozen=True, eq=False)
class MoveTool:
    """Move a tool to a pose (4, 4): straight, or all joints together."""

    world_from_tool: ArrayLike
    tool: Tool = "sensor"
    straight: bool = False
    speed: float = 1.0

    def __post_init__(self) -> None:
        target = _array("move", "world_from_tool", self.world_from_tool, (4, 4))
        rotation = target[:3, :3]
        is_pose = np.abs(rotation @ rotation.T - np.eye(3)).max() < _RIGID and np.linalg.det(rotation) > 0
        if not is_pose or not np.array_equal(target[3], [0, 0, 0, 1]):
            raise CommandError(f"move: world_from_tool = {target.tolist()}: expected a rigid transform")
        _number("move", "speed", self.speed, 1e-6, 1.0)


@dataclass(frozen=True)
class SetMonitorSpeed:
    """Scale the speed of moves, 0 to 1; never beyond what the guard allows."""

    share: float

    def __post_init__(self) -> None:
        _number("monitor speed", "share", self.share, 0.0, 1.0)


@dataclass(frozen=True)
class ChangeOperation:
    """Come to rest, then change between manual and automatic operation."""

    operation: Operation


@dataclass(frozen=True)
class Cancel:
    """End the job that runs or waits, or the moves; come to rest."""


@dataclass(frozen=True)
class Reset:
    """Leave an emergency stop when all axes rest."""


@dataclass(frozen=True)
class SetGripper:
    """Bring the pads `width` (m) apart, or close them with `force` (N, each finger); one of the two."""

    width: float | None = None
    force: float | None = None

    def __post_init__(self) -> None:
        if (self.width is None) == (self.force is None):
            raise CommandError("gripper: expected either width or force")
        for name in ("width", "force"):
            if (value := getattr(self, name)) is not None:
                _number("gripper", name, value, 0.0, 1e4)


@dataclass(frozen=True)
class RunBelt:
    """Give a conveyor, numbered from 1, another speed, m/s."""

    number: int
    speed: float

    def __post_init__(self) -> None:
        _number("conveyor", "speed", self.speed, -10.0, 10.0)


# For messages to persons.
NAMES: dict[type, str] = {
    Jog: "jog",
    MoveJoints: "move",
    MoveTool: "move",
    ChangeOperation: "change of operation",
    Reset: "reset",
    SetGripper: "gripper",
    RunBelt: "conveyor",
}

Command = Jog | MoveJoints | MoveTool | SetMonitorSpeed | ChangeOperation | Cancel | Reset | SetGripper | RunBelt


def _number(command: str, name: str, value: float, low: float, high: float) -> None:
    if not (isinstance(value, int | float) and low <= value <= high):
        raise CommandError(f"{command}: {name} = {value!r}: expected a number from {low:g} to {high:g}")


def _array(command: str, name: str, value: ArrayLike, shape: tuple[int | None, ...]) -> NDArray[np.float64]:
    expected = " x ".join("n" if size is None else str(size) for size in shape)
    try:
        array = np.asarray(value, float)
    except (TypeError, ValueError) as error:
        raise CommandError(f"{command}: {name} = {value!r}: expected {expected} numbers") from error
    fits = array.ndim == len(shape) and all(s in (None, n) for s, n in zip(shape, array.shape, strict=True))
    if not (fits and np.isfinite(array).all()):
        raise CommandError(f"{command}: {name} = {value!r}: expected {expected} finite numbers")
    return array
