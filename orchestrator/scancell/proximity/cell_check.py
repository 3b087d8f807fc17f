"""Check that described bodies of a cell that do not belong to the arm do not intersect."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell.errors import CellError
from scancell.geometry.mesh import Mesh, clustered, sample_surface
from scancell.nominal.cell import NominalCell
from scancell.proximity.judge import fcl_model
from scancell.sensor import closest_points

Array = NDArray[np.float64]

_TOUCH = 0.1e-3  # m: bodies may stand on each other and lie against each other
_SAMPLES = 10_000  # points on a surface at which the depth is measured, beside its vertices
_CELLS = 12  # points along each edge of the common bounding box, to find what coincides
_MANY_FACES = 100_000  # from which on a mesh is made coarser first
_GRID = 0.5e-3  # m: cubes whose vertices are drawn together then

# Platter and base of the table are drawn into each other around their bearing.
_JOINED = frozenset({frozenset({"table", "table_base"})})
_KEYS = {
    "base": "robot.base",
    "table": "table.pose",
    "table_base": "table.pose",
    "part": "part.x_mm, part.y_mm, part.z_mm",
}


def check_cell(nominal: NominalCell) -> None:
    """Raise `CellError` if standing bodies of a cell (robot base, table, belts, parts, obstacles) intersect.

    The table is at angle 0 and the arm does not count: its motion is checked by planning.

    Raises `CellError` naming each pair, the depth in mm, and the keys that place them.
    """
    found = [
        f"'{a}' and '{b}' intersect, about {depth * 1e3:.2g} mm deep: change {_key(a, nominal)} or {_key(b, nominal)}"
        for a, b, depth in _intersections(nominal)
    ]
    if found:
        raise CellError("; ".join(found))


def _intersections(nominal: NominalCell) -> Iterator[tuple[str, str, float]]:
    frames = nominal.frame_poses(nominal.home)
    standing = [body for body in nominal.bodies if body.moves_with.partition("[")[0] in ("world", "table", "part")]
    placed = [(body.name, body.mesh.transformed(frames[body.moves_with])) for body in standing]
    for (a, mesh_a), (b, mesh_b) in combinations(placed, 2):
        if frozenset({a, b}) not in _JOINED:
            depth = penetration(mesh_a, mesh_b)
            if depth > 0.0:
                yield a, b, depth


def _key(body: str, nominal: NominalCell) -> str:
    names = [part.description.name for part in nominal.further_parts]
    if body in names:
        return f"further_part[{names.index(body) + 1}].pose"
    return _KEYS.get(body, f"the pose of '{body}'")


def penetration(a: Mesh, b: Mesh) -> float:
    """Largest distance (m) by which the surface of one mesh lies inside the other; 0 up to `_TOUCH`.

    Meshes in one frame. Where surfaces coincide, the radius of a ball that fits into both counts instead. A mesh that
    is not closed has no inside. Meshes of more than `_MANY_FACES` triangles are made coarser, and 2 `_GRID` more are
    forgiven.
    """
    low, high = np.maximum(a.bounds[0], b.bounds[0]), np.minimum(a.bounds[1], b.bounds[1])
    if (high - low).min() <= _TOUCH:
        return 0.0
    forgiven = _TOUCH
    if max(len(a.faces), len(b.faces)) > _MANY_FACES:
        a, b = (clustered(mesh, _GRID) if len(mesh.faces) > _MANY_FACES else mesh for mesh in (a, b))
        forgiven += 2 * _GRID
    near_a, near_b = _faces_in_box(a, low, high), _faces_in_box(b, low, high)
    whole = [_depth(one.vertices[near[:, 0]], other) for one, near, other in ((a, near_a, b), (b, near_b, a))]
    # Where surfaces do not meet, a shell lies in the other mesh with all of its vertices or not at all.
    if not np.concatenate(whole).any() and not _surfaces_meet(a, near_a, b, near_b):
        return 0.0
    on_a, on_b = _points_in_box(a, near_a, low, high), _points_in_box(b, near_b, low, high)
    depth = max(_depth(on_a, b).max(initial=0), _depth(on_b, a).max(initial=0))
    if depth <= forgiven:
        cells = np.stack(np.meshgrid(*[np.linspace(0, 1, _CELLS + 2)[1:-1]] * 3), -1).reshape(-1, 3)
        inner = low + cells * (high - low)
        depth = np.minimum(_depth(inner, a), _depth(inner, b)).max()
    return float(depth) if depth > forgiven else 0.0


def _faces_in_box(mesh: Mesh, low: Array, high: Array) -> NDArray[np.int64]:
    """Faces (k, 3) whose bounding boxes meet the box."""
    corners = mesh.vertices[mesh.faces]
    meets = ((corners.min(1) <= high) & (corners.max(1) >= low)).all(1)
    return np.asarray(mesh.faces[meets])


def _points_in_box(mesh: Mesh, faces: NDArray[np.int64], low: Array, high: Array) -> Array:
    """Vertices of `faces` and points drawn evenly from their area, those in the box."""
    points, near = mesh.vertices[faces].reshape(-1, 3), Mesh(mesh.vertices, faces)
    if near.areas.any():
        points = np.concatenate([points, sample_surface(near, _SAMPLES, 0)[0]])
    return np.asarray(points[((points >= low) & (points <= high)).all(1)])


def _depth(points: Array, solid: Mesh) -> Array:
    """How deep each of the points (n, 3) lies inside, m; 0 outside."""
    if not len(points) or not solid.is_closed:
        return np.zeros(len(points))
    _, _, signed = closest_points(solid.vertices, solid.faces.astype(np.uint32), points)
    return np.maximum(-np.asarray(signed), 0.0)


def _surfaces_meet(a: Mesh, faces_a: NDArray[np.int64], b: Mesh, faces_b: NDArray[np.int64]) -> bool:
    if not len(faces_a) or not len(faces_b):
        return False
    import fcl  # noqa: PLC0415  (only where bounding boxes overlap)

    def body(mesh: Mesh, faces: NDArray[np.int64]) -> Any:
        used, numbers = np.unique(faces, return_inverse=True)
        return fcl.CollisionObject(fcl_model(mesh.vertices[used], numbers.reshape(-1, 3)), fcl.Transform())

    contacts = fcl.collide(body(a, faces_a), body(b, faces_b), fcl.CollisionRequest(), fcl.CollisionResult())
    return bool(contacts > 0)
