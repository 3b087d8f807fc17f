"""Planning of a complete scan: from the part in the cell to a collision-free program."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from scancell.errors import PlanningError
from scancell.planning import paths, surface
from scancell.planning.assembly import Assembly
from scancell.planning.configuration_map import Judge
from scancell.planning.model import PlanningCell
from scancell.planning.options import ScanOptions
from scancell.planning.path_planner import PathPlanner, PlacedPath
from scancell.planning.placement import Infeasible, PlacedPass, PlacedSweep, Placer
from scancell.planning.plan import Plan
from scancell.planning.reasons import join_reasons
from scancell.planning.surface import Surface
from scancell.planning.verification import check_part, verified
from scancell.planning.views import Spacing, Sweep, View, exposure_counts, seen_by

Array = NDArray[np.float64]

# Largest fraction of the surface seen by all views that infeasible views may lose.
_MAX_LOSS = 0.2
# Replacements of an infeasible sweep: changes of elevation (rad) and of distance (m).
_ALTERNATIVES = ((0.0, 0.015), (0.0, 0.03), *((np.radians(k), 0.0) for k in (15, 30, 45)))
_DEFAULT_AZIMUTH = np.radians(105.0)  # preferred azimuth of single poses when the scan has no sweeps


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
        return verified(cell, options, Plan(*assembly.finish(), None, (), reduced=_reductions(cell)))
    placed = _place_paths(cell, options, judges)
    coverage, warnings = _plan_views(cell, options, placer, assembly, placed)
    warnings += [item.note for item in placed if item.note]
    for item in placed:
        assembly.add_path(item)
    made = Plan(*assembly.finish(), coverage, tuple(warnings), tuple(placed), _reductions(cell))
    return verified(cell, options, made)


def _reductions(cell: PlanningCell) -> tuple[str, ...]:
    found = cell.reduced_meshes.items()
    return tuple(one.line(name) for name, one in found if one.original_faces > len(one.mesh.faces))


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
