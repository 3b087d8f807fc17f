"""Motions between views that keep clear of everything, through a retreat or the home position where need be."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

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
        self._clearance = clearance
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
            for a, b in pairwise(way):
                key = (a.tobytes(), b.tobytes())
                if key not in checked:
                    checked[key] = self._check(a, b)
                if checked[key]:
                    direct = direct or checked[key]
                    break
            else:
                return [self.move(a, b) for a, b in pairwise(way)]
        raise PlanningError(f"no clear way to {purpose}: {describe(direct[0], self._clearance)} on the straight one")

    def _check(self, start: Array, end: Array) -> list[Clash]:
        steps = int(np.ceil(np.abs(end - start).max() / _CHECK_STEP)) + 1
        way = np.linspace(start, end, max(2, steps))
        return self._cell.too_near(way[:, :6], way[:, 6], self._clearance)

    def _ways(self, start: Array, end: Array) -> Iterator[list[Array]]:
        """Waypoint lists to try, simplest first. The table turns on the longest leg, away from the part."""
        yield [start, end]
        home = self._cell.nominal.home
        for distance in _RETREATS:
            back, front = self._retreat(start, distance), self._retreat(end, distance)
            if back is not None and front is not None:
                yield [start, back, front, end]
                yield [start, back, np.append(home, start[6]), np.append(home, end[6]), front, end]
        yield [start, np.append(home, start[6]), np.append(home, end[6]), end]

    def _retreat(self, at: Array, distance: float) -> Array | None:
        """Joints and table (7,) with the sensor drawn back along its viewing direction, in the same branch."""
        target = self._cell.table_from_sensor(at[:6]) @ pose.translation((0.0, 0.0, -distance))
        q = self._cell.ik(target[None], reference=at[:6])[0]
        gap = np.nan_to_num(np.abs(q - at[:6]).max(-1), nan=np.inf)
        best = int(np.argmin(gap))
        return np.append(q[best], at[6]) if gap[best] < np.radians(60) else None
