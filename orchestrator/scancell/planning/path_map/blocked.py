"""Where a configuration map is blocked, and by which constraints and pairs of bodies."""

from __future__ import annotations

from collections import Counter

import numpy as np
from numpy.typing import NDArray

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
from scancell.planning.path_map.table_motion import Lattice
from scancell.planning.reasons import describe

Indices = NDArray[np.int64]

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
    reached = np.ones(COARSE_ROWS, bool)
    for number, step in enumerate(steps):
        column = int(step) * lattice.samples
        map_.require(column, rows)
        passed = int(step - steps[number - 1]) if number else 0
        farthest = int(np.ceil(2 * lattice.rates * passed * COARSE_ROWS / lattice.angles))
        wanted = _widened(reached, farthest)
        reached = wanted & (map_.quality[column, rows] > 0)
        if not reached.any():
            share = 100 * column / (map_.columns - 1)
            return f"at {share:.0f} % of the way {_forbidden(lattice, column, rows[wanted])}"
    return "table and joints are too slow to follow the free table angles"


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


def _forbidden(lattice: Lattice, column: int, rows: Indices) -> str:
    """The constraints that forbid cells, the most frequent first, each with its share of them."""
    map_ = lattice.map
    causes = map_.cause[column, rows]
    names: Counter[str] = Counter(CAUSES[cause] for cause in causes if cause != CLEARANCE)
    near = rows[causes == CLEARANCE]
    names.update(f"clearance between {clash.body_a} and {clash.body_b}" for clash in map_.worst_clashes(column, near))
    shares = [f"{name} ({100 * count / len(rows):.0f} %)" for name, count in names.most_common(_MOST_NAMED)]
    where = "every table angle" if len(rows) == COARSE_ROWS else "every table angle that can be reached"
    return f"{where} is forbidden: {', '.join(shares)}"
