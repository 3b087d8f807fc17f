"""What a person or a program does with the robot, drawn from a seed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scancell.cell.controller import Frame, Mode, Operation
from scancell.cell.instance import CellInstance
from scancell.nominal.cell import NominalCell

Array = NDArray[np.float64]

_PAUSE = 0.4  # s in which the arm comes to rest between kinds of jogs
_NEAR_HOME = 0.7  # rad


@dataclass(frozen=True)
class Command:
    """A jog or a move from `time` (s) on.

    Attributes
    ----------
    values
        Deflections (joints + 1,) of a jog, target (joints + 1,), rad, of a joint move, or pose (7,) of a line move:
        position, m, and quaternion.
    speed
        Share of the full speed of a move.
    """

    time: float
    mode: Mode
    values: Array
    frame: Frame = Frame.WORLD
    speed: float = 1.0


@dataclass(frozen=True)
class Scenario:
    """Commands from a start (joints + 1,), rad, on, in the order of time, for `duration` s."""

    operation: Operation
    start: Array
    commands: tuple[Command, ...]
    duration: float


def random_scenario(
    operation: Operation, nominal: NominalCell, start: Array, duration: float, rng: np.random.Generator
) -> Scenario:
    """A person who jogs, or moves to random places one after the other, for `duration` s."""
    if operation is Operation.MANUAL:
        return Scenario(operation, start, tuple(_jogs(nominal, start, duration, rng)), duration)
    return Scenario(operation, start, tuple(_moves(nominal, start, rng)), duration)


def random_start(nominal: NominalCell, rng: np.random.Generator) -> Array:
    """Axes (joints + 1,), rad: near home in half of all cases, else anywhere within the limits."""
    lower, upper = nominal.arm.limits
    q = nominal.home + rng.uniform(-_NEAR_HOME, _NEAR_HOME, len(lower))
    if rng.random() < 0.5:
        q = rng.uniform(lower, upper)
    held = [joint.index for joint in nominal.arm.held]
    q[held] = nominal.home[held]
    return np.append(np.clip(q, lower + 0.02, upper - 0.02), 0.0)


def _jogs(nominal: NominalCell, start: Array, duration: float, rng: np.random.Generator) -> list[Command]:
    commands: list[Command] = []
    time, before = 0.1, None
    cartesian = len(nominal.arm.joints) - len(nominal.arm.held) == 6
    while time < duration:
        mode = Mode.TOOL_JOG if cartesian and rng.random() < 0.5 else Mode.JOINT_JOG
        if before is not None and mode is not before:
            commands.append(Command(time, before, np.zeros(len(start))))
            time += _PAUSE
        axes = 6 if mode is Mode.TOOL_JOG else len(start)
        chosen = rng.permutation(axes)[: 1 if rng.random() < 0.6 else int(rng.integers(2, 4))]
        values = np.zeros(len(start))
        values[chosen] = rng.choice([-1.0, 1.0], len(chosen)) * rng.choice([1.0, rng.uniform(0.1, 1.0)])
        commands.append(Command(time, mode, values, Frame(int(rng.integers(2)))))
        time += rng.uniform(0.3, 1.5) if rng.random() < 0.5 else rng.uniform(1.5, duration)
        before = mode
    return commands


def _moves(nominal: NominalCell, start: Array, rng: np.random.Generator) -> list[Command]:
    lower, upper = nominal.arm.limits
    held = [joint.index for joint in nominal.arm.held]
    commands, here = [], start
    for _ in range(int(rng.integers(1, 4))):
        reach = rng.choice([0.3, 1.0, 3.0])
        q = np.clip(here[:-1] + rng.uniform(-reach, reach, len(lower)), lower + 0.02, upper - 0.02)
        q[held] = here[:-1][held]
        here = np.append(q, here[-1] + rng.uniform(-1.5, 1.5))
        speed = float(rng.choice([1.0, rng.uniform(0.1, 1.0)]))
        commands.append(Command(0.1, Mode.JOINT_MOVE, here, speed=speed))
    return commands


class Operator:
    """Gives the commands of a scenario to a cell, jogs at their times, moves one after the other."""

    def __init__(self, cell: CellInstance, scenario: Scenario) -> None:
        self._cell, self._commands = cell, list(scenario.commands)
        self._targets = cell.real_group(cell.axis_names("command."))
        self._jog = cell.real_group([f"command.jog[{i}]" for i in range(1, len(scenario.start) + 1)])
        self._speed = cell.real_group(["command.speed"])
        self._starts = 0
        cell.set_integer("command.operation", scenario.operation)

    @property
    def done(self) -> bool:
        """Whether all commands were given."""
        return not self._commands

    def act(self) -> None:
        """Give the next command if it is its time; to be called once a cycle."""
        time = self._cell.time_us * 1e-6
        if not self._commands or time < self._commands[0].time:
            return
        moves = self._commands[0].mode not in (Mode.JOINT_JOG, Mode.TOOL_JOG)
        if moves and self._starts and not self._cell.get_boolean("controller.at_destination"):
            return
        command = self._commands.pop(0)
        self._cell.set_integer("command.mode", command.mode)
        if moves:
            self._cell.set(self._speed, np.array([command.speed]))
            self._cell.set(self._targets, command.values)
            self._starts += 1
            self._cell.set_integer("command.start", self._starts)
        else:
            self._cell.set_integer("command.jog_frame", command.frame)
            self._cell.set(self._jog, command.values)
