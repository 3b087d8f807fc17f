"""Trajectories sampled at the controller cycle: rest-to-rest moves, and runs at constant speed between smooth ramps.

Every ramp is a polynomial whose acceleration starts and ends at zero, so that acceleration is continuous.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

# Extremes of the quintic 10 s³ - 15 s⁴ + 6 s⁵ over unit time and travel.
_QUINTIC_SPEED = 1.875
_QUINTIC_ACCELERATION = 10 / np.sqrt(3)
# Largest acceleration of a speed that rises as 3 s² - 2 s³ over unit time to unit speed.
_RAMP_ACCELERATION = 1.5


def quintic(fraction: ArrayLike) -> Array:
    """Quintic time scaling ``10 s³ - 15 s⁴ + 6 s⁵`` of `fraction`: zero speed and acceleration at 0 and at 1."""
    s = np.clip(np.asarray(fraction, float), 0.0, 1.0)
    return np.asarray(s**3 * (10 - 15 * s + 6 * s**2))


def move_time(travel: ArrayLike, max_speed: ArrayLike, max_acceleration: ArrayLike) -> float:
    """Shortest duration (s) of a synchronised quintic move by `travel` (axes,) within the limits of every axis."""
    distance = np.abs(np.asarray(travel, float))
    by_speed = _QUINTIC_SPEED * distance / np.asarray(max_speed, float)
    by_acceleration = np.sqrt(_QUINTIC_ACCELERATION * distance / np.asarray(max_acceleration, float))
    return float(max(by_speed.max(), by_acceleration.max()))


def move(start: ArrayLike, end: ArrayLike, max_speed: ArrayLike, max_acceleration: ArrayLike, cycle: float) -> Array:
    """Positions (n, axes), n >= 2, every `cycle` seconds of a straight synchronised rest-to-rest move."""
    start, end = np.asarray(start, float), np.asarray(end, float)
    cycles = max(1, int(np.ceil(move_time(end - start, max_speed, max_acceleration) / cycle - 1e-9)))
    return np.asarray(start + quintic(np.arange(cycles + 1) / cycles)[:, None] * (end - start))


@dataclass(frozen=True)
class Run:
    """A rest-to-rest run along a path with constant speed during the exposures.

    Attributes
    ----------
    times, path
        (n,) s and (n,) path coordinate (m or rad), one per cycle; `path` increases and is 0 at the first exposure.
    trigger_from, trigger_to
        Interval (s) in which triggers are enabled; the speed is constant in it.
    """

    times: Array
    path: Array
    trigger_from: float
    trigger_to: float


def run(count: int, interval: float, speed: float, acceleration: float, cycle: float) -> Run:
    """The run with `count` exposures, one every `interval` of path, at `speed` with ramps of at most `acceleration`.

    Path units are m or rad. Ramps last whole cycles. Two cycles of constant speed separate them from the exposures,
    because the controller reaches a set-point one cycle late.
    """
    ramp_cycles = int(np.ceil(_RAMP_ACCELERATION * speed / acceleration / cycle))
    lead = 2
    trigger_from = (ramp_cycles + lead) * cycle
    # Half an interval after the last exposure, so that it fires and no further one does.
    trigger_to = trigger_from + (count - 0.5) * interval / speed
    cruise_cycles = 2 * lead + int(np.ceil((trigger_to - trigger_from) / cycle))
    times: Array = np.arange(2 * ramp_cycles + cruise_cycles + 1, dtype=np.float64) * cycle
    ramp = ramp_cycles * cycle
    cruise_end = ramp + cruise_cycles * cycle
    rising = np.clip(times / ramp, 0.0, 1.0)
    falling = np.clip((times - cruise_end) / ramp, 0.0, 1.0)
    travelled = _ramp_travel(rising) * ramp + np.clip(times - ramp, 0.0, cruise_end - ramp)
    travelled += (falling - _ramp_travel(falling)) * ramp
    path = speed * (travelled - 0.5 * ramp - lead * cycle)
    return Run(times, path, trigger_from, trigger_to)


def _ramp_travel(s: Array) -> Array:
    """Integral of the ramp ``3 s² - 2 s³``, 1/2 at s = 1."""
    return np.asarray(s**3 - s**4 / 2)


def limit_fractions(
    positions: ArrayLike, max_speed: ArrayLike, max_acceleration: ArrayLike, cycle: float
) -> tuple[Array, Array]:
    """Peak speed and peak acceleration per axis (axes,) of sampled positions (n, axes), as fractions of the limits."""
    p = np.asarray(positions, float)
    speed = np.abs(np.diff(p, axis=0)) / cycle
    acceleration = np.abs(np.diff(p, n=2, axis=0)) / cycle**2
    peak_speed = speed.max(0) if len(speed) else np.zeros(p.shape[1])
    peak_acceleration = acceleration.max(0) if len(acceleration) else np.zeros(p.shape[1])
    return peak_speed / np.asarray(max_speed, float), peak_acceleration / np.asarray(max_acceleration, float)
