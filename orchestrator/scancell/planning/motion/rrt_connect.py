"""Paths through joint space by RRT-Connect, whose edges are proved to keep their clearances.

Two trees grow from start and goal, in turn: one towards a random configuration, the other towards the new end of the
first (Kuffner & LaValle, "RRT-Connect: an efficient approach to single-query path planning", 2000). The path that joins
them is shortened afterwards. The same inputs and seed give the same path.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scancell.proximity.motion_check import MotionCheck

Array = NDArray[np.float64]

_PIECE = 0.25  # rad: edges are proved and kept in pieces that move no axis by more
_FARTHEST = 6  # pieces by which a tree grows towards a random configuration
_MARGIN = 1.6  # rad beyond start and goal within which configurations are drawn
_SHORTCUTS = 30  # attempts to shorten the path


class RrtConnect:
    """Path planner for arm and table.

    Parameters
    ----------
    motions
        Proof that a motion keeps its clearances.
    lower, upper
        (axes,) limits of joints and table, rad.
    iterations
        Random configurations before giving up.
    seed
        Random seed.
    """

    def __init__(self, motions: MotionCheck, lower: Array, upper: Array, iterations: int = 150, seed: int = 0) -> None:
        self._motions, self._lower, self._upper = motions, lower, upper
        self._iterations, self._seed = iterations, seed

    def path(self, start: Array, goal: Array) -> list[Array] | None:
        """Configurations (axes,), rad, from `start` to `goal` by free straight motions; None if none is found."""
        rng = np.random.default_rng(self._seed)
        low = np.maximum(np.minimum(start, goal) - _MARGIN, self._lower)
        high = np.minimum(np.maximum(start, goal) + _MARGIN, self._upper)
        trees = [_Tree(start), _Tree(goal)]
        for number in range(self._iterations):
            growing, other = trees[number % 2], trees[1 - number % 2]
            new = self._grow(growing, rng.uniform(low, high), _FARTHEST)
            if new is None:
                continue
            end = self._grow(other, growing.nodes[new], None)
            if end is not None and np.array_equal(other.nodes[end], growing.nodes[new]):
                halves = [growing.branch(new), other.branch(end)]
                first, second = halves if number % 2 == 0 else halves[::-1]
                return self._shortened([*first, *second[-2::-1]], rng)
        return None

    def _grow(self, tree: _Tree, target: Array, pieces: int | None) -> int | None:
        """Grow a tree straight towards `target` by at most `pieces` pieces; number of the last new node, if any."""
        near = tree.nearest(target)
        count = max(1, int(np.ceil(np.abs(target - tree.nodes[near]).max() / _PIECE)))
        steps = np.linspace(0.0, 1.0, count + 1)[1:, None]
        ends = tree.nodes[near] + steps * (target - tree.nodes[near])
        ends[-1] = target
        ends = ends[:pieces]
        clashes = self._motions.first_clashes(np.vstack([tree.nodes[near], ends[:-1]]), ends)
        free = next((i for i, clash in enumerate(clashes) if clash is not None), len(clashes))
        number = None
        for node in ends[:free]:
            number = near = tree.add(node, near)
        return number

    def _shortened(self, path: list[Array], rng: np.random.Generator) -> list[Array]:
        """The path with free straight motions in place of detours, the direct way past every corner tried last."""
        for _ in range(_SHORTCUTS):
            if len(path) < 3:
                return path
            first, last = sorted(rng.choice(len(path), 2, replace=False))
            path = self._cut(path, int(first), int(last))
        corner = 1
        while corner < len(path) - 1:
            shorter = self._cut(path, corner - 1, corner + 1)
            corner += len(shorter) == len(path)
            path = shorter
        return path

    def _cut(self, path: list[Array], first: int, last: int) -> list[Array]:
        if last - first < 2 or self._motions.first_clashes(path[first], path[last])[0] is not None:
            return path
        return [*path[: first + 1], *path[last:]]


class _Tree:
    """Configurations, each joined to a parent; the first one is the root."""

    def __init__(self, root: Array) -> None:
        self.nodes = [root]
        self._parents = [0]

    def nearest(self, to: Array) -> int:
        return int(np.argmin(np.linalg.norm(np.array(self.nodes) - to, axis=1)))

    def add(self, node: Array, parent: int) -> int:
        self.nodes.append(node)
        self._parents.append(parent)
        return len(self.nodes) - 1

    def branch(self, number: int) -> list[Array]:
        """Configurations from the root to node `number`."""
        found = [self.nodes[number]]
        while number:
            number = self._parents[number]
            found.append(self.nodes[number])
        return found[::-1]
