"""Lower bounds on the distance between bodies from spheres around pieces of their surfaces, for many poses at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from orchestrator.geometry.mesh import Mesh

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


def cover(mesh: Mesh, pieces: int) -> Array:
    """Spheres (k, 4), k <= `pieces`, as x, y, z, radius in the mesh's frame, that together hold every triangle.

    The triangles are halved at the median of their centres along the longest side, again and again.
    """
    triangles = mesh.vertices[mesh.faces]
    centres = triangles.mean(1)
    groups = [np.arange(len(triangles))]
    while len(groups) < pieces:
        spans = [np.ptp(centres[group], axis=0).max() * (len(group) > 1) for group in groups]
        largest = int(np.argmax(spans))
        if spans[largest] == 0:
            break
        group = groups.pop(largest)
        axis = int(np.argmax(np.ptp(centres[group], axis=0)))
        order = group[np.argsort(centres[group, axis], kind="stable")]
        groups += [order[: len(order) // 2], order[len(order) // 2 :]]
    return np.array([_sphere(triangles[group].reshape(-1, 3)) for group in groups])


def _sphere(points: Array) -> Array:
    centre = (points.min(0) + points.max(0)) / 2
    return np.append(centre, np.sqrt(((points - centre) ** 2).sum(1).max()))


class SphereBounds:
    """Sphere covers of several bodies; `possibly_within` names the (pose, pair) cases worth an exact query."""

    def __init__(self, meshes: list[Mesh], pairs: Indices, pieces: int = 24) -> None:
        self._pairs = pairs
        self._coarse = np.array([cover(mesh, 1)[0] for mesh in meshes])
        fine = [cover(mesh, pieces) for mesh in meshes]
        # Bodies of fewer pieces repeat their last one, so that all covers stack.
        self._fine = np.array([np.concatenate([c, np.repeat(c[-1:], pieces - len(c), 0)]) for c in fine])

    def possibly_within(self, poses: Array, distance: float) -> tuple[Indices, Indices]:
        """Indices (m,) of poses and of pairs, sorted by pair, whose spheres come nearer than `distance`.

        `poses` is (n, bodies, 4, 4). A case that is not named is farther apart than `distance` for certain.
        """
        first, second = self._pairs.T
        centres = np.einsum("nbij,bj->nbi", poses[..., :3, :3], self._coarse[:, :3]) + poses[..., :3, 3]
        gap = np.linalg.norm(centres[:, first] - centres[:, second], axis=-1)
        gap -= self._coarse[first, 3] + self._coarse[second, 3]
        pair, index = np.nonzero((gap <= distance).T)
        keep = np.zeros(len(pair), bool)
        for start in range(0, len(pair), 4096):
            part = slice(start, start + 4096)
            keep[part] = self._fine_gap(poses, index[part], pair[part]) <= distance
        return index[keep], pair[keep]

    def _fine_gap(self, poses: Array, index: Indices, pair: Indices) -> Array:
        """Smallest gap (m,) between the fine spheres of both bodies of each case."""
        first, second = self._pairs[pair].T
        a, b = (self._placed(poses[index, body], body) for body in (first, second))
        # |a-b|² by one matrix product; the rounding (1e-8 m) is far below any clearance asked for.
        square = (a**2).sum(-1)[:, :, None] + (b**2).sum(-1)[:, None, :] - 2 * a @ np.swapaxes(b, 1, 2)
        gap = np.sqrt(np.maximum(square, 0.0)) - self._fine[first, :, None, 3] - self._fine[second, None, :, 3]
        return np.asarray(gap.min((1, 2)) - 1e-7)

    def _placed(self, poses: Array, body: Indices) -> Array:
        return np.asarray(self._fine[body, :, :3] @ np.swapaxes(poses[:, :3, :3], 1, 2) + poses[:, None, :3, 3])
