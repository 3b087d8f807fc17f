"""The robot controller of a running cell: its modes, and the reason for rejecting a command."""

from __future__ import annotations

from enum import IntEnum
from typing import Annotated

from numpy.typing import ArrayLike

from scancell.arguments import Rigid, Shape, Within
from scancell.cell.instance import CellInstance

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
}


def refusal(cell: CellInstance) -> str | None:
    """Reason why the controller rejects its command; None if it does not."""
    reason = cell.get_integer("controller.error")
    if reason == 0:
        return None
    number = cell.get_integer("controller.limit")
    table = len(cell.axis_names("command."))
    axis = {0: "an axis", table: "the table"}.get(number, f"joint {number}")
    return _REFUSALS[reason].format(axis=axis)


def state_in_words(cell: CellInstance) -> str:
    """State and mode of the controller, for messages."""
    state = ("at rest", "moving", "braking", "in an emergency stop")[cell.get_integer("controller.state")]
    mode = Mode(cell.get_integer("controller.mode")).name.lower().replace("_", " ")
    return f"the controller is {state} (mode {mode})"
