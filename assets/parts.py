"""Parts to scan, in millimetres, standing on z = 0."""

from __future__ import annotations

import numpy as np
from manifold3d import Manifold
from numpy.typing import NDArray
from shapes import block, cone, drum, hull, solid_from, union

SPHERE_RADIUS = 25.0
SPHERE_CENTRE_Z = 45.0


def sphere_on_foot() -> Manifold:
    """Sphere of 50 mm diameter, its centre 45 mm above the table, on a stem and a round foot.

    The corners of the facets lie on the sphere, their middles up to 4 µm inside.
    """
    vertices, faces = _subdivided(*_icosahedron(), 45)
    ball = solid_from(vertices * SPHERE_RADIUS + [0, 0, SPHERE_CENTRE_Z], faces)
    foot = union([drum(22, 0, 6, chamfer=1, segments=96), cone(12, 7, 5.5, 12), drum(7, 5, 30, chamfer=0)])
    return ball + foot


def step_block() -> Manifold:
    """Staircase of steps 0.5 to 8 mm high with sharp edges, a groove across it and a ramp at its end."""
    heights = (10.0, 10.5, 12.0, 15.0, 19.0, 27.0)
    stairs = [block((-45 + 12 * i, -25, 0), (-45 + 12 * i + 12.0, 25, z)) for i, z in enumerate(heights)]
    ramp = _prism([(27, 0), (45, 0), (45, 12), (27, 27)], -25, 25)
    groove = block((-50, -3, 7), (50, 3, 40))
    return union([*stairs, ramp]) - groove


def free_form() -> Manifold:
    """Smooth body of some 80 × 60 × 40 mm on a flat bottom: a star-shaped surface, smooth everywhere above it."""
    vertices, faces = _subdivided(*_half_octahedron(), 100)
    top = vertices * _free_form_radius(vertices)[:, None]
    top[:, :2] -= (top[:, :2].min(0) + top[:, :2].max(0)) / 2
    rim = _boundary_loop(faces)
    centre = len(top)
    bottom = np.stack([np.roll(rim, -1), rim, np.full(len(rim), centre)], 1)
    return solid_from(np.vstack([top, [0.0, 0.0, 0.0]]), np.vstack([faces, bottom]))


def machined() -> Manifold:
    """Milled block with pockets, a boss, bores, a counterbored pattern, a slot and chamfered edges."""
    body = block((-45, -30, 0), (45, 30, 22), corner=5, chamfer=1.5)
    body += hull(drum(16, 20, 22, at=(-18, 0, 0), chamfer=0), drum(14, 20, 32, at=(-18, 0, 0), chamfer=1))
    pocket = block((10, -20, 12), (37, 20, 30), corner=6) - drum(7, 0, 19, at=(23.5, 0, 0), chamfer=0)
    bore = drum(8, -1, 40, at=(-18, 0, 0), chamfer=0) + cone(8, 12, 28.5, 32.5).translate((-18, 0, 0))
    corners = [(-38.0, -23.0), (-38.0, 23.0), (2.0, -23.0), (2.0, 23.0)]
    screws = [drum(2.6, -1, 40, at=(x, y, 0), chamfer=0, segments=40) for x, y in corners]
    heads = [drum(4.7, 16, 40, at=(x, y, 0), chamfer=0, segments=48) for x, y in corners]
    slot = hull(drum(3, 15, 30, at=(-33, 14, 0), chamfer=0), drum(3, 15, 30, at=(-33, -14, 0), chamfer=0))
    bevel = _prism([(39, 23), (46, 23), (46, 16)], -31, 31)
    return body - union([pocket, bore, *screws, *heads, slot, bevel])


def _prism(outline_xz: list[tuple[float, float]], low: float, high: float) -> Manifold:
    """Convex outline in x and z drawn along y."""
    return Manifold.hull_points([(x, y, z) for x, z in outline_xz for y in (low, high)])


def _free_form_radius(direction: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance (n,) from the origin to the surface along unit vectors (n, 3): an ellipsoid with smooth waves."""
    x, y, z = direction.T
    ellipsoid = 1.0 / np.sqrt((x / 40.0) ** 2 + (y / 30.0) ** 2 + (z / 37.0) ** 2)
    waves = 0.09 * np.cos(4.2 * x + 0.8) * np.cos(2.6 * y - 0.4) + 0.05 * np.sin(5.0 * y + 2.0 * x) * (1.0 - z * z)
    dent = -0.13 * np.exp(-((x - 0.35) ** 2 + (y + 0.15) ** 2 + (z - 0.92) ** 2) / 0.16)
    return ellipsoid * (1.0 + waves + dent)


def _icosahedron() -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    g = (1 + np.sqrt(5)) / 2
    planes = [(-1, g), (1, g), (-1, -g), (1, -g)]
    v = [(a, b, 0) for a, b in planes] + [(0, a, b) for a, b in planes] + [(b, 0, a) for a, b in planes]
    faces = [(0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11), (1, 5, 9), (5, 11, 4), (11, 10, 2)]
    faces += [(10, 7, 6), (7, 1, 8), (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8), (3, 8, 9), (4, 9, 5), (2, 4, 11)]
    faces += [(6, 2, 10), (8, 6, 7), (9, 8, 1)]
    return np.array(v, float) / np.sqrt(1 + g * g), np.array(faces)


def _half_octahedron() -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    vertices = np.array([[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [0, 0, 1]], float)
    return vertices, np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])


def _subdivided(
    vertices: NDArray[np.float64], faces: NDArray[np.int64], parts: int
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Cut each edge into `parts`, put all vertices on the unit sphere, share equal ones."""
    rows = [(i, j) for i in range(parts + 1) for j in range(parts + 1 - i)]
    number = {ij: k for k, ij in enumerate(rows)}
    weights = np.array([(parts - i - j, i, j) for i, j in rows], float) / parts
    cells = [(number[i, j], number[i + 1, j], number[i, j + 1]) for i, j in rows if i + j < parts]
    cells += [(number[i + 1, j], number[i + 1, j + 1], number[i, j + 1]) for i, j in rows if i + j < parts - 1]
    points = np.einsum("wk,fkd->fwd", weights, vertices[faces]).reshape(-1, 3)
    triangles = (np.array(cells)[None] + (np.arange(len(faces)) * len(rows))[:, None, None]).reshape(-1, 3)
    _, first, shared = np.unique(np.round(points, 9), axis=0, return_index=True, return_inverse=True)
    points = points[first]
    return points / np.linalg.norm(points, axis=1, keepdims=True), shared.reshape(-1)[triangles]


def _boundary_loop(faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """Vertices along the open rim, in the sense of the faces that end there."""
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    known = {(int(a), int(b)) for a, b in edges}
    following = {a: b for a, b in known if (b, a) not in known}
    loop = [min(following)]
    while (step := following[loop[-1]]) != loop[0]:
        loop.append(step)
    return np.array(loop)
