"""Motions between views that keep clear of everything, through a retreat or the home position where need be."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise, product

import numpy as np
from numpy.typing import NDArray

from orchestrator.errors import PlanningError
from orchestrator.geometry import pose
from orchestrator.planning import trajectory
from orchestrator.planning.model import PlanningCell
from orchestrator.planning.placement import LIMIT_SHARE
from orchestrator.planning.reasons import describe
from orchestrator.proximity.scene import Clash

Array = NDArray[np.float64]

_CHECK_STEP = np.radians(0.5)  # of the joint that moves most: some 7 mm at arm's length
_RETREATS = (0.06, 0.12, 0.2)


class Connector:
    """Finds collision-free joint motions (q and table together) in one cell."""

    def __init__(self, cell: PlanningCell, clearance: float) -> None:
        self._cell = cell
        # Between the poses that views were checked at, bodies may come a little nearer.
        self._clearance = 0.8 * clearance
        arm, nominal = cell.nominal.arm, cell.nominal
        self._speed = LIMIT_SHARE * np.append(arm.max_speed, nominal.table_max_speed)
        self._acceleration = LIMIT_SHARE * np.append(arm.max_acceleration, nominal.table_max_acceleration)

    def move(self, start: Array, end: Array) -> Array:
        """Set-points (n, 7) of the straight joint motion from `start` to `end` (7,), unchecked."""
        return trajectory.move(start, end, self._speed, self._acceleration, self._cell.cycle)

    def connect(self, start: Array, end: Array, purpose: str) -> list[Array]:
        """Set-points (n, 7) of one or more motions, each rest to rest, from `start` to `end` (7,).

        Raises `PlanningError`, naming `purpose` and what hits what on the straight way, when no way is clear.
        """
        if np.abs(end - start).max() < 1e-9:
            return []
        checked: dict[tuple[bytes, bytes], list[Clash]] = {}
        direct: list[Clash] = []
        for way in self._ways(start, end):
            legs = [(a, b) for a, b in pairwise(way) if np.abs(b - a).max() > 0]
            for a, b in legs:
                key = (a.tobytes(), b.tobytes())
                if key not in checked:
                    checked[key] = self._check(a, b)
                if checked[key]:
                    direct = direct or checked[key]
                    break
            else:
                return [self.move(a, b) for a, b in legs]
        raise PlanningError(f"no clear way to {purpose}: {describe(direct[0], self._clearance)} on the straight one")

    def _check(self, start: Array, end: Array) -> list[Clash]:
        steps = int(np.ceil(np.abs(end - start).max() / _CHECK_STEP)) + 1
        way = np.linspace(start, end, max(2, steps))
        return self._cell.too_near(way[:, :6], way[:, 6], self._clearance)

    def _ways(self, start: Array, end: Array) -> Iterator[list[Array]]:
        """Waypoint lists to try, simplest first: straight, through a retreat at either end or both, through home."""
        yield [start, end]
        starts, ends = self._escapes(start), self._escapes(end)
        pairs = sorted(product(range(len(starts)), range(len(ends))), key=sum)
        yield from ([start, starts[i], ends[k], end] for i, k in pairs)
        home = self._cell.nominal.home
        for i, k in pairs:
            yield [start, starts[i], np.append(home, start[6]), np.append(home, end[6]), ends[k], end]

    def _escapes(self, at: Array) -> list[Array]:
        """`at` (7,) itself, and with the sensor drawn back along its view or lifted along the table's axis."""
        here = self._cell.table_from_sensor(at[:6])
        targets = []
        for distance in _RETREATS:
            targets.append(here @ pose.translation((0.0, 0.0, -distance)))
            targets.append(pose.translation((0.0, 0.0, distance)) @ here)
        q = self._cell.ik(np.array(targets), reference=at[:6])
        # The same branch is the one whose joints hardly change.
        gap = np.nan_to_num(np.abs(q - at[:6]).max(-1), nan=np.inf)
        best = np.argmin(gap, axis=1)
        near = [q[i, k] for i, k in enumerate(best) if gap[i, k] < np.radians(60)]
        return [at, *(np.append(joints, at[6]) for joints in near)]
