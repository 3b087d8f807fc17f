"""From a part in the cell to a checked program."""

from __future__ import annotations

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
from orchestrator.planning.placement import PlacedPass, PlacedSweep, describe, place_passes, place_poses, place_sweeps
from orchestrator.planning.surface import MIN_COSINE, Surface

Array = NDArray[np.float64]

# When views that cannot be reached cost more than this share of what the wanted views would see, the scan is refused.
_MAX_LOSS = 0.2


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
    assembly = Assembly(cell, options)
    if len(options.poses):
        coverage, warnings = None, _plan_poses(cell, options, assembly)
    else:
        coverage, warnings = _plan_views(cell, options, assembly)
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


def _plan_poses(cell: PlanningCell, options: ScanOptions, assembly: Assembly) -> list[str]:
    if len(options.poses) > options.max_profiles:
        raise PlanningError(f"{len(options.poses)} poses are given, max_profiles allows {options.max_profiles}")
    placed, reasons = place_poses(cell, options.poses, assembly.azimuth, options.clearance)
    if reasons:
        raise PlanningError(_listed("poses that cannot be taken", reasons))
    for item in placed:
        if item is not None:
            assembly.add_pose(item)
    return []


def _plan_views(cell: PlanningCell, options: ScanOptions, assembly: Assembly) -> tuple[float, list[str]]:
    part = surface.sample(cell.nominal.part, cell.nominal.table_from_part)
    sweep_views = paths.sweeps(part, cell.range, options.sweep) if options.sweep else []
    pass_views = paths.passes(part, cell.range, options.raster) if options.raster else []
    wanted: list[Sweep | Pass] = [*sweep_views, *pass_views]
    if not wanted:
        raise PlanningError("no view sees any of the part: nothing of it faces the sensor")
    warnings: list[str] = []
    sweeps = _reach_sweeps(cell, sweep_views, options, warnings)
    angle_step = options.sweep.angle_step if options.sweep else 1.0
    pitch = options.raster.pitch if options.raster else 1.0
    kept: list[Sweep | Pass] = [*(s.view for s in sweeps), *pass_views]
    angle_step, pitch, counts = paths.fit_budget(kept, angle_step, pitch, options.max_profiles)
    if sum(counts) > options.max_profiles:
        raise PlanningError(f"{len(kept)} views need more than max_profiles = {options.max_profiles} exposures")
    placed_passes: list[PlacedPass] = []
    if options.raster:
        branch = sweeps[0].branch if sweeps else None
        found, reasons = place_passes(
            cell, pass_views, counts[len(sweeps) :], pitch, options.raster.speed, options.clearance, branch
        )
        placed_passes = [p for p in found if p is not None]
        warnings += [f"left out: {reason}" for reason in reasons]
    coverage = _check_loss(cell, part, wanted, sweeps, placed_passes, warnings)
    for sweep, count in zip(sweeps, counts, strict=False):
        assembly.add_sweep(sweep, count)
    for item in placed_passes:
        assembly.add_pass(item)
    return coverage, warnings


def _reach_sweeps(
    cell: PlanningCell, views: list[Sweep], options: ScanOptions, warnings: list[str]
) -> list[PlacedSweep]:
    """Place sweeps; one that fails is tried from farther off and from higher up, then left out with a warning."""
    if options.sweep is None:
        return []
    azimuth = options.sweep.azimuth
    placed, reasons = place_sweeps(cell, views, azimuth, options.clearance)
    failed = [view for view, item in zip(views, placed, strict=True) if item is None]
    result = [item for item in placed if item is not None]
    for view, reason in zip(failed, reasons, strict=True):
        raised = [view.elevation + np.radians(k) for k in (15, 30, 45)]
        others = [view.tilted(view.elevation, extra) for extra in (0.015, 0.03)]
        others += [view.tilted(e, 0.0) for e in raised if e <= np.radians(85)]
        found, _ = place_sweeps(cell, others, azimuth, options.clearance)
        instead = next((item for item in found if item is not None), None)
        if instead is None:
            warnings.append(f"left out: {reason}")
        else:
            warnings.append(f"{reason}; done instead: {instead.view.name}")
            result.append(instead)
    return result


def _check_loss(
    cell: PlanningCell,
    part: Surface,
    wanted: list[Sweep | Pass],
    sweeps: list[PlacedSweep],
    passes: list[PlacedPass],
    warnings: list[str],
) -> float:
    """Share of the surface that the placed views see; `PlanningError` when far less than wanted."""
    ideal = np.any([_sees(cell, part, view) for view in wanted], axis=0)
    done: list[Sweep | Pass] = [*(s.view for s in sweeps), *(p.view for p in passes)]
    real = np.any([_sees(cell, part, view) for view in done], axis=0) if done else np.zeros_like(ideal)
    lost = float((ideal & ~real).mean() / max(ideal.mean(), 1e-12))
    if lost > _MAX_LOSS:
        raise PlanningError(
            _listed(f"{100 * lost:.0f} % of the surface that the wanted views see is out of reach", warnings)
        )
    return float(real.mean())


def _sees(cell: PlanningCell, part: Surface, view: Sweep | Pass) -> NDArray[np.bool_]:
    if isinstance(view, Sweep):
        return surface.best_cosine_of_sweep(cell.range, view.at_azimuth_zero, part) > MIN_COSINE
    turned = part.turned(-view.direction)
    return surface.best_cosine_of_passes(cell.range, view.start, view.end, turned) > MIN_COSINE


def _listed(title: str, reasons: list[str]) -> str:
    shown = reasons[:8]
    more = [f"and {len(reasons) - len(shown)} more"] if len(reasons) > len(shown) else []
    return f"{title}: " + "; ".join([*shown, *more])
