"""Forward and differential kinematics of a serial chain given by Denavit-Hartenberg parameters, vectorised."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.geometry import pose

Array = NDArray[np.float64]


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
        """What no angle changes: a, d and theta (joints,), and rotations ``Rx(alpha) Ry(beta)`` (joints, 3, 3)."""
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
