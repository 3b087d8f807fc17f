"""Motions of the table along a configuration map: a lattice of angles and speeds, and the cost of a motion.

Time is divided into steps of constant acceleration. Accelerations are multiples of a quantum, so that speeds and angles
at the ends of steps are multiples of quanta, too: a lattice that constant acceleration never leaves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.planning.configuration_map import ConfigurationMap

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_LEVELS = 4  # quanta of the largest acceleration
_LEAST_SPEEDS = 10  # quanta of the largest speed, at least


@dataclass(frozen=True)
class CostWeights:
    """Weights of the cost of a motion per unit of time, see `Lattice.cost`.

    Attributes
    ----------
    speed, acceleration
        k_ω and k_a, of the squares of table speed and acceleration over their limits.
    """

    speed: float = 0.1
    acceleration: float = 0.1


@dataclass(frozen=True)
class TableMotion:
    """A motion of the table along a map.

    Attributes
    ----------
    start
        Number of the lattice angle at the start.
    accelerations
        (steps,) quanta of acceleration.
    angle, rate
        (columns,) table angle (rad, not wrapped) and speed (rad/s) at each pose of the path.
    cost
        See `Lattice.cost`; the mean over time.
    """

    start: int
    accelerations: Indices
    angle: Array
    rate: Array
    cost: float


class Lattice:
    """Steps, speeds and angles of motions along a map.

    Parameters
    ----------
    map
        Configuration map; its number of columns less one must be a multiple of `samples`.
    samples
        Poses of the path in a step.
    period
        Time between two poses, s.
    max_rate, max_acceleration
        Limits of the table, rad/s, rad/s².
    weights
        Weights of the cost.

    Attributes
    ----------
    steps
        Number of steps of time.
    angles
        Number of lattice angles in a turn.
    rates
        Largest speed in quanta.
    accelerations
        Largest acceleration in quanta.
    """

    def __init__(
        self,
        map: ConfigurationMap,
        samples: int,
        period: float,
        max_rate: float,
        max_acceleration: float,
        weights: CostWeights,
    ) -> None:
        self.map, self.samples, self.weights = map, samples, weights
        self.steps, rest = divmod(map.columns - 1, samples)
        if rest or not self.steps:
            raise ValueError(f"columns = {map.columns}: expected a multiple of samples = {samples}, plus 1")
        self._period, self._step = period, samples * period
        quantum = min(max_acceleration / _LEVELS, max_rate / (_LEAST_SPEEDS * self._step))
        self.angles = int(np.ceil(2 * np.pi / (quantum * self._step**2 / 2)))
        self._angle = 2 * np.pi / self.angles
        self._quantum = 2 * self._angle / self._step**2
        self.rates = int(max_rate / (self._quantum * self._step) + 1e-9)
        self.accelerations = min(int(max_acceleration / self._quantum + 1e-9), _LEVELS)
        self._max_rate, self._max_acceleration = max_rate, max_acceleration
        self._offset = period * np.arange(1, samples + 1)

    def samples_of(self, angle: ArrayLike, rate: ArrayLike, acceleration: ArrayLike) -> tuple[Indices, Array]:
        """Map rows and table speeds (rad/s), (..., samples), of the poses in a step from lattice states (...,)."""
        angle, rate, acceleration = (np.asarray(x, float)[..., None] for x in (angle, rate, acceleration))
        speed = self._quantum * (rate * self._step + acceleration * self._offset)
        turned = self._quantum * (rate * self._step * self._offset + acceleration * self._offset**2 / 2)
        position = (angle * self._angle + turned) * (self.map.rows / (2 * np.pi))
        return np.rint(position).astype(np.int64) % self.map.rows, speed

    def after(self, angle: ArrayLike, rate: ArrayLike, acceleration: ArrayLike) -> tuple[Indices, Indices]:
        """Lattice angle and speed, (...,), after a step from lattice states (...,)."""
        angle, rate, acceleration = (np.asarray(x, np.int64) for x in (angle, rate, acceleration))
        return (angle + 2 * rate + acceleration) % self.angles, rate + acceleration

    def can_stop(self, rate: ArrayLike, steps_left: ArrayLike) -> NDArray[np.bool_]:
        """Whether a speed can be brought to 0 in the steps that are left, (...,)."""
        return np.asarray(np.abs(rate) <= self.accelerations * np.asarray(steps_left))

    def cost(self, step: ArrayLike, angle: ArrayLike, rate: ArrayLike, acceleration: ArrayLike) -> Array:
        """Cost (...,) of steps from lattice states (...,), whose cells must be evaluated; infinite where forbidden.

        The mean over the step's poses of ``1 / f - 1 + k_ω (ω / ω_max)² + k_a (a / a_max)²``, per step of the path.
        """
        row, speed = self.samples_of(angle, rate, acceleration)
        column = np.asarray(step, np.int64)[..., None] * self.samples + np.arange(1, self.samples + 1)
        quality = self.map.quality[column, row]
        allowed = (self.map.lowest_rate[column, row] <= speed) & (speed <= self.map.highest_rate[column, row])
        with np.errstate(divide="ignore"):
            of_cells = np.where(allowed, 1.0 / quality - 1.0, np.inf)
        return np.asarray(of_cells.mean(-1) + self.motion_cost(speed, acceleration))

    def motion_cost(self, speed: Array, acceleration: ArrayLike) -> Array:
        """Cost (...,) of speeds (..., samples), rad/s, and accelerations (...,), quanta."""
        of_speed = self.weights.speed * ((speed / self._max_rate) ** 2).mean(-1)
        of_acceleration = self.weights.acceleration * (
            np.asarray(acceleration, float) * self._quantum / self._max_acceleration
        ) ** 2
        return np.asarray(of_speed + of_acceleration)

    def motion(self, start: int, accelerations: ArrayLike) -> TableMotion:
        """The motion from rest at lattice angle `start` with these accelerations (steps,), quanta."""
        accelerations = np.asarray(accelerations, np.int64)
        rate = np.concatenate([[0], np.cumsum(accelerations)])
        lattice = start + np.concatenate([[0], np.cumsum(2 * rate[:-1] + accelerations)])
        turned = self._quantum * (
            rate[:-1, None] * self._step * self._offset + accelerations[:, None] * self._offset**2 / 2
        )
        angle = lattice[:-1, None] * self._angle + turned
        speed = self._quantum * (rate[:-1, None] * self._step + accelerations[:, None] * self._offset)
        cost = self.cost(np.arange(self.steps), lattice[:-1], rate[:-1], accelerations)
        return TableMotion(
            int(start),
            accelerations,
            np.concatenate([[start * self._angle], angle.ravel()]),
            np.concatenate([[0.0], speed.ravel()]),
            float(cost.mean()),
        )
