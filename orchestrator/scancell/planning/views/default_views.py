"""The views of a scan without coverage goal: sweeps through and beside the table's axis, passes over the top."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scancell.errors import PlanningError
from scancell.planning.model import PlanningCell
from scancell.planning.options import ScanOptions
from scancell.planning.reasons import join_reasons
from scancell.planning.views import paths
from scancell.planning.views.placement import Infeasible, Placed, PlacedSweep, Placer
from scancell.planning.views.views import Surface, Sweep, exposure_counts, seen_by

Flags = NDArray[np.bool_]

# Largest fraction of the surface seen by all views that infeasible views may lose.
# Replacements of an infeasible sweep: changes of elevation (rad) and of distance (m).
_ALTERNATIVES = ((0.0, 0.015), (0.0, 0.03), *((np.radians(k), 0.0) for k in (15, 30, 45)))


def default_views(
    cell: PlanningCell, options: ScanOptions, part: Surface, placer: Placer, max_profiles: int, is_needed: bool
) -> tuple[list[tuple[Placed, int]], Flags, list[str]]:
    """Placed views with their numbers of exposures, the samples that they see, and warnings.

    The warnings name views that were omitted or replaced. What is seen (n,) ignores occlusion.

    Raises `PlanningError` if infeasible views lose more of the surface than `ScanOptions.max_lost_share`, or there are
    too few exposures.

    Parameters
    ----------
    max_profiles
        Largest number of exposures.
    is_needed
        Whether it is an error if no view sees the part.
    """
    turns = paths.sweeps(part, cell.range, options.sweep) if options.sweep else []
    lines = paths.passes(part, cell.range, options.raster) if options.raster else []
    if is_needed and not (turns or lines):
        raise PlanningError("no view sees the part: no surface faces the sensor")
    cell.work.spend(0.0)
    if options.sweep:
        seen = seen_by([*turns, *lines], cell.range, part)
        turns += paths.side_sweeps(part, cell.range, options.sweep, seen, cell.work)
    warnings: list[str] = []
    sweeps = _reach_sweeps(placer, turns, warnings)
    counts = exposure_counts([*(s.view for s in sweeps), *lines], options.spacing, max_profiles)
    placed: list[tuple[Placed, int]] = [*zip(sweeps, counts, strict=False)]
    if options.raster:
        branch = sweeps[0].branch if sweeps and cell.nominal.arm.has_named_branches else None
        left = counts[len(sweeps) :]
        for item, count in zip(placer.passes(lines, left, options.raster.speed, branch), left, strict=True):
            if isinstance(item, Infeasible):
                warnings.append(f"omitted: {item.reason}")
            else:
                placed.append((item, count))
                warnings += [item.note] if item.note else []
    wanted = seen_by([*turns, *lines], cell.range, part)
    seen = seen_by([item.view for item, _ in placed], cell.range, part)
    _check_loss(wanted, seen, options.max_lost_share, warnings)
    return placed, seen, warnings


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


def _check_loss(wanted: Flags, seen: Flags, most: float, warnings: list[str]) -> None:
    """`PlanningError` when more than the share `most` of the samples (n,) that wanted views see is not `seen`."""
    lost = float((wanted & ~seen).mean() / max(wanted.mean(), 1e-12))
    if lost > most:
        title = (
            f"{100 * lost:.0f} % of the surface seen by the requested views is out of reach;"
            f" scan.max_lost_share = {most:g} allows {100 * most:.0f} %"
        )
        raise PlanningError(join_reasons(title, warnings))
