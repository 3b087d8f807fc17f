"""Distances, closest points and collisions of rigid bodies, for many poses in one call."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.geometry.mesh import Mesh
from scancell.proximity._native import PairDistances

Array = NDArray[np.float64]


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
