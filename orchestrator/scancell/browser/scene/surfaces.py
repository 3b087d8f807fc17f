"""Meshes and colours of bodies for a renderer that shades smoothly between vertices."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scancell.config.material import Material
from scancell.geometry.mesh import Mesh
from scancell.geometry.mesh_files import weld
from scancell.geometry.reduction import decimated
from scancell.nominal.cell import Body
from scancell.views.pictures import painted

Vertices = NDArray[np.float32]
Faces = NDArray[np.uint32]
DrawnMesh = tuple[Vertices, Faces]
Rgb = tuple[int, int, int]

_MOST_FACES = 150_000  # of a body on the screen; more only take longer to load
_CREASE = np.radians(32.0)  # edges at which the surface bends by more are drawn sharp
_INSET = 0.3e-3  # m by which the scanned part is drawn smaller, or it would hide half of its cloud
_METALS = ("rough_conductor", "grooved_conductor", "mirror")
_PAINT, _METAL = np.array([1.0, 0.985, 0.95]), np.array([0.94, 0.97, 1.0])
_DARKEST = 0.14  # displayed brightness; blacker surfaces would lose their shape


def drawn_mesh(body: Body) -> DrawnMesh:
    """Vertices (n, 3), m, and faces (m, 3) of a body, simplified where it is huge, with `split_at_creases`."""
    mesh = decimated(body.mesh, _MOST_FACES)
    return split_at_creases(inset(mesh, _INSET) if body.moves_with == "part" else mesh)


def inset(mesh: Mesh, depth: float) -> Mesh:
    """The mesh with its vertices moved inwards by `depth`, m, along the mean normals of their faces."""
    first, number = weld(mesh.vertices)
    normals = np.zeros((len(first), 3))
    np.add.at(normals, number[mesh.faces], (mesh.areas[:, None] * mesh.normals)[:, None])
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    moved = mesh.vertices[first] - depth * normals / np.where(length > 0, length, 1.0)
    return Mesh(moved[number], mesh.faces, mesh.source)


def split_at_creases(mesh: Mesh, angle: float = _CREASE) -> DrawnMesh:
    """Vertices (n, 3), m, and faces (m, 3), in their order, so that faces share a vertex only across smooth edges.

    A renderer that takes the mean normal of the faces at each vertex then draws edges sharp where the normals of both
    faces differ by more than `angle` (rad).
    """
    from scipy.sparse import coo_array  # noqa: PLC0415  (takes a while to import)
    from scipy.sparse.csgraph import connected_components  # noqa: PLC0415

    first, number = weld(mesh.vertices)
    faces = number[mesh.faces].astype(np.int64)
    corner = np.arange(3 * len(faces)).reshape(-1, 3)  # of a face: the vertices, were none shared
    start, end = faces.ravel(), np.roll(faces, -1, 1).ravel()
    from_corner, to_corner = corner.ravel(), np.roll(corner, -1, 1).ravel()
    low, high = np.minimum(start, end), np.maximum(start, end)
    order = np.lexsort((high, low))
    one, other = order[:-1], order[1:]
    normals = mesh.normals
    smooth = (low[one] == low[other]) & (high[one] == high[other])
    smooth &= np.einsum("ni,ni->n", normals[one // 3], normals[other // 3]) >= np.cos(angle)
    one, other = one[smooth], other[smooth]
    at_low = np.where(start == low, from_corner, to_corner)
    at_high = np.where(start == low, to_corner, from_corner)
    rows, columns = np.concatenate([at_low[one], at_high[one]]), np.concatenate([at_low[other], at_high[other]])
    joined = coo_array((np.ones(len(rows), np.int8), (rows, columns)), shape=(corner.size, corner.size))
    count, vertex = connected_components(joined, directed=False)
    source = np.zeros(count, np.int64)
    source[vertex] = start
    vertices = np.asarray(mesh.vertices[first][source], np.float32)
    return vertices, np.asarray(vertex.reshape(-1, 3), np.uint32)


def body_colour(body: Body, number: int) -> Rgb:
    """Displayed colour of a body: parts, belts and obstacles by their material, the machine as in pictures."""
    machine = ("base", "table", "table_base", "sensor", "gripper")
    if body.name in machine or body.moves_with.startswith(("link[", "finger[")):
        return as_rgb(painted(body, number).colour)
    return material_colour(body.material)


def material_colour(material: Material) -> Rgb:
    """Displayed colour of a material: its reflectance as grey, metals colder than paint."""
    tint = _METAL if material.model in _METALS else _PAINT
    return as_rgb(tint * max(np.sqrt(material.reflectance), _DARKEST))


def as_rgb(colour: NDArray[np.float64] | tuple[float, float, float]) -> Rgb:
    """Values 0 to 255 of a displayed colour, 0 to 1."""
    red, green, blue = (round(255 * float(share)) for share in colour)
    return red, green, blue
