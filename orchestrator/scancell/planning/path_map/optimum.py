"""The best motion of the table along a configuration map, by dynamic programming over its lattice.

The whole map is evaluated. Edges are implicit: memory is one byte per state (steps x angles x speeds) for the way back.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scancell.planning.path_map.table_motion import Lattice, TableMotion


def best_motion(lattice: Lattice) -> TableMotion | None:
    """The motion of least cost from rest to rest, at any angle; None where there is none."""
    lattice.map.require_all()
    rates = np.arange(-lattice.rates, lattice.rates + 1)
    cost = np.full((len(rates), lattice.angles), np.inf, np.float32)
    first = lattice.map.quality[0, lattice.row(np.arange(lattice.angles))]
    cost[lattice.rates] = np.where(first > 0, 0.0, np.inf)
    chosen = np.zeros((lattice.steps, len(rates), lattice.angles), np.int8)
    for step in range(lattice.steps):
        cost = _after_step(lattice, step, cost, chosen[step])
    if not np.isfinite(cost[lattice.rates]).any():
        return None
    return _way_back(lattice, chosen, int(np.argmin(cost[lattice.rates])))


def _after_step(
    lattice: Lattice, step: int, before: NDArray[np.float32], chosen: NDArray[np.int8]
) -> NDArray[np.float32]:
    """Least costs (speeds, angles) after a step; notes the accelerations that lead there."""
    after = np.full_like(before, np.inf)
    angles = np.arange(lattice.angles)
    left = lattice.steps - step - 1
    for index, rate in enumerate(range(-lattice.rates, lattice.rates + 1)):
        if not np.isfinite(before[index]).any():
            continue
        for acceleration in range(-lattice.accelerations, lattice.accelerations + 1):
            _, next_rate = lattice.after(0, rate, acceleration)
            if abs(next_rate) > lattice.rates or not lattice.can_stop(next_rate, left):
                continue
            total = before[index] + lattice.cost(step, angles, rate, acceleration)
            turned = np.roll(total, 2 * rate + acceleration)
            target = int(next_rate) + lattice.rates
            better = turned < after[target]
            after[target][better] = turned[better]
            chosen[target][better] = acceleration
    return after


def _way_back(lattice: Lattice, chosen: NDArray[np.int8], end: int) -> TableMotion:
    accelerations = []
    angle, rate = end, 0
    for step in reversed(range(lattice.steps)):
        acceleration = int(chosen[step, rate + lattice.rates, angle])
        accelerations.append(acceleration)
        rate -= acceleration
        angle = (angle - 2 * rate - acceleration) % lattice.angles
    return lattice.motion(angle, accelerations[::-1])
