"""Vectorised forward, differential and inverse kinematics of a serial arm given by Denavit-Hartenberg parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.geometry import numeric_ik, pose, spherical_wrist
from scancell.geometry.continuation import SixJoints
from scancell.geometry.denavit_hartenberg import dh_from_axes

Array = NDArray[np.float64]

_BLOCK = 512  # poses whose solutions are chosen at a time: they stay in the cache
_AT_LIMIT = 1e-9  # rad: solutions that exceed a limit by rounding count as at the limit
_SMALL_LENGTH, _SMALL_ANGLE = 5e-3, np.radians(1.0)  # deviations from an arm with a closed form


@dataclass(frozen=True)
class Joint:
    """Revolute joint by standard Denavit-Hartenberg parameters: m, rad, rad/s, rad/s².

    ``T = Rz(q + theta) T(a, 0, d) Rx(alpha) Ry(beta)``; `theta` is the zero offset and `beta` Hayati's parameter for
    nearly parallel axes.
    """

    a: float
    d: float
    alpha: float
    theta: float = 0.0
    min: float = -np.pi
    max: float = np.pi
    max_speed: float = 1.0
    max_acceleration: float = 1.0
    beta: float = 0.0


# Joints that are added to arms of fewer than six, in general position; lengths in terms of the arm's.
_ADDED = (Joint(0.21, 0.13, 1.1), Joint(0.17, -0.19, 0.7))


@dataclass(frozen=True)
class HeldJoint:
    """Joint number `index`, from 0, that inverse kinematics holds at each of `values` (rad) in turn."""

    index: int
    values: tuple[float, ...]


@dataclass(frozen=True)
class Arm:
    """Serial arm from its base, at `world_from_base` (4, 4), to its flange; tool transforms are up to the caller.

    An arm of more than six joints reaches a pose in infinitely many ways: `ik` holds one joint for each beyond six.
    """

    joints: Sequence[Joint]
    world_from_base: Array = field(default_factory=lambda: np.eye(4))
    held: Sequence[HeldJoint] = ()

    def column(self, name: str) -> Array:
        """One field of all joints, (joints,)."""
        return np.array([getattr(joint, name) for joint in self.joints], float)

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

    def link_poses(self, q: ArrayLike) -> Array:
        """``world_from_link`` (..., joints + 1, 4, 4) at q (..., joints), rad: base first, flange last."""
        angle = np.asarray(q, float) + self.column("theta")
        step = np.zeros((*angle.shape, 4, 4))
        alpha, beta = self.column("alpha"), self.column("beta")
        step[..., :3, :3] = pose.rotation_about(2, angle) @ pose.rotation_about(0, alpha) @ pose.rotation_about(1, beta)
        step[..., 0, 3] = self.column("a") * np.cos(angle)
        step[..., 1, 3] = self.column("a") * np.sin(angle)
        step[..., 2, 3] = self.column("d")
        step[..., 3, 3] = 1.0
        frames = [np.broadcast_to(self.world_from_base, (*angle.shape[:-1], 4, 4))]
        for i in range(angle.shape[-1]):
            frames.append(frames[-1] @ step[..., i, :, :])
        return np.stack(frames, -3)

    def fk(self, q: ArrayLike) -> Array:
        """Forward kinematics: ``world_from_flange`` (..., 4, 4) at q (..., joints), rad."""
        return np.asarray(self.link_poses(q)[..., -1, :, :])

    def jacobian(self, q: ArrayLike) -> Array:
        """Geometric Jacobian (..., 6, joints) of the flange in world axes: linear velocity, then angular velocity."""
        frames = self.link_poses(q)
        axes = frames[..., :-1, :3, 2]
        lever = frames[..., -1:, :3, 3] - frames[..., :-1, :3, 3]
        return np.swapaxes(np.concatenate([np.cross(axes, lever), axes], -1), -1, -2)

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

    def ik_along(self, paths: ArrayLike, reference: ArrayLike | None = None, filtered: bool = True) -> Array:
        """Joint angles (n, k, branches, joints), rad, along paths of poses (n, k, 4, 4): a branch is one motion.

        Numbered branches are those of `ik` at the first pose, continued. Parameters as in `ik`.
        """
        paths = np.asarray(paths, float)
        found = [part.along(paths) for part in self._parts]
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
    def _parts(self) -> list[_Part]:
        """Solvers for each combination of values of the held joints."""
        values = product(*(joint.values for joint in self.held))
        return [_Part(self, dict(zip((joint.index for joint in self.held), v, strict=True))) for v in values]


class _Part:
    """Inverse kinematics with the joints numbered in `held` at its angles: that of the arm of all other joints."""

    def __init__(self, arm: Arm, held: dict[int, float]) -> None:
        self._held = held
        self._count = len(arm.joints)
        self._free = [i for i in range(self._count) if i not in held]
        self._flange_from_end = np.eye(4)
        self._arm = self._reduced(arm) if held else arm
        self._theta = self._arm.column("theta")
        self.dimensions = self._closed_form_dimensions()

    @property
    def suffix(self) -> str:
        return "".join(f", joint {i + 1} at {np.degrees(value):g} deg" for i, value in self._held.items())

    @property
    def is_named(self) -> bool:
        return self.dimensions is not None or self._neighbour is not None

    @property
    def branch_names(self) -> tuple[str, ...]:
        if self.is_named:
            return spherical_wrist.BRANCH_NAMES
        return tuple(str(i) for i in range(1, numeric_ik.number_of_branches(self._chain[0]) + 1))

    def along(self, paths: Array) -> Array:
        """Joints (n, k, branches, joints) of the whole arm along paths (n, k, 4, 4), without regard to limits."""
        targets = paths @ self._flange_from_end
        n, k = paths.shape[:2]
        if self.is_named:
            q = self._configurations(targets.reshape(-1, 4, 4))
            q = q.reshape(n, k, *q.shape[1:])
        else:
            q = self._continued(targets)
        if not self._held:
            return q
        whole = np.full((*q.shape[:-1], self._count), np.nan)
        whole[..., self._free] = q
        for index, value in self._held.items():
            whole[..., index] = np.where(np.isfinite(q[..., 0]), value, np.nan)
        return whole

    def distance_outside_reach(self, targets: Array) -> Array:
        if self.dimensions is None:
            return np.full(len(targets), np.nan)
        base_from_end = pose.inverse(self._arm.world_from_base) @ targets @ self._flange_from_end
        return spherical_wrist.distance_outside_reach(*self.dimensions, base_from_end)

    def _reduced(self, arm: Arm) -> Arm:
        q = np.zeros(self._count)
        for index, value in self._held.items():
            q[index] = value
        frames = replace(arm, world_from_base=np.eye(4)).link_poses(q)
        axes = frames[self._free]
        chain = dh_from_axes(axes[:, :3, 3], axes[:, :3, 2], frames[-1])
        self._flange_from_end = pose.inverse(chain.last_from_end)
        rows = zip(chain.a, chain.d, chain.alpha, chain.theta, strict=True)
        joints = [Joint(*(float(value) for value in row)) for row in rows]
        return Arm(joints, arm.world_from_base @ chain.base_from_first)

    def _closed_form_dimensions(self) -> tuple[Array, Array, Array] | None:
        """a, d and alpha of the closed form. Where axes 2 and 3 are opposed, joint 3 counts the other way round."""
        if len(self._arm.joints) != 6:
            return None
        a, d, alpha, beta = (self._arm.column(name) for name in ("a", "d", "alpha", "beta"))
        self._sign = np.ones(6)
        if np.cos(alpha[1]) < 0:  # Rx(pi) Rz(q) T(a, 0, d) = Rz(-q) T(a, 0, -d) Rx(pi)
            self._sign[2], d[2] = -1.0, -d[2]
            alpha[1:3] += np.pi
        return (a, d, alpha) if spherical_wrist.is_supported(a, d, alpha, beta) else None

    def _configurations(self, targets: Array) -> Array:
        """Branches (n, 8, 6) in closed form, or refined from those of an arm nearby."""
        if self.dimensions is None:
            assert self._neighbour is not None
            seeds = self._neighbour.ik(targets, filtered=False)
            return numeric_ik.refined(self._arm, targets, seeds)
        base_from_end = pose.inverse(self._arm.world_from_base) @ targets
        return np.asarray(self._sign * spherical_wrist.solve(*self.dimensions, base_from_end) - self._theta)

    def _continued(self, targets: Array) -> Array:
        """Numbered branches (n, k, branches, joints) along paths (n, k, 4, 4)."""
        chain, flange_from_last = self._chain
        joints, count = len(self._theta), numeric_ik.number_of_branches(chain)
        first = targets[:, 0]
        base_from_last = pose.inverse(self._arm.world_from_base) @ first @ flange_from_last
        seeds = numeric_ik.candidates(chain, joints, base_from_last) - self._theta
        start = numeric_ik.distinct_solutions(self._arm, first, seeds, count)
        path = np.repeat(targets.swapaxes(0, 1), count, axis=1)
        q = numeric_ik.continued(self._arm, path, start.reshape(-1, joints))
        return q.reshape(-1, len(first), count, joints).swapaxes(0, 1)

    @cached_property
    def _chain(self) -> tuple[SixJoints, Array]:
        """The arm with joints added behind its flange up to six, and ``flange_from_last`` when those are at 0."""
        own = self._arm.joints
        reach = sum(float(np.hypot(joint.a, joint.d)) for joint in own)
        added = [replace(joint, a=reach * joint.a, d=reach * joint.d) for joint in _ADDED[: 6 - len(own)]]
        whole = Arm([*own, *added])
        rows = [tuple(float(x) for x in whole.column(name)) for name in ("a", "d", "alpha", "beta")]
        return SixJoints(*rows), Arm(added).fk(np.zeros(len(added)))

    @cached_property
    def _neighbour(self) -> Arm | None:
        """The arm with a closed form from which this one deviates little, as one that was calibrated; None if none."""
        if len(self._arm.joints) != 6:
            return None
        joints = []
        for i, joint in enumerate(self._arm.joints):
            right = np.round(joint.alpha / (np.pi / 2)) * (np.pi / 2)
            a = 0.0 if i in (3, 4) else joint.a
            d = 0.0 if i == 4 else joint.d
            alpha = joint.alpha if i == 5 else right
            if max(abs(a - joint.a), abs(d - joint.d)) > _SMALL_LENGTH:
                return None
            if max(abs(alpha - joint.alpha), abs(joint.beta)) > _SMALL_ANGLE:
                return None
            joints.append(replace(joint, a=a, d=d, alpha=alpha, beta=0.0))
        nearby = Arm(joints, self._arm.world_from_base)
        return nearby if nearby.has_closed_form else None
