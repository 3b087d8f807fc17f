"""Commands of an operator or a program to the robot."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scancell.cell.controller import JogFrame, Mode, Operation
from scancell.cell.instance import CellInstance
from scancell.cell.program import Program, Segment
from scancell.cell.program_file import program_data

Array = NDArray[np.float64]

JOGS = (Mode.JOINT_JOG, Mode.CARTESIAN_JOG)
_EMERGENCY_STOP = 3  # of controller.state
_RESET_CYCLES = 3  # of the controller, from a reset to the next command
_LINE = [f"command.target.{name}" for name in (*(f"position[{i}]" for i in (1, 2, 3)),
                                               *(f"orientation[{i}]" for i in (1, 2, 3, 4)))]  # fmt: skip


@dataclass(frozen=True)
class Command:
    """A jog or a motion from `time` (s) on.

    Attributes
    ----------
    values
        Deflections (joints + 1,) of a jog; target (joints + 1,), rad, of a joint move; position, m, quaternion and
        table angle (8,) of a line move; set-points (n, joints + 1), rad, of a program, one per controller cycle.
    frame
        Of a Cartesian jog.
    speed
        Share of the full speed of a move.
    """

    time: float
    mode: Mode
    values: Array
    frame: JogFrame = JogFrame.WORLD
    speed: float = 1.0


@dataclass(frozen=True)
class Scenario:
    """Commands from a start (joints + 1,), rad, on, in the order of time, for `duration` s.

    Attributes
    ----------
    speed
        Largest share of the full speed.
    resets
        Number of stops after which the operator resets the controller and gives the last command again.
    """

    operation: Operation
    start: Array
    commands: tuple[Command, ...]
    duration: float
    speed: float = 1.0
    resets: int = 0


class Operator:
    """Gives the commands of a scenario to a cell: jogs at their times, moves one after the other.

    Parameters
    ----------
    cell
        A running instance.
    scenario
        Its commands.
    cycle
        Of the controller, s.
    folder
        For the files of programs.
    """

    def __init__(self, cell: CellInstance, scenario: Scenario, cycle: float, folder: Path) -> None:
        self._cell, self._commands = cell, list(scenario.commands)
        self._cycle, self._folder = cycle, folder
        axes = cell.axis_names("command.")
        self._targets, self._line = cell.real_group(axes), cell.real_group(_LINE)
        self._jog = cell.real_group([f"command.jog[{i}]" for i in range(1, len(axes) + 1)])
        self._speed = cell.real_group(["command.speed"])
        self._starts = 0
        self._resets_left, self._resets, self._waits = scenario.resets, 0, 0
        self._last: Command | None = None
        cell.set_integer("command.operation", scenario.operation)

    @property
    def next_time(self) -> float:
        """Time of the next command, s."""
        return self._commands[0].time if self._commands else np.inf

    @property
    def done(self) -> bool:
        """Whether all commands were given."""
        return not self._commands

    @property
    def jogs(self) -> bool:
        """Whether a jog is pressed."""
        return self._last is not None and self._last.mode in JOGS and bool(self._last.values.any())

    def act(self, state: int) -> bool:
        """Give the next command if it is its time, or reset a stopped controller; to be called once a cycle.

        Returns whether the operator waits for nothing: False while there is a stop to reset.
        """
        if state == _EMERGENCY_STOP and self._resets_left:
            self._reset()
            return False
        if self._waits:
            self._waits = 0
            assert self._last is not None
            self._give(self._last)
        time = self._cell.time_us * 1e-6
        if self._commands and time >= self._commands[0].time and self._is_free(self._commands[0]):
            self._give(self._commands.pop(0))
        return True

    def _is_free(self, command: Command) -> bool:
        moved = command.mode not in JOGS and self._starts > 0
        return not moved or self._cell.get_boolean("controller.at_destination")

    def _reset(self) -> None:
        """Let go of the jog and reset the controller as soon as the robot is at rest."""
        if not self._waits:
            self._cell.set(self._jog, np.zeros(self._jog.count))
            self._cell.set_integer("command.mode", Mode.HOLD)
        elif self._waits % _RESET_CYCLES == 0 and not self._cell.get_boolean("controller.moving"):
            self._resets += 1
            self._cell.set_integer("command.reset", self._resets)
            self._resets_left -= 1
        self._waits += 1

    def _give(self, command: Command) -> None:
        self._last = command
        self._cell.set_integer("command.mode", command.mode)
        if command.mode in JOGS:
            self._cell.set_integer("command.jog_frame", command.frame)
            self._cell.set(self._jog, command.values)
            return
        self._cell.set(self._speed, np.array([command.speed]))
        if command.mode is Mode.LINE_MOVE:
            self._cell.set(self._line, command.values[:-1])
            self._cell.set(self._targets, np.append(np.zeros(self._targets.count - 1), command.values[-1]))
        elif command.mode is Mode.PROGRAM:
            self._load(command.values)
        else:
            self._cell.set(self._targets, command.values)
        self._starts += 1
        self._cell.set_integer("command.start", self._starts)

    def _load(self, points: Array) -> None:
        times = np.asarray(self._cycle * np.arange(len(points)), np.float64)
        program = Program((Segment(1, times, points[:, :-1], np.asarray(points[:, -1], np.float64)),))
        path = (self._folder / f"program{self._starts}.json").absolute()
        path.write_text(json.dumps(program_data(program)))
        self._cell.set_string("command.program", str(path))
        self._cell.set_integer("command.segment", 1)


def pressed(
    start: Array,
    mode: Mode,
    values: Array,
    frame: JogFrame,
    duration: float,
    presses: Iterable[tuple[float, float]] = (),
    speed: float = 1.0,
    resets: int = 0,
) -> Scenario:
    """An operator who jogs from `start` (joints + 1,) with deflections `values` (joints + 1,).

    `presses` are times, s, at which the deflections change, and the factor that they have from then on; without, the
    jog is pressed all the time.
    """
    commands = [Command(time, mode, share * values, frame) for time, share in presses or [(0.1, 1.0)]]
    return Scenario(Operation.MANUAL, start, tuple(commands), duration, speed, resets)
