"""Serial chains by standard Denavit-Hartenberg parameters: kinematics, vectorised, and the parameters of given axes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.geometry import pose

Array = NDArray[np.float64]

_PARALLEL = 1e-9  # sine of the angle below which two axes count as parallel
_MEETING = 1e-9  # m: distance below which two axes count as intersecting


@dataclass(frozen=True)
class Joint:
    """Revolute joint by standard Denavit-Hartenberg parameters: m, rad, rad/s, rad/s², rad/s³.

    ``T = Rz(q + theta) T(a, 0, d) Rx(alpha) Ry(beta)``; `theta` is the zero offset and `beta` Hayati's parameter for
    nearly parallel axes.
    """

    a: float
    d: float
    alpha: float
    theta: float = 0.0
    min: float = -np.pi
    max: float = np.pi
    max_speed: float = 1.0
    max_acceleration: float = 1.0
    max_jerk: float = np.inf
    beta: float = 0.0


@dataclass(frozen=True)
class Chain:
    """Joints from the base, at `world_from_base` (4, 4), to the flange."""

    joints: Sequence[Joint]
    world_from_base: Array = field(default_factory=lambda: np.eye(4))

    def column(self, name: str) -> Array:
        """One field of all joints, (joints,)."""
        return np.array([getattr(joint, name) for joint in self.joints], float)

    @cached_property
    def _links(self) -> tuple[Array, Array, Array, Array]:
        """Constants of the chain: a, d and theta (joints,), and rotations ``Rx(alpha) Ry(beta)`` (joints, 3, 3)."""
        alpha, beta = self.column("alpha"), self.column("beta")
        twist = pose.rotation_about(0, alpha) @ pose.rotation_about(1, beta)
        return self.column("a"), self.column("d"), self.column("theta"), twist

    def link_poses(self, q: ArrayLike) -> Array:
        """``world_from_link`` (..., joints + 1, 4, 4) at q (..., joints), rad: base first, flange last."""
        a, d, theta, twist = self._links
        angle = np.asarray(q, float) + theta
        step = np.zeros((*angle.shape, 4, 4))
        turn = pose.rotation_about(2, angle)
        step[..., :3, :3] = turn @ twist
        step[..., 0, 3] = a * turn[..., 0, 0]
        step[..., 1, 3] = a * turn[..., 1, 0]
        step[..., 2, 3] = d
        step[..., 3, 3] = 1.0
        frames = [np.broadcast_to(self.world_from_base, (*angle.shape[:-1], 4, 4))]
        for i in range(angle.shape[-1]):
            frames.append(frames[-1] @ step[..., i, :, :])
        return np.stack(frames, -3)

    def fk(self, q: ArrayLike) -> Array:
        """Forward kinematics: ``world_from_flange`` (..., 4, 4) at q (..., joints), rad."""
        return np.asarray(self.link_poses(q)[..., -1, :, :])

    def jacobian(self, q: ArrayLike) -> Array:
        """Geometric Jacobian (..., 6, joints) of the flange in world axes: linear velocity, then angular velocity."""
        frames = self.link_poses(q)
        axes = frames[..., :-1, :3, 2]
        lever = frames[..., -1:, :3, 3] - frames[..., :-1, :3, 3]
        return np.swapaxes(np.concatenate([np.cross(axes, lever), axes], -1), -1, -2)


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
