"""Standard Denavit-Hartenberg parameters of a serial chain that is given by the lines of its joint axes."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.geometry import pose
from scancell.geometry.chain import Chain, Joint

Array = NDArray[np.float64]

_PARALLEL = 1e-9  # sine of the angle below which two axes count as parallel
_MEETING = 1e-9  # m: distance below which two axes count as intersecting


def dh_from_axes(points: ArrayLike, directions: ArrayLike, end: ArrayLike) -> tuple[Chain, Array]:
    """Chain whose joints turn about lines through `points` (n, 3), m, along `directions` (n, 3).

    All are given in the base frame with every joint at 0, and so is the pose of the `end` (4, 4).

    The x axis of a frame is the common normal of two successive axes: of axes that intersect, the normal of their
    plane; of parallel ones, the normal that leaves d = 0; of coincident ones, the x axis of the frame before. Of its
    two directions the one nearer to the x axis before is taken, so that a may be negative. The first frame lies on
    axis 1 where it is nearest to the base's origin, and has the base's orientation if axis 1 is along the base's z.

    Returns
    -------
    chain
        In the base frame.
    last_from_end
        (4, 4) what four parameters of the last row cannot express of the pose of the end, a screw along its z: the
        identity for an end whose z is axis n.
    """
    end = np.asarray(end, float)
    origins = np.vstack([np.asarray(points, float), end[:3, 3]])
    axes = np.vstack([np.asarray(directions, float), end[:3, 2]])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    frame = _first_frame(origins[0], axes[0])
    base_from_first = frame
    joints = []
    for k in range(1, len(axes)):
        last = k == len(axes) - 1
        x, origin = _common_normal(frame, origins[k], axes[k], end if last else None)
        joints.append(_joint(frame, x, origin, axes[k]))
        frame = pose.from_rotation(np.column_stack([x, np.cross(axes[k], x), axes[k]]), origin)
    return Chain(joints, base_from_first), pose.inverse(frame) @ end


def _first_frame(point: Array, z: Array) -> Array:
    x = np.array([1.0, 0.0, 0.0]) if abs(z[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    x = _unit(x - (x @ z) * z)
    return pose.from_rotation(np.column_stack([x, np.cross(z, x), z]), point - (point @ z) * z)


def _common_normal(frame: Array, point: Array, z: Array, end: Array | None) -> tuple[Array, Array]:
    """Direction x of the next frame and its origin on the line through `point` along `z`."""
    before, origin = frame[:3, 2], frame[:3, 3]
    normal = np.cross(before, z)
    sine = float(np.linalg.norm(normal))
    gap = point - origin
    if sine < _PARALLEL:
        across = gap - (gap @ before) * before
        if np.linalg.norm(across) > _MEETING:
            return _towards(_unit(across), frame), origin + across
        # Coincident axes: any place and direction will do, for the end its own.
        return (frame[:3, 0], origin) if end is None else (end[:3, 0], end[:3, 3])
    x = _towards(normal / sine, frame)
    # The feet of the common normal: origin + s before + distance x = point + t z.
    t = float(np.linalg.det(np.column_stack([gap, before, normal]))) / sine**2
    return x, point + t * z


def _joint(frame: Array, x: Array, origin: Array, z: Array) -> Joint:
    """The joint from a frame to the next one."""
    before = frame[:3, 2]
    gap = origin - frame[:3, 3]
    a, d = float(gap @ x), float(gap @ before)
    alpha = np.arctan2(np.cross(before, z) @ x, before @ z)
    theta = np.arctan2(np.cross(frame[:3, 0], x) @ before, frame[:3, 0] @ x)
    return Joint(0.0 if abs(a) < _MEETING else a, 0.0 if abs(d) < _MEETING else d, float(alpha), float(theta))


def _towards(x: Array, frame: Array) -> Array:
    """`x` or its opposite, whichever is nearer to the frame's x axis (its y axis if both are equally near)."""
    along = float(x @ frame[:3, 0])
    if abs(along) < 1e-6:
        along = float(x @ frame[:3, 1])
    return x if along > 0 else -x


def _unit(vector: Array) -> Array:
    return np.asarray(vector / np.linalg.norm(vector))
