"""Characteristics of artefacts from fits of their faces: size, form, spacing, angle and their uncertainty.

Terms in the style of VDI/VDE 2634 parts 2 and 3 and ISO 10360 parts 8 and 13. The number, place and filtering of the
points follow the scan and not these standards, so that the figures are no verification after them.

The uncertainty is the standard uncertainty that the covariance of the fits gives (JCGM 102), for residuals without
correlation between points; systematic effects are not part of it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from scancell.arrays import Array
from scancell.geometry import pose
from scancell.geometry.fits import (
    ConeFit,
    CylinderFit,
    Fit,
    PlaneFit,
    SphereFit,
    fit_cone,
    fit_cylinder,
    fit_plane,
    fit_sphere,
)
from scancell.geometry.shapes import Box, Cone, Cylinder, PlacedShape, Plane, Ring, ShapeGroup, Sphere

Kind = Literal["plane", "sphere", "cylinder", "cone"]

_SAME_SURFACE = np.cos(np.radians(20.0))  # between normals: two shapes that share a surface do not make an edge
_TIE = 1e-9  # m: two shapes are equally near
_NONE = -1

_MOST_FORM = 0.95  # share of the points of the 95 % figures
_PARALLEL = 1e-6  # rad: nominal angle between planes below which they have a distance and no angle
_LEAST_OPENING = 0.1  # length of the sum of the normals of two flanks
_STEP = 1e-6  # m and 1, of numerical derivatives
_ACROSS = np.cos(1e-3)  # between their bisector and the normal of the plane above them
_FITS: dict[str, Callable[..., Fit]] = {
    "plane": fit_plane,
    "sphere": fit_sphere,
    "cylinder": fit_cylinder,
    "cone": fit_cone,
}


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


@dataclass(frozen=True)
class Characteristic:
    """One figure: measured value, nominal value and standard uncertainty, in m, rad or 1.

    `nominal` is 0 for form deviations; `uncertainty` is NaN where extreme points decide the figure.
    """

    name: str
    of: str
    value: float
    nominal: float
    uncertainty: float
    unit: Literal["m", "rad"]

    @property
    def error(self) -> float:
        """Measured minus nominal value."""
        return self.value - self.nominal

    def as_row(self) -> dict[str, Any]:
        """Plain data for JSON and CSV: lengths in mm with errors in µm, angles in degrees; None instead of NaN."""
        scale, unit = (1e3, "mm") if self.unit == "m" else (180 / np.pi, "deg")
        fine, fine_unit = (1e6, "um") if self.unit == "m" else (180 / np.pi, "deg")
        values = {
            f"value_{unit}": scale * self.value,
            f"nominal_{unit}": scale * self.nominal,
            f"error_{fine_unit}": fine * self.error,
            f"uncertainty_{fine_unit}": fine * self.uncertainty,
        }
        return {"of": self.of, "name": self.name, **{k: None if np.isnan(v) else float(v) for k, v in values.items()}}


@dataclass(frozen=True)
class FittedFace:
    """A face with its points (n, 3), m, their signed distances (n,) from the nominal face, and the fit."""

    face: Face
    points: Array
    signed: Array
    fit: Fit


def fitted_face(face: Face, points: Array) -> FittedFace:
    """Least-squares fit of the points (n, 3), m, of a face, its sense as that of the nominal face.

    Raises `FitError` if the points do not determine the element.
    """
    fit = _FITS[face.kind](points)
    if isinstance(fit, PlaneFit) and fit.normal @ face.axis < 0:
        turn = np.diag([1.0, 1.0, 1.0, -1.0, -1.0, -1.0])
        fit = PlaneFit(
            point=fit.point, normal=-fit.normal, residuals=-fit.residuals, covariance=turn @ fit.covariance @ turn
        )
    return FittedFace(face, points, face.distances(points)[0], fit)


def characteristics(faces: Sequence[FittedFace]) -> list[Characteristic]:
    """Sizes of faces, figures of pairs of faces and of grooves, then form and bias of each face."""
    found = [figure for one in faces for figure in _sizes(one)]
    spheres = [one for one in faces if one.face.kind == "sphere"]
    planes = [one for one in faces if one.face.kind == "plane"]
    found += [_spacing(a, b) for a, b in combinations(spheres, 2)]
    found += [figure for a, b in combinations(planes, 2) for figure in _between_planes(a, b)]
    found += [figure for a, b in combinations(planes, 2) for top in planes for figure in _groove_depth(a, b, top)]
    return [*found, *(figure for one in faces for figure in _forms(one))]


def narrowest_range(values: Array, share: float = _MOST_FORM) -> float:
    """Width of the shortest interval that holds a share of the values (n,)."""
    ordered = np.sort(values)
    inside = int(np.ceil(share * len(ordered)))
    return float((ordered[inside - 1 :] - ordered[: len(ordered) - inside + 1]).min())


def _sizes(one: FittedFace) -> Iterator[Characteristic]:
    fit, face = one.fit, one.face
    deviation = fit.standard_deviations
    match fit:
        case SphereFit():
            yield Characteristic("probing size", face.name, 2 * fit.radius, 2 * face.size, 2 * float(deviation[3]), "m")
        case CylinderFit():
            yield Characteristic("diameter", face.name, 2 * fit.radius, 2 * face.size, 2 * float(deviation[6]), "m")
        case ConeFit():
            yield Characteristic(
                "cone angle", face.name, 2 * fit.half_angle, 2 * face.size, 2 * float(deviation[7]), "rad"
            )


def _forms(one: FittedFace) -> Iterator[Characteristic]:
    name = {"sphere": "probing form", "plane": "flatness"}.get(one.face.kind, "form")
    residuals, unknown = one.fit.residuals, float("nan")
    zone = _FITS[one.face.kind](one.points, criterion="minimum zone")
    for title, value in (
        (name, one.fit.form),
        (f"{name}, 95 % of the points", narrowest_range(residuals)),
        (f"{name}, minimum zone", zone.form),
    ):
        yield Characteristic(title, one.face.name, value, 0.0, unknown, "m")
    count = len(residuals)
    spread = float(residuals.std())
    yield Characteristic("dispersion", one.face.name, spread, 0.0, spread / np.sqrt(2 * count), "m")
    yield Characteristic("bias", one.face.name, float(one.signed.mean()), 0.0, spread / np.sqrt(count), "m")
    d95 = float(np.quantile(np.abs(one.signed), _MOST_FORM))
    yield Characteristic("D95 %", one.face.name, d95, 0.0, unknown, "m")
    yield Characteristic("max - min", one.face.name, float(np.ptp(one.signed)), 0.0, unknown, "m")


def _spacing(a: FittedFace, b: FittedFace) -> Characteristic:
    between = b.fit.parameters[:3] - a.fit.parameters[:3]
    length = float(np.linalg.norm(between))
    along = between / length
    variance = sum(along @ one.fit.covariance[:3, :3] @ along for one in (a, b))
    nominal = float(np.linalg.norm(b.face.point - a.face.point))
    return Characteristic("sphere spacing", _pair(a, b), length, nominal, float(np.sqrt(variance)), "m")


def _between_planes(a: FittedFace, b: FittedFace) -> Iterator[Characteristic]:
    """Step height of planes with the same normal, length between opposite sides of a shape, angle of a groove."""
    angle = _angle(a.face.axis, b.face.axis)
    same_shape = a.face.shape == b.face.shape
    if angle < _PARALLEL:
        yield _offset("step height", a, b)
    elif np.pi - angle < _PARALLEL and same_shape:
        yield _offset("length", a, b)
    elif _look_at_each_other(a, b):
        yield _opening(a, b)


def _offset(name: str, a: FittedFace, b: FittedFace) -> Characteristic:
    """Distance of the centroid of the second plane's points from the first plane."""
    (point_a, normal_a), (point_b, _) = (np.split(one.fit.parameters, 2) for one in (a, b))
    across = point_b - point_a
    gradient = np.concatenate([-normal_a, across])
    variance = gradient @ a.fit.covariance @ gradient + normal_a @ b.fit.covariance[:3, :3] @ normal_a
    nominal = float((b.face.point - a.face.point) @ a.face.axis)
    sign = -1.0 if nominal < 0 else 1.0
    return Characteristic(
        name, _pair(a, b), sign * float(across @ normal_a), sign * nominal, float(np.sqrt(variance)), "m"
    )


def _look_at_each_other(a: FittedFace, b: FittedFace) -> bool:
    between = b.face.point - a.face.point
    return bool(min(a.face.axis @ between, -(b.face.axis @ between)) > 0)


def _opening(a: FittedFace, b: FittedFace) -> Characteristic:
    """Angle between two flanks."""
    normal_a, normal_b = a.fit.parameters[3:], b.fit.parameters[3:]
    slopes = (_perpendicular(normal_b, normal_a), a), (_perpendicular(normal_a, normal_b), b)
    variance = sum(slope @ one.fit.covariance[3:, 3:] @ slope for slope, one in slopes)
    value, nominal = (np.pi - _angle(*pair) for pair in ((normal_a, normal_b), (a.face.axis, b.face.axis)))
    return Characteristic("groove angle", _pair(a, b), value, nominal, float(np.sqrt(variance)), "rad")


def _groove_depth(a: FittedFace, b: FittedFace, top: FittedFace) -> Iterator[Characteristic]:
    """Depth of two flanks that face each other below a plane across their bisector."""
    if top is a or top is b or not _look_at_each_other(a, b):
        return
    middle = a.face.axis + b.face.axis
    length = np.linalg.norm(middle)
    if length < _LEAST_OPENING or middle @ top.face.axis / length < _ACROSS:
        return
    three = (a, b, top)
    start = np.concatenate([one.fit.parameters for one in three])
    steps = _STEP * np.eye(len(start))
    gradient = np.array([(_depth(start + step) - _depth(start - step)) / (2 * _STEP) for step in steps])
    variance = sum(g @ one.fit.covariance @ g for g, one in zip(np.split(gradient, 3), three, strict=True))
    nominal = _depth(np.concatenate([part for one in three for part in (one.face.point, one.face.axis)]))
    where = f"{_pair(a, b)} / {top.face.name}"
    yield Characteristic("groove depth", where, _depth(start), nominal, float(np.sqrt(variance)), "m")


def _depth(planes: Array) -> float:
    """Depth of the line in which two planes meet below a third, at the middle of the flanks; planes (18,)."""
    points, normals = planes.reshape(3, 2, 3).swapaxes(0, 1)
    along = np.cross(normals[0], normals[1])
    matrix = np.stack([normals[0], normals[1], along])
    middle = (points[0] + points[1]) / 2
    foot = np.linalg.solve(matrix, [normals[0] @ points[0], normals[1] @ points[1], along @ middle])
    return float((points[2] - foot) @ normals[2])


def _perpendicular(vector: Array, direction: Array) -> Array:
    """Unit vector of the part of `vector` across `direction`, by which the angle between them changes."""
    across = vector - (vector @ direction) * direction
    return np.asarray(across / np.linalg.norm(across))


def _angle(a: Array, b: Array) -> float:
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


def _pair(a: FittedFace, b: FittedFace) -> str:
    return f"{a.face.name} - {b.face.name}"
