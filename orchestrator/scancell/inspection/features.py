"""Features of a CAD part with the points measured on them, and datum systems.

A feature is one face, or several that lie on the same surface, such as the two halves of a bore. Datums are the
least-squares elements of their features (ISO 5459 permits other associations; the report states this one).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.ndimage import uniform_filter1d
from scipy.special import ndtri, stdtrit

from scancell import sensor as sensor_rt
from scancell.arrays import Array
from scancell.errors import FitError
from scancell.geometry import pose
from scancell.geometry.cad import CadFace, CadMesh
from scancell.geometry.fits import Fit, fit_cone, fit_cylinder, fit_plane, fit_sphere, least_squares
from scancell.geometry.shapes import PartSurface
from scancell.values import Value

_SAME_LENGTH, _SAME_ANGLE = 1e-6, 1e-5  # m and rad between surfaces of one feature
_FITS = {"plane": fit_plane, "cylinder": fit_cylinder, "cone": fit_cone, "sphere": fit_sphere}
_ITERATIONS = 20
_SETTLED = 1e-13  # m and rad: largest step of a datum system that changes nothing
UNFELT = 1e-6  # of a motion: effect on distances that does not count
_NOISE = 1.4826  # standard deviations of a normal distribution, in median deviations
_WINDOW = 401  # successive points whose mean change tells the noise there
_MOST_CHANGE = 8.0  # of the median change, that counts
_MOST_APART = 4.0  # standard deviations between means of successive profiles, that count
_SURE = 0.975  # quantile by which noise that few profiles tell is widened
_LEAST_IN_PROFILE = 5  # points of a profile on a feature whose mean counts
_LEAST_PROFILES = 3  # that tell what their points have in common
_DEPENDENT = 1e-4  # singular values of constraints that earlier datums imply already


@dataclass(frozen=True, eq=False, repr=False)
class MeasuredPart(Value):
    """Points (n, 3) near the faces of a part, m, in its frame.

    Attributes
    ----------
    profile
        (n,) number of the profile of each point, whose points share errors; all different where it is unknown.
    face
        (n,) number of the face that each point lies on, from 0; -1 for none.
    """

    part: CadMesh
    points: Array
    profile: NDArray[np.int64]
    face: NDArray[np.int64]

    @classmethod
    def of(
        cls, part: CadMesh, points: Array, profile: NDArray[Any] | None, reach: float, threads: int = 0
    ) -> MeasuredPart:
        """Points allotted to their nearest faces, as far as they are within `reach`, m."""
        distance, triangle = PartSurface(part).distances(points, threads)
        face = np.where(np.abs(distance) <= reach, part.cad_face[triangle], -1)
        known = np.arange(len(points)) if profile is None else profile.astype(np.int64)
        return cls(part, points, known, face)

    def scaled(self, factor: float) -> MeasuredPart:
        """All points farther from the origin of the part by a factor, on the same faces."""
        return replace(self, points=factor * self.points)

    def feature(self, name: str, faces: Sequence[int], edge: float, threads: int = 0) -> Feature:
        """Feature of faces (numbers from 0) with its points, those within `edge`, m, of other faces left out.

        Raises `FitError` if the faces lie on different surfaces.
        """
        found = [self.part.cad_faces[number] for number in faces]
        first = found[0] if all(is_one_surface(found[0], other) for other in found[1:]) else None
        own = np.isin(self.part.cad_face, faces)
        rows = np.flatnonzero(np.isin(self.face, faces))
        if edge > 0 and not own.all() and len(rows):
            others = sensor_rt.MeshSurface(self.part.vertices, self.part.faces[~own])
            rows = rows[np.abs(others.signed_distances(self.points[rows], threads)[0]) > edge]
        # The part of these faces alone: distances from it do not jump to a neighbour.
        alone = replace(self.part, faces=self.part.faces[own], cad_face=self.part.cad_face[own])
        points, profile = self.points[rows], self.profile[rows]
        return Feature(name, tuple(faces), first, points, profile, self.face[rows], alone)


def is_one_surface(a: CadFace, b: CadFace) -> bool:
    """Whether two faces lie on one surface."""
    if a.kind != b.kind or not a.is_exact or abs(a.radius - b.radius) > _SAME_LENGTH:
        return False
    if abs(a.second - b.second) > (_SAME_LENGTH if a.kind == "torus" else _SAME_ANGLE):
        return False
    between = pose.inverse(a.part_from_face) @ b.part_from_face
    tilt = float(np.linalg.norm(np.cross([0.0, 0.0, 1.0], between[:3, 2])))
    away = between[:3, 3]
    match a.kind:
        case "plane":
            apart = abs(float(away[2]))
        case "cylinder":
            apart = float(np.hypot(*away[:2]))
        case "cone":
            a_apex, b_apex = (
                one.part_from_face[:3, 3] - one.radius / np.tan(one.second) * one.part_from_face[:3, 2]
                for one in (a, b)
            )
            apart = float(np.linalg.norm(a_apex - b_apex))
        case _:
            apart = float(np.linalg.norm(away))
    return apart < _SAME_LENGTH and (a.kind == "sphere" or tilt < _SAME_ANGLE)


@dataclass(frozen=True, eq=False, repr=False)
class Feature(Value):
    """A feature with its points, in the frame of the part, m.

    Attributes
    ----------
    faces
        Numbers of its faces, from 0.
    nominal
        Its surface; None where the faces lie on several surfaces.
    points, profile, face
        (n, 3) measured points, and numbers (n,) of the profile and of the face of each.
    alone
        The part reduced to its faces.
    """

    name: str
    faces: tuple[int, ...]
    nominal: CadFace | None
    points: Array
    profile: NDArray[np.int64]
    face: NDArray[np.int64]
    alone: CadMesh

    @property
    def kind(self) -> str:
        """Kind of the surface; ``surface`` where the faces lie on several, or on one without a closed form."""
        return self.nominal.kind if self.nominal is not None and self.nominal.is_exact else "surface"

    @cached_property
    def corners(self) -> Array:
        """(k, 3) vertices of its triangles, m."""
        return self.alone.vertices[np.unique(self.alone.faces)]

    @cached_property
    def frame(self) -> Array:
        """Nominal pose (4, 4): z is the outward normal of a plane, or the axis; the origin lies amid the feature."""
        if self.nominal is None:
            raise FitError(f"'{self.name}' lies on several surfaces")
        frame = self.nominal.part_from_face.copy()
        if self.kind == "plane" and frame[:3, 2] @ (self.alone.areas @ self.alone.normals) < 0:
            frame[:3, :3] = frame[:3, :3] @ np.diag([1.0, -1.0, -1.0])
        local = pose.transform_points(pose.inverse(frame), self.corners)
        middle = (local.min(0) + local.max(0)) / 2
        shift = {"plane": middle * [1, 1, 0], "cylinder": middle * [0, 0, 1], "cone": middle * [0, 0, 1]}.get(self.kind)
        return frame if shift is None else np.asarray(frame @ pose.translation(shift))

    @cached_property
    def half_extent(self) -> Array:
        """(3,) half sizes of the feature along the axes of its frame, m."""
        local = pose.transform_points(pose.inverse(self.frame), self.corners)
        return np.asarray(np.abs(local).max(0))

    def distances(self, points: Array) -> tuple[Array, Array]:
        """Signed distances (n,), m, of points (n, 3) from the nominal surface, and unit normals (n, 3) there.

        Positive distances lie on the side of the normal of a plane, away from the axis or centre of a curved surface,
        and outside the material of others.
        """
        if self.kind == "plane":
            normal = self.frame[:3, 2]
            return (points - self.frame[:3, 3]) @ normal, np.broadcast_to(normal, points.shape)
        if self.kind != "surface":
            assert self.nominal is not None
            return self.nominal.nearest(points)
        return self._surface.nearest(points)

    @cached_property
    def _surface(self) -> PartSurface:
        return PartSurface(self.alone)

    @cached_property
    def fit(self) -> Fit:
        """Least-squares element of the points, its sense as that of the nominal one.

        Raises `FitError` if the surface has no such element, or the points do not determine it.
        """
        if self.kind not in _FITS:
            raise FitError(f"'{self.name}': a {self.kind} has no axis, normal or centre")
        try:
            fit = _FITS[self.kind](self.points)
        except FitError as error:
            raise FitError(f"'{self.name}' (faces {', '.join(map(str, self.faces))}): {error}") from None
        if self.kind == "sphere" or fit.parameters[3:6] @ self.frame[:3, 2] >= 0:
            return fit
        return replace(fit, **{"normal" if self.kind == "plane" else "direction": -fit.parameters[3:6]})

    @cached_property
    def placed(self) -> Placed:
        """Least-squares place of the points on the nominal surface."""
        return Placed.best(self)

    @cached_property
    def noise(self) -> Noise:
        """Noise of the distances, by how they change from point to point and from profile to profile."""
        distance, jacobian, inverse = self._linearised
        change = np.abs(np.diff(distance))
        # Between the ends of two profiles a change is no noise.
        change = np.minimum(np.append(change, change[-1:]), _MOST_CHANGE * float(np.median(change)))
        deviation = np.pi**0.5 / 2 * uniform_filter1d(change, _WINDOW, mode="nearest")
        _, profile, count = np.unique(self.profile, return_inverse=True, return_counts=True)
        many = np.flatnonzero(count >= _LEAST_IN_PROFILE)
        if len(many) < _LEAST_PROFILES:
            return Noise(deviation, profile, 0.0)

        def sums(columns: Array) -> Array:
            """Sums (c, p) over the points of each profile of columns (c, n)."""
            return np.stack([np.bincount(profile, one) for one in columns])

        apart = np.abs(np.diff((sums(distance[None])[0] / count)[many]))
        # From one view to the next, means may jump.
        apart = np.minimum(apart, _MOST_APART * _NOISE * float(np.median(apart)))
        # The fit follows part of the noise, much of it where few profiles determine it.
        fitted = np.diff((sums(jacobian.T) / count)[:, many]).T

        def expected(own: Array, with_fit: Array, of_fit: Array) -> float:
            """Sum of squared changes by noise of means of variance (p,), of covariances (f, p), (f, f) with the fit."""
            changes = own[many][1:] + own[many][:-1] - 2 * (fitted * np.diff(with_fit[:, many]).T).sum(1)
            return float(changes.sum() + np.einsum("ni,ij,nj->", fitted, of_fit, fitted))

        by_profile, by_point = sums(inverse), inverse * deviation**2
        told = expected(np.ones(len(count)), by_profile, by_profile @ by_profile.T)
        by_points = expected(sums(deviation[None] ** 2)[0] / count**2, sums(by_point) / count, by_point @ inverse.T)
        # Few profiles tell it with few degrees of freedom, for which Student's t is wider (JCGM 100 G.3). Squared
        # changes from one to the next, of twice the variance, tell two thirds of what independent values do.
        freedom = max(told / 3, 1.0)
        wider = float(stdtrit(freedom, _SURE) / ndtri(_SURE))
        power = wider**2 * float((apart**2).sum()) - by_points
        return Noise(deviation, profile, float(np.sqrt(max(0.0, power) / (3 * freedom))))

    @cached_property
    def _linearised(self) -> tuple[Array, Array, Array]:
        """Distances (n,) from the least-squares place, their derivatives (n, f), and the inverse (f, n) of these."""
        distance, jacobian = self.placed.linearised(self.points)
        return distance, jacobian, np.asarray(np.linalg.pinv(jacobian))

    @cached_property
    def spread(self) -> Array:
        """(k, j) square root of the covariance of the parameters of the fit."""
        inverse = self._linearised[2]
        by_point = inverse * self.noise.deviation
        by_profile = self.noise.common * np.stack([np.bincount(self.noise.profile, row) for row in inverse])
        values, vectors = np.linalg.eigh(by_point @ by_point.T + by_profile @ by_profile.T)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        # The element moves as the points do that noise has moved.
        parameters, count = self.fit.parameters, len(self.placed.motions)
        motions = root[:count].T @ self.placed.motions
        found = np.zeros((len(parameters), root.shape[1]))
        found[:3] = (np.cross(motions[:, :3], parameters[:3]) + motions[:, 3:]).T
        if self.kind == "sphere":
            found[3] = -root[count]
            return found
        found[3:6] = np.cross(motions[:, :3], parameters[3:6]).T
        if self.kind == "cylinder":
            found[6] = -root[count]
        return found


@dataclass(frozen=True, eq=False, repr=False)
class Noise(Value):
    """Noise of the distances of n points: `deviation` (n,) of each, and `common`, m, of all points of a profile.

    `profile` (n,) numbers the profiles from 0.
    """

    deviation: Array
    profile: NDArray[np.intp]
    common: float

    def shared(self, cell: NDArray[np.intp]) -> sparse.csr_array:
        """(c, p) standard deviation of the mean of the points in each cell, (n,), by each profile."""
        share = self.common / np.bincount(cell)[cell]
        if self.common == 0.0:
            return sparse.csr_array((int(cell.max()) + 1, 1))
        return sparse.csr_array((share, (cell, self.profile)))


@dataclass(frozen=True)
class Placed:
    """Nominal surface of a feature, adjusted by motions (f, 6) of the points, and by an offset where it is free."""

    feature: Feature
    motions: Array
    is_offset: bool
    moved_points: Array  # pose (4, 4) of the points
    offset: float = 0.0

    @classmethod
    def of(cls, feature: Feature, motions: Array, is_offset: bool, moved_points: Array) -> Placed:
        """With those combinations of motions (f, 6) that change distances: a plane does not feel shifts in itself."""
        placed = cls(feature, motions, is_offset, moved_points)
        effect = placed.by_motion(feature.points)[1] @ placed.motions.T
        _, values, vt = np.linalg.svd(effect, full_matrices=False)
        return replace(placed, motions=vt[values > UNFELT * len(effect) ** 0.5] @ placed.motions)

    @classmethod
    def best(cls, feature: Feature) -> Placed:
        """Least-squares place of the points on the nominal surface, or beside one that has a radius."""
        start = cls.of(feature, all_motions(feature), feature.kind in ("cylinder", "sphere", "torus"), np.eye(4))
        return least_squares(start, feature.points)

    def linearised(self, points: Array) -> tuple[Array, Array]:
        """Distances (n,) of points (n, 3), and their derivatives (n, f or f + 1)."""
        distance, by_motion = self.by_motion(points)
        columns = [by_motion @ self.motions.T]
        if self.is_offset:
            columns.append(-np.ones((len(points), 1)))
        return distance - self.offset, np.hstack(columns)

    def by_motion(self, points: Array) -> tuple[Array, Array]:
        """Distances (n,) of points (n, 3) without the offset, and their derivatives (n, 6) by a motion."""
        at = pose.transform_points(self.moved_points, points)
        distance, normal = self.feature.distances(at)
        return distance, np.hstack([np.cross(at, normal), normal])

    def moved(self, step: Array) -> Self:
        """The same after a step."""
        count = len(self.motions)
        motion = step[:count] @ self.motions
        turned = pose.from_rotation(pose.exp_rotation(motion[:3]), motion[3:]) @ self.moved_points
        return replace(self, moved_points=turned, offset=self.offset + float(step[count:].sum()))


def all_motions(feature: Feature) -> Array:
    """Turns and shifts (6, 6), of which each moves the feature by about as much."""
    size = float(np.linalg.norm(feature.corners, axis=1).max())
    return np.diag([1 / size] * 3 + [1.0] * 3)


@dataclass(frozen=True, eq=False, repr=False)
class DatumSystem(Value):
    """Datums in order of precedence (ISO 5459): an earlier one is met exactly, a later one in the motions left."""

    features: tuple[Feature, ...]

    def pose(self, parameters: Sequence[Array]) -> tuple[Array, Array]:
        """Pose (4, 4) that brings the part onto its nominal datums, and the motions (f, 6) that they leave free.

        Motions are turns and shifts (rx, ry, rz, x, y, z), rad and m, about the origin of the part.

        Parameters
        ----------
        parameters
            Those of the fit of each datum feature, (k,).
        """
        # Turns are counted in the displacements that they make at about the size of the part.
        size = max(float(np.linalg.norm(feature.corners, axis=1).max()) for feature in self.features)
        scale = np.array([1 / size] * 3 + [1.0] * 3)
        moved, free = np.eye(4), np.eye(6)
        for _ in range(_ITERATIONS):
            step, free = np.zeros(6), np.eye(6)
            for feature, own in zip(self.features, parameters, strict=True):
                away, jacobian = _constraints(feature, own, moved)
                u, values, vt = np.linalg.svd(jacobian * scale @ free.T)
                rank = int((values > _DEPENDENT).sum())
                right = -(away + jacobian @ (scale * step))
                step = step + ((u.T @ right)[:rank] / values[:rank]) @ vt[:rank] @ free
                free = vt[rank:] @ free
            step = scale * step
            motion = pose.from_rotation(pose.exp_rotation(step[:3]), step[3:])
            moved = motion @ moved
            if np.abs(step).max() < _SETTLED:
                break
        return moved, free * scale

    @cached_property
    def parameters(self) -> tuple[Array, ...]:
        """Parameters (k,) of the fit of each datum feature."""
        return tuple(feature.fit.parameters for feature in self.features)


def _constraints(feature: Feature, parameters: Array, moved: Array) -> tuple[Array, Array]:
    """Residuals (c,) of a datum of moved parameters (k,), and their derivatives (c, 6) by a turn and shift.

    Directions count as displacements at the ends of the feature, so that all are lengths.
    """
    u, v, w = feature.frame[:3, :3].T
    at = pose.transform_points(moved, parameters[None, :3])[0]
    to_point = np.hstack([-pose.skew(at), np.eye(3)])
    from_nominal = at - feature.frame[:3, 3]
    if feature.kind == "sphere":
        return from_nominal, to_point
    direction = moved[:3, :3] @ parameters[3:6]
    length = float(feature.half_extent.max())
    tilt = np.hstack([-length * pose.skew(direction), np.zeros((3, 3))])
    across = np.array([u, v])
    shifts = w[None] if feature.kind == "plane" else across
    away = np.concatenate([length * across @ direction, shifts @ from_nominal])
    return away, np.concatenate([across @ tilt, shifts @ to_point])
