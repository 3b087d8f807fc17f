"""Planning of a complete scan: from the part in the cell to a collision-free program."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from scancell.arrays import Flags
from scancell.config.description import si_value
from scancell.config.scan import BeltDescription, ScanDescription
from scancell.errors import DescriptionError, PlanningError
from scancell.nominal.parts import pose_matrix
from scancell.planning.model import PlanningCell, WorkLimitError, join_reasons
from scancell.planning.motion.assembly import Assembly, check_part, verified
from scancell.planning.motion.connection import Stands
from scancell.planning.options import ScanOptions
from scancell.planning.path_map.configuration_map import QualityFactor
from scancell.planning.path_map.path_planner import PathPlanner, PlacedPath
from scancell.planning.plan import Plan
from scancell.planning.views import paths
from scancell.planning.views.coverage import CHOICE_SHARE, Candidate, CoveragePlanner, Sight
from scancell.planning.views.placement import (
    Infeasible,
    Placed,
    PlacedPass,
    PlacedPose,
    PlacedSweep,
    belt_run,
    range_warnings,
    sensor_over_belt,
    spacing_and_count,
)
from scancell.planning.views.views import Surface, Sweep, exposure_counts, sample_part, seen_by

if TYPE_CHECKING:
    from scancell.planning.views.sensor_paths import SensorPath

_TABLE_ANGLES = 24  # in a turn, at which the table may rest while another axis moves along a path
_GRID = 7  # positions of an axis that moves together with the table, from which the search starts

# Replacements of an infeasible sweep: changes of elevation (rad) and of distance (m).
_ALTERNATIVES = ((0.0, 0.015), (0.0, 0.03), *((np.radians(k), 0.0) for k in (15, 30, 45)))


def default_views(
    cell: PlanningCell, options: ScanOptions, part: Surface, stands: Stands, max_profiles: int, is_needed: bool
) -> tuple[list[tuple[Placed, int]], Flags, list[str]]:
    """Placed views with their numbers of exposures, the samples that they see, and warnings.

    The warnings name views that were omitted or replaced. What is seen (n,) ignores occlusion.

    Raises `PlanningError` if infeasible views lose more of the surface than `scan.max_lost_share`, or there are too few
    exposures.

    Parameters
    ----------
    max_profiles
        Largest number of exposures.
    is_needed
        Whether it is an error if no view sees the part.
    """
    scan, elevations = options.scan, np.radians(options.scan.sweep.elevations_deg).tolist()
    turns = paths.sweeps(part, cell.range, options, elevations) if scan.sweep.enabled else []
    lines = paths.passes(part, cell.range, options) if scan.raster.enabled else []
    if is_needed and not (turns or lines):
        raise PlanningError("no view sees the part: no surface faces the sensor")
    cell.work.spend(0.0)
    if scan.sweep.enabled:
        seen = seen_by([*turns, *lines], cell.range, part)
        turns += paths.side_sweeps(part, cell.range, options, elevations, seen, cell.work)
    warnings: list[str] = []
    sweeps = _reach_sweeps(stands, turns, warnings)
    counts = exposure_counts([*(s.view for s in sweeps), *lines], options.spacing, max_profiles)
    placed: list[tuple[Placed, int]] = [*zip(sweeps, counts, strict=False)]
    branch = sweeps[0].branch if sweeps and cell.nominal.arm.has_named_branches else None
    left = counts[len(sweeps) :]
    found = stands.passes(lines, left, si_value(scan.raster, "speed_mm_s"), branch)
    for item, count in zip(found, left, strict=True):
        if isinstance(item, Infeasible):
            warnings.append(f"omitted: {item.reason}")
        else:
            placed.append((item, count))
            warnings += [item.note] if item.note else []
    wanted = seen_by([*turns, *lines], cell.range, part)
    seen = seen_by([item.view for item, _ in placed], cell.range, part)
    _check_loss(wanted, seen, scan.max_lost_share, warnings)
    return placed, seen, warnings


def _reach_sweeps(stands: Stands, views: list[Sweep], warnings: list[str]) -> list[PlacedSweep]:
    """Place sweeps; an infeasible one is replaced by one from farther or higher, else omitted, with a warning."""
    result: list[PlacedSweep] = []
    for view, item in zip(views, stands.sweeps(views), strict=True):
        if not isinstance(item, Infeasible):
            result.append(item)
            continue
        others = [view.moved(*change) for change in _ALTERNATIVES]
        tried = (stands.sweeps([other])[0] for other in others if other.elevation <= np.radians(85))
        replacement = next((other for other in tried if not isinstance(other, Infeasible)), None)
        if replacement is None:
            warnings.append(f"omitted: {item.reason}")
        else:
            warnings.append(
                f"{item.reason}; replaced by the sweep {replacement.view.name.removeprefix(f'{view.name}, ')}"
            )
            result.append(replacement)
    return result


def _check_loss(wanted: Flags, seen: Flags, most: float, warnings: list[str]) -> None:
    """`PlanningError` when more than the share `most` of the samples (n,) that wanted views see is not `seen`."""
    lost = float((wanted & ~seen).mean() / max(wanted.mean(), 1e-12))
    if lost > most:
        title = (
            f"{100 * lost:.0f} % of the surface seen by the requested views is out of reach;"
            f" scan.max_lost_share = {most:g} allows {100 * most:.0f} %"
        )
        raise PlanningError(join_reasons(title, warnings))


def plan(
    cell: PlanningCell,
    options: ScanOptions,
    sight: Sight | None = None,
    quality_factors: Sequence[QualityFactor] = (),
    candidates: Sequence[Candidate] = (),
) -> Plan:
    """Plan a scan.

    `sight` judges coverage-driven views, which need it, and are chosen from `candidates` if there are any;
    `quality_factors` are further constraints of motions along sensor paths.

    Raises `PlanningError` if the part does not fit on the table or poses are infeasible, naming them with the distance
    out of reach, the angle outside the joint limits, or the bodies that collide.
    """
    check_part(cell)
    stands = Stands(cell, options)
    assembly = Assembly(cell, options, stands)
    if options.scan.belt is not None:
        warnings = _plan_belt(cell, options.scan, options.scan.belt, stands, assembly)
        return verified(cell, options, Plan(*assembly.finish(), None, tuple(warnings), reduced=_reductions(cell)))
    if options.scan.pose:
        _plan_poses(cell, options.scan, stands, assembly)
        parts = assembly.finish()
        return verified(cell, options, Plan(*parts, None, tuple(stands.warnings), reduced=_reductions(cell)))
    along = _place_paths(stands, options, quality_factors)
    left = options.scan.max_profiles - sum(len(item.exposures) for item in along)
    part, report = sample_part(cell.nominal.part, cell.nominal.table_from_part), None
    warnings = []
    if options.scan.coverage.enabled:
        assert sight is not None
        views, report = CoveragePlanner(stands, sight, options, candidates).choose(part, left)
        if cell.work.spent > CHOICE_SHARE * cell.work.limit:
            warnings.append(
                f"views were chosen until {100 * CHOICE_SHARE:.0f} % of scan.max_planning_work ="
                f" {cell.work.limit:g} was used: they see {100 * report.share:.1f} % of the measurable surface"
            )
        warnings += [f"goal not met: {one.limit}" for one in report.features if one.limit]
        seen = seen_by([placed.view for placed, _ in views], cell.range, part)
    else:
        cell.work.doing = "placing sweeps and passes"
        views, seen, warnings = default_views(cell, options, part, stands, left, is_needed=not along)
    warnings += [item.note for item in along if item.note] + stands.warnings
    omitted = _assemble(assembly, views, in_order=report is None)
    if not along:
        omitted += assembly.go_home()
    kept = [item for item, _ in views if not any(item is lost for lost, _ in omitted)]
    warnings += [f"omitted: {reason}" for _, reason in omitted]
    if not kept and not along:
        raise PlanningError(join_reasons("no view of the part can be taken", warnings))
    if omitted:
        seen = seen_by([item.view for item in kept], cell.range, part)
    for item in along:
        assembly.add_motion(item)
    seen |= seen_by([item.view for item in along], cell.range, part)
    coverage = float(seen.mean())
    mapped = tuple(item for item in along if isinstance(item, PlacedPath))
    plan_ = Plan(*assembly.finish(), coverage, tuple(warnings), mapped, report, _reductions(cell))
    return verified(cell, options, plan_)


def _reductions(cell: PlanningCell) -> tuple[str, ...]:
    found = cell.reduced_meshes.items()
    return tuple(one.line(name) for name, one in found if one.original_faces > len(one.mesh.faces))


def _plan_poses(cell: PlanningCell, scan: ScanDescription, stands: Stands, assembly: Assembly) -> None:
    poses = np.array([pose_matrix(pose) for pose in scan.pose])
    if len(poses) > scan.max_profiles:
        raise PlanningError(
            f"{len(poses)} poses are given",
            key="scan.max_profiles",
            value=scan.max_profiles,
            expected=f"at least {len(poses)}",
        )
    cell.work.doing = f"placing {len(poses)} poses"
    found = stands.poses(poses)
    reasons = [item.reason for item in found if isinstance(item, Infeasible)]
    if reasons:
        raise PlanningError(join_reasons("infeasible poses", reasons))
    for item in found:
        if not isinstance(item, Infeasible):
            assembly.add_pose(item)


def _plan_belt(
    cell: PlanningCell, scan: ScanDescription, belt: BeltDescription, stands: Stands, assembly: Assembly
) -> list[str]:
    """Add the scan on the belt; returns warnings."""
    nominal = cell.nominal
    run = belt_run(nominal, belt, cell.cycle)
    if nominal.carries_sensor:
        world_from_sensor = nominal.required_belt().world_from_belt @ sensor_over_belt(nominal, belt)
        cell.work.doing = "placing the sensor over the belt"
        placed = stands.still("the pose over the belt", world_from_sensor)
    else:
        home = np.append(nominal.home, cell.table_start)
        placed = PlacedPose("the part on the belt", home, stands.candidates[0].positions)
    if isinstance(placed, Infeasible):
        raise PlanningError(placed.reason, key="scan.belt.pose")
    pitch, count, warnings = spacing_and_count(run, belt, scan.max_profiles)
    assembly.add_belt(placed, run, pitch, count)
    return [*warnings, *range_warnings(nominal, belt, cell.range), *stands.warnings]


def _place_paths(
    stands: Stands, options: ScanOptions, quality_factors: Sequence[QualityFactor]
) -> list[PlacedPath | PlacedPass]:
    """Motions for the sensor paths of the description; `PlanningError` with all reasons where one has none."""
    scan, cell = options.scan, stands.cell
    nominal = cell.nominal
    if not scan.path:
        return []
    # SciPy's splines take a while to import.
    from scancell.planning.views.sensor_paths import sensor_paths  # noqa: PLC0415

    found = [path for item in scan.path for path in sensor_paths(item, nominal.part, nominal.table_from_part)]
    needed = sum(path.count for path in found)
    if needed > scan.max_profiles:
        raise PlanningError(
            f"the paths need {needed} exposures",
            key="scan.max_profiles",
            value=scan.max_profiles,
            expected="a larger pitch_mm of the paths or a larger scan.max_profiles",
        )
    placed: list[PlacedPath | PlacedPass] = []
    reasons: list[str] = []
    for number, path in enumerate(found, start=1):
        cell.work.doing = f"placing path {number} of {len(found)} ({path.name})"
        item = _placed_path(stands, options, quality_factors, path)
        if isinstance(item, str):
            reasons.append(item)
        else:
            placed.append(item)
    if reasons:
        raise PlanningError(join_reasons("infeasible paths", reasons))
    return placed


def _placed_path(
    stands: Stands, options: ScanOptions, quality_factors: Sequence[QualityFactor], path: SensorPath
) -> PlacedPath | PlacedPass | str:
    """A path at the first stand where it has a motion; or why it has none where the axes start.

    Where another axis than the table moves along it, the stands that differ by it alone count as one. Two axes take the
    stand of the least cost. A part that the arm holds, or on a fixed table, leaves no axis to choose: its paths are
    placed as passes.
    """
    nominal = stands.cell.nominal
    if nominal.holds_part or (not nominal.table_turns and path.axis == ("table",)):
        if path.axis != ("table",):
            raise DescriptionError(
                "the arm alone moves a part that it holds", key="path.axis", value=list(path.axis), expected="table"
            )
        (item,) = stands.passes([path], [path.count], path.speed, None)
        return item.reason if isinstance(item, Infeasible) else item
    if path.axis != ("table",):
        return _path_by_axes(stands, options, quality_factors, path)
    reason = ""
    for stand in stands.candidates:
        placed = PathPlanner(stand.cell, options.clearance, quality_factors).place(path)
        if isinstance(placed, PlacedPath):
            return replace(placed, further=stand.positions)
        reason = reason or placed
    return reason


def _path_by_axes(
    stands: Stands, options: ScanOptions, quality_factors: Sequence[QualityFactor], path: SensorPath
) -> PlacedPath | str:
    cell, further = stands.cell, [axis.name for axis in stands.cell.nominal.further_axes]
    axis = next(name for name in path.axis if name != "table")
    if axis not in further:
        raise DescriptionError(key="path.axis", value=list(path.axis), expected=", ".join(["table", *further]))
    number, start = 1 + further.index(axis), cell.table_start
    rows = np.array([[start, *stand.positions] for stand in stands.candidates])
    planner = PathPlanner(cell, options.clearance, quality_factors)
    if len(path.axis) == 1:
        rows[:, number] = rows[0, number]
        turned = [row for row in np.unique(rows, axis=0) for _ in range(_TABLE_ANGLES)]
        angles = np.tile(start + 2 * np.pi / _TABLE_ANGLES * np.arange(_TABLE_ANGLES), len(turned) // _TABLE_ANGLES)
        return planner.place_along(path, axis, [np.array([a, *row[1:]]) for a, row in zip(angles, turned, strict=True)])
    if len(np.unique(rows[:, number])) == 1:
        one = cell.nominal.further_axes[number - 1]
        grid = np.unique([*np.linspace(one.min, one.max, _GRID), one.start])
        rows = np.repeat(rows, len(grid), axis=0)
        rows[:, number] = np.tile(grid, len(rows) // len(grid))
    return planner.place_by_two(path, axis, list(rows))


def _assemble(assembly: Assembly, views: list[tuple[Placed, int]], in_order: bool) -> list[tuple[Placed, str]]:
    """Append views with their numbers of exposures: in order, or each time the one that is nearest in time.

    Those at one stand follow each other. Returns those to which no free path is found, with the reason.
    """
    stands = list(dict.fromkeys(placed.further for placed, _ in views))
    left, omitted = sorted(views, key=lambda view: stands.index(view[0].further)), []
    while left:
        times = [] if in_order else [assembly.time_to(placed.ends[0], placed.further) for placed, _ in left]
        nearest = 0 if in_order else int(np.argmin(times))
        placed, count = left.pop(nearest)
        try:
            assembly.add_view(placed, count)
        except WorkLimitError:
            raise
        except PlanningError as error:
            omitted.append((placed, str(error)))
    return omitted
