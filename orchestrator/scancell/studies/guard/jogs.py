"""Random jogs, moves and programs, from which scenarios are made."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from scancell.cell.controller import JogFrame, Mode, Operation
from scancell.geometry import pose
from scancell.nominal.cell import NominalCell
from scancell.studies.guard.scenario import Command, Scenario

Array = NDArray[np.float64]

_CYCLE = 0.016  # s
_WITHIN = 0.9  # of the limits of the axes
_SAMPLES = 400
_LONGER = 1.05
_LONGEST = 120.0  # s
_RAMP = 0.15  # share of the time in which the speed rises, and falls

BEGIN = 0.1  # s at which the first command is given
_PAUSE = 0.4  # s in which the arm comes to rest between kinds of jogs
_NEAR_HOME = 0.7  # rad
_INSIDE = 0.02  # rad, of the limits
_LINE, _LINE_TURN = 0.5, 1.0  # m and rad, of a straight move at most
_PERSON_SLOWEST = 0.1  # of a person's own deflections


def program_points(nominal: NominalCell, through: Sequence[Array], speed: float, cycle: float = _CYCLE) -> Array:
    """Set-points (n, joints + 1), rad, one per `cycle` (s), through points at a share of the full speed.

    The path is a cubic spline through the points; its speed rises smoothly from rest, is even, and falls to rest.
    """
    points = np.array(through)
    lengths = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1) + 1e-9))
    path = CubicSpline(lengths / lengths[-1], points)
    share = np.linspace(0.0, 1.0, _SAMPLES)
    axes = path(_eased(share))
    rates = np.abs(np.gradient(axes, share, axis=0)).max(0)
    bends = np.abs(np.gradient(np.gradient(axes, share, axis=0), share, axis=0)).max(0)
    by_speed = float((rates / (_WITHIN * speed * nominal.axis_max_speed)).max())
    by_bend = float(np.sqrt(bends / (_WITHIN * nominal.axis_max_acceleration)).max())
    cycles = max(int(np.ceil(min(_LONGER * max(by_speed, by_bend), _LONGEST) / cycle)), 8)
    return np.asarray(path(_eased(np.linspace(0.0, 1.0, cycles + 1))))


def _eased(share: Array) -> Array:
    """Course (n,) from 0 to 1, at rest with no acceleration at both ends; even but for the `_RAMP` at each end."""
    ramp = np.clip(np.minimum(share, 1.0 - share) / _RAMP, 0.0, 1.0)
    gained = _RAMP * ramp**3 * (1.0 - ramp / 2)  # integral of the speed ramp² (3 - 2 ramp)
    even = gained + np.clip(np.minimum(share, 1.0 - share) - _RAMP, 0.0, None)
    total = 1.0 - _RAMP
    return np.asarray(np.where(share < 0.5, even, total - even) / total)


@dataclass(frozen=True)
class Jog:
    """A jog with deflections `values` (joints + 1,), the largest of which is 1."""

    mode: Mode
    values: Array
    frame: JogFrame


class Draws:
    """Random starts, jogs and moves of an arm.

    Parameters
    ----------
    nominal
        Kinematics.
    """

    def __init__(self, nominal: NominalCell) -> None:
        self._nominal = nominal
        self._held = [joint.index for joint in nominal.arm.held]
        self._cartesian = len(nominal.arm.joints) - len(self._held) == 6
        lower, upper = nominal.arm.limits
        self._lower, self._upper = lower + _INSIDE, upper - _INSIDE

    def start(self, rng: np.random.Generator) -> Array:
        """Axes (joints + 1,), rad: near home in half of all cases, else anywhere within the limits; any table angle."""
        home = self._nominal.home
        q = home + rng.uniform(-_NEAR_HOME, _NEAR_HOME, len(home))
        if rng.random() < 0.5:
            q = rng.uniform(self._lower, self._upper)
        q[self._held] = home[self._held]
        return np.append(np.clip(q, self._lower, self._upper), rng.uniform(-np.pi, np.pi))

    def jog(self, rng: np.random.Generator) -> Jog:
        """Of one axis or several, of joints, of the tool in both frames, of the table, or of arm and table together."""
        joints = len(self._nominal.home)
        values = np.zeros(joints + 1)
        mode = Mode.CARTESIAN_JOG if self._cartesian and rng.random() < 0.5 else Mode.JOINT_JOG
        axes = 6 if mode is Mode.CARTESIAN_JOG else joints
        count = 1 if rng.random() < 0.5 else int(rng.integers(2, axes + 1))
        turns = rng.random()
        if turns > 0.15:  # else the table alone
            chosen = rng.permutation(axes)[:count]
            values[chosen] = rng.choice([-1.0, 1.0], count) * rng.choice([np.ones(count), rng.uniform(0.1, 1.0, count)])
        if turns < 0.35:
            values[-1] = rng.choice([-1.0, 1.0])
        return Jog(mode, values / np.abs(values).max(), JogFrame(int(rng.integers(2))))

    def person(self, start: Array, speed: float, duration: float, rng: np.random.Generator) -> Scenario:
        """An operator who jogs in one direction after another, at `speed` or down to a tenth of it."""
        commands: list[Command] = []
        time, before = BEGIN, None
        while time < duration:
            jog = self.jog(rng)
            if before is not None and jog.mode is not before:
                commands.append(Command(time, before, np.zeros(len(start))))
                time += _PAUSE
            share = speed * float(rng.choice([1.0, rng.uniform(_PERSON_SLOWEST, 1.0)]))
            commands.append(Command(time, jog.mode, share * jog.values, jog.frame))
            time += rng.uniform(0.3, 1.5) if rng.random() < 0.5 else rng.uniform(1.5, duration)
            before = jog.mode
        return Scenario(Operation.MANUAL, start, tuple(commands), duration, speed)

    def table_jog(self, start: Array, speed: float, duration: float, rng: np.random.Generator) -> Scenario:
        """An operator who jogs the table alone, in one direction."""
        values = np.append(np.zeros(len(start) - 1), speed * rng.choice([-1.0, 1.0]))
        return Scenario(Operation.MANUAL, start, (Command(BEGIN, Mode.JOINT_JOG, values),), duration, speed)

    def moves(self, start: Array, speed: float, duration: float, rng: np.random.Generator) -> Scenario:
        """Joint moves, straight ones and those of a program to random places, one after the other."""
        commands, here = [], start
        for _ in range(int(rng.integers(1, 4))):
            commands.append(self.move(here, speed, rng))
            if commands[-1].mode is Mode.PROGRAM and len(commands) > 1:
                commands.pop()  # a program begins where the axes are
                continue
            if commands[-1].mode is not Mode.JOINT_MOVE:
                break  # where exactly it ends is not known
            here = commands[-1].values
        return Scenario(Operation.AUTOMATIC, start, tuple(commands), duration, speed)

    def move(self, start: Array, speed: float, rng: np.random.Generator) -> Command:
        """One move from a start (joints + 1,)."""
        kind = rng.choice([Mode.JOINT_MOVE, Mode.LINE_MOVE, Mode.PROGRAM])
        end = self._target(start, rng)
        if kind == Mode.LINE_MOVE and self._cartesian:
            sensor = self._nominal.world_from_sensor(start[:-1])
            shift = rng.uniform(-_LINE, _LINE, 3)
            turn = pose.exp_rotation(rng.choice([0.0, 1.0]) * rng.uniform(-_LINE_TURN, _LINE_TURN, 3))
            target = pose.from_rotation(turn @ sensor[:3, :3], sensor[:3, 3] + shift)
            return line_move(target, float(end[-1]), speed)
        if kind == Mode.PROGRAM:
            through = [self._target(start, rng) for _ in range(int(rng.integers(1, 3)))]
            return self.program([start, *through, end], speed)
        return Command(BEGIN, Mode.JOINT_MOVE, end, speed=speed)

    def program(self, through: list[Array], speed: float) -> Command:
        """A program through points (joints + 1,)."""
        return Command(BEGIN, Mode.PROGRAM, program_points(self._nominal, through, speed), speed=speed)

    def _target(self, start: Array, rng: np.random.Generator) -> Array:
        reach = rng.choice([0.3, 1.0, 3.0])
        q = np.clip(start[:-1] + rng.uniform(-reach, reach, len(start) - 1), self._lower, self._upper)
        q[self._held] = start[:-1][self._held]
        return np.append(q, start[-1] + rng.uniform(-1.5, 1.5))


def line_move(world_from_sensor: Array, table: float, speed: float) -> Command:
    """A straight move of the sensor to a pose (4, 4), while the table turns to an angle, rad."""
    quaternion = pose.quaternion_from_rotation(world_from_sensor[:3, :3])
    values = np.concatenate([world_from_sensor[:3, 3], quaternion, [table]])
    return Command(BEGIN, Mode.LINE_MOVE, values, speed=speed)
