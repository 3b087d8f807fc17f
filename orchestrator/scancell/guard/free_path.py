"""Free length of a path that the controller shows: how far the robot is proved to keep all clearances on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.config.description import si_value
from scancell.config.robot import RobotDescription
from scancell.geometry import pose
from scancell.nominal.cell import Body, NominalCell
from scancell.proximity.motion_check import Budget, MotionBounds, MotionCheck, MotionClash
from scancell.proximity.scene import ProximityScene, arm_chain

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

_ROUNDING = 5e-6  # m: of proofs, which need some room
_NEARER, _NEARER_SHARE = 0.2e-3, 0.1  # m, and share of its distance, by which a pair may come nearer that does not

STILL = 1e-9  # m: pairs whose distance changes less in a short motion do not approach

_FINEST = 2e-4  # rad: finest intervals, a fraction of a millimetre of motion
_SOON = 1 / 16  # of the first piece, in which the distance changes, for the direction of its change

_LONGER = 1.1  # levers may grow by as much on the way of a stop


class NearPairs:
    """Distances that pairs within their clearance have to keep.

    Parameters
    ----------
    nominal
        Kinematics and bodies.
    pairs
        Names of the bodies of each pair.
    clearance
        Distance that counts as contact, one for all pairs or (pairs,), m.
    angle_error
        Of the measured angles, one or (axes,), rad.

    Attributes
    ----------
    clearance, angle_error
        As given, (pairs,), m, and (axes,), rad.
    """

    def __init__(
        self, nominal: NominalCell, pairs: Sequence[tuple[str, str]], clearance: ArrayLike, angle_error: ArrayLike
    ) -> None:
        self._pairs, self._bounds = pairs, MotionBounds(nominal, pairs)
        self.clearance = np.broadcast_to(np.asarray(clearance, float), (len(pairs),))
        self.angle_error = np.broadcast_to(np.asarray(angle_error, float), (len(nominal.arm.joints) + 1,))
        self._begins = True
        self.release()

    def release(self) -> None:
        """Forget all pairs: each has its clearance again."""
        self._kept = np.full(len(self.clearance), np.inf)

    def take_over(self, before: NearPairs) -> None:
        """Keep the distances of those pairs that other bodies of a cell had `before`."""
        kept = dict(zip(before._pairs, before._kept.tolist(), strict=True))
        self._kept = np.array([kept.get(pair, np.inf) for pair in self._pairs])
        self._begins = before._begins

    def begin_session(self) -> None:
        """Accept in the next update that something else than a permitted motion has brought pairs nearer."""
        self._begins = True

    def update(self, axes: Array, distance: Array, exact: bool) -> tuple[Flags, Array]:
        """Which pairs (pairs,) are within their clearance, and the distances (pairs,), m, that those have to keep.

        Where a session begins, a pair that is nearer than its stored distance by more than errors of the angles explain
        keeps its present distance: only something else than a permitted motion has brought it there.

        Parameters
        ----------
        axes
            Joints and table angle where the motion begins, (axes,), rad.
        distance
            Of the pairs at `axes`, (pairs,), m; NaN or infinite for pairs that have their room.
        exact
            Whether `axes` are set-points, not measured.
        """
        of_axes = self._bounds.pairs(axes[None], np.diag(self.angle_error)[:, None])[:, 0]
        near = distance <= self.clearance + of_axes.sum(0)
        # The errors of the axes are independent.
        feigned = np.zeros(len(near)) if exact else np.sqrt((of_axes**2).sum(0))
        stays = np.isfinite(self._kept) & ((distance >= self._kept - feigned - _ROUNDING) | (not self._begins))
        self._begins = False
        self._kept = np.where(near, np.where(stays, self._kept, distance - feigned - _ROUNDING), np.inf)
        return near, np.where(near, self._kept, -np.inf)


def almost(distance: Array, clearance: Array) -> Array:
    """Distances (pairs,), m, that pairs with their `clearance` keep if a motion does not reduce their `distance`."""
    return np.maximum(clearance, distance - np.maximum(_NEARER, _NEARER_SHARE * distance))


@dataclass(frozen=True)
class ShownPath:
    """Set-points of a path, and how far the robot may be from it.

    Attributes
    ----------
    points
        (n, axes), rad, equally spaced in path clock.
    deviation
        Bound on the deviation of the axes from the straight motion from each point to the next, (n - 1, axes),
        rad.
    ends
        End of the motion from each point that pairs without room have to survive, (n - 1, axes), rad.
    aside
        The deviation that applies to those, (axes,), rad.
    exact
        Whether the first point is a set-point, not measured.
    """

    points: Array
    deviation: Array
    ends: Array
    aside: Array
    exact: bool = True


@dataclass(frozen=True)
class Section:
    """Pieces of a path from `begin` to `end`, of which `parts` (a power of 2) are distinguished in each."""

    begin: int
    end: int
    parts: int


class FreePath:
    """Searches for the first place of a path that is not proved free.

    Parameters
    ----------
    nominal
        Kinematics and bodies.
    scene
        Pairs of these bodies.
    near
        Distances that count as contact, and the pairs within them.
    """

    def __init__(self, nominal: NominalCell, scene: ProximityScene, near: NearPairs) -> None:
        self._motions = MotionCheck(nominal, scene, near.clearance, 1, _FINEST)
        self._pairs, self._near, self._clearance = scene.pairs, near, near.clearance
        self.angle_error = near.angle_error

    def search(self, path: ShownPath, sections: Sequence[Section], budget: Budget) -> tuple[float, MotionClash | None]:
        """Pieces that are proved free, one section after the other, and the clash behind them; None: there is none."""
        near, kept = self._without_room(path, budget)
        room = np.where(near, -np.inf, self._clearance)
        for section in sections:
            pieces = slice(section.begin, section.end)
            if section.end <= section.begin:
                continue
            begins, ends, deviation = path.points[pieces], path.points[1:][pieces], path.deviation[pieces]
            first = self._motions.first_violations(begins, ends, section.parts, deviation, room, budget)
            if near.any():
                nearer = self._motions.first_violations(
                    begins, path.ends[pieces], section.parts, path.aside, kept, budget
                )
                first = np.minimum(first, nearer)
            if np.isfinite(first).any():
                number = int(np.argmin(first))
                piece, share = divmod(section.begin + float(first[number]), 1.0)
                return piece + share, self._clash(path.points, int(piece), share, number)
        return float(max(section.end for section in sections)), None

    def distance(self, axes: Array, pair: tuple[str, str]) -> float:
        """Distance of a pair of the scene at `axes` (axes,), rad, m."""
        return self._distance(axes, self._pairs.index(pair))

    def _clash(self, points: Array, piece: int, share: float, number: int) -> MotionClash:
        place = points[piece] + share * (points[piece + 1] - points[piece])
        clearance = float(self._clearance[number])
        return MotionClash(piece, *self._pairs[number], self._distance(place, number), clearance, share)

    def _distance(self, axes: Array, number: int) -> float:
        one = np.arange(len(self._pairs)) == number
        return float(self._motions.distances(axes[None], one)[0, number])

    def _without_room(self, path: ShownPath, budget: Budget) -> tuple[Flags, Array]:
        """Pairs (pairs,) whose distances must not become less than others (pairs,), m.

        They are within their clearance (`NearPairs.update`), or within that and the deviation where the path begins and
        does not reduce their distance.
        """
        start = path.points[0]
        violated = self._motions.violations(start[None], start[None], path.deviation[0], budget=budget)
        distance = self._motions.distances(start[None], violated, budget)[0]
        near, kept = self._near.update(start, distance, path.exact)
        far = violated & ~near
        if not far.any():
            return near, kept
        soon = start + _SOON * (path.points[1] - start)
        later = self._motions.distances(soon[None], far, budget)[0]
        slides = far & (later >= distance - STILL)
        return near | slides, np.where(slides, almost(distance, self._clearance), kept)


@dataclass(frozen=True)
class JogLimits:
    """Largest accelerations in manual operation: of all axes (axes,), rad/s², of the tool, m/s² and rad/s²."""

    axes: Array
    line: float
    turn: float


def jog_limits(robot: RobotDescription, nominal: NominalCell) -> JogLimits:
    """The limits that the controller of a described robot keeps."""
    motion = robot.motion
    return JogLimits(
        motion.jog_joint_share * nominal.axis_max_acceleration,
        si_value(motion, "jog_acceleration_mm_s2"),
        si_value(motion, "jog_turn_acceleration_deg_s2"),
    )


class UnseenApproach:
    """Bounds the approach of pairs of bodies by changes of a jog.

    Parameters
    ----------
    nominal
        Kinematics and bodies.
    pairs
        Names of the bodies of each pair.
    limits
        Of the changes.
    """

    def __init__(self, nominal: NominalCell, pairs: Sequence[tuple[str, str]], limits: JogLimits) -> None:
        self._bounds, self._limits = MotionBounds(nominal, pairs), limits
        lever = {body.name: _lever(nominal, body) for body in nominal.bodies if _is_on_tool(nominal, body)}
        moving = {name for name in arm_chain(nominal) if name != "base"}
        by_tool = {}
        for i, (a, b) in enumerate(pairs):
            on_tool = a if a in lever else b if b in lever else None
            if on_tool is not None and (b if on_tool == a else a) not in moving:
                by_tool[i] = limits.line + limits.turn * lever[on_tool]
        self._on_tool, self._by_tool = np.array(list(by_tool), np.int64), np.array(list(by_tool.values()))  # m/s²

    def bound(self, axes: Array, time_squared: float) -> Array:
        """Bound (pairs,), m, at `axes` (axes,), rad, on what accelerations add in half of `time_squared`, s²."""
        half = time_squared / 2
        joints, table = self._limits.axes.copy(), np.zeros_like(self._limits.axes)
        table[-1], joints[-1] = joints[-1], 0.0
        by_joints, by_table = self._bounds.pairs(axes[None], half * np.stack([joints, table])[:, None])[:, 0]
        by_joints[self._on_tool] = np.minimum(by_joints[self._on_tool], half * self._by_tool)
        return np.asarray(_LONGER * (by_joints + by_table))


def _is_on_tool(nominal: NominalCell, body: Body) -> bool:
    return body.moves_with in ("sensor", "finger[1]", "finger[2]", f"link[{len(nominal.arm.joints)}]")


def _lever(nominal: NominalCell, body: Body) -> float:
    """Largest distance of a body's points from the tool's origin, m."""
    frames = nominal.frame_poses(nominal.home)
    tool_from_body = pose.inverse(frames["sensor"]) @ frames[body.moves_with]
    return float(np.linalg.norm(pose.transform_points(tool_from_body, body.mesh.vertices), axis=1).max())
