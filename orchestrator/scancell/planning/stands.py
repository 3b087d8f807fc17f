"""Stands: positions at which axes beside joints and table rest while views are taken, and the stands of the views.

A view is placed where these axes start, if it is feasible there. Of the other candidates (`scan.axis`), the one at
which most of the remaining views are feasible comes next, and so on. Between stands the axes move while the arm is at
home.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import TypeVar

import numpy as np

from scancell.arrays import Array
from scancell.config.scan import ScanAxisDescription
from scancell.errors import DescriptionError
from scancell.geometry.pose import inverse
from scancell.nominal.cell import NominalCell
from scancell.planning.model import PlanningCell, describe, join_reasons
from scancell.planning.motion.connection import AxisMotions, Connector
from scancell.planning.options import ScanOptions
from scancell.planning.views.placement import Infeasible, PlacedPass, PlacedPose, PlacedSweep, Placer
from scancell.planning.views.views import Pass, Sweep
from scancell.proximity.scene import Clash

_MOST_CANDIDATES = 500
_SAME = 1e-9  # rad or m: positions that differ by less are one

_T = TypeVar("_T", PlacedSweep, PlacedPass, PlacedPose)


def candidate_positions(nominal: NominalCell, described: Sequence[ScanAxisDescription]) -> list[tuple[float, ...]]:
    """Positions (k,) of the axes beside joints and table, rad or m, at which a scan may hold them; the start first.

    Of an axis that is described, in steps from its start to its limits, and the limits; others stay at their start.
    All combinations follow the start by the time that the slowest of the axes needs to get there.

    Raises `DescriptionError` if an axis does not exist, is named twice or has a step of the wrong unit, or there are
    more than 500 combinations.
    """
    axes = nominal.further_axes
    values = {axis.name: [axis.start] for axis in axes}
    for number, item in enumerate(described, start=1):
        key = f"scan.axis[{number}]"
        axis = next((axis for axis in axes if axis.name == item.name), None)
        if axis is None or item.name in [one.name for one in described[: number - 1]]:
            names = ", ".join(one.name for one in axes)
            expected = f"one of {names}, each once" if names else "a cell with [[axis]]"
            raise DescriptionError(key=f"{key}.name", value=item.name, expected=expected)
        step = np.radians(item.step_deg or 0.0) if axis.joint.kind == "revolute" else 1e-3 * (item.step_mm or 0.0)
        if not step:
            unit = "step_deg" if axis.joint.kind == "revolute" else "step_mm"
            raise DescriptionError(key=key, value=item.name, expected=f"{unit}, as the axis is {axis.joint.kind}")
        inside = axis.start + step * np.arange(np.ceil((axis.min - axis.start) / step), (axis.max - axis.start) / step)
        others = np.clip([axis.min, *inside, axis.max], axis.min, axis.max)
        apart = np.diff(others, prepend=-np.inf) > _SAME
        values[item.name] += others[apart & (np.abs(others - axis.start) > _SAME)].tolist()
    count = int(np.prod([len(one) for one in values.values()]))
    if count > _MOST_CANDIDATES:
        raise DescriptionError(
            f"{count} positions of the axes", key="scan.axis", expected=f"larger steps: at most {_MOST_CANDIDATES}"
        )
    start = tuple(axis.start for axis in axes)
    speed = np.array([axis.max_speed for axis in axes])

    def time(positions: tuple[float, ...]) -> float:
        return float((np.abs(np.subtract(positions, start)) / speed).max(initial=0.0))

    return [start, *sorted((one for one in product(*values.values()) if one != start), key=time)]


@dataclass(frozen=True)
class Stand:
    """A cell in which the axes beside joints and table rest at `positions` (k,), rad or m."""

    positions: tuple[float, ...]
    cell: PlanningCell
    options: ScanOptions

    @cached_property
    def placer(self) -> Placer:
        """Places views there."""
        return Placer(self.cell, self.options.azimuth, self.options.clearance)

    @cached_property
    def connector(self) -> Connector:
        """Finds motions of joints and table there."""
        return Connector(self.cell, self.options.clearance)


class Stands:
    """The stands of a scan, and the placement of views at one of them.

    Parameters
    ----------
    cell
        Nominal cell with all axes.
    options
        Clearance, preferred azimuth, and the candidates.
    """

    def __init__(self, cell: PlanningCell, options: ScanOptions) -> None:
        self.cell, self._options = cell, options
        self._made: dict[tuple[float, ...], Stand] = {}
        self._refused: list[str] = []

    def at(self, positions: tuple[float, ...]) -> Stand:
        """The stand at positions (k,), rad or m."""
        if positions not in self._made:
            held = self.cell.held(positions) if positions else self.cell
            self._made[positions] = Stand(positions, held, self._options)
        return self._made[positions]

    @cached_property
    def motions(self) -> AxisMotions:
        """Finds motions between stands."""
        return AxisMotions(self.cell, self._options.clearance)

    @cached_property
    def start(self) -> Stand:
        """The stand at which programs start and end."""
        nominal = self.cell.nominal
        return self.at(tuple(axis.start for axis in nominal.further_axes) or nominal.held_at)

    @cached_property
    def candidates(self) -> tuple[Stand, ...]:
        """The stands to which a motion from the start is proved free, with arm and table where they start.

        Raises `DescriptionError` as `candidate_positions`.
        """
        found, at = [self.start], self.cell.start
        others = candidate_positions(self.cell.nominal, self._options.scan.axis)[1:]
        for positions in others:
            self.cell.work.spend(0.0)
            way = self.motions.path(at, self.along(at, positions))
            if isinstance(way, Clash):
                self._refused.append(f"{self.in_words(positions)}: {describe(way)}")
            else:
                found.append(self.at(positions))
        return tuple(found)

    @property
    def warnings(self) -> list[str]:
        """Candidates that the axes do not reach."""
        total = len(self.candidates) - 1 + len(self._refused)
        title = f"{len(self._refused)} of {total} positions of the axes are not reached with the arm at home"
        return [join_reasons(title, self._refused)] if self._refused else []

    def along(self, axes: Array, positions: tuple[float, ...]) -> Array:
        """The positions (axes,) of joints and table, with further axes at others (k,)."""
        return np.array([*axes[: len(self.cell.nominal.home) + 1], *positions])

    def in_words(self, positions: tuple[float, ...]) -> str:
        """Positions (k,) of the axes for messages."""
        pairs = zip(self.cell.nominal.further_axes, positions, strict=True)
        return ", ".join(
            f"{axis.name} at {np.degrees(at):g} deg"
            if axis.joint.kind == "revolute"
            else f"{axis.name} at {1e3 * at:g} mm"
            for axis, at in pairs
        )

    def sweeps(self, views: Sequence[Sweep]) -> list[PlacedSweep | Infeasible]:
        """See `Placer.sweeps`."""
        return self._placed(len(views), lambda stand, rows: stand.placer.sweeps([views[i] for i in rows]))

    def passes(
        self, views: Sequence[Pass], counts: Sequence[int], speed: float, branch: int | None
    ) -> list[PlacedPass | Infeasible]:
        """See `Placer.passes`."""

        def place(stand: Stand, rows: Sequence[int]) -> list[PlacedPass | Infeasible]:
            return stand.placer.passes([views[i] for i in rows], [counts[i] for i in rows], speed, branch)

        return self._placed(len(views), place)

    def poses(self, part_from_sensor: Array) -> list[PlacedPose | Infeasible]:
        """See `Placer.poses`; the names count all poses."""

        def place(stand: Stand, rows: Sequence[int]) -> list[PlacedPose | Infeasible]:
            found = stand.placer.poses(part_from_sensor[list(rows)])
            return [
                replace(item, name=f"pose {i + 1}") if isinstance(item, PlacedPose) else item
                for i, item in zip(rows, found, strict=True)
            ]

        return self._placed(len(part_from_sensor), place)

    def still(self, name: str, world_from_sensor: Array) -> PlacedPose | Infeasible:
        """The pose (4, 4) of the sensor in the world with the table where it starts, or why it is infeasible."""

        def place(stand: Stand, _: Sequence[int]) -> list[PlacedPose | Infeasible]:
            return [stand.placer.still(name, inverse(stand.cell.nominal.world_from_table) @ world_from_sensor)]

        return self._placed(1, place)[0]

    def _placed(
        self, count: int, place: Callable[[Stand, Sequence[int]], list[_T | Infeasible]]
    ) -> list[_T | Infeasible]:
        """Views by number, each at the first of the stands in the order of the module's description."""

        def at(stand: Stand, rows: list[int]) -> dict[int, _T | Infeasible]:
            found = place(stand, rows)
            placed = [one if isinstance(one, Infeasible) else replace(one, further=stand.positions) for one in found]
            return dict(zip(rows, placed, strict=True))

        first, *others = self.candidates
        found = at(first, list(range(count)))
        left = [i for i, item in found.items() if isinstance(item, Infeasible)]
        elsewhere = [at(stand, left) for stand in others] if left else []
        while left and elsewhere:
            best = max(elsewhere, key=lambda items: sum(not isinstance(items[i], Infeasible) for i in left))
            served = [i for i in left if not isinstance(best[i], Infeasible)]
            if not served:
                break
            found |= {i: best[i] for i in served}
            left = [i for i in left if i not in served]
        for i in left if others else ():
            item = found[i]
            assert isinstance(item, Infeasible)
            found[i] = replace(item, reason=f"{item.reason}; nor is it feasible elsewhere ({len(others)} positions)")
        return list(found.values())
