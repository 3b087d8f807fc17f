"""Planning of a complete scan: from the part in the cell to a collision-free program."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scancell.cell.program import Program
from scancell.errors import PlanningError
from scancell.planning import paths, surface
from scancell.planning.assembly import Assembly
from scancell.planning.model import PlanningCell
from scancell.planning.options import ScanOptions
from scancell.planning.path_planner import PathPlanner, PlacedPath
from scancell.planning.paths import Pass, Sweep
from scancell.planning.placement import Infeasible, PlacedPass, PlacedSweep, Placer
from scancell.planning.reasons import describe, join_reasons
from scancell.planning.surface import MIN_COSINE, Surface
from scancell.proximity.judge import first_collision

Array = NDArray[np.float64]

# Largest fraction of the surface seen by all views that infeasible views may lose.
_MAX_LOSS = 0.2
# Replacements of an infeasible sweep: changes of elevation (rad) and of distance (m).
_ALTERNATIVES = ((0.0, 0.015), (0.0, 0.03), *((np.radians(k), 0.0) for k in (15, 30, 45)))
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
    reduced
        Bodies whose meshes were reduced for the distance queries, and by how much: added to their clearances.
    """

    program: Program
    segment: NDArray[np.int64]
    q: Array
    table: Array
    coverage: float | None
    warnings: tuple[str, ...]
    paths: tuple[PlacedPath, ...] = ()
    reduced: tuple[str, ...] = ()


def plan(cell: PlanningCell, options: ScanOptions) -> Plan:
    """Plan a scan.

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
        return _verified(cell, options, Plan(*assembly.finish(), None, (), reduced=_reductions(cell)))
    placed = _place_paths(cell, options)
    coverage, warnings = _plan_views(cell, options, placer, assembly, placed)
    for item in placed:
        assembly.add_path(item)
    made = Plan(*assembly.finish(), coverage, tuple(warnings), tuple(placed), _reductions(cell))
    return _verified(cell, options, made)


def _reductions(cell: PlanningCell) -> tuple[str, ...]:
    found = cell.reduced_meshes.items()
    return tuple(one.line(name) for name, one in found if one.original_faces > len(one.mesh.faces))


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
    clash = first_collision(cell.judged_meshes, cell.proximity.pairs, cell.proximity.names, poses)
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


def _place_paths(cell: PlanningCell, options: ScanOptions) -> list[PlacedPath]:
    """Motions for the sensor paths of the description; `PlanningError` with all reasons where one has none."""
    if not options.paths:
        return []
    # SciPy's splines take a while to import.
    from scancell.planning.sensor_paths import sensor_paths  # noqa: PLC0415

    found = [
        path for item in options.paths for path in sensor_paths(item, cell.nominal.part, cell.nominal.table_from_part)
    ]
    planner = PathPlanner(cell, options.clearance)
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
        seen = _seen(cell, part, [*sweep_views, *pass_views])
        sweep_views += paths.side_sweeps(part, cell.range, options.sweep, seen)
    warnings: list[str] = []
    sweeps = _reach_sweeps(placer, sweep_views, warnings)
    kept: list[Sweep | Pass] = [*(s.view for s in sweeps), *pass_views]
    counts = paths.fit_budget(
        kept,
        options.sweep.angle_step if options.sweep else np.inf,
        options.raster.pitch if options.raster else np.inf,
        options.max_profiles - sum(len(item.exposures) for item in along),
    )
    passes: list[PlacedPass] = []
    if options.raster:
        branch = sweeps[0].branch if sweeps and cell.nominal.arm.has_named_branches else None
        for item in placer.passes(pass_views, counts[len(sweeps) :], options.raster.speed, branch):
            if isinstance(item, Infeasible):
                warnings.append(f"omitted: {item.reason}")
            else:
                passes.append(item)
    seen = _seen_along(cell, part, along)
    coverage = _check_loss(cell, part, [*sweep_views, *pass_views], [*sweeps, *passes], seen, warnings)
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
    cell: PlanningCell,
    part: Surface,
    wanted: list[Sweep | Pass],
    placed: list[PlacedSweep | PlacedPass],
    besides: NDArray[np.bool_],
    warnings: list[str],
) -> float:
    """Fraction of the surface that the placed views, or paths `besides`, see.

    `PlanningError` when the placed views lose more than `_MAX_LOSS` of what was wanted.
    """
    ideal = _seen(cell, part, wanted)
    real = _seen(cell, part, [item.view for item in placed])
    lost = float((ideal & ~real).mean() / max(ideal.mean(), 1e-12))
    if lost > _MAX_LOSS:
        title = f"{100 * lost:.0f} % of the surface seen by the requested views is out of reach"
        raise PlanningError(join_reasons(title, warnings))
    return float((real | besides).mean())


def _seen_along(cell: PlanningCell, part: Surface, along: Sequence[PlacedPath]) -> NDArray[np.bool_]:
    """Whether any of the paths sees each surface sample, (n,)."""
    seen = np.zeros(len(part.points), bool)
    for item in along:
        poses = item.path.at(np.linspace(0.0, item.path.length, len(item.exposures)))
        seen |= surface.best_cosine_of_exposures(cell.range, poses, part) > MIN_COSINE
    return seen


def _seen(cell: PlanningCell, part: Surface, views: Sequence[Sweep | Pass]) -> NDArray[np.bool_]:
    """Whether any of the views sees each surface sample, (n,)."""
    seen = np.zeros(len(part.points), bool)
    for view in views:
        if isinstance(view, Sweep):
            cosine = surface.best_cosine_of_sweep(cell.range, view.at_azimuth_zero, part)
        else:
            turned = part.turned(-view.direction)
            cosine = surface.best_cosine_of_passes(cell.range, view.start, view.end, turned)
        seen |= cosine > MIN_COSINE
    return seen
