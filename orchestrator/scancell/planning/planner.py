"""Planning of a complete scan: from the part in the cell to a collision-free program."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scancell.cell.program import Program
from scancell.errors import PlanningError
from scancell.planning import surface
from scancell.planning.assembly import Assembly
from scancell.planning.coverage import CoveragePlanner, CoverageReport
from scancell.planning.default_views import default_views
from scancell.planning.model import PlanningCell
from scancell.planning.options import ScanOptions
from scancell.planning.path_planner import PathPlanner, PlacedPath
from scancell.planning.placement import Infeasible, Placed, PlacedSweep, Placer
from scancell.planning.reasons import describe, join_reasons
from scancell.planning.sight import Sight
from scancell.planning.views import seen_by
from scancell.proximity.judge import first_collision

Array = NDArray[np.float64]


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
    report
        What coverage-driven views see; None for others.
    """

    program: Program
    segment: NDArray[np.int64]
    q: Array
    table: Array
    coverage: float | None
    warnings: tuple[str, ...]
    paths: tuple[PlacedPath, ...] = ()
    report: CoverageReport | None = None


def plan(cell: PlanningCell, options: ScanOptions, sight: Sight | None = None) -> Plan:
    """Plan a scan; `sight` judges coverage-driven views, which need it.

    Raises
    ------
    PlanningError
        If the part does not fit on the table or poses are infeasible, naming them with the distance out of reach, the
        angle outside the joint limits, or the bodies that collide.
    """
    check_part(cell)
    placer = Placer(cell, options.azimuth, options.clearance)
    assembly = Assembly(cell, options)
    if len(options.poses):
        _plan_poses(options, placer, assembly)
        return _verified(cell, options, Plan(*assembly.finish(), None, ()))
    along = _place_paths(cell, options)
    left = options.max_profiles - sum(len(item.exposures) for item in along)
    part, report = surface.sample(cell.nominal.part, cell.nominal.table_from_part), None
    warnings: list[str] = []
    if options.coverage:
        assert sight is not None
        views, report = CoveragePlanner(cell, sight, options).choose(part, left)
        seen = seen_by([placed.view for placed, _ in views], cell.range, part)
    else:
        views, seen, warnings = default_views(cell, options, part, placer, left, is_needed=not along)
    _assemble(assembly, views, in_order=report is None)
    for item in along:
        assembly.add_path(item)
    seen |= seen_by([item.path for item in along], cell.range, part)
    coverage = float(seen.mean())
    return _verified(cell, options, Plan(*assembly.finish(), coverage, tuple(warnings), tuple(along), report))


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
    hit = cell.clearance_violations(nominal.home[None], np.array([cell.table_start]), 1e-4)
    if hit:
        raise PlanningError(f"at the home position: {describe(hit[0], 1e-4)}")


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


def _assemble(assembly: Assembly, views: list[tuple[Placed, int]], in_order: bool) -> None:
    """Append views with their numbers of exposures: in order, or each time the one that is nearest in time."""
    left = list(views)
    while left:
        nearest = 0 if in_order else int(np.argmin([assembly.time_to(placed.ends[0]) for placed, _ in left]))
        placed, count = left.pop(nearest)
        if isinstance(placed, PlacedSweep):
            assembly.add_sweep(placed, count)
        else:
            assembly.add_pass(placed)
