"""Triangle meshes: reading them with every fault named, and the properties of the solids they bound."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

from orchestrator.errors import MeshError
from orchestrator.geometry import pose

Array = NDArray[np.float64]

METRES_PER_UNIT = {"mm": 1e-3, "m": 1.0, "inch": 0.0254}
FORMATS = (".stl", ".obj", ".ply")


@dataclass(frozen=True)
class Mesh:
    """Vertices (n, 3) in metres, faces (m, 3) of vertex numbers; `source` is the file or a name."""

    vertices: Array
    faces: NDArray[np.int64]
    source: str = ""

    @cached_property
    def bounds(self) -> Array:
        """(2, 3) lower and upper corner of the vertices that faces use."""
        used = self.vertices[np.unique(self.faces)]
        return np.stack([used.min(0), used.max(0)])

    @cached_property
    def areas(self) -> Array:
        """(m,) area of each face, m²."""
        return np.asarray(np.linalg.norm(self._cross, axis=-1) / 2)

    @cached_property
    def normals(self) -> Array:
        """(m, 3) unit normals, right-hand rule; zero for a face without area."""
        length = np.linalg.norm(self._cross, axis=-1, keepdims=True)
        return np.asarray(self._cross / np.where(length > 0, length, 1.0))

    @cached_property
    def _cross(self) -> Array:
        a, b, c = np.moveaxis(self.vertices[self.faces], 1, 0)
        return np.cross(b - a, c - a)

    def transformed(self, target_from_part: ArrayLike) -> Mesh:
        """The mesh in another frame."""
        return Mesh(pose.transform_points(target_from_part, self.vertices), self.faces, self.source)

    @cached_property
    def hull(self) -> Mesh:
        """Convex hull, faces outwards; `MeshError` when the vertices have no volume."""
        used = self.vertices[np.unique(self.faces)]
        try:
            hull = trimesh.convex.convex_hull(used)
        except Exception as error:  # qhull's own exception type is private
            raise MeshError(f"{self.source}: all vertices lie in one plane, the part has no volume") from error
        return Mesh(np.asarray(hull.vertices, float), np.asarray(hull.faces, np.int64), self.source)


def box_mesh(size: ArrayLike, source: str = "box") -> Mesh:
    """A box with edges `size` (3,) along its axes, centred on the origin, metres."""
    box = trimesh.creation.box(np.asarray(size, float))
    return Mesh(np.asarray(box.vertices, float), np.asarray(box.faces, np.int64), source)


def clustered(mesh: Mesh, grid: float) -> Mesh:
    """The mesh with all vertices in a cube of the grid (m) drawn together into one of them; coarser by < 2 `grid`.

    The hull may shrink or grow by that much. Meant for proximity checks on scans of millions of triangles.
    """
    cell = np.floor((mesh.vertices - mesh.vertices.min(0)) / grid).astype(np.int64)
    size = cell.max(0) + 1
    _, first, place = np.unique(
        (cell[:, 0] * size[1] + cell[:, 1]) * size[2] + cell[:, 2], return_index=True, return_inverse=True
    )
    faces = place[mesh.faces]
    a, b, c = faces.T
    whole = faces[(a != b) & (b != c) & (c != a)]
    # A part smaller than the grid would vanish: leave it as it is.
    return Mesh(mesh.vertices[first], whole, mesh.source) if len(whole) else mesh


@dataclass(frozen=True)
class MassProperties:
    """Mass (kg), centre of mass (3,) and inertia (3, 3) about it, in the mesh's own axes."""

    mass: float
    centre_of_mass: Array
    inertia: Array


def load_mesh(path: str | Path, unit: str = "mm") -> Mesh:
    """Read an STL, OBJ or PLY file whose coordinates are in `unit` (mm, m or inch).

    Raises `MeshError` with the file and the fault: missing, not a mesh, empty, NaN or infinite vertices,
    a face index out of range, or no face with an area.
    """
    path = Path(path)
    if unit not in METRES_PER_UNIT:
        raise MeshError(f"{path}: unit {unit!r} is not known; expected one of {', '.join(METRES_PER_UNIT)}")
    if not path.is_file():
        raise MeshError(f"{path}: {'is not a file' if path.exists() else 'no such file'}")
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        raise MeshError(f"{path}: {suffix or 'no suffix'} is not a mesh format known here: {', '.join(FORMATS)}")
    vertices, faces = _read_obj(path) if suffix == ".obj" else _read_with_trimesh(path, suffix)
    mesh = Mesh(vertices * METRES_PER_UNIT[unit], faces, str(path))
    check_mesh(mesh)
    return mesh


def check_mesh(mesh: Mesh) -> None:
    """Raise `MeshError` unless the mesh is a finite, non-empty set of faces of which at least one has an area."""
    vertices, faces, source = mesh.vertices, mesh.faces, mesh.source
    if len(vertices) == 0 or len(faces) == 0:
        raise MeshError(f"{source}: no triangles ({len(vertices)} vertices, {len(faces)} faces)")
    if faces.min() < 0 or faces.max() >= len(vertices):
        face = int(np.flatnonzero(((faces < 0) | (faces >= len(vertices))).any(1))[0])
        raise MeshError(
            f"{source}: face {face} uses vertex {faces[face].tolist()}, but the vertices are 0 to {len(vertices) - 1}"
        )
    finite = np.isfinite(vertices).all(1)
    if not finite.all():
        row = int(np.flatnonzero(~finite)[0])
        count = int((~finite).sum())
        raise MeshError(f"{source}: vertex {row} is {vertices[row].tolist()}; {count} are NaN or infinite")
    if not (mesh.areas > 0).any():
        raise MeshError(f"{source}: all {len(faces)} triangles are degenerate (no area)")


def _read_with_trimesh(path: Path, suffix: str) -> tuple[Array, NDArray[np.int64]]:
    """STL and PLY. Whatever a broken file makes the reader raise becomes one message."""
    if path.stat().st_size == 0:
        raise MeshError(f"{path}: the file is empty")
    try:
        with path.open("rb") as stream:
            mesh = trimesh.load(stream, file_type=suffix[1:], force="mesh", process=False)
        vertices = np.asarray(mesh.vertices, float).reshape(-1, 3)
        faces = np.asarray(mesh.faces).reshape(-1, 3).astype(np.int64)
    except Exception as error:  # every broken file raises another type
        raise MeshError(f"{path}: not a readable {suffix[1:].upper()} mesh") from error
    if len(vertices) == 0 and len(faces) == 0:
        raise MeshError(f"{path}: holds no {suffix[1:].upper()} mesh: no triangles in it")
    return vertices, faces


def _read_obj(path: Path) -> tuple[Array, NDArray[np.int64]]:
    """Vertices and faces of an OBJ file; polygons become fans, texture and normal indices are ignored."""
    vertex_lines: list[bytes] = []
    polygons: list[list[int]] = []
    corner = re.compile(rb"/\S*")
    try:
        for line in path.read_bytes().replace(b"\\\n", b" ").splitlines():
            if line.startswith((b"v ", b"v\t")):
                vertex_lines.append(line)
            elif line.startswith((b"f ", b"f\t")):
                indices = [int(token) for token in corner.sub(b"", line).split()[1:]]
                # 1 is the first vertex, -1 the last one so far; 0 does not exist and is left to fail the check.
                polygons.append([i - 1 if i >= 0 else len(vertex_lines) + i for i in indices])
        vertices = np.array([line.split()[1:4] for line in vertex_lines], dtype=float)
    except ValueError as error:
        raise MeshError(f"{path}: not a readable OBJ mesh ({error})") from error
    if not vertex_lines and not polygons:
        raise MeshError(f"{path}: not an OBJ mesh: no vertices and no faces in it")
    triangles = [(p[0], p[i], p[i + 1]) for p in polygons for i in range(1, len(p) - 1)]
    if vertices.shape[1:] != (3,) and len(vertices):
        raise MeshError(f"{path}: not a readable OBJ mesh (a vertex has fewer than three coordinates)")
    return vertices.reshape(-1, 3), np.array(triangles, dtype=np.int64).reshape(-1, 3)


def mass_properties(mesh: Mesh, density: float) -> MassProperties:
    """Mass properties of the solid of uniform `density` (kg/m³) inside the mesh.

    A mesh that is not closed has no inside: its convex hull stands in for it.
    """
    # Millimetres keep trimesh's absolute tolerances harmless on small parts.
    solid = trimesh.Trimesh(mesh.vertices * 1e3, mesh.faces, process=True)
    if not (solid.is_watertight and solid.is_winding_consistent) or abs(solid.volume) < 1e-9:
        solid = trimesh.Trimesh(mesh.hull.vertices * 1e3, mesh.hull.faces, process=False)
    if solid.volume < 0:
        solid.invert()
    volume = float(solid.volume) * 1e-9
    inertia = np.asarray(solid.moment_inertia, float) * 1e-15 * density
    return MassProperties(volume * density, np.asarray(solid.center_mass, float) * 1e-3, inertia)


def is_stable_pose(mesh: Mesh, table_from_part: ArrayLike, tolerance: float = 1e-5) -> bool:
    """Whether the part, standing by gravity on the plane z = 0 of the table, stays as it is.

    Stable: the vertices of the hull within `tolerance` (m) of the lowest one enclose the centre of mass,
    seen from above, with a margin of `tolerance`.
    """
    hull = pose.transform_points(table_from_part, mesh.hull.vertices)
    centre = pose.transform_points(table_from_part, mass_properties(mesh, 1.0).centre_of_mass[None])[0]
    feet = hull[hull[:, 2] <= hull[:, 2].min() + tolerance][:, :2] - centre[:2]
    # In every direction the farthest foot must lie beyond the centre; 720 directions miss the narrowest by 1e-5.
    angle = np.linspace(0.0, 2 * np.pi, 720, endpoint=False)
    support = (feet @ np.stack([np.cos(angle), np.sin(angle)])).max(0)
    return bool(support.min() > tolerance)
