"""Pairs of bodies within their clearance: a motion must not bring them nearer than they were when they came there.

They have no distance for a stop, so requiring one would prevent every motion that separates them.  A motion that never
brings such a pair nearer is permitted.  Where the start of a motion is known by measured angles only, an approach
within their errors is permitted as well, but only once: the minimum distance is stored until the pair has its clearance
again, over any number of motions and sessions.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.nominal.cell import NominalCell
from scancell.proximity.motion_bounds import MotionBounds

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

_ROUNDING = 5e-6  # m: of proofs, which need some room
_NEARER, _NEARER_SHARE = 0.2e-3, 0.1  # m, and share of its distance, by which a pair may come nearer that does not

STILL = 1e-9  # m: pairs whose distance changes less in a short motion do not approach


class NearPairs:
    """Distances that pairs within their clearance have to keep.

    Parameters
    ----------
    nominal
        Kinematics and bodies.
    pairs
        Names of the bodies of each pair.
    clearance
        Distance that counts as contact, one for all pairs or (pairs,), m.
    angle_error
        Of the measured angles, one or (axes,), rad.

    Attributes
    ----------
    clearance, angle_error
        As given, (pairs,), m, and (axes,), rad.
    """

    def __init__(
        self, nominal: NominalCell, pairs: Sequence[tuple[str, str]], clearance: ArrayLike, angle_error: ArrayLike
    ) -> None:
        self._pairs, self._bounds = pairs, MotionBounds(nominal, pairs)
        self.clearance = np.broadcast_to(np.asarray(clearance, float), (len(pairs),))
        self.angle_error = np.broadcast_to(np.asarray(angle_error, float), (len(nominal.arm.joints) + 1,))
        self._begins = True
        self.release()

    def release(self) -> None:
        """Forget all pairs: each has its clearance again."""
        self._kept = np.full(len(self.clearance), np.inf)

    def take_over(self, before: NearPairs) -> None:
        """Keep the distances of those pairs that other bodies of a cell had `before`."""
        kept = dict(zip(before._pairs, before._kept.tolist(), strict=True))
        self._kept = np.array([kept.get(pair, np.inf) for pair in self._pairs])
        self._begins = before._begins

    def begin_session(self) -> None:
        """Accept in the next update that something else than a permitted motion has brought pairs nearer."""
        self._begins = True

    def update(self, axes: Array, distance: Array, exact: bool) -> tuple[Flags, Array]:
        """Which pairs (pairs,) are within their clearance, and the distances (pairs,), m, that those have to keep.

        Where a session begins, a pair that is nearer than its stored distance by more than errors of the angles explain
        keeps its present distance: only something else than a permitted motion has brought it there.

        Parameters
        ----------
        axes
            Joints and table angle where the motion begins, (axes,), rad.
        distance
            Of the pairs at `axes`, (pairs,), m; NaN or infinite for pairs that have their room.
        exact
            Whether `axes` are set-points, not measured.
        """
        of_axes = self._bounds.pairs(axes[None], np.diag(self.angle_error)[:, None])[:, 0]
        near = distance <= self.clearance + of_axes.sum(0)
        # The errors of the axes are independent.
        feigned = np.zeros(len(near)) if exact else np.sqrt((of_axes**2).sum(0))
        stays = np.isfinite(self._kept) & ((distance >= self._kept - feigned - _ROUNDING) | (not self._begins))
        self._begins = False
        self._kept = np.where(near, np.where(stays, self._kept, distance - feigned - _ROUNDING), np.inf)
        return near, np.where(near, self._kept, -np.inf)


def almost(distance: Array, clearance: Array) -> Array:
    """Distances (pairs,), m, that pairs with their `clearance` keep if a motion does not reduce their `distance`."""
    return np.maximum(clearance, distance - np.maximum(_NEARER, _NEARER_SHARE * distance))
