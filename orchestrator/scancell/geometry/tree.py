"""Trees of joints: poses of their frames, and Jacobians, vectorised over the positions of the axes."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from scancell.arrays import Array
from scancell.geometry import pose

WORLD = "world"  # the frame that carries the first joints


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint that turns about its z, or slides along it, and the frame that it carries.

    ``parent_from_frame = parent_from_joint @ motion(gain * position + zero) @ joint_from_frame``

    Attributes
    ----------
    frame, parent
        Names of the frame that it carries and of the one that carries it.
    kind
        Whether it stays, turns or slides.
    axis
        Name of the axis whose position (rad or m) moves it; none for a fixed joint.
    zero
        Its position where that of the axis is 0, rad or m.
    parent_from_joint, joint_from_frame
        Constant poses (4, 4) before and behind the motion.
    wobble
        Tilts (rx_cos, rx_sin, ry_cos, ry_sin), rad, of the axis of a revolute joint, which repeat with every turn.
    gain
        Motion per unit of the axis' position: not 1 where its encoder has an error of scale.
    """

    frame: str
    parent: str = WORLD
    kind: Literal["fixed", "revolute", "prismatic"] = "fixed"
    axis: str = ""
    zero: float = 0.0
    parent_from_joint: Array = field(default_factory=lambda: np.eye(4))
    joint_from_frame: Array = field(default_factory=lambda: np.eye(4))
    wobble: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)
    gain: float = 1.0

    @property
    def frame_at_zero(self) -> Array:
        """Pose (4, 4) of the frame on the joint before its motion, with the axis at 0."""
        motion = np.eye(4)
        if self.kind == "revolute":
            motion[:3, :3] = pose.rotation_about(2, self.zero)
        elif self.kind == "prismatic":
            motion[2, 3] = self.zero
        return np.asarray(motion @ self.joint_from_frame)

    def tilt(self, position: Array) -> Array:
        """Pose (..., 4, 4) by which its axis is tilted at positions (...,), rad."""
        rx_cos, rx_sin, ry_cos, ry_sin = self.wobble
        c, s = np.cos(position), np.sin(position)
        return pose.from_rotation(
            pose.rotation_about(0, rx_cos * c + rx_sin * s) @ pose.rotation_about(1, ry_cos * c + ry_sin * s)
        )


def z_along(direction: int) -> Array:
    """Pose (4, 4) of a joint whose z lies along the coordinate axis `direction`: 0, 1 or 2."""
    return pose.from_rotation(np.roll(np.eye(3), direction + 1, axis=0))


class Tree:
    """Joints that carry one another.

    Positions of the axes are arrays (..., k) in the order of `axes`; axes that they do not state are at 0.

    Parameters
    ----------
    joints
        All joints, in any order; of two that may come first, the first given does.
    axes
        Names of the axes that come first; the others follow in the order of their joints.

    Raises
    ------
    ValueError
        If a joint is carried by a frame that there is not, or by itself.
    """

    def __init__(self, joints: Iterable[Joint], axes: Sequence[str] = ()) -> None:
        self.joints = tuple(_parents_first(joints))
        self.axes = tuple(dict.fromkeys((*axes, *(joint.axis for joint in self.joints if joint.axis))))
        self._number = {joint.frame: i for i, joint in enumerate(self.joints)}
        self._parts: dict[tuple[str, ...], Tree] = {}
        self._parents = [self._number.get(joint.parent) for joint in self.joints]
        self._before, self._behind = (
            [None if np.array_equal(getattr(joint, name), np.eye(4)) else getattr(joint, name) for joint in self.joints]
            for name in ("parent_from_joint", "joint_from_frame")
        )
        moving = [joint for joint in self.joints if joint.axis]
        self._moving = [i for i, joint in enumerate(self.joints) if joint.axis]
        self._columns = [self.axes.index(joint.axis) for joint in moving]
        self._slides = np.array([joint.kind == "prismatic" for joint in moving], bool)
        self._zero, self._gain = (np.array([getattr(joint, name) for joint in moving]) for name in ("zero", "gain"))
        self._moved_behind = np.reshape([joint.joint_from_frame for joint in moving], (-1, 4, 4))

    def __getitem__(self, frame: str) -> Joint:
        """The joint that carries a frame."""
        return self.joints[self._number[frame]]

    def place(self, positions: ArrayLike = (), frames: Sequence[str] | None = None) -> dict[str, Array]:
        """Poses ``world_from_frame`` (..., 4, 4) by name of `frames`, or of all, at positions (..., k)."""
        q = np.asarray(positions, float)
        names = (WORLD, *self._number) if frames is None else tuple(frames)
        placed, shape = self._part(names)._placed(q)[1], (*q.shape[:-1], 4, 4)
        return {
            name: placed[name] if placed[name].shape == shape else np.broadcast_to(placed[name], shape).copy()
            for name in names
        }

    def jacobian(self, frame: str, positions: ArrayLike) -> Array:
        """Geometric Jacobian (..., 6, axes) of the origin of a frame at positions (..., k).

        Velocity of the origin, then angular velocity, in world axes, per velocity of each axis.
        """
        return self.relative(frame, WORLD, positions)[1]

    def relative(self, frame: str, other: str, positions: ArrayLike) -> tuple[Array, Array]:
        """Pose (..., 4, 4) of a frame in another one, and its Jacobian (..., 6, axes) in there, see `jacobian`."""
        q, part = np.asarray(positions, float), self._part((frame, other))
        joints, placed = part._placed(q)
        at, base = placed[frame], placed[other]
        one, two = (part._part((end,))._number for end in (frame, other))
        result = np.zeros((*q.shape[:-1], 6, len(self.axes)))
        # Joints that move both frames do not count.
        moving = [
            k for k, i in enumerate(part._moving) if (part.joints[i].frame in one) != (part.joints[i].frame in two)
        ]
        if moving:
            numbers = [part._moving[k] for k in moving]
            before = np.stack(np.broadcast_arrays(*(joints[i] for i in numbers)), -3)
            along = before[..., :3, 2] * [[1.0 if part.joints[i].frame in one else -1.0] for i in numbers]
            linear, slides = np.cross(along, at[..., None, :3, 3] - before[..., :3, 3]), part._slides[moving, None]
            along = np.broadcast_to(along, linear.shape)  # axes on the world are the same at all positions
            columns = np.concatenate([np.where(slides, along, linear), np.where(slides, 0.0, along)], -1)
            for k, number in enumerate(moving):
                result[..., part._columns[number]] += part._gain[number] * columns[..., k, :]
        if other == WORLD:
            return at, result
        turn = np.swapaxes(base[..., :3, :3], -1, -2)
        result[..., :3, :], result[..., 3:, :] = turn @ result[..., :3, :], turn @ result[..., 3:, :]
        return pose.inverse(base) @ at, result

    def axes_of(self, frame: str) -> tuple[str, ...]:
        """Names of the axes that move a frame, from the world on."""
        return tuple(dict.fromkeys(joint.axis for joint in self._part((frame,)).joints if joint.axis))

    def carrier_of(self, frame: str, axes: Collection[str]) -> tuple[str, Array]:
        """The frame behind the last joint by which `axes` move a frame, or the world, and the pose (4, 4) in it.

        All other axes are at 0.
        """
        carrier_from_frame = np.eye(4)
        while frame != WORLD and self[frame].axis not in axes:
            carrier_from_frame = self[frame].parent_from_joint @ self[frame].frame_at_zero @ carrier_from_frame
            frame = self[frame].parent
        return frame, carrier_from_frame

    def _part(self, frames: tuple[str, ...]) -> Tree:
        """The joints that carry some frames."""
        if frames not in self._parts:
            needed: set[str] = set()
            for frame in frames:
                while frame != WORLD:
                    needed.add(frame)
                    frame = self[frame].parent  # noqa: PLW2901
            self._parts[frames] = Tree([joint for joint in self.joints if joint.frame in needed], self.axes)
        return self._parts[frames]

    def _placed(self, q: Array) -> tuple[list[Array], dict[str, Array]]:
        """Poses of the joints before their motion, and of the frames; those that no axis moves are (4, 4)."""
        stated = np.array(self._columns, int) < q.shape[-1]
        positions = np.zeros((*q.shape[:-1], len(stated)))
        positions[..., stated] = q[..., np.array(self._columns, int)[stated]]
        positions = self._gain * positions + self._zero
        motion = np.zeros((*positions.shape, 4, 4))
        motion[..., range(4), range(4)] = 1.0
        motion[..., ~self._slides, :3, :3] = pose.rotation_about(2, positions[..., ~self._slides])
        motion[..., self._slides, 2, 3] = positions[..., self._slides]
        steps = iter(np.moveaxis(motion @ self._moved_behind, -3, 0))
        angles = iter(np.moveaxis(positions, -1, 0))
        joints: list[Array] = []
        frames: list[Array | None] = []
        for i, joint in enumerate(self.joints):
            parent = self._parents[i]
            at = _joined(None if parent is None else frames[parent], self._before[i])
            if joint.axis:
                angle = next(angles)
                at = _joined(at, joint.tilt(angle)) if any(joint.wobble) else at
            joints.append(np.eye(4) if at is None else at)
            frames.append(_joined(at, next(steps) if joint.axis else self._behind[i]))
        names = (joint.frame for joint in self.joints)
        placed = (np.eye(4) if at is None else at for at in frames)
        return joints, {WORLD: np.eye(4)} | dict(zip(names, placed, strict=True))


def _parents_first(joints: Iterable[Joint]) -> list[Joint]:
    left, placed, frames = list(joints), [], {WORLD}
    while left:
        joint = next((joint for joint in left if joint.parent in frames), None)
        if joint is None:
            raise ValueError(f"frame '{left[0].frame}' is carried by '{left[0].parent}': expected a frame of the tree")
        left.remove(joint)
        placed.append(joint)
        frames.add(joint.frame)
    return placed


def _joined(first: Array | None, second: Array | None) -> Array | None:
    """The product of two poses, each the identity where it is None."""
    if first is None or second is None:
        return second if first is None else first
    return np.asarray(first @ second)
