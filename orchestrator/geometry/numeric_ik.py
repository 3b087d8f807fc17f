"""Inverse kinematics by damped least squares, for arms without a closed form (as-built arms, other geometries)."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from orchestrator.geometry import pose

Array = NDArray[np.float64]


class Kinematics(Protocol):
    """What the iteration needs of an arm."""

    def fk(self, q: Array) -> Array: ...

    def jacobian(self, q: Array) -> Array: ...


def refine(arm: Kinematics, targets: Array, seeds: Array, iterations: int = 60) -> Array:
    """Joints (n, 6) that bring the flange to `targets` (n, 4, 4), starting from `seeds` (n, 6); NaN if they do not.

    Levenberg-Marquardt on the error (position in metres, rotation vector in radians times 0.3 m, so that both
    weigh alike at arm's length), each row with its own damping.
    """
    q = seeds.copy()
    weight = np.array([1.0, 1.0, 1.0, 0.3, 0.3, 0.3])
    damping = np.full(len(q), 1e-6)
    error = _error(arm, targets, q) * weight
    cost = (error**2).sum(-1)
    for _ in range(iterations):
        busy = np.flatnonzero(np.isfinite(cost) & (cost > 1e-28))
        if len(busy) == 0:
            break
        jacobian = arm.jacobian(q[busy]) * weight[:, None]
        normal = np.swapaxes(jacobian, -1, -2) @ jacobian
        normal += damping[busy, None, None] * np.eye(q.shape[-1])
        step = np.linalg.solve(normal, np.swapaxes(jacobian, -1, -2) @ error[busy][..., None])[..., 0]
        trial = q[busy] + np.clip(step, -0.5, 0.5)
        trial_error = _error(arm, targets[busy], trial) * weight
        trial_cost = (trial_error**2).sum(-1)
        better = trial_cost < cost[busy]
        accepted = busy[better]
        q[accepted], error[accepted], cost[accepted] = trial[better], trial_error[better], trial_cost[better]
        damping[busy] = np.clip(np.where(better, damping[busy] * 0.1, damping[busy] * 10), 1e-15, 1e2)
    q[~(cost < 1e-20)] = np.nan
    return q


def solve_branches(arm: Kinematics, targets: Array, seeds: Array) -> Array:
    """Refine several seeds (n, m, 6) per target; solutions found twice are kept once, the others become NaN."""
    n, m, joints = seeds.shape
    flat = refine(arm, np.repeat(targets, m, axis=0), seeds.reshape(-1, joints))
    q = flat.reshape(n, m, joints)
    for k in range(1, m):
        gap = np.remainder(q[:, :k] - q[:, k : k + 1] + np.pi, 2 * np.pi) - np.pi
        with np.errstate(invalid="ignore"):
            repeated = (np.abs(gap).max(-1) < 1e-6).any(-1)
        q[repeated, k] = np.nan
    return q


def _error(arm: Kinematics, targets: Array, q: Array) -> Array:
    """Twist-like error (n, 6), world axes: what is missing in position and in rotation."""
    reached = arm.fk(q)
    turn = targets[:, :3, :3] @ np.swapaxes(reached[:, :3, :3], -1, -2)
    # NaN seeds stay NaN rather than confuse the quaternion's argmax.
    known = np.asarray(np.isfinite(q).all(-1))
    missing = np.where(known[:, None], pose.log_rotation(np.nan_to_num(turn)), np.nan)
    return np.concatenate([targets[:, :3, 3] - reached[:, :3, 3], missing], -1)
