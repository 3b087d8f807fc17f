"""Closed-form inverse kinematics of six-joint arms with parallel axes 2 and 3 and a spherical wrist.

The family (standard Denavit-Hartenberg, ``T_i = Rz(theta_i) T(a_i, 0, d_i) Rx(alpha_i)``): alpha_2 = 0, the
other four inner alphas ±90 degrees, a_4 = a_5 = d_5 = 0. Everything else is free, shoulder offsets included.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from orchestrator.geometry import pose

Array = NDArray[np.float64]

BRANCH_NAMES = tuple(
    f"{shoulder}-{elbow}-{wrist}"
    for shoulder in ("lefty", "righty")
    for elbow in ("above", "below")
    for wrist in ("noflip", "flip")
)
"""Names of the eight branches, in the order of `solve`.

lefty: the wrist centre lies in front of axis 1 (righty: the arm reaches over backwards); above: the elbow lies
on the upper side of the line from shoulder to wrist centre; noflip: joint 5 is positive (theta offset included).
"""

_ROUNDING = 1e-11


def belongs(a: Array, d: Array, alpha: Array, beta: Array) -> bool:
    """Whether the four DH columns (6,) describe an arm of this family."""
    right_angles = np.abs(np.cos(alpha[[0, 2, 3, 4]])) < 1e-12
    zeros = np.abs(np.array([a[3], a[4], d[4], np.sin(alpha[1]), *beta])) < 1e-12
    return bool(right_angles.all() and zeros.all() and np.cos(alpha[1]) > 0 and abs(a[1]) > 0)


def solve(a: Array, d: Array, alpha: Array, base_from_flange: Array) -> Array:
    """DH angles (n, 8, 6) in (-pi, pi] of every branch for targets (n, 4, 4); NaN where a branch does not exist."""
    last = pose.from_rotation(pose.rotation_about(0, alpha[5]), (a[5], 0.0, d[5]))
    base_from_wrist = base_from_flange @ pose.inverse(last)
    theta = np.full((len(base_from_flange), 8, 6), np.nan)
    arm_angles = _solve_position(a, d, alpha, base_from_wrist[:, :3, 3])
    theta[:, :, :3] = np.repeat(arm_angles, 2, axis=1)
    theta[:, :, 3:] = _solve_wrist(a, d, alpha, base_from_wrist[:, :3, :3], arm_angles)
    theta[~np.isfinite(theta).all(-1)] = np.nan
    return np.asarray(np.where(theta <= -np.pi, theta + 2 * np.pi, theta))


def shortfall(a: Array, d: Array, alpha: Array, base_from_flange: Array) -> Array:
    """Metres (n,) by which the wrist centre lies beyond (or too near for) the arm's reach, 0 within it."""
    last = pose.from_rotation(pose.rotation_about(0, alpha[5]), (a[5], 0.0, d[5]))
    x, y, z = (base_from_flange @ pose.inverse(last))[:, :3, 3].T
    forearm = np.hypot(a[2], d[3])
    radial = np.sqrt(np.maximum(x * x + y * y - (d[1] + d[2]) ** 2, 0.0))
    # The nearer of the two shoulder positions decides; so does the nearer end of the reach.
    distance = np.hypot(np.stack([radial, -radial]) - a[0], z - d[0])
    outside = np.maximum(distance - (abs(a[1]) + forearm), abs(abs(a[1]) - forearm) - distance)
    return np.asarray(np.maximum(outside, 0.0).min(0))


def _solve_position(a: Array, d: Array, alpha: Array, centre: Array) -> Array:
    """Joints 1-3 (n, 4, 3): shoulder x elbow choices that bring the wrist centre to `centre` (n, 3)."""
    s1, s3 = np.sign(np.sin(alpha[0])), np.sign(np.sin(alpha[2]))
    offset = d[1] + d[2]
    forearm, psi = np.hypot(a[2], d[3]), np.arctan2(-s3 * d[3], a[2])
    x, y, z = centre.T
    front = np.array([1.0, 1.0, -1.0, -1.0])
    above = np.array([1.0, -1.0, 1.0, -1.0])
    with np.errstate(invalid="ignore"):
        radial = _root(x * x + y * y - offset**2)[:, None] * front
        theta1 = np.arctan2(y, x)[:, None] - np.arctan2(-s1 * offset, radial)
        across, up = radial - a[0], np.broadcast_to((s1 * (z - d[0]))[:, None], radial.shape)
        cosine = (across**2 + up**2 - a[1] ** 2 - forearm**2) / (2 * a[1] * forearm)
        # Rounding may push a fully stretched arm just out of reach.
        cosine = np.where(np.abs(cosine) <= 1 + _ROUNDING, np.clip(cosine, -1, 1), np.nan)
        bend = -s1 * front * above * np.arccos(cosine)
        theta2 = np.arctan2(up, across) - np.arctan2(forearm * np.sin(bend), a[1] + forearm * np.cos(bend))
    return _wrap(np.stack([theta1, theta2, bend - psi], -1))


def _solve_wrist(a: Array, d: Array, alpha: Array, base_from_wrist: Array, arm_angles: Array) -> Array:
    """Joints 4-6 (n, 8, 3), noflip before flip for each of the four arm choices."""
    base_from_link3 = np.broadcast_to(np.eye(3), (*arm_angles.shape[:2], 3, 3))
    for i in range(3):
        turn = pose.rotation_about(2, arm_angles[..., i]) @ pose.rotation_about(0, alpha[i])
        base_from_link3 = base_from_link3 @ turn
    wrist = np.swapaxes(base_from_link3, -1, -2) @ base_from_wrist[:, None]
    s4, s5 = np.sign(np.sin(alpha[3])), np.sign(np.sin(alpha[4]))
    # Rx(±90) Rz(t5) Rx(∓90) = Ry(∓t5): ZYZ angles. Equal signs leave a half turn about X, which reverses joint 6.
    if s4 == s5:
        wrist = wrist @ pose.rotation_about(0, np.pi)
    sine = np.hypot(wrist[..., 0, 2], wrist[..., 1, 2])
    straight = sine < 1e-12
    pitch_sign = -s4 * np.array([1.0, -1.0])
    first = np.arctan2(wrist[..., 1, 2], wrist[..., 0, 2])[..., None] + np.where(pitch_sign > 0, 0.0, np.pi)
    first = np.where(straight[..., None], np.array([0.0, np.pi]), first)
    # With joint 4 known, Rz(-t4) R = Ry(b) Rz(c) gives both others without dividing by sin b.
    rest = pose.rotation_about(2, -first) @ wrist[..., None, :, :]
    pitch = np.arctan2(rest[..., 0, 2], rest[..., 2, 2])
    roll = np.arctan2(rest[..., 1, 0], rest[..., 1, 1])
    angles = np.stack([first, -s4 * pitch, -roll if s4 == s5 else roll], -1)
    return _wrap(angles.reshape(len(angles), 8, 3))


def _root(square: Array) -> Array:
    """Square root, NaN below zero except for rounding."""
    return np.asarray(np.sqrt(np.where(np.abs(square) < _ROUNDING**2, 0.0, square)))


def _wrap(angle: Array) -> Array:
    return np.asarray(np.remainder(angle + np.pi, 2 * np.pi) - np.pi)
