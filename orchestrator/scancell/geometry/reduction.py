"""Simplification of meshes, and bounds on the distance between a mesh and its simplification."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.errors import MeshError
from scancell.geometry.mesh import Mesh
from scancell.geometry.mesh_files import weld

Array = NDArray[np.float64]

_TOLERANCE = 0.1e-3  # m: the bound exceeds the largest distance that was found by no more
_MAX_TRIANGLES = 2_000_000  # in a round of subdivision; then the bound is what has been proved so far


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


@dataclass(frozen=True)
class ReducedMesh:
    """A mesh in place of one with more faces.

    Attributes
    ----------
    mesh
        The mesh, or the original if that has few faces.
    original_faces
        Number of faces of the original.
    error
        Bound (m) on the distance of any point of the original from the mesh, or from its inside if it is closed.
    """

    mesh: Mesh
    original_faces: int
    error: float = 0.0

    def line(self, name: str) -> str:
        """Line of text for messages."""
        return (
            f"{name}: {self.original_faces} triangles reduced to {len(self.mesh.faces)}, beyond which the body reaches"
            f" at most {1e3 * self.error:.2f} mm"
        )


def reduced(mesh: Mesh, max_faces: int, max_error: float) -> ReducedMesh:
    """The mesh simplified to `max_faces` triangles by quadric edge collapse; unchanged if it has no more.

    Where the error would exceed `max_error` (m), it keeps four times as many, and so on.

    Raises `MeshError` if no triangle remains.
    """
    while True:
        light = decimated(mesh, max_faces)
        if light is mesh:
            return ReducedMesh(mesh, len(mesh.faces))
        error = protrusion_bound(mesh, light, limit=max_error)
        if error <= max_error:
            return ReducedMesh(light, len(mesh.faces), error)
        max_faces *= 4


def protrusion_bound(mesh: Mesh, solid: Mesh, tolerance: float = _TOLERANCE, limit: float = np.inf) -> float:
    """Bound (m) on the distance by which any point of a mesh lies outside a solid, or off an open surface.

    Triangles whose bound, see `scancell.sensor.MeshSurface.triangle_distances`, exceeds the largest distance found so
    far by more than `tolerance` are divided in four. Beyond `limit` the bound is not sought: the result is a distance
    above it.
    """
    surface = sensor_rt.MeshSurface(solid.vertices, solid.faces.astype(np.uint32))
    triangles = mesh.vertices[mesh.faces]
    corners = surface.signed_distances(mesh.vertices[np.unique(mesh.faces)])[0]
    largest = max(0.0, float((corners if solid.is_closed else np.abs(corners)).max()))
    while largest <= limit:
        distance, bound = surface.triangle_distances(triangles, solid.is_closed)
        largest = max(largest, float(distance.max(initial=0.0)))
        rest = np.flatnonzero(bound > largest + tolerance)
        if not len(rest) or 4 * len(rest) > _MAX_TRIANGLES:
            return max(largest + tolerance, float(bound[rest].max(initial=0.0)))
        triangles = _divided(triangles[rest])
    return largest


def _divided(triangles: Array) -> Array:
    """Four triangles (4 n, 3, 3) in place of each (n, 3, 3), between its corners and the middles of its edges."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    quarters = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.concatenate([np.stack(corners, 1) for corners in quarters])
