"""Which bodies of a cell must keep apart."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike

from orchestrator.proximity.scene import ProximityScene


def cell_pairs(chain: Sequence[str], around: Sequence[str]) -> list[tuple[str, str]]:
    """Pairs of a serial chain of links (base first, tool last) with itself and with the bodies around it.

    Neighbours in the chain share a joint and touch, and the bodies around (table, part) touch each other by design:
    those are left out.
    """
    inner = [(a, b) for (i, a), (j, b) in combinations(enumerate(chain), 2) if j - i > 1]
    return inner + [(a, b) for a in chain for b in around]


_TOUCH = 1e-9  # m: what is nearer than this intersects


def always_touching(scene: ProximityScene, poses: ArrayLike, share: float = 0.95) -> set[frozenset[str]]:
    """Pairs that intersect in at least `share` of the poses (n, bodies, 4, 4): drawn into each other, not clashing."""
    poses = np.asarray(poses, float)
    count: dict[frozenset[str], int] = {}
    for clash in scene.too_near(poses, _TOUCH):
        key = frozenset((clash.body_a, clash.body_b))
        count[key] = count.get(key, 0) + 1
    return {key for key, hits in count.items() if hits >= share * len(poses)}
