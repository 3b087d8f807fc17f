"""Commands of operators to a `LiveCell`; each checks its values where it is made.

Each is named like the command of a session that does the same, with its parameters.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Annotated

from numpy.typing import ArrayLike

from scancell.arguments import Count, Rigid, Shape, Share, Within, checked_fields
from scancell.cell.controller import JogFrame, Operation, Tool

_DEFLECTION = Within(-1.0, 1.0)
_Positive = Annotated[float, Within(0.0, 1e4)]


@checked_fields
@dataclass(frozen=True, eq=False)
class JogJoints:
    """Jog joints and table by hand for as long as it is renewed.

    Parameters
    ----------
    deflections
        Of the joints and the table, at most (joints + 1,), -1 to 1; the others are 0.

    Examples
    --------
    >>> with scancell.Scanner() as scanner, scanner.session(guarded=True) as session:
    ...     live = scancell.LiveCell(session)
    ...     live.submit(scancell.SetOperation(scancell.Operation.MANUAL))
    ...     live.run(lambda: session.time > 0.3, realtime=False)
    ...     live.submit(scancell.JogJoints([0.2]))
    ...     live.run(lambda: live.state.moving, realtime=False)
    ...     bool(live.state.destination[0] > session.home[0])
    True
    """

    deflections: Annotated[ArrayLike, Shape((None,), within=_DEFLECTION)]


@checked_fields
@dataclass(frozen=True, eq=False)
class JogSensor:
    """Jog the sensor for as long as it is renewed.

    Parameters
    ----------
    deflections
        (6,) along x, y, z and about x, y, z, -1 to 1.
    frame
        Whose axes these are.

    Examples
    --------
    >>> down = scancell.JogSensor([0, 0, 0.5, 0, 0, 0], scancell.JogFrame.SENSOR)
    >>> scancell.JogSensor([0, 0, 2, 0, 0, 0])
    Traceback (most recent call last):
        ...
    scancell.errors.DescriptionError: deflections = ...: expected finite numbers of shape (6,) from -1 to 1
    """

    deflections: Annotated[ArrayLike, Shape((6,), within=_DEFLECTION)]
    frame: JogFrame = JogFrame.WORLD


@checked_fields
@dataclass(frozen=True, eq=False)
class MoveJoints:
    """Move all joints together, and the table.

    Parameters
    ----------
    joints
        (joints,) angles, rad.
    table_angle
        rad; None: the table rests.
    speed
        Share of the full speed, above 0, at most 1.

    Examples
    --------
    >>> with scancell.Scanner() as scanner, scanner.session(guarded=True) as session:
    ...     live = scancell.LiveCell(session)
    ...     live.submit(scancell.MoveJoints(session.home, table_angle=0.2))
    ...     live.run(lambda: live.state.progress == 1 and not live.state.moving, realtime=False)
    ...     print(f"{live.state.table_angle:.2f} rad")
    0.20 rad
    """

    joints: Annotated[ArrayLike, Shape((None,))]
    table_angle: Annotated[float, Within(-1e4, 1e4)] | None = None
    speed: Share = 1.0


@checked_fields
@dataclass(frozen=True, eq=False)
class _PoseCommand:
    world_from_tool: Annotated[ArrayLike, Rigid()]
    tool: Tool = "sensor"
    speed: Share = 1.0


class MoveTool(_PoseCommand):
    """Move a tool to a pose, all joints together.

    Parameters
    ----------
    world_from_tool
        (4, 4).
    tool
        ``sensor`` or ``gripper``.
    speed
        Share of the full speed, above 0, at most 1.

    Examples
    --------
    Moves wait for the one that runs:

    >>> above = scancell.location(0.45, 0.0, 0.25, rx=np.pi)
    >>> lower = scancell.location(0.45, 0.0, 0.23, rx=np.pi)
    >>> with scancell.Scanner() as scanner, scanner.session(guarded=True) as session:
    ...     live = scancell.LiveCell(session)
    ...     live.submit(scancell.MoveTool(above))
    ...     live.submit(scancell.MoveLine(lower, speed=0.5))
    ...     live.run(lambda: np.allclose(session.world_from_tool(), lower, atol=1e-4), realtime=False)
    ...     live.state.controller
    'moving'
    """


class MoveLine(_PoseCommand):
    """Move a tool straight to a pose.

    See the example of `MoveTool`, which has the same parameters: `world_from_tool`, `tool` and `speed`, of which the
    share is that of the line speed.
    """


@checked_fields
@dataclass(frozen=True)
class SetMonitorSpeed:
    """Scale the speed of moves and programs; never beyond what the guard allows.

    Parameters
    ----------
    share
        0 to 1; 0 pauses them.

    Examples
    --------
    >>> with scancell.Scanner() as scanner, scanner.session(guarded=True) as session:
    ...     live = scancell.LiveCell(session)
    ...     live.submit(scancell.SetMonitorSpeed(0.25))
    ...     live.step()
    ...     live.state.monitor_speed
    0.25
    """

    share: Annotated[float, Within(0.0, 1.0)]


@checked_fields
@dataclass(frozen=True)
class SetOperation:
    """Come to rest, then change between manual and automatic `operation`.

    See the example of `JogJoints`.
    """

    operation: Operation


@dataclass(frozen=True)
class Cancel:
    """End the job that runs or waits, or the moves; come to rest.

    Examples
    --------
    >>> with scancell.Scanner() as scanner, scanner.session(guarded=True) as session:
    ...     live = scancell.LiveCell(session)
    ...     waiting = live.perform(lambda session: session.wait(60), "wait for a minute")
    ...     live.submit(scancell.Cancel())
    ...     live.run(waiting.done, realtime=False)
    ...     waiting.cancelled(), live.state.job
    (True, None)
    """


@dataclass(frozen=True)
class Reset:
    """Leave an emergency stop when all axes rest.

    Examples
    --------
    >>> with scancell.Scanner() as scanner, scanner.session(guarded=True) as session:
    ...     live = scancell.LiveCell(session)
    ...     live.emergency_stop()
    ...     live.run(lambda: live.state.controller == "emergency stop", realtime=False)
    ...     live.submit(scancell.Reset())
    ...     live.run(lambda: live.state.controller == "at rest", realtime=False)
    ...     live.state.refusal
    ''
    """


@checked_fields
@dataclass(frozen=True)
class OpenGripper:
    """Bring the pads of the gripper apart.

    Parameters
    ----------
    width
        Distance between the pads, m.

    Examples
    --------
    >>> cell = scancell.assets_dir() / "cells" / "pick_and_place.toml"
    >>> with scancell.Scanner(cell=cell) as scanner, scanner.session("part.stl", guarded=True) as session:
    ...     live = scancell.LiveCell(session)
    ...     live.submit(scancell.OpenGripper(0.03))
    ...     live.run(lambda: abs(live.state.gripper_width - 0.03) < 1e-4, realtime=False)
    ...     live.submit(scancell.CloseGripper(20.0))
    ...     live.run(lambda: live.state.gripper_width < 0.02, realtime=False)
    """

    width: _Positive


@checked_fields
@dataclass(frozen=True)
class CloseGripper:
    """Close the gripper with `force`, N each finger.

    See the example of `OpenGripper`.
    """

    force: _Positive


@checked_fields
@dataclass(frozen=True)
class RunConveyor:
    """Give a conveyor another speed.

    Parameters
    ----------
    conveyor
        Its number, from 1.
    speed
        m/s, -10 to 10.

    Examples
    --------
    >>> cell = scancell.assets_dir() / "cells" / "pick_and_place.toml"
    >>> with scancell.Scanner(cell=cell) as scanner, scanner.session("part.stl", guarded=True) as session:
    ...     live = scancell.LiveCell(session)
    ...     live.submit(scancell.RunConveyor(1, 0.1))
    ...     live.run(lambda: session.time > 1, realtime=False)
    ...     print(f"{session.conveyor_travel(1):.2f} m")
    0.10 m
    """

    conveyor: Count
    speed: Annotated[float, Within(-10.0, 10.0)]


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
