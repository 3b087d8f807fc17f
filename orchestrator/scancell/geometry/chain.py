"""Serial chains by standard Denavit-Hartenberg parameters: kinematics, vectorised, and the parameters of given axes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.geometry import pose
from scancell.geometry.tree import Joint as TreeJoint
from scancell.geometry.tree import Tree

Array = NDArray[np.float64]

_NEARLY_PARALLEL = 0.1  # sine of the angle below which two axes count as nearly parallel
_NO_LENGTH, _EXACT = 1e-10, 1e-12  # m, rad: what is below is rounding
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
    def tree(self) -> Tree:
        """The tree of the base and the links: frames ``base``, ``link[1]`` …, axes ``joint[1]`` …"""
        joints = [TreeJoint("base", parent_from_joint=self.world_from_base)]
        for number, joint in enumerate(self.joints, 1):
            twist = pose.rotation_about(0, joint.alpha) @ pose.rotation_about(1, joint.beta)
            behind = pose.from_rotation(twist, (joint.a, 0.0, joint.d))
            joints.append(
                TreeJoint(
                    f"link[{number}]",
                    joints[-1].frame,
                    "revolute",
                    f"joint[{number}]",
                    zero=joint.theta,
                    joint_from_frame=behind,
                )
            )
        return Tree(joints)

    @property
    def flange(self) -> str:
        """Name of the last frame."""
        return self.tree.joints[-1].frame

    def link_poses(self, q: ArrayLike) -> Array:
        """``world_from_link`` (..., joints + 1, 4, 4) at q (..., joints), rad: base first, flange last."""
        placed = self.tree.place(q)
        return np.stack([placed[joint.frame] for joint in self.tree.joints], -3)

    def fk(self, q: ArrayLike) -> Array:
        """Forward kinematics: ``world_from_flange`` (..., 4, 4) at q (..., joints), rad."""
        return self.tree.place(q, [self.flange])[self.flange]

    def jacobian(self, q: ArrayLike) -> Array:
        """Geometric Jacobian (..., 6, joints) of the flange in world axes: linear velocity, then angular velocity."""
        return self.tree.jacobian(self.flange, q)


def dh_from_axes(points: ArrayLike, directions: ArrayLike, end: ArrayLike) -> tuple[Chain, Array]:
    """Chain whose joints turn about lines through `points` (n, 3), m, along `directions` (n, 3).

    All are given in the base frame with every joint at 0, and so is the pose of the `end` (4, 4).

    The x axis of a frame is the common normal of two successive axes; of axes that intersect, the normal of their
    plane. The common normal of axes that are nearly parallel is far away and changes with the least of their errors:
    between these, the x axis leads from one axis to the other in the plane that leaves d = 0, and `beta` completes the
    tilt (Hayati, 1983). Of coincident axes, the x axis of the frame before is kept. Of the two directions of x the one
    nearer to the x axis before is taken, so that a may be negative. The first frame lies on axis 1 where it is nearest
    to the base's origin, and has the base's orientation if axis 1 is along the base's z.

    Returns
    -------
    chain
        In the base frame.
    last_from_end
        (4, 4) what the parameters of the last row cannot express of the pose of the end: the identity for an end whose
        z is axis n, a rotation about z for one whose z is nearly parallel to it, otherwise a screw along z.
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
        x, origin = _next_frame(frame, origins[k], axes[k], end if last else None)
        joint = _joint(frame, x, origin, axes[k])
        joints.append(joint)
        frame = frame @ Chain([joint]).fk([0.0])
    return Chain(joints, base_from_first), pose.inverse(frame) @ end


def _first_frame(point: Array, z: Array) -> Array:
    x = np.array([1.0, 0.0, 0.0]) if abs(z[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    x = _unit(x - (x @ z) * z)
    return pose.from_rotation(np.column_stack([x, np.cross(z, x), z]), point - (point @ z) * z)


def _next_frame(frame: Array, point: Array, z: Array, end: Array | None) -> tuple[Array, Array]:
    """Direction x of a row, perpendicular to the axis before, and the next origin on the line through `point`."""
    before, origin = frame[:3, 2], frame[:3, 3]
    normal = np.cross(before, z)
    sine = float(np.linalg.norm(normal))
    gap = point - origin
    if sine < _NEARLY_PARALLEL:
        # Where the line meets the plane through the frame's origin that is perpendicular to the axis before.
        place = point - (gap @ before) / (z @ before) * z if end is None else end[:3, 3]
        across = place - origin - ((place - origin) @ before) * before
        if np.linalg.norm(across) > _MEETING:
            return _towards(_unit(across), frame), place
        # Any direction will do: for the end that which leaves no rotation.
        return frame[:3, 0] if end is None else _unit(np.cross(end[:3, 1], before) * (z @ before)), place
    x = _towards(normal / sine, frame)
    # The feet of the common normal: origin + s before + distance x = point + t z.
    t = float(np.linalg.det(np.column_stack([gap, before, normal]))) / sine**2
    return x, point + t * z


def _joint(frame: Array, x: Array, origin: Array, z: Array) -> Joint:
    """The joint from a frame to the next one, with z = Rz(theta) Rx(alpha) Ry(beta) z."""
    before = frame[:3, 2]
    gap = origin - frame[:3, 3]
    a, d = float(gap @ x), float(gap @ before)
    alpha = np.arctan2(np.cross(before, z) @ x, before @ z)
    beta = np.arcsin(np.clip(x @ z, -1.0, 1.0))
    theta = np.arctan2(np.cross(frame[:3, 0], x) @ before, frame[:3, 0] @ x)
    a, d = (0.0 if abs(length) < _NO_LENGTH else length for length in (a, d))
    return Joint(a, d, float(alpha), float(theta), beta=0.0 if abs(beta) < _EXACT else float(beta))


def _towards(x: Array, frame: Array) -> Array:
    """`x` or its opposite, whichever is nearer to the frame's x axis (its y axis if both are equally near)."""
    along = float(x @ frame[:3, 0])
    if abs(along) < 1e-6:
        along = float(x @ frame[:3, 1])
    return x if along > 0 else -x


def _unit(vector: Array) -> Array:
    return np.asarray(vector / np.linalg.norm(vector))
