"""Rigid poses as arrays of homogeneous matrices ``(..., 4, 4)``, named ``target_from_source``.

All functions broadcast over leading axes and work in radians. Quaternions are w, x, y, z.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

_SMALL = 1e-4  # below this angle the series are exact to machine precision


def from_rotation(rotation: ArrayLike, position: ArrayLike = (0.0, 0.0, 0.0)) -> Array:
    """Pose (..., 4, 4) of a rotation matrix (..., 3, 3) and a position (..., 3) in metres."""
    rotation = np.asarray(rotation, float)
    position = np.asarray(position, float)
    shape = np.broadcast_shapes(rotation.shape[:-2], position.shape[:-1])
    result = np.zeros((*shape, 4, 4))
    result[..., :3, :3] = rotation
    result[..., :3, 3] = position
    result[..., 3, 3] = 1.0
    return result


def translation(position: ArrayLike) -> Array:
    """Pose (..., 4, 4) that only shifts by `position` (..., 3)."""
    return from_rotation(np.eye(3), position)


def pose(position: ArrayLike, quaternion: ArrayLike = (1.0, 0.0, 0.0, 0.0)) -> Array:
    """Pose (..., 4, 4) from a position (..., 3) and a quaternion (..., 4), w first, of any length but zero."""
    return from_rotation(rotation_from_quaternion(quaternion), position)


def rotation_from_quaternion(quaternion: ArrayLike) -> Array:
    """Rotation matrices (..., 3, 3) of quaternions (..., 4); ValueError for a quaternion of zero length."""
    q = np.asarray(quaternion, float)
    length = np.linalg.norm(q, axis=-1, keepdims=True)
    if not np.all(length > 0):
        raise ValueError("a quaternion of zero length has no direction")
    w, x, y, z = np.moveaxis(q / length, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, -1) for row in rows], -2)


def quaternion_from_rotation(rotation: ArrayLike) -> Array:
    """Quaternions (..., 4) with w >= 0 of rotation matrices (..., 3, 3).

    Shepperd's method: of the four equivalent forms the one with the largest divisor, good at every angle.
    """
    r = np.asarray(rotation, float)
    trace = np.trace(r, axis1=-2, axis2=-1)
    xx, yy, zz = r[..., 0, 0], r[..., 1, 1], r[..., 2, 2]
    # Each row is one component's multiple of the whole quaternion: 4 w q, 4 x q, 4 y q, 4 z q.
    wx, wy, wz = (r[..., 2, 1] - r[..., 1, 2], r[..., 0, 2] - r[..., 2, 0], r[..., 1, 0] - r[..., 0, 1])
    xy, xz, yz = (r[..., 0, 1] + r[..., 1, 0], r[..., 0, 2] + r[..., 2, 0], r[..., 1, 2] + r[..., 2, 1])
    forms = np.stack(
        [
            np.stack([1 + trace, wx, wy, wz], -1),
            np.stack([wx, 1 + 2 * xx - trace, xy, xz], -1),
            np.stack([wy, xy, 1 + 2 * yy - trace, yz], -1),
            np.stack([wz, xz, yz, 1 + 2 * zz - trace], -1),
        ],
        -2,
    )
    best = np.argmax(np.diagonal(forms, axis1=-2, axis2=-1), axis=-1)
    q = np.take_along_axis(forms, best[..., None, None], -2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return np.asarray(np.where(q[..., :1] < 0, -q, q))


def rotation_about(axis: int, angle: ArrayLike) -> Array:
    """Rotation matrices (..., 3, 3) by `angle` (...) about coordinate axis 0, 1 or 2."""
    angle = np.asarray(angle, float)
    result = np.zeros((*angle.shape, 3, 3))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    result[..., axis, axis] = 1.0
    result[..., i, i] = result[..., j, j] = np.cos(angle)
    result[..., j, i] = np.sin(angle)
    result[..., i, j] = -np.sin(angle)
    return result


def rotation_from_euler_xyz(angles: ArrayLike) -> Array:
    """Rotations (..., 3, 3) of intrinsic X, Y', Z'' angles (..., 3): R = Rx(a) Ry(b) Rz(c)."""
    a = np.asarray(angles, float)
    return rotation_about(0, a[..., 0]) @ rotation_about(1, a[..., 1]) @ rotation_about(2, a[..., 2])


def euler_xyz_from_rotation(rotation: ArrayLike) -> Array:
    """Intrinsic X, Y', Z'' angles (..., 3) with b in [-pi/2, pi/2]; c absorbs nothing: at b = ±pi/2, a is 0."""
    r = np.asarray(rotation, float)
    cos_b = np.hypot(r[..., 0, 0], r[..., 0, 1])
    a = np.where(cos_b > 1e-12, np.arctan2(-r[..., 1, 2], r[..., 2, 2]), 0.0)
    # With a known, Rx(-a) R = Ry(b) Rz(c), whose middle row is (sin c, cos c, 0): exact at the singularity too.
    rest = rotation_about(0, -a) @ r
    b = np.arctan2(r[..., 0, 2], cos_b)
    return np.stack([a, b, np.arctan2(rest[..., 1, 0], rest[..., 1, 1])], -1)


def rotation_from_euler_zyz(angles: ArrayLike) -> Array:
    """Rotations (..., 3, 3) of intrinsic Z, Y', Z'' angles (..., 3) (yaw, pitch, roll): R = Rz(a) Ry(b) Rz(c)."""
    a = np.asarray(angles, float)
    return rotation_about(2, a[..., 0]) @ rotation_about(1, a[..., 1]) @ rotation_about(2, a[..., 2])


def euler_zyz_from_rotation(rotation: ArrayLike) -> Array:
    """Intrinsic Z, Y', Z'' angles (..., 3) with b in [0, pi]; at b = 0 or pi, a is 0."""
    r = np.asarray(rotation, float)
    sin_b = np.hypot(r[..., 0, 2], r[..., 1, 2])
    a = np.where(sin_b > 1e-12, np.arctan2(r[..., 1, 2], r[..., 0, 2]), 0.0)
    rest = rotation_about(2, -a) @ r  # Ry(b) Rz(c)
    b = np.arctan2(rest[..., 0, 2], rest[..., 2, 2])
    return np.stack([a, b, np.arctan2(rest[..., 1, 0], rest[..., 1, 1])], -1)


def from_euler_xyz(position: ArrayLike, angles: ArrayLike) -> Array:
    """Pose (..., 4, 4) from a position (..., 3) and intrinsic X, Y', Z'' angles (..., 3)."""
    return from_rotation(rotation_from_euler_xyz(angles), position)


def inverse(target_from_source: ArrayLike) -> Array:
    """``source_from_target`` of rigid poses (..., 4, 4)."""
    t = np.asarray(target_from_source, float)
    rotation = np.swapaxes(t[..., :3, :3], -1, -2)
    return from_rotation(rotation, -(rotation @ t[..., :3, 3:])[..., 0])


def transform_points(target_from_source: ArrayLike, points_in_source: ArrayLike) -> Array:
    """Points (..., n, 3) carried by poses (..., 4, 4)."""
    t = np.asarray(target_from_source, float)
    points = np.asarray(points_in_source, float)
    return np.asarray(points @ np.swapaxes(t[..., :3, :3], -1, -2) + t[..., None, :3, 3])


def transform_each(target_from_source: ArrayLike, points_in_source: ArrayLike) -> Array:
    """Points (n, 3), each carried by a pose (n, 4, 4) of its own."""
    t, points = np.asarray(target_from_source, float), np.asarray(points_in_source, float)
    return np.asarray(np.einsum("nij,nj->ni", t[:, :3, :3], points) + t[:, :3, 3])


def skew(vector: ArrayLike) -> Array:
    """Matrices (..., 3, 3) with ``skew(v) @ u == cross(v, u)``."""
    x, y, z = np.moveaxis(np.asarray(vector, float), -1, 0)
    zero = np.zeros_like(x)
    return np.stack([np.stack([zero, -z, y], -1), np.stack([z, zero, -x], -1), np.stack([-y, x, zero], -1)], -2)


def exp_rotation(vector: ArrayLike) -> Array:
    """Rotations (..., 3, 3) by |vector| radians about `vector` (..., 3) (Rodrigues)."""
    vector = np.asarray(vector, float)
    a, b, _ = _series(np.linalg.norm(vector, axis=-1))
    k = skew(vector)
    return np.asarray(np.eye(3) + a[..., None, None] * k + b[..., None, None] * (k @ k))


def log_rotation(rotation: ArrayLike) -> Array:
    """Rotation vectors (..., 3), length in [0, pi], of rotations (..., 3, 3)."""
    q = quaternion_from_rotation(rotation)
    sine = np.linalg.norm(q[..., 1:], axis=-1)
    angle = 2 * np.arctan2(sine, q[..., 0])
    safe = np.where(sine > 1e-12, sine, 1.0)
    return np.asarray(q[..., 1:] * np.where(sine > 1e-12, angle / safe, 2.0)[..., None])


def exp_twist(twist: ArrayLike) -> Array:
    """Poses (..., 4, 4) after following the constant twist (..., 6) = (linear, angular) for one unit of time."""
    twist = np.asarray(twist, float)
    linear, angular = twist[..., :3], twist[..., 3:]
    _, b, c = _series(np.linalg.norm(angular, axis=-1))
    k = skew(angular)
    left = np.eye(3) + b[..., None, None] * k + c[..., None, None] * (k @ k)
    return from_rotation(exp_rotation(angular), (left @ linear[..., None])[..., 0])


def log_twist(target_from_source: ArrayLike) -> Array:
    """The twist (..., 6) = (linear, angular) whose `exp_twist` is the pose; angle in [0, pi]."""
    t = np.asarray(target_from_source, float)
    angular = log_rotation(t[..., :3, :3])
    _, b, c = _series(np.linalg.norm(angular, axis=-1))
    k = skew(angular)
    left = np.eye(3) + b[..., None, None] * k + c[..., None, None] * (k @ k)
    return np.concatenate([np.linalg.solve(left, t[..., :3, 3:])[..., 0], angular], -1)


def interpolate(start: ArrayLike, end: ArrayLike, fraction: ArrayLike) -> Array:
    """Poses on the screw from `start` to `end`: constant twist, `fraction` 0 gives `start`, 1 gives `end`."""
    start = np.asarray(start, float)
    twist = log_twist(inverse(start) @ np.asarray(end, float))
    return np.asarray(start @ exp_twist(np.asarray(fraction, float)[..., None] * twist))


def interpolate_straight(start: ArrayLike, end: ArrayLike, fraction: ArrayLike) -> Array:
    """Poses whose origin runs straight from `start` to `end` while the rotation turns at a constant rate."""
    start, end = np.asarray(start, float), np.asarray(end, float)
    fraction = np.asarray(fraction, float)
    turn = log_rotation(np.swapaxes(start[..., :3, :3], -1, -2) @ end[..., :3, :3])
    rotation = start[..., :3, :3] @ exp_rotation(fraction[..., None] * turn)
    position = start[..., :3, 3] + fraction[..., None] * (end[..., :3, 3] - start[..., :3, 3])
    return from_rotation(rotation, position)


def angular_velocity(before: ArrayLike, after: ArrayLike, duration: ArrayLike) -> Array:
    """Mean angular velocity (..., 3), rad/s, in the target frame, between two poses `duration` seconds apart."""
    before, after = np.asarray(before, float), np.asarray(after, float)
    turn = log_rotation(after[..., :3, :3] @ np.swapaxes(before[..., :3, :3], -1, -2))
    return np.asarray(turn / np.asarray(duration, float)[..., None])


def _series(angle: Array) -> tuple[Array, Array, Array]:
    """sin(t)/t, (1-cos t)/t², (t-sin t)/t³ without cancellation near zero."""
    small = angle < _SMALL
    t = np.where(small, 1.0, angle)
    half = np.sin(t / 2)
    a = np.where(small, 1 - angle**2 / 6, np.sin(t) / t)
    b = np.where(small, 0.5 - angle**2 / 24, 2 * half * half / t**2)
    c = np.where(angle < 0.05, 1 / 6 - angle**2 / 120 + angle**4 / 5040 - angle**6 / 362880, (t - np.sin(t)) / t**3)
    return a, b, c
