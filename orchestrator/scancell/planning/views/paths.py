"""Scan paths from the part's surface: table sweeps at several elevations and heights, and straight passes over the top.

All poses are in the frame of the table at angle 0 (origin on the top face, z along the axis). `placement` chooses the
azimuth and the joints of the arm.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np

from scancell.arrays import Array, Flags
from scancell.config.description import si_value
from scancell.errors import PlanningError
from scancell.geometry import pose
from scancell.planning.model import SensorRange, Work
from scancell.planning.options import ScanOptions
from scancell.planning.views.views import MIN_COSINE, Pass, Surface, Sweep, crossing_angles, seen_by, sweep_pose

_END_MARGIN = 1e-3  # m by which the laser line and a pass extend beyond the surface to cover
_MAX_LINES = 2000  # beside one another at one elevation
_MIN_LEVEL_GAIN = 0.002  # fraction of the surface that a further depth level must add
_MAX_LEVELS = 4
_SIDE_OFFSETS = (0.3, 0.6, 0.85)  # of the part's radius
_MAX_SIDE_SWEEPS = 4
_MIN_SWEEP_GAIN = 0.01  # fraction of the surface that a side sweep must add


def sweeps(part: Surface, sensor_range: SensorRange, options: ScanOptions, elevations: Sequence[float]) -> list[Sweep]:
    """Sweeps through the table's axis that cover the surface facing the sensor at each elevation, rad."""
    nothing = np.zeros(len(part.points), bool)
    return [view for e in elevations for view in _sweeps_at(part, sensor_range, options, e, 0.0, nothing)]


def side_sweeps(
    part: Surface,
    sensor_range: SensorRange,
    options: ScanOptions,
    elevations: Sequence[float],
    seen: Flags,
    work: Work,
) -> list[Sweep]:
    """Sweeps with the laser sheet offset from the axis, for samples not yet `seen` (n,), such as radial walls.

    A sheet through the axis meets radial walls at grazing incidence. Greedy choice by added surface, at most
    `_MAX_SIDE_SWEEPS`, until the best candidate adds less than `_MIN_SWEEP_GAIN`. `work` may cancel at each candidate.
    """
    candidates = sweeps_beside_axis(part, sensor_range, options, elevations, seen, work)
    sees = np.zeros((len(candidates), len(seen)), bool)
    for i, view in enumerate(candidates):
        work.spend(0.0)
        sees[i] = seen_by([view], sensor_range, part)
    chosen: list[Sweep] = []
    while candidates and len(chosen) < _MAX_SIDE_SWEEPS:
        gain = (sees & ~seen).mean(1)
        best = int(np.argmax(gain))
        if gain[best] < _MIN_SWEEP_GAIN:
            break
        chosen.append(candidates[best])
        seen = seen | sees[best]
    return chosen


def sweeps_beside_axis(
    part: Surface,
    sensor_range: SensorRange,
    options: ScanOptions,
    elevations: Sequence[float],
    seen: Flags,
    work: Work,
) -> list[Sweep]:
    """Sweeps with the laser sheet at several offsets from the axis, for samples not yet `seen` (n,)."""
    views: list[Sweep] = []
    radius = float(np.hypot(part.extremes[:, 0], part.extremes[:, 1]).max())
    offsets = [sign * share * radius for share in _SIDE_OFFSETS for sign in (1, -1)]
    for elevation, offset in product(elevations, offsets):
        work.spend(0.0)
        views += _sweeps_at(part, sensor_range, options, elevation, offset, seen)
    return views


def _sweeps_at(
    part: Surface, sensor_range: SensorRange, options: ScanOptions, elevation: float, offset: float, done: Flags
) -> list[Sweep]:
    """Sweeps at one elevation with the sheet at y = `offset`, for samples that are not `done` (n,)."""
    up, depth, facing = _in_sheet(part, elevation, offset)
    wanted = facing & ~done
    if wanted.mean() < _MIN_LEVEL_GAIN:
        return []
    turns = pose.rotation_about(2, crossing_angles(part.extremes, offset))
    solid = (turns @ part.extremes[..., None]).reshape(-1, 3)
    solid_up, solid_depth = _line_and_view(solid[np.isfinite(solid[:, 0])], elevation)
    half = _half_line(sensor_range, options.standoff)
    views: list[Sweep] = []
    covered = ~wanted
    for centre in tile(
        float(up[wanted].min()), float(up[wanted].max()), half, si_value(options.scan.sweep, "height_step_mm")
    ):
        own = np.abs(up - centre) <= half
        near = float(solid_depth[np.abs(solid_up - centre) <= half].min(initial=np.inf))
        for _ in range(_MAX_LEVELS):
            left = ~covered & own & (depth >= near - _END_MARGIN)
            if left.mean() < _MIN_LEVEL_GAIN:
                break
            view = _sweep(centre, near, elevation, offset, options.standoff)
            seen = seen_by([view], sensor_range, part)
            if (seen & ~covered).mean() > _MIN_LEVEL_GAIN:
                views.append(view)
                covered |= seen
                left &= ~seen
            # The rest lies beyond the measuring range: move closer, by a fifth of the depth of field at least.
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
    """Coordinates (...,) of points (..., 3) along the laser line and along the viewing direction at azimuth 0."""
    c, s = np.cos(elevation), np.sin(elevation)
    return -s * points[..., 0] + c * points[..., 2], -c * points[..., 0] - s * points[..., 2]


def _in_sheet(part: Surface, elevation: float, offset: float) -> tuple[Array, Array, Flags]:
    """Line and view coordinates (n,) of each point where it crosses the sheet, and whether it faces the sensor."""
    turn = pose.rotation_about(2, crossing_angles(part.points, offset))
    points = (turn @ part.points[..., None])[..., 0]
    normals = (turn @ part.normals[..., None])[..., 0]
    # NaN (never crosses the sheet) compares as not facing.
    facing = normals @ np.array([np.cos(elevation), 0.0, np.sin(elevation)]) > MIN_COSINE
    # A point that faces the sensor at its crossing on the near side uses that one.
    side = np.where(facing[0], 0, 1)
    up, depth = (np.take_along_axis(x, side[None], 0)[0] for x in _line_and_view(points, elevation))
    return up, depth, np.asarray(facing.any(0))


def tile(low: float, high: float, half: float, step: float) -> Array:
    """Centres (n,) of equally spaced lines of half-width `half` that cover [low, high], spacing at most `step`.

    Raises `PlanningError` if they are too many.
    """
    span = high - low
    if span <= 2 * half:
        return np.array([(low + high) / 2])
    needed = (span - 2 * half) / min(step, 2 * half)
    if not needed < _MAX_LINES:
        raise PlanningError(
            f"{1e3 * span:.0f} mm need {needed:.3g} laser lines {1e3 * min(step, 2 * half):.3g} mm apart",
            expected=f"at most {_MAX_LINES}; raise scan.sweep.height_step_mm, or change scan.sweep.standoff_mm",
        )
    return np.linspace(low + half, high - half, int(np.ceil(needed - 1e-9)) + 1)


def _half_line(sensor_range: SensorRange, standoff: float) -> float:
    half = float(sensor_range.half_line(standoff)) - _END_MARGIN
    if not half > 0.0:
        raise PlanningError(
            f"the laser line is {2e3 * max(half + _END_MARGIN, 0.0):.3g} mm long at this distance",
            key="scan.sweep.standoff_mm",
            value=round(1e3 * standoff, 6),
            expected=f"a distance at which more than {2e3 * _END_MARGIN:g} mm of it are seen; the measuring range is"
            f" {1e3 * sensor_range.near:g} to {1e3 * sensor_range.far:g} mm",
        )
    return half


def passes(part: Surface, sensor_range: SensorRange, options: ScanOptions) -> list[Pass]:
    """Passes over the surface that faces up, in the direction of shortest total travel (15 degree steps)."""
    up = part.normals[:, 2] > MIN_COSINE
    if not up.any():
        return []
    half = _half_line(sensor_range, options.standoff)
    step = max(2 * half - si_value(options.scan.raster, "overlap_mm"), half)

    def travel(direction: float) -> float:
        span = np.ptp(part.turned(-direction).points[up], axis=0)
        return float(len(tile(0.0, span[1], half, step)) * (span[0] + 0.02))

    direction = float(min(np.radians(np.arange(0, 180, 15)), key=travel))
    turned, back = part.turned(-direction), pose.from_rotation(pose.rotation_about(2, direction))
    y = turned.points[up, 1]
    result: list[Pass] = []
    for centre in tile(float(y.min()), float(y.max()), half, step):
        result += _passes_along(turned, sensor_range, options, float(centre))
    # Boustrophedon: the direction of travel alternates.
    ends = ((p.name, back @ p.start, back @ p.end) for p in result)
    return [Pass(name, *((a, b) if i % 2 == 0 else (b, a))) for i, (name, a, b) in enumerate(ends)]


def _passes_along(turned: Surface, sensor_range: SensorRange, options: ScanOptions, centre: float) -> list[Pass]:
    """Passes over one strip along x, one per depth level."""
    half = _half_line(sensor_range, options.standoff)
    strip = (turned.normals[:, 2] > MIN_COSINE) & (np.abs(turned.points[:, 1] - centre) <= half)
    window = np.abs(turned.extremes[:, 1] - centre) <= half
    if not strip.any():
        return []
    # The highest point in the strip decides, whether it faces up or not.
    height = float(turned.extremes[window, 2].max(initial=turned.points[strip, 2].max()))
    looking_down = np.diag([1.0, -1.0, -1.0])
    views: list[Pass] = []
    for _ in range(_MAX_LEVELS):
        z = height + options.standoff
        reached = strip & (turned.points[:, 2] >= z - sensor_range.far)
        if reached.mean() > _MIN_LEVEL_GAIN or (reached.any() and not views):
            x = turned.points[reached, 0]
            start = pose.from_rotation(looking_down, (x.min() - _END_MARGIN, centre, z))
            end = pose.from_rotation(looking_down, (x.max() + _END_MARGIN, centre, z))
            views.append(Pass(f"pass at y = {1e3 * centre:.0f} mm, height {1e3 * z:.0f} mm", start, end))
        strip = strip & ~reached
        if strip.mean() < _MIN_LEVEL_GAIN:
            break
        height = float(turned.points[strip, 2].max())
    return views
