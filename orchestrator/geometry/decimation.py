"""Meshes with fewer triangles, and how far they are from the ones they stand for."""

from __future__ import annotations

import fast_simplification
import numpy as np
from numpy.typing import NDArray

import sensor_rt
from orchestrator.errors import MeshError
from orchestrator.geometry.mesh import Mesh


def decimated(mesh: Mesh, most_faces: int) -> Mesh:
    """The mesh with `most_faces` triangles, by quadric edge collapse; itself where it has no more.

    Edges of an open or branching mesh cannot all collapse: what is left then may have more.

    Raises
    ------
    MeshError
        If nothing is left.
    """
    if len(mesh.faces) <= most_faces:
        return mesh
    # In millimetres and about its centre: the library works in single precision.
    centre = mesh.bounds.mean(0)
    # Corners that several triangles have in common are one vertex: a triangle by itself would just be dropped.
    welded, number = np.unique(((mesh.vertices - centre) * 1e3).astype(np.float32), axis=0, return_inverse=True)
    vertices, faces = fast_simplification.simplify(welded, number[mesh.faces].astype(np.int32), target_count=most_faces)
    if len(faces) == 0:
        raise MeshError(f"{mesh.source}: cannot be simplified from {len(mesh.faces)} to {most_faces} triangles")
    return Mesh(np.asarray(vertices, np.float64) * 1e-3 + centre, np.asarray(faces, np.int64), mesh.source)


def deviation(mesh: Mesh, other: Mesh) -> float:
    """Largest distance (m) of a corner or face centre of either mesh from the other's surface."""
    return max(_one_sided(mesh, other), _one_sided(other, mesh))


def _one_sided(source: Mesh, target: Mesh) -> float:
    corners = source.vertices[np.unique(source.faces)]
    probes = np.concatenate([corners, source.vertices[source.faces].mean(1)])
    _, _, distance = sensor_rt.closest_points(target.vertices, np.asarray(target.faces, np.uint32), probes)
    absolute: NDArray[np.float64] = np.abs(distance)
    return float(absolute.max())
