"""The part's surface as points with normals on the table, and how much of it a view sees."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orchestrator.geometry import pose
from orchestrator.geometry.mesh import Mesh
from orchestrator.planning.model import SensorRange

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

# Grazing light gives a broad, dim stripe: 78 degrees from the normal is the limit of use.
MIN_COSINE = float(np.cos(np.radians(78)))


@dataclass(frozen=True)
class Surface:
    """Points (n, 3) evenly spread over the surface, unit normals (n, 3), in the frame of the table at angle 0.

    `extremes` (m, 3) are these points and the vertices, one per half millimetre, for distances not to be missed.
    """

    points: Array
    normals: Array
    extremes: Array

    def turned(self, angle: float) -> Surface:
        """The surface after the table turned by `angle`."""
        rotation = pose.rotation_about(2, angle)
        return Surface(self.points @ rotation.T, self.normals @ rotation.T, self.extremes @ rotation.T)


def sample(part: Mesh, table_from_part: Array, count: int = 12_000) -> Surface:
    """Sample the part where it is clamped, the same points for the same part (stratified by area).

    A mesh whose faces point inwards is turned over; an open one is taken with both sides.
    """
    weight = part.areas / part.areas.sum()
    rng = np.random.default_rng(0)
    ticks = (np.arange(count) + rng.uniform(size=count)) / count
    face = np.minimum(np.searchsorted(np.cumsum(weight), ticks), len(weight) - 1)
    u, v = rng.uniform(size=(2, count, 1))
    a, b, c = np.moveaxis(part.vertices[part.faces[face]], 1, 0)
    root = np.sqrt(u)
    points = (1 - root) * a + root * (1 - v) * b + root * v * c
    normals = part.normals[face]
    # The area vectors of a closed surface cancel; their moment is three times its volume.
    area_vector = part.normals * part.areas[:, None]
    if np.linalg.norm(area_vector.sum(0)) > 1e-3 * part.areas.sum():
        points, normals = np.concatenate([points, points]), np.concatenate([normals, -normals])
    elif (area_vector * (part.vertices[part.faces[:, 0]] - part.bounds.mean(0))).sum() < 0:
        normals = -normals
    extremes = part.vertices[np.unique(part.faces)]
    points, extremes = (pose.transform_points(table_from_part, p) for p in (points, extremes))
    return Surface(points, normals @ table_from_part[:3, :3].T, _thinned(np.concatenate([extremes, points])))


def _thinned(points: Array, grid: float = 5e-4) -> Array:
    """One of the points (n, 3) in each cube of a grid (m)."""
    cell = np.floor((points - points.min(0)) / grid).astype(np.int64)
    size = cell.max(0) + 1
    _, first = np.unique((cell[:, 0] * size[1] + cell[:, 1]) * size[2] + cell[:, 2], return_index=True)
    return np.asarray(points[first])


def lit_cosine(sensor_range: SensorRange, table_from_sensor: Array, points: Array, normals: Array) -> Array:
    """Cosine (n,) between normal and laser ray at points in the laser sheet, 0 where the sensor does not see.

    The points are taken to lie in the sheet (their x in the sensor frame is not looked at); a point counts when it
    lies in the range trapezoid and at least one camera is on the lit side of its tangent plane. Occlusion by other
    parts of the surface is not considered.
    """
    rotation, origin = table_from_sensor[:3, :3], table_from_sensor[:3, 3]
    at = (points - origin) @ rotation
    normal = normals @ rotation
    y, z = at[:, 1], at[:, 2]
    in_sheet = np.stack([np.zeros_like(y), y, z], -1)
    cosine = -(normal * in_sheet).sum(-1) / np.maximum(np.linalg.norm(in_sheet, axis=-1), 1e-12)
    seen = np.zeros(len(points), bool)
    for camera in sensor_range.cameras:
        ray = camera - in_sheet
        seen |= (normal * ray).sum(-1) > MIN_COSINE * np.linalg.norm(ray, axis=-1)
    return np.where(seen & sensor_range.holds(y, z), np.maximum(cosine, 0.0), 0.0)


def crossings(points: Array, offset: float) -> Array:
    """Turns (2, n, 3, 3) of the table that carry points (n, 3) into the plane y = `offset`; NaN for those too near.

    A point of a turning part crosses the plane twice: on the side of x > 0, where the sensor stands, and beyond.
    """
    radius = np.hypot(points[:, 0], points[:, 1])
    with np.errstate(invalid="ignore", divide="ignore"):
        near = np.arcsin(offset / radius) if offset else np.zeros_like(radius)
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    return pose.rotation_about(2, np.stack([near, np.pi - near]) - azimuth)


def best_cosine_of_sweep(sensor_range: SensorRange, table_from_sensor: Array, surface: Surface) -> Array:
    """Best `lit_cosine` (n,) of each point during a full turn of the table.

    `table_from_sensor` must look along -x, so that its sheet is a plane of constant y.
    """
    best = np.zeros(len(surface.points))
    for turn in crossings(surface.points, float(table_from_sensor[1, 3])):
        points = (turn @ surface.points[..., None])[..., 0]
        normals = (turn @ surface.normals[..., None])[..., 0]
        best = np.fmax(best, lit_cosine(sensor_range, table_from_sensor, points, normals))
    return best


def best_cosine_of_passes(sensor_range: SensorRange, start: Array, end: Array, surface: Surface) -> Array:
    """Best `lit_cosine` (n,) of each point during one straight pass from pose `start` to `end` across the sheet."""
    direction = start[:3, 0]
    along = (surface.points - start[:3, 3]) @ direction
    length = float((end[:3, 3] - start[:3, 3]) @ direction)
    crossed = (along >= min(0.0, length)) & (along <= max(0.0, length))
    return np.where(crossed, lit_cosine(sensor_range, start, surface.points, surface.normals), 0.0)
