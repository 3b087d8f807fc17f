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
Flags = NDArray[np.bool_]

_EDGE = 1e-3  # the ends of the laser line and of a pass reach this far beyond what they must cover
_WORTH = 0.002  # share of the surface that a deeper level must add
_MAX_LEVELS = 4
_SIDE_OFFSETS = (0.3, 0.6, 0.85)  # of the part's radius
_MAX_SIDE_SWEEPS = 4
_WORTH_A_TURN = 0.01  # share of the surface that a side sweep must add


@dataclass(frozen=True)
class Sweep:
    """A full turn of the table under a standing sensor.

    `at_azimuth_zero` (4, 4) is ``table_from_sensor`` looking along -x at `target` (3,), the laser sheet upright;
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

    def moved(self, raised: float, farther: float) -> Sweep:
        """The same line of the part seen from `raised` radians higher and `farther` metres off."""
        distance = float(np.linalg.norm(self.at_azimuth_zero[:3, 3] - self.target)) + farther
        elevation = self.elevation + raised
        how = f"from {1e3 * farther:.0f} mm farther" if farther else f"raised to {np.degrees(elevation):.0f} deg"
        return Sweep(f"{self.name}, {how}", sweep_pose(self.target, elevation, distance), self.target, elevation)


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
    """``table_from_sensor`` at azimuth 0 that looks at `target` (3,) from `distance` (m), sheet upright."""
    c, s = np.cos(elevation), np.sin(elevation)
    rotation = np.array([[0.0, -s, -c], [-1.0, 0.0, 0.0], [0.0, c, -s]])
    return pose.from_rotation(rotation, target + distance * np.array([c, 0.0, s]))


def sweeps(part: Surface, sensor_range: SensorRange, options: SweepOptions) -> list[Sweep]:
    """Turns that cover what faces the sensor at each elevation."""
    nothing = np.zeros(len(part.points), bool)
    return [view for e in options.elevations for view in _sweeps_at(part, sensor_range, options, e, 0.0, nothing)]


def side_sweeps(part: Surface, sensor_range: SensorRange, options: SweepOptions, seen: Flags) -> list[Sweep]:
    """Further turns, the sheet beside the axis, for what the others do not see (n,): walls that point at the axis.

    A sheet through the axis only grazes them. The candidate that adds most is taken first, until none adds enough.
    """
    radius = float(np.hypot(part.extremes[:, 0], part.extremes[:, 1]).max())
    offsets = [sign * share * radius for share in _SIDE_OFFSETS for sign in (1, -1)]
    candidates = [
        view
        for e in options.elevations
        for y in offsets
        for view in _sweeps_at(part, sensor_range, options, e, y, seen)
    ]
    sees = np.array(
        [surface.best_cosine_of_sweep(sensor_range, v.at_azimuth_zero, part) > MIN_COSINE for v in candidates]
    )
    chosen: list[Sweep] = []
    while candidates and len(chosen) < _MAX_SIDE_SWEEPS:
        gain = (sees & ~seen).mean(1)
        best = int(np.argmax(gain))
        if gain[best] < _WORTH_A_TURN:
            break
        chosen.append(candidates[best])
        seen = seen | sees[best]
    return chosen


def _sweeps_at(
    part: Surface, sensor_range: SensorRange, options: SweepOptions, elevation: float, offset: float, done: Flags
) -> list[Sweep]:
    """Turns at one elevation with the sheet at y = `offset`, for all that is not `done` (n,)."""
    up, depth, facing = _in_sheet(part, elevation, offset)
    wanted = facing & ~done
    if wanted.mean() < _WORTH:
        return []
    solid = np.concatenate(list(surface.crossings(part.extremes, offset) @ part.extremes[..., None]))[..., 0]
    solid_up, solid_depth = _line_and_view(solid[np.isfinite(solid[:, 0])], elevation)
    half = _half_line(sensor_range, options.standoff)
    views: list[Sweep] = []
    covered = ~wanted
    for centre in tile(float(up[wanted].min()), float(up[wanted].max()), half, options.height_step):
        own = np.abs(up - centre) <= half
        near = float(solid_depth[np.abs(solid_up - centre) <= half].min(initial=np.inf))
        for _ in range(_MAX_LEVELS):
            left = ~covered & own & (depth >= near - _EDGE)
            if left.mean() < _WORTH:
                break
            view = _sweep(centre, near, elevation, offset, options.standoff)
            seen = surface.best_cosine_of_sweep(sensor_range, view.at_azimuth_zero, part) > MIN_COSINE
            if (seen & ~covered).mean() > _WORTH:
                views.append(view)
                covered |= seen
                left &= ~seen
            # What is left lies beyond the range: go nearer, by a fifth of the depth of field at the least.
            beyond = depth[left & (depth > near)]
            step = 0.2 * (sensor_range.far - options.standoff)
            near = max(float(np.quantile(beyond, 0.01)), near + step) if len(beyond) else np.inf
    return views


def _sweep(up: float, depth: float, elevation: float, offset: float, standoff: float) -> Sweep:
    c, s = np.cos(elevation), np.sin(elevation)
    target = np.array([-s * up - c * depth, offset, c * up - s * depth])
    beside = f", {1e3 * offset:.0f} mm beside the axis" if offset else ""
    where = f"radius {1e3 * target[0]:.0f} mm height {1e3 * target[2]:.0f} mm"
    name = f"sweep at {np.degrees(elevation):.0f} deg{beside}, line centre at {where}"
    return Sweep(name, sweep_pose(target, elevation, standoff), target, elevation)


def _line_and_view(points: Array, elevation: float) -> tuple[Array, Array]:
    """Coordinates (...,) of points (..., 3) along the laser line and along the view, sensor at azimuth 0."""
    c, s = np.cos(elevation), np.sin(elevation)
    return -s * points[..., 0] + c * points[..., 2], -c * points[..., 0] - s * points[..., 2]


def _in_sheet(part: Surface, elevation: float, offset: float) -> tuple[Array, Array, Flags]:
    """Line and view coordinates (n,) of each point where it best crosses the sheet, and whether it faces the sensor."""
    turn = surface.crossings(part.points, offset)
    points = (turn @ part.points[..., None])[..., 0]
    normals = (turn @ part.normals[..., None])[..., 0]
    # NaN, a point that never crosses, compares as not facing.
    facing = normals @ np.array([np.cos(elevation), 0.0, np.sin(elevation)]) > MIN_COSINE
    # A point seen on the sensor's side of the axis need not be seen again beyond it.
    side = np.where(facing[0], 0, 1)
    up, depth = (np.take_along_axis(x, side[None], 0)[0] for x in _line_and_view(points, elevation))
    return up, depth, np.asarray(facing.any(0))


def tile(low: float, high: float, half: float, step: float) -> Array:
    """Centres of lines of half-width `half` that cover [low, high], at most `step` apart, evenly spread."""
    span = high - low
    if span <= 2 * half:
        return np.array([(low + high) / 2])
    count = int(np.ceil((span - 2 * half) / min(step, 2 * half) - 1e-9)) + 1
    return np.linspace(low + half, high - half, count)


def _half_line(sensor_range: SensorRange, standoff: float) -> float:
    return float(sensor_range.half_line(standoff)) - _EDGE


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
    # Whatever stands up in the strip decides the height, also where it does not face up itself.
    height = float(turned.extremes[window, 2].max(initial=turned.points[strip, 2].max()))
    looking_down = np.diag([1.0, -1.0, -1.0])
    views: list[Pass] = []
    for _ in range(_MAX_LEVELS):
        z = height + options.standoff
        reached = strip & (turned.points[:, 2] >= z - sensor_range.far)
        if reached.mean() > _WORTH or (reached.any() and not views):
            x = turned.points[reached, 0]
            start = pose.from_rotation(looking_down, (x.min() - _EDGE, centre, z))
            end = pose.from_rotation(looking_down, (x.max() + _EDGE, centre, z))
            views.append(Pass(f"pass at y = {1e3 * centre:.0f} mm, height {1e3 * z:.0f} mm", start, end, direction))
        strip = strip & ~reached
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
