"""Numerical inverse kinematics by damped least squares, for arms without a closed form."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from scancell.geometry import pose

Array = NDArray[np.float64]


class Kinematics(Protocol):
    """Interface of an arm for the solver."""

    def fk(self, q: Array) -> Array: ...

    def jacobian(self, q: Array) -> Array: ...


def refine(arm: Kinematics, targets: Array, seeds: Array, iterations: int = 60) -> Array:
    """Joints (n, 6), rad, whose flange pose is `targets` (n, 4, 4), from `seeds` (n, 6); NaN without convergence.

    Levenberg-Marquardt on the pose error (position in m; rotation vector in rad times 0.3 m, for comparable weight),
    with separate damping for each row.
    """
    q = seeds.copy()
    weight = np.array([1.0, 1.0, 1.0, 0.3, 0.3, 0.3])
    damping = np.full(len(q), 1e-6)
    error = _error(arm, targets, q) * weight
    cost = (error**2).sum(-1)
    for _ in range(iterations):
        active = np.flatnonzero(np.isfinite(cost) & (cost > 1e-28))
        if len(active) == 0:
            break
        jacobian = arm.jacobian(q[active]) * weight[:, None]
        normal = np.swapaxes(jacobian, -1, -2) @ jacobian
        normal += damping[active, None, None] * np.eye(q.shape[-1])
        step = np.linalg.solve(normal, np.swapaxes(jacobian, -1, -2) @ error[active][..., None])[..., 0]
        trial = q[active] + np.clip(step, -0.5, 0.5)
        trial_error = _error(arm, targets[active], trial) * weight
        trial_cost = (trial_error**2).sum(-1)
        better = trial_cost < cost[active]
        accepted = active[better]
        q[accepted], error[accepted], cost[accepted] = trial[better], trial_error[better], trial_cost[better]
        damping[active] = np.clip(np.where(better, damping[active] * 0.1, damping[active] * 10), 1e-15, 1e2)
    q[~(cost < 1e-20)] = np.nan
    return q


def solve_branches(arm: Kinematics, targets: Array, seeds: Array) -> Array:
    """Distinct solutions (n, m, 6), rad, for targets (n, 4, 4) from seeds (n, m, 6); NaN: duplicates and failures."""
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
    """Pose error (n, 6), target minus current, in world axes: position (m), rotation vector (rad)."""
    current = arm.fk(q)
    rotation = targets[:, :3, :3] @ np.swapaxes(current[:, :3, :3], -1, -2)
    # NaN seeds stay NaN: the quaternion's argmax would hide them.
    finite = np.asarray(np.isfinite(q).all(-1))
    rotation_vector = np.where(finite[:, None], pose.log_rotation(np.nan_to_num(rotation)), np.nan)
    return np.concatenate([targets[:, :3, 3] - current[:, :3, 3], rotation_vector], -1)
