"""A guarded cell that runs while operators command it, without any view."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable

import numpy as np

from scancell.cell.controller import Operation
from scancell.errors import CommandError
from scancell.scanning.session import SEEN, ScanSession
from scancell.stopwatch import Pace
from scancell.workspace.live_commands import (
    ChangeOperation,
    Command,
    Jog,
    MoveJoints,
    MoveTool,
    Reset,
    RunBelt,
    SetGripper,
    SetMonitorSpeed,
)
from scancell.workspace.live_state import LiveState, StateReader

_SEEN_US = round(SEEN * 1e6)


class LiveCell:
    """Steps a running cell in whole controller cycles, and takes commands between them.

    `submit`, `stop` and `state` may be called from any thread; `cycle` and `run` from one alone, which owns the cell.
    All motion goes through the cell's controller. Moves wait for the one that runs; other commands take effect in the
    next cycle. A stop comes before everything that was submitted, and drops it.

    Parameters
    ----------
    session
        A running cell, guarded or not, that nothing else steps.
    hold_time
        Time for which a jog goes on without being renewed, s of `clock`.
    clock
        s; that of the machine.
    state_cycles
        Number of cycles from one `state` to the next.
    """

    def __init__(
        self,
        session: ScanSession,
        hold_time: float = 0.3,
        clock: Callable[[], float] = time.monotonic,
        state_cycles: int = 1,
    ) -> None:
        self._session, self._cell = session, session.cell
        self._hold_time, self._clock, self._state_cycles = hold_time, clock, state_cycles
        self._cycles = 0
        self._lock = threading.Lock()
        self._submitted: deque[Command] = deque()
        self._stop_pressed = False
        self._moves: deque[MoveJoints | MoveTool] = deque()
        self._jog_until: float | None = None
        self._at_rest: ChangeOperation | Reset | None = None  # what waits until the robot rests
        self._settled_us = 0
        self._moving = False  # a move that was begun has not ended
        self._message = ""
        self._reader = StateReader(session)
        self._state = self._reader.read()

    # From any thread

    @property
    def state(self) -> LiveState:
        """As it was read last."""
        return self._state

    def submit(self, command: Command) -> None:
        """Hand over a command; what becomes of it is in `LiveState.refusal` and `message`."""
        with self._lock:
            self._submitted.append(command)

    def stop(self) -> None:
        """Stop the robot in an emergency stop, and drop all commands that were submitted; `Reset` ends it."""
        with self._lock:
            self._submitted.clear()
            self._stop_pressed = True

    # From the thread that owns the cell

    def run(self, ended: Callable[[], bool], realtime: bool = True) -> None:
        """Run cycle by cycle until `ended`, by the wall clock or as fast as possible.

        A machine that is too slow makes the cell's time slow.

        Raises
        ------
        CellError
            If the FMU reports an error.
        """
        pace = Pace(self._session.cycle)
        while not ended():
            self.cycle()
            if realtime:
                pace.wait()

    def cycle(self) -> None:
        """Obey commands, step one controller cycle, and read the state where that is due."""
        with self._lock:
            commands, self._submitted = self._submitted, deque()
            stopped, self._stop_pressed = self._stop_pressed, False
        if stopped:
            self._press_stop()
        for command in commands:
            try:
                self._obey(command)
                self._message = ""
            except CommandError as error:
                self._message = str(error)
        self._act_at_rest()
        self._keep_jog()
        self._begin_move()
        self._session.step()
        self._moving = self._moving and not self._move_ended()
        self._cycles += 1
        if self._cycles % self._state_cycles == 0:
            self._state = self._reader.read(self._message)

    def _press_stop(self) -> None:
        self._give_up()
        self._session.hold()
        self._session.press_emergency_stop()

    def _give_up(self) -> None:
        """Forget what was to move the robot."""
        self._moves.clear()
        self._jog_until, self._at_rest, self._moving = None, None, False

    def _obey(self, command: Command) -> None:
        session = self._session
        match command:
            case Jog():
                self._jog(command)
            case MoveJoints() | MoveTool():
                self._moves.append(command)
            case SetMonitorSpeed():
                session.set_monitor_speed(command.share)
            case ChangeOperation() | Reset():
                self._give_up()
                session.hold()
                self._at_rest = command
            case SetGripper(width=None):
                session.flange_from("gripper")
                session.set_gripper_force(command.force or 0.0)
            case SetGripper():
                session.flange_from("gripper")
                session.set_gripper_width(command.width or 0.0)
            case RunBelt():
                if not 1 <= command.number <= len(self._state.belts):
                    raise CommandError(f"RunBelt: number = {command.number}: expected 1 to {len(self._state.belts)}")
                session.run_belt(command.number, command.speed)

    def _jog(self, command: Jog) -> None:
        """Begin or renew a jog; not before the guard has seen the robot rest in manual operation."""
        operation = Operation(self._cell.get_integer("command.operation"))
        if self._is_settling:
            return
        if operation is not Operation.MANUAL:
            raise CommandError("Jog: the cell is in automatic operation: change to manual operation first")
        self._session.set_jog(command.mode, command.deflections, command.frame)
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
            self._session.change_operation(self._at_rest.operation)
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
        except CommandError as error:
            self._moves.clear()
            self._message = str(error)
        else:
            self._moving = True

    def _start(self, move: MoveJoints | MoveTool) -> None:
        session = self._session
        match move:
            case MoveJoints():
                if np.size(move.q) != len(session.joints):
                    raise CommandError(f"MoveJoints: q = {move.q!r}: expected {len(session.joints)} angles")
                session.start_joints(move.q, move.table, move.speed)
            case MoveTool(straight=True):
                session.start_line(move.world_from_tool, move.tool, move.speed)
            case MoveTool():
                session.start_joints(session.joints_for(move.world_from_tool, move.tool), speed=move.speed)

    def _move_ended(self) -> bool:
        """Whether a move is done or was refused; a refused one takes those with it that wait."""
        if self._cell.get_integer("controller.error") != 0:
            self._moves.clear()
            return True
        return self._cell.get_boolean("controller.at_destination")
