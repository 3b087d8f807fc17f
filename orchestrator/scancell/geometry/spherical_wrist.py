"""Closed-form inverse kinematics of six-joint arms with parallel axes 2 and 3 and a spherical wrist.

Supported arms (standard Denavit-Hartenberg, ``T_i = Rz(theta_i) T(a_i, 0, d_i) Rx(alpha_i)``): alpha_2 = 0, alpha_1,
alpha_3, alpha_4 and alpha_5 ±90 degrees, a_4 = a_5 = d_5 = 0. All other parameters are free, shoulder offsets
included. Lengths in metres, angles in radians.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scancell.geometry import pose

Array = NDArray[np.float64]

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


def is_supported(a: Array, d: Array, alpha: Array, beta: Array) -> bool:
    """Whether an arm with these Denavit-Hartenberg parameters (6,) each has this closed form."""
    right_angles = np.abs(np.cos(alpha[[0, 2, 3, 4]])) < 1e-12
    zeros = np.abs(np.array([a[3], a[4], d[4], np.sin(alpha[1]), *beta])) < 1e-12
    return bool(right_angles.all() and zeros.all() and np.cos(alpha[1]) > 0 and abs(a[1]) > 0)


def solve(a: Array, d: Array, alpha: Array, base_from_flange: Array) -> Array:
    """Joint angles theta (n, 8, 6) in (-pi, pi] of all branches for targets (n, 4, 4); NaN without a solution."""
    last = pose.from_rotation(pose.rotation_about(0, alpha[5]), (a[5], 0.0, d[5]))
    base_from_wrist = base_from_flange @ pose.inverse(last)
    theta = np.full((len(base_from_flange), 8, 6), np.nan)
    arm_angles = _solve_position(a, d, alpha, base_from_wrist[:, :3, 3])
    theta[:, :, :3] = np.repeat(arm_angles, 2, axis=1)
    theta[:, :, 3:] = _solve_wrist(a, d, alpha, base_from_wrist[:, :3, :3], arm_angles)
    theta[~np.isfinite(theta).all(-1)] = np.nan
    return np.asarray(np.where(theta <= -np.pi, theta + 2 * np.pi, theta))


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


def _solve_position(a: Array, d: Array, alpha: Array, centre: Array) -> Array:
    """Joints 1-3 (n, 4, 3) of the shoulder and elbow branches for wrist centres (n, 3)."""
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
        # Tolerates rounding when the arm is fully extended.
        cosine = np.where(np.abs(cosine) <= 1 + _ROUNDING, np.clip(cosine, -1, 1), np.nan)
        bend = -s1 * front * above * np.arccos(cosine)
        theta2 = np.arctan2(up, across) - np.arctan2(forearm * np.sin(bend), a[1] + forearm * np.cos(bend))
    return _wrap(np.stack([theta1, theta2, bend - psi], -1))


def _solve_wrist(a: Array, d: Array, alpha: Array, base_from_wrist: Array, arm_angles: Array) -> Array:
    """Joints 4-6 (n, 8, 3): noflip, then flip, of each of the four arm branches."""
    base_from_link3 = np.broadcast_to(np.eye(3), (*arm_angles.shape[:2], 3, 3))
    for i in range(3):
        link = pose.rotation_about(2, arm_angles[..., i]) @ pose.rotation_about(0, alpha[i])
        base_from_link3 = base_from_link3 @ link
    wrist = np.swapaxes(base_from_link3, -1, -2) @ base_from_wrist[:, None]
    s4, s5 = np.sign(np.sin(alpha[3])), np.sign(np.sin(alpha[4]))
    # Rx(±90) Rz(t5) Rx(∓90) = Ry(∓t5): ZYZ angles. Equal signs leave Rx(180), which reverses joint 6.
    if s4 == s5:
        wrist = wrist @ pose.rotation_about(0, np.pi)
    sine = np.hypot(wrist[..., 0, 2], wrist[..., 1, 2])
    straight = sine < 1e-12
    pitch_sign = -s4 * np.array([1.0, -1.0])
    first = np.arctan2(wrist[..., 1, 2], wrist[..., 0, 2])[..., None] + np.where(pitch_sign > 0, 0.0, np.pi)
    first = np.where(straight[..., None], np.array([0.0, np.pi]), first)
    # With joint 4 known, Rz(-t4) R = Ry(b) Rz(c) gives joints 5 and 6 without division by sin b.
    rest = pose.rotation_about(2, -first) @ wrist[..., None, :, :]
    pitch = np.arctan2(rest[..., 0, 2], rest[..., 2, 2])
    roll = np.arctan2(rest[..., 1, 0], rest[..., 1, 1])
    angles = np.stack([first, -s4 * pitch, -roll if s4 == s5 else roll], -1)
    return _wrap(angles.reshape(len(angles), 8, 3))


def _root(square: Array) -> Array:
    """Square root; 0 for negative values within rounding, NaN below."""
    return np.asarray(np.sqrt(np.where(np.abs(square) < _ROUNDING**2, 0.0, square)))


def _wrap(angle: Array) -> Array:
    return np.asarray(np.remainder(angle + np.pi, 2 * np.pi) - np.pi)
