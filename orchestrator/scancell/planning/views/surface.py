"""Surface samples of the part on the table, and which of them a view sees."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scancell.geometry import pose
from scancell.geometry.mesh import Mesh
from scancell.geometry.sampling import sample_surface
from scancell.planning.model import SensorRange

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

# At grazing incidence the stripe is wide and dim: up to 78 degrees from the normal it is usable.
MIN_COSINE = float(np.cos(np.radians(78)))


@dataclass(frozen=True)
class Surface:
    """Surface samples in the frame of the table at angle 0, m.

    Attributes
    ----------
    points, normals
        (n, 3) points of equal area shares and their unit normals.
    extremes
        (m, 3) sample points and mesh vertices, thinned to one per 0.5 mm cube: the extent of the part.
    """

    points: Array
    normals: Array
    extremes: Array

    def turned(self, angle: float) -> Surface:
        """The surface rotated by `angle` (rad) about the table's axis."""
        rotation = pose.rotation_about(2, angle)
        return Surface(self.points @ rotation.T, self.normals @ rotation.T, self.extremes @ rotation.T)


def sample(part: Mesh, table_from_part: Array, count: int = 12_000) -> Surface:
    """Area-stratified samples of the part (mesh in the part frame, m), the same for the same mesh.

    Normals of a closed mesh point outwards, whatever its winding; an open mesh is sampled on both sides.

    Parameters
    ----------
    table_from_part
        (4, 4) pose of the part on the table at angle 0.
    count
        Number of samples; an open mesh gets twice as many.
    """
    points, face = sample_surface(part, count, seed=0)
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
    """The first of the points (n, 3) in each cube of edge length `grid` (m)."""
    cell = np.floor((points - points.min(0)) / grid).astype(np.int64)
    size = cell.max(0) + 1
    _, first = np.unique((cell[:, 0] * size[1] + cell[:, 1]) * size[2] + cell[:, 2], return_index=True)
    return np.asarray(points[first])


def lit_cosine(sensor_range: SensorRange, table_from_sensor: Array, points: Array, normals: Array) -> Array:
    """Cosine (n,) of the laser's angle of incidence at points (n, 3), 0 where the sensor does not see them.

    `table_from_sensor` (4, 4) or (n, 4, 4), m, has each point in the laser sheet: its x in the sensor frame is ignored;
    NaN where there is no such pose. A point is seen if it lies in the measuring range and at least one camera sees its
    front side at an angle up to 78 degrees. Occlusion is ignored.
    """
    rotation, origin = table_from_sensor[..., :3, :3], table_from_sensor[..., :3, 3]
    at = np.einsum("...ij,...i->...j", rotation, points - origin)
    normal = np.einsum("...ij,...i->...j", rotation, normals)
    y, z = at[:, 1], at[:, 2]
    in_sheet = np.stack([np.zeros_like(y), y, z], -1)
    cosine = -(normal * in_sheet).sum(-1) / np.maximum(np.linalg.norm(in_sheet, axis=-1), 1e-12)
    seen = np.zeros(len(points), bool)
    for camera in sensor_range.cameras:
        ray = camera - in_sheet
        seen |= (normal * ray).sum(-1) > MIN_COSINE * np.linalg.norm(ray, axis=-1)
    return np.where(seen & sensor_range.contains(y, z), np.maximum(cosine, 0.0), 0.0)


def crossing_angles(points: Array, offset: float) -> Array:
    """Table angles (2, n), rad, that move points (n, 3) into the plane y = `offset` (m).

    A point crosses the plane twice per turn: first at x > 0, on the sensor's side, and then at x < 0. NaN for points
    nearer to the axis than `offset`.
    """
    radius = np.hypot(points[:, 0], points[:, 1])
    with np.errstate(invalid="ignore", divide="ignore"):
        near = np.arcsin(offset / radius) if offset else np.zeros_like(radius)
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    return np.stack([near, np.pi - near]) - azimuth
