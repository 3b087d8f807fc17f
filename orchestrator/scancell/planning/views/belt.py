"""Scan of a part that a belt carries through the laser sheet of the sensor at rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from scancell.arrays import Array
from scancell.cell.program import BeltRun
from scancell.config.description import si_value
from scancell.config.scan import BeltDescription
from scancell.errors import PlanningError
from scancell.geometry import pose
from scancell.geometry.mesh import box_mesh
from scancell.nominal.cell import NominalCell
from scancell.nominal.parts import pose_matrix
from scancell.planning.model import SensorRange

_MARGIN = 5e-3  # m of travel before and after the part that is scanned, too
_LEAST_CROSSING = 0.2  # component along the belt of the unit normal of the laser sheet


def crossings(nominal: NominalCell, belt_from_sensor: Array) -> Array:
    """Travel (n,) of the belt, m, at which each vertex of the part lies in the laser sheet, the plane x = 0 of the
    sensor.

    Raises `PlanningError` if the sheet is nearly parallel to the travel.
    """
    normal, origin = belt_from_sensor[:3, 0], belt_from_sensor[:3, 3]
    if abs(normal[0]) < _LEAST_CROSSING:
        angle = np.degrees(np.arcsin(abs(normal[0])))
        raise PlanningError(
            f"the laser sheet is {angle:.1f} deg from the direction of travel",
            key="scan.belt.pose",
            expected=f"at least {np.degrees(np.arcsin(_LEAST_CROSSING)):.1f} deg: the sheet across the belt",
        )
    return np.asarray((origin - _vertices(nominal)) @ normal / normal[0])


def _vertices(nominal: NominalCell) -> Array:
    """Positions (n, 3) of the vertices of the part's faces in the frame of the belt at travel 0, m."""
    used = nominal.part.vertices[np.unique(nominal.part.faces)]
    return pose.transform_points(nominal.required_belt().belt_from_part, used)


def belt_run(nominal: NominalCell, scan: BeltDescription, cycle: float) -> BeltRun:
    """Travel of the belt that brings the whole part through the laser sheet; `cycle` is the controller's, s.

    Raises `PlanningError` if the belt cannot run so fast, or the part is beyond the sensor or leaves the belt.
    """
    belt, speed = nominal.required_belt(), si_value(scan, "speed_mm_s")
    highest, length = si_value(belt.description, "max_speed_mm_s"), si_value(belt.description, "length_mm")
    if abs(speed) > highest:
        raise PlanningError(
            key="scan.belt.speed_mm_s", value=1e3 * speed, expected=f"at most {1e3 * highest:g}, its conveyor's"
        )
    direction = np.copysign(1.0, speed)
    travel = direction * crossings(nominal, pose_matrix(scan.pose))
    if travel.min() <= 0.0:
        raise PlanningError(
            f"the part starts {-1e3 * travel.min():.1f} mm beyond the laser sheet",
            key="scan.belt.pose",
            expected="a sensor that the part reaches later: move it along the belt, or reverse speed_mm_s",
        )
    last = travel.max() + _MARGIN
    x = pose.transform_points(belt.belt_from_part, nominal.part.vertices)[:, 0]
    reached = (x.min() + x.max()) / 2 + direction * (last + _stopping(nominal, scan, cycle, last))
    if abs(reached) > length / 2:
        raise PlanningError(
            f"the part leaves the belt: its centre stops {1e3 * abs(reached):.1f} mm from the middle, its end is at"
            f" {5e2 * length:g} mm",
            key="scan.belt.pose",
            expected="a sensor nearer to the start of the part, or a lower speed_mm_s",
        )
    # Exposures begin in the first controller cycle beyond `trigger_from`.
    first = max(0.0, travel.min() - _MARGIN - abs(speed) * cycle)
    return BeltRun(belt.conveyor, speed, direction * first, direction * last)


def _stopping(nominal: NominalCell, scan: BeltDescription, cycle: float, last: float) -> float:
    """Travel until the belt is at rest, m, after the last exposure at a travel of `last`, m."""
    acceleration = si_value(nominal.required_belt().description, "max_acceleration_mm_s2")
    speed = abs(si_value(scan, "speed_mm_s"))
    reached = min(speed, np.sqrt(2 * acceleration * last))  # from rest
    return float(2 * cycle * speed + reached**2 / (2 * acceleration))


def with_passing_part(nominal: NominalCell, scan: BeltDescription, cycle: float) -> NominalCell:
    """The cell for planning: in place of the part, the box that it sweeps on the belt until it is at rest again."""
    belt, run = nominal.required_belt(), belt_run(nominal, scan, cycle)
    points = pose.transform_points(belt.belt_from_part, nominal.part.vertices)
    ends = np.array(
        [0.0, run.trigger_to + np.copysign(_stopping(nominal, scan, cycle, abs(run.trigger_to)), run.speed)]
    )
    low, high = points.min(0), points.max(0)
    low[0] += ends.min()
    high[0] += ends.max()
    swept = box_mesh(high - low, nominal.part.source).transformed(
        belt.world_from_belt @ pose.translation((low + high) / 2)
    )
    bodies = [
        replace(body, moves_with="world", mesh=swept, patches=()) if body.moves_with == "part" else body
        for body in nominal.bodies
    ]
    return replace(nominal, bodies=tuple(bodies))


def spacing_and_count(run: BeltRun, scan: BeltDescription, max_profiles: int) -> tuple[float, int, list[str]]:
    """Travel between exposures (m) and their number, at most `max_profiles`, with a warning if it is larger."""
    length = abs(run.trigger_to - run.trigger_from)
    requested = si_value(scan, "pitch_mm")
    pitch = max(requested, length / max(1, max_profiles - 1))
    warnings = []
    if pitch > requested:
        warnings.append(
            f"scan.belt.pitch_mm is increased from {1e3 * requested:g} to {1e3 * pitch:.3f} to stay within "
            f"scan.max_profiles = {max_profiles}"
        )
    return pitch, int(length / pitch) + 1, warnings


def range_warnings(nominal: NominalCell, scan: BeltDescription, range_: SensorRange) -> list[str]:
    """Warning about the share of the part that passes outside the measuring range."""
    points, belt_from_sensor = _vertices(nominal), pose_matrix(scan.pose)
    points[:, 0] += crossings(nominal, belt_from_sensor)
    _, y, z = pose.transform_points(pose.inverse(belt_from_sensor), points).T
    outside = ~range_.contains(y, z)
    if not outside.any():
        return []
    return [f"{outside.mean():.0%} of the part's vertices pass outside the measuring range: move scan.belt.pose"]
