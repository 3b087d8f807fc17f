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

from scancell.evaluation.faces import Face
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

Array = NDArray[np.float64]

_MOST_FORM = 0.95  # share of the points of the 95 % figures
_PARALLEL = 1e-6  # rad: nominal angle between planes below which they have a distance and no angle
_LEAST_OPENING = 0.1  # length of the sum of the normals of two flanks
_ACROSS = np.cos(1e-3)  # between their bisector and the normal of the plane above them
_FITS: dict[str, Callable[..., Fit]] = {
    "plane": fit_plane,
    "sphere": fit_sphere,
    "cylinder": fit_cylinder,
    "cone": fit_cone,
}


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
    gradient = np.array([_slope(start, place) for place in range(len(start))])
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


def _slope(planes: Array, place: int) -> float:
    step = np.zeros_like(planes)
    step[place] = 1e-6
    return (_depth(planes + step) - _depth(planes - step)) / 2e-6


def _perpendicular(vector: Array, direction: Array) -> Array:
    """Unit vector of the part of `vector` across `direction`, by which the angle between them changes."""
    across = vector - (vector @ direction) * direction
    return np.asarray(across / np.linalg.norm(across))


def _angle(a: Array, b: Array) -> float:
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


def _pair(a: FittedFace, b: FittedFace) -> str:
    return f"{a.face.name} - {b.face.name}"
