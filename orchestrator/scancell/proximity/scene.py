"""Distances, closest points and collisions of rigid bodies, for many poses in one call; the scene of a cell."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.geometry.mesh import Mesh
from scancell.nominal.cell import OCCUPIED, NominalCell
from scancell.proximity._native import PairDistances

Array = NDArray[np.float64]

_ON_ARM = ("link", "sensor", "finger")
_CONTACT = 1e-9  # m: bodies closer than this intersect


@dataclass(frozen=True)
class Clash:
    """Two bodies nearer than `clearance` (m) at pose number `index`; `distance` (m) is 0 when they intersect."""

    index: int
    body_a: str
    body_b: str
    distance: float
    clearance: float


class ProximityScene:
    """Rigid bodies and the pairs of them to check.

    Distances are between surfaces: a body completely inside another is not detected, only its way in. Along a path,
    pass consecutive poses in one call: what is known of a pair at one pose shortens the search at the next one.

    Poses (n, bodies, 4, 4) are ``world_from_body`` in the order of `names`. `threads` = 0 uses every core; results do
    not depend on it.

    Raises `ValueError` if a mesh has no faces or is not finite, or a pair names one body twice; `KeyError` if a pair
    names a body that has no mesh.

    Parameters
    ----------
    meshes
        Mesh of each body by name, in the body's frame, m.
    pairs
        Names of the bodies to compare, in either order.

    Attributes
    ----------
    names
        Bodies in the order of their poses.
    pairs
        Names of the bodies compared, in the order of the results.
    native
        The scene of the compiled module.
    """

    def __init__(self, meshes: Mapping[str, Mesh], pairs: Sequence[tuple[str, str]]) -> None:
        self.names = tuple(meshes)
        self.pairs = tuple(pairs)
        self.native = PairDistances([(mesh.vertices, mesh.faces) for mesh in meshes.values()], self._numbers())

    def _numbers(self) -> NDArray[np.int64]:
        number = {name: i for i, name in enumerate(self.names)}
        return np.array([(number[a], number[b]) for a, b in self.pairs], np.int64).reshape(-1, 2)

    def without(self, excluded: Collection[frozenset[str]]) -> ProximityScene:
        """The scene without the `excluded` pairs; it shares the bodies."""
        scene = object.__new__(ProximityScene)
        scene.names = self.names
        scene.pairs = tuple(pair for pair in self.pairs if frozenset(pair) not in excluded)
        scene.native = self.native.with_pairs(scene._numbers())
        return scene

    def distances(self, poses: ArrayLike, bound: ArrayLike, threads: int = 0) -> Array:
        """Distances (n, pairs), m, exact below the bound and equal to it otherwise; 0 when intersecting.

        Raises `ValueError` if a shape is wrong, a pose is not a rigid transform, or a bound is negative or NaN.

        Parameters
        ----------
        poses
            (n, bodies, 4, 4)
        bound
            One for all pairs, (pairs,) or (n, pairs), m; the smaller, the faster. ``inf`` gives the distance of any
            two bodies.
        """
        return self.native.distances(poses, bound, threads)

    def closest_points(self, poses: ArrayLike, bound: ArrayLike, threads: int = 0) -> tuple[Array, Array]:
        """Distances (n, pairs), m, and the closest points (n, pairs, 2, 3) of both bodies in the world, m.

        The points are NaN when the bodies intersect or are not nearer than the bound. Where several points are equally
        close, such as on parallel faces, any of them. Parameters and errors as in `distances`.
        """
        return self.native.closest_points(poses, bound, threads)

    def collisions(self, poses: ArrayLike, threads: int = 0) -> NDArray[np.bool_]:
        """Whether surfaces intersect, (n, pairs), at poses (n, bodies, 4, 4): faster than `distances`.

        Raises `ValueError` if the shape is wrong or a pose is not a rigid transform.
        """
        return self.native.collisions(poses, threads)

    def clearance_violations(self, poses: ArrayLike, clearance: ArrayLike, threads: int = 0) -> list[Clash]:
        """All pairs nearer than `clearance` (m, one or (pairs,)) at poses (n, bodies, 4, 4), see `distances`."""
        required = np.broadcast_to(np.asarray(clearance, float), (len(self.pairs),))
        distance = self.distances(poses, required, threads)
        index, pair = np.nonzero(distance < required)
        return [
            Clash(int(i), *self.pairs[p], float(distance[i, p]), float(required[p]))
            for i, p in zip(index, pair, strict=True)
        ]


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
