"""Cameras of pictures of the cell: an ideal pinhole, fixed, turning around the cell, or following the sensor."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.arrays import Array
from scancell.config.sensor import SensorDescription
from scancell.geometry import pose
from scancell.nominal.parts import Body
from scancell.views.recorded_run import RecordedRun

_FIELD_DEG = 34.0  # of view along the longer side of the picture: that of a 60 mm lens, which distorts little
_RIM = 0.05  # of the picture's width and height that framing leaves free on every side
View = Literal["cell", "part", "orbit", "sensor"]

AZIMUTH_DEG, ELEVATION_DEG = -52.0, 24.0  # deg, of the standard view
_PART_ELEVATION = 38.0  # deg: lower views hardly show the top of a part
_SAMPLES = 16  # of the run, at which everything is kept in view
_MOST_VERTICES = 150  # of a body that framing looks at

Index = NDArray[np.int64]

_LEAST_PX = 1.5  # half width of the drawn stripe at least, or it would break up into dots


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


# Camera at a time of the run, with this share (0 to 1) of the pictures taken.
CameraPath = Callable[[float, float], PinholeCamera]


def camera_path(view: View, run: RecordedRun, size: tuple[int, int]) -> CameraPath:
    """The camera of a view for pictures of `size` (width, height), px.

    ``cell`` is fixed and has the whole cell in view at all times, ``part`` the table and the part, larger; ``orbit``
    goes once around the cell; ``sensor`` keeps the sensor and what it measures in the middle.
    """
    times = np.linspace(run.motion.start, run.motion.duration, _SAMPLES)
    bodies = run.cell.bodies
    if view == "part":
        near = [body for body in bodies if body.moves_with in ("part", "sensor" if run.cell.holds_part else "table")]
        fixed = framing(_swept(near, run, times), AZIMUTH_DEG, _PART_ELEVATION, size)
        return lambda time, share: fixed
    if view == "sensor":
        return _following(run, size)
    swept = _swept(bodies, run, times)
    if view == "cell":
        whole = framing(swept, AZIMUTH_DEG, ELEVATION_DEG, size)
        return lambda time, share: whole
    return _orbiting(swept, size)


def _swept(bodies: list[Body] | tuple[Body, ...], run: RecordedRun, times: Array) -> Array:
    """World points (n, 3) of some vertices of bodies at some times."""
    return np.concatenate([points_of_bodies(bodies, frames) for frames in map(run.motion.frames, times.tolist())])


def points_of_bodies(bodies: Sequence[Body], frames: Mapping[str, Array]) -> Array:
    """World points (n, 3) of some vertices of bodies, whose `frames` are at poses (4, 4)."""
    found = []
    for body in bodies:
        vertices = body.mesh.vertices[:: max(1, len(body.mesh.vertices) // _MOST_VERTICES)]
        found.append(pose.transform_points(frames[body.moves_with], vertices))
    return np.concatenate(found)


def _orbiting(points: Array, size: tuple[int, int]) -> CameraPath:
    """Once around points (n, 3), which stay in view, each taken as the circle that it draws around the middle."""
    middle = (points.min(0) + points.max(0)) / 2
    radius = np.hypot(*(points - middle)[:, :2].T)
    around = np.radians(np.arange(0, 360, 15))[:, None]
    circles = np.stack(np.broadcast_arrays(radius * np.cos(around), radius * np.sin(around), points[:, 2] - middle[2]))
    framed = framing(middle + circles.reshape(3, -1).T, AZIMUTH_DEG, ELEVATION_DEG, size)

    def camera(time: float, share: float) -> PinholeCamera:
        turn = pose.rotation_about(2, 2 * np.pi * share)
        about_middle = pose.from_rotation(turn, middle - turn @ middle)
        return replace(framed, world_from_camera=about_middle @ framed.world_from_camera)

    return camera


def _following(run: RecordedRun, size: tuple[int, int]) -> CameraPath:
    """From a fixed direction, with the middle of sensor and stripe in the middle of the picture."""
    far = 1e-3 * run.setup.sensor.range.far_mm
    housing = next((body.mesh for body in run.cell.bodies if body.moves_with == "sensor"), None)
    extent = far if housing is None else float(np.linalg.norm(np.ptp(housing.bounds, axis=0)))
    away = 2.0 * (far + extent) * direction(AZIMUTH_DEG, ELEVATION_DEG)

    def camera(time: float, share: float) -> PinholeCamera:
        frames: Mapping[str, Array] = run.motion.frames(time)
        target = frames["sensor"][:3, 3] + 0.4 * far * frames["sensor"][:3, 2]
        return looking_at(target + away, target, size)

    return camera


@dataclass(frozen=True)
class LaserSheet:
    """A switched-on laser: the sheet x = 0 of the sensor frame, |y| <= `slope` * (z - `source_z`).

    Lengths in m. `half_width` is that of the stripe; pictures widen it to about a pixel. `far` is the end of the
    measuring range; light is drawn up to ten times as far. Curvature and misalignment of the sheet are too small to be
    seen in a picture of the cell and are left out.
    """

    world_from_sensor: Array
    source_z: float
    slope: float
    half_width: float
    far: float

    @property
    def source(self) -> Array:
        """Position (3,) of the source in the world, m."""
        return np.asarray(self.world_from_sensor[:3, 3] + self.source_z * self.world_from_sensor[:3, 2])

    def stripe(self, eye: Array, directions: Array, depth: Array, focal_px: float) -> tuple[Index, Array]:
        """Rows (k,) of rays that meet the stripe, shadows left aside, and its brightness (k,) there, 0 to 1.

        Rays (n, 3) from `eye` (3,) meet surfaces at multiples `depth` (n,) of their directions, infinite for none;
        `focal_px` gives the width of a pixel there.
        """
        start, normal = self._across(eye)
        x = np.abs(start + np.where(np.isfinite(depth), depth, 0.0) * (directions @ normal))
        half = np.maximum(self.half_width, (_LEAST_PX / focal_px) * depth)
        rows = np.flatnonzero((x < 1.5 * half) & np.isfinite(depth))
        rows = rows[self._distance(eye + depth[rows, None] * directions[rows]) > 0]
        return rows, np.clip(1.5 - x[rows] / half[rows], 0.0, 1.0)

    def veil(self, eye: Array, directions: Array, depth: Array) -> tuple[Index, Array, Array]:
        """Points at which rays cross the sheet before surfaces, shadows left aside; rays as for `stripe`.

        Returns rows (k,) of rays, the points (k, 3) where they cross it, and how much light (k,) is left of 1: it thins
        out from a quarter of the measuring range on.
        """
        start, normal = self._across(eye)
        with np.errstate(divide="ignore", invalid="ignore"):
            t = -start / (directions @ normal)
        rows = np.flatnonzero((t > 0) & (t < depth))
        points = eye + t[rows, None] * directions[rows]
        distance = self._distance(points)
        kept = np.flatnonzero(distance > 0)
        return rows[kept], points[kept], np.minimum(1.0, 0.25 * self.far / distance[kept])

    def _across(self, eye: Array) -> tuple[float, Array]:
        """Sensor x of the eye, and the direction (3,) in the world in which it grows."""
        normal = self.world_from_sensor[:3, 0]
        return float((eye - self.world_from_sensor[:3, 3]) @ normal), normal

    def _distance(self, points: Array) -> Array:
        """Distance (n,) along sensor z from the source of world points (n, 3) between the ends of the fan, else 0."""
        _, y, z = pose.transform_points(pose.inverse(self.world_from_sensor), points).T
        ahead = z - self.source_z
        return np.where((ahead <= 10 * self.far) & (np.abs(y) <= self.slope * ahead), ahead, 0.0)


def laser_sheet(sensor: SensorDescription, world_from_sensor: Array) -> LaserSheet:
    """The sheet of a described sensor at a pose (4, 4)."""
    laser = sensor.laser
    source = 1e-3 * laser.source_z_mm
    return LaserSheet(
        world_from_sensor,
        source,
        float(np.tan(np.radians(laser.fan_half_angle_deg))),
        2e-3 * laser.sheet_sigma_mm,
        1e-3 * sensor.range.far_mm,
    )
