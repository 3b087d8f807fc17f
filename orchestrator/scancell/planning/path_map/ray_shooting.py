"""Ray Shooting: a motion of the table along a configuration map that evaluates few of its cells.

From every state, rays of constant acceleration are followed through the map; the table takes the first step of the ray
of lowest cost (Dumitrache & Borangiu). The cost of a ray includes that of the way from its end to the end of the path
on a coarse map, without inertia; rays alone would not see farther than their length. If no ray continues, the last step
is undone.
"""

from __future__ import annotations

from collections import Counter

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.arrays import Array, Indices
from scancell.planning.model import describe
from scancell.planning.path_map.configuration_map import (
    CAUSES,
    CLEARANCE,
    FREE,
    JOINT_RANGE,
    JOINT_SPEED,
    REACH,
    SINGULARITY,
    USER,
    ConfigurationMap,
)
from scancell.planning.path_map.table_motion import Lattice, TableMotion

COARSE_ROWS = 72  # table angles of the coarse map in a turn
COARSE_COLUMNS = 60  # about as many columns of it
_MOST_NAMED = 3  # constraints in a message
_CAUSES = {
    FREE: "",
    JOINT_RANGE: "a joint is at its limit",
    SINGULARITY: "the arm is at a singular configuration",
    JOINT_SPEED: "no speed of the table lets all joints keep their limits of speed",
    USER: "a further constraint of the plan forbids it",
}

_States = tuple[Indices, Indices, Indices]  # angles, speeds, accelerations of rays at the begin of a step

_MOST_STARTS = 4
_MOST_STEPS = 20  # steps made in all before the search gives up, in lengths of the path
_BLOCKED = 1e3  # cost of a step into a coarse cell that is forbidden: a finer way may lead past it


def coarse_steps(lattice: Lattice) -> Indices:
    """Steps (n,) of the lattice at whose ends a coarse map has its columns."""
    stride = max(1, lattice.steps // COARSE_COLUMNS)
    return np.unique([*range(0, lattice.steps, stride), lattice.steps]).astype(np.int64)


def why_blocked(lattice: Lattice) -> str:
    """Position on the path beyond which no table angle can be reached, and the constraints that forbid the next ones.

    By the coarse map and a table without inertia: where this one gets through, it is the limits of speed and
    acceleration that block the way.
    """
    map_, steps = lattice.map, coarse_steps(lattice)
    rows = np.arange(COARSE_ROWS) * map_.rows // COARSE_ROWS
    reached = within = map_.within(rows)
    for number, step in enumerate(steps):
        column = int(step) * lattice.samples
        map_.require(column, rows)
        passed = int(step - steps[number - 1]) if number else 0
        farthest = int(np.ceil(2 * lattice.rates * passed * COARSE_ROWS / lattice.angles))
        wanted = _widened(reached, farthest) & within
        reached = wanted & (map_.quality[column, rows] > 0)
        if not reached.any():
            share = 100 * column / (map_.columns - 1)
            return (
                f"at {share:.0f} % of the way {_forbidden(lattice, column, rows[wanted], wanted.sum() == within.sum())}"
            )
    name = map_.drive.name
    free = "table angles" if name == "table" else f"positions of {name}"
    return f"{name} and joints are too slow to follow the free {free}"


def why_forbidden(map_: ConfigurationMap, column: int, row: int) -> str:
    """Constraint that forbids an evaluated cell, with the bodies and distances; empty if it is free."""
    cause = int(map_.cause[column, row])
    if cause == CLEARANCE:
        return describe(map_.worst_clashes(column, np.array([row]))[0])
    return map_.out_of_reach(column, row) if cause == REACH else _CAUSES[cause]


def _widened(flags: NDArray[np.bool_], by: int) -> NDArray[np.bool_]:
    """Whether a flag (n,) at most `by` elements away, around a circle, is set."""
    if 2 * by + 1 >= len(flags):
        return np.full(len(flags), flags.any())
    return np.asarray(np.any([np.roll(flags, k) for k in range(-by, by + 1)], axis=0))


def _forbidden(lattice: Lattice, column: int, rows: Indices, are_all: bool) -> str:
    """The constraints that forbid cells, the most frequent first, each with its share of them."""
    map_ = lattice.map
    causes = map_.cause[column, rows]
    names: Counter[str] = Counter(CAUSES[cause] for cause in causes if cause != CLEARANCE)
    near = rows[causes == CLEARANCE]
    names.update(f"clearance between {clash.body_a} and {clash.body_b}" for clash in map_.worst_clashes(column, near))
    shares = [f"{name} ({100 * count / len(rows):.0f} %)" for name, count in names.most_common(_MOST_NAMED)]
    where = f"every {map_.drive.in_words}" + ("" if are_all else " that can be reached")
    return f"{where} is forbidden: {', '.join(shares)}"


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
        of_speed = lattice.weights.table_speed * np.minimum(np.abs(turns) * spacing / (2 * lattice.rates), 1.0) ** 2
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
