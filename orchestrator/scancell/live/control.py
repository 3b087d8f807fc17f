"""Execution of the commands of operators, from cycle to cycle."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from scancell.cell.controller import Operation
from scancell.errors import CommandError, DescriptionError
from scancell.live.commands import Cancel, Command, CommandAtRest, Jog, Move, SetOperation
from scancell.scanning.session import SEEN, ScanSession

_SEEN_US = round(SEEN * 1e6)


class LiveControl:
    """Commands a session that another object steps; see `LiveCell` for the parameters.

    Moves wait for the one that runs. A change of operation and a reset wait until the robot rests.
    """

    def __init__(self, session: ScanSession, hold_time: float, clock: Callable[[], float]) -> None:
        self._session, self._cell = session, session.cell
        self._hold_time, self._clock = hold_time, clock
        self._moves: deque[Move] = deque()
        self._jog_until: float | None = None
        self._at_rest: CommandAtRest | None = None
        self._settled_us = 0
        self._moving = False  # a move that was begun has not ended

    def cancel_motion(self) -> None:
        """Drop all moves and jogs; the robot stops."""
        self._moves.clear()
        self._jog_until, self._at_rest, self._moving = None, None, False
        self._session.hold()

    def press_emergency_stop(self) -> None:
        """Cancel the motion and press the emergency stop."""
        self.cancel_motion()
        self._session.press_emergency_stop()

    @property
    def is_free(self) -> bool:
        """Whether nothing moves the robot and no motion is queued."""
        waits = self._moves or self._moving or self._jog_until is not None or self._is_settling
        return not waits and not self._cell.get_boolean("controller.moving")

    def apply(self, command: Command) -> None:
        """Start a command, or queue it.

        Raises
        ------
        CommandError
            If it cannot be carried out.
        """
        match command:
            case Jog():
                self._jog(command)
            case Move():
                self._moves.append(command)
            case CommandAtRest():
                self.cancel_motion()
                self._at_rest = command
            case Cancel():
                self.cancel_motion()
            case _:
                command.start(self._session)

    def begin_cycle(self) -> None:
        """Start what is due in the next cycle.

        Raises
        ------
        CommandError
            If a move cannot be started; the queued moves are dropped.
        """
        self._act_at_rest()
        self._keep_jog()
        self._begin_move()

    def end_cycle(self) -> None:
        """Update whether a move has ended."""
        self._moving = self._moving and not self._move_ended()

    def _jog(self, command: Jog) -> None:
        """Start or renew a jog, but not before the guard has seen the robot at rest in manual operation."""
        operation = Operation(self._cell.get_integer("command.operation"))
        if self._is_settling:
            return
        if operation is not Operation.MANUAL:
            reason = "the cell is in automatic operation: change to manual operation first"
            raise CommandError(f"{command.name}: {reason}")
        command.start(self._session)
        self._jog_until = self._clock() + self._hold_time

    def _keep_jog(self) -> None:
        """Renew the heartbeat while the jog is renewed, else end the jog."""
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
        self._at_rest.start(self._session)
        # A reset needs the next cycle of the controller, another operation the next answer of the guard.
        self._settled_us = self._cell.time_us + (_SEEN_US if isinstance(self._at_rest, SetOperation) else 1)
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
            move.start(self._session)
        except (CommandError, DescriptionError):
            self._moves.clear()
            raise
        self._moving = True

    def _move_ended(self) -> bool:
        """Whether a move is done or was rejected; a rejected one drops the queued moves."""
        if self._cell.get_integer("controller.error") != 0:
            self._moves.clear()
            return True
        return self._cell.get_boolean("controller.at_destination")
