"""Collisions along a motion by python-fcl: an independent check of motions that our own distances found free.

The judge shares no list of pairs with what it judges. It compares all bodies whose poses relative to each other change,
except those that touch each other at the start by construction: a link and the next one, a platter and its bearing, a
part and what it stands on.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.geometry.mesh import Mesh
from scancell.proximity.scene import Clash

Array = NDArray[np.float64]

_STILL = 1e-9  # m and rad: pairs that moved less since they were last checked are not checked again
_TOUCHING = 1e-6  # m: bodies that are closer at the start touch each other


class Judge:
    """Judges many motions of the same bodies.

    Parameters
    ----------
    meshes
        Mesh of each body by name, in the body's frame, m.
    names
        Bodies in the order of their poses.
    start
        Poses (bodies, 4, 4), m, at which the bodies that touch each other do so by construction; they are not compared.
    ignored
        Pairs of names that are not compared either.
    """

    def __init__(
        self,
        meshes: Mapping[str, Mesh],
        names: Sequence[str],
        start: ArrayLike,
        ignored: Collection[frozenset[str]] = (),
    ) -> None:
        self._meshes, self._names = meshes, names
        pairs = [(a, b) for a, b in combinations(range(len(names)), 2) if {names[a], names[b]} not in ignored]
        self._index = np.array(pairs, np.int64).reshape(-1, 2)
        self._middle = np.array([meshes[name].bounds.mean(0) for name in names])
        self._half = np.array([np.ptp(meshes[name].bounds, axis=0) / 2 for name in names])
        self._objects: dict[str, Any] = {}  # of bodies whose boxes have met those of others
        self._index = self._index[~self._touching(np.asarray(start, float))]

    @property
    def pairs(self) -> list[tuple[str, str]]:
        """Names of the bodies that are compared."""
        return [(self._names[a], self._names[b]) for a, b in self._index]

    def first_collision(self, poses: ArrayLike) -> Clash | None:
        """The first of the poses (n, bodies, 4, 4), m, at which surfaces of a pair intersect, or None."""
        import fcl  # noqa: PLC0415  (most commands make no plan)

        poses = np.asarray(poses, float)
        near = np.zeros((len(poses), len(self._index)), bool)
        columns = self._within_reach(poses)
        near[:, columns] = self._overlapping(poses, self._index[columns])
        request, result = fcl.CollisionRequest(), fcl.CollisionResult()
        for i, k in zip(*np.nonzero(near), strict=True):
            if fcl.collide(*self._placed(poses[i], self._index[k]), request, result):
                a, b = self._index[k]
                return Clash(int(i), self._names[a], self._names[b], 0.0, 0.0)
        return None

    def _touching(self, poses: Array) -> NDArray[np.bool_]:
        """Whether the bodies of each pair touch at poses (bodies, 4, 4)."""
        import fcl  # noqa: PLC0415  (most commands make no plan)

        found = self._overlapping(poses[None], self._index, _TOUCHING)[0]
        for k in np.flatnonzero(found).tolist():
            request, result = fcl.DistanceRequest(), fcl.DistanceResult()
            found[k] = fcl.distance(*self._placed(poses, self._index[k]), request, result) < _TOUCHING
        return np.asarray(found)

    def _placed(self, poses: Array, pair: ArrayLike) -> list[Any]:
        """The bodies of a pair of numbers at poses (bodies, 4, 4)."""
        import fcl  # noqa: PLC0415  (most commands make no plan)

        numbers = np.asarray(pair).tolist()
        placed = [self._object(self._names[k]) for k in numbers]
        for body, k in zip(placed, numbers, strict=True):
            body.setTransform(fcl.Transform(poses[k, :3, :3], poses[k, :3, 3]))
        return placed

    def _object(self, name: str) -> Any:
        """The body, which is kept and moved: a new one takes a pass over all vertices."""
        import fcl  # noqa: PLC0415  (most commands make no plan)

        if name not in self._objects:
            self._objects[name] = fcl.CollisionObject(fcl_model(self._meshes[name].vertices, self._meshes[name].faces))
        return self._objects[name]

    def _within_reach(self, poses: Array, margin: float = 0.0) -> NDArray[np.int64]:
        """Pairs whose bounding spheres are nearer than `margin` (m), or overlap, at one of the poses."""
        rotation, position = poses[..., :3, :3], poses[..., :3, 3]
        centre = position + (rotation @ self._middle[..., None])[..., 0]
        one, other = self._index.T
        between = np.linalg.norm(centre[:, one] - centre[:, other], axis=-1)
        radius = np.linalg.norm(self._half, axis=1)
        return np.flatnonzero((between <= radius[one] + radius[other] + margin).any(0))

    def _overlapping(self, poses: Array, index: NDArray[np.int64], margin: float = 0.0) -> NDArray[np.bool_]:
        """Whether bodies (pairs, 2) moved since the pose before and their bounding boxes overlap, (n, pairs).

        The boxes are compared in the frames of both bodies, the first of each pair grown by `margin` (m).
        """
        one, other = index.T
        first, second = poses[:, one], poses[:, other]
        back = np.swapaxes(first[..., :3, :3], -1, -2)
        turn = back @ second[..., :3, :3]
        offset = (back @ (second[..., :3, 3] - first[..., :3, 3])[..., None])[..., 0]
        reach = np.abs(turn)
        middle, half = self._middle, self._half
        in_first = offset + np.einsum("npij,pj->npi", turn, middle[other]) - middle[one]
        overlap = (np.abs(in_first) <= half[one] + margin + np.einsum("npij,pj->npi", reach, half[other])).all(-1)
        in_second = np.einsum("npji,npj->npi", turn, in_first)
        overlap &= (np.abs(in_second) <= half[other] + np.einsum("npji,pj->npi", reach, half[one] + margin)).all(-1)
        moved = np.ones_like(overlap)
        moved[1:] = (np.abs(np.diff(offset, axis=0)) > _STILL).any(-1)
        moved[1:] |= (np.abs(np.diff(turn, axis=0)) > _STILL).any((-1, -2))
        return np.asarray(overlap & moved)


def fcl_model(vertices: Array, faces: NDArray[np.int64]) -> Any:
    """Triangles (m, 3) of vertices (n, 3), m, as a geometry of python-fcl."""
    import fcl  # noqa: PLC0415  (most commands need none)

    model = fcl.BVHModel()
    model.beginModel(len(vertices), len(faces))
    model.addSubModel(np.ascontiguousarray(vertices), np.ascontiguousarray(faces))
    model.endModel()
    return model
