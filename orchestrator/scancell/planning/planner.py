"""Planning of a complete scan: from the part in the cell to a collision-free program."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scancell.cell.program import Program
from scancell.errors import PlanningError
from scancell.planning import paths, surface, trajectory
from scancell.planning.assembly import Assembly
from scancell.planning.configuration_map import Judge
from scancell.planning.model import PlanningCell
from scancell.planning.options import ScanOptions
from scancell.planning.path_planner import PathPlanner, PlacedPath
from scancell.planning.placement import Infeasible, PlacedPass, PlacedSweep, Placer
from scancell.planning.reasons import describe, join_reasons
from scancell.planning.surface import Surface
from scancell.planning.timing import axis_name
from scancell.planning.views import Spacing, Sweep, View, exposure_counts, seen_by
from scancell.proximity.judge import first_collision

Array = NDArray[np.float64]

# Largest fraction of the surface seen by all views that infeasible views may lose.
_MAX_LOSS = 0.2
# Replacements of an infeasible sweep: changes of elevation (rad) and of distance (m).
_ALTERNATIVES = ((0.0, 0.015), (0.0, 0.03), *((np.radians(k), 0.0) for k in (15, 30, 45)))
_SAME_PLACE = 1e-6  # rad
_DEFAULT_AZIMUTH = np.radians(105.0)  # preferred azimuth of single poses when the scan has no sweeps


@dataclass(frozen=True)
class Plan:
    """A program and its exposures.

    Attributes
    ----------
    program
        From home to home, checked for reach, joint limits and collisions.
    segment
        (m,) segment id of each exposure, in order of time.
    q, table
        (m, joints), (m,) planned joints and table angle of each exposure, rad.
    coverage
        Fraction of the part's surface that the views see, self-occlusion ignored; None for given poses.
    warnings
        Views that were omitted or replaced, and why.
    paths
        Sensor paths with the motions of the table that were found for them.
    source
        File that a saved plan was read from.
    """

    program: Program
    segment: NDArray[np.int64]
    q: Array
    table: Array
    coverage: float | None
    warnings: tuple[str, ...]
    paths: tuple[PlacedPath, ...] = ()
    source: str = ""


def plan(cell: PlanningCell, options: ScanOptions, judges: Sequence[Judge] = ()) -> Plan:
    """Plan a scan; `judges` are further constraints of motions along sensor paths.

    Raises
    ------
    PlanningError
        If the part does not fit on the table or poses are infeasible, naming them with the distance out of reach, the
        angle outside the joint limits, or the bodies that collide.
    """
    check_part(cell)
    azimuth = options.sweep.azimuth if options.sweep else _DEFAULT_AZIMUTH
    placer = Placer(cell, azimuth, options.clearance)
    assembly = Assembly(cell, options)
    if len(options.poses):
        _plan_poses(options, placer, assembly)
        return _verified(cell, options, Plan(*assembly.finish(), None, ()))
    placed = _place_paths(cell, options, judges)
    coverage, warnings = _plan_views(cell, options, placer, assembly, placed)
    warnings += [item.note for item in placed if item.note]
    for item in placed:
        assembly.add_path(item)
    return _verified(cell, options, Plan(*assembly.finish(), coverage, tuple(warnings), tuple(placed)))


def recheck(cell: PlanningCell, saved: Plan, options: ScanOptions) -> Plan:
    """A saved plan, after it was checked in this cell as a new one is: limits, clearances, python-fcl.

    Raises
    ------
    PlanningError
        If the plan is for another arm or controller, does not start at the home position, does not continue, exceeds a
        limit, or comes too close to something; with the segment.
    """
    check_part(cell)
    nominal, at = cell.nominal, np.append(cell.nominal.home, cell.table_start)
    motions = cell.motion_check(options.clearance)
    lower, upper = nominal.arm.limits
    for segment in saved.program.segments:
        where = f"{saved.source}: segment {segment.id} ({segment.name})"
        if segment.q.shape[1] != len(nominal.home):
            raise PlanningError(f"{where}: {segment.q.shape[1]} joints, the arm has {len(nominal.home)}")
        if np.abs(np.diff(segment.times, prepend=-cell.cycle) - cell.cycle).max() > 1e-9:
            raise PlanningError(
                f"{where}: expected a set-point every {1e3 * cell.cycle:g} ms from 0, the controller's cycle"
            )
        points = np.column_stack([segment.q, segment.table])
        gap = float(np.abs(points[0] - at).max())
        if gap > _SAME_PLACE:
            raise PlanningError(f"{where}: starts {np.degrees(gap):.3f} deg from where the motion before it ends")
        if (segment.q < lower - _SAME_PLACE).any() or (segment.q > upper + _SAME_PLACE).any():
            raise PlanningError(f"{where}: leaves the joint limits")
        resting = np.concatenate([*3 * [points[:1]], points, *3 * [points[-1:]]])
        used = trajectory.limit_fractions(resting, cell.axis_limits, cell.cycle)
        if used.max() > 1 + 1e-6:
            axis = axis_name(cell, int(np.argmax(used.max(0))))
            raise PlanningError(f"{where}: {axis} exceeds a limit by {100 * (used.max() - 1):.1f} %")
        deviation = np.abs(np.diff(points, n=2, axis=0)).max(0, initial=0.0) / 4
        clash = next((c for c in motions.first_clashes(points[:-1], points[1:], deviation) if c is not None), None)
        if clash is not None:
            raise PlanningError(f"{where}: {describe(clash)}")
        at = points[-1]
    return _verified(cell, options, saved)


def _verified(cell: PlanningCell, options: ScanOptions, made: Plan) -> Plan:
    """The plan, after python-fcl found no collision at every second set-point.

    Raises
    ------
    PlanningError
        Otherwise: a defect of scancell, whose own distances proved the motion free.
    """
    if not options.verify:
        return made
    segments = made.program.segments
    poses = cell.nominal.body_poses(
        np.concatenate([segment.q[::2] for segment in segments]),
        np.concatenate([segment.table[::2] for segment in segments]),
    )
    clash = first_collision(cell.proximity_meshes, cell.proximity.pairs, cell.proximity.names, poses)
    if clash is None:
        return made
    starts = np.cumsum([0, *(len(segment.times[::2]) for segment in segments)])
    number = int(np.searchsorted(starts, clash.index, side="right")) - 1
    segment, at = segments[number], 2 * int(clash.index - starts[number])
    place = f"segment {segment.id} ({segment.name}), {segment.times[at]:.3f} s after its start"
    raise PlanningError(f"python-fcl finds that {clash.body_a} hits {clash.body_b} in {place}")


def check_part(cell: PlanningCell) -> None:
    """Check that the part lies on the table and that nothing collides at the home position.

    Raises
    ------
    PlanningError
        Otherwise, with the distance by which the part protrudes or the bodies that collide.
    """
    nominal = cell.nominal
    used = nominal.part.vertices[np.unique(nominal.part.faces)]
    on_table = used @ nominal.table_from_part[:3, :3].T + nominal.table_from_part[:3, 3]
    radius = float(np.hypot(on_table[:, 0], on_table[:, 1]).max())
    if radius > nominal.table_radius + 1e-9:
        raise PlanningError(
            f"{nominal.part.source}: too large for the table: it extends to {1e3 * radius:.1f} mm from the axis, "
            f"{1e3 * (radius - nominal.table_radius):.1f} mm beyond the table's radius"
        )
    if on_table[:, 2].min() < -1e-6:
        raise PlanningError(
            f"{nominal.part.source}: its lowest point is {-1e3 * on_table[:, 2].min():.3f} mm below the table's top"
        )
    hit = cell.contacts(nominal.home[None], np.array([cell.table_start]))
    if hit:
        raise PlanningError(f"at the home position: {describe(hit[0])}")


def _plan_poses(options: ScanOptions, placer: Placer, assembly: Assembly) -> None:
    if len(options.poses) > options.max_profiles:
        raise PlanningError(f"{len(options.poses)} poses are given, max_profiles allows {options.max_profiles}")
    found = placer.poses(options.poses)
    reasons = [item.reason for item in found if isinstance(item, Infeasible)]
    if reasons:
        raise PlanningError(join_reasons("infeasible poses", reasons))
    for item in found:
        if not isinstance(item, Infeasible):
            assembly.add_pose(item)


def _place_paths(cell: PlanningCell, options: ScanOptions, judges: Sequence[Judge]) -> list[PlacedPath]:
    """Motions for the sensor paths of the description; `PlanningError` with all reasons where one has none."""
    if not options.paths:
        return []
    # SciPy's splines take a while to import.
    from scancell.planning.sensor_paths import sensor_paths  # noqa: PLC0415

    found = [
        path for item in options.paths for path in sensor_paths(item, cell.nominal.part, cell.nominal.table_from_part)
    ]
    planner = PathPlanner(cell, options.clearance, judges)
    placed = [planner.place(path) for path in found]
    reasons = [item for item in placed if isinstance(item, str)]
    if reasons:
        raise PlanningError(join_reasons("infeasible paths", reasons))
    return [item for item in placed if isinstance(item, PlacedPath)]


def _plan_views(
    cell: PlanningCell, options: ScanOptions, placer: Placer, assembly: Assembly, along: Sequence[PlacedPath]
) -> tuple[float, list[str]]:
    part = surface.sample(cell.nominal.part, cell.nominal.table_from_part)
    sweep_views = paths.sweeps(part, cell.range, options.sweep) if options.sweep else []
    pass_views = paths.passes(part, cell.range, options.raster) if options.raster else []
    if not (sweep_views or pass_views or along):
        raise PlanningError("no view sees the part: no surface faces the sensor")
    if options.sweep:
        seen = seen_by([*sweep_views, *pass_views], cell.range, part)
        sweep_views += paths.side_sweeps(part, cell.range, options.sweep, seen)
    warnings: list[str] = []
    sweeps = _reach_sweeps(placer, sweep_views, warnings)
    spacing = Spacing(
        options.sweep.angle_step if options.sweep else np.inf, options.raster.pitch if options.raster else np.inf
    )
    left = options.max_profiles - sum(len(item.exposures) for item in along)
    counts = exposure_counts([*(s.view for s in sweeps), *pass_views], spacing, left)
    passes: list[PlacedPass] = []
    if options.raster:
        branch = sweeps[0].branch if sweeps and cell.nominal.arm.has_named_branches else None
        for item in placer.passes(pass_views, counts[len(sweeps) :], options.raster.speed, branch):
            if isinstance(item, Infeasible):
                warnings.append(f"omitted: {item.reason}")
            else:
                passes.append(item)
                warnings += [item.note] if item.note else []
    made: list[View] = [*(item.view for item in sweeps), *(item.view for item in passes), *(p.path for p in along)]
    coverage = _check_loss(cell, part, [*sweep_views, *pass_views], made, warnings)
    for sweep, count in zip(sweeps, counts, strict=False):
        assembly.add_sweep(sweep, count)
    for placed in passes:
        assembly.add_pass(placed)
    return coverage, warnings


def _reach_sweeps(placer: Placer, views: list[Sweep], warnings: list[str]) -> list[PlacedSweep]:
    """Place sweeps; an infeasible one is replaced by one from farther or higher, else omitted, with a warning."""
    result: list[PlacedSweep] = []
    for view, item in zip(views, placer.sweeps(views), strict=True):
        if not isinstance(item, Infeasible):
            result.append(item)
            continue
        others = [view.moved(*change) for change in _ALTERNATIVES]
        tried = (placer.sweeps([other])[0] for other in others if other.elevation <= np.radians(85))
        replacement = next((other for other in tried if not isinstance(other, Infeasible)), None)
        if replacement is None:
            warnings.append(f"omitted: {item.reason}")
        else:
            warnings.append(
                f"{item.reason}; replaced by the sweep {replacement.view.name.removeprefix(f'{view.name}, ')}"
            )
            result.append(replacement)
    return result


def _check_loss(
    cell: PlanningCell, part: Surface, wanted: Sequence[View], placed: Sequence[View], warnings: list[str]
) -> float:
    """Fraction of the surface that the placed views see.

    `PlanningError` when they lose more than `_MAX_LOSS` of what was wanted.
    """
    ideal, real = (seen_by(views, cell.range, part) for views in (wanted, placed))
    lost = float((ideal & ~real).mean() / max(ideal.mean(), 1e-12))
    if lost > _MAX_LOSS:
        title = f"{100 * lost:.0f} % of the surface seen by the requested views is out of reach"
        raise PlanningError(join_reasons(title, warnings))
    return float(real.mean())
