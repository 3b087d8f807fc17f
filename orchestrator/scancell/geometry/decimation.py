"""Mesh simplification and the distance between a mesh and its simplification."""

from __future__ import annotations

import numpy as np

from scancell import sensor as sensor_rt
from scancell.errors import MeshError
from scancell.geometry.mesh import Mesh
from scancell.geometry.mesh_files import weld


def decimated(mesh: Mesh, max_faces: int) -> Mesh:
    """The mesh (m) simplified to `max_faces` triangles by quadric edge collapse; unchanged if it has no more.

    Boundary and non-manifold edges do not collapse: open or non-manifold meshes may keep more triangles.

    Raises `MeshError` if no triangle remains.
    """
    if len(mesh.faces) <= max_faces:
        return mesh
    import fast_simplification  # noqa: PLC0415

    # The library works in single precision: millimetres, about the centre.
    centre = mesh.bounds.mean(0)
    corners = ((mesh.vertices - centre) * 1e3).astype(np.float32)
    # Vertices must be shared: triangles without neighbours would be removed.
    first, number = weld(corners)
    vertices, faces = fast_simplification.simplify(
        corners[first], number[mesh.faces].astype(np.int32), target_count=max_faces
    )
    if len(faces) == 0:
        raise MeshError(f"cannot be simplified from {len(mesh.faces)} to {max_faces} triangles", file=mesh.source)
    return Mesh(np.asarray(vertices, np.float64) * 1e-3 + centre, np.asarray(faces, np.int64), mesh.source)


def deviation(mesh: Mesh, other: Mesh) -> float:
    """Largest distance (m) from a vertex or face centre of either mesh to the surface of the other."""
    return max(_one_sided(mesh, other), _one_sided(other, mesh))


def _one_sided(source: Mesh, target: Mesh) -> float:
    corners = source.vertices[np.unique(source.faces)]
    probes = np.concatenate([corners, source.vertices[source.faces].mean(1)])
    distance, _ = sensor_rt.MeshSurface(target.vertices, target.faces).signed_distances(probes)
    return float(np.abs(distance).max())
