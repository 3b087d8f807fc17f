"""Numerical inverse kinematics of arms of up to six joints without a closed form."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from scancell.arrays import Array
from scancell.geometry import continuation, pose
from scancell.geometry.continuation import SixJoints

SAME = 1e-6  # rad: solutions nearer than this count as one

_BLOCK = 128  # poses that are solved at a time: what they need stays in the cache
_NO_TURN = 0.05  # rad: a joint that the arm does not have must end at 0, up to what refinement mends
_LEG = np.array([0.02, 0.1])  # m, rad: longest step along a path from one solution to the next
_LARGEST_CHANGE = 0.5  # rad: of a joint in such a step; more means another branch


class Kinematics(Protocol):
    """Interface of an arm for the solver."""

    def fk(self, q: Array) -> Array: ...

    def jacobian(self, q: Array) -> Array: ...


def refine(arm: Kinematics, targets: Array, seeds: Array, iterations: int = 60) -> Array:
    """Joints (n, joints), rad, whose flange pose is `targets` (n, 4, 4), from seeds; NaN without convergence.

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
        # Singular values, because normal equations would square the condition near singular poses.
        u, value, vt = np.linalg.svd(jacobian, full_matrices=False)
        along = (np.swapaxes(u, -1, -2) @ error[active][..., None])[..., 0]
        along *= value / (value**2 + damping[active, None])
        step = (np.swapaxes(vt, -1, -2) @ along[..., None])[..., 0]
        trial = q[active] + np.clip(step, -0.5, 0.5)
        trial_error = _error(arm, targets[active], trial) * weight
        trial_cost = (trial_error**2).sum(-1)
        better = trial_cost < cost[active]
        accepted = active[better]
        q[accepted], error[accepted], cost[accepted] = trial[better], trial_error[better], trial_cost[better]
        damping[active] = np.clip(np.where(better, damping[active] * 0.1, damping[active] * 10), 1e-22, 1e2)
    q[~(cost < 1e-24)] = np.nan
    return q


def number_of_branches(chain: SixJoints) -> int:
    """Most real solutions that any pose of the chain can have in general position."""
    return int(continuation.start(chain, 0).theta.shape[1])


def candidates(chain: SixJoints, joints: int, base_from_end: Array) -> Array:
    """Angles theta (n, m, joints) near all solutions for targets (n, 4, 4), NaN beyond, to be refined.

    The joints of the chain beyond the first `joints` are not the arm's: solutions that turn them are left out. Where a
    set of solutions may be incomplete, paths are followed once more from another start.
    """
    starts = range(0, max(1, len(base_from_end)), _BLOCK)
    blocks = [_candidates(chain, joints, base_from_end[start : start + _BLOCK]) for start in starts]
    most = max(block.shape[1] for block in blocks)
    return np.concatenate(
        [np.pad(block, ((0, 0), (0, most - block.shape[1]), (0, 0)), constant_values=np.nan) for block in blocks]
    )


def _candidates(chain: SixJoints, joints: int, targets: Array) -> Array:
    found = []
    pending = np.ones(len(targets), bool)
    for number in range(continuation.STARTS):
        start = continuation.start(chain, number)
        theta = np.full((len(targets), start.theta.shape[1], 6), np.nan)
        theta[pending], complete = continuation.solve(chain, start, targets[pending])
        found.append(theta)
        pending[pending] = ~complete
        if not pending.any():
            break
    theta = np.concatenate(found, 1)
    with np.errstate(invalid="ignore"):
        turned = np.abs(_wrap(theta[..., joints:])).max(-1, initial=0.0) > _NO_TURN
    theta[turned] = np.nan
    return theta[..., :joints]


def refined(arm: Kinematics, targets: Array, seeds: Array) -> Array:
    """Distinct solutions (n, m, joints), rad, for targets (n, 4, 4) from seeds (n, m, joints), which may be NaN.

    NaN: duplicates and failures. Solutions nearer than `SAME` in every joint count as one.
    """
    m = seeds.shape[1]
    q = np.full_like(seeds, np.nan)
    usable = np.isfinite(seeds).all(-1)
    q[usable] = refine(arm, np.repeat(targets[:, None], m, axis=1)[usable], seeds[usable])
    for k in range(1, m):
        with np.errstate(invalid="ignore"):
            repeated = (np.abs(_wrap(q[:, :k] - q[:, k : k + 1])).max(-1) < SAME).any(-1)
        q[repeated, k] = np.nan
    return q


def distinct_solutions(arm: Kinematics, targets: Array, seeds: Array, count: int) -> Array:
    """The first `count` of the solutions of `refined`, (n, count, joints), NaN after the last."""
    q = refined(arm, targets, seeds)
    order = np.argsort(np.isnan(q[..., 0]), axis=1, kind="stable")[:, :count]
    return np.take_along_axis(q, order[..., None], 1)


def continued(arm: Kinematics, path: Array, start: Array, on_step: Callable[[int], None] | None = None) -> Array:
    """Joints (k, n, joints), rad, along paths of poses (k, n, 4, 4) that begin at joints `start` (n, joints).

    Poses between are straight. NaN from where a path leaves the reach, or passes a singular pose on another branch.
    `on_step` is called with the number of solutions before they are looked for.
    """
    q = np.concatenate([start[None], np.full((len(path) - 1, *start.shape), np.nan)])
    travelled = np.append(0.0, np.cumsum(_legs(path[:-1], path[1:])))

    def reached(targets: Array, seeds: Array) -> Array:
        found, usable = np.full_like(seeds, np.nan), np.isfinite(seeds).all(-1)
        if on_step is not None:
            on_step(int(usable.sum()))
        found[usable] = refine(arm, targets[usable], seeds[usable], iterations=12)
        found[~(np.abs(found - seeds).max(-1) < _LARGEST_CHANGE)] = np.nan
        return found

    def follow(here: int, there: int) -> None:
        """The end first, then all poses before it from a line between the ends; by halves where some are not found."""
        rows = np.flatnonzero(np.isfinite(q[here]).all(-1))
        begin, end, poses = q[here, rows], q[here, rows], path[here : there + 1, rows]
        length = travelled[there] - travelled[here]
        legs = max(1, int(np.ceil(length)))
        for k in range(1, legs + 1):
            way = np.full(len(rows), k / legs)
            end = reached(poses[-1] if k == legs else pose.interpolate_straight(poses[0], poses[-1], way), end)
        share = (travelled[here + 1 : there, None, None] - travelled[here]) / max(length, 1e-300)
        between = np.concatenate([reached(poses[1:-1], begin + share * (end - begin)), end[None]])
        if there == here + 1 or np.isfinite(between).all():
            q[here + 1 : there + 1, rows] = between
        else:
            middle = (here + there) // 2
            follow(here, middle)
            follow(middle, there)

    here = 0
    while here < len(path) - 1:
        farthest = int(np.searchsorted(travelled, travelled[here] + 1.0, "right")) - 1
        there = min(max(here + 1, farthest), here + _BLOCK)
        follow(here, there)
        here = there
    return q


def _legs(here: Array, there: Array) -> Array:
    """Steps (k,) that paths (k, n, 4, 4) need from poses to the next ones, as real numbers."""
    distance = np.linalg.norm(there[..., :3, 3] - here[..., :3, 3], axis=-1).max(-1, initial=0.0)
    turn = pose.log_rotation(np.swapaxes(here[..., :3, :3], -1, -2) @ there[..., :3, :3])
    angle = np.linalg.norm(turn, axis=-1).max(-1, initial=0.0)
    return np.asarray((np.stack([distance, angle], -1) / _LEG).max(-1))


def _error(arm: Kinematics, targets: Array, q: Array) -> Array:
    """Pose error (n, 6), target minus current, in world axes: position (m), rotation vector (rad)."""
    current = arm.fk(q)
    rotation = targets[:, :3, :3] @ np.swapaxes(current[:, :3, :3], -1, -2)
    return np.concatenate([targets[:, :3, 3] - current[:, :3, 3], pose.log_rotation(rotation)], -1)


def _wrap(angle: Array) -> Array:
    return np.asarray(np.remainder(angle + np.pi, 2 * np.pi) - np.pi)
