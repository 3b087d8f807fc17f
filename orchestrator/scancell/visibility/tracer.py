"""Occlusion tests against static triangle meshes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.geometry.mesh import Mesh

Array = NDArray[np.float64]


class Tracer:
    """Occlusion queries against static meshes in one frame, m.

    Parameters
    ----------
    threads
        Number of threads of each query; 0 uses all cores.
    """

    def __init__(self, meshes: Sequence[Mesh], threads: int = 0) -> None:
        self._scene = sensor_rt.Scene()
        for number, mesh in enumerate(meshes):
            self._scene.add_mesh(str(number), mesh.vertices, mesh.faces, 0.5)
        self._poses = np.tile(np.eye(4), (len(meshes), 1, 1))
        self._threads = threads

    def blocked(self, start: Array, end: Array) -> NDArray[np.bool_]:
        """Whether a surface crosses the segments from `start` (n, 3) to `end` (n, 3), (n,).

        Raises `ValueError` if a segment has zero length or is not finite.
        """
        return sensor_rt.occluded(self._scene, self._poses, start, end, self._threads)
