"""Poses of the parts that a gripper or a belt moves, from what is measured: joints, table, belts and the gripper.

A part is at its described pose until the gripper holds it, and rides on its belt by the measured travel.  From the
instant in which the gripper reports a grip the part moves with the flange, until the fingers open; then it stays where
it is, on the platter, on a belt or in the world.  How it slips in the grip or settles afterwards is not measured.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from scancell.arguments import checked_arguments
from scancell.arrays import Array, Flags
from scancell.config.cell import CellDescription
from scancell.config.description import si_value
from scancell.config.robot import RobotDescription
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh
from scancell.geometry.tree import WORLD
from scancell.guard.messages import PlacedPart
from scancell.nominal.cell import NominalCell, flange_from_tool
from scancell.nominal.parts import Body, pose_matrix
from scancell.proximity.motion_check import Budget, MotionBounds, MotionCheck, MotionClash, arm_motion
from scancell.proximity.scene import ProximityScene, arm_chain, carrying_axes

_OPENED = 0.5e-3  # m by which the fingers open to release a part
_NEAR_GRIP = 0.02  # m: a part farther from the space between the fingers is not what they hold
_ABOVE = 0.05  # m: a part that is released higher above the platter or a belt falls elsewhere
_RESTS = 1e-6  # m that a belt at rest travels between two states

TABLE = "table"

_SINGULAR = 0.01  # smallest singular value of the Jacobian from which on the controller moves the tool straight

_ROUNDING = 5e-6  # m: of proofs, which need some room
_NEARER, _NEARER_SHARE = 0.2e-3, 0.1  # m, and share of its distance, by which a pair may come nearer that does not

STILL = 1e-9  # m: pairs whose distance changes less in a short motion do not approach

_FINEST = 2e-4  # rad, and m of prismatic axes: finest intervals, a fraction of a millimetre of motion
_FIRST_SHARE = 1 / 16  # of the first piece of a path, after which a distance tells whether it grows

_LEVER_GROWTH = 1.1  # factor by which levers may grow during a stop


def movable_parts(cell: CellDescription) -> list[int]:
    """Numbers, from 1, of the free parts that a belt or a gripper can move."""
    is_moved = cell.gripper is not None
    numbers = [
        number
        for number, further in enumerate(cell.further_part, start=2)
        if further.fixture == "free" and (is_moved or further.conveyor)
    ]
    return [1, *numbers] if cell.part.fixture == "free" and (is_moved or cell.part.arrival) else numbers


@dataclass(frozen=True)
class _Place:
    """The frame that carries a part, and the pose (4, 4) of the part in it."""

    carrier: str
    pose: Array


class PartTracker:
    """Follows the parts of a cell that can be moved.

    Parameters
    ----------
    cell
        Its description.
    nominal
        The nominal cell with its parts.

    Examples
    --------
    >>> setup = scancell.load_setup(scancell.assets_dir() / "cells/pick_and_place.toml")
    >>> nominal = scancell.nominal_cell(setup.cell, scancell.load_part("part.stl"))
    >>> tracker = scancell.PartTracker(setup.cell, nominal)
    >>> axes = np.append(nominal.home, 0.0)
    >>> (part,) = tracker.update(axes, travel=[0.0], width=0.07, gripped=False)  # on its belt, in the world
    >>> part.number, part.carrier
    (1, 0)
    """

    @checked_arguments
    def __init__(self, cell: CellDescription, nominal: NominalCell) -> None:
        self._nominal, self._flange = nominal, nominal.arm.flange
        self._belts = {
            f"conveyor[{number}]": (si_value(belt, "length_mm") / 2, si_value(belt, "width_mm") / 2)
            for number, belt in enumerate(cell.conveyor, 1)
        }
        self._meshes: dict[int, Mesh] = {1: nominal.part}
        self._meshes |= {number: part.mesh for number, part in enumerate(nominal.further_parts, start=2)}
        self._places = {number: self._start(cell, number) for number in movable_parts(cell)}
        self._travel = np.zeros(len(self._belts))
        self._held: int | None = None
        self._width = np.inf  # at which the part is held
        self._grip = np.zeros((0, 3))
        if cell.gripper is not None:
            length = si_value(cell.gripper, "finger_length_mm")
            between = np.linspace(0.0, length, 10)[:, None] * [0.0, 0.0, 1.0]
            self._grip = pose.transform_points(pose_matrix(cell.gripper.pose), between)

    def update(self, axes: ArrayLike, travel: ArrayLike, width: float, gripped: bool) -> tuple[PlacedPart, ...]:
        """Poses of the parts, but for those on a belt that moves.

        Parameters
        ----------
        axes
            Measured positions, (axes,), rad or m.
        travel
            Measured travels of the belts, (belts,), m.
        width
            Measured distance between the pads, m.
        gripped
            Whether the gripper reports that it holds something.
        """
        axes, travel = np.asarray(axes, float), np.asarray(travel, float)
        moves, self._travel = np.abs(travel - self._travel) > _RESTS, travel
        moving = {frame for frame, moved in zip(self._belts, moves, strict=True) if moved}
        frames = self._nominal.tree.place([*axes, *travel])
        if self._held is not None and width > self._width + _OPENED:
            self._release(self._held, frames)
            self._held = None
        elif self._held is None and gripped:
            self._take(frames, width)
        numbers = {frame: number for number, frame in enumerate(carriers(self._nominal)) if number}
        return tuple(
            PlacedPart(number, 0, _numbers(frames[place.carrier] @ place.pose))
            if place.carrier not in numbers
            else PlacedPart(number, numbers[place.carrier], _numbers(place.pose))
            for number, place in self._places.items()
            if place.carrier not in moving
        )

    def _start(self, cell: CellDescription, number: int) -> _Place:
        if number > 1:
            further = cell.further_part[number - 2]
            return _Place(further.stands_on, pose_matrix(further.pose))
        arrival = cell.part.arrival
        if arrival is None:
            return _Place(TABLE, self._nominal.table_from_part)
        return _Place(arrival.stands_on, pose_matrix(arrival.pose))

    def _take(self, frames: Mapping[str, Array], width: float) -> None:
        """The part nearest to the space between the fingers moves with the flange from now on."""
        flange = frames[self._flange]
        grip = pose.transform_points(flange, self._grip)
        nearest, number = _NEAR_GRIP, None
        for candidate, place in self._places.items():
            in_part = pose.transform_points(pose.inverse(frames[place.carrier] @ place.pose), grip)
            low, high = self._meshes[candidate].bounds
            outside = np.maximum(np.maximum(low - in_part, in_part - high), 0.0)
            apart = float(np.linalg.norm(outside, axis=1).min())
            if apart < nearest:
                nearest, number = apart, candidate
        if number is not None:
            place = self._places[number]
            self._places[number] = _Place(self._flange, pose.inverse(flange) @ frames[place.carrier] @ place.pose)
            self._held, self._width = number, width

    def _release(self, number: int, frames: Mapping[str, Array]) -> None:
        """The part stays on the platter or belt below it, or in the world."""
        place = self._places[number]
        at = frames[place.carrier] @ place.pose
        mesh = self._meshes[number].transformed(at)
        centre = mesh.bounds.mean(0)
        carrier = WORLD
        for frame in (*self._belts, TABLE):
            top = frames[TABLE] if frame == TABLE else self._nominal.world_from(frame)  # belts stand where they are
            top_from_world = pose.inverse(top)
            across = np.abs(pose.transform_points(top_from_world, centre[None])[0, :2])
            height = pose.transform_points(top_from_world, mesh.vertices)[:, 2].min()
            half = self._belts.get(frame)
            inside = np.hypot(*across) < self._nominal.table_radius if half is None else (across < half).all()
            if inside and abs(height) < _ABOVE:
                carrier = frame
        self._places[number] = _Place(carrier, pose.inverse(frames[carrier]) @ at)


def carriers(nominal: NominalCell) -> tuple[str, ...]:
    """Frames by the numbers of `PlacedPart.carrier`: the world, then the frames behind all axes in their order."""
    links = (f"link[{i}]" for i in range(1, len(nominal.arm.joints) + 1))
    return (WORLD, *links, TABLE, *(axis.name for axis in nominal.further_axes))


def _numbers(at: Array) -> tuple[float, ...]:
    """Position and quaternion of a pose (4, 4)."""
    return tuple(float(value) for value in (*at[:3, 3], *pose.quaternion_from_rotation(at[:3, :3])))


class Tool:
    """Kinematics of the tool that Cartesian motion moves: the sensor, or the flange where this does not carry it.

    Attributes
    ----------
    joints
        Number of joints of the arm, the first axes; the next one is the table.
    active
        Numbers from 0 of the joints that Cartesian motion moves.
    held
        Those of the axes that it does not: other joints, and all axes beyond the table.
    """

    def __init__(self, nominal: NominalCell) -> None:
        self._motion, self._axes = arm_motion(nominal)
        self._flange_from_tool = flange_from_tool(nominal)
        self.joints = len(nominal.arm.joints)
        held = {joint.index for joint in nominal.arm.held}
        self.held = np.array([*sorted(held), *range(self.joints + 1, len(nominal.axes))], np.int64)
        self.active = np.array([i for i in range(self.joints) if i not in held], np.int64)

    def poses(self, axes: Array) -> tuple[Array, Array]:
        """``world_from_tool`` (n, 4, 4) at positions (n, axes), and the Jacobian (n, 6, joints) of its origin.

        The Jacobian is in world axes, linear velocity, then angular velocity, with all axes but the joints at rest.
        """
        placed, jacobian = self._placed(axes)
        return placed, jacobian[..., : self.joints]

    def twist(self, axes: Array, rates: Array) -> Array:
        """Velocity and angular velocity (6,), world axes, of the tool's origin at `axes` (axes,) with all `rates`."""
        return np.asarray(self._placed(axes[None])[1][0] @ rates[self._axes])

    def _placed(self, axes: Array) -> tuple[Array, Array]:
        return self._motion.tool_poses(axes[:, self._axes], len(self._axes) - 1, self._flange_from_tool)

    def moves_straight(self, jacobian: Array) -> bool:
        """Whether Cartesian motion is possible with a Jacobian (6, joints): six active joints, no singular position."""
        if len(self.active) != 6:
            return False
        return bool(np.linalg.svd(jacobian[:, self.active], compute_uv=False)[-1] >= _SINGULAR)

    def rates(self, jacobian: Array, twist: Array) -> Array:
        """Rates (n, joints), rad/s, of twists (n, 6) of the tool, world axes; held joints stand still."""
        rates = np.zeros((len(twist), jacobian.shape[-1]))
        rates[:, self.active] = np.linalg.solve(jacobian[..., self.active], twist[..., None])[..., 0]
        return rates

    def length(self, axes: Array) -> float:
        """Length (m) of the path of the tool's origin through positions (n, axes)."""
        position = self.poses(axes)[0][:, :3, 3]
        return float(np.linalg.norm(np.diff(position, axis=0), axis=1).sum())


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
        Error of the measured positions, one or (axes,), rad or m.

    Attributes
    ----------
    clearance, angle_error
        As given, (pairs,), m, and (axes,), rad or m.
    """

    def __init__(
        self, nominal: NominalCell, pairs: Sequence[tuple[str, str]], clearance: ArrayLike, angle_error: ArrayLike
    ) -> None:
        self._pairs, self._bounds = pairs, MotionBounds(nominal, pairs)
        self.clearance = np.broadcast_to(np.asarray(clearance, float), (len(pairs),))
        self.angle_error = np.broadcast_to(np.asarray(angle_error, float), (len(nominal.axes),))
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
        """Flags (pairs,) of the pairs within their clearance, and the distances (pairs,), m, that these have to keep.

        Where a session begins, a pair that is nearer than its stored distance by more than errors of the angles explain
        keeps its present distance: only something else than a permitted motion has brought it there.

        Parameters
        ----------
        axes
            Positions where the motion begins, (axes,), rad or m.
        distance
            Distance of the pairs at `axes`, (pairs,), m; NaN or infinite for pairs that have their room.
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
        (n, axes), rad or m, equally spaced in path clock.
    deviation
        Bound on the deviation of the axes from the straight motion from each point to the next, (n - 1, axes),
        rad or m.
    ends
        End of the motion from each point that pairs without room have to survive, (n - 1, axes), rad or m.
    aside
        The deviation that applies to those, (axes,), rad or m.
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
        """Distance of a pair of the scene at positions `axes` (axes,), m."""
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
        soon = start + _FIRST_SHARE * (path.points[1] - start)
        later = self._motions.distances(soon[None], far, budget)[0]
        slides = far & (later >= distance - STILL)
        return near | slides, np.where(slides, almost(distance, self._clearance), kept)


@dataclass(frozen=True)
class JogLimits:
    """Largest accelerations in manual operation: all axes (axes,), rad/s² or m/s², and the tool, m/s² and rad/s²."""

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
        Limits of the changes.
    """

    def __init__(self, nominal: NominalCell, pairs: Sequence[tuple[str, str]], limits: JogLimits) -> None:
        self._bounds, self._limits = MotionBounds(nominal, pairs), limits
        lever = {
            body.name: _lever(nominal, body)
            for body in nominal.bodies
            if nominal.tree.carrier_of(body.moves_with, nominal.axes)[0] == nominal.arm.flange
        }
        moving = {name for name in arm_chain(nominal) if name != "base"}
        # The limits of the tool are those of its motion in the world, not on what carries the arm.
        carriers_of_arm = set(nominal.tree.axes_of("base"))
        moving |= {body.name for body in nominal.bodies if carriers_of_arm & carrying_axes(nominal, body)}
        by_tool = {}
        for i, (a, b) in enumerate(pairs):
            on_tool = a if a in lever else b if b in lever else None
            if on_tool is not None and (b if on_tool == a else a) not in moving:
                by_tool[i] = limits.line + limits.turn * lever[on_tool]
        self._joints = len(nominal.arm.joints)
        self._on_tool, self._by_tool = np.array(list(by_tool), np.int64), np.array(list(by_tool.values()))  # m/s²

    def bound(self, axes: Array, time_squared: float) -> Array:
        """Bound (pairs,), m, on how much nearer accelerations of a jog at `axes` (axes,) bring each pair.

        Half of `time_squared` (s²) is the distance per unit of acceleration.
        """
        half = time_squared / 2
        is_joint = np.arange(len(axes)) < self._joints
        joints, others = np.where([is_joint, ~is_joint], self._limits.axes, 0.0)
        by_joints, by_others = self._bounds.pairs(axes[None], half * np.stack([joints, others])[:, None])[:, 0]
        by_joints[self._on_tool] = np.minimum(by_joints[self._on_tool], half * self._by_tool)
        return np.asarray(_LEVER_GROWTH * (by_joints + by_others))


def _lever(nominal: NominalCell, body: Body) -> float:
    """Largest distance of a body's points from the tool's origin, m."""
    frames = nominal.frame_poses(nominal.home)
    flange_from_body = pose.inverse(frames[nominal.arm.flange]) @ frames[body.moves_with]
    tool_from_body = pose.inverse(flange_from_tool(nominal)) @ flange_from_body
    return float(np.linalg.norm(pose.transform_points(tool_from_body, body.mesh.vertices), axis=1).max())
