"""The controller of a simulated robot of ABB: externally guided motion (EGM)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from scancell.arrays import Array
from scancell.errors import MessageError, ScancellError
from scancell.wire.abb.packets import (
    JOINTS,
    POSE,
    ROBOT,
    SENSOR,
    Kind,
    Message,
    packed,
    pose_from,
    pose_message,
    unpacked,
)
from scancell.wire.robot import RobotController, VirtualRobot

COMM_TIMEOUT = 1.0  # s without a correction after which guidance ends: \CommTimeout of EGMSetupUC by default

_EGM = "EGM"
_ON, _OFF = 1, 2  # motorState
_ERROR, _STOPPED, _RUNNING = 1, 2, 3  # mciState
_RAPID_STOPPED, _RAPID_RUNNING = 1, 2  # rapidExecState
_AT_TARGET = np.radians(0.1)


class EgmController(RobotController):
    """Guides the robot by the corrections of a sensor; parameters and errors are those of `RobotController`.

    Guidance begins with a correction, and ends `COMM_TIMEOUT` after the last one, as by a program that starts it again.

    Attributes
    ----------
    is_guided
        Whether guidance is in force.
    """

    is_running = False

    def __init__(self, robot: VirtualRobot, show: Callable[[str], None] = lambda _: None) -> None:
        super().__init__(robot, show)
        self.is_guided = False
        self._last = 0.0  # time of the last correction
        self._target: Array | None = None  # joints (joints,)
        self._pose: Message | None = None  # of the last correction: what it says again needs no inverse kinematics
        self._has_failed = False
        self._least = float(robot.max_acceleration.min())

    @property
    def state(self) -> int:
        """State of guidance as EGM numbers it."""
        if self._has_failed or self.robot.is_stopped:
            return _ERROR
        return _RUNNING if self.is_guided else _STOPPED

    @property
    def is_at_target(self) -> bool:
        """Whether the robot rests where the last correction wants it."""
        if self._target is None or self.robot.is_moving:
            return False
        return bool(np.abs(self.robot.targets - self._target).max() < _AT_TARGET)

    def correct(self, message: Message) -> None:
        """Take a correction of a sensor.

        Raises
        ------
        MessageError, CommandError
            If it cannot be followed: the robot holds.
        """
        planned, speeds = message.get("planned", {}), message.get("speedRef", {})
        joints, place = planned.get(JOINTS, {}).get(JOINTS, []), planned.get(POSE)
        if planned.get("externalJoints", {}).get(JOINTS) or speeds.get("externalJoints", {}).get(JOINTS):
            raise MessageError(key="externalJoints", value="given", expected="none: no external axis is guided")
        if joints and place is not None:
            raise MessageError(key="planned", value="joints and a pose", expected="one of them")
        if joints:
            self._guide(lambda: self._follow(np.radians(self._all_joints(joints))))
        elif place is not None:
            self._guide(lambda: self._follow_pose(place))
        elif rates := speeds.get(JOINTS, {}).get(JOINTS, []):
            wanted = np.radians(self._all_joints(rates))
            self._guide(lambda: self._move_at(lambda: wanted))
        elif velocity := speeds.get("cartesians", {}).get("value", []):
            if len(velocity) != 6:
                raise MessageError(key="cartesians", value=len(velocity), expected="6 numbers")
            twist = np.append(1e-3 * np.array(velocity[:3]), np.radians(velocity[3:]))
            self._guide(lambda: self._move_at(lambda: self.robot.rates_for(twist)))
        elif self.is_guided:  # nothing new: what is in force stays
            self._last = self.robot.time

    def fail(self, reason: str) -> None:
        """Refuse a correction; the robot holds."""
        self.refuse(_EGM, reason)
        if self.is_guided:
            self._end()
            self._has_failed = True

    def step(self) -> None:
        """Let a cycle of the controller pass."""
        if self.is_guided:
            if self.robot.fault:
                self.log(f"guidance ends: {self.robot.fault}")
                self._end()
                self._has_failed = True
            elif self.robot.time - self._last > COMM_TIMEOUT:
                self.log(f"guidance ends: no correction for {COMM_TIMEOUT:g} s")
                self._end()
        self.robot.step()

    def _guide(self, command: Callable[[], None]) -> None:
        if self.robot.is_stopped:
            raise MessageError("a protective stop is in force")
        command()
        if not self.is_guided:
            self.log("guidance begins")
        self.is_guided, self._has_failed, self._last = True, False, self.robot.time

    def _follow(self, joints: Array) -> None:
        self._pose, self._target = None, joints
        self.robot.servo(joints)

    def _follow_pose(self, place: Message) -> None:
        if place == self._pose:
            return
        base_from_tcp = pose_from(place)
        joints = self.robot.joints_nearby(base_from_tcp)
        self._follow(self.robot.joints_for(base_from_tcp) if joints is None else joints)
        self._pose = place

    def _move_at(self, rates: Callable[[], Array]) -> None:
        self._pose = self._target = None
        self.robot.move_at_rates(rates, self._least)

    def _end(self) -> None:
        self.is_guided, self._pose, self._target = False, None, None
        self.robot.hold()

    def _all_joints(self, numbers: list[float]) -> list[float]:
        if len(numbers) != len(self.robot.home):
            raise MessageError(key=JOINTS, value=len(numbers), expected=f"{len(self.robot.home)} numbers")
        return numbers


class EgmServer:
    """The controller's end of an EGM session: states to a sensor, corrections from it.

    Attributes
    ----------
    is_started
        Whether the sensor has answered the last state by a correction.
    is_open
        True: datagrams have no connection.
    """

    is_open = True

    def __init__(self, controller: EgmController) -> None:
        self._controller = controller
        self._number = 0
        self.is_started = False

    def receive(self, received: bytes) -> bytes:
        """Take a message of the sensor; there is no answer to it."""
        try:
            message = unpacked(received, SENSOR)
            kind = message.get("header", {}).get("mtype")
            if kind != Kind.CORRECTION:
                raise MessageError(key="mtype", value=kind, expected=f"{int(Kind.CORRECTION)} (correction)")
        except MessageError as error:  # of no known sender: guidance goes on
            self._controller.refuse(_EGM, str(error))
            return b""
        self.is_started = True
        try:
            self._controller.correct(message)
        except ScancellError as error:
            self._controller.fail(str(error))
        return b""

    def cycle(self) -> bytes:
        """State of the robot."""
        robot, controller = self._controller.robot, self._controller
        self._number += 1
        self.is_started = False
        measured, commanded = (pose_message(place) for place in robot.tcp_poses)
        microseconds = round(1e6 * robot.time)
        clock = {"sec": microseconds // 1_000_000, "usec": microseconds % 1_000_000}
        stopped = robot.is_stopped
        message = {
            "header": {"seqno": self._number % 2**32, "tm": microseconds // 1000 % 2**32, "mtype": Kind.DATA},
            "feedBack": {JOINTS: {JOINTS: np.degrees(robot.joints).tolist()}, POSE: measured, "time": clock},
            "planned": {JOINTS: {JOINTS: np.degrees(robot.targets).tolist()}, POSE: commanded, "time": clock},
            "motorState": {"state": _OFF if stopped else _ON},
            "mciState": {"state": controller.state},
            "mciConvergenceMet": controller.is_at_target,
            "rapidExecState": {"state": _RAPID_STOPPED if stopped else _RAPID_RUNNING},
        }
        return packed(message, ROBOT)

    def close(self) -> None:
        """End."""
