"""Proof that joint motions keep a clearance: exact distances and bounds on the motion, bisected.

At the middle of an interval of a motion, a pair of bodies at distance d keeps the clearance c in the whole interval if
d >= c + h, where h bounds the motion of one body relative to the other from the middle to either end (Schwarzer, Saha &
Latombe, "Exact collision checking of robot paths", 2002).  Parts of the bodies need room only for their own motion
along the direction that separates them.  Intervals without this proof are halved.  Samples would miss what is thinner
than their spacing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from scancell.arrays import Array, Flags
from scancell.geometry import pose
from scancell.geometry.tree import WORLD, Tree
from scancell.nominal.cell import NominalCell
from scancell.nominal.parts import Body
from scancell.proximity._native import CellMotion, MotionProof
from scancell.proximity.scene import Clash, ProximityScene

_KINDS = {"fixed": 0, "revolute": 1, "prismatic": 2}
_WORLD = -1  # as the parent of a joint, or the frame of a body

_CONTACT = 1e-9  # m: bodies closer than this intersect
_FINEST = 1e-5  # rad, and m of prismatic axes
_UNLIMITED = 2**62
_BLOCK = 512  # motions between two looks at the work
_MOTION_WORK = 3e-4  # about seconds, for a motion and for each radian of it


class MotionBounds:
    """Motion bounds of pairs of bodies, by their bounding spheres.

    Parameters
    ----------
    nominal
        Kinematics and bodies.
    pairs
        Names of the bodies of each pair.

    Attributes
    ----------
    native
        Kinematics and bounds of the compiled module.
    """

    def __init__(self, nominal: NominalCell, pairs: Sequence[tuple[str, str]]) -> None:
        number = {body.name: i for i, body in enumerate(nominal.bodies)}
        index = np.array([(number[a], number[b]) for a, b in pairs], np.int64).reshape(-1, 2)
        joints = _joints(nominal.tree, nominal.axes)
        bodies = np.array([_row(nominal, body) for body in nominal.bodies])
        self.native = CellMotion(joints, len(joints), bodies, index)

    def pairs(self, at: Array, half_travel: Array) -> Array:
        """Bounds (..., n, pairs), m, on the motion of a body relative to the other while no axis moves by more.

        `at` is (n, axes) and `half_travel` (..., n, axes), rad or m.
        """
        return self.straight(at, np.zeros_like(half_travel), half_travel)

    def straight(self, at: Array, half: Array, slack: Array) -> Array:
        """The same while axes follow a straight line from `at`, by `half` times -1 to 1, and leave it by `slack`."""
        half, slack = np.broadcast_arrays(np.asarray(half, float), np.asarray(slack, float))
        axes = half.shape[-1]
        here = np.broadcast_to(at, half.shape).reshape(-1, axes)
        found = self.native.bounds(here, half.reshape(-1, axes), slack.reshape(-1, axes))
        return found.reshape(*half.shape[:-1], found.shape[-1])


def arm_motion(nominal: NominalCell) -> tuple[CellMotion, list[int]]:
    """Kinematics of the arm and of what carries it, whose last frame is the flange.

    Its axes are those of the cell with the numbers that are returned, from 0: the joints, then what carries the arm.
    """
    moving = set(nominal.tree.axes_of(nominal.arm.flange))
    numbers = [i for i, axis in enumerate(nominal.axes) if axis in moving]
    joints = _joints(nominal.tree, [nominal.axes[i] for i in numbers])
    return CellMotion(joints, len(joints), np.zeros((0, 22)), np.zeros((0, 2), np.int64)), numbers


def _moved_frames(tree: Tree, axes: Sequence[str]) -> list[str]:
    return [joint.frame for joint in tree.joints if joint.axis in axes]


def _joints(tree: Tree, axes: Sequence[str]) -> Array:
    """Joints (n, 35) that the axes move: kind, parent, axis, and the constant poses before and behind each."""
    frames = _moved_frames(tree, axes)
    rows = []
    for frame in frames:
        joint = tree[frame]
        carrier, carrier_from_parent = tree.carrier_of(joint.parent, axes)
        parent = _WORLD if carrier == WORLD else frames.index(carrier)
        numbers = [_KINDS[joint.kind], parent, axes.index(joint.axis)]
        before = carrier_from_parent @ joint.parent_from_joint
        rows.append(np.concatenate([numbers, before.ravel(), joint.frame_at_zero.ravel()]))
    return np.array(rows).reshape(-1, 35)


def _row(nominal: NominalCell, body: Body) -> Array:
    """Parameters (22,) of a body for the native kinematics.

    Frame that carries it, bounding sphere (centre and radius) in it, largest distance of the body from the axis of the
    last joint that moves it, and its pose in the frame.
    """
    tree, axes = nominal.tree, nominal.axes
    carrier, carrier_from_body = tree.carrier_of(body.moves_with, axes)
    points = pose.transform_points(carrier_from_body, body.mesh.vertices)
    centre = (points.min(0) + points.max(0)) / 2
    radius = np.linalg.norm(points - centre, axis=1).max()
    number, from_axis = _WORLD, 0.0
    if carrier != WORLD:
        number = _moved_frames(tree, axes).index(carrier)
        in_joint = pose.transform_points(tree[carrier].frame_at_zero, points)
        from_axis = np.linalg.norm(in_joint[:, :2], axis=1).max()
    return np.concatenate([[number], centre, [radius, from_axis], carrier_from_body.ravel()])


@dataclass
class Budget:
    """Work that searches may still do, in comparisons of faces and of their bounding volumes (about 0.1 µs each).

    Nothing more is proved when it is used up. A search that has begun is finished.
    """

    left: int = _UNLIMITED
    whole: Budget | None = None  # of which it is a part

    def share(self, parts: int) -> Budget:
        """An equal share for the first of `parts` searches; what it does not use is left to the others."""
        return Budget(self.left // parts, self)

    def spend(self, work: int) -> None:
        """Take work from it, and from that of which it is a part."""
        self.left -= work
        if self.whole is not None:
            self.whole.spend(work)


@dataclass(frozen=True)
class MotionClash(Clash):
    """A violation of a clearance by motion number `index`, at `fraction` (0 to 1) of its path."""

    fraction: float


class MotionCheck:
    """Checks motions that are linear in the positions of the axes, rad or m.

    Parameters
    ----------
    nominal
        Kinematics and bodies.
    scene
        Pairs of these bodies.
    clearance
        Distance to keep, one for all pairs or (pairs,), m.
    threads
        Threads of the distance queries, which do not change the result; 0 uses all cores.
    finest
        Travel of each axis from the middle of an interval to its ends, rad or m: what is not proved there counts as a
        violation. At a distance of 1 m from its axis, a joint moves a body as far as an axis that slides.
    spend
        Called with the estimated work of every block of motions of `first_clashes`, before it is done.
    """

    def __init__(
        self,
        nominal: NominalCell,
        scene: ProximityScene,
        clearance: ArrayLike,
        threads: int = 0,
        finest: float = _FINEST,
        spend: Callable[[float], None] | None = None,
    ) -> None:
        self._scene = scene
        self._clearance = np.broadcast_to(np.asarray(clearance, float), (len(scene.pairs),))
        self._threads = threads
        self._finest, self._spend = finest, spend
        self._native = MotionProof(scene.native, MotionBounds(nominal, scene.pairs).native)

    def first_clashes(
        self, start: ArrayLike, end: ArrayLike, deviation: ArrayLike = 0.0, clearance: ArrayLike | None = None
    ) -> list[MotionClash | None]:
        """One entry per motion: None if it is proved to keep all clearances, else a place where it does not.

        Parameters
        ----------
        start, end
            (n, axes) positions, rad or m.
        deviation
            Largest deviation of the true motion from the straight one, one for all axes, (axes,) or
            (n, axes), rad or m. Where the distance does not allow for it, the motion violates the clearance.
        clearance
            In place of that of the check, (pairs,) or (n, pairs), m; pairs of ``-inf`` are not checked.
        """
        motions = self._motions(start, end, deviation, clearance)
        found: list[MotionClash | None] = []
        for first in range(0, len(motions[0]), _BLOCK):
            from_, to, slack, required = (one[first : first + _BLOCK] for one in motions)
            if self._spend is not None:
                self._spend(_MOTION_WORK * float((1 + np.abs(to - from_).max(1)).sum()))
            clashes = self._native.first_clashes(from_, to, slack, required, self._finest, self._threads)
            for i, clash in enumerate(clashes):
                if clash is None:
                    found.append(None)
                    continue
                pair, distance, fraction = clash
                needed = max(float(required[i, pair]), _CONTACT)
                found.append(MotionClash(first + i, *self._scene.pairs[pair], distance, needed, fraction))
        return found

    def violations(
        self,
        start: Array,
        end: Array,
        deviation: ArrayLike = 0.0,
        clearance: ArrayLike | None = None,
        budget: Budget | None = None,
        finest: float | None = None,
    ) -> Flags:
        """Whether each pair (pairs,) is not proved to keep its clearance on any of the motions from `start` to `end`.

        `finest` is in place of that of the check; others as in `first_clashes`. What this and the two following
        functions find out about a pair shortens their next call: one thread may use them at a time.
        """
        budget = budget or Budget()
        motions = self._motions(start, end, deviation, clearance)
        violated, work = self._native.violations(*motions, finest or self._finest, max(budget.left, 0))
        budget.spend(work)
        return violated

    def first_violations(
        self,
        start: Array,
        end: Array,
        parts: int,
        deviation: ArrayLike = 0.0,
        clearance: ArrayLike | None = None,
        budget: Budget | None = None,
    ) -> Array:
        """Where the first pairs (pairs,) are not proved to keep their clearance, in motions one after the other.

        It is the beginning of one of `parts` equal parts of a motion from `start` to `end`, and counted in motions;
        infinite for other pairs. `parts` is a power of 2; others as in `violations`.
        """
        budget = budget or Budget()
        motions = self._motions(start, end, deviation, clearance)
        first, work = self._native.first_violations(*motions, self._finest, parts, max(budget.left, 0))
        budget.spend(work)
        return first

    def distances(self, axes: Array, pairs: Flags, budget: Budget | None = None) -> Array:
        """Distances (n, pairs), m, at `axes` (n, axes), rad or m, of some `pairs` (pairs,); NaN of the others.

        They take work from a budget and do not end with it.
        """
        found, work = self._native.distances(axes, pairs)
        if budget is not None:
            budget.spend(work)
        return found

    def clash_along(self, points: Array) -> MotionClash | None:
        """None if the motion of the controller through set-points (n, axes), rad or m, is proved, else a clash.

        The controller interpolates by cubics, which leave the straight lines by less than a quarter of the second
        differences. Set-points are checked first: most motions that fail do so there, and proofs take longer.
        """
        deviation = np.abs(np.diff(points, n=2, axis=0)).max(0, initial=0.0) / 4
        for start, end in ((points, points), (points[:-1], points[1:])):
            found = [clash for clash in self.first_clashes(start, end, deviation) if clash is not None]
            if found:
                return min(found, key=lambda clash: clash.distance - clash.clearance)
        return None

    def _motions(
        self, start: ArrayLike, end: ArrayLike, deviation: ArrayLike, clearance: ArrayLike | None
    ) -> tuple[Array, Array, Array, Array]:
        """Start, end and deviation (n, axes), rad or m, and clearance (n, pairs), m."""
        start, end = np.atleast_2d(np.asarray(start, float)), np.atleast_2d(np.asarray(end, float))
        slack = np.broadcast_to(np.asarray(deviation, float), start.shape)
        given = self._clearance if clearance is None else np.asarray(clearance, float)
        return start, end, slack, np.broadcast_to(given, (len(start), len(self._scene.pairs)))
