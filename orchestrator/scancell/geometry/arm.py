"""Vectorised forward, differential and inverse kinematics of a serial arm given by Denavit-Hartenberg parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.geometry import numeric_ik, pose, spherical_wrist
from scancell.geometry.spherical_wrist import BRANCH_NAMES

Array = NDArray[np.float64]

__all__ = ["BRANCH_NAMES", "Arm", "Joint"]


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


@dataclass(frozen=True)
class Arm:
    """Serial arm from its base, at `world_from_base` (4, 4), to its flange; tool transforms are up to the caller."""

    joints: Sequence[Joint]
    world_from_base: Array = field(default_factory=lambda: np.eye(4))

    def _column(self, name: str) -> Array:
        return np.array([getattr(joint, name) for joint in self.joints], float)

    @property
    def limits(self) -> Array:
        """Lower and upper joint limits (2, joints), rad."""
        return np.stack([self._column("min"), self._column("max")])

    @property
    def max_speed(self) -> Array:
        """Joint speed limits (joints,), rad/s."""
        return self._column("max_speed")

    @property
    def max_acceleration(self) -> Array:
        """Joint acceleration limits (joints,), rad/s²."""
        return self._column("max_acceleration")

    @property
    def has_closed_form(self) -> bool:
        """Whether `ik` is in closed form (all branches) rather than numerical (solutions near the seeds)."""
        return len(self.joints) == 6 and spherical_wrist.is_supported(
            self._column("a"), self._column("d"), self._column("alpha"), self._column("beta")
        )

    def link_poses(self, q: ArrayLike) -> Array:
        """``world_from_link`` (..., joints + 1, 4, 4) at q (..., joints), rad: base first, flange last."""
        angle = np.asarray(q, float) + self._column("theta")
        step = np.zeros((*angle.shape, 4, 4))
        alpha, beta = self._column("alpha"), self._column("beta")
        step[..., :3, :3] = pose.rotation_about(2, angle) @ pose.rotation_about(0, alpha) @ pose.rotation_about(1, beta)
        step[..., 0, 3] = self._column("a") * np.cos(angle)
        step[..., 1, 3] = self._column("a") * np.sin(angle)
        step[..., 2, 3] = self._column("d")
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
        base = q + turn * np.round((np.broadcast_to(goal, q.shape) - q) / turn)
        options = base[..., None] + turn * np.array([0.0, -1.0, 1.0, -2.0, 2.0])
        outside = np.maximum(0.0, np.maximum(lower[:, None] - options, options - upper[:, None]))
        cost = 1e6 * outside + np.abs(options - np.broadcast_to(goal, q.shape)[..., None])
        best = np.argmin(cost, axis=-1)
        return np.asarray(np.take_along_axis(options, best[..., None], -1)[..., 0])

    def ik(self, world_from_flange: ArrayLike, reference: ArrayLike | None = None, filtered: bool = True) -> Array:
        """Inverse kinematics: joint angles (n, 8, 6), rad, of all branches (`BRANCH_NAMES`) for targets (n, 4, 4).

        Without a closed form the solutions are numerical, from the branches of the nearest arm that has one, or from
        random seeds; the order of branches is then arbitrary.

        Parameters
        ----------
        reference
            (6,) or (n, 6) joints near which multiples of 2 pi are chosen, see `nearest_turn`.
        filtered
            Whether branches that violate a joint limit become NaN, as branches without a solution do.
        """
        targets = np.asarray(world_from_flange, float).reshape(-1, 4, 4)
        if reference is not None:
            reference = np.broadcast_to(np.asarray(reference, float), (len(targets), 6))[:, None]
        if self.has_closed_form:
            base_from_flange = pose.inverse(self.world_from_base) @ targets
            theta = spherical_wrist.solve(self._column("a"), self._column("d"), self._column("alpha"), base_from_flange)
            q = theta - self._column("theta")
        else:
            q = numeric_ik.solve_branches(self, targets, self._seeds(targets))
        q = self.nearest_turn(q, reference)
        return np.where(self.within_limits(q)[..., None], q, np.nan) if filtered else q

    def distance_outside_reach(self, world_from_flange: ArrayLike) -> Array:
        """Distance (n,), m, of the wrist centre of targets (n, 4, 4) from its reach; NaN without a closed form."""
        targets = np.asarray(world_from_flange, float).reshape(-1, 4, 4)
        if not self.has_closed_form:
            return np.full(len(targets), np.nan)
        base_from_flange = pose.inverse(self.world_from_base) @ targets
        dimensions = (self._column("a"), self._column("d"), self._column("alpha"))
        return spherical_wrist.distance_outside_reach(*dimensions, base_from_flange)

    def _seeds(self, targets: Array) -> Array:
        """Initial joints (n, 8, 6) of the numerical solution."""
        idealised = self._closed_form_approximation()
        if idealised is not None:
            seeds = idealised.ik(targets, filtered=False)
            if np.isfinite(seeds).any():
                return seeds
        lower, upper = self.limits
        fractions = np.random.default_rng(0).uniform(0.1, 0.9, (8, len(self.joints)))
        return np.broadcast_to(lower + fractions * (upper - lower), (len(targets), 8, len(self.joints)))

    def _closed_form_approximation(self) -> Arm | None:
        """The nearest arm with a closed form, its deviations (as-built) removed; None when there is none."""
        if len(self.joints) != 6:
            return None
        joints = []
        for i, joint in enumerate(self.joints):
            right = np.round(joint.alpha / (np.pi / 2)) * (np.pi / 2)
            in_wrist = i in (3, 4)
            a = 0.0 if in_wrist else joint.a
            d = 0.0 if i == 4 else joint.d
            alpha = joint.alpha if i == 5 else right
            joints.append(replace(joint, a=a, d=d, alpha=alpha, beta=0.0))
        idealised = Arm(joints, self.world_from_base)
        return idealised if idealised.has_closed_form else None
