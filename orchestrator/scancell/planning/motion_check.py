"""Proof that joint motions keep a clearance: exact distances and bounds on the motion, bisected.

At the middle of an interval of a motion, a pair of bodies at distance d keeps the clearance c in the whole interval if
d >= c + h, where h bounds the motion of one body relative to the other from the middle to either end (Schwarzer, Saha &
Latombe, "Exact collision checking of robot paths", 2002).  Intervals without this proof are halved.  Samples would miss
what is thinner than their spacing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.geometry import pose
from scancell.nominal.cell import Body, NominalCell
from scancell.proximity.scene import Clash, ProximityScene

Array = NDArray[np.float64]

_FARTHEST_SEARCH = 0.05  # m beyond the clearance: longer searches cost more than halving the interval
_CONTACT = 1e-9  # m: bodies closer than this intersect
_FINEST = 1e-5  # rad from the middle of an interval to its ends: what is not proved there counts as a violation


@dataclass(frozen=True)
class MotionClash(Clash):
    """A place where motion number `index` violates a clearance, at `fraction` of its way from 0 to 1."""

    fraction: float


@dataclass(frozen=True)
class _Sphere:
    """Bounding sphere of a body that `joints` joints of the arm carry: centre in the frame of the last one, m."""

    joints: int
    centre: Array
    radius: float


class MotionCheck:
    """Checks motions that are linear in the joints and the table angle.

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
    """

    def __init__(self, nominal: NominalCell, scene: ProximityScene, clearance: ArrayLike, threads: int = 0) -> None:
        self._nominal = nominal
        self._scene = scene
        self._clearance = np.broadcast_to(np.maximum(np.asarray(clearance, float), _CONTACT), (len(scene.pairs),))
        self._threads = threads
        joints = nominal.arm.joints
        self._axes = len(joints) + 1
        # Farthest that the frame after joint m can be from the axis of joint k <= m is the sum from k to m.
        self._link_length = np.array([np.hypot(joint.a, joint.d) for joint in joints])
        bodies = {body.name: body for body in nominal.bodies}
        self._pairs = [(bodies[a], bodies[b]) for a, b in scene.pairs]
        self._spheres = {body.name: self._sphere(body) for body in nominal.bodies}
        self._table_radius = {body.name: self._radius_on_table(body) for body in nominal.bodies}

    def first_clashes(self, start: ArrayLike, end: ArrayLike, deviation: ArrayLike = 0.0) -> list[MotionClash | None]:
        """One entry per motion: None if it is proved to keep all clearances, else a place where the proof fails.

        Parameters
        ----------
        start, end
            (n, joints + 1) joints and table angle, rad.
        deviation
            Largest deviation of the true motion from the straight one, one for all axes or (joints + 1,), rad.
        """
        start, end = np.atleast_2d(np.asarray(start, float)), np.atleast_2d(np.asarray(end, float))
        travel = np.abs(end - start)
        slack = np.broadcast_to(np.asarray(deviation, float), (self._axes,))
        found: list[MotionClash | None] = [None] * len(start)
        owner = np.arange(len(start))
        middle, half = np.full(len(start), 0.5), 0.5
        unproved = np.ones((len(start), len(self._pairs)), bool)
        while len(owner):
            at = start[owner] + middle[:, None] * (end - start)[owner]
            half_travel = half * travel[owner]
            moved = self._motion(at, half_travel + slack)
            searched = unproved & (moved <= _FARTHEST_SEARCH)
            bound = np.where(searched, self._clearance + moved, 0.0)
            distance = self._scene.distances(self._body_poses(at), bound, self._threads)
            unproved &= ~(searched & (distance >= bound))
            finest = (half_travel < _FINEST).all(1)
            # The deviation does not shrink: what is nearer than it allows cannot be proved in any smaller interval.
            needed = self._clearance + (self._motion(at, np.broadcast_to(slack, at.shape)) if slack.any() else 0.0)
            violated = unproved & ((searched & (distance < needed)) | finest[:, None])
            for i in np.flatnonzero(violated.any(1)):
                if found[owner[i]] is None:  # intervals are in order: the first one is the first on the motion
                    pair = int(np.argmin(np.where(violated[i], distance[i] - self._clearance, np.inf)))
                    nearest, required = float(distance[i, pair]), float(self._clearance[pair])
                    found[owner[i]] = MotionClash(
                        int(owner[i]), *self._scene.pairs[pair], nearest, required, float(middle[i])
                    )
            going_on = unproved.any(1) & np.array([found[o] is None for o in owner], bool)
            half /= 2
            owner = np.repeat(owner[going_on], 2)
            middle = (middle[going_on, None] + np.array([-half, half])).ravel()
            unproved = np.repeat(unproved[going_on], 2, axis=0)
        return found

    def clash_along(self, points: Array) -> MotionClash | None:
        """None if the motion of the controller through set-points (n, joints + 1), rad, is proved, else a clash.

        The controller interpolates by cubics, which leave the straight lines by less than a quarter of the second
        differences. Set-points are checked first: most motions that fail do so there, and proofs take longer.
        """
        deviation = np.abs(np.diff(points, n=2, axis=0)).max(0, initial=0.0) / 4
        for start, end in ((points, points), (points[:-1], points[1:])):
            found = [clash for clash in self.first_clashes(start, end, deviation) if clash is not None]
            if found:
                return min(found, key=lambda clash: clash.distance - clash.clearance)
        return None

    def _body_poses(self, at: Array) -> Array:
        return self._nominal.body_poses(at[:, :-1], at[:, -1])

    def _motion(self, at: Array, half_travel: Array) -> Array:
        """Bounds (n, pairs), m, on the motion of a body relative to the other while no axis moves by more.

        `at` and `half_travel` are (n, joints + 1), rad.
        """
        frames = self._nominal.arm.link_poses(at[:, :-1])
        reach = {name: self._reach(sphere, frames, half_travel) for name, sphere in self._spheres.items()}
        bounds = [self._pair_motion(a, b, reach, half_travel) for a, b in self._pairs]
        return np.stack(bounds, 1) if bounds else np.zeros((len(at), 0))

    def _pair_motion(self, a: Body, b: Body, reach: dict[str, Array], half_travel: Array) -> Array:
        if self._spheres[a.name].joints > self._spheres[b.name].joints:
            a, b = b, a
        first, last = self._spheres[a.name].joints, self._spheres[b.name].joints
        motion = (half_travel[:, first:last] * reach[b.name][:, first:last]).sum(1)
        radii = [self._table_radius[body.name] for body in (a, b)]
        if radii[0] is None and radii[1] is not None:
            motion = motion + half_travel[:, -1] * radii[1]
        elif radii[0] is not None and radii[1] is None:
            motion = motion + half_travel[:, -1] * radii[0]
        return np.asarray(motion)

    def _reach(self, sphere: _Sphere, frames: Array, half_travel: Array) -> Array:
        """Bounds (n, joints), m, on the distance of a body's points from the axes of the joints that carry it."""
        count = sphere.joints
        centre = (frames[:, count] @ np.append(sphere.centre, 1.0))[:, None, :3]
        lever = centre - frames[:, :count, :3, 3]
        axis = frames[:, :count, :3, 2]
        radius = np.linalg.norm(np.cross(axis, lever), axis=-1) + sphere.radius
        # Joints beyond joint k move the body towards its axis or away from it.
        farthest = np.cumsum(self._link_length[:count][::-1])[::-1] + np.linalg.norm(sphere.centre)
        shift = half_travel[:, :count] * farthest
        beyond = np.cumsum(shift[:, ::-1], 1)[:, ::-1] - shift
        return np.asarray(radius + beyond)

    def _sphere(self, body: Body) -> _Sphere:
        frame, _, number = body.moves_with.partition("[")
        joints = len(self._nominal.arm.joints)
        vertices = body.mesh.vertices
        if frame == "link":
            carried = int(number.rstrip("]"))
        elif frame in ("sensor", "finger"):
            carried = joints
            frames = self._nominal.frame_poses(self._nominal.home, 0.0)
            flange_from_body = pose.inverse(frames[f"link[{joints}]"]) @ frames[body.moves_with]
            vertices = pose.transform_points(flange_from_body, vertices)
        else:
            carried = 0
        centre = (vertices.min(0) + vertices.max(0)) / 2
        return _Sphere(carried, centre, float(np.linalg.norm(vertices - centre, axis=1).max()))

    def _radius_on_table(self, body: Body) -> float | None:
        """Largest distance of a body's points from the table's axis, m; None if it does not turn with the table."""
        here, turned = (self._nominal.frame_poses(self._nominal.home, angle) for angle in (0.0, 1.0))
        if np.allclose(here[body.moves_with], turned[body.moves_with]):
            return None
        table_from_body = pose.inverse(here["table"]) @ here[body.moves_with]
        return float(np.linalg.norm(pose.transform_points(table_from_body, body.mesh.vertices)[:, :2], axis=1).max())
