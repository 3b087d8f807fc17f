"""Clashes (FCL) and bounded distances (coal) between rigid bodies, for many poses in one call."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import coal
import fcl
import numpy as np
from numpy.typing import ArrayLike, NDArray

from orchestrator.geometry import pose
from orchestrator.geometry.mesh import Mesh
from orchestrator.proximity.bounds import Indices, SphereBounds

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Clash:
    """Two bodies that touch or come too near at pose number `index`; `distance` (m) is 0 when they intersect."""

    index: int
    body_a: str
    body_b: str
    distance: float = 0.0


class ProximityScene:
    """Bodies with meshes in their own frames and the pairs that must keep apart.

    Surfaces are checked: a body wholly inside another goes unnoticed, but cannot get there unnoticed.

    Parameters
    ----------
    meshes
        Body name → mesh.
    pairs
        Names of the bodies to compare; the order within a pair does not matter.
    """

    def __init__(self, meshes: Mapping[str, Mesh], pairs: Sequence[tuple[str, str]]) -> None:
        self.names = tuple(meshes)
        self._meshes = dict(meshes)
        self.pairs = tuple(pairs)
        number = {name: i for i, name in enumerate(self.names)}
        self._pairs: Indices = np.array([(number[a], number[b]) for a, b in pairs], np.int64).reshape(-1, 2)
        self._bounds = SphereBounds(list(meshes.values()), self._pairs)

    @cached_property
    def _fcl(self) -> list[Any]:
        return [_fcl_object(mesh) for mesh in self._meshes.values()]

    @cached_property
    def _coal(self) -> list[Any]:
        return [_coal_model(mesh) for mesh in self._meshes.values()]

    def without(self, excluded: Collection[frozenset[str]]) -> ProximityScene:
        """The same bodies with fewer pairs."""
        return ProximityScene(self._meshes, [pair for pair in self.pairs if frozenset(pair) not in excluded])

    def clashes(self, poses: ArrayLike) -> list[Clash]:
        """Every pair that intersects at each of the poses (n, bodies, 4, 4), ``world_from_body`` in `names` order."""
        poses = np.asarray(poses, float)
        index, pair = self._bounds.possibly_within(poses, 0.0)
        hit = self._exact(poses, index, pair, self._intersect)
        return [Clash(int(i), *self.pairs[p]) for i, p, h in zip(index, pair, hit, strict=True) if h > 0]

    def distances(self, poses: ArrayLike, upper_bound: float) -> Array:
        """Distances (n, pairs) in metres, exact below `upper_bound` and equal to it beyond; 0 when intersecting."""
        poses = np.asarray(poses, float)
        result = np.full((len(poses), len(self.pairs)), float(upper_bound))
        index, pair = self._bounds.possibly_within(poses, upper_bound)

        def measure(a: int, b: int, pose_a: Array, pose_b: Array) -> float:
            return self._distance(a, b, pose_a, pose_b, upper_bound)

        result[index, pair] = self._exact(poses, index, pair, measure)
        return result

    def too_near(self, poses: ArrayLike, clearance: float) -> list[Clash]:
        """Every pair nearer than `clearance` (m) at each of the poses, with its distance."""
        distance = self.distances(poses, clearance)
        index, pair = np.nonzero(distance < clearance)
        return [Clash(int(i), *self.pairs[p], float(distance[i, p])) for i, p in zip(index, pair, strict=True)]

    def _exact(self, poses: Array, index: Indices, pair: Indices, query: Any) -> Array:
        """`query` for each case (m,); a pair that has not moved since the case before keeps its answer."""
        first, second = self._pairs[pair].T
        pose_a, pose_b = poses[index, first], poses[index, second]
        relative = pose.inverse(pose_a) @ pose_b
        moved = np.ones(len(index), bool)
        moved[1:] = (pair[1:] != pair[:-1]) | (np.abs(relative[1:] - relative[:-1]).max((1, 2)) > 1e-12)
        answer = np.zeros(len(index))
        for k in np.flatnonzero(moved):
            answer[k] = query(int(first[k]), int(second[k]), pose_a[k], pose_b[k])
        group = np.cumsum(moved) - 1
        return np.asarray(answer[moved][group]) if len(index) else answer

    def _intersect(self, a: int, b: int, pose_a: Array, pose_b: Array) -> float:
        for body, world_from_body in ((a, pose_a), (b, pose_b)):
            self._fcl[body].setTransform(fcl.Transform(world_from_body[:3, :3], world_from_body[:3, 3]))
        return float(fcl.collide(self._fcl[a], self._fcl[b], fcl.CollisionRequest(), fcl.CollisionResult()) > 0)

    def _distance(self, a: int, b: int, pose_a: Array, pose_b: Array, upper_bound: float) -> float:
        result = coal.DistanceResult()
        result.min_distance = upper_bound  # the search starts with this bound and only improves on it
        request = coal.DistanceRequest(False, 0.0, 0.0)
        placed = [coal.Transform3s(np.ascontiguousarray(p[:3, :3]), p[:3, 3].copy()) for p in (pose_a, pose_b)]
        coal.distance(self._coal[a], placed[0], self._coal[b], placed[1], request, result)
        return min(max(float(result.min_distance), 0.0), upper_bound)


def _fcl_object(mesh: Mesh) -> Any:
    model = fcl.BVHModel()
    model.beginModel(len(mesh.vertices), len(mesh.faces))
    model.addSubModel(np.ascontiguousarray(mesh.vertices), np.ascontiguousarray(mesh.faces))
    model.endModel()
    return fcl.CollisionObject(model, fcl.Transform())


def _coal_model(mesh: Mesh) -> Any:
    model = coal.BVHModelOBBRSS()
    model.beginModel(len(mesh.faces), len(mesh.vertices))
    model.addVertices(np.ascontiguousarray(mesh.vertices))
    model.addTriangles(np.ascontiguousarray(mesh.faces))
    model.endModel()
    return model
