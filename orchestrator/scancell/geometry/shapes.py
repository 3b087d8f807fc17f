"""Solids and surfaces of exact shape: signed distance in closed form, normals, and tessellations."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.arrays import Array
from scancell.geometry import pose
from scancell.geometry.cad import CadMesh
from scancell.geometry.mesh import Mesh, box_mesh, joined
from scancell.sensor import MeshSurface

_BLOCK = 1 << 15  # points worked on at a time, which stay in the cache
_ON_EDGE = 1e-9  # m: accuracy of distances from edges
CHORD_ERROR = 10e-6  # m: default distance of a tessellation from its shape


def chords(radius: float, chord_error: float) -> int:
    """Even number of chords of a circle that stay within `chord_error` of it."""
    half_angle = np.arccos(max(1.0 - chord_error / radius, 0.5))
    return 2 * int(np.ceil(np.pi / half_angle / 2))


def revolved_mesh(profile: Array, segments: int, source: str) -> Mesh:
    """Mesh of a polyline (k, 2) of radius and z, material on its left, turned about z."""
    angle = 2 * np.pi * np.arange(segments) / segments
    circle = np.stack([np.cos(angle), np.sin(angle)], 1)
    is_closed = bool((profile[0] == profile[-1]).all())
    corners = profile[:-1] if is_closed else profile
    rings = [_ring(radius, z, circle) for radius, z in corners]
    first = np.cumsum([0, *(len(ring) for ring in rings)])
    pairs = [(k, (k + 1) % len(rings)) for k in range(len(profile) - 1)]
    strips = [_strip(int(first[a]), len(rings[a]), int(first[b]), len(rings[b])) for a, b in pairs]
    return Mesh(np.concatenate(rings), np.concatenate(strips), source)


def _ring(radius: float, z: float, circle: Array) -> Array:
    """Vertices of one corner of the profile: a circle, or a point on the axis."""
    if radius == 0.0:
        return np.array([[0.0, 0.0, z]])
    return np.column_stack([radius * circle, np.full(len(circle), z)])


def _strip(low: int, low_count: int, high: int, high_count: int) -> NDArray[np.int64]:
    """Faces between two rings of vertices, of which one may be a point."""
    count = max(low_count, high_count)
    here = np.arange(count)
    after = (here + 1) % count
    below = np.stack([low + here, low + after, high + after % high_count], 1)
    above = np.stack([low + here % low_count, high + after, high + here], 1)
    return np.concatenate([below] * (low_count > 1) + [above] * (high_count > 1))


@dataclass(frozen=True)
class Shape(ABC):
    """A surface in its own frame; dimensions in metres. `ValueError` for a dimension that is not positive."""

    is_solid: ClassVar[bool] = True

    def __post_init__(self) -> None:
        for one in fields(self):
            value = getattr(self, one.name)
            if not (np.isfinite(value) and value > 0.0):
                raise ValueError(f"{type(self).__name__}: {one.name} = {value!r} m, expected a positive number")

    @property
    @abstractmethod
    def reach(self) -> float:
        """Distance of the farthest point from the origin."""

    @abstractmethod
    def nearest(self, points: ArrayLike) -> tuple[Array, Array]:
        """Signed distance (n,), m, positive outside, of points (n, 3), and its gradient (n, 3), a unit normal.

        Where the gradient is not defined (centre of a sphere, axis of a cylinder), one of its limits is returned.
        """

    @abstractmethod
    def mesh(self, chord_error: float = CHORD_ERROR) -> Mesh:
        """Triangles with vertices on the surface and at most `chord_error` (m) away from it; faces outwards."""


@dataclass(frozen=True)
class Sphere(Shape):
    """Sphere around the origin."""

    radius: float

    @property
    def reach(self) -> float:
        """See `Shape.reach`."""
        return self.radius

    def nearest(self, points: ArrayLike) -> tuple[Array, Array]:
        """See `Shape.nearest`."""
        points = np.asarray(points, float)
        distance = _length(points)
        return distance - self.radius, _unit(points, distance, 2)

    def mesh(self, chord_error: float = CHORD_ERROR) -> Mesh:
        """See `Shape.mesh`."""
        # The chords along and across the meridians add up in the middle of a face.
        segments = chords(self.radius, chord_error / 2)
        angle = np.linspace(-np.pi / 2, np.pi / 2, segments // 2 + 1)
        profile = self.radius * np.stack([np.cos(angle), np.sin(angle)], 1)
        profile[[0, -1], 0] = 0.0
        return revolved_mesh(profile, segments, "sphere")


@dataclass(frozen=True)
class Plane(Shape):
    """Rectangle in z = 0, centred; its signed distance is positive on the side of +z."""

    size_x: float
    size_y: float

    is_solid: ClassVar[bool] = False

    @property
    def reach(self) -> float:
        """See `Shape.reach`."""
        return float(np.hypot(self.size_x, self.size_y)) / 2

    def nearest(self, points: ArrayLike) -> tuple[Array, Array]:
        """See `Shape.nearest`."""
        points = np.asarray(points, float)
        beyond = np.maximum(np.abs(points[:, :2]) - np.array([self.size_x, self.size_y]) / 2, 0.0)
        offset = np.column_stack([np.copysign(beyond, points[:, :2]), points[:, 2]])
        distance, side = _length(offset), np.where(points[:, 2] < 0.0, -1.0, 1.0)
        return side * distance, side[:, None] * _unit(offset, distance, 2)

    def mesh(self, chord_error: float = CHORD_ERROR) -> Mesh:
        """Two triangles with normals along +z."""
        x, y = self.size_x / 2, self.size_y / 2
        corners = np.array([[-x, -y, 0.0], [x, -y, 0.0], [x, y, 0.0], [-x, y, 0.0]])
        return Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]]), "plane")


@dataclass(frozen=True)
class Box(Shape):
    """Cuboid centred on the origin."""

    size_x: float
    size_y: float
    size_z: float

    @property
    def size(self) -> Array:
        """(3,) edges."""
        return np.array([self.size_x, self.size_y, self.size_z])

    @property
    def reach(self) -> float:
        """See `Shape.reach`."""
        return float(np.linalg.norm(self.size)) / 2

    def nearest(self, points: ArrayLike) -> tuple[Array, Array]:
        """See `Shape.nearest`."""
        points = np.asarray(points, float)
        beyond = np.abs(points) - self.size / 2
        outside = np.maximum(beyond, 0.0)
        distance = _length(outside)
        face, rows = beyond.argmax(1), np.arange(len(points))
        normal = np.where(distance[:, None] > 0.0, _unit(outside, distance, 2), np.eye(3)[face])
        return np.where(distance > 0.0, distance, beyond[rows, face]), np.copysign(normal, points)

    def mesh(self, chord_error: float = CHORD_ERROR) -> Mesh:
        """Two triangles on each side."""
        return box_mesh(self.size)


class _Revolved(Shape):
    """Solid of revolution about z."""

    @property
    @abstractmethod
    def profile(self) -> Array:
        """(k, 2) radius and z of the corners of the section, anticlockwise, the first and last on the axis or equal.

        The section is convex.
        """

    @property
    def reach(self) -> float:
        """See `Shape.reach`."""
        return float(_length(self.profile).max())

    def nearest(self, points: ArrayLike) -> tuple[Array, Array]:
        """See `Shape.nearest`."""
        points = np.asarray(points, float)
        radius = _length(points[:, :2])
        signed, normal = _nearest_on_profile(np.column_stack([radius, points[:, 2]]), self.profile)
        return signed, np.column_stack([normal[:, :1] * _unit(points[:, :2], radius, 0), normal[:, 1]])

    def mesh(self, chord_error: float = CHORD_ERROR) -> Mesh:
        """See `Shape.mesh`."""
        profile = self.profile
        return revolved_mesh(profile, chords(float(profile[:, 0].max()), chord_error), type(self).__name__.lower())


@dataclass(frozen=True)
class Cylinder(_Revolved):
    """Cylinder along z with end faces, centred on the origin."""

    radius: float
    height: float

    @property
    def profile(self) -> Array:
        """See `_Revolved.profile`."""
        r, z = self.radius, self.height / 2
        return np.array([[0.0, -z], [r, -z], [r, z], [0.0, z]])


@dataclass(frozen=True)
class Cone(_Revolved):
    """Cone frustum along z with end faces, from z = -height/2 to height/2; `top_radius` may be 0."""

    bottom_radius: float
    top_radius: float
    height: float

    def __post_init__(self) -> None:
        Cylinder(self.bottom_radius, self.height)
        if self.top_radius:
            Cylinder(self.top_radius, self.height)

    @property
    def profile(self) -> Array:
        """See `_Revolved.profile`."""
        z = self.height / 2
        rim = [[0.0, -z], [self.bottom_radius, -z], [self.top_radius, z]]
        return np.array([*rim, [0.0, z]] if self.top_radius else rim)


@dataclass(frozen=True)
class Ring(_Revolved):
    """Cylinder along z with a concentric bore through it, centred on the origin."""

    inner_radius: float
    outer_radius: float
    height: float

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.inner_radius < self.outer_radius:
            raise ValueError(f"Ring: inner_radius = {self.inner_radius} m, expected less than {self.outer_radius} m")

    @property
    def profile(self) -> Array:
        """See `_Revolved.profile`."""
        r, s, z = self.inner_radius, self.outer_radius, self.height / 2
        return np.array([[r, -z], [s, -z], [s, z], [r, z], [r, -z]])


@dataclass(frozen=True)
class PlacedShape:
    """A shape in the frame of a group.

    `measured` shapes are what the artefact is calibrated for; a `support` holds them.
    """

    name: str
    shape: Shape
    frame_from_shape: Array
    role: Literal["measured", "support"] = "measured"

    def nearest(self, points: ArrayLike) -> tuple[Array, Array]:
        """Signed distance (n,), m, and unit normal (n, 3) for points (n, 3), both in the frame of the group."""
        signed, normal = self.shape.nearest(pose.transform_points(pose.inverse(self.frame_from_shape), points))
        return signed, normal @ self.frame_from_shape[:3, :3].T

    def transformed(self, target_from_frame: ArrayLike) -> PlacedShape:
        """The shape in another frame."""
        return PlacedShape(self.name, self.shape, np.asarray(target_from_frame) @ self.frame_from_shape, self.role)


@dataclass(frozen=True)
class ShapeGroup:
    """Shapes that form one rigid part, as `load_artefact` reads them: the union of solids, and open surfaces.

    Attributes
    ----------
    shapes
        The shapes, each with its ``name``, exact ``shape``, ``role`` and pose ``frame_from_shape`` (4, 4) in the frame
        of the group, m.
    source
        File or name, for messages.

    Raises
    ------
    ValueError
        If there are no shapes.

    Examples
    --------
    The ball of this artefact is 25 mm wide, and its centre at a height of 60 mm:

    >>> artefact = scancell.load_artefact(scancell.assets_dir() / "artefacts" / "sphere.toml")
    >>> distance, normal, number = artefact.nearest([[0.0, 0.0, 0.08]])
    >>> print(distance.round(6), normal, artefact.shapes[number[0]].name)
    [0.0075] [[0. 0. 1.]] ball
    """

    shapes: tuple[PlacedShape, ...]
    source: str = "shapes"

    def __post_init__(self) -> None:
        if not self.shapes:
            raise ValueError(f"{self.source}: has no shapes")

    @property
    def measured(self) -> tuple[PlacedShape, ...]:
        """The shapes that the artefact is calibrated for."""
        return tuple(one for one in self.shapes if one.role == "measured")

    def nearest(self, points: ArrayLike) -> tuple[Array, Array, NDArray[np.intp]]:
        """Signed distance (n,), m, unit normal (n, 3) and number of the nearest shape (n,) for `points` (n, 3), m.

        The nearest of several solids is the one with the smallest signed distance: exact outside their union. Inside
        the union, near an edge where two of them meet, the distance may be too short by the depth of the point.
        """
        points = np.asarray(points, float)
        signed, normal, index = np.empty(len(points)), np.empty((len(points), 3)), np.empty(len(points), np.intp)
        for start in range(0, len(points), _BLOCK):
            rows = slice(start, start + _BLOCK)
            signed[rows], normal[rows], index[rows] = self._nearest(points[rows])
        return signed, normal, index

    def _nearest(self, points: Array) -> tuple[Array, Array, NDArray[np.intp]]:
        signed, normal = np.full(len(points), np.nan), np.full((len(points), 3), np.nan)
        best, index = np.full(len(points), np.inf), np.zeros(len(points), np.intp)
        for number, placed in enumerate(self.shapes):
            from_centre = _length(points - placed.frame_from_shape[:3, 3])
            near = np.flatnonzero(from_centre - placed.shape.reach < best)
            its_signed, its_normal = placed.nearest(points[near])
            # An open surface has no inside.
            rank = its_signed if placed.shape.is_solid else np.abs(its_signed)
            nearer = rank < best[near]
            rows = near[nearer]
            best[rows], signed[rows], normal[rows] = rank[nearer], its_signed[nearer], its_normal[nearer]
            index[rows] = number
        return signed, normal, index

    def transformed(self, target_from_group: ArrayLike) -> ShapeGroup:
        """The group in the frame to which `target_from_group`, a pose (4, 4), leads."""
        return ShapeGroup(tuple(one.transformed(target_from_group) for one in self.shapes), self.source)

    def mesh(self, chord_error: float = CHORD_ERROR) -> ShapeMesh:
        """Triangles of all shapes in the frame of the group, at most `chord_error` (m) away from them.

        Solids may overlap.
        """
        meshes = [one.shape.mesh(chord_error).transformed(one.frame_from_shape) for one in self.shapes]
        whole = joined(meshes, self.source)
        return ShapeMesh(whole.vertices, whole.faces, self.source, shapes=self)


@dataclass(frozen=True, eq=False, repr=False)
class ShapeMesh(Mesh):
    """Tessellation of shapes, which it holds for ray tracing and measurement."""

    shapes: ShapeGroup = field(kw_only=True)

    def transformed(self, target_from_part: ArrayLike) -> ShapeMesh:
        """Mesh and shapes in another frame."""
        moved = super().transformed(target_from_part)
        return ShapeMesh(moved.vertices, moved.faces, self.source, shapes=self.shapes.transformed(target_from_part))


def _length(vectors: Array) -> Array:
    # NumPy's hypot neither overflows nor loses short vectors.
    length = np.hypot(vectors[:, 0], vectors[:, 1])
    return length if vectors.shape[1] == 2 else np.hypot(length, vectors[:, 2])


def _unit(vectors: Array, length: Array, fallback_axis: int) -> Array:
    """Unit vectors; along an axis where the length is 0."""
    unit = vectors / np.where(length > 0.0, length, 1.0)[:, None]
    unit[length == 0.0, fallback_axis] = 1.0
    return unit


def _nearest_on_profile(points: Array, profile: Array) -> tuple[Array, Array]:
    """Signed distance (n,) and normal (n, 2) of points (n, 2) from a convex polyline (k, 2), material on its left."""
    edge = np.diff(profile, axis=0)
    along = edge / _length(edge)[:, None]
    outward = np.stack([along[:, 1], -along[:, 0]], 1)
    height = points @ outward.T - np.sum(profile[:-1] * outward, 1)
    travel = points @ along.T - np.sum(profile[:-1] * along, 1)
    beyond = travel - np.clip(travel, 0.0, _length(edge))
    distance = np.hypot(height, beyond)
    inside = (height <= 0.0).all(1)
    side, rows = np.where(inside, height.argmax(1), distance.argmin(1)), np.arange(len(points))
    height, beyond, distance = height[rows, side], beyond[rows, side], distance[rows, side]
    at_corner = ~inside & (beyond != 0.0)
    signed = np.where(at_corner, distance, height)
    scale = np.where(at_corner, distance, 1.0)
    across = np.where(at_corner, height, 1.0) / scale
    lengthwise = np.where(at_corner, beyond, 0.0) / scale
    return signed, across[:, None] * outward[side] + lengthwise[:, None] * along[side]


class PartSurface:
    """Distances to the exact shapes or faces of a part that has them, otherwise to its mesh.

    Attributes
    ----------
    is_exact
        Whether the part consists of exact shapes, or of faces with a closed form.
    is_signed
        Whether distances have a sign: a mesh that is not closed has no inside.
    """

    def __init__(self, part: Mesh) -> None:
        self._part, self._mesh = part, MeshSurface(part.vertices, part.faces)
        self._shapes = part.shapes if isinstance(part, ShapeMesh) else None
        self.is_exact = self._shapes is not None or (isinstance(part, CadMesh) and part.is_exact)
        self.is_signed = self._shapes is not None or part.is_closed

    def __reduce__(self) -> tuple[Any, ...]:
        return PartSurface, (self._part,)

    def distances(self, points: Array, threads: int = 0) -> tuple[Array, NDArray[np.uint32]]:
        """Distance (n,), m, positive outside, and nearest face of the mesh (n,) of points (n, 3) in the part frame.

        `threads` does not change the result; 0 uses all cores.
        """
        signed, face = self._signed(points, threads)
        return (signed if self.is_signed else np.abs(signed)), face

    def _signed(self, points: Array, threads: int) -> tuple[Array, NDArray[np.uint32]]:
        """The same, but without an inside the sign is that of the side of the nearest face."""
        signed, face = self._mesh.signed_distances(points, threads)
        if self._shapes is not None:
            return self._shapes.nearest(points)[0], face
        if not self.is_signed:
            signed = np.copysign(signed, self._heights(points, face))
        if isinstance(self._part, CadMesh):  # whose exact faces have a side of their own
            signed = self._part.refined(points, signed, face)
        return signed, face

    def _heights(self, points: Array, face: NDArray[np.uint32]) -> Array:
        """Heights (n,) of points (n, 3) above the planes of triangles (n,), m."""
        corner = self._part.vertices[self._part.faces[face, 0]]
        return np.asarray(np.einsum("ni,ni->n", points - corner, self._part.normals[face]))

    def nearest(self, points: Array, threads: int = 0) -> tuple[Array, Array]:
        """Signed distance (n,), m, of points (n, 3) in the part frame, and its gradient (n, 3), a unit normal.

        Without an inside the sign is that of the side of the nearest face.
        """
        if self._shapes is not None:
            return self._shapes.nearest(points)[:2]
        signed, face = self._signed(points, threads)
        corners, normal = self._part.vertices[self._part.faces[face]], self._part.normals[face]
        height = self._heights(points, face)
        # Where the nearest point is on an edge, the gradient leads away from it.
        rows = np.flatnonzero((np.abs(np.abs(height) - np.abs(signed)) > _ON_EDGE) & (np.abs(signed) > _ON_EDGE))
        away, gradient = _from_edges(points[rows], corners[rows]), normal.copy()
        length = np.linalg.norm(away, axis=1)
        on_edge = np.abs(length - np.abs(signed[rows])) <= _ON_EDGE
        gradient[rows[on_edge]] = (away / signed[rows, None])[on_edge]
        return signed, gradient


def _from_edges(points: Array, corners: Array) -> Array:
    """Vectors (n, 3) to points (n, 3) from the nearest point on the edges of triangles (n, 3, 3), one for each."""
    along = np.roll(corners, -1, axis=1) - corners
    offset = points[:, None] - corners
    square = np.maximum(np.einsum("nki,nki->nk", along, along), np.finfo(float).tiny)
    share = np.clip(np.einsum("nki,nki->nk", offset, along) / square, 0.0, 1.0)
    away = offset - share[..., None] * along
    nearest = np.einsum("nki,nki->nk", away, away).argmin(1)
    return np.asarray(away[np.arange(len(points)), nearest])
