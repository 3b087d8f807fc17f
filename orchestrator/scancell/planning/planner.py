"""Planning of a complete scan: from the part in the cell to a collision-free program."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from scancell.errors import PlanningError
from scancell.geometry.pose import inverse
from scancell.planning.model import PlanningCell
from scancell.planning.motion.assembly import Assembly
from scancell.planning.motion.verification import check_part, verified
from scancell.planning.options import BeltOptions, ScanOptions
from scancell.planning.path_map.configuration_map import QualityFactor
from scancell.planning.path_map.path_planner import PathPlanner, PlacedPath
from scancell.planning.plan import Plan
from scancell.planning.reasons import join_reasons
from scancell.planning.views.belt import belt_run, range_warnings, spacing_and_count
from scancell.planning.views.coverage import CHOICE_SHARE, CoveragePlanner
from scancell.planning.views.default_views import default_views
from scancell.planning.views.placement import Infeasible, Placed, Placer
from scancell.planning.views.sight import Sight
from scancell.planning.views.views import sample_part, seen_by
from scancell.planning.work import WorkLimitError

Array = NDArray[np.float64]


def plan(
    cell: PlanningCell, options: ScanOptions, sight: Sight | None = None, quality_factors: Sequence[QualityFactor] = ()
) -> Plan:
    """Plan a scan.

    `sight` judges coverage-driven views, which need it; `quality_factors` are further constraints of motions along
    sensor paths.

    Raises `PlanningError` if the part does not fit on the table or poses are infeasible, naming them with the distance
    out of reach, the angle outside the joint limits, or the bodies that collide.
    """
    check_part(cell)
    placer = Placer(cell, options.azimuth, options.clearance)
    assembly = Assembly(cell, options)
    if options.belt is not None:
        warnings = _plan_belt(cell, options, options.belt, placer, assembly)
        return verified(cell, options, Plan(*assembly.finish(), None, tuple(warnings), reduced=_reductions(cell)))
    if len(options.poses):
        _plan_poses(cell, options, placer, assembly)
        return verified(cell, options, Plan(*assembly.finish(), None, (), reduced=_reductions(cell)))
    along = _place_paths(cell, options, quality_factors)
    left = options.max_profiles - sum(len(item.exposures) for item in along)
    part, report = sample_part(cell.nominal.part, cell.nominal.table_from_part), None
    warnings = []
    if options.coverage:
        assert sight is not None
        views, report = CoveragePlanner(cell, sight, options).choose(part, left)
        if cell.work.spent > CHOICE_SHARE * cell.work.limit:
            warnings.append(
                f"views were chosen until {100 * CHOICE_SHARE:.0f} % of scan.max_planning_work ="
                f" {cell.work.limit:g} was used: they see {100 * report.share:.1f} % of the measurable surface"
            )
        seen = seen_by([placed.view for placed, _ in views], cell.range, part)
    else:
        cell.work.doing = "placing sweeps and passes"
        views, seen, warnings = default_views(cell, options, part, placer, left, is_needed=not along)
    warnings += [item.note for item in along if item.note]
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
    plan_ = Plan(*assembly.finish(), coverage, tuple(warnings), tuple(along), report, _reductions(cell))
    return verified(cell, options, plan_)


def _reductions(cell: PlanningCell) -> tuple[str, ...]:
    found = cell.reduced_meshes.items()
    return tuple(one.line(name) for name, one in found if one.original_faces > len(one.mesh.faces))


def _plan_poses(cell: PlanningCell, options: ScanOptions, placer: Placer, assembly: Assembly) -> None:
    if len(options.poses) > options.max_profiles:
        raise PlanningError(
            f"{len(options.poses)} poses are given",
            key="scan.max_profiles",
            value=options.max_profiles,
            expected=f"at least {len(options.poses)}",
        )
    cell.work.doing = f"placing {len(options.poses)} poses"
    found = placer.poses(options.poses)
    reasons = [item.reason for item in found if isinstance(item, Infeasible)]
    if reasons:
        raise PlanningError(join_reasons("infeasible poses", reasons))
    for item in found:
        if not isinstance(item, Infeasible):
            assembly.add_pose(item)


def _plan_belt(
    cell: PlanningCell, options: ScanOptions, belt: BeltOptions, placer: Placer, assembly: Assembly
) -> list[str]:
    """Add the scan on the belt; returns warnings."""
    nominal = cell.nominal
    run = belt_run(nominal, belt, cell.cycle)
    world_from_sensor = nominal.required_belt().world_from_belt @ belt.belt_from_sensor
    cell.work.doing = "placing the sensor over the belt"
    placed = placer.still("the pose over the belt", inverse(nominal.world_from_table) @ world_from_sensor)
    if isinstance(placed, Infeasible):
        raise PlanningError(placed.reason, key="scan.belt.pose")
    pitch, count, warnings = spacing_and_count(run, belt, options.max_profiles)
    assembly.add_belt(placed, run, pitch, count)
    return [*warnings, *range_warnings(nominal, belt, cell.range)]


def _place_paths(
    cell: PlanningCell, options: ScanOptions, quality_factors: Sequence[QualityFactor]
) -> list[PlacedPath]:
    """Motions for the sensor paths of the description; `PlanningError` with all reasons where one has none."""
    if not options.paths:
        return []
    # SciPy's splines take a while to import.
    from scancell.planning.views.sensor_paths import sensor_paths  # noqa: PLC0415

    found = [
        path for item in options.paths for path in sensor_paths(item, cell.nominal.part, cell.nominal.table_from_part)
    ]
    needed = sum(path.count for path in found)
    if needed > options.max_profiles:
        raise PlanningError(
            f"the paths need {needed} exposures",
            key="scan.max_profiles",
            value=options.max_profiles,
            expected="a larger pitch_mm of the paths or a larger scan.max_profiles",
        )
    planner = PathPlanner(cell, options.clearance, quality_factors)
    placed = []
    for number, path in enumerate(found, start=1):
        cell.work.doing = f"placing path {number} of {len(found)} ({path.name})"
        placed.append(planner.place(path))
    reasons = [item for item in placed if isinstance(item, str)]
    if reasons:
        raise PlanningError(join_reasons("infeasible paths", reasons))
    return [item for item in placed if isinstance(item, PlacedPath)]


def _assemble(assembly: Assembly, views: list[tuple[Placed, int]], in_order: bool) -> list[tuple[Placed, str]]:
    """Append views with their numbers of exposures: in order, or each time the one that is nearest in time.

    Returns those to which no free path is found, with the reason.
    """
    left, omitted = list(views), []
    while left:
        nearest = 0 if in_order else int(np.argmin([assembly.time_to(placed.ends[0]) for placed, _ in left]))
        placed, count = left.pop(nearest)
        try:
            assembly.add_view(placed, count)
        except WorkLimitError:
            raise
        except PlanningError as error:
            omitted.append((placed, str(error)))
    return omitted
