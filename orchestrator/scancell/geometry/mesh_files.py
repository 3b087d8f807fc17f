"""Reading of triangle meshes from STL, OBJ and PLY files, and welding of equal vertices."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell.errors import MeshError
from scancell.files import require_file
from scancell.geometry.orientation import connected_components

Vertices = NDArray[np.floating[Any]]
Faces = NDArray[np.int64]

FORMATS = (".stl", ".obj", ".ply")

_STL_HEAD = 84  # bytes: header and number of triangles
_STL_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_BLOCK = 1 << 16
_ROUNDING = 1e-6  # of the largest coordinate: a few last digits of single precision


def read_mesh(path: Path) -> tuple[Vertices, Faces]:
    """Vertices (n, 3) in the unit of the file and faces (m, 3), neither welded nor validated.

    Raises `MeshError` if the file is missing, empty, of an unknown format, or broken.
    """
    require_file(path, MeshError)
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        raise MeshError(f"{suffix or 'no suffix'} is not a mesh format", file=path, expected=", ".join(FORMATS))
    if suffix == ".obj":
        return _read_obj(path)
    if suffix == ".stl":
        triangles = _read_binary_stl(path)
        if triangles is not None:
            return triangles, np.arange(len(triangles)).reshape(-1, 3)
    return _read_with_trimesh(path, suffix)


def weld(vertices: Vertices) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Merge vertices (n, 3) of equal coordinates.

    A tenth of the time of `np.unique` and a fifth of that of trimesh, which sort: 0.4 s for a million triangles.

    Returns
    -------
    first
        (k,) indices of the vertices to keep, ascending: the first one at each position.
    number
        (n,) index of each vertex among those kept.
    """
    hashes = _position_hashes(vertices)
    earliest = np.arange(len(hashes))
    pending = earliest
    slots = 1 << len(hashes).bit_length()
    table = np.empty(slots, np.int64)
    # Vectorised hash table: the first vertex of each slot is stored, those of other hashes are inserted next round.
    while len(pending):
        slot = (hashes[pending] & np.uint64(slots - 1)).astype(np.int64)
        table[slot[::-1]] = pending[::-1]
        found = table[slot]
        same = hashes[found] == hashes[pending]
        earliest[pending[same]] = found[same]
        pending = pending[~same]
    kept = earliest == np.arange(len(hashes))
    return np.flatnonzero(kept), (np.cumsum(kept) - 1)[earliest]


def weld_seams(vertices: Vertices, faces: Faces) -> Faces:
    """Faces (m, 3) after joining vertices of open edges that differ by rounding only.

    CAD programs write a corner that two faces share as 0 in one of them and as 1e-17 in the other.
    """
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    edges, count = np.unique(edges, axis=0, return_counts=True)
    rim = np.unique(edges[count == 1])
    if not len(rim):
        return faces
    cells = vertices[rim] / (_ROUNDING * np.abs(vertices).max())
    # Two grids, as a pair may lie on both sides of the border of a cell of one of them.
    joined = [rim[first[number]] for first, number in (weld(np.round(cells)), weld(np.round(cells + 0.5)))]
    label = connected_components(len(vertices), np.concatenate([rim, rim]), np.concatenate(joined))
    return np.unique(label, return_index=True)[1][label][faces]


def _position_hashes(vertices: Vertices) -> NDArray[np.uint64]:
    """64-bit hashes (n,) of positions (n, 3); collision probability 2^-64 per pair."""
    bits = np.dtype(f"u{vertices.dtype.itemsize}")
    factor, shift = np.uint64(0x9E3779B97F4A7C15), np.uint64(32)
    hashes = np.empty(len(vertices), np.uint64)
    for start in range(0, len(vertices), _BLOCK):
        positions = np.ascontiguousarray(vertices[start : start + _BLOCK] + vertices.dtype.type(0))  # -0 becomes 0
        value = np.zeros(len(positions), np.uint64)
        for column in positions.view(bits).T:
            value = (value + column) * factor
            value = (value ^ (value >> shift)) * factor
            value ^= value >> shift
        hashes[start : start + _BLOCK] = value
    return hashes


def write_stl(path: Path, vertices: Vertices, faces: Faces) -> None:
    """Write a binary STL file of vertices (n, 3), in the unit of the file, and faces (m, 3); its normals are zero."""
    triangles = np.zeros(len(faces), _STL_TRIANGLE)
    triangles["corners"] = vertices[faces].reshape(triangles["corners"].shape)
    head = b"scancell".ljust(80, b" ") + len(faces).to_bytes(4, "little")
    path.write_bytes(head + triangles.tobytes())


def _read_binary_stl(path: Path) -> Vertices | None:
    """Corners (3 m, 3), float32, of a binary STL file; None if the file size does not match its triangle count."""
    size = path.stat().st_size
    with path.open("rb") as stream:
        head = stream.read(_STL_HEAD)
        count = int.from_bytes(head[80:], "little")
        if len(head) < _STL_HEAD or count == 0 or size != _STL_HEAD + count * _STL_TRIANGLE.itemsize:
            return None
        triangles = np.fromfile(stream, _STL_TRIANGLE, count)
    return triangles["corners"].reshape(-1, 3)


def _read_with_trimesh(path: Path, suffix: str) -> tuple[Vertices, Faces]:
    """Vertices and faces of a PLY or text STL file; any exception of the reader becomes a `MeshError`."""
    import trimesh  # noqa: PLC0415  (half a second, which binary STL files need not pay)

    try:
        with path.open("rb") as stream:
            mesh = trimesh.load(stream, file_type=suffix[1:], force="mesh", process=False)
        vertices = np.asarray(mesh.vertices, float).reshape(-1, 3)
        faces = np.asarray(mesh.faces).reshape(-1, 3).astype(np.int64)
    except Exception as error:  # the type depends on how the file is broken
        raise MeshError(f"not a readable {suffix[1:].upper()} mesh", file=path) from error
    if len(vertices) == 0 and len(faces) == 0:
        raise MeshError(f"holds no {suffix[1:].upper()} mesh: no triangles", file=path)
    return vertices, faces


def _read_obj(path: Path) -> tuple[Vertices, Faces]:
    """Vertices and faces of an OBJ file; polygons become triangle fans, texture and normal indices are ignored.

    trimesh splits the surface where texture coordinates change, or, told not to, does not resolve negative indices.
    """
    vertex_lines: list[bytes] = []
    polygons: list[list[int]] = []
    corner = re.compile(rb"/\S*")
    try:
        for line in path.read_bytes().replace(b"\\\n", b" ").splitlines():
            if line.startswith((b"v ", b"v\t")):
                vertex_lines.append(line)
            elif line.startswith((b"f ", b"f\t")):
                indices = [int(token) for token in corner.sub(b"", line).split()[1:]]
                # 1 is the first vertex, -1 the last one so far; 0 is invalid and fails validation later.
                polygons.append([i - 1 if i >= 0 else len(vertex_lines) + i for i in indices])
        vertices = np.array([line.split()[1:4] for line in vertex_lines], dtype=float)
    except ValueError as error:
        raise MeshError(f"not a readable OBJ mesh ({error})", file=path) from error
    if not vertex_lines and not polygons:
        raise MeshError("not an OBJ mesh: no vertices and no faces", file=path)
    triangles = [(p[0], p[i], p[i + 1]) for p in polygons for i in range(1, len(p) - 1)]
    if vertices.shape[1:] != (3,) and len(vertices):
        raise MeshError("not a readable OBJ mesh (a vertex has fewer than three coordinates)", file=path)
    return vertices.reshape(-1, 3), np.array(triangles, dtype=np.int64).reshape(-1, 3)
