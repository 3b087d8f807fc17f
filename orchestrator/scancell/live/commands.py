"""Commands of operators to a `LiveCell`; each checks its values when it is constructed.

Each is named like the command of a session that does the same, with its parameters.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

from scancell.arguments import Count, Share, checked_fields
from scancell.cell.driver import (
    BeltSpeed,
    Deflections,
    Force,
    JogFrame,
    JointAngles,
    MonitorSpeed,
    Operation,
    SensorDeflections,
    TableAngle,
    Tool,
    Width,
    WorldFromTool,
)
from scancell.cell.session import CellSession


class Command(ABC):
    """Command of an operator; `needs_operation` is the operation without which the controller rejects it."""

    needs_operation: ClassVar[Operation | None] = None

    @property
    def name(self) -> str:
        """Name in messages, as of the command of a session: ``move_joints``."""
        return re.sub(r"(?<!^)(?=[A-Z])", "_", type(self).__name__).lower()

    @abstractmethod
    def start(self, session: CellSession) -> None:
        """Give the command to the controller of `session`, which is not stepped.

        Raises
        ------
        CommandError
            If the cell cannot carry it out.
        """


class Jog(Command):
    """Motion by hand, which lasts as long as the command is renewed."""

    needs_operation = Operation.MANUAL


class Move(Command):
    """Motion to a destination, which starts when the moves before it have ended."""

    needs_operation = Operation.AUTOMATIC


class CommandAtRest(Command):
    """Command that cancels all motion and takes effect when the robot rests."""


@checked_fields
@dataclass(frozen=True, eq=False)
class JogJoints(Jog):
    """Jog joints and table by hand for as long as it is renewed.

    Parameters
    ----------
    deflections
        Of the joints, then the table, -1 to 1; those that are not stated are 0.

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

    deflections: Deflections

    def start(self, session: CellSession) -> None:
        """Call `CellSession.start_jog_joints` of `session`."""
        session.start_jog_joints(self.deflections)


@checked_fields
@dataclass(frozen=True, eq=False)
class JogSensor(Jog):
    """Jog the sensor, or another tool, for as long as it is renewed.

    Parameters
    ----------
    deflections
        (6,) along x, y, z and about x, y, z, -1 to 1.
    frame
        Whose axes these are: a `JogFrame`, or the name of a frame of the cell, such as ``table``.
    tool
        ``sensor``, ``gripper``, or the name of a tool of the description.

    Examples
    --------
    >>> down = scancell.JogSensor([0, 0, 0.5, 0, 0, 0], scancell.JogFrame.SENSOR)
    >>> scancell.JogSensor([0, 0, 2, 0, 0, 0])
    Traceback (most recent call last):
        ...
    scancell.errors.DescriptionError: deflections = ...: expected finite numbers of shape (6,) from -1 to 1
    """

    deflections: SensorDeflections
    frame: JogFrame | str = JogFrame.WORLD
    tool: Tool = "sensor"

    def start(self, session: CellSession) -> None:
        """Call `CellSession.start_jog_sensor` of `session`."""
        session.start_jog_sensor(self.deflections, self.frame, self.tool)


@checked_fields
@dataclass(frozen=True, eq=False)
class MoveJoints(Move):
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

    joints: JointAngles
    table_angle: TableAngle | None = None
    speed: Share = 1.0

    def start(self, session: CellSession) -> None:
        """Call `CellSession.start_move_joints` of `session`."""
        session.start_move_joints(self.joints, self.table_angle, speed=self.speed)


@checked_fields
@dataclass(frozen=True, eq=False)
class _PoseMove(Move):
    world_from_tool: WorldFromTool
    tool: Tool = "sensor"
    speed: Share = 1.0


class MoveTool(_PoseMove):
    """Move a tool to a pose, all joints together.

    Parameters
    ----------
    world_from_tool
        (4, 4).
    tool
        ``sensor``, ``gripper``, or the name of a tool of the description.
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

    def start(self, session: CellSession) -> None:
        """Call `CellSession.start_move_tool` of `session`."""
        session.start_move_tool(self.world_from_tool, self.tool, speed=self.speed)


class MoveLine(_PoseMove):
    """Move a tool straight to a pose.

    See the example of `MoveTool`, which has the same parameters: `world_from_tool`, `tool` and `speed`, a share of the
    line speed.
    """

    def start(self, session: CellSession) -> None:
        """Call `CellSession.start_move_line` of `session`."""
        session.start_move_line(self.world_from_tool, self.tool, speed=self.speed)


@checked_fields
@dataclass(frozen=True)
class SetMonitorSpeed(Command):
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

    share: MonitorSpeed

    def start(self, session: CellSession) -> None:
        """Call `CellSession.set_monitor_speed` of `session`."""
        session.set_monitor_speed(self.share)


@checked_fields
@dataclass(frozen=True)
class SetOperation(CommandAtRest):
    """Come to rest, then change between manual and automatic `operation`.

    See the example of `JogJoints`.
    """

    operation: Operation

    def start(self, session: CellSession) -> None:
        """Call `CellSession.request_operation` of `session`."""
        session.request_operation(self.operation)


@dataclass(frozen=True)
class Cancel(Command):
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

    def start(self, session: CellSession) -> None:
        """Call `CellSession.hold` of `session`."""
        session.hold()


@dataclass(frozen=True)
class Reset(CommandAtRest):
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

    def start(self, session: CellSession) -> None:
        """Call `CellSession.release_emergency_stop` of `session`."""
        session.release_emergency_stop()


@checked_fields
@dataclass(frozen=True)
class OpenGripper(Command):
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

    width: Width

    def start(self, session: CellSession) -> None:
        """Call `CellSession.start_open_gripper` of `session`."""
        session.start_open_gripper(self.width)


@checked_fields
@dataclass(frozen=True)
class CloseGripper(Command):
    """Close the gripper with `force`, N each finger.

    See the example of `OpenGripper`.
    """

    force: Force

    def start(self, session: CellSession) -> None:
        """Call `CellSession.start_close_gripper` of `session`."""
        session.start_close_gripper(self.force)


@checked_fields
@dataclass(frozen=True)
class RunConveyor(Command):
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
    speed: BeltSpeed

    def start(self, session: CellSession) -> None:
        """Call `CellSession.run_conveyor` of `session`."""
        session.run_conveyor(self.conveyor, self.speed)
