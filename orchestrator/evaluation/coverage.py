"""How much of the surface that the sensor could see has points.

What it could see is worked out from the mesh, the planned poses and the sensor's dimensions by a ray tracer that the
sensor model does not share (see `tracer`), so that a fault in one is not excused by the other.

The rule: a place counts as covered where a point of the cloud lies within 1.5 profile spacings, and never where the
next one is more than 1.5 mm away. Of a plane scanned in profiles `s` apart that leaves the share min(1, 3 mm / s).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from orchestrator.evaluation.tracer import Tracer
from orchestrator.geometry import pose
from orchestrator.geometry.mesh import Mesh

Array = NDArray[np.float64]
Index = NDArray[np.int64]

COVERAGE_SAMPLES = 20_000
_SPACINGS = 1.5  # of the profiles, by which a point reaches: more than the half that dense profiles need
_FARTHEST = 1.5e-3  # m, whatever the spacing
_LIFT = 10e-6  # m off the surface where sight lines start: clear of single precision, far below any feature
_CHUNK = 2000  # samples whose distances to all sheets are held at a time


@dataclass(frozen=True)
class CameraView:
    """Pinhole camera of the sensor: `camera_from_sensor` (4, 4), focal length, image centre and size in px."""

    camera_from_sensor: Array
    focal_px: float
    centre_px: tuple[float, float]
    size_px: tuple[int, int]

    def sees(self, points_in_sensor: Array) -> NDArray[np.bool_]:
        """(n,) whether the points (n, 3) fall into the image. Lens distortion is left out."""
        x, y, z = pose.transform_points(self.camera_from_sensor, points_in_sensor).T
        column, row = (self.focal_px * v / z + c for v, c in zip((x, y), self.centre_px, strict=True))
        inside = (np.abs(2 * column + 1 - self.size_px[0]) <= self.size_px[0]) & (
            np.abs(2 * row + 1 - self.size_px[1]) <= self.size_px[1]
        )
        return np.asarray((z > 0) & inside)

    @property
    def position_in_sensor(self) -> Array:
        """(3,) centre of projection."""
        return np.asarray(pose.inverse(self.camera_from_sensor)[:3, 3])


@dataclass(frozen=True)
class SensorView:
    """What decides whether the sensor sees a point: source and opening of the laser, range, cameras. SI."""

    source_z: float
    fan_half_angle: float
    near: float
    far: float
    cameras: tuple[CameraView, ...]

    @classmethod
    def from_resolved(cls, sensor: Mapping[str, Any]) -> SensorView:
        """From the resolved description (SI) that the sensor library gets."""
        laser, limits = sensor["laser"], sensor["range"]
        return cls(
            laser["source_z"],
            laser["fan_half_angle"],
            limits["near"],
            limits["far"],
            tuple(_camera_view(camera) for camera in sensor["cameras"]),
        )


@dataclass(frozen=True)
class Coverage:
    """Samples of equal area on the whole surface, which of them could be seen, and which of these have points."""

    samples_in_part: Array
    visible: NDArray[np.bool_]
    covered: NDArray[np.bool_]
    sample_area: float
    radius: float
    spacing: float
    incidence_limit: float

    @property
    def fraction(self) -> float:
        """Covered share of the visible surface, 0 … 1; NaN when nothing is visible."""
        seen = int(self.visible.sum())
        return float((self.covered & self.visible).sum() / seen) if seen else float("nan")

    def as_json(self) -> dict[str, Any]:
        """Plain data for ``deviation.json``."""
        fraction = self.fraction
        return {
            "what": "share of the visible surface that has a point of the cloud within the radius",
            "fraction": None if np.isnan(fraction) else fraction,
            "visible_area_mm2": 1e6 * self.sample_area * int(self.visible.sum()),
            "surface_area_mm2": 1e6 * self.sample_area * len(self.visible),
            "radius_mm": 1e3 * self.radius,
            "profile_spacing_mm": 1e3 * self.spacing,
            "incidence_limit_deg": float(np.degrees(self.incidence_limit)),
            "samples": len(self.visible),
        }


def coverage(
    mesh: Mesh,
    points_in_part: Array,
    part_from_sensor: Array,
    view: SensorView,
    *,
    spacing: float,
    obstacles: Sequence[Mesh] = (),
    radius: float | None = None,
    incidence_limit: float = np.radians(75.0),
    samples: int = COVERAGE_SAMPLES,
    seed: int = 0,
    threads: int = 0,
) -> Coverage:
    """Share of the visible surface that the cloud covers.

    Parameters
    ----------
    mesh, obstacles
        The part, and what turns with it and can hide it (the table), in the part frame, m.
    points_in_part
        (k, 3) points of the cloud.
    part_from_sensor
        (n, 4, 4) nominal pose of the sensor at each planned exposure.
    spacing
        Distance between neighbouring profiles on the surface, m: a sample is lit by an exposure whose sheet passes
        within half of it.
    radius
        A sample is covered when a point lies within this distance, m; 1.5 × `spacing`, at most 1.5 mm, unless given.
    incidence_limit
        Largest angle (rad) between the surface normal and the laser's light, or a camera's view.
    samples, seed
        How many samples of equal area stand for the surface, and the seed that places them.
    threads
        For the search of neighbours; 0: as many as there are cores.
    """
    reach = min(_SPACINGS * spacing, _FARTHEST) if radius is None else radius
    places, normals = sample_surface(mesh, samples, seed)
    visible = visible_samples(
        places,
        normals,
        Tracer([mesh, *obstacles]),
        part_from_sensor,
        view,
        tolerance=spacing / 2,
        incidence_limit=incidence_limit,
    )
    covered = np.zeros(samples, bool)
    if len(points_in_part):
        covered = np.isfinite(
            cKDTree(points_in_part).query(places, distance_upper_bound=reach, workers=threads or -1)[0]
        )
    area = float(mesh.areas.sum()) / samples
    return Coverage(places, visible, covered, area, reach, spacing, incidence_limit)


def sample_surface(mesh: Mesh, count: int, seed: int) -> tuple[Array, Array]:
    """Points (count, 3) that stand for equal areas, and their face normals (count, 3).

    Along the list of faces the samples are evenly spaced in area (one random place in each of `count` equal
    stretches), inside its face each is uniformly random.
    """
    rng = np.random.default_rng(seed)
    edge = np.cumsum(mesh.areas)
    face = np.searchsorted(edge, (np.arange(count) + rng.random(count)) / count * edge[-1], side="right")
    face = np.minimum(face, len(mesh.faces) - 1)
    u, v = rng.random((2, count))
    root = np.sqrt(u)
    weights = np.stack([1 - root, root * (1 - v), root * v], -1)
    return np.einsum("nk,nkd->nd", weights, mesh.vertices[mesh.faces[face]]), mesh.normals[face]


def visible_samples(
    samples: Array,
    normals: Array,
    tracer: Tracer,
    part_from_sensor: Array,
    view: SensorView,
    *,
    tolerance: float,
    incidence_limit: float,
) -> NDArray[np.bool_]:
    """(m,) whether the laser lights and some camera sees each sample (m, 3) in at least one exposure."""
    sample, exposure = _lit_pairs(samples, part_from_sensor, view, tolerance)
    least = np.cos(incidence_limit)
    source = _positions(part_from_sensor, np.array([0.0, 0.0, view.source_z]))
    lit = _in_sight(samples[sample], normals[sample], source[exposure], least, tracer)
    sample, exposure = sample[lit], exposure[lit]
    sensor_from_part = pose.inverse(part_from_sensor)
    in_sensor = pose.transform_each(sensor_from_part[exposure], samples[sample])
    visible = np.zeros(len(samples), bool)
    for camera in view.cameras:
        todo = camera.sees(in_sensor) & ~visible[sample]
        centre = _positions(part_from_sensor, camera.position_in_sensor)
        rest = sample[todo]
        seen = _in_sight(samples[rest], normals[rest], centre[exposure[todo]], least, tracer)
        visible[rest[seen]] = True
    return visible


def _lit_pairs(samples: Array, part_from_sensor: Array, view: SensorView, tolerance: float) -> tuple[Index, Index]:
    """Pairs of sample and exposure where the sample lies in the sheet's slice, its fan and the range."""
    sensor_from_part = pose.inverse(part_from_sensor)
    slope, shift = sensor_from_part[:, 0, :3].T, sensor_from_part[:, 0, 3]
    found: list[tuple[Index, Index]] = []
    for start in range(0, len(samples), _CHUNK):
        across = samples[start : start + _CHUNK] @ slope + shift
        near_sheet = np.nonzero(np.abs(across) <= tolerance)
        found.append((near_sheet[0] + start, near_sheet[1]))
    sample = np.concatenate([pair[0] for pair in found])
    exposure = np.concatenate([pair[1] for pair in found])
    _, y, z = pose.transform_each(sensor_from_part[exposure], samples[sample]).T
    in_fan = np.abs(y) <= (z - view.source_z) * np.tan(view.fan_half_angle)
    kept = in_fan & (z >= view.near) & (z <= view.far)
    return sample[kept], exposure[kept]


def _in_sight(
    places: Array, normals: Array, viewpoints: Array, least_cosine: float, tracer: Tracer
) -> NDArray[np.bool_]:
    """Whether each place (k, 3) faces its viewpoint (k, 3) steeply enough and nothing stands between them."""
    way = viewpoints - places
    cosine = np.einsum("ki,ki->k", way, normals) / np.linalg.norm(way, axis=1)
    good = cosine >= least_cosine
    good[good] = ~tracer.blocked(places[good] + _LIFT * normals[good], viewpoints[good])
    return np.asarray(good)


def _positions(part_from_sensor: Array, point_in_sensor: Array) -> Array:
    """(n, 3) where a point of the sensor is at each exposure."""
    return np.asarray(part_from_sensor[:, :3, :3] @ point_in_sensor + part_from_sensor[:, :3, 3])


def _camera_view(camera: Mapping[str, Any]) -> CameraView:
    side, tilt = camera["side"], camera["tilt"]
    sine, cosine = np.sin(tilt), np.cos(tilt)
    axes = [[0.0, -side, 0.0], [side * cosine, 0.0, sine], [-side * sine, 0.0, cosine]]  # x, y, z of the camera
    sensor_from_camera = pose.from_rotation(np.array(axes).T, (side * camera["baseline"], 0.0, camera["height"]))
    return CameraView(
        pose.inverse(sensor_from_camera),
        camera["focal_px"],
        (camera["cx_px"], camera["cy_px"]),
        (camera["width_px"], camera["height_px"]),
    )
