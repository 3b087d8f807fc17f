"""Branches of arms whose inverse kinematics has no named ones, on a configuration map.

A pose has several solutions, which the numerical inverse kinematics lists in no order. A branch is what small steps of
pose and table angle connect: from a solution at the first pose of the path, its neighbours on the map are found by
Newton's method, from these their neighbours, and so on. Cells whose joints are outside their limits, or where a joint
would change by more than `_LARGEST_STEP`, end a branch: no motion passes there either.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from scancell.arrays import Array, Flags, Indices
from scancell.planning.model import PlanningCell

_STARTS = 72  # rows at which solutions for the first pose are looked for
_LARGEST_STEP = 0.2  # rad, of a joint from a cell to the next one
_SAME = 1e-3  # rad: a solution that a branch contains


class NumberedBranches:
    """The branches that reach every column of a map, by number from 0; found one after another.

    Parameters
    ----------
    cell
        Nominal cell.
    targets
        Poses (k, 4, 4) for the inverse kinematics at columns (k,) and rows (k,).
    within
        (rows,) whether a row is a position within the limits of the axis.
    columns
        Number of columns.
    """

    def __init__(
        self, cell: PlanningCell, targets: Callable[[Indices, Indices], Array], within: Flags, columns: int
    ) -> None:
        self._cell, self._targets, self._within, self._columns = cell, targets, within, columns
        self._found: list[Array] = []
        self._left: list[tuple[int, Array]] | None = None  # rows and joints of solutions in no branch, the best last

    def __getitem__(self, number: int) -> Array | None:
        """Joints (columns, rows, joints), rad, of a branch, NaN where it does not reach; None if there are fewer."""
        while len(self._found) <= number:
            if self._left is None:
                self._left = self._solutions()
            if not self._left:
                return None
            row, joints = self._left.pop()
            q = self._grown(row, joints)
            self._left = [one for one in self._left if not np.abs(q[0, one[0]] - one[1]).max() < _SAME]
            if np.isfinite(q[..., 0]).any(1).all():
                self._found.append(q)
        return self._found[number]

    def near(self, number: int, column: Array, row: Array, targets: Array, reference: Array | None = None) -> Array:
        """Joints (k, joints), rad, of a branch for targets (k, 4, 4) at or between columns and rows (k,).

        NaN where the branch does not reach, or outside the limits of joints. `reference` is as of `Arm.ik`.
        """
        q, arm = self[number], self._cell.nominal.arm
        if q is None:
            return np.full((len(targets), len(arm.joints)), np.nan)
        seeds = np.full((len(targets), len(arm.joints)), np.nan)
        last, rows = self._columns - 1, q.shape[1]
        for column_of, row_of in (
            (np.rint, np.rint),
            *((a, b) for a in (np.floor, np.ceil) for b in (np.floor, np.ceil)),
        ):
            lost = np.isnan(seeds[:, 0])
            at = np.clip(column_of(column[lost]), 0, last).astype(np.int64)
            seeds[lost] = q[at, row_of(row[lost]).astype(np.int64) % rows]
        return self._cell.near(targets, seeds, reference)

    def _solutions(self) -> list[tuple[int, Array]]:
        """Rows and joints (joints,) of all solutions for the first pose, those farthest from joint limits last."""
        rows = np.flatnonzero(self._within)
        rows = np.unique(rows[np.linspace(0, len(rows) - 1, _STARTS).astype(np.int64)])
        q = self._cell.ik(self._targets(np.zeros(len(rows), np.int64), rows))
        lower, upper = self._cell.nominal.arm.limits
        margin = (np.minimum(q - lower, upper - q) / (upper - lower)).min(-1)
        at = np.argwhere(np.isfinite(margin))
        order = np.argsort(margin[tuple(at.T)], kind="stable")
        return [(int(rows[i]), q[i, solution]) for i, solution in at[order]]

    def _grown(self, row: int, joints: Array) -> Array:
        """The branch (columns, rows, joints) that contains a solution at a row of the first column."""
        rows = len(self._within)
        q = np.full((self._columns, rows, len(joints)), np.nan)
        tried = np.broadcast_to(~self._within, q.shape[:2]).copy()
        q[0, row], tried[0, row] = joints, True
        wave = np.array([[0, row]])
        while len(wave):
            steps = np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
            after = (wave[:, None] + steps).reshape(-1, 2)
            before = np.repeat(wave, len(steps), axis=0)
            after[:, 1] %= rows
            new = (after[:, 0] >= 0) & (after[:, 0] < self._columns)
            new[new] = ~tried[tuple(after[new].T)]
            after, before = after[new], before[new]
            _, first = np.unique(after @ [rows, 1], return_index=True)
            after, before = after[first], before[first]
            tried[tuple(after.T)] = True
            seeds = q[tuple(before.T)]
            found = self._cell.near(self._targets(after[:, 0], after[:, 1]), seeds, seeds)
            with np.errstate(invalid="ignore"):
                good = np.abs(found - seeds).max(-1) < _LARGEST_STEP
            wave = after[good]
            q[tuple(wave.T)] = found[good]
        return q
