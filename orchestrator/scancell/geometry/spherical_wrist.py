"""Closed-form inverse kinematics of six-joint arms with parallel axes 2 and 3 and a spherical wrist.

Supported arms (standard Denavit-Hartenberg, ``T_i = Rz(theta_i) T(a_i, 0, d_i) Rx(alpha_i)``): alpha_2 = 0, alpha_1,
alpha_3, alpha_4 and alpha_5 ±90 degrees, a_4 = a_5 = d_5 = 0. All other parameters are free, shoulder offsets
included. Lengths in metres, angles in radians.
"""

from __future__ import annotations

import numpy as np

from scancell.arrays import Array
from scancell.geometry import pose

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
_BLOCK = 512  # poses that are solved at a time: what they need stays in the cache


def is_supported(a: Array, d: Array, alpha: Array, beta: Array) -> bool:
    """Whether an arm with these Denavit-Hartenberg parameters (6,) each has this closed form."""
    right_angles = np.abs(np.cos(alpha[[0, 2, 3, 4]])) < 1e-12
    zeros = np.abs(np.array([a[3], a[4], d[4], np.sin(alpha[1]), *beta])) < 1e-12
    return bool(right_angles.all() and zeros.all() and np.cos(alpha[1]) > 0 and abs(a[1]) > 0)


def solve(a: Array, d: Array, alpha: Array, base_from_flange: Array, slack: float = 0.0) -> Array:
    """Joint angles theta (n, 8, 6) in (-pi, pi] of all branches for targets (n, 4, 4); NaN without a solution.

    Of targets whose wrist centre is within `slack`, m, of where two arm branches meet, on either side, those are
    angles near both.
    """
    theta = np.empty((len(base_from_flange), 8, 6))
    for start in range(0, len(theta), _BLOCK):
        rows = slice(start, start + _BLOCK)
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
