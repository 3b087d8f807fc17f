"""The surface of a part, prepared for distance queries."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell.geometry.mesh import Mesh
from scancell.geometry.shapes import ShapeMesh
from scancell.sensor import MeshSurface

Array = NDArray[np.float64]


class PartSurface:
    """Distances to the exact shapes of a part that has them, otherwise to its mesh.

    Attributes
    ----------
    is_exact
        Whether the part consists of exact shapes.
    is_signed
        Whether distances have a sign: a mesh that is not closed has no inside.
    """

    def __init__(self, part: Mesh) -> None:
        self._part, self._mesh = part, MeshSurface(part.vertices, part.faces)
        self._shapes = part.shapes if isinstance(part, ShapeMesh) else None
        self.is_exact = self._shapes is not None
        self.is_signed = self.is_exact or part.is_closed

    def __reduce__(self) -> tuple[Any, ...]:
        return PartSurface, (self._part,)

    def distances(self, points: Array, threads: int = 0) -> tuple[Array, NDArray[np.uint32]]:
        """Distance (n,), m, positive outside, and nearest face of the mesh (n,) of points (n, 3) in the part frame.

        `threads` does not change the result; 0 uses all cores.
        """
        signed, face = self._mesh.signed_distances(points, threads)
        if self._shapes is not None:
            signed = self._shapes.nearest(points)[0]
        return (signed if self.is_signed else np.abs(signed)), face
