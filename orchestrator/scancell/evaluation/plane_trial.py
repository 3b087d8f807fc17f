"""Measurement of a plane target by a sensor: signed bias, standard deviation, repeatability, outliers, missing points.

The target is a rectangle that the laser line does not leave. All figures are of the signed distances of the points from
it, positive towards the sensor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.arrays import Array
from scancell.config.choices import Engine
from scancell.config.loading import as_built_sensor
from scancell.config.material import PRESETS
from scancell.config.sensor import SensorDescription
from scancell.geometry import pose
from scancell.reconstruction.reconstruct import ProfilePoints
from scancell.scanning.sense import expose
from scancell.scanning.world import make_sensor

MATT = PRESETS["matt_white"].reflectance
_SIZE = 6.0  # edge of the target over its distance
_OUTLIER = 5.0  # robust standard deviations from the median
_TO_SIGMA = 1.4826  # median absolute deviation of a normal distribution
_BINS = 100  # of the laser line, for missing points
_BLOCKS = 16  # of the laser line, between whose means the target counts as straight

_MAX_GAP = 0.3e-3  # m: largest spacing of points between which a profile is interpolated


@dataclass(frozen=True)
class PlaneTarget:
    """A matt plane (Oren-Nayar) in front of the sensor.

    Attributes
    ----------
    z
        Where it meets the sensor's Z axis, m.
    in_plane, out_of_plane
        Angles of rotation about sensor X, which tilts the profile, and then about sensor Y, rad.
    reflectance
        0..1.
    speed
        Speed of the target along sensor X, m/s; the target is in its place at the middle of the exposure.
    """

    z: float
    in_plane: float = 0.0
    out_of_plane: float = 0.0
    reflectance: float = MATT
    speed: float = 0.0

    @property
    def sensor_from_target(self) -> Array:
        """Pose (4, 4); +z of the target towards the sensor."""
        turn = pose.rotation_about(1, self.out_of_plane) @ pose.rotation_about(0, np.pi + self.in_plane)
        return pose.from_rotation(turn, np.array([0.0, 0.0, self.z]))


@dataclass(frozen=True)
class PlaneReading:
    """Points (n, 3), m, of repeated exposures of a target, with exposure, camera and column (n,) of each.

    `line` is the half length of the laser line that an ideal sensor sees of the target, from -y to +y, m.
    """

    target: PlaneTarget
    exposures: int
    points_in_sensor: Array
    signed: Array
    frame: NDArray[np.int64]
    camera: NDArray[np.int64]
    column: NDArray[np.int64]
    line: tuple[float, float]

    def figures(self) -> PlaneFigures:
        """Statistics of the signed distances."""
        nothing = float("nan")
        if not len(self.signed):
            return PlaneFigures(0, nothing, nothing, nothing, nothing, nothing, nothing, 1.0)
        centre = np.median(self.signed)
        spread = _TO_SIGMA * np.median(np.abs(self.signed - centre))
        residual = self.signed - self.block_means().ravel()[self._block()]
        count = np.bincount(self.frame, minlength=self.exposures)
        means = np.bincount(self.frame, self.signed, minlength=self.exposures)[count > 0] / count[count > 0]
        far = np.abs(self.signed - centre) > _OUTLIER * max(float(spread), 1e-12)
        return PlaneFigures(
            points=len(self.signed),
            bias=float(self.signed.mean()),
            std=float(self.signed.std()),
            noise=float(np.sqrt((residual**2).mean())),
            repeatability_of_point=self._repeatability_of_point(),
            repeatability_of_mean=float(means.std(ddof=1)) if self.exposures > 1 else nothing,
            outlier_rate=float(far.mean()),
            missing_rate=self._missing(),
        )

    def block_means(self) -> Array:
        """Signed distance (k, 16), averaged over equal blocks of the line for each of k cameras; NaN where empty."""
        block, size = self._block(), (int(self.camera.max(initial=0)) + 1) * _BLOCKS
        with np.errstate(invalid="ignore"):
            means = np.bincount(block, self.signed, minlength=size) / np.bincount(block, minlength=size)
        return np.asarray(means.reshape(-1, _BLOCKS))

    def _block(self) -> NDArray[np.int64]:
        """Number (n,) of the block of each point among those of all cameras."""
        low, high = self.line
        place = np.clip(((self.points_in_sensor[:, 1] - low) / (high - low) * _BLOCKS).astype(int), 0, _BLOCKS - 1)
        return np.asarray(self.camera * _BLOCKS + place)

    def _repeatability_of_point(self) -> float:
        """Root mean square, over pixel columns, of the standard deviation over the exposures."""
        _, group = np.unique(np.column_stack([self.camera, self.column]), axis=0, return_inverse=True)
        group = group.ravel()
        number, first = np.bincount(group), np.bincount(group, self.signed)
        residual = self.signed - (first / number)[group]
        free = int((number - 1).sum())
        return float(np.sqrt((residual**2).sum() / free)) if free else float("nan")

    def _missing(self) -> float:
        """Share of the line, in bins without its ends, that holds no point of an exposure."""
        low, high = self.line
        if not high > low:
            return float("nan")
        place = np.floor((self.points_in_sensor[:, 1] - low) / (high - low) * _BINS).astype(int)
        inside = (place >= 1) & (place < _BINS - 1)
        held = len(np.unique(self.frame[inside] * _BINS + place[inside]))
        return 1.0 - held / (self.exposures * (_BINS - 2))


@dataclass(frozen=True)
class PlaneFigures:
    """Figures of a reading, m and 1.

    Attributes
    ----------
    bias, std
        Mean and standard deviation over all points of all exposures.
    noise
        Standard deviation of the points from the mean of their 1/16 of the laser line and camera, speckle included.
    repeatability_of_point, repeatability_of_mean
        Standard deviation over the exposures of a point in a fixed pixel column, and of the mean of the profile.
    outlier_rate
        Share of the points farther than 5 robust standard deviations from the median.
    missing_rate
        Share of the laser line, as an ideal sensor sees it, without a point.
    """

    points: int
    bias: float
    std: float
    noise: float
    repeatability_of_point: float
    repeatability_of_mean: float
    outlier_rate: float
    missing_rate: float

    def as_row(self) -> dict[str, Any]:
        """Plain data, lengths in um; None instead of NaN."""
        rates = ("points", "outlier_rate", "missing_rate")
        found = {name if name in rates else f"{name}_um": value for name, value in asdict(self).items()}
        scaled = {name: value if name in rates else 1e6 * value for name, value in found.items()}
        return {name: None if np.isnan(value) else value for name, value in scaled.items()}


def measure_plane(
    sensor: SensorDescription,
    target: PlaneTarget,
    exposures: int,
    engine: Engine,
    *,
    as_built: Sequence[str] = (),
    seed: int = 0,
    threads: int = 0,
) -> PlaneReading:
    """Expose a target several times, each with noise of its own.

    The view of the sensor without noise determines where points are expected.

    Raises `DescriptionError` if a perturbation is invalid; `SensorError` if the library reports an error.
    """
    scene = sensor_rt.Scene()
    roughness = PRESETS["matt_white"].roughness
    material = sensor_rt.Material(target.reflectance, "oren_nayar", roughness, 1.5)
    scene.add_plane("target", np.eye(4), (_SIZE * target.z, _SIZE * target.z), material)

    def measured(described: SensorDescription, count: int, engine: Engine) -> ProfilePoints:
        true = make_sensor(as_built_sensor(described, as_built), seed)
        index = np.arange(count, dtype=np.int64)
        taken = _exposures(true, target, index)
        return expose(scene, make_sensor(described, seed), true, taken, index, engine, threads=threads).points

    seen = measured(sensor.replace({"render.noise": False}), 1, "geometric")
    line = np.asarray(seen.points_in_sensor, float)[:, 1]
    found = measured(sensor, exposures, engine)
    points = np.asarray(found.points_in_sensor, float).reshape(-1, 3)
    at = target.sensor_from_target
    return PlaneReading(
        target=target,
        exposures=exposures,
        points_in_sensor=points,
        signed=(points - at[:3, 3]) @ at[:3, 2],
        frame=np.asarray(found.frame, np.int64),
        camera=np.asarray(found.camera, np.int64),
        column=np.asarray(found.column, np.int64),
        line=(float(line.min()), float(line.max())) if len(line) else (0.0, 0.0),
    )


def _exposures(sensor: sensor_rt.Sensor, target: PlaneTarget, index: NDArray[np.int64]) -> sensor_rt.Exposures:
    """At rest, or with the motion of the target over the exposure."""
    samples, count = 2 if target.speed else 1, len(index)
    bodies = np.tile(target.sensor_from_target, (count, 1, samples, 1, 1))
    if target.speed:
        bodies[:, 0, :, 0, 3] += 0.5 * target.speed * sensor.exposure * np.array([-1.0, 1.0])
    still = np.tile(np.eye(4), (count, samples, 1, 1))
    return sensor_rt.Exposures(still, bodies, np.full(count, sensor.exposure), index)


@dataclass(frozen=True)
class Linearity:
    """Largest deviations, m, from the best line of measured over true height.

    `of_mean` is of the mean height of the profiles, `of_field` of 1/16 of the laser line, each camera by itself.
    """

    of_mean: float
    of_field: float


def linearity(readings: Sequence[PlaneReading]) -> Linearity:
    """Linearity from readings of targets across the sensor's Z at distances over the measuring range."""
    z = np.array([one.target.z for one in readings])
    mean = np.array([one.signed.mean() for one in readings])
    each = [one.block_means().ravel() for one in readings]
    place, field = np.repeat(z, [len(one) for one in each]), np.concatenate(each)
    good = np.isfinite(field)
    return Linearity(_off_line(z, mean), _off_line(place[good], field[good]))


def _off_line(x: Array, y: Array) -> float:
    return float(np.abs(y - np.polyval(np.polyfit(x, y, 1), x)).max())


def sheet_deviation(profiles: Any, sensor: sensor_rt.Sensor) -> Array:
    """Offset (m,), m, of each point from the laser sheet along the sensor's X; NaN unless a second camera sees it.

    A camera with its centre at C triangulates P, where its ray meets the nominal sheet. A surface point at an offset d
    from the sheet lies on the same ray at ``P + d (s, t)`` in z and y, with ``s = (P_z - C_z) / (P_x - C_x)`` and
    ``t = (P_y - C_y) / (P_x - C_x)``. With the profile ``z(y)`` of a second camera (slopes s', t'), to first order,
    ``d = (P_z - z(P_y)) / (s' - s + (t - t') dz/dy)``.

    Parameters
    ----------
    profiles
        Points of any number of frames, with `points_in_sensor` (m, 3), `frame` and `camera` (m,).
    """
    points = np.asarray(profiles.points_in_sensor, float)
    frame, camera = np.asarray(profiles.frame), np.asarray(profiles.camera)
    centres = np.array([one.sensor_from_camera[:3, 3] for one in sensor.cameras])
    found = np.full(len(points), np.nan)
    for one_frame in np.unique(frame):
        of_frame = np.flatnonzero(frame == one_frame)
        for own in range(len(centres)):
            rows = of_frame[camera[of_frame] == own]
            others = of_frame[camera[of_frame] == (own + 1) % len(centres)]
            if len(rows) and len(others) > 1 and len(centres) > 1:
                found[rows] = _offset(points[rows], centres[own], points[others], centres[(own + 1) % len(centres)])
    return found


def _offset(points: Array, centre: Array, others: Array, other_centre: Array) -> Array:
    """Offsets (n,) of points (n, 3) from the sheet, by the points (m, 3) of the other camera."""
    others = others[np.argsort(others[:, 1], kind="stable")]
    y, z = others[:, 1], others[:, 2]
    after = np.clip(np.searchsorted(y, points[:, 1]), 1, len(y) - 1)
    step = y[after] - y[after - 1]
    inside = (points[:, 1] >= y[after - 1]) & (points[:, 1] <= y[after]) & (step > 0) & (step < _MAX_GAP)
    slope = np.divide(z[after] - z[after - 1], step, out=np.zeros(len(step)), where=inside)
    across = z[after - 1] + slope * (points[:, 1] - y[after - 1])
    t, s = _ray_slopes(points, centre)
    interpolated = np.stack([points[:, 0], points[:, 1], across], -1)
    other_t, other_s = _ray_slopes(interpolated, other_centre)
    sensitivity = other_s - s + (t - other_t) * slope
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(inside, (points[:, 2] - across) / sensitivity, np.nan)


def _ray_slopes(points: Array, centre: Array) -> tuple[Array, Array]:
    """Slopes dy/dx and dz/dx (n,) of the rays from a camera centre (3,) to points (n, 3)."""
    ray = points - centre
    return ray[:, 1] / ray[:, 0], ray[:, 2] / ray[:, 0]
