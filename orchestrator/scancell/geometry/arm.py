"""Serial arm: its kinematics, joint limits and turns, and all branches of its inverse kinematics."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.arrays import Array
from scancell.geometry import inverse_kinematics, pose
from scancell.geometry.continuation import SixJoints
from scancell.geometry.tree import Joint as TreeJoint
from scancell.geometry.tree import Tree

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


__all__ = ["Arm", "HeldJoint", "Joint"]


# Largest deviations of the pose from that of a chain with a closed form, in terms of the reach and rad.
_SMALL_LENGTH, _SMALL_ANGLE = 0.05, 0.1
_PROBES = 64  # joints at which such deviations are judged

# Joints that are added to chains of fewer than six, in general position; lengths in terms of the chain's.
_ADDED = (Joint(0.21, 0.13, 1.1), Joint(0.17, -0.19, 0.7))

_BLOCK = 512  # poses whose solutions are chosen at a time: they stay in the cache
_AT_LIMIT = 1e-9  # rad: solutions that exceed a limit by rounding count as at the limit


class Branches:
    """Inverse kinematics of a chain whose joints numbered in `held` (from 0) are at its angles, rad.

    It is that of the chain of all other joints, six or fewer.

    Attributes
    ----------
    dimensions
        a, d and alpha of the closed form; None without one.
    """

    def __init__(self, chain: Chain, held: Mapping[int, float]) -> None:
        self._held = held
        self._count = len(chain.joints)
        self._free = [i for i in range(self._count) if i not in held]
        self._flange_from_end = np.eye(4)
        self._chain = self._reduced(chain) if held else chain
        *others, last = self._chain.joints
        if last.beta != 0.0:  # it is part of the tool, and no matter of the axes
            self._flange_from_end = self._flange_from_end @ pose.from_rotation(pose.rotation_about(1, -last.beta))
            self._chain = Chain([*others, replace(last, beta=0.0)], self._chain.world_from_base)
        self._theta = self._chain.column("theta")
        self.dimensions = self._closed_form_dimensions()

    @property
    def suffix(self) -> str:
        return "".join(f", joint {i + 1} at {np.degrees(value):g} deg" for i, value in self._held.items())

    @property
    def is_named(self) -> bool:
        return self.dimensions is not None or self._neighbour is not None

    @property
    def branch_names(self) -> tuple[str, ...]:
        if self.is_named:
            return inverse_kinematics.BRANCH_NAMES
        return tuple(str(i) for i in range(1, inverse_kinematics.number_of_branches(self._completed[0]) + 1))

    def along(self, paths: Array, on_step: Callable[[int], None] | None = None) -> Array:
        """Joints (n, k, branches, joints) of the whole chain along paths (n, k, 4, 4), without regard to limits."""
        targets = paths @ self._flange_from_end
        n, k = paths.shape[:2]
        if self.is_named:
            q = self._configurations(targets.reshape(-1, 4, 4))
            q = q.reshape(n, k, *q.shape[1:])
        else:
            q = self._continued(targets, on_step)
        if not self._held:
            return q
        whole = np.full((*q.shape[:-1], self._count), np.nan)
        whole[..., self._free] = q
        for index, value in self._held.items():
            whole[..., index] = np.where(np.isfinite(q[..., 0]), value, np.nan)
        return whole

    def holds(self, q: Array) -> NDArray[np.bool_]:
        """Whether the held joints of q (n, joints) are at their angles, (n,)."""
        return np.asarray(np.isclose(q[:, [*self._held]], [*self._held.values()]).all(1))

    def near(self, targets: Array, seeds: Array) -> Array:
        """Joints (n, joints) of the whole chain for targets (n, 4, 4), each by Newton's method from a seed (n, joints).

        NaN from seeds that are NaN or do not converge.
        """
        found, usable = np.full_like(seeds, np.nan), np.isfinite(seeds).all(-1)
        own = seeds[usable].copy()
        ends = targets[usable] @ self._flange_from_end
        own[:, self._free] = inverse_kinematics.refine(self._chain, ends, own[:, self._free], iterations=12)
        found[usable] = np.where(np.isfinite(own).all(-1, keepdims=True), own, np.nan)
        return found

    def distance_outside_reach(self, targets: Array) -> Array:
        if self.dimensions is None:
            return np.full(len(targets), np.nan)
        base_from_end = pose.inverse(self._chain.world_from_base) @ targets @ self._flange_from_end
        return inverse_kinematics.distance_outside_reach(*self.dimensions, base_from_end)

    def _reduced(self, chain: Chain) -> Chain:
        q = np.zeros(self._count)
        for index, value in self._held.items():
            q[index] = value
        frames = Chain(chain.joints).link_poses(q)
        axes = frames[self._free]
        reduced, last_from_end = dh_from_axes(axes[:, :3, 3], axes[:, :3, 2], frames[-1])
        self._flange_from_end = pose.inverse(last_from_end)
        return Chain(reduced.joints, chain.world_from_base @ reduced.world_from_base)

    def _closed_form_dimensions(self) -> tuple[Array, Array, Array] | None:
        """a, d and alpha of the closed form. Where axes 2 and 3 are opposed, joint 3 counts the other way round."""
        if len(self._chain.joints) != 6:
            return None
        a, d, alpha, beta = (self._chain.column(name) for name in ("a", "d", "alpha", "beta"))
        self._sign = np.ones(6)
        if np.cos(alpha[1]) < 0:  # Rx(pi) Rz(q) T(a, 0, d) = Rz(-q) T(a, 0, -d) Rx(pi)
            self._sign[2], d[2] = -1.0, -d[2]
            alpha[1:3] += np.pi
        return (a, d, alpha) if inverse_kinematics.has_spherical_wrist(a, d, alpha, beta) else None

    def _configurations(self, targets: Array) -> Array:
        """Branches (n, 8, 6) in closed form, or refined from those of a chain nearby.

        Where two branches nearly meet, those of the neighbour may lead to one solution or none: there, all solutions
        are looked for and take the names of the neighbour's branches that have their joints.
        """
        if self.dimensions is not None:
            return self._closed_form(targets)
        assert self._neighbour is not None
        neighbour, slack = self._neighbour
        seeds = neighbour._closed_form(targets, slack)
        q = inverse_kinematics.refined(self._chain, targets, seeds)
        lost = (np.isfinite(seeds[..., 0]) & ~np.isfinite(q[..., 0])).any(1)
        if lost.any():
            found = inverse_kinematics.refined(
                self._chain, targets[lost], np.concatenate([q[lost], self._candidates(targets[lost])], 1)
            )
            for row, solutions in zip(np.flatnonzero(lost), found, strict=True):
                q[row] = self._named(solutions[np.isfinite(solutions[:, 0])], neighbour)
        return q

    def _named(self, solutions: Array, neighbour: Branches) -> Array:
        """Solutions (m, 6) by the branches (8, 6) of the neighbour; those without a place of their own in others."""
        named = np.full((len(inverse_kinematics.BRANCH_NAMES), 6), np.nan)
        own = neighbour._closed_form(neighbour._chain.fk(solutions))
        gap = np.abs(np.remainder(own - solutions[:, None] + np.pi, 2 * np.pi) - np.pi).max(-1)
        places = np.where(np.isfinite(gap), gap, np.inf).argmin(1)
        others = []
        for place, solution in zip(places, solutions, strict=True):
            if np.isnan(named[place, 0]):
                named[place] = solution
            else:
                others.append(solution)
        for place, solution in zip(np.flatnonzero(np.isnan(named[:, 0])), others, strict=False):
            named[place] = solution
        return named

    def _closed_form(self, targets: Array, slack: float = 0.0) -> Array:
        """Branches (n, 8, 6) of a chain with a closed form."""
        assert self.dimensions is not None
        base_from_end = pose.inverse(self._chain.world_from_base) @ targets
        return np.asarray(
            self._sign * inverse_kinematics.spherical_wrist_solutions(*self.dimensions, base_from_end, slack)
            - self._theta
        )

    def _candidates(self, targets: Array) -> Array:
        """Joints (n, m, joints) near all solutions for targets (n, 4, 4), to be refined; NaN beyond."""
        completed, flange_from_last = self._completed
        base_from_last = pose.inverse(self._chain.world_from_base) @ targets @ flange_from_last
        return inverse_kinematics.candidates(completed, len(self._theta), base_from_last) - self._theta

    def _continued(self, targets: Array, on_step: Callable[[int], None] | None) -> Array:
        """Numbered branches (n, k, branches, joints) along paths (n, k, 4, 4)."""
        joints, count = len(self._theta), inverse_kinematics.number_of_branches(self._completed[0])
        first = targets[:, 0]
        start = inverse_kinematics.distinct_solutions(self._chain, first, self._candidates(first), count)
        path = np.repeat(targets.swapaxes(0, 1), count, axis=1)
        q = inverse_kinematics.continued(self._chain, path, start.reshape(-1, joints), on_step)
        return q.reshape(-1, len(first), count, joints).swapaxes(0, 1)

    @cached_property
    def _completed(self) -> tuple[SixJoints, Array]:
        """The chain with joints added behind its flange up to six, and ``flange_from_last`` when those are at 0."""
        own = self._chain.joints
        reach = sum(float(np.hypot(joint.a, joint.d)) for joint in own)
        added = [replace(joint, a=reach * joint.a, d=reach * joint.d) for joint in _ADDED[: 6 - len(own)]]
        whole = Chain([*own, *added])
        rows = [tuple(float(x) for x in whole.column(name)) for name in ("a", "d", "alpha", "beta")]
        return SixJoints(*rows), Chain(added).fk(np.zeros(len(added)))

    @cached_property
    def _neighbour(self) -> tuple[Branches, float] | None:
        """A chain with a closed form from whose poses those of this one deviate little, as if calibrated; None if none.

        With it, by how much the wrist centres of both may differ, m.
        """
        if len(self._chain.joints) != 6:
            return None
        joints = []
        for i, joint in enumerate(self._chain.joints):
            alpha = joint.alpha if i == 5 else np.round(joint.alpha / (np.pi / 2)) * (np.pi / 2)
            d = 0.0 if i == 4 else joint.d
            joints.append(replace(joint, a=0.0 if i in (3, 4) else joint.a, d=d, alpha=alpha, beta=0.0))
        nearby = Branches(Chain(joints, self._chain.world_from_base), {})
        if nearby.dimensions is None:
            return None
        q = np.random.default_rng(0).uniform(-np.pi, np.pi, (_PROBES, 6))
        ours, theirs = self._chain.fk(q), nearby._chain.fk(q)
        length = float(np.linalg.norm(ours[:, :3, 3] - theirs[:, :3, 3], axis=1).max())
        turn = pose.log_rotation(np.swapaxes(theirs[:, :3, :3], 1, 2) @ ours[:, :3, :3])
        angle = float(np.linalg.norm(turn, axis=1).max())
        reach = sum(float(np.hypot(joint.a, joint.d)) for joint in joints)
        last = float(np.hypot(joints[5].a, joints[5].d))
        return (nearby, length + angle * last) if length < _SMALL_LENGTH * reach and angle < _SMALL_ANGLE else None


@dataclass(frozen=True)
class HeldJoint:
    """Joint number `index`, from 0, that inverse kinematics holds at each of `values` (rad) in turn."""

    index: int
    values: tuple[float, ...]


@dataclass(frozen=True)
class Arm(Chain):
    """Serial arm from its base, at `world_from_base` (4, 4), to its flange; tool transforms are up to the caller.

    An arm of more than six joints reaches a pose in infinitely many ways: `ik` holds one joint for each beyond six.
    """

    held: Sequence[HeldJoint] = ()

    @property
    def limits(self) -> Array:
        """Lower and upper joint limits (2, joints), rad."""
        return np.stack([self.column("min"), self.column("max")])

    @property
    def max_speed(self) -> Array:
        """Joint speed limits (joints,), rad/s."""
        return self.column("max_speed")

    @property
    def max_acceleration(self) -> Array:
        """Joint acceleration limits (joints,), rad/s²."""
        return self.column("max_acceleration")

    @property
    def has_closed_form(self) -> bool:
        """Whether `ik` is in closed form rather than numerical."""
        return all(part.dimensions is not None for part in self._parts)

    @property
    def has_named_branches(self) -> bool:
        """Whether a branch of `ik` is one configuration at all poses, rather than a number at each."""
        return all(part.is_named for part in self._parts)

    @cached_property
    def branch_names(self) -> tuple[str, ...]:
        """Names of the branches of `ik`: configurations where there is a closed form, else numbers from 1.

        Where joints are held, the names end with the values of those.
        """
        return tuple(name + part.suffix for part in self._parts for name in part.branch_names)

    def within_limits(self, q: ArrayLike, margin: float = 0.0) -> NDArray[np.bool_]:
        """Whether every joint of q (..., joints) is inside its limits by `margin` (rad), (...,); false for NaN."""
        q = np.asarray(q, float)
        lower, upper = self.limits
        return np.asarray(((q >= lower + margin) & (q <= upper - margin)).all(-1))

    def limit_violation(self, q: ArrayLike) -> Array:
        """Angle (..., joints), rad, by which each joint of q (..., joints) is outside its limits; 0 inside."""
        q = np.asarray(q, float)
        lower, upper = self.limits
        return np.asarray(np.maximum(0.0, np.maximum(lower - q, q - upper)))

    def nearest_turn(self, q: ArrayLike, reference: ArrayLike | None = None) -> Array:
        """q (..., joints) with multiples of 2 pi added per joint: inside the limits if possible, near `reference`.

        `reference` defaults to 0, or the limit nearest to it: a range of many turns has its middle many turns away,
        and a motion to there lasts for minutes. A joint that cannot be brought inside its limits ends
        as near to them as possible.
        """
        q = np.asarray(q, float)
        lower, upper = self.limits
        goal = np.clip(0.0, lower, upper) if reference is None else np.asarray(reference, float)
        turn = 2 * np.pi
        # Between the fewest turns that reach the lower limit and the most that keep the upper one.
        least, most = np.ceil((lower - _AT_LIMIT - q) / turn), np.floor((upper + _AT_LIMIT - q) / turn)
        nearest = np.clip(np.rint((goal - q) / turn), least, most)
        # Where none is inside, `most` ends below the limits and `least` above.
        too_low, too_high = lower - (q + turn * most), q + turn * least - upper
        nearest = np.where(least <= most, nearest, np.where(too_low < too_high, most, least))
        return np.asarray(q + turn * nearest)

    def ik(self, world_from_flange: ArrayLike, reference: ArrayLike | None = None, filtered: bool = True) -> Array:
        """Inverse kinematics: joint angles (n, branches, joints), rad, for targets (n, 4, 4); NaN without a solution.

        Closed form where there is one (`scancell.geometry.inverse_kinematics`), else numerical (`continuation`): all
        isolated solutions; of the infinitely many at a singular pose some; two closer than 1e-4 rad count as one. An
        arm of fewer than six joints attains few poses. Numbered branches are in no order from one pose to another, see
        `ik_along`.

        Parameters
        ----------
        reference
            (joints,) or (n, joints) joints near which multiples of 2 pi are chosen, see `nearest_turn`.
        filtered
            Whether branches that violate a joint limit become NaN, as branches without a solution do.
        """
        targets = np.asarray(world_from_flange, float).reshape(-1, 1, 4, 4)
        return self.ik_along(targets, reference, filtered)[:, 0]

    def ik_along(
        self,
        paths: ArrayLike,
        reference: ArrayLike | None = None,
        filtered: bool = True,
        on_step: Callable[[int], None] | None = None,
    ) -> Array:
        """Joint angles (n, k, branches, joints), rad, along paths of poses (n, k, 4, 4): a branch is one motion.

        Numbered branches are those of `ik` at the first pose, continued; `on_step` is called with the number of
        solutions before each step of that. Other parameters as in `ik`.
        """
        paths = np.asarray(paths, float)
        found = [part.along(paths, on_step) for part in self._parts]
        q = found[0] if len(found) == 1 else np.concatenate(found, axis=2)
        if reference is not None:
            reference = np.broadcast_to(np.asarray(reference, float), (len(paths), len(self.joints)))[:, None, None]
        for start in range(0, len(q), _BLOCK):
            rows = slice(start, start + _BLOCK)
            q[rows] = self._chosen(q[rows], None if reference is None else reference[rows], filtered)
        return q

    def near(self, world_from_flange: ArrayLike, seeds: Array, reference: Array | None = None) -> Array:
        """Joint angles (n, joints), rad, for targets (n, 4, 4) by Newton's method from seeds (n, joints) close to them.

        NaN without convergence or outside the limits; held joints stay. `reference` is as of `ik`.
        """
        targets = np.asarray(world_from_flange, float)
        found = np.full_like(seeds, np.nan)
        for part in self._parts:
            own = part.holds(seeds)
            found[own] = part.near(targets[own], seeds[own])
        near = None if reference is None else np.broadcast_to(reference, found.shape)
        return self._chosen(found, near, filtered=True)

    def _chosen(self, q: Array, reference: Array | None, filtered: bool) -> Array:
        """Solutions (..., joints) in the turn to choose, NaN outside the limits if `filtered`."""
        turned = self.nearest_turn(q, reference)
        held = [joint.index for joint in self.held]
        turned[..., held] = q[..., held]
        if not filtered:
            return turned
        inside = np.clip(turned, *self.limits)
        within = (np.abs(turned - inside) <= _AT_LIMIT).all(-1)
        inside[~within] = np.nan
        return inside

    def distance_outside_reach(self, world_from_flange: ArrayLike) -> Array:
        """Distance (n,), m, of the wrist centre of targets (n, 4, 4) from its reach; NaN without a closed form."""
        targets = np.asarray(world_from_flange, float).reshape(-1, 4, 4)
        return np.asarray(np.min([part.distance_outside_reach(targets) for part in self._parts], axis=0))

    @cached_property
    def _parts(self) -> list[Branches]:
        """Solvers for each combination of values of the held joints."""
        values = product(*(joint.values for joint in self.held))
        return [Branches(self, dict(zip((joint.index for joint in self.held), v, strict=True))) for v in values]
