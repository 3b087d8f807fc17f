"""Trees of joints: poses of their frames, and Jacobians, vectorised over the positions of the axes."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.geometry import pose

Array = NDArray[np.float64]

WORLD = "world"  # the frame that carries the first joints


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint that turns about its z, or slides along it, and the frame that it carries.

    ``parent_from_frame = parent_from_joint @ motion(position + zero) @ joint_from_frame``

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
    """

    frame: str
    parent: str = WORLD
    kind: Literal["fixed", "revolute", "prismatic"] = "fixed"
    axis: str = ""
    zero: float = 0.0
    parent_from_joint: Array = field(default_factory=lambda: np.eye(4))
    joint_from_frame: Array = field(default_factory=lambda: np.eye(4))
    wobble: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)

    @property
    def parent_from_frame(self) -> Array:
        """Pose (4, 4) of the frame in its parent with the axis at 0."""
        motion = np.eye(4)
        if self.kind == "revolute":
            motion[:3, :3] = pose.rotation_about(2, self.zero)
        elif self.kind == "prismatic":
            motion[2, 3] = self.zero
        return np.asarray(self.parent_from_joint @ motion @ self.joint_from_frame)

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
    """Joints, each behind the one that carries it.

    Positions of the axes are arrays (..., k) in the order of `axes`; axes that they do not state are at 0.

    Attributes
    ----------
    joints
        All joints.
    axes
        Names of the axes, in the order of their joints.
    """

    def __init__(self, joints: Iterable[Joint]) -> None:
        self.joints = tuple(joints)
        self.axes = tuple(dict.fromkeys(joint.axis for joint in self.joints if joint.kind != "fixed"))
        self._number = {joint.frame: number for number, joint in enumerate(self.joints)}
        self._branches: dict[tuple[str, ...], _Branch] = {}

    def place(self, positions: ArrayLike = (), frames: Sequence[str] | None = None) -> dict[str, Array]:
        """Poses ``world_from_frame`` (..., 4, 4) by name of `frames`, or of all, at positions (..., k)."""
        q = np.asarray(positions, float)
        names = (WORLD, *self._number) if frames is None else tuple(frames)
        branch = self._branch(names)
        placed = {WORLD: np.eye(4)} | dict(zip(branch.frames, branch.place(q)[1], strict=True))
        shape = (*q.shape[:-1], 4, 4)
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
        """Pose (..., 4, 4) of a frame in another one, and its Jacobian (..., 6, axes) in there, see `jacobian`.

        Joints that move both frames do not count.
        """
        q, branch, paths = (
            np.asarray(positions, float),
            self._branch((frame, other)),
            (self._path(frame), self._path(other)),
        )
        joints, frames = branch.place(q)
        world_from = {WORLD: np.eye(4)} | dict(zip(branch.frames, frames, strict=True))
        at, base = world_from[frame], world_from[other]
        result = np.zeros((*q.shape[:-1], 6, len(self.axes)))
        moving = [
            (k, i)
            for k, i in enumerate(branch.moving)
            if (branch.frames[i] in paths[0]) != (branch.frames[i] in paths[1])
        ]
        if moving:
            rows, numbers = (list(one) for one in zip(*moving, strict=True))
            joint = np.stack(np.broadcast_arrays(*(joints[i] for i in numbers)), -3)
            along = joint[..., :3, 2] * [[1.0 if branch.frames[i] in paths[0] else -1.0] for i in numbers]
            linear = np.cross(along, at[..., None, :3, 3] - joint[..., :3, 3])
            slides = branch.slides[rows][:, None]
            columns = np.stack([np.where(slides, along, linear), np.where(slides, 0.0, along)], -2)
            if other != WORLD:
                columns = columns @ base[..., None, :3, :3]
            columns = columns.reshape(*columns.shape[:-2], 6)
            for k, row in enumerate(rows):
                result[..., branch.column[row]] += columns[..., k, :]
        return (at if other == WORLD else pose.inverse(base) @ at), result

    def axes_of(self, frame: str) -> tuple[str, ...]:
        """Names of the axes that move a frame, from the world on."""
        branch = self._branch((frame,))
        return tuple(dict.fromkeys(branch.joints[i].axis for i in branch.moving))

    def carrier_of(self, frame: str, axes: Collection[str]) -> tuple[str, Array]:
        """The frame behind the last joint by which `axes` move a frame, or the world, and the pose (4, 4) in it.

        All other axes are at 0.
        """
        carrier_from_frame = np.eye(4)
        while frame != WORLD and self[frame].axis not in axes:
            carrier_from_frame = self[frame].parent_from_frame @ carrier_from_frame
            frame = self[frame].parent
        return frame, carrier_from_frame

    def __getitem__(self, frame: str) -> Joint:
        """The joint that carries a frame."""
        return self.joints[self._number[frame]]

    def _path(self, frame: str) -> list[str]:
        """Frames that carry a frame, from itself to the world."""
        path = []
        while frame != WORLD:
            path.append(frame)
            frame = self[frame].parent
        return path

    def _branch(self, frames: tuple[str, ...]) -> _Branch:
        if frames not in self._branches:
            needed = {self._number[carrier] for frame in frames for carrier in self._path(frame)}
            self._branches[frames] = _Branch([self.joints[i] for i in sorted(needed)], self.axes)
        return self._branches[frames]


class _Branch:
    """The joints that carry some frames, with what their poses need ready."""

    def __init__(self, joints: Sequence[Joint], axes: Sequence[str]) -> None:
        self.joints, self.frames = joints, [joint.frame for joint in joints]
        number = {frame: i for i, frame in enumerate(self.frames)}
        self._parents = [number.get(joint.parent) for joint in joints]
        self._before = [None if _is_identity(joint.parent_from_joint) else joint.parent_from_joint for joint in joints]
        self._behind = [None if _is_identity(joint.joint_from_frame) else joint.joint_from_frame for joint in joints]
        self._tilted = [any(joint.wobble) for joint in joints]
        self.moving = [i for i, joint in enumerate(joints) if joint.kind != "fixed"]
        moved = [joints[i] for i in self.moving]
        self.column = np.array([axes.index(joint.axis) for joint in moved], np.intp)
        self.slides = np.array([joint.kind == "prismatic" for joint in moved], bool)
        self._zero = np.array([joint.zero for joint in moved])
        self._moved_behind = np.array([joint.joint_from_frame for joint in moved]).reshape(-1, 4, 4)

    def place(self, q: Array) -> tuple[list[Array], list[Array]]:
        """Poses of the joints before their motion, and of the frames; those that no axis moves are (4, 4)."""
        positions = self._positions(q)
        steps = self._steps(positions)
        before: list[Array] = []
        frames: list[Array] = []
        moved = 0
        for i, parent in enumerate(self._parents):
            at = None if parent is None else frames[parent]
            at = _joined(at, self._before[i])
            moves = self.joints[i].kind != "fixed"
            if moves and self._tilted[i]:
                at = _joined(at, self.joints[i].tilt(positions[..., moved]))
            before.append(np.eye(4) if at is None else at)
            at = _joined(at, steps[..., moved, :, :] if moves else self._behind[i])
            frames.append(np.eye(4) if at is None else at)
            moved += moves
        return before, frames

    def _positions(self, q: Array) -> Array:
        """Positions (..., moving) of the joints, rad or m."""
        stated = self.column < q.shape[-1]
        if stated.all():
            return np.asarray(q[..., self.column] + self._zero)
        positions = np.zeros((*q.shape[:-1], len(self.column)))
        positions[..., stated] = q[..., self.column[stated]]
        return np.asarray(positions + self._zero)

    def _steps(self, positions: Array) -> Array:
        """Poses (..., moving, 4, 4) of the frames on the joints before their motion."""
        motion = np.zeros((*positions.shape, 4, 4))
        motion[..., range(4), range(4)] = 1.0
        turns = ~self.slides
        motion[..., turns, :3, :3] = pose.rotation_about(2, positions[..., turns])
        motion[..., self.slides, 2, 3] = positions[..., self.slides]
        return np.asarray(motion @ self._moved_behind)


def _is_identity(matrix: Array) -> bool:
    return bool(np.array_equal(matrix, np.eye(4)))


def _joined(first: Array | None, second: Array | None) -> Array | None:
    """The product of two poses, each the identity where it is None."""
    if first is None or second is None:
        return second if first is None else first
    return np.asarray(first @ second)
