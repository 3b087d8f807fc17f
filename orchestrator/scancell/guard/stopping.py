"""Stops in closed form: all axes brake in proportion, on a straight line in their angles.

Until the brakes act the axes keep their rates for the reaction time T.  The axis that needs longest to brake at its
deceleration sets the braking time B, in which all rates fall to 0 linearly: the axes travel as far as in T + B / 2 at
their rates.  For one axis that is v T + v² / (2 a).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.guard.motion import Hypothesis
from scancell.guard.unseen import JogLimits

Array = NDArray[np.float64]


@dataclass(frozen=True)
class WorstCase:
    """Assumptions for which a stop must be proved; arrays are one for all axes or (axes,).

    Attributes
    ----------
    age
        Of a measured state when it is used, s.
    period
        Between two checks, s: a stop that is not commanded now may be commanded one period later.
    delay
        From the command to the beginning of braking, s; the rest of the controller's cycle included.
    deceleration
        That every axis attains, rad/s².
    angle_error
        Of the measured angles, rad.
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
        Bound on the deviation of the axes from the predicted motion on the way, (axes,), rad, without changes by
        the operator.
    unseen
        What such changes add to the way is what their accelerations do in half of this, s².
    """

    braking_time: float
    deviation: Array
    unseen: float


def braking_time(rates: ArrayLike, deceleration: ArrayLike) -> float:
    """Time (s) in which axes of `rates` (axes,), rad/s, brake in proportion at `deceleration`, rad/s²."""
    return float((np.abs(np.asarray(rates, float)) / np.asarray(deceleration, float)).max(initial=0.0))


def stopping_motion(rates: ArrayLike, reaction: float, deceleration: ArrayLike, times: ArrayLike) -> Array:
    """Travel (n, axes), rad, at `times` (n,) after the measured state, braking from `reaction` on; s, rad/s, rad/s²."""
    rates, times = np.asarray(rates, float), np.asarray(times, float)
    braking = braking_time(rates, deceleration)
    since = np.clip(times - reaction, 0.0, braking)
    lost = since**2 / (2 * braking) if braking > 0 else 0.0
    return np.asarray((np.minimum(times, reaction) + since - lost)[:, None] * rates)


def stopping_travel(rates: ArrayLike, reaction: float, deceleration: ArrayLike) -> Array:
    """Travel (axes,), rad, until axes of `rates` (axes,), rad/s, stand: reaction in s, deceleration in rad/s²."""
    return np.asarray(np.asarray(rates, float) * (reaction + braking_time(rates, deceleration) / 2))


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
