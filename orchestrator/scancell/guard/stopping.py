"""Stops in closed form: all axes brake in proportion, on a straight line in their positions.

Positions, rates and accelerations of an axis are in rad, rad/s and rad/s², those of a prismatic one in m, m/s and m/s².

Until the brakes act the axes keep their rates for the reaction time T.  The axis that needs longest to brake at its
deceleration sets the braking time B, in which all rates fall to 0 linearly: the axes travel as far as in T + B / 2 at
their rates.  For one axis that is v T + v² / (2 a).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.arrays import Array
from scancell.geometry import pose
from scancell.guard.parts import JogLimits, Tool
from scancell.nominal.cell import NominalCell

_STEPS = 8  # of Newton's method
_FOUND = 1e-6  # m and rad: poses that are met; one step further the error is that squared
_NO_TURN = 1e-9  # rad/s


@dataclass(frozen=True)
class MeasuredState:
    """Measured positions of all axes (axes,), rad or m, at `time` (s) by the controller's clock."""

    time: float
    axes: Array


class Path(Enum):
    """How a motion by hand continues."""

    JOINT = "joint-interpolated"  # the rates of the joints stay (Eq. 9)
    BASE = "Cartesian in the base frame"  # the tool's velocity and angular velocity in the base frame stay (Eq. 10)
    TOOL = "Cartesian in the tool frame"  # those in the tool's own frame stay: its origin follows a helix


class Kind(Enum):
    """The simplest kind of motion that is consistent with measured states.

    One of several joints cannot be distinguished from one that combines translation and rotation in a few states: both
    are `COMBINED`.
    """

    REST = "at rest"
    TABLE = "table"
    FURTHER_AXES = "further axes"  # beside the table, which may turn, too
    SINGLE_JOINT = "single joint"
    TRANSLATION = "translation"
    ROTATION = "rotation"
    COMBINED = "combined"


@dataclass(frozen=True)
class Hypothesis:
    """A motion by hand that is possible from the last measured state on.

    Attributes
    ----------
    path
        How it continues.
    state
        Last measured state.
    rates
        Rates of all axes, (axes,).
    rate_error
        Bound on the error of each rate, (axes,).
    rate_age
        Time from which the rates are, before that of the state, s.
    """

    path: Path
    state: MeasuredState
    rates: Array
    rate_error: Array
    rate_age: float


@dataclass(frozen=True)
class Identification:
    """The simplest motion that is consistent with the measured states, and all possible ones."""

    kind: Kind
    hypotheses: tuple[Hypothesis, ...]


@dataclass(frozen=True)
class WorstCase:
    """Assumptions for which a stop must be proved; arrays are one for all axes or (axes,).

    Attributes
    ----------
    age
        Age of a measured state when it is used, s.
    period
        Between two checks, s: a stop that is not commanded now may be commanded one period later.
    delay
        From the command to the beginning of braking, s; the rest of the controller's cycle included.
    deceleration
        That every axis attains.
    angle_error
        Error of the measured positions.
    unseen
        Largest accelerations of unseen changes of the motion by the operator; None: it continues as identified.
    """

    age: float
    period: float
    delay: float
    deceleration: ArrayLike
    angle_error: ArrayLike
    unseen: JogLimits | None = None

    @property
    def reaction(self) -> float:
        """Time from the measured state to the beginning of braking, s."""
        return self.age + self.period + self.delay


@dataclass(frozen=True)
class Stop:
    """The latest possible stop.

    Attributes
    ----------
    braking_time
        Time from the beginning of braking to the standstill, s.
    deviation
        Bound on the deviation of the axes from the predicted motion on the way, (axes,), without changes by the
        operator.
    unseen
        What such changes add to the way is what their accelerations do in half of this, s².
    """

    braking_time: float
    deviation: Array
    unseen: float


def braking_time(rates: ArrayLike, deceleration: ArrayLike) -> float:
    """Time (s) in which axes of `rates` (axes,) brake in proportion at `deceleration`, one or (axes,)."""
    return float((np.abs(np.asarray(rates, float)) / np.asarray(deceleration, float)).max(initial=0.0))


def latest_stop(hypothesis: Hypothesis, worst: WorstCase) -> Stop:
    """The longest stop of a hypothesis in the worst case."""
    rates, error = np.abs(hypothesis.rates), hypothesis.rate_error
    reaction = worst.reaction
    # The rates are as old as the middle of the states, the position is that of the last one.
    changing = reaction + hypothesis.rate_age
    change = worst.unseen.axes * changing if worst.unseen is not None else 0.0
    braking = braking_time(rates + error + change, worst.deceleration)
    deviation = np.asarray(worst.angle_error, float) + error * reaction + error * braking / 2
    unseen = changing**2 - hypothesis.rate_age**2 + changing * braking if worst.unseen is not None else 0.0
    return Stop(braking, np.asarray(deviation), unseen)


class Predictor:
    """Predicts axes along hypotheses.

    Joint limits are not taken into account: a prediction goes further than the robot can.
    """

    def __init__(self, nominal: NominalCell) -> None:
        self._tool = Tool(nominal)

    def axes(self, hypotheses: Sequence[Hypothesis], times: Array) -> Array:
        """Positions (h, n, axes) of h hypotheses at increasing `times` (h, n) after their states, s.

        Cartesian paths solve the inverse kinematics by Newton's method from joint-interpolated motion. Behind a place
        that it does not reach, such as a singular position, the joints keep the rates that they had there. What carries
        the arm rests meanwhile.
        """
        start = np.array([hypothesis.state.axes for hypothesis in hypotheses])
        rates = np.array([hypothesis.rates for hypothesis in hypotheses])
        found = np.asarray(start[:, None] + times[..., None] * rates[:, None])
        bent = [i for i, hypothesis in enumerate(hypotheses) if hypothesis.path is not Path.JOINT]
        if bent:
            in_tool = np.array([hypotheses[i].path is Path.TOOL for i in bent])
            joints = self._tool.joints
            found[bent, :, :joints] = self._cartesian(start[bent], rates[bent, :joints], in_tool, times[bent])
        return found

    def _cartesian(self, start: Array, rates: Array, in_tool: NDArray[np.bool_], times: Array) -> Array:
        """Joints (h, n, joints) of Cartesian motion from `start` (h, axes) with `rates` (h, joints) there."""
        here, jacobian = self._tool.poses(start)
        twist = (jacobian @ rates[..., None])[..., 0]
        wanted = _poses(here, twist, in_tool, times)
        first, others = np.split(start, [self._tool.joints], 1)
        guess = first[:, None] + times[..., None] * rates[:, None]
        at_rest = np.repeat(others, times.shape[1], 0)
        joints, met = self._solved(guess.reshape(-1, first.shape[1]), at_rest, wanted.reshape(-1, 4, 4))
        return _continued(joints.reshape(guess.shape), met.reshape(times.shape), guess, times)

    def _solved(self, joints: Array, others: Array, wanted: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Joints (n, joints) at which the tool has the poses (n, 4, 4), and for which of them that is the case.

        They are looked for from `joints` on, with the other axes at `others` (n, others).
        """
        for _ in range(_STEPS):
            here, jacobian = self._tool.poses(np.hstack([joints, others]))
            miss = np.concatenate(
                [wanted[:, :3, 3] - here[:, :3, 3], _rotation_between(here[:, :3, :3], wanted[:, :3, :3])], 1
            )
            met = np.abs(miss).max(1) <= _FOUND
            try:
                step = self._tool.rates(jacobian, miss)
            except np.linalg.LinAlgError:
                break
            joints = joints + np.clip(step, -0.5, 0.5)
            if met.all():
                break
        return joints, met


def _poses(start: Array, twist: Array, in_tool: NDArray[np.bool_], times: Array) -> Array:
    """Poses (h, n, 4, 4) at `times` (h, n), s, of motion from `start` (h, 4, 4) with twists (h, 6) there, world axes.

    The velocity keeps its direction in the world, or turns with the tool.
    """
    velocity, turn = twist[:, None, :3], twist[:, None, 3:]
    t = times[..., None]
    rotation = pose.exp_rotation(turn * t) @ start[:, None, :3, :3]
    straight = velocity * t
    speed = np.linalg.norm(turn, axis=-1, keepdims=True)
    turning = np.maximum(speed, _NO_TURN)
    axis = turn / turning
    along = (velocity * axis).sum(-1, keepdims=True) * axis
    across = velocity - along
    angle = turning * t
    bow = np.sin(angle) / turning * across + 2 * np.sin(angle / 2) ** 2 / turning * np.cross(axis, across)
    helix = np.where(speed > _NO_TURN, along * t + bow, straight)
    moved = np.where(in_tool[:, None, None], helix, straight)
    return pose.from_rotation(rotation, start[:, None, :3, 3] + moved)


def _rotation_between(here: Array, wanted: Array) -> Array:
    """Rotation vectors (n, 3), world axes, from rotations (n, 3, 3) to others, as long as the sines of the angles."""
    turn = wanted @ np.swapaxes(here, -1, -2)
    return np.asarray((turn - np.swapaxes(turn, -1, -2))[:, (2, 0, 1), (1, 2, 0)] / 2)


def _continued(joints: Array, met: NDArray[np.bool_], guess: Array, times: Array) -> Array:
    """Joints (h, n, joints) with those behind the first place that is not `met` (h, n) at the rates before it.

    There are such rates from the third place on; before, all are those of `guess`.
    """
    for row in np.flatnonzero(~met.all(1)):
        first = int(np.argmin(met[row]))
        if first < 2:
            joints[row] = guess[row]
            continue
        last = (joints[row, first - 1] - joints[row, first - 2]) / (times[row, first - 1] - times[row, first - 2])
        joints[row, first:] = joints[row, first - 1] + (times[row, first:] - times[row, first - 1])[:, None] * last
    return joints
