"""Scan paths for any part: turns of the table at several elevations and heights, and straight passes over the top.

Everything is laid out in the frame of the table at angle 0 (origin on the top face, z along the axis). How the arm
gets there, and from which side, is decided later.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orchestrator.errors import PlanningError
from orchestrator.geometry import pose
from orchestrator.planning import surface
from orchestrator.planning.model import SensorRange
from orchestrator.planning.options import RasterOptions, SweepOptions
from orchestrator.planning.surface import MIN_COSINE, Surface

Array = NDArray[np.float64]

_EDGE = 1e-3  # the ends of the laser line and of a pass reach this far beyond what they must cover
_WORTH = 0.002  # share of the surface that a deeper level must add
_MAX_LEVELS = 4


@dataclass(frozen=True)
class Sweep:
    """A full turn of the table under a standing sensor.

    `at_azimuth_zero` (4, 4) is ``table_from_sensor`` in the plane y = 0, the laser sheet holding the table's axis;
    turning it about the axis gives the same scan from another side.
    """

    name: str
    at_azimuth_zero: Array
    target: Array
    elevation: float

    def at(self, azimuth: float, roll: float) -> Array:
        """``table_from_sensor`` at an azimuth; `roll` (0 or pi) turns the sensor about its viewing direction."""
        turn = pose.from_rotation(pose.rotation_about(2, azimuth))
        return np.asarray(turn @ self.at_azimuth_zero @ pose.from_rotation(pose.rotation_about(2, roll)))

    def tilted(self, elevation: float, standoff: float) -> Sweep:
        """The same line of the part seen under another elevation, from farther or nearer by `standoff` (m)."""
        distance = float(np.linalg.norm(self.at_azimuth_zero[:3, 3] - self.target)) + standoff
        name = f"{self.name} (raised to {np.degrees(elevation):.0f} deg)"
        return Sweep(name, sweep_pose(self.target, elevation, distance), self.target, elevation)


@dataclass(frozen=True)
class Pass:
    """A straight pass, looking down the axis and moving across the laser sheet.

    `start` and `end` (4, 4) are ``table_from_sensor`` when the table is turned by `-direction`: the travel is along x.
    """

    name: str
    start: Array
    end: Array
    direction: float

    def at(self, path: Array) -> Array:
        """Sensor poses (n, 4, 4) at path coordinates (n,) in metres from the start, extrapolated beyond both ends."""
        return pose.interpolate_straight(self.start, self.end, path / self.length)

    @property
    def length(self) -> float:
        """Metres between the first and the last exposure."""
        return float(np.linalg.norm(self.end[:3, 3] - self.start[:3, 3]))


def sweep_pose(target: Array, elevation: float, distance: float) -> Array:
    """``table_from_sensor`` at azimuth 0 that looks at `target` (3,) from `distance` (m), in one plane with the axis."""
    c, s = np.cos(elevation), np.sin(elevation)
    rotation = np.array([[0.0, -s, -c], [-1.0, 0.0, 0.0], [0.0, c, -s]])
    return pose.from_rotation(rotation, target + distance * np.array([c, 0.0, s]))


def sweeps(part: Surface, sensor_range: SensorRange, options: SweepOptions) -> list[Sweep]:
    """Turns that cover what faces the sensor at each elevation."""
    return [view for e in options.elevations for view in _sweeps_at(part, sensor_range, options, e)]


def _sweeps_at(part: Surface, sensor_range: SensorRange, options: SweepOptions, elevation: float) -> list[Sweep]:
    up, depth = _meridian(part.points, elevation)
    facing = _facing(part, elevation)
    # A point seen on the sensor's side of the axis need not be seen again on the far side.
    side = np.where(facing[0], 0, 1)
    wanted = facing.any(0)
    if not wanted.any():
        return []
    rows = np.arange(wanted.size)
    up, depth = up[side, rows], depth[side, rows]
    solid_up, solid_depth = (x.reshape(-1) for x in _meridian(part.extremes, elevation))
    half = _half_line(sensor_range, options.standoff)
    views: list[Sweep] = []
    covered = ~wanted
    for centre in tile(float(up[wanted].min()), float(up[wanted].max()), half, options.height_step):
        window = np.abs(solid_up - centre) <= half
        own = np.abs(up - centre) <= half
        near = solid_depth[window].min() if window.any() else depth[wanted & own].min(initial=np.inf)
        for _ in range(_MAX_LEVELS):
            if not np.isfinite(near):
                break
            target = _from_meridian(centre, near, elevation)
            name = f"sweep at {np.degrees(elevation):.0f} deg, line centre {centre_text(target)}"
            view = Sweep(name, sweep_pose(target, elevation, options.standoff), target, elevation)
            seen = surface.best_cosine_of_sweep(sensor_range, view.at_azimuth_zero, part) > MIN_COSINE
            if (seen & ~covered).mean() > _WORTH or not views:
                views.append(view)
                covered |= seen
            left = ~covered & own & (depth > near + 1e-6)
            if left.mean() < _WORTH:
                break
            near = max(float(np.quantile(depth[left], 0.01)), near + 0.2 * (sensor_range.far - options.standoff))
    return views


def _meridian(points: Array, elevation: float) -> tuple[Array, Array]:
    """Coordinates (2, n) along the laser line and along the view when points pass near (0) and far (1) of the axis."""
    radius = np.hypot(points[:, 0], points[:, 1])
    r = np.stack([radius, -radius])
    c, s = np.cos(elevation), np.sin(elevation)
    return -s * r + c * points[:, 2], -c * r - s * points[:, 2]


def _from_meridian(up: float, depth: float, elevation: float) -> Array:
    c, s = np.cos(elevation), np.sin(elevation)
    return np.array([-s * up - c * depth, 0.0, c * up - s * depth])


def _facing(part: Surface, elevation: float) -> NDArray[np.bool_]:
    """(2, n) whether the surface faces the sensor on the near and on the far side of the axis."""
    radius = np.hypot(part.points[:, 0], part.points[:, 1])
    outwards = part.points[:, :2] / np.maximum(radius, 1e-9)[:, None]
    radial = (part.normals[:, :2] * outwards).sum(1)
    c, s = np.cos(elevation), np.sin(elevation)
    return np.asarray(np.stack([c * radial, -c * radial]) + s * part.normals[:, 2] > MIN_COSINE)


def tile(low: float, high: float, half: float, step: float) -> Array:
    """Centres of lines of half-width `half` that cover [low, high], at most `step` apart, evenly spread."""
    span = high - low
    if span <= 2 * half:
        return np.array([(low + high) / 2])
    count = int(np.ceil((span - 2 * half) / min(step, 2 * half) - 1e-9)) + 1
    return np.linspace(low + half, high - half, count)


def _half_line(sensor_range: SensorRange, standoff: float) -> float:
    return float(sensor_range.half_line(standoff)) - _EDGE


def centre_text(target: Array) -> str:
    """Radius and height of a point of the plane y = 0 in millimetres, for messages."""
    return f"radius {1e3 * target[0]:.0f} mm height {1e3 * target[2]:.0f} mm"


def passes(part: Surface, sensor_range: SensorRange, options: RasterOptions) -> list[Pass]:
    """Passes over everything that faces up, in the direction that makes them few and short."""
    up = part.normals[:, 2] > MIN_COSINE
    if not up.any():
        return []
    half = _half_line(sensor_range, options.standoff)
    step = max(2 * half - options.overlap, half)

    def effort(direction: float) -> float:
        span = np.ptp(part.turned(-direction).points[up], axis=0)
        return float(len(tile(0.0, span[1], half, step)) * (span[0] + 0.02))

    direction = min(np.radians(np.arange(0, 180, 15)), key=effort)
    turned = part.turned(-float(direction))
    y = turned.points[up, 1]
    result: list[Pass] = []
    for centre in tile(float(y.min()), float(y.max()), half, step):
        result += _passes_along(turned, sensor_range, options, float(centre), float(direction))
    # Back and forth: every other strip is driven the other way.
    return [p if i % 2 == 0 else Pass(p.name, p.end, p.start, p.direction) for i, p in enumerate(result)]


def _passes_along(
    turned: Surface, sensor_range: SensorRange, options: RasterOptions, centre: float, direction: float
) -> list[Pass]:
    """One strip; deeper surfaces get passes of their own."""
    half = _half_line(sensor_range, options.standoff)
    strip = (turned.normals[:, 2] > MIN_COSINE) & (np.abs(turned.points[:, 1] - centre) <= half)
    window = np.abs(turned.extremes[:, 1] - centre) <= half
    if not strip.any():
        return []
    height = float(turned.extremes[window, 2].max() if window.any() else turned.points[strip, 2].max())
    looking_down = np.diag([1.0, -1.0, -1.0])
    views: list[Pass] = []
    for _ in range(_MAX_LEVELS):
        z = height + options.standoff
        here = strip & (turned.points[:, 2] <= height + 1e-6)
        reached = here & (turned.points[:, 2] >= z - sensor_range.far)
        if reached.mean() > _WORTH or not views:
            x = turned.points[reached if reached.any() else here, 0]
            start = pose.from_rotation(looking_down, (x.min() - _EDGE, centre, z))
            end = pose.from_rotation(looking_down, (x.max() + _EDGE, centre, z))
            views.append(Pass(f"pass at y = {1e3 * centre:.0f} mm, height {1e3 * z:.0f} mm", start, end, direction))
        strip = here & ~reached
        if strip.mean() < _WORTH:
            break
        height = float(turned.points[strip, 2].max())
    return views


def fit_budget(views: Sequence[Sweep | Pass], angle_step: float, pitch: float, max_profiles: int) -> list[int]:
    """Exposures of each view: as dense as asked for, or thinned alike so that the sum keeps to `max_profiles`.

    A view needs at least two; `PlanningError` when even that is too many.
    """

    def counts(factor: float) -> list[int]:
        wanted = [2 * np.pi / angle_step if isinstance(v, Sweep) else v.length / pitch + 1 for v in views]
        return [max(2, int(np.ceil(w / factor - 1e-9))) for w in wanted]

    if 2 * len(views) > max_profiles:
        raise PlanningError(f"{len(views)} views need two exposures each; max_profiles = {max_profiles} is too few")
    factor = max(1.0, sum(counts(1.0)) / max_profiles)
    while sum(counts(factor)) > max_profiles:
        factor *= 1.005
    return counts(factor)
