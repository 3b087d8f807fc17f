"""Commands of operators to a `LiveCell`, made from the methods by which a `CellSession` starts them.

The table at the end has all of them. Each takes the arguments of its method, which are checked when it is made.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any, Concatenate, ParamSpec

from scancell.arguments import checked_arguments
from scancell.cell.driver import Operation
from scancell.cell.session import CellSession

P = ParamSpec("P")


class CommandKind(Enum):
    """How a `LiveCell` carries out a command."""

    JOG = "moves the robot by hand for as long as it is renewed"
    MOVE = "moves the robot to a destination when the moves before it have ended"
    AT_REST = "cancels all motion, and starts when the robot rests"
    AT_ONCE = "starts in the next cycle"
    CANCEL = "cancels all motion and the job"


_NEEDS_OPERATION = {CommandKind.JOG: Operation.MANUAL, CommandKind.MOVE: Operation.AUTOMATIC}


@dataclass(frozen=True, eq=False)
class Command:
    """Command of an operator.

    Attributes
    ----------
    name
        Name of the command of a session that does the same: ``move_joints``.
    kind
        How a live cell carries it out.
    method
        Name of the method of a session that starts it: ``start_move_joints``.
    arguments
        Arguments of this method by name.
    """

    name: str
    kind: CommandKind
    method: str
    arguments: Mapping[str, Any]

    @property
    def needs_operation(self) -> Operation | None:
        """The operation without which the controller rejects it."""
        return _NEEDS_OPERATION.get(self.kind)

    def start(self, session: CellSession) -> None:
        """Give the command to the controller of `session`, which is not stepped.

        Raises
        ------
        CommandError
            If the cell cannot carry it out.
        """
        getattr(session, self.method)(**self.arguments)


def _command(name: str, kind: CommandKind, start: Callable[Concatenate[CellSession, P], None]) -> Callable[P, Command]:
    """Function with the parameters of the method `start` of a session that checks them and makes a command."""
    signature = inspect.signature(start)
    signature = signature.replace(parameters=list(signature.parameters.values())[1:], return_annotation="Command")

    @functools.wraps(start)
    def make(*args: P.args, **kwargs: P.kwargs) -> Command:
        bound = signature.bind(*args, **kwargs)
        bound.apply_defaults()
        return Command(name, kind, start.__name__, bound.arguments)

    make.__doc__ = (
        f"Make the command of a live cell that calls `CellSession.{start.__name__}`. See the example of `LiveCell`."
    )
    vars(make)["__signature__"] = signature
    return checked_arguments(make)


JogJoints = _command("jog_joints", CommandKind.JOG, CellSession.start_jog_joints)
JogSensor = _command("jog_sensor", CommandKind.JOG, CellSession.start_jog_sensor)
MoveJoints = _command("move_joints", CommandKind.MOVE, CellSession.start_move_joints)
MoveTool = _command("move_tool", CommandKind.MOVE, CellSession.start_move_tool)
MoveLine = _command("move_line", CommandKind.MOVE, CellSession.start_move_line)
SetMonitorSpeed = _command("set_monitor_speed", CommandKind.AT_ONCE, CellSession.set_monitor_speed)
SetOperation = _command("set_operation", CommandKind.AT_REST, CellSession.request_operation)
Reset = _command("reset", CommandKind.AT_REST, CellSession.release_emergency_stop)
Cancel = _command("cancel", CommandKind.CANCEL, CellSession.hold)
OpenGripper = _command("open_gripper", CommandKind.AT_ONCE, CellSession.start_open_gripper)
CloseGripper = _command("close_gripper", CommandKind.AT_ONCE, CellSession.start_close_gripper)
RunConveyor = _command("run_conveyor", CommandKind.AT_ONCE, CellSession.run_conveyor)
