"""Rigid transforms as homogeneous matrices ``(..., 4, 4)``, named ``target_from_source``.

All functions broadcast over leading axes. Positions are in metres, angles in radians, quaternions w, x, y, z.

Examples
--------
Poses are joined by ``@``, so that the names of the frames meet:

>>> pose = scancell.pose
>>> world_from_table = pose.translation((0.5, 0.0, 0.1))
>>> table_from_part = pose.from_rotation(pose.rotation_about(2, np.pi / 2), (0.0, 0.0, 0.02))
>>> world_from_part = world_from_table @ table_from_part
>>> print(pose.transform_points(world_from_part, [[0.03, 0.0, 0.0]]).round(3))
[[0.5  0.03 0.12]]
>>> bool(np.allclose(pose.inverse(world_from_part) @ world_from_part, np.eye(4)))
True

Rotations as Euler angles and as quaternions:

>>> down = pose.rotation_from_euler_xyz((np.pi, 0.0, 0.0))
>>> print(np.abs(pose.quaternion_from_rotation(down)).round(3))
[0. 1. 0. 0.]
>>> turned = pose.rotation_about(2, np.radians([0, 45, 90]))
>>> print(np.degrees(pose.log_rotation(turned)[:, 2]).round(3))
[ 0. 45. 90.]

Half of the way between two poses:

>>> print(pose.interpolate_straight(world_from_table, world_from_part, [0.5])[0, :3, 3].round(3))
[0.5  0.   0.11]
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from scancell.arrays import Array

_SMALL = 1e-4  # rad: below, the truncated series are exact to machine precision

_BLOCK = 1 << 14  # points that are transformed at a time


def from_rotation(rotation: ArrayLike, position: ArrayLike = (0.0, 0.0, 0.0)) -> Array:
    """Pose (..., 4, 4) of the matrix `rotation` (..., 3, 3) and a `position` (..., 3), m."""
    rotation = np.asarray(rotation, float)
    position = np.asarray(position, float)
    shape = np.broadcast_shapes(rotation.shape[:-2], position.shape[:-1])
    result = np.zeros((*shape, 4, 4))
    result[..., :3, :3] = rotation
    result[..., :3, 3] = position
    result[..., 3, 3] = 1.0
    return result


def translation(position: ArrayLike) -> Array:
    """Pose (..., 4, 4) of identity rotation at `position` (..., 3), m."""
    return from_rotation(np.eye(3), position)


def pose(position: ArrayLike, quaternion: ArrayLike = (1.0, 0.0, 0.0, 0.0)) -> Array:
    """Pose (..., 4, 4) from `position` (..., 3), m, and `quaternion` (..., 4), see `rotation_from_quaternion`."""
    return from_rotation(rotation_from_quaternion(quaternion), position)


def rotation_from_quaternion(quaternion: ArrayLike) -> Array:
    """Rotation matrices (..., 3, 3) of `quaternion` (..., 4) as w, x, y, z, which is normalized first.

    Raises
    ------
    ValueError
        If a quaternion has zero length.
    """
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
    """Quaternions (..., 4), w, x, y, z with w >= 0, of the matrices `rotation` (..., 3, 3).

    Shepperd's method: the one of four equivalent forms with the largest divisor, accurate at every angle.
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
    """Rotation matrices (..., 3, 3) by `angle` (...,), rad, about the coordinate `axis` 0, 1 or 2."""
    angle = np.asarray(angle, float)
    result = np.zeros((*angle.shape, 3, 3))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    result[..., axis, axis] = 1.0
    result[..., i, i] = result[..., j, j] = np.cos(angle)
    result[..., j, i] = np.sin(angle)
    result[..., i, j] = -np.sin(angle)
    return result


def looking_from(azimuth: ArrayLike, elevation: ArrayLike) -> Array:
    """Rotations (..., 3, 3) of a sensor that looks at the origin from a direction; its x is level.

    The direction, against which the sensor's z points, has `azimuth` and `elevation` (...,), rad.
    """
    c, s = np.broadcast_arrays(np.cos(elevation), np.sin(elevation))
    zero, one = np.zeros_like(c), np.ones_like(c)
    rows = [np.stack([zero, -s, -c], -1), np.stack([-one, zero, zero], -1), np.stack([zero, c, -s], -1)]
    return np.asarray(rotation_about(2, azimuth) @ np.stack(rows, -2))


def rotation_from_euler_xyz(angles: ArrayLike) -> Array:
    """Rotations (..., 3, 3) of intrinsic X, Y', Z'' `angles` (..., 3), rad: R = Rx(a) Ry(b) Rz(c)."""
    a = np.asarray(angles, float)
    return rotation_about(0, a[..., 0]) @ rotation_about(1, a[..., 1]) @ rotation_about(2, a[..., 2])


def euler_xyz_from_rotation(rotation: ArrayLike) -> Array:
    """Intrinsic X, Y', Z'' angles (..., 3), rad, of `rotation` (..., 3, 3).

    The last angle is 0 where the middle one is ±90 deg.
    """
    r = np.asarray(rotation, float)
    cosine = np.hypot(r[..., 0, 0], r[..., 0, 1])
    lost = cosine < 1e-9
    first = np.where(lost, np.arctan2(r[..., 2, 1], r[..., 1, 1]), np.arctan2(-r[..., 1, 2], r[..., 2, 2]))
    last = np.where(lost, 0.0, np.arctan2(-r[..., 0, 1], r[..., 0, 0]))
    return np.stack([first, np.arctan2(r[..., 0, 2], cosine), last], -1)


def rotation_from_euler_zyz(angles: ArrayLike) -> Array:
    """Rotations (..., 3, 3) of intrinsic Z, Y', Z'' `angles` (..., 3), rad: R = Rz(a) Ry(b) Rz(c)."""
    a = np.asarray(angles, float)
    return rotation_about(2, a[..., 0]) @ rotation_about(1, a[..., 1]) @ rotation_about(2, a[..., 2])


def euler_zyz_from_rotation(rotation: ArrayLike) -> Array:
    """Intrinsic Z, Y', Z'' angles (..., 3), rad, of `rotation` (..., 3, 3), the middle one in [0, pi].

    The last angle is 0 where the middle one is 0 or 180 deg.
    """
    r = np.asarray(rotation, float)
    sine = np.hypot(r[..., 0, 2], r[..., 1, 2])
    lost = sine < 1e-9
    first = np.where(lost, np.arctan2(-r[..., 0, 1], r[..., 1, 1]), np.arctan2(r[..., 1, 2], r[..., 0, 2]))
    last = np.where(lost, 0.0, np.arctan2(r[..., 2, 1], -r[..., 2, 0]))
    return np.stack([first, np.arctan2(sine, r[..., 2, 2]), last], -1)


def from_euler_xyz(position: ArrayLike, angles: ArrayLike) -> Array:
    """Pose (..., 4, 4) from `position` (..., 3), m, and intrinsic X, Y', Z'' `angles` (..., 3), rad."""
    return from_rotation(rotation_from_euler_xyz(angles), position)


def inverse(target_from_source: ArrayLike) -> Array:
    """Inverse ``source_from_target`` (..., 4, 4) of the rigid poses `target_from_source` (..., 4, 4)."""
    t = np.asarray(target_from_source, float)
    rotation = np.swapaxes(t[..., :3, :3], -1, -2)
    return from_rotation(rotation, -(rotation @ t[..., :3, 3:])[..., 0])


def transform_points(target_from_source: ArrayLike, points_in_source: ArrayLike) -> Array:
    """Points (..., n, 3) in the target frame, of `points_in_source` (..., n, 3) by `target_from_source` (..., 4, 4)."""
    t = np.asarray(target_from_source, float)
    points = np.asarray(points_in_source, float)
    rotation, shift = np.swapaxes(t[..., :3, :3], -1, -2), t[..., None, :3, 3]
    if t.ndim > 2 or points.ndim != 2:
        return np.asarray(points @ rotation + shift)
    result = np.empty_like(points)
    for start in range(0, len(points), _BLOCK):  # blocks stay in the cache
        rows = slice(start, start + _BLOCK)
        np.matmul(points[rows], rotation, out=result[rows])
        result[rows] += shift
    return result


def transform_each(target_from_source: ArrayLike, points_in_source: ArrayLike) -> Array:
    """Points (n, 3) in the target frames: `points_in_source` (n, 3), each by its own `target_from_source` (n, 4, 4)."""
    t, points = np.asarray(target_from_source, float), np.asarray(points_in_source, float)
    return np.asarray(np.einsum("nij,nj->ni", t[:, :3, :3], points) + t[:, :3, 3])


def skew(vector: Array) -> Array:
    """Matrices (..., 3, 3) with ``skew(v) @ u == cross(v, u)``."""
    x, y, z = np.moveaxis(vector, -1, 0)
    zero = np.zeros_like(x)
    return np.stack([np.stack([zero, -z, y], -1), np.stack([z, zero, -x], -1), np.stack([-y, x, zero], -1)], -2)


def nearest_rotation(matrix: Array) -> Array:
    """Rotation (3, 3) nearest to a matrix in the sum of squared differences (Kabsch 1976)."""
    u, _, vt = np.linalg.svd(matrix)
    return np.asarray(u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt)


def exp_rotation(vector: ArrayLike) -> Array:
    """Rotation matrices (..., 3, 3) of the rotation vectors `vector` (..., 3), rad, by Rodrigues' formula."""
    vector = np.asarray(vector, float)
    a, b = _rodrigues_coefficients(np.linalg.norm(vector, axis=-1))
    k = skew(vector)
    return np.asarray(np.eye(3) + a[..., None, None] * k + b[..., None, None] * (k @ k))


def log_rotation(rotation: ArrayLike) -> Array:
    """Rotation vectors (..., 3), rad, of length in [0, pi], of the matrices `rotation` (..., 3, 3)."""
    r = np.asarray(rotation, float)
    cosine = (r[..., 0, 0] + r[..., 1, 1] + r[..., 2, 2] - 1) / 2
    if (cosine > 0).all():  # away from half turns the part that changes its sign with the turn is accurate, and faster
        half = (r - np.swapaxes(r, -1, -2))[..., (2, 0, 1), (1, 2, 0)] / 2
        sine = np.sqrt((half**2).sum(-1))
        return np.asarray(
            half * np.where(sine > 1e-12, np.arctan2(sine, cosine) / np.maximum(sine, 1e-12), 1.0)[..., None]
        )
    q = quaternion_from_rotation(r)
    sine = np.linalg.norm(q[..., 1:], axis=-1)
    angle = 2 * np.arctan2(sine, q[..., 0])
    safe = np.where(sine > 1e-12, sine, 1.0)
    return np.asarray(q[..., 1:] * np.where(sine > 1e-12, angle / safe, 2.0)[..., None])


def interpolate_straight(start: ArrayLike, end: ArrayLike, fraction: ArrayLike) -> Array:
    """Poses (n, 4, 4) at `fraction` (n,) of the way from `start` to `end` (4, 4): straight, turning evenly.

    Fractions outside [0, 1] extrapolate.
    """
    start, end = np.asarray(start, float), np.asarray(end, float)
    fraction = np.asarray(fraction, float)
    rotation_vector = log_rotation(np.swapaxes(start[..., :3, :3], -1, -2) @ end[..., :3, :3])
    rotation = start[..., :3, :3] @ exp_rotation(fraction[..., None] * rotation_vector)
    position = start[..., :3, 3] + fraction[..., None] * (end[..., :3, 3] - start[..., :3, 3])
    return from_rotation(rotation, position)


def _rodrigues_coefficients(angle: Array) -> tuple[Array, Array]:
    """sin(t)/t and (1-cos t)/t², without cancellation near zero."""
    small = angle < _SMALL
    t = np.where(small, 1.0, angle)
    half = np.sin(t / 2)
    a = np.where(small, 1 - angle**2 / 6, np.sin(t) / t)
    b = np.where(small, 0.5 - angle**2 / 24, 2 * half * half / t**2)
    return a, b
