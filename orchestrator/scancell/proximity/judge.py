"""Collisions along a motion by python-fcl: an independent judge of motions that our own distances found free."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.geometry.mesh import Mesh
from scancell.proximity.scene import Clash

Array = NDArray[np.float64]

_STILL = 1e-9  # m and rad: pairs that moved less since they were last checked are not checked again


class Judge:
    """Judges many motions of the same bodies.

    Parameters
    ----------
    meshes
        Mesh of each body by name, in the body's frame, m.
    pairs
        Names of the bodies to check.
    names
        Bodies in the order of their poses.
    """

    def __init__(self, meshes: Mapping[str, Mesh], pairs: Sequence[tuple[str, str]], names: Sequence[str]) -> None:
        self._meshes, self._pairs, self._names = meshes, pairs, names
        number = {name: i for i, name in enumerate(names)}
        self._index = np.array([(number[a], number[b]) for a, b in pairs], np.int64).reshape(-1, 2)
        concerned = {name for pair in pairs for name in pair}
        self._models = {name: fcl_model(meshes[name].vertices, meshes[name].faces) for name in concerned}

    def first_collision(self, poses: ArrayLike) -> Clash | None:
        """The first of the poses (n, bodies, 4, 4), m, at which surfaces of a pair intersect, or None."""
        import fcl  # noqa: PLC0415  (most commands make no plan)

        poses = np.asarray(poses, float)
        near = _near(self._meshes, self._names, self._index, poses) & _moved(self._index, poses)
        request, result = fcl.CollisionRequest(), fcl.CollisionResult()
        for i, k in zip(*np.nonzero(near), strict=True):
            objects = []
            for name, body in zip(self._pairs[k], self._index[k], strict=True):
                at = poses[i, body]
                objects.append(fcl.CollisionObject(self._models[name], fcl.Transform(at[:3, :3], at[:3, 3])))
            if fcl.collide(*objects, request, result):
                return Clash(int(i), self._pairs[k][0], self._pairs[k][1], 0.0, 0.0)
        return None


def first_collision(
    meshes: Mapping[str, Mesh], pairs: Sequence[tuple[str, str]], names: Sequence[str], poses: ArrayLike
) -> Clash | None:
    """The first of the poses at which surfaces of a pair intersect, or None; parameters as of `Judge`."""
    return Judge(meshes, pairs, names).first_collision(poses)


def fcl_model(vertices: Array, faces: NDArray[np.int64]) -> Any:
    """Triangles (m, 3) of vertices (n, 3), m, as a geometry of python-fcl."""
    import fcl  # noqa: PLC0415  (most commands need none)

    model = fcl.BVHModel()
    model.beginModel(len(vertices), len(faces))
    model.addSubModel(np.ascontiguousarray(vertices), np.ascontiguousarray(faces))
    model.endModel()
    return model


def _near(
    meshes: Mapping[str, Mesh], names: Sequence[str], index: NDArray[np.int64], poses: Array
) -> NDArray[np.bool_]:
    """Whether the bounding boxes of pairs, each in the frame of the other body, overlap, (n, pairs)."""
    middle = np.array([meshes[name].bounds.mean(0) for name in names])
    half = np.array([np.ptp(meshes[name].bounds, axis=0) / 2 for name in names])
    overlaps = np.ones((len(poses), len(index)), bool)
    for one, other in (index.T, index[:, ::-1].T):
        rotation, position = poses[..., :3, :3], poses[..., :3, 3]
        centre = position + (rotation @ middle[..., None])[..., 0]
        between = np.swapaxes(rotation[:, one], -1, -2) @ (centre[:, other] - centre[:, one])[..., None]
        turned = np.swapaxes(rotation[:, one], -1, -2) @ rotation[:, other]
        reach = half[one] + (np.abs(turned) @ half[other][..., None])[..., 0]
        overlaps &= (np.abs(between[..., 0]) <= reach).all(-1)
    return overlaps


def _moved(index: NDArray[np.int64], poses: Array) -> NDArray[np.bool_]:
    """Whether the bodies of a pair moved relative to each other since the pose before, (n, pairs)."""
    first, second = poses[:, index[:, 0]], poses[:, index[:, 1]]
    rotation = np.swapaxes(first[..., :3, :3], -1, -2)
    relative = np.concatenate(
        [rotation @ second[..., :3, :3], rotation @ (second[..., :3, 3] - first[..., :3, 3])[..., None]], -1
    )
    moved = np.ones((len(poses), len(index)), bool)
    moved[1:] = (np.abs(np.diff(relative, axis=0)) > _STILL).any((-1, -2))
    return moved
