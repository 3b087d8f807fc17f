"""Meshes as the FMU reads them: the inverse of `scancell.cell.fmu_file.mesh_json`."""

from __future__ import annotations

from base64 import b64decode
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray


def read_mesh_json(mesh: Mapping[str, str]) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Vertices (n, 3), m, and faces (m, 3) that `mesh_json` wrote."""
    vertices = np.frombuffer(b64decode(mesh["vertices"]), "<f8").reshape(-1, 3)
    return vertices, np.frombuffer(b64decode(mesh["faces"]), "<i4").reshape(-1, 3)
