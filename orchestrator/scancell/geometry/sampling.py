"""Random samples of triangle mesh surfaces."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scancell.geometry.mesh import Mesh


def sample_surface(mesh: Mesh, count: int, seed: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Area-stratified random points (count, 3), m, and their faces (count,).

    One point in each of `count` equal intervals of the cumulative face area, uniformly distributed within its face.
    """
    rng = np.random.default_rng(seed)
    cumulated = np.cumsum(mesh.areas / mesh.areas.sum())
    face = np.searchsorted(cumulated, (np.arange(count) + rng.uniform(size=count)) / count)
    face = np.minimum(face, len(cumulated) - 1)  # rounding may leave the sum below 1
    u, v = rng.uniform(size=(2, count, 1))
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces[face]], 1, 0)
    root = np.sqrt(u)
    return (1 - root) * a + root * (1 - v) * b + root * v * c, face
