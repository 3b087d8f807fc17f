"""From a part in the cell to a checked program."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orchestrator.cell.program import Program
from orchestrator.errors import PlanningError
from orchestrator.planning import paths, surface
from orchestrator.planning.assembly import Assembly
from orchestrator.planning.model import PlanningCell
from orchestrator.planning.options import ScanOptions
from orchestrator.planning.paths import Pass, Sweep
from orchestrator.planning.placement import PlacedPass, PlacedSweep, Placer, Refusal
from orchestrator.planning.reasons import describe, listed
from orchestrator.planning.surface import MIN_COSINE, Surface

Array = NDArray[np.float64]

# When views that cannot be reached cost more than this share of what the wanted views would see, the scan is refused.
_MAX_LOSS = 0.2
# What a sweep that fails is replaced by: higher up (rad) or farther off (m).
_ALTERNATIVES = ((0.0, 0.015), (0.0, 0.03), *((np.radians(k), 0.0) for k in (15, 30, 45)))
_DEFAULT_AZIMUTH = np.radians(105.0)  # where single poses are taken when there are no sweeps to say it


@dataclass(frozen=True)
class Plan:
    """A program with what it will do.

    Attributes
    ----------
    program
        Checked for reach, joint limits and clashes, from home to home.
    segment
        (m,) id of the segment of each exposure, in order of firing.
    part_from_sensor
        (m, 4, 4) planned nominal sensor pose of each exposure.
    q, table
        (m, 6), (m,) planned joints and table angle of each exposure.
    views
        Segment id → what it scans.
    coverage
        Share of the part's surface that the views see, were it convex; None for given poses.
    warnings
        What was left out or changed, in sentences.
    """

    program: Program
    segment: NDArray[np.int64]
    part_from_sensor: Array
    q: Array
    table: Array
    views: dict[int, str]
    coverage: float | None
    warnings: tuple[str, ...]


def plan(cell: PlanningCell, options: ScanOptions) -> Plan:
    """Plan a scan.

    Raises `PlanningError` naming the poses that are out of reach or outside joint limits (and by how much), or what
    comes too near what; or by how much the part is too large for the table.
    """
    check_part(cell)
    azimuth = options.sweep.azimuth if options.sweep else _DEFAULT_AZIMUTH
    placer = Placer(cell, azimuth, options.clearance)
    assembly = Assembly(cell, options)
    coverage: float | None = None
    warnings: list[str] = []
    if len(options.poses):
        _plan_poses(options, placer, assembly)
    else:
        coverage, warnings = _plan_views(cell, options, placer, assembly)
    program, segment, q, table, views = assembly.finish()
    part_from_sensor = cell.nominal.part_from_sensor(q, table)
    return Plan(program, segment, part_from_sensor, q, table, views, coverage, tuple(warnings))


def check_part(cell: PlanningCell) -> None:
    """Raise `PlanningError` unless the part stands on the table and the cell is clear at home."""
    nominal = cell.nominal
    used = nominal.part.vertices[np.unique(nominal.part.faces)]
    on_table = used @ nominal.table_from_part[:3, :3].T + nominal.table_from_part[:3, 3]
    radius = float(np.hypot(on_table[:, 0], on_table[:, 1]).max())
    if radius > nominal.table_radius + 1e-9:
        raise PlanningError(
            f"{nominal.part.source}: too large for the table: it reaches {1e3 * radius:.1f} mm from the axis, "
            f"{1e3 * (radius - nominal.table_radius):.1f} mm beyond the table's radius"
        )
    if on_table[:, 2].min() < -1e-6:
        raise PlanningError(
            f"{nominal.part.source}: its lowest point is {-1e3 * on_table[:, 2].min():.3f} mm below the table's top"
        )
    hit = cell.too_near(nominal.home[None], np.array([cell.table_start]), 1e-4)
    if hit:
        raise PlanningError(f"at home {describe(hit[0], 1e-4)}")


def _plan_poses(options: ScanOptions, placer: Placer, assembly: Assembly) -> None:
    if len(options.poses) > options.max_profiles:
        raise PlanningError(f"{len(options.poses)} poses are given, max_profiles allows {options.max_profiles}")
    found = placer.poses(options.poses)
    refused = [item.reason for item in found if isinstance(item, Refusal)]
    if refused:
        raise PlanningError(listed("poses that cannot be taken", refused))
    for item in found:
        if not isinstance(item, Refusal):
            assembly.add_pose(item)


def _plan_views(
    cell: PlanningCell, options: ScanOptions, placer: Placer, assembly: Assembly
) -> tuple[float, list[str]]:
    part = surface.sample(cell.nominal.part, cell.nominal.table_from_part)
    sweep_views = paths.sweeps(part, cell.range, options.sweep) if options.sweep else []
    pass_views = paths.passes(part, cell.range, options.raster) if options.raster else []
    if not (sweep_views or pass_views):
        raise PlanningError("no view sees any of the part: nothing of it faces the sensor")
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
        options.max_profiles,
    )
    passes: list[PlacedPass] = []
    if options.raster:
        branch = sweeps[0].branch if sweeps else None
        for item in placer.passes(pass_views, counts[len(sweeps) :], options.raster.speed, branch):
            if isinstance(item, Refusal):
                warnings.append(f"left out: {item.reason}")
            else:
                passes.append(item)
    coverage = _check_loss(cell, part, [*sweep_views, *pass_views], [*sweeps, *passes], warnings)
    for sweep, count in zip(sweeps, counts, strict=False):
        assembly.add_sweep(sweep, count)
    for placed in passes:
        assembly.add_pass(placed)
    return coverage, warnings


def _reach_sweeps(placer: Placer, views: list[Sweep], warnings: list[str]) -> list[PlacedSweep]:
    """Place sweeps; one that fails is tried from farther off and from higher up, then left out with a warning."""
    result: list[PlacedSweep] = []
    for view, item in zip(views, placer.sweeps(views), strict=True):
        if not isinstance(item, Refusal):
            result.append(item)
            continue
        others = [view.moved(raised, farther) for raised, farther in _ALTERNATIVES]
        tried = (placer.sweeps([other])[0] for other in others if other.elevation <= np.radians(85))
        instead = next((other for other in tried if not isinstance(other, Refusal)), None)
        if instead is None:
            warnings.append(f"left out: {item.reason}")
        else:
            warnings.append(f"{item.reason}; done instead{instead.view.name.removeprefix(view.name)}")
            result.append(instead)
    return result


def _check_loss(
    cell: PlanningCell,
    part: Surface,
    wanted: list[Sweep | Pass],
    placed: list[PlacedSweep | PlacedPass],
    warnings: list[str],
) -> float:
    """Share of the surface that the placed views see; `PlanningError` when far less than wanted."""
    ideal = _seen(cell, part, wanted)
    real = _seen(cell, part, [item.view for item in placed])
    lost = float((ideal & ~real).mean() / max(ideal.mean(), 1e-12))
    if lost > _MAX_LOSS:
        title = f"{100 * lost:.0f} % of the surface that the wanted views see is out of reach"
        raise PlanningError(listed(title, warnings))
    return float(real.mean())


def _seen(cell: PlanningCell, part: Surface, views: Sequence[Sweep | Pass]) -> NDArray[np.bool_]:
    """(n,) whether any of the views sees each point of the surface."""
    seen = np.zeros(len(part.points), bool)
    for view in views:
        if isinstance(view, Sweep):
            cosine = surface.best_cosine_of_sweep(cell.range, view.at_azimuth_zero, part)
        else:
            turned = part.turned(-view.direction)
            cosine = surface.best_cosine_of_passes(cell.range, view.start, view.end, turned)
        seen |= cosine > MIN_COSINE
    return seen
