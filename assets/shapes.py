"""Solid shapes for the asset meshes, in millimetres, and the STL writer. Used by make_assets.py only."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Literal

import numpy as np
from manifold3d import CrossSection, Manifold, Mesh, OpType
from numpy.typing import ArrayLike

Axis = Literal["x", "y", "z"]

_TURN = {"x": (0.0, 90.0, 0.0), "y": (-90.0, 0.0, 0.0), "z": (0.0, 0.0, 0.0)}  # takes +z to +axis


def drum(
    radius: float,
    low: float,
    high: float,
    *,
    axis: Axis = "z",
    at: tuple[float, float, float] = (0.0, 0.0, 0.0),
    chamfer: float = 3.0,
    segments: int = 64,
) -> Manifold:
    """Cylinder about `axis` through `at`, from `low` to `high` along it, both rims chamfered."""
    body = Manifold.cylinder(high - low - 2 * chamfer, radius, radius, segments).translate((0, 0, low + chamfer))
    if chamfer > 0:
        core = Manifold.cylinder(high - low, radius - chamfer, radius - chamfer, segments).translate((0, 0, low))
        body = hull(body, core)
    return body.rotate(_TURN[axis]).translate(at)


def cone(radius_low: float, radius_high: float, low: float, high: float, segments: int = 64) -> Manifold:
    """Frustum about z."""
    return Manifold.cylinder(high - low, radius_low, radius_high, segments).translate((0, 0, low))


def block(
    low: tuple[float, float, float], high: tuple[float, float, float], corner: float = 0.0, chamfer: float = 0.0
) -> Manifold:
    """Box between two corners, its edges along z rounded by `corner`, top and bottom rims chamfered."""
    size = np.subtract(high, low)
    outline = CrossSection.square((size[0] - 2 * corner, size[1] - 2 * corner), center=True)
    if corner > 0:
        outline = outline.offset(corner, circular_segments=32)
    body = Manifold.extrude(outline, size[2] - 2 * chamfer).translate((0, 0, low[2] + chamfer))
    if chamfer > 0:
        scale = ((size[0] - 2 * chamfer) / size[0], (size[1] - 2 * chamfer) / size[1])
        core = Manifold.extrude(outline.scale(scale), size[2]).translate((0, 0, low[2]))
        body = hull(body, core)
    return body.translate((*(np.add(low, high) / 2)[:2], 0))


def hull(*solids: Manifold) -> Manifold:
    """Convex hull of all of them together."""
    return Manifold.batch_hull(list(solids))


def union(solids: Iterable[Manifold]) -> Manifold:
    """All of them in one."""
    return Manifold.batch_boolean(list(solids), OpType.Add)


def ring_of(
    solid: Manifold, count: int, axis: Axis = "z", start_deg: float = 0.0, arc_deg: float = 360.0
) -> list[Manifold]:
    """`count` copies of `solid` spread over an arc around `axis`."""
    column = "xyz".index(axis)
    angles = start_deg + arc_deg * np.arange(count) / count
    return [solid.rotate(tuple(float(a) if i == column else 0.0 for i in range(3))) for a in angles]


def solid_from(vertices: ArrayLike, faces: ArrayLike) -> Manifold:
    """Solid of a closed triangle mesh, counter-clockwise seen from outside."""
    return Manifold(Mesh(np.asarray(vertices, np.float32), np.asarray(faces, np.uint32)))


def write_stl(path: Path, solid: Manifold) -> int:
    """Write a binary STL without a date or a name, so that equal shapes make equal bytes; returns its face count."""
    mesh = solid.to_mesh()
    corners = np.asarray(mesh.vert_properties, np.float32)[:, :3][np.asarray(mesh.tri_verts)]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).astype(np.float64)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    record = np.zeros(len(corners), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    record["normal"] = normals / np.where(length > 0, length, 1.0)
    record["corners"] = corners
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(bytes(80) + np.uint32(len(record)).tobytes() + record.tobytes())
    return len(record)
