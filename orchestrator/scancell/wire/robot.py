"""A robot of the running cell as its controller knows it: what every maker's interface reads and commands.

Lengths are in metres, angles in radians, times in simulated seconds; poses (4, 4) are ``base_from_tcp``, where the TCP
is the first tool of the cell, the sensor that the arm carries, until `VirtualRobot.flange_from_tcp` is set.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from scancell.arrays import Array
from scancell.cell.driver import Operation, refusal
from scancell.errors import CommandError, DescriptionError
from scancell.geometry import pose
from scancell.nominal.cell import flange_from_tool
from scancell.scanning.session import ScanSession

_LATCHED = 3  # controller.state of a stop that stays in force until a reset
_DAMPING = 1e-3  # of the inverse Jacobian: singular positions make no infinite speeds
_NO_LENGTH = 1e-6  # m: a line shorter than this is a turn
_JOINTS = 6  # of the robots whose controllers are emulated
_LOGGED = 3  # lines of one kind of refusals that are shown

Rates = Callable[[], Array]


class VirtualRobot:
    """A robot in a session, which nothing else steps.

    It moves by the cell's own controller: moves to an end, and streams of set-points. A command replaces the one
    before.

    Parameters
    ----------
    session
        A running cell at rest, guarded or not. A guard permits moves alone.

    Attributes
    ----------
    flange_from_tcp
        Pose (4, 4) of the TCP on the flange.
    outputs
        States of the digital outputs, bit by bit.
    """

    def __init__(self, session: ScanSession) -> None:
        self._session, self._cell, self._arm = session, session.cell, session.nominal.arm
        self._joints = len(self._arm.joints)
        self._measured = self._cell.real_group(self._cell.axis_names("measured."))
        names = [name for name in self._cell.names if name.startswith("measured.qd[")]
        self._rates = self._cell.real_group(names)
        self._commanded = self._cell.path_ahead(1)
        self._speed_in_force = self._cell.real_group(["command.monitor_speed"])
        self._presence = [name for name in self._cell.names if name.startswith("presence[") and "detected" in name]
        motion = session.world.setup.cell.robot.motion
        self._line_speed, self._turn_speed = motion.line_speed_mm_s * 1e-3, float(np.radians(motion.turn_speed_deg_s))
        self.flange_from_tcp = flange_from_tool(session.nominal)
        self.outputs = 0
        self._stream: _RateStream | None = None
        self._set_point: Array | None = None  # of a stream
        self._moves = False
        self._fault = ""
        # Of the present cycle; None: not asked for yet.
        self._targets: Array | None = None
        self._jacobian: Array | None = None
        self._poses: Array | None = None
        self._target_rates = np.zeros(self._joints)

    # State

    @property
    def cycle(self) -> float:
        """Cycle of the controller, s."""
        return self._session.cycle

    @property
    def time(self) -> float:
        """Simulated time, s."""
        return self._session.time

    @property
    def home(self) -> Array:
        """Joint angles (joints,) of the home position."""
        return self._session.home

    @property
    def max_acceleration(self) -> Array:
        """Limits (joints,) of the accelerations of the joints, rad/s²."""
        return self._arm.max_acceleration

    @property
    def joints(self) -> Array:
        """Measured joint angles (joints,)."""
        return self._cell.get(self._measured)[: self._joints].copy()

    @property
    def joint_rates(self) -> Array:
        """Measured rates (joints,) of the joints, rad/s."""
        return self._cell.get(self._rates).copy()

    @property
    def targets(self) -> Array:
        """Set-points (joints,) of the present cycle."""
        if self._targets is None:
            self._targets = self._cell.get(self._commanded)[: self._joints].copy()
        return self._targets

    @property
    def target_rates(self) -> Array:
        """Rates (joints,) of the set-points over the last cycle, rad/s."""
        return self._target_rates

    @cached_property
    def carrier_from_base(self) -> Array:
        """Pose (4, 4) of the base on what carries it, the world or an axis, which rests."""
        return np.asarray(self._arm.world_from_base)

    def base_from_flange(self, joints: ArrayLike) -> Array:
        """Pose (..., 4, 4) of the flange at joint angles (..., joints), by the nominal geometry."""
        return np.asarray(self._base_from_carrier @ self._arm.fk(joints))

    def base_from_tcp(self, joints: ArrayLike) -> Array:
        """Pose (..., 4, 4) of the TCP at joint angles (..., joints), by the nominal geometry."""
        return np.asarray(self.base_from_flange(joints) @ self.flange_from_tcp)

    def tcp_jacobian(self, joints: ArrayLike) -> Array:
        """Jacobian (6, joints) of the TCP in the axes of the base: linear velocity, then angular velocity."""
        whole = self._arm.jacobian(joints)
        rotation = self._base_from_carrier[:3, :3]
        linear, angular = rotation @ whole[:3], rotation @ whole[3:]
        arm = self.base_from_flange(joints)[:3, :3] @ self.flange_from_tcp[:3, 3]
        return np.vstack([linear + np.cross(angular.T, arm).T, angular])

    @property
    def tcp_poses(self) -> Array:
        """Poses (2, 4, 4) of the TCP: at the measured joints, and at the set-points."""
        if self._poses is None:
            self._poses = self.base_from_tcp(np.stack([self.joints, self.targets]))
        return self._poses

    @property
    def measured_jacobian(self) -> Array:
        """Jacobian (6, joints) of the TCP at the measured joints, see `tcp_jacobian`; set-points differ by little."""
        if self._jacobian is None:
            self._jacobian = self.tcp_jacobian(self.joints)
        return self._jacobian

    def joints_for(self, base_from_tcp: Array, near: ArrayLike | None = None) -> Array:
        """Joint angles (joints,) at a pose of the TCP, of all solutions nearest to `near`, by default the set-points.

        Raises
        ------
        CommandError
            If the arm does not reach it within its joint limits.
        """
        reference = self.targets if near is None else np.asarray(near, float)
        branches = self._arm.ik(self._carrier_from_flange(base_from_tcp), reference)[0]
        found = branches[np.isfinite(branches).all(-1)]
        if not len(found):
            place = ", ".join(f"{x * 1e3:.1f}" for x in base_from_tcp[:3, 3])
            raise CommandError(f"the TCP cannot be brought to ({place}) mm in this orientation within joint limits")
        return np.asarray(found[np.argmin(np.abs(found - reference).max(-1))])

    def is_within_limits(self, joints: ArrayLike) -> bool:
        """Whether joint angles (joints,) are within their limits."""
        return bool(self._arm.within_limits(joints))

    def joints_nearby(self, base_from_tcp: Array) -> Array | None:
        """Joint angles (joints,) at a pose near the present one, in less time than `joints_for`; None if it fails."""
        if self._arm.has_closed_form:
            try:
                return self.joints_for(base_from_tcp)
            except CommandError:
                return None
        near = self.targets[None]
        found = self._arm.near(self._carrier_from_flange(base_from_tcp)[None], near, near)[0]
        return np.asarray(found) if np.isfinite(found).all() else None

    @property
    def is_moving(self) -> bool:
        """Whether an axis moves."""
        return self._cell.get_boolean("controller.moving")

    @property
    def is_at_end(self) -> bool:
        """Whether the last move has ended; True without one."""
        return not self._moves

    @property
    def is_stopped(self) -> bool:
        """Whether a stop is in force that only `reset` ends: by the guard, by `stop`, or by a message that is late."""
        return self._cell.get_integer("controller.state") == _LATCHED

    @property
    def fault(self) -> str:
        """Reason for which the controller refuses or ended the last command; empty if it did not."""
        return self._fault

    @property
    def text(self) -> str:
        """What the pendant shows: a guard's reason, or the controller's."""
        return self._cell.get_string("pendant.text")

    @property
    def speed_fraction(self) -> float:
        """Speed that the operator allows, 0 to 1."""
        return self._session.monitor_speed

    @speed_fraction.setter
    def speed_fraction(self, share: float) -> None:
        self._session.set_monitor_speed(share)

    @property
    def speed_in_force(self) -> float:
        """Speed of moves and of streamed speeds, 0 to 1: that of the operator, or less by a guard."""
        return float(self._cell.get(self._speed_in_force)[0])

    @property
    def inputs(self) -> int:
        """Digital inputs, bit by bit: the presence sensors in their order."""
        return sum(self._cell.get_boolean(name) << i for i, name in enumerate(self._presence))

    # Commands; they take effect in the next cycle

    def move_joints(self, joints: ArrayLike, speed: float) -> None:
        """Move all joints to (joints,), so that the fastest has `speed`, rad/s; accelerations are the cell's own.

        Raises
        ------
        CommandError, DescriptionError
            If the joints are no angles.
        """
        # The fastest joint determines the time, as far as the speeds of all joints are those of the description.
        way = np.abs(np.asarray(joints, float) - self.targets)
        leading = int(np.argmax(way / self._arm.max_speed)) if len(way) == self._joints else 0
        self._begin(is_move=True)
        self._session.start_move_joints(joints, speed=_share(speed, float(self._arm.max_speed[leading])))

    def move_line(self, base_from_tcp: Array, speed: float) -> None:
        """Move the TCP straight to a pose at `speed`, m/s, or of a turn alone rad/s; accelerations are the cell's own.

        Raises
        ------
        CommandError, DescriptionError
            If it is no pose.
        """
        self._begin(is_move=True)
        nominal, axes = self._session.nominal, self._session.destination
        world_from_tcp = nominal.world_from(nominal.arm_on, axes) @ self.carrier_from_base @ base_from_tcp
        # The controller of the cell has one share for both speeds: that which the slower one needs.
        way = pose.inverse(self.base_from_tcp(self.targets)) @ base_from_tcp
        length, turn = np.linalg.norm(way[:3, 3]), np.linalg.norm(pose.log_rotation(way[:3, :3]))
        turning = speed * turn / length if length > _NO_LENGTH else speed
        share = max(_share(speed, self._line_speed), _share(float(turning), self._turn_speed))
        self._session.start_line_of(self.flange_from_tcp, world_from_tcp, share)

    def servo(self, joints: ArrayLike) -> Array:
        """Stream a set-point (joints,), which stays in force until the next one; a jump is made within the limits.

        Returns the set-point (joints,), clipped to the limits of the joints.
        """
        self._begin(is_move=False)
        self._set_point = np.clip(np.asarray(joints, float), *self._arm.limits)
        return self._set_point

    def move_at_rates(self, rates: Rates, acceleration: float) -> None:
        """Move at the joint rates (joints,), rad/s, that a function states in every cycle, by `speed_in_force`.

        They change by at most `acceleration`, rad/s², of the joint that changes most.
        """
        stream = self._stream or _RateStream(self.targets.copy(), np.zeros(self._joints), rates, acceleration)
        self._begin(is_move=False)
        stream.rates, stream.acceleration = rates, acceleration
        self._stream = stream

    def rates_for(self, tcp_velocity: ArrayLike) -> Array:
        """Joint rates (joints,) of a velocity (6,) of the TCP in the axes of the base, m/s and rad/s."""
        jacobian = self.tcp_jacobian(self.targets)
        square = jacobian @ jacobian.T + _DAMPING**2 * np.eye(6)
        return np.asarray(jacobian.T @ np.linalg.solve(square, np.asarray(tcp_velocity, float)))

    def hold(self) -> None:
        """End any motion: the axes come to rest at the accelerations of the cell."""
        self._fault = ""
        self._end()
        self._session.hold()

    def stop(self) -> None:
        """Stop as with the emergency stop, in force until `reset`."""
        self.hold()
        self._session.press_emergency_stop()

    def reset(self) -> None:
        """End a stop; motions do not continue."""
        self.hold()
        self._session.release_emergency_stop()

    def step(self) -> None:
        """Let a cycle of the controller pass."""
        before = self.targets
        if self._stream is not None:
            self._set_point = self._stream.step(self.cycle, self.speed_in_force, self._arm.max_speed, self._arm.limits)
        if self._set_point is not None:
            self._session.start_servo(self._set_point)
        self._session.step()
        self._targets = self._jacobian = self._poses = None
        self._target_rates = (self.targets - before) / self.cycle
        if self._moves or self._set_point is not None:
            self._look()

    # Implementation

    def _look(self) -> None:
        """Update whether the motion has ended, or was refused."""
        reason = refusal(self._cell)
        # A stream that runs into a limit waits there: the controller names the axis until the stream leads back.
        waits = not self._moves and self._cell.get_integer("controller.limit") != 0
        if self.is_stopped or (reason is not None and not waits):
            self.hold()
            self._fault = reason or self.text
        elif self._moves and self._cell.get_boolean("controller.at_destination"):
            self._moves = False

    def _begin(self, is_move: bool) -> None:
        self._end()
        self._fault, self._moves = "", is_move
        if self._cell.get_integer("command.operation") != Operation.AUTOMATIC:
            self._session.request_operation(Operation.AUTOMATIC)

    def _end(self) -> None:
        self._moves, self._stream, self._set_point = False, None, None

    @cached_property
    def _base_from_carrier(self) -> Array:
        return pose.inverse(self.carrier_from_base)

    def _carrier_from_flange(self, base_from_tcp: Array) -> Array:
        return np.asarray(self.carrier_from_base @ base_from_tcp @ pose.inverse(self.flange_from_tcp))


@dataclass
class _RateStream:
    """Set-points (joints,) and their rates, which follow the wanted ones within an acceleration, rad/s²."""

    position: Array
    rate: Array
    rates: Rates
    acceleration: float

    def step(self, cycle: float, share: float, max_speed: Array, limits: Array) -> Array:
        """Set-points a cycle later; `share` scales the wanted rates, which keep their ratio at the limits of speed."""
        wanted = share * self.rates()
        wanted = wanted / max(1.0, float((np.abs(wanted) / max_speed).max()))
        change = wanted - self.rate
        most = float(np.abs(change).max())
        self.rate = self.rate + change * min(1.0, self.acceleration * cycle / max(most, 1e-12))
        self.position = np.clip(self.position + self.rate * cycle, *limits)
        return self.position


class RobotController:
    """What the emulated controllers of all makers have: a robot, and a log of what they refuse.

    Parameters
    ----------
    robot
        The robot that it moves, of six joints.
    show
        Receives lines of the log.

    Raises
    ------
    DescriptionError
        If the robot has another number of joints.

    Attributes
    ----------
    refusals
        Number of refused requests by the interface that they came to.
    """

    robot: VirtualRobot

    def __init__(self, robot: VirtualRobot, show: Callable[[str], None] = lambda _: None) -> None:
        check_joints(len(robot.home))
        self.robot, self._show = robot, show
        self.refusals: Counter[str] = Counter()

    @property
    def cycle(self) -> float:
        """Cycle, s."""
        return self.robot.cycle

    def log(self, line: str) -> None:
        """Show a line."""
        self._show(f"{self.robot.time:10.3f} s  {line}")

    def refuse(self, interface: str, reason: str) -> None:
        """Count a refusal, and show the first ones of each interface."""
        self.refusals[interface] += 1
        if self.refusals[interface] <= _LOGGED:
            last = ": further ones are counted" if self.refusals[interface] == _LOGGED else ""
            self.log(f"refused by {interface}: {reason}{last}")


def check_joints(count: int) -> None:
    """Raise `DescriptionError` if an arm has not the number of joints of the robots whose controllers are emulated."""
    if count != _JOINTS:
        raise DescriptionError(key="cell.robot.joint", value=count, expected=f"{_JOINTS} joints")


def _share(speed: float, full: float) -> float:
    return float(np.clip(speed / full, 1e-4, 1.0))
