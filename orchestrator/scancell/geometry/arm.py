"""Serial arm: its kinematics, joint limits and turns, and all branches of its inverse kinematics."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.geometry.branches import Branches
from scancell.geometry.chain import Chain, Joint

__all__ = ["Arm", "HeldJoint", "Joint"]

Array = NDArray[np.float64]

_BLOCK = 512  # poses whose solutions are chosen at a time: they stay in the cache
_AT_LIMIT = 1e-9  # rad: solutions that exceed a limit by rounding count as at the limit


@dataclass(frozen=True)
class HeldJoint:
    """Joint number `index`, from 0, that inverse kinematics holds at each of `values` (rad) in turn."""

    index: int
    values: tuple[float, ...]


@dataclass(frozen=True)
class Arm(Chain):
    """Serial arm from its base, at `world_from_base` (4, 4), to its flange; tool transforms are up to the caller.

    An arm of more than six joints reaches a pose in infinitely many ways: `ik` holds one joint for each beyond six.
    """

    held: Sequence[HeldJoint] = ()

    @property
    def limits(self) -> Array:
        """Lower and upper joint limits (2, joints), rad."""
        return np.stack([self.column("min"), self.column("max")])

    @property
    def max_speed(self) -> Array:
        """Joint speed limits (joints,), rad/s."""
        return self.column("max_speed")

    @property
    def max_acceleration(self) -> Array:
        """Joint acceleration limits (joints,), rad/s²."""
        return self.column("max_acceleration")

    @property
    def has_closed_form(self) -> bool:
        """Whether `ik` is in closed form rather than numerical."""
        return all(part.dimensions is not None for part in self._parts)

    @property
    def has_named_branches(self) -> bool:
        """Whether a branch of `ik` is one configuration at all poses, rather than a number at each."""
        return all(part.is_named for part in self._parts)

    @cached_property
    def branch_names(self) -> tuple[str, ...]:
        """Names of the branches of `ik`: configurations where there is a closed form, else numbers from 1.

        Where joints are held, the names end with the values of those.
        """
        return tuple(name + part.suffix for part in self._parts for name in part.branch_names)

    def within_limits(self, q: ArrayLike, margin: float = 0.0) -> NDArray[np.bool_]:
        """Whether every joint of q (..., joints) is inside its limits by `margin` (rad), (...,); false for NaN."""
        q = np.asarray(q, float)
        lower, upper = self.limits
        return np.asarray(((q >= lower + margin) & (q <= upper - margin)).all(-1))

    def limit_violation(self, q: ArrayLike) -> Array:
        """Angle (..., joints), rad, by which each joint of q (..., joints) is outside its limits; 0 inside."""
        q = np.asarray(q, float)
        lower, upper = self.limits
        return np.asarray(np.maximum(0.0, np.maximum(lower - q, q - upper)))

    def nearest_turn(self, q: ArrayLike, reference: ArrayLike | None = None) -> Array:
        """q (..., joints) with multiples of 2 pi added per joint: inside the limits if possible, near `reference`.

        `reference` defaults to the middle of the joint range. A joint that cannot be brought inside its limits ends
        as near to them as possible.
        """
        q = np.asarray(q, float)
        lower, upper = self.limits
        goal = (lower + upper) / 2 if reference is None else np.asarray(reference, float)
        turn = 2 * np.pi
        # Between the fewest turns that reach the lower limit and the most that keep the upper one.
        least, most = np.ceil((lower - _AT_LIMIT - q) / turn), np.floor((upper + _AT_LIMIT - q) / turn)
        nearest = np.clip(np.rint((goal - q) / turn), least, most)
        # Where none is inside, `most` ends below the limits and `least` above.
        too_low, too_high = lower - (q + turn * most), q + turn * least - upper
        nearest = np.where(least <= most, nearest, np.where(too_low < too_high, most, least))
        return np.asarray(q + turn * nearest)

    def ik(self, world_from_flange: ArrayLike, reference: ArrayLike | None = None, filtered: bool = True) -> Array:
        """Inverse kinematics: joint angles (n, branches, joints), rad, for targets (n, 4, 4); NaN without a solution.

        Closed form where there is one (`scancell.geometry.spherical_wrist`), else numerical (`continuation`): all
        isolated solutions; of the infinitely many at a singular pose some; two closer than 1e-4 rad count as one. An
        arm of fewer than six joints attains few poses. Numbered branches are in no order from one pose to another, see
        `ik_along`.

        Parameters
        ----------
        reference
            (joints,) or (n, joints) joints near which multiples of 2 pi are chosen, see `nearest_turn`.
        filtered
            Whether branches that violate a joint limit become NaN, as branches without a solution do.
        """
        targets = np.asarray(world_from_flange, float).reshape(-1, 1, 4, 4)
        return self.ik_along(targets, reference, filtered)[:, 0]

    def ik_along(
        self,
        paths: ArrayLike,
        reference: ArrayLike | None = None,
        filtered: bool = True,
        on_step: Callable[[int], None] | None = None,
    ) -> Array:
        """Joint angles (n, k, branches, joints), rad, along paths of poses (n, k, 4, 4): a branch is one motion.

        Numbered branches are those of `ik` at the first pose, continued; `on_step` is called with the number of
        solutions before each step of that. Other parameters as in `ik`.
        """
        paths = np.asarray(paths, float)
        found = [part.along(paths, on_step) for part in self._parts]
        q = found[0] if len(found) == 1 else np.concatenate(found, axis=2)
        if reference is not None:
            reference = np.broadcast_to(np.asarray(reference, float), (len(paths), len(self.joints)))[:, None, None]
        for start in range(0, len(q), _BLOCK):
            rows = slice(start, start + _BLOCK)
            q[rows] = self._chosen(q[rows], None if reference is None else reference[rows], filtered)
        return q

    def _chosen(self, q: Array, reference: Array | None, filtered: bool) -> Array:
        """Solutions (..., joints) in the turn to choose, NaN outside the limits if `filtered`."""
        turned = self.nearest_turn(q, reference)
        held = [joint.index for joint in self.held]
        turned[..., held] = q[..., held]
        if not filtered:
            return turned
        inside = np.clip(turned, *self.limits)
        within = (np.abs(turned - inside) <= _AT_LIMIT).all(-1)
        inside[~within] = np.nan
        return inside

    def distance_outside_reach(self, world_from_flange: ArrayLike) -> Array:
        """Distance (n,), m, of the wrist centre of targets (n, 4, 4) from its reach; NaN without a closed form."""
        targets = np.asarray(world_from_flange, float).reshape(-1, 4, 4)
        return np.asarray(np.min([part.distance_outside_reach(targets) for part in self._parts], axis=0))

    @cached_property
    def _parts(self) -> list[Branches]:
        """Solvers for each combination of values of the held joints."""
        values = product(*(joint.values for joint in self.held))
        return [Branches(self, dict(zip((joint.index for joint in self.held), v, strict=True))) for v in values]
