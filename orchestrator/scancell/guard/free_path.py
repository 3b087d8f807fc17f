"""Free length of a path that the controller shows: how far the robot is proved to keep all clearances on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scancell.guard.near import STILL, NearPairs, almost
from scancell.nominal.cell import NominalCell
from scancell.proximity.motion_check import Budget, MotionCheck, MotionClash
from scancell.proximity.scene import ProximityScene

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

_FINEST = 2e-4  # rad: finest intervals, a fraction of a millimetre of motion
_SOON = 1 / 16  # of the first piece, in which the distance changes, for the direction of its change


@dataclass(frozen=True)
class ShownPath:
    """Set-points of a path, and how far the robot may be from it.

    Attributes
    ----------
    points
        (n, axes), rad, equally spaced in path clock.
    deviation
        Bound on the deviation of the axes from the straight motion from each point to the next, (n - 1, axes),
        rad.
    ends
        End of the motion from each point that pairs without room have to survive, (n - 1, axes), rad.
    aside
        The deviation that applies to those, (axes,), rad.
    exact
        Whether the first point is a set-point, not measured.
    """

    points: Array
    deviation: Array
    ends: Array
    aside: Array
    exact: bool = True


@dataclass(frozen=True)
class Section:
    """Pieces of a path from `begin` to `end`, of which `parts` (a power of 2) are distinguished in each."""

    begin: int
    end: int
    parts: int


class FreePath:
    """Searches for the first place of a path that is not proved free.

    Parameters
    ----------
    nominal
        Kinematics and bodies.
    scene
        Pairs of these bodies.
    near
        Distances that count as contact, and the pairs within them.
    """

    def __init__(self, nominal: NominalCell, scene: ProximityScene, near: NearPairs) -> None:
        self._motions = MotionCheck(nominal, scene, near.clearance, 1, _FINEST)
        self._pairs, self._near, self._clearance = scene.pairs, near, near.clearance
        self.angle_error = near.angle_error

    def search(self, path: ShownPath, sections: Sequence[Section], budget: Budget) -> tuple[float, MotionClash | None]:
        """Pieces that are proved free, one section after the other, and the clash behind them; None: there is none."""
        near, kept = self._without_room(path, budget)
        room = np.where(near, -np.inf, self._clearance)
        for section in sections:
            pieces = slice(section.begin, section.end)
            if section.end <= section.begin:
                continue
            begins, ends, deviation = path.points[pieces], path.points[1:][pieces], path.deviation[pieces]
            first = self._motions.first_violations(begins, ends, section.parts, deviation, room, budget)
            if near.any():
                nearer = self._motions.first_violations(
                    begins, path.ends[pieces], section.parts, path.aside, kept, budget
                )
                first = np.minimum(first, nearer)
            if np.isfinite(first).any():
                number = int(np.argmin(first))
                piece, share = divmod(section.begin + float(first[number]), 1.0)
                return piece + share, self._clash(path.points, int(piece), share, number)
        return float(max(section.end for section in sections)), None

    def distance(self, axes: Array, pair: tuple[str, str]) -> float:
        """Distance of a pair of the scene at `axes` (axes,), rad, m."""
        return self._distance(axes, self._pairs.index(pair))

    def _clash(self, points: Array, piece: int, share: float, number: int) -> MotionClash:
        place = points[piece] + share * (points[piece + 1] - points[piece])
        clearance = float(self._clearance[number])
        return MotionClash(piece, *self._pairs[number], self._distance(place, number), clearance, share)

    def _distance(self, axes: Array, number: int) -> float:
        one = np.arange(len(self._pairs)) == number
        return float(self._motions.distances(axes[None], one)[0, number])

    def _without_room(self, path: ShownPath, budget: Budget) -> tuple[Flags, Array]:
        """Pairs (pairs,) whose distances must not become less than others (pairs,), m.

        They are within their clearance (`NearPairs.update`), or within that and the deviation where the path begins and
        does not reduce their distance.
        """
        start = path.points[0]
        violated = self._motions.violations(start[None], start[None], path.deviation[0], budget=budget)
        distance = self._motions.distances(start[None], violated, budget)[0]
        near, kept = self._near.update(start, distance, path.exact)
        far = violated & ~near
        if not far.any():
            return near, kept
        soon = start + _SOON * (path.points[1] - start)
        later = self._motions.distances(soon[None], far, budget)[0]
        slides = far & (later >= distance - STILL)
        return near | slides, np.where(slides, almost(distance, self._clearance), kept)
