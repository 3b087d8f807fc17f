"""The camera that a picture of the cell is taken with: an ideal pinhole."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.geometry import pose

Array = NDArray[np.float64]

_FIELD_DEG = 34.0  # of view along the longer side of the picture: that of a 60 mm lens, which distorts little
_RIM = 0.05  # of the picture's width and height that framing leaves free on every side


@dataclass(frozen=True)
class PinholeCamera:
    """Pinhole camera: axes x to the right, y down, z forward; integer pixel = pixel centre.

    `world_from_camera` is (4, 4); `focal_px` in pixels; the principal point is the middle of the picture.
    """

    world_from_camera: Array
    focal_px: float
    width_px: int
    height_px: int

    @property
    def centre(self) -> Array:
        """Optical centre (3,) in the world, m."""
        return self.world_from_camera[:3, 3]

    @property
    def principal_point(self) -> Array:
        """Column and row (2,) that the optical axis passes through, px."""
        return np.array([self.width_px - 1, self.height_px - 1]) / 2

    def directions(self, pixels: ArrayLike) -> Array:
        """World directions (n, 3) of pixels (n, 2) = (column, row), 1 m long along the optical axis."""
        right, down, forward = self.world_from_camera[:3, :3].T
        offset = (np.asarray(pixels, float) - self.principal_point) / self.focal_px
        return np.asarray(offset @ np.stack([right, down]) + forward)

    def project(self, points: ArrayLike) -> tuple[Array, Array]:
        """Pixels (n, 2) = (column, row) and depths (n,), m along the optical axis, of world points (n, 3).

        Pixels of points that do not lie before the camera (depth <= 0) are NaN.
        """
        seen = pose.transform_points(pose.inverse(self.world_from_camera), points)
        depth = seen[:, 2]
        ahead = np.where(depth > 0, depth, np.nan)
        return self.focal_px * seen[:, :2] / ahead[:, None] + self.principal_point, depth


def looking_at(eye: ArrayLike, target: ArrayLike, size: tuple[int, int]) -> PinholeCamera:
    """Camera at `eye` (3,) with `target` (3,) in the middle of a picture of `size` (width, height) px, upright."""
    eye, target = np.asarray(eye, float), np.asarray(target, float)
    forward = (target - eye) / np.linalg.norm(target - eye)
    side = np.cross(forward, (0.0, 0.0, 1.0))
    right = side / np.linalg.norm(side) if np.linalg.norm(side) > 1e-9 else np.array([1.0, 0.0, 0.0])
    rotation = np.stack([right, np.cross(forward, right), forward], -1)
    focal = max(size) / (2 * np.tan(np.radians(_FIELD_DEG) / 2))
    return PinholeCamera(pose.from_rotation(rotation, eye), float(focal), *size)


def direction(azimuth_deg: float, elevation_deg: float) -> Array:
    """Unit vector (3,) at `azimuth_deg` from world x and `elevation_deg` above the horizontal."""
    azimuth, elevation = np.radians([azimuth_deg, elevation_deg])
    level = np.cos(elevation)
    return np.array([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])


def framing(points: Array, azimuth_deg: float, elevation_deg: float, size: tuple[int, int]) -> PinholeCamera:
    """The nearest camera in a `direction` from world points (n, 3) that has all in view, with a rim around them.

    `size` is the width and height of the picture, px.
    """
    middle = (points.min(0) + points.max(0)) / 2
    camera = looking_at(middle + direction(azimuth_deg, elevation_deg), middle, size)
    axes = camera.world_from_camera[:3, :3]
    slope = (1 - 2 * _RIM) * np.array(size) / (2 * camera.focal_px)
    seen = (points - middle) @ axes
    # A camera shifted by x0 that stands back by s sees the point (x, z) where |x - x0| <= slope * (s + z). The points
    # that bind at both sides of the picture give the middle between them, and the distance.
    most, least = (seen[:, :2] - slope * seen[:, 2:]).max(0), (seen[:, :2] + slope * seen[:, 2:]).min(0)
    shift, back = (most + least) / 2, float(((most - least) / 2 / slope).max())
    eye = middle + axes[:, :2] @ shift - back * axes[:, 2]
    return replace(camera, world_from_camera=pose.from_rotation(axes, eye))
