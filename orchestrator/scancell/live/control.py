"""Carries out the commands of operators to a running cell, from cycle to cycle."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from scancell.cell.controller import Operation
from scancell.errors import CommandError
from scancell.live.commands import (
    Cancel,
    CloseGripper,
    Command,
    JogJoints,
    JogSensor,
    MoveJoints,
    MoveLine,
    MoveTool,
    OpenGripper,
    Reset,
    RunConveyor,
    SetMonitorSpeed,
    SetOperation,
    name_of,
)
from scancell.scanning.session import SEEN, ScanSession

_SEEN_US = round(SEEN * 1e6)


class LiveControl:
    """Commands a session that another object steps; see `LiveCell` for the parameters.

    Moves wait for the one that runs. A change of operation and a reset wait until the robot rests.
    """

    def __init__(self, session: ScanSession, hold_time: float, clock: Callable[[], float]) -> None:
        self._session, self._cell = session, session.cell
        self._hold_time, self._clock = hold_time, clock
        self._moves: deque[MoveJoints | MoveTool | MoveLine] = deque()
        self._jog_until: float | None = None
        self._at_rest: SetOperation | Reset | None = None  # what waits until the robot rests
        self._settled_us = 0
        self._moving = False  # a move that was begun has not ended
        self._conveyors = sum(name.startswith("command.conveyor[") for name in self._cell.names)

    def cancel_motion(self) -> None:
        """Drop all moves and jogs; the robot comes to rest."""
        self._moves.clear()
        self._jog_until, self._at_rest, self._moving = None, None, False
        self._session.hold()

    def press_emergency_stop(self) -> None:
        """Cancel the motion and press the emergency stop."""
        self.cancel_motion()
        self._session.press_emergency_stop()

    @property
    def is_free(self) -> bool:
        """Whether nothing moves the robot, nor is to move it."""
        waits = self._moves or self._moving or self._jog_until is not None or self._is_settling
        return not waits and not self._cell.get_boolean("controller.moving")

    def apply(self, command: Command) -> None:
        """Carry out a command, or queue it.

        Raises
        ------
        CommandError
            If it cannot be carried out.
        """
        session = self._session
        match command:
            case JogJoints() | JogSensor():
                self._jog(command)
            case MoveJoints() | MoveTool() | MoveLine():
                self._moves.append(command)
            case SetMonitorSpeed():
                session.set_monitor_speed(command.share)
            case SetOperation() | Reset():
                self.cancel_motion()
                self._at_rest = command
            case OpenGripper():
                session.flange_from_tool("gripper")
                session.start_open_gripper(command.width)
            case CloseGripper():
                session.flange_from_tool("gripper")
                session.start_close_gripper(command.force)
            case RunConveyor():
                if not 1 <= command.conveyor <= self._conveyors:
                    raise CommandError(f"run_conveyor: conveyor = {command.conveyor}: expected 1 to {self._conveyors}")
                session.run_conveyor(command.conveyor, command.speed)
            case Cancel():
                self.cancel_motion()

    def begin_cycle(self) -> None:
        """Command what is due in the next cycle.

        Raises
        ------
        CommandError
            If a move cannot be begun; those that wait are dropped.
        """
        self._act_at_rest()
        self._keep_jog()
        self._begin_move()

    def end_cycle(self) -> None:
        """See whether a move has ended."""
        self._moving = self._moving and not self._move_ended()

    def _jog(self, command: JogJoints | JogSensor) -> None:
        """Begin or renew a jog; not before the guard has seen the robot rest in manual operation."""
        operation = Operation(self._cell.get_integer("command.operation"))
        if self._is_settling:
            return
        if operation is not Operation.MANUAL:
            reason = "the cell is in automatic operation: change to manual operation first"
            raise CommandError(f"{name_of(command)}: {reason}")
        if isinstance(command, JogSensor):
            self._session.start_jog_sensor(command.deflections, command.frame)
        else:
            self._session.start_jog_joints(command.deflections)
        self._jog_until = self._clock() + self._hold_time

    def _keep_jog(self) -> None:
        """Tell the controller that the operator still jogs, or let go of the jog."""
        if self._jog_until is None:
            return
        if self._clock() < self._jog_until:
            self._session.renew_heartbeat()
        else:
            self._jog_until = None
            self._session.hold()

    def _act_at_rest(self) -> None:
        if self._at_rest is None or self._cell.get_boolean("controller.moving"):
            return
        if isinstance(self._at_rest, Reset):
            self._session.release_emergency_stop()
            self._settled_us = self._cell.time_us + 1  # the controller resets in its next cycle
        else:
            self._session.request_operation(self._at_rest.operation)
            self._settled_us = self._cell.time_us + _SEEN_US
        self._at_rest = None

    @property
    def _is_settling(self) -> bool:
        """Whether nothing may move the robot yet."""
        return self._at_rest is not None or self._cell.time_us < self._settled_us

    def _begin_move(self) -> None:
        if not self._moves or self._moving or self._is_settling:
            return
        move = self._moves.popleft()
        try:
            self._start(move)
        except CommandError:
            self._moves.clear()
            raise
        self._moving = True

    def _start(self, move: MoveJoints | MoveTool | MoveLine) -> None:
        session = self._session
        match move:
            case MoveJoints():
                session.start_move_joints(move.joints, move.table_angle, speed=move.speed)
            case MoveTool():
                session.start_move_tool(move.world_from_tool, move.tool, speed=move.speed)
            case MoveLine():
                session.start_move_line(move.world_from_tool, move.tool, speed=move.speed)

    def _move_ended(self) -> bool:
        """Whether a move is done or was refused; a refused one takes those with it that wait."""
        if self._cell.get_integer("controller.error") != 0:
            self._moves.clear()
            return True
        return self._cell.get_boolean("controller.at_destination")
