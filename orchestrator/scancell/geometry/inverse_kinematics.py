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


BRANCH_NAMES = tuple(
    f"{shoulder}-{elbow}-{wrist}"
    for shoulder in ("lefty", "righty")
    for elbow in ("above", "below")
    for wrist in ("noflip", "flip")
)
"""Names of the eight branches, in the order of `solve`.

lefty: the wrist centre is in front of axis 1 (righty: the arm reaches backwards over it); above: the elbow is above
the line from shoulder to wrist centre; noflip: joint 5 is positive (theta offset included).
"""

_ROUNDING = 1e-11
_WRIST_BLOCK = 512  # poses that are solved at a time: what they need stays in the cache


def has_spherical_wrist(a: Array, d: Array, alpha: Array, beta: Array) -> bool:
    """Whether an arm with these Denavit-Hartenberg parameters (6,) each has this closed form."""
    right_angles = np.abs(np.cos(alpha[[0, 2, 3, 4]])) < 1e-12
    zeros = np.abs(np.array([a[3], a[4], d[4], np.sin(alpha[1]), *beta])) < 1e-12
    return bool(right_angles.all() and zeros.all() and np.cos(alpha[1]) > 0 and abs(a[1]) > 0)


def spherical_wrist_solutions(a: Array, d: Array, alpha: Array, base_from_flange: Array, slack: float = 0.0) -> Array:
    """Joint angles theta (n, 8, 6) in (-pi, pi] of all branches for targets (n, 4, 4); NaN without a solution.

    Of targets whose wrist centre is within `slack`, m, of where two arm branches meet, on either side, those are
    angles near both.
    """
    theta = np.empty((len(base_from_flange), 8, 6))
    for start in range(0, len(theta), _WRIST_BLOCK):
        rows = slice(start, start + _WRIST_BLOCK)
        rotation = np.ascontiguousarray(base_from_flange[rows, :3, :3].transpose(1, 2, 0))
        position = np.ascontiguousarray(base_from_flange[rows, :3, 3].T)
        theta[rows] = _solve_block(a, d, alpha, rotation, position, slack).transpose(3, 0, 1, 2).reshape(-1, 8, 6)
    return theta


def distance_outside_reach(a: Array, d: Array, alpha: Array, base_from_flange: Array) -> Array:
    """Distance (n,), m, by which the wrist centre of targets (n, 4, 4) is too far or too near; 0 within reach."""
    last = pose.from_rotation(pose.rotation_about(0, alpha[5]), (a[5], 0.0, d[5]))
    x, y, z = (base_from_flange @ pose.inverse(last))[:, :3, 3].T
    forearm = np.hypot(a[2], d[3])
    radial = np.sqrt(np.maximum(x * x + y * y - (d[1] + d[2]) ** 2, 0.0))
    # Both shoulder configurations; the smaller violation counts.
    distance = np.hypot(np.stack([radial, -radial]) - a[0], z - d[0])
    outside = np.maximum(distance - (abs(a[1]) + forearm), abs(abs(a[1]) - forearm) - distance)
    return np.asarray(np.maximum(outside, 0.0).min(0))


def _solve_block(a: Array, d: Array, alpha: Array, rotation: Array, position: Array, slack: float) -> Array:
    """Joint angles (4, 2, 6, m), for arm and wrist branches, of flange rotations (3, 3, m) and positions (3, m)."""
    c, s = np.cos(alpha[5]), np.sin(alpha[5])
    x, y, z = rotation[:, 0], c * rotation[:, 1] - s * rotation[:, 2], s * rotation[:, 1] + c * rotation[:, 2]
    theta = np.empty((4, 2, 6, position.shape[1]))
    with np.errstate(invalid="ignore"):
        theta[:, 0, :3] = _solve_position(a, d, alpha, position - a[5] * x - d[5] * z, slack)
        theta[:, 1, :3] = theta[:, 0, :3]
        _solve_wrist(alpha, np.stack([x, y, z], 1), theta)
        theta -= 2 * np.pi * np.rint(theta / (2 * np.pi))
        theta[theta <= -np.pi] += 2 * np.pi
    return theta


def _solve_position(a: Array, d: Array, alpha: Array, centre: Array, slack: float) -> Array:
    """Joints 1-3 (4, 3, m) of the shoulder and elbow branches for wrist centres (3, m); NaN out of reach."""
    s1, s3 = np.sign(np.sin(alpha[0])), np.sign(np.sin(alpha[2]))
    offset = d[1] + d[2]
    forearm, psi = np.hypot(a[2], d[3]), np.arctan2(-s3 * d[3], a[2])
    x, y, z = centre
    radial = _root(x * x + y * y - offset**2, slack * (2 * abs(offset) + slack)) * np.array([[1.0], [-1.0]])
    turn = np.arctan2(y, x) - np.arctan2(-s1 * offset, radial)
    across, up = radial - a[0], s1 * (z - d[0])
    cosine = (across * across + up * up - (a[1] ** 2 + forearm**2)) / (2 * a[1] * forearm)
    # Near the reach's boundary a radial distance of `slack` changes the cosine by this.
    margin = slack * (abs(a[1]) + forearm) / (abs(a[1]) * forearm)
    # Tolerates rounding when the arm is fully extended.
    cosine = np.where(np.abs(cosine) <= 1 + _ROUNDING + margin, np.clip(cosine, -1 + margin, 1 - margin), np.nan)
    sine = np.sqrt((1 - cosine) * (1 + cosine))
    bend = np.arctan2(sine, cosine)
    slope, lead = np.arctan2(up, across), np.arctan2(forearm * sine, a[1] + forearm * cosine)
    theta = np.empty((4, 3, len(x)))
    for k, (front, above) in enumerate(((1, 1), (1, -1), (-1, 1), (-1, -1))):
        side, sign = (1 - front) // 2, -s1 * front * above
        theta[k, 1] = slope[side] - sign * lead[side]
        theta[k, 2] = sign * bend[side] - psi
        theta[k, 0] = np.where(np.isnan(bend[side]), np.nan, turn[side])
    return theta


def _solve_wrist(alpha: Array, base_from_wrist: Array, theta: Array) -> None:
    """Fill joints 4-6 of theta (4, 2, 6, m) from joints 1-3, for rotations (3, 3, m): noflip, then flip."""
    s1, s3, s4, s5 = np.sign(np.sin(alpha[[0, 2, 3, 4]]))
    sine, cosine = np.sin(theta[::2, 0, 0]), np.cos(theta[::2, 0, 0])
    first_two = base_from_wrist[:2].swapaxes(0, 1)
    # The columns of the wrist seen from link 1: (ahead, s1 * up, -s1 * aside), for both shoulders.
    ahead = cosine[:, None] * first_two[:, 0] + sine[:, None] * first_two[:, 1]
    aside = cosine[:, None] * first_two[:, 1] - sine[:, None] * first_two[:, 0]
    up = s1 * base_from_wrist[2]
    # Rx(±90) Rz(t5) Rx(∓90) = Ry(∓t5): ZYZ angles. Equal signs leave Rx(180), which reverses joint 6.
    reversed_ = -1.0 if s4 == s5 else 1.0
    for k in range(4):
        angle = theta[k, 0, 1] + theta[k, 0, 2]
        c, s = np.cos(angle), np.sin(angle)
        row0 = c * ahead[k // 2] + s * up
        row1 = -s3 * s1 * aside[k // 2]
        row2_z = reversed_ * s3 * (s * ahead[k // 2, 2] - c * up[2])
        along, beside = reversed_ * row0[2], reversed_ * row1[2]
        length = np.sqrt(along * along + beside * beside)
        straight = length < 1e-12
        # noflip: joint 5 is positive.
        scale = -s4 / np.where(straight, 1.0, length)
        c4, s4_ = np.where(straight, 1.0, scale * along), np.where(straight, 0.0, scale * beside)
        # With joint 4 known, Rz(-t4) R = Ry(b) Rz(c) gives joints 5 and 6 without division by sin b.
        pitch = np.arctan2(c4 * along + s4_ * beside, row2_z)
        roll = np.arctan2(c4 * row1[0] - s4_ * row0[0], reversed_ * (c4 * row1[1] - s4_ * row0[1]))
        theta[k, 0, 3], theta[k, 0, 4], theta[k, 0, 5] = np.arctan2(s4_, c4), -s4 * pitch, reversed_ * roll
        theta[k, 1, 3], theta[k, 1, 4] = theta[k, 0, 3] + np.pi, s4 * pitch
        theta[k, 1, 5] = theta[k, 0, 5] + np.pi


def _root(square: Array, slack: float) -> Array:
    """Square root; that of `slack` for values within it, and 0 for those within rounding; NaN below."""
    return np.asarray(np.sqrt(np.where(np.abs(square) < max(slack, _ROUNDING**2), slack, square)))
