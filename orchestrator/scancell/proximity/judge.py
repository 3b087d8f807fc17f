"""Collisions along a motion by python-fcl: an independent check of motions that our own distances found free.

The judge shares no list of pairs with what it judges. It compares all bodies whose poses relative to each other change,
except those that touch each other at the start by construction: a link and the next one, a platter and its bearing, a
part and what it stands on.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.arrays import Array
from scancell.errors import CellError
from scancell.geometry.mesh import Mesh, clustered, sample_surface
from scancell.nominal.cell import NominalCell
from scancell.proximity.scene import Clash
from scancell.sensor import closest_points

_STILL = 1e-9  # m and rad: pairs that moved less since they were last checked are not checked again
_TOUCHING = 1e-6  # m: bodies that are closer at the start touch each other

_TOUCH = 0.1e-3  # m: bodies may stand on each other and lie against each other
_SAMPLES = 10_000  # points on a surface at which the depth is measured, beside its vertices
_CELLS = 12  # points along each edge of the common bounding box, to find what coincides
_MANY_FACES = 100_000  # from which on a mesh is made coarser first
_GRID = 0.5e-3  # m: cubes whose vertices are drawn together then

# Platter and base of the table are drawn into each other around their bearing.
_JOINED = {"table", "table_base"}
_KEYS = {
    "base": "robot.base",
    "table": "table.pose",
    "table_base": "table.pose",
    "part": "part.x_mm, part.y_mm, part.z_mm",
}


class Judge:
    """Judges many motions of the same bodies.

    Parameters
    ----------
    meshes
        Mesh of each body by name, in the body's frame, m.
    names
        Bodies in the order of their poses.
    start
        Poses (bodies, 4, 4), m, at which the bodies that touch each other do so by construction; they are not compared.
    ignored
        Pairs of names that are not compared either.
    """

    def __init__(
        self,
        meshes: Mapping[str, Mesh],
        names: Sequence[str],
        start: ArrayLike,
        ignored: Collection[frozenset[str]] = (),
    ) -> None:
        self._meshes, self._names = meshes, names
        pairs = [(a, b) for a, b in combinations(range(len(names)), 2) if {names[a], names[b]} not in ignored]
        self._index = np.array(pairs, np.int64).reshape(-1, 2)
        self._middle = np.array([meshes[name].bounds.mean(0) for name in names])
        self._half = np.array([np.ptp(meshes[name].bounds, axis=0) / 2 for name in names])
        self._objects: dict[str, Any] = {}  # of bodies whose boxes have met those of others
        self._index = self._index[~self._touching(np.asarray(start, float))]

    @property
    def pairs(self) -> list[tuple[str, str]]:
        """Names of the bodies that are compared."""
        return [(self._names[a], self._names[b]) for a, b in self._index]

    def first_collision(self, poses: ArrayLike) -> Clash | None:
        """The first of the poses (n, bodies, 4, 4), m, at which surfaces of a pair intersect, or None."""
        import fcl  # noqa: PLC0415  (most commands make no plan)

        poses = np.asarray(poses, float)
        near = np.zeros((len(poses), len(self._index)), bool)
        columns = self._within_reach(poses)
        near[:, columns] = self._overlapping(poses, self._index[columns])
        request, result = fcl.CollisionRequest(), fcl.CollisionResult()
        for i, k in zip(*np.nonzero(near), strict=True):
            if fcl.collide(*self._placed(poses[i], self._index[k]), request, result):
                a, b = self._index[k]
                return Clash(int(i), self._names[a], self._names[b], 0.0, 0.0)
        return None

    def _touching(self, poses: Array) -> NDArray[np.bool_]:
        """Whether the bodies of each pair touch at poses (bodies, 4, 4)."""
        import fcl  # noqa: PLC0415  (most commands make no plan)

        found = self._overlapping(poses[None], self._index, _TOUCHING)[0]
        for k in np.flatnonzero(found).tolist():
            request, result = fcl.DistanceRequest(), fcl.DistanceResult()
            found[k] = fcl.distance(*self._placed(poses, self._index[k]), request, result) < _TOUCHING
        return np.asarray(found)

    def _placed(self, poses: Array, pair: ArrayLike) -> list[Any]:
        """The bodies of a pair of numbers at poses (bodies, 4, 4)."""
        import fcl  # noqa: PLC0415  (most commands make no plan)

        placed = []
        for k in np.asarray(pair).tolist():
            name = self._names[k]
            if name not in self._objects:  # kept and moved: a new one takes a pass over all vertices
                mesh = self._meshes[name]
                self._objects[name] = fcl.CollisionObject(fcl_model(mesh.vertices, mesh.faces))
            self._objects[name].setTransform(fcl.Transform(poses[k, :3, :3], poses[k, :3, 3]))
            placed.append(self._objects[name])
        return placed

    def _within_reach(self, poses: Array, margin: float = 0.0) -> NDArray[np.int64]:
        """Pairs whose bounding spheres are nearer than `margin` (m), or overlap, at one of the poses."""
        rotation, position = poses[..., :3, :3], poses[..., :3, 3]
        centre = position + (rotation @ self._middle[..., None])[..., 0]
        one, other = self._index.T
        between = np.linalg.norm(centre[:, one] - centre[:, other], axis=-1)
        radius = np.linalg.norm(self._half, axis=1)
        return np.flatnonzero((between <= radius[one] + radius[other] + margin).any(0))

    def _overlapping(self, poses: Array, index: NDArray[np.int64], margin: float = 0.0) -> NDArray[np.bool_]:
        """Whether bodies (pairs, 2) moved since the pose before and their bounding boxes overlap, (n, pairs).

        The boxes are compared in the frames of both bodies, the first of each pair grown by `margin` (m).
        """
        one, other = index.T
        first, second = poses[:, one], poses[:, other]
        back = np.swapaxes(first[..., :3, :3], -1, -2)
        turn = back @ second[..., :3, :3]
        offset = (back @ (second[..., :3, 3] - first[..., :3, 3])[..., None])[..., 0]
        reach = np.abs(turn)
        middle, half = self._middle, self._half
        in_first = offset + np.einsum("npij,pj->npi", turn, middle[other]) - middle[one]
        overlap = (np.abs(in_first) <= half[one] + margin + np.einsum("npij,pj->npi", reach, half[other])).all(-1)
        in_second = np.einsum("npji,npj->npi", turn, in_first)
        overlap &= (np.abs(in_second) <= half[other] + np.einsum("npji,pj->npi", reach, half[one] + margin)).all(-1)
        moved = np.ones_like(overlap)
        moved[1:] = (np.abs(np.diff(offset, axis=0)) > _STILL).any(-1)
        moved[1:] |= (np.abs(np.diff(turn, axis=0)) > _STILL).any((-1, -2))
        return np.asarray(overlap & moved)


def fcl_model(vertices: Array, faces: NDArray[np.int64]) -> Any:
    """Triangles (m, 3) of vertices (n, 3), m, as a geometry of python-fcl."""
    import fcl  # noqa: PLC0415  (most commands need none)

    model = fcl.BVHModel()
    model.beginModel(len(vertices), len(faces))
    model.addSubModel(np.ascontiguousarray(vertices), np.ascontiguousarray(faces))
    model.endModel()
    return model


def check_cell(nominal: NominalCell) -> None:
    """Raise `CellError` if standing bodies of a cell (robot base, table, belts, parts, obstacles) intersect.

    The table is at angle 0, other axes where they start, and the arm does not count: its motion is checked by planning.
    Obstacles on one carrier may intersect, and so may all bodies on one further axis: they are one rigid body. What an
    axis carries may intersect what carries the axis, in its bearing, except for the arm and the platter.

    Raises `CellError` naming each pair, the depth in mm, and the keys that place them.
    """
    carriers = {body.name: body.moves_with for body in nominal.bodies}
    below = {axis.name: axis.joint.parent for axis in nominal.further_axes}
    nominal = nominal.with_axes_held()
    frames = nominal.frame_poses(nominal.home)
    carried = {body.name: nominal.carrier(body.moves_with).partition("[")[0] for body in nominal.bodies}
    kinds = {"world", "table", "part"} - ({"part"} if nominal.holds_part else set())
    standing = [body for body in nominal.bodies if carried[body.name] in kinds]
    placed = [(body.name, body.mesh.transformed(frames[body.moves_with])) for body in standing]
    problems = []
    for (a, mesh_a), (b, mesh_b) in combinations(placed, 2):
        one, other = carriers[a], carriers[b]
        is_one_body = one == other and (one in below or not {a, b} & set(_KEYS))
        is_bearing = (below.get(one) == other or below.get(other) == one) and not {a, b} & {"base", "table"}
        depth = 0.0 if is_one_body or is_bearing or {a, b} == _JOINED else penetration(mesh_a, mesh_b)
        if depth > 0.0:
            keys = f"{_key(a, nominal)} or {_key(b, nominal)}"
            problems.append(f"'{a}' and '{b}' intersect, about {depth * 1e3:.2g} mm deep: change {keys}")
    if problems:
        raise CellError("; ".join(problems))


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
