"""Motions of the table along a configuration map: a lattice of angles and speeds, and the cost of a motion.

Time is divided into steps of constant acceleration. Accelerations are multiples of a quantum, so that speeds and angles
at the ends of steps are multiples of quanta, too: a lattice that constant acceleration never leaves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.arrays import Array, Indices
from scancell.config.scan import WeightsDescription
from scancell.planning.path_map.configuration_map import ConfigurationMap

_LEVELS = 4  # quanta of the largest acceleration
_LEAST_SPEEDS = 10  # quanta of the largest speed, at least


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
    configurations
        The map; its number of columns less one must be a multiple of `samples`.
    samples
        Poses of the path in a step.
    period
        Time between two poses, s.
    max_rate, max_acceleration
        Limits of the table, or of the axis that the map is of, rad/s, rad/s², or m/s, m/s².
    weights
        Weights of the cost of a motion, see `cost`.

    Attributes
    ----------
    map
        The map.
    steps
        Number of steps of time.
    span
        A turn, or the span of positions of another axis, rad or m.
    angles
        Number of lattice angles in it.
    rates
        Largest speed in quanta.
    accelerations
        Largest acceleration in quanta.
    """

    def __init__(
        self,
        configurations: ConfigurationMap,
        samples: int,
        period: float,
        max_rate: float,
        max_acceleration: float,
        weights: WeightsDescription,
    ) -> None:
        self.map, self.samples, self.weights = configurations, samples, weights
        self.steps, rest = divmod(configurations.columns - 1, samples)
        if rest or not self.steps:
            raise ValueError(f"columns = {configurations.columns}: expected a multiple of samples = {samples}, plus 1")
        self._period, self._step, self._low = period, samples * period, configurations.drive.low
        self.span = configurations.drive.span
        quantum = min(max_acceleration / _LEVELS, max_rate / (_LEAST_SPEEDS * self._step))
        self.angles = int(np.ceil(self.span / (quantum * self._step**2 / 2)))
        self._angle = self.span / self.angles
        self._quantum = 2 * self._angle / self._step**2
        self.rates = int(max_rate / (self._quantum * self._step) + 1e-9)
        self.accelerations = min(int(max_acceleration / self._quantum + 1e-9), _LEVELS)
        self._max_rate, self._max_acceleration = max_rate, max_acceleration

    def cells(
        self, step: ArrayLike, angle: ArrayLike, rate: ArrayLike, acceleration: ArrayLike, only_end: bool = False
    ) -> tuple[Indices, Indices, Array]:
        """Map columns, rows and table speeds (rad/s), (..., samples), of the poses in steps from lattice states (...,).

        `only_end` leaves out all poses but the last one of a step.
        """
        angle, rate, acceleration = (np.asarray(x, float)[..., None] for x in (angle, rate, acceleration))
        number = np.array([self.samples]) if only_end else np.arange(1, self.samples + 1)
        turned, speed = self._within_step(rate, acceleration, self._period * number)
        row = np.rint((angle * self._angle + turned) * (self.map.rows / self.span)).astype(np.int64) % self.map.rows
        column = np.asarray(step, np.int64)[..., None] * self.samples + number
        return np.broadcast_to(column, row.shape), row, speed

    def _within_step(
        self, rate: Array | Indices, acceleration: Array | Indices, since: ArrayLike
    ) -> tuple[Array, Array]:
        """Angle turned (rad) and speed (rad/s), of broadcast shape, at a time (s) since the start of a step."""
        since = np.asarray(since, float)
        turned = self._quantum * (rate * self._step * since + acceleration * since**2 / 2)
        return np.asarray(turned), np.asarray(self._quantum * (rate * self._step + acceleration * since))

    def row(self, angle: ArrayLike) -> Indices:
        """Map rows (...,) of lattice angles (...,)."""
        place = np.asarray(angle, float) * (self.map.rows / self.angles)
        return np.asarray(np.rint(place).astype(np.int64) % self.map.rows)

    def after(self, angle: ArrayLike, rate: ArrayLike, acceleration: ArrayLike) -> tuple[Indices, Indices]:
        """Lattice angle and speed, (...,), after a step from lattice states (...,)."""
        angle, rate, acceleration = (np.asarray(x, np.int64) for x in (angle, rate, acceleration))
        return (angle + 2 * rate + acceleration) % self.angles, rate + acceleration

    def can_stop(self, rate: ArrayLike, steps_left: ArrayLike) -> NDArray[np.bool_]:
        """Whether a speed can be brought to 0 in the steps that are left, (...,)."""
        return np.asarray(np.abs(rate) <= self.accelerations * np.asarray(steps_left))

    def cost(
        self, step: ArrayLike, angle: ArrayLike, rate: ArrayLike, acceleration: ArrayLike, only_end: bool = False
    ) -> Array:
        """Cost (...,) of steps from lattice states (...,), whose cells must be evaluated; infinite where forbidden.

        The mean over the step's poses of ``1 / f - 1 + k_ω (ω / ω_max)² + k_a (a / a_max)²``, per step of the path.
        """
        column, row, speed = self.cells(step, angle, rate, acceleration, only_end)
        quality = self.map.quality[column, row]
        allowed = (self.map.lowest_rate[column, row] <= speed) & (speed <= self.map.highest_rate[column, row])
        with np.errstate(divide="ignore"):
            of_cells = np.where(allowed, 1.0 / quality - 1.0, np.inf)
        of_speed = self.weights.table_speed * ((speed / self._max_rate) ** 2).mean(-1)
        fraction = np.asarray(acceleration, float) * (self._quantum / self._max_acceleration)
        return np.asarray(of_cells.mean(-1) + of_speed + self.weights.table_acceleration * fraction**2)

    def effort(self, motion: TableMotion) -> float:
        """The terms of the cost of a motion for speed and acceleration; the mean over time."""
        acceleration = motion.accelerations * (self._quantum / self._max_acceleration)
        of_speed = self.weights.table_speed * float(((motion.rate[1:] / self._max_rate) ** 2).mean())
        return of_speed + self.weights.table_acceleration * float((acceleration**2).mean())

    def angle_at(self, motion: TableMotion, time: ArrayLike, window: float) -> Array:
        """Table angles (...,), rad, not wrapped, at times (...,) from the start, s, averaged over a `window`, s.

        The motion begins half a window early and ends half a window late. Its speed and acceleration do not exceed
        those of the motion itself, from which it deviates by at most ``a window² / 24`` at an acceleration a; its jerk
        is a change of acceleration over the window.
        """
        time = np.asarray(time, float)
        turned = self._angle_integral(motion, time + window / 2) - self._angle_integral(motion, time - window / 2)
        return np.asarray(turned / window + self._low)

    def window(self, max_jerk: float) -> float:
        """The window of `angle_at`, s, for which no change of acceleration exceeds a jerk limit, rad/s³."""
        return min(2 * self.accelerations * self._quantum / max_jerk, self._step)

    def _angle_integral(self, motion: TableMotion, time: Array) -> Array:
        """Integral (...,), rad s, of the table angle from the start; at rest before and after the motion."""
        first, rate, acceleration = motion.start, np.cumsum([0, *motion.accelerations]), [*motion.accelerations, 0]
        lattice = first + np.concatenate([[0], np.cumsum(2 * rate[:-1] + motion.accelerations)])
        # The state at the start of each step, and after the last one, where the table rests.
        angle = lattice * self._angle
        speed, change = rate * self._quantum * self._step, np.array(acceleration) * self._quantum
        h = self._step
        done = np.concatenate([[0.0], np.cumsum(h * (angle + h * (speed / 2 + h * change / 6))[:-1])])
        step = np.clip((time / h).astype(np.int64), 0, self.steps)
        since = time - step * h
        # Before the start the table rests, too.
        moving = time > 0
        return np.asarray(
            done[step]
            + since * (angle[step] + np.where(moving, since * (speed[step] / 2 + since * change[step] / 6), 0.0))
        )

    def motion(self, start: int, accelerations: ArrayLike) -> TableMotion:
        """The motion from rest at lattice angle `start` with these accelerations (steps,), quanta."""
        accelerations = np.asarray(accelerations, np.int64)
        rate = np.concatenate([[0], np.cumsum(accelerations)])
        lattice = start + np.concatenate([[0], np.cumsum(2 * rate[:-1] + accelerations)])
        since = self._period * np.arange(1, self.samples + 1)
        turned, speed = self._within_step(rate[:-1, None], accelerations[:, None], since)
        angle = lattice[:-1, None] * self._angle + turned
        # Wrapped as in the search, so that rounding picks the same cells.
        cost = self.cost(np.arange(self.steps), lattice[:-1] % self.angles, rate[:-1], accelerations)
        return TableMotion(
            int(start),
            accelerations,
            np.concatenate([[start * self._angle], angle.ravel()]) + self._low,
            np.concatenate([[0.0], speed.ravel()]),
            float(cost.mean()),
        )
