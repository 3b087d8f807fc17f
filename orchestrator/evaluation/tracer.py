"""A ray tracer of evaluation's own, which shares nothing with the sensor's: it judges what the sensor could have seen.

It is the `embreex` package (Embree 4 with its own build), in single precision and millimetres.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from orchestrator.geometry.mesh import Mesh

Array = NDArray[np.float64]

_MM = 1e3


class Tracer:
    """Rays against meshes that all stand still in one frame (metres)."""

    def __init__(self, meshes: Sequence[Mesh]) -> None:
        triangles = np.concatenate([mesh.vertices[mesh.faces] for mesh in meshes])
        # Coordinates near zero keep single precision harmless.
        self._centre = (triangles.reshape(-1, 3).min(0) + triangles.reshape(-1, 3).max(0)) / 2
        self._triangles = ((triangles - self._centre) * _MM).astype(np.float32)
        self._scene = EmbreeScene()
        self._geometry = TriangleMesh(self._scene, self._triangles)

    def blocked(self, start: Array, end: Array) -> NDArray[np.bool_]:
        """(n,) whether anything lies on the straight way from `start` (n, 3) to `end` (n, 3)."""
        way = (end - start) * _MM
        length = np.linalg.norm(way, axis=1)
        direction = way / length[:, None]
        hit = self._scene.run(
            ((start - self._centre) * _MM).astype(np.float32),
            direction.astype(np.float32),
            dists=length.astype(np.float32),
            query="OCCLUDED",
        )
        return np.asarray(hit >= 0)

    def first_hit(self, start: Array, direction: Array) -> tuple[NDArray[np.int64], Array]:
        """Triangle (n,), counted through all meshes, -1 for none, and its distance (n,), m; unit directions (n, 3)."""
        answer = self._scene.run(
            ((start - self._centre) * _MM).astype(np.float32), direction.astype(np.float32), output=True
        )
        return answer["primID"].astype(np.int64), answer["tfar"].astype(float) / _MM
