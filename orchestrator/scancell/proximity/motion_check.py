"""Proof that joint motions keep a clearance: exact distances and bounds on the motion, bisected.

At the middle of an interval of a motion, a pair of bodies at distance d keeps the clearance c in the whole interval if
d >= c + h, where h bounds the motion of one body relative to the other from the middle to either end (Schwarzer, Saha &
Latombe, "Exact collision checking of robot paths", 2002).  Intervals without this proof are halved.  Samples would miss
what is thinner than their spacing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.nominal.cell import NominalCell
from scancell.proximity.motion_bounds import MotionBounds
from scancell.proximity.scene import Clash, ProximityScene

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

_FARTHEST_SEARCH = 0.05  # m beyond the clearance: longer searches cost more than halving the interval
_CONTACT = 1e-9  # m: bodies closer than this intersect
_FINEST = 1e-5  # rad


@dataclass(frozen=True)
class MotionClash(Clash):
    """A place where motion number `index` violates a clearance, at `fraction` of its way from 0 to 1."""

    fraction: float


class MotionCheck:
    """Checks motions that are linear in the joints and the table angle.

    Parameters
    ----------
    nominal
        Kinematics and bodies.
    scene
        Pairs of these bodies.
    clearance
        Distance to keep, one for all pairs or (pairs,), m.
    threads
        Threads of the distance queries, which do not change the result; 0 uses all cores.
    finest
        Angle from the middle of an interval to its ends, rad: what is not proved there counts as a violation.
    """

    def __init__(
        self,
        nominal: NominalCell,
        scene: ProximityScene,
        clearance: ArrayLike,
        threads: int = 0,
        finest: float = _FINEST,
    ) -> None:
        self._nominal = nominal
        self._scene = scene
        self._clearance = np.broadcast_to(np.maximum(np.asarray(clearance, float), _CONTACT), (len(scene.pairs),))
        self._threads = threads
        self._finest = finest
        self._bounds = MotionBounds(nominal, scene.pairs)

    def first_clashes(
        self, start: ArrayLike, end: ArrayLike, deviation: ArrayLike = 0.0, clearance: ArrayLike | None = None
    ) -> list[MotionClash | None]:
        """One entry per motion: None if it is proved to keep all clearances, else a place where it does not.

        Parameters
        ----------
        start, end
            (n, joints + 1) joints and table angle, rad.
        deviation
            Largest deviation of the true motion from the straight one, one for all axes, (joints + 1,) or
            (n, joints + 1), rad. Where the distance does not allow for it, the motion violates the clearance.
        clearance
            In place of that of the check, (pairs,) or (n, pairs), m; pairs of ``-inf`` are not checked.
        """
        start, end = np.atleast_2d(np.asarray(start, float)), np.atleast_2d(np.asarray(end, float))
        travel = np.abs(end - start)
        slack = np.broadcast_to(np.asarray(deviation, float), travel.shape)
        found: list[MotionClash | None] = [None] * len(start)
        owner = np.arange(len(start))
        middle, half = np.full(len(start), 0.5), 0.5
        given = self._clearance if clearance is None else np.asarray(clearance, float)
        required = np.broadcast_to(np.maximum(given, _CONTACT), (len(start), len(self._scene.pairs)))
        unproved = np.broadcast_to(given > -np.inf, required.shape)
        while len(owner):
            at = start[owner] + middle[:, None] * (end - start)[owner]
            half_travel = half * travel[owner]
            finest = (half_travel < self._finest).all(1)
            distance, proved, violated = self._judge(at, half_travel, slack[owner], required[owner], unproved)
            unproved = unproved & ~proved
            violated |= unproved & finest[:, None]
            for i in np.flatnonzero(violated.any(1)):
                if found[owner[i]] is None:  # intervals are in order: the first one is the first on the motion
                    pair = int(np.argmin(np.where(violated[i], distance[i] - required[owner[i]], np.inf)))
                    nearest, keep = float(distance[i, pair]), float(required[owner[i], pair])
                    found[owner[i]] = MotionClash(
                        int(owner[i]), *self._scene.pairs[pair], nearest, keep, float(middle[i])
                    )
            going_on = unproved.any(1) & np.array([found[o] is None for o in owner], bool)
            half /= 2
            owner = np.repeat(owner[going_on], 2)
            middle = (middle[going_on, None] + np.array([-half, half])).ravel()
            unproved = np.repeat(unproved[going_on], 2, axis=0)
        return found

    def clash_along(self, points: Array) -> MotionClash | None:
        """None if the motion of the controller through set-points (n, joints + 1), rad, is proved, else a clash.

        The controller interpolates by cubics, which leave the straight lines by less than a quarter of the second
        differences. Set-points are checked first: most motions that fail do so there, and proofs take longer.
        """
        deviation = np.abs(np.diff(points, n=2, axis=0)).max(0, initial=0.0) / 4
        for start, end in ((points, points), (points[:-1], points[1:])):
            found = [clash for clash in self.first_clashes(start, end, deviation) if clash is not None]
            if found:
                return min(found, key=lambda clash: clash.distance - clash.clearance)
        return None

    def _judge(
        self, at: Array, half_travel: Array, slack: Array, required: Array, unproved: Flags
    ) -> tuple[Array, Flags, Flags]:
        """Distances (n, pairs), m, at the middles of intervals, and which pairs are proved or violate there."""
        moved, strayed = self._bounds.pairs(at, np.stack([half_travel + slack, slack]))
        searched = unproved & (moved <= _FARTHEST_SEARCH + strayed)
        bound = np.where(searched, required + moved, 0.0)
        poses = self._nominal.body_poses(at[:, :-1], at[:, -1])
        distance = self._scene.distances(poses, bound, self._threads)
        return distance, searched & (distance >= bound), searched & (distance < required + strayed)
