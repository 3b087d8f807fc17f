"""Proximity scene of a cell: its bodies and the pairs to check for collision."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike

from scancell.geometry.mesh import Mesh
from scancell.nominal.cell import OCCUPIED, NominalCell
from scancell.proximity.scene import ProximityScene

_ON_ARM = ("link", "sensor", "finger")
_CONTACT = 1e-9  # m: bodies closer than this intersect


def arm_chain(nominal: NominalCell) -> list[str]:
    """Names of the arm's bodies, base first, tools last."""
    return [b.name for b in nominal.bodies if b.name == "base" or b.moves_with.startswith(_ON_ARM)]


def cell_scene(nominal: NominalCell, meshes: Mapping[str, Mesh]) -> ProximityScene:
    """Scene of all bodies with the pairs of `cell_pairs`, except those that intersect at nearly every configuration.

    Bodies that cannot move relative to each other, such as a gripper's housing and the last link, are no pair.
    Measured space may hold the arm's base, which cannot leave it; nothing else is excepted from keeping clear of it.

    Parameters
    ----------
    meshes
        Mesh of each body by name, in the body's frame, m.
    """
    chain = arm_chain(nominal)
    around = [body.name for body in nominal.bodies if body.name not in chain]
    last = f"link[{len(nominal.arm.joints)}]"
    carrier = {body.name: last if body.moves_with == "sensor" else body.moves_with for body in nominal.bodies}
    pairs = [
        pair
        for pair in cell_pairs(chain, around)
        if carrier[pair[0]] != carrier[pair[1]] and not ("base" in pair and _measured(pair))
    ]
    scene = ProximityScene({body.name: meshes[body.name] for body in nominal.bodies}, pairs)
    lower, upper = nominal.arm.limits
    q = np.random.default_rng(0).uniform(lower, upper, (100, len(lower)))
    found = intersecting_pairs(scene, nominal.body_poses(q, np.zeros(len(q))))
    intersecting = {pair for pair in found if not _measured(pair)}
    return scene.without(intersecting) if intersecting else scene


def _measured(pair: Iterable[str]) -> bool:
    return any(name.startswith(OCCUPIED) for name in pair)


def cell_pairs(chain: Sequence[str], around: Sequence[str]) -> list[tuple[str, str]]:
    """Pairs to check: bodies of a serial chain (base first) with each other, and with the bodies around it.

    Excluded are neighbours in the chain, which share a joint, and pairs of the bodies around, which rest on each other.
    """
    inner = [(a, b) for (i, a), (j, b) in combinations(enumerate(chain), 2) if j - i > 1]
    return inner + [(a, b) for a in chain for b in around]


def intersecting_pairs(scene: ProximityScene, poses: ArrayLike, fraction: float = 0.95) -> set[frozenset[str]]:
    """Pairs that intersect in at least `fraction` of the poses (n, bodies, 4, 4): overlapping by construction."""
    poses = np.asarray(poses, float)
    count: dict[frozenset[str], int] = {}
    for clash in scene.clearance_violations(poses, _CONTACT):
        key = frozenset((clash.body_a, clash.body_b))
        count[key] = count.get(key, 0) + 1
    return {key for key, hits in count.items() if hits >= fraction * len(poses)}
