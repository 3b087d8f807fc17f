"""Ray Shooting: a motion of the table along a configuration map that evaluates few of its cells.

From every state, rays of constant acceleration are followed through the map; the table takes the first step of the ray
of lowest cost (Dumitrache & Borangiu). The cost of a ray includes that of the way from its end to the end of the path
on a coarse map, without inertia; rays alone would not see farther than their length. If no ray continues, the last step
is undone.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.planning.path_map.blocked import COARSE_ROWS, coarse_steps
from scancell.planning.path_map.table_motion import Lattice, TableMotion

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
_States = tuple[Indices, Indices, Indices]  # angles, speeds, accelerations of rays at the begin of a step

_MOST_STARTS = 4
_MOST_STEPS = 20  # steps made in all before the search gives up, in lengths of the path
_BLOCKED = 1e3  # cost of a step into a coarse cell that is forbidden: a finer way may lead past it


def shoot(lattice: Lattice) -> TableMotion | None:
    """A motion from rest to rest of low cost; None where none was found."""
    guide = _Guide(lattice)
    search = _Search(lattice, guide)
    for start in guide.starts(_MOST_STARTS):
        found = search.run(int(start))
        if found is not None:
            return found
    return None


class _Guide:
    """Cost to go on a coarse map, of a table without inertia, by dynamic programming over its angles.

    The coarse map has a column at the end of every step, or of every few steps of a long path, and `COARSE_ROWS` rows.
    """

    def __init__(self, lattice: Lattice) -> None:
        fine = lattice.map
        self._lattice = lattice
        rows = np.arange(COARSE_ROWS) * fine.rows // COARSE_ROWS
        steps = coarse_steps(lattice)
        column, row = (x.ravel() for x in np.meshgrid(steps * lattice.samples, rows, indexing="ij"))
        fine.require(column, row)
        # A step counts as the coarse column that follows it.
        following = np.searchsorted(steps, np.arange(lattice.steps + 1))
        quality = fine.quality[column, row].reshape(len(steps), COARSE_ROWS)[following]
        with np.errstate(divide="ignore"):
            cost = np.minimum(1.0 / quality - 1.0, _BLOCKED)
        spacing = lattice.angles / COARSE_ROWS  # lattice angles in a coarse row
        farthest = int(np.ceil(2 * lattice.rates / spacing))
        turns = np.arange(-farthest, farthest + 1)
        # 2 lattice angles in a step are one quantum of speed.
        of_speed = lattice.weights.speed * np.minimum(np.abs(turns) * spacing / (2 * lattice.rates), 1.0) ** 2
        to_go = np.zeros((lattice.steps + 1, COARSE_ROWS))
        for step in reversed(range(lattice.steps)):
            onward = to_go[step + 1] + cost[step + 1]
            neighbour = (np.arange(COARSE_ROWS)[:, None] + turns) % COARSE_ROWS
            to_go[step] = (onward[neighbour] + of_speed).min(1)
        self._to_go = to_go
        self._first = np.where(quality[0] > 0, to_go[0], np.inf)

    def starts(self, most: int) -> Indices:
        """Free lattice angles to start from, by the cost to go: at most `most`, in different parts of a turn."""
        order = np.argsort(self._first, kind="stable")
        order = order[np.isfinite(self._first[order])]
        chosen: list[int] = []
        for row in order:
            apart = [min((row - c) % COARSE_ROWS, (c - row) % COARSE_ROWS) for c in chosen]
            if len(chosen) < most and min(apart, default=COARSE_ROWS) >= COARSE_ROWS // 12:
                chosen.append(int(row))
        return np.array(chosen, np.int64) * self._lattice.angles // COARSE_ROWS

    def to_go(self, step: int, angle: ArrayLike) -> Array:
        """Cost (...,) from lattice angles (...,) before a step to the end of the path."""
        place = np.asarray(angle, float) * (COARSE_ROWS / self._lattice.angles)
        row = np.floor(place).astype(np.int64)
        part = place - row
        line = self._to_go[step]
        return np.asarray(line[row % COARSE_ROWS] * (1 - part) + line[(row + 1) % COARSE_ROWS] * part)


class _Search:
    """Depth-first search, the best ray first."""

    def __init__(self, lattice: Lattice, guide: _Guide) -> None:
        self._lattice, self._guide = lattice, guide
        self._dead: set[tuple[int, int, int]] = set()
        self._steps_left = _MOST_STEPS * lattice.steps
        # In this many steps the table can change from any speed to any other.
        self._horizon = max(2, -(-2 * lattice.rates // lattice.accelerations))

    def run(self, start: int) -> TableMotion | None:
        """A motion from rest at a lattice angle."""
        lattice = self._lattice
        states = [(start, 0)]
        choices = [self._ranked(0, start, 0)]
        taken: list[int] = []
        while choices and self._steps_left > 0:
            step = len(taken)
            if step == lattice.steps:
                return lattice.motion(start, taken)
            angle, rate = states[-1]
            following = None
            while choices[-1] and following is None:
                acceleration = choices[-1].pop(0)
                next_angle, next_rate = (int(x) for x in lattice.after(angle, rate, acceleration))
                if (step + 1, next_angle, next_rate) not in self._dead:
                    following = (next_angle, next_rate)
            if following is None:
                self._dead.add((step, angle, rate))
                choices.pop()
                states.pop()
                if taken:
                    taken.pop()
                continue
            self._steps_left -= 1
            taken.append(acceleration)
            states.append(following)
            choices.append(self._ranked(step + 1, *following) if step + 1 < lattice.steps else [])
        return None

    def _ranked(self, step: int, angle: int, rate: int) -> list[int]:
        """Accelerations whose first step is free, that of the best ray first."""
        lattice = self._lattice
        length = min(self._horizon, lattice.steps - step)
        first, states = self._rays(step, angle, rate, length)
        # The first step, which is taken, counts with all its poses, those ahead with their ends.
        cells = [lattice.cells(step + k, *state, only_end=k > 0)[:2] for k, state in enumerate(states)]
        lattice.map.require(*(np.concatenate([c[i].ravel() for c in cells]) for i in (0, 1)))
        cost = np.stack([lattice.cost(step + k, *state, only_end=k > 0) for k, state in enumerate(states)])
        free = np.isfinite(cost).cumprod(0).sum(0)
        end, _ = lattice.after(*states[-1])
        total = np.where(np.isfinite(cost), cost, 0.0).sum(0) + self._guide.to_go(step + length, end)
        # Rays that are blocked come last, the longest first.
        order = np.lexsort((total, -free))
        return [int(first[i]) for i in order if free[i] > 0]

    def _rays(self, step: int, angle: int, rate: int, length: int) -> tuple[Indices, list[_States]]:
        """First accelerations (rays,), and lattice states and accelerations of the rays before each step.

        A ray keeps its acceleration as long as the speed limit and the braking at the end of the path allow it.
        """
        lattice = self._lattice
        first = np.arange(-lattice.accelerations, lattice.accelerations + 1)
        possible = np.abs(rate + first) <= lattice.rates
        first = first[possible & lattice.can_stop(rate + first, lattice.steps - step - 1)]
        states: list[_States] = []
        at, speed = np.full(len(first), angle, np.int64), np.full(len(first), rate, np.int64)
        for k in range(length):
            fastest = min(lattice.rates, lattice.accelerations * (lattice.steps - step - k - 1))
            acceleration = np.asarray(np.clip(speed + first, -fastest, fastest) - speed, np.int64)
            states.append((at, speed, acceleration))
            at, speed = lattice.after(at, speed, acceleration)
        return np.asarray(first, np.int64), states
