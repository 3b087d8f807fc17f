"""Faces of artefacts: planes, spheres, cylinders and cones of its measured shapes, and the points on them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from scancell.geometry import pose
from scancell.geometry.shapes import Box, Cone, Cylinder, PlacedShape, Plane, Ring, ShapeGroup, Sphere

Array = NDArray[np.float64]
Kind = Literal["plane", "sphere", "cylinder", "cone"]

_SAME_SURFACE = np.cos(np.radians(20.0))  # between normals: two shapes that share a surface do not make an edge
_TIE = 1e-9  # m: two shapes are equally near
_NONE = -1


@dataclass(frozen=True)
class Face:
    """One face of an artefact, in the frame of the artefact.

    Attributes
    ----------
    frame
        (4, 4) pose; z is the outward normal of a plane, or the axis, along which a cone opens.
    extent
        Plane: its two sizes; cylinder: height; cone: smallest and largest distance from the apex along the surface.
    size
        Radius of spheres and cylinders, half angle of cones, m or rad.
    outward
        -1 for a bore, whose material lies outside.
    """

    name: str
    kind: Kind
    frame: Array
    extent: tuple[float, ...] = ()
    size: float = float("nan")
    outward: int = 1

    @property
    def shape(self) -> str:
        """Name of the shape that it bounds."""
        return self.name.split(":", 1)[0]

    @property
    def point(self) -> Array:
        """(3,) origin of the frame: centre of a sphere, point of a plane or axis, apex of a cone."""
        return np.asarray(self.frame[:3, 3])

    @property
    def axis(self) -> Array:
        """(3,) z of the frame."""
        return np.asarray(self.frame[:3, 2])

    def distances(self, points: Array) -> tuple[Array, Array, Array]:
        """Signed distance (n,), m, positive outside the material; unit normal (n, 3); distance (n,) from the edges.

        The distance from the edges is negative beyond them.
        """
        local = pose.transform_points(pose.inverse(self.frame), points)
        signed, normal, inward = getattr(self, f"_{self.kind}")(local)
        return self.outward * signed, self.outward * normal @ self.frame[:3, :3].T, inward

    def _plane(self, local: Array) -> tuple[Array, Array, Array]:
        inward = (np.array(self.extent) / 2 - np.abs(local[:, :2])).min(1)
        return local[:, 2], np.broadcast_to([0.0, 0.0, 1.0], local.shape), inward

    def _sphere(self, local: Array) -> tuple[Array, Array, Array]:
        distance = np.linalg.norm(local, axis=1)
        return distance - self.size, _unit(local, distance), np.full(len(local), np.inf)

    def _cylinder(self, local: Array) -> tuple[Array, Array, Array]:
        radial = local * [1.0, 1.0, 0.0]
        distance = np.linalg.norm(radial, axis=1)
        return distance - self.size, _unit(radial, distance), self.extent[0] / 2 - np.abs(local[:, 2])

    def _cone(self, local: Array) -> tuple[Array, Array, Array]:
        radial = local * [1.0, 1.0, 0.0]
        distance = np.linalg.norm(radial, axis=1)
        cos, sin = np.cos(self.size), np.sin(self.size)
        along = distance * sin + local[:, 2] * cos
        normal = cos * _unit(radial, distance) - sin * np.array([0.0, 0.0, 1.0])
        inward = np.minimum(along - self.extent[0], self.extent[1] - along)
        return distance * cos - local[:, 2] * sin, normal, inward


@dataclass(frozen=True)
class Assignment:
    """Face of each point (n,), -1 for none, and whether it is an outlier: farther than the reach from all shapes."""

    face: NDArray[np.int64]
    outlier: NDArray[np.bool_]


def faces_of(group: ShapeGroup) -> list[Face]:
    """Faces of the measured shapes."""
    return [face for placed in group.measured for face in _faces(placed)]


def assign(points: Array, group: ShapeGroup, faces: list[Face], reach: float, guard: float) -> Assignment:
    """The measured face that each point (n, 3), m, lies on.

    A point belongs to the nearest face within `reach` that it lies above, unless another shape is nearer, or it is
    within `guard` of an edge of the face, or of another shape whose surface has another direction there, such as the
    stem of a sphere.
    """
    best = np.full(len(points), np.inf)
    owner = np.full(len(points), _NONE, np.int64)
    normals, inward = np.zeros_like(points), np.zeros(len(points))
    for number, face in enumerate(faces):
        signed, normal, inside = face.distances(points)
        nearer = (np.abs(signed) < best) & (inside > 0)
        best[nearer], owner[nearer], inward[nearer] = np.abs(signed[nearer]), number, inside[nearer]
        normals[nearer] = normal[nearer]
    kept = (best <= reach) & (inward >= guard)
    nearest = np.full(len(points), np.inf)
    for placed in group.shapes:
        signed, normal = placed.nearest(points)
        nearest = np.minimum(nearest, np.abs(signed))
        own = np.isin(owner, [number for number, face in enumerate(faces) if face.shape == placed.name])
        across = np.einsum("ni,ni->n", normal, normals) < _SAME_SURFACE
        kept &= own | ((~across | (np.abs(signed) >= guard)) & (np.abs(signed) >= best - _TIE))
    return Assignment(np.where(kept, owner, _NONE), nearest > reach)


def _faces(placed: PlacedShape) -> Iterator[Face]:
    """Faces by name; `shape:face` for shapes with several."""
    shape, frame, name = placed.shape, placed.frame_from_shape, placed.name
    match shape:
        case Sphere(radius):
            yield Face(name, "sphere", frame, size=radius)
        case Plane(size_x, size_y):
            yield Face(name, "plane", frame, (size_x, size_y))
        case Box():
            for axis, letter in enumerate("xyz"):
                for sign, mark in ((1, "+"), (-1, "-")):
                    turn = _turn_to(axis, sign)
                    sizes = np.abs(turn.T @ shape.size)
                    at = pose.from_rotation(turn, turn[:, 2] * shape.size[axis] / 2)
                    yield Face(f"{name}:{mark}{letter}", "plane", frame @ at, (float(sizes[0]), float(sizes[1])))
        case Cylinder(radius, height):
            yield Face(name, "cylinder", frame, (height,), radius)
        case Ring(inner_radius, _, height):
            yield Face(name, "cylinder", frame, (height,), inner_radius, -1)
        case Cone():
            yield _cone_face(name, shape, frame)
        case _:
            raise TypeError(f"{name}: {type(shape).__name__} has no faces to measure")


def _cone_face(name: str, shape: Cone, frame: Array) -> Face:
    wide, narrow = max(shape.bottom_radius, shape.top_radius), min(shape.bottom_radius, shape.top_radius)
    angle = float(np.arctan((wide - narrow) / shape.height))
    # The frame at the apex, with z towards the wide end.
    sign = 1 if shape.top_radius > shape.bottom_radius else -1
    apex = -sign * (shape.height / 2 + narrow / np.tan(angle))
    at = pose.from_rotation(_turn_to(2, sign), [0.0, 0.0, apex])
    return Face(name, "cone", frame @ at, (narrow / np.sin(angle), wide / np.sin(angle)), angle)


def _turn_to(axis: int, sign: int) -> Array:
    """Rotation (3, 3) whose third column is plus or minus a coordinate axis."""
    columns = np.roll(np.eye(3), 2 - axis, axis=1)
    return columns if sign > 0 else columns @ np.diag([1.0, -1.0, -1.0])


def _unit(vectors: Array, length: Array) -> Array:
    return np.asarray(vectors / np.where(length > 0, length, 1.0)[:, None])
