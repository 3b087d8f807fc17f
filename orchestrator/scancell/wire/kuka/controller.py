"""The controller of a simulated robot of KUKA: sensor-guided motion by the RobotSensorInterface (RSI)."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from scancell.arrays import Array
from scancell.errors import CommandError, MessageError
from scancell.geometry import pose
from scancell.wire.kuka.packets import (
    AXES,
    AXIS_CORRECTION,
    FRAME,
    POSE_CORRECTION,
    Answer,
    answer_from,
    frame_of,
    pose_from,
    state_packet,
)
from scancell.wire.robot import RobotController, VirtualRobot

MOST_LATE = 100  # packets in a row without an answer in time, after which RSI ends: Timeout of the ETHERNET object

_RSI = "RSI"
_FIRST_IPOC = 1_000_000  # ms
_OUTPUTS = 2**32 - 1


class RsiController(RobotController):
    """Corrects the position of the robot by the answers of a sensor; errors are those of `RobotController`.

    Sensor-guided motion begins with an answer, at the set-points of that cycle, and ends after `MOST_LATE` packets in a
    row without an answer in time. Until then the last corrections stay in force (``HOLDON="1"``).

    Parameters
    ----------
    robot, show
        See `RobotController`.
    is_absolute
        Whether corrections count from the start of the motion, else from the cycle before.

    Attributes
    ----------
    is_guided
        Whether sensor-guided motion is in force.
    is_answered
        Whether the sensor answered the last packet.
    late
        Packets without an answer in time since the motion began.
    """

    is_running = False

    def __init__(
        self, robot: VirtualRobot, show: Callable[[str], None] = lambda _: None, is_absolute: bool = False
    ) -> None:
        super().__init__(robot, show)
        self._is_absolute = is_absolute
        self.is_guided = self.is_answered = False
        self._corrections: Mapping[str, Array] = {}
        self._text = ""
        self.late = self._missed = 0
        self._begin()

    @property
    def ipoc(self) -> int:
        """Number of the present cycle, ms."""
        return _FIRST_IPOC + round(1e3 * self.robot.time)

    def take(self, answer: Answer) -> None:
        """Take the answer of a sensor, which has effect in the next cycle; late ones have none.

        Raises
        ------
        MessageError
            If it answers no packet, or a stop is in force.
        """
        if self.robot.is_stopped:
            raise MessageError("a protective stop is in force")
        if not _FIRST_IPOC <= answer.ipoc <= self.ipoc:
            raise MessageError(key="IPOC", value=answer.ipoc, expected=str(self.ipoc))
        if answer.ipoc < self.ipoc or self.is_answered:
            return
        if answer.unknown:
            self.refuse(_RSI, f"elements {', '.join(answer.unknown)[:200]}: expected corrections and outputs")
        if answer.text and answer.text != self._text:
            self.log(f"text of the sensor: {answer.text[:200]!r}")
        self._text = answer.text
        if answer.outputs is not None:
            self.robot.outputs = answer.outputs & _OUTPUTS
        self._corrections = answer.corrections
        self.is_answered = True

    def step(self) -> None:
        """Let a cycle of the controller pass."""
        if self.is_answered and not self.is_guided:
            self._begin()
            self.is_guided = True
            self.log("sensor-guided motion begins")
        if self.is_guided:
            self._missed = 0 if self.is_answered else self._missed + 1
            self.late += not self.is_answered
            if self.robot.fault:
                self._end(self.robot.fault)
            elif self._missed > MOST_LATE:
                self._end(f"{self._missed} packets in a row without an answer in time")
            else:
                self._correct()
        self.is_answered = False
        self.robot.step()

    def _begin(self) -> None:
        """Corrections count from the present set-points."""
        self._joints = self._start = self.robot.targets
        self._frame = np.zeros(6)
        self.late = self._missed = 0

    def _correct(self) -> None:
        axes, frame = (self._corrections.get(key, np.zeros(6)) for key in (AXIS_CORRECTION, POSE_CORRECTION))
        try:
            if self._is_absolute:
                if (frame != self._frame).any():
                    self._joints, self._frame = self._moved(self._start, frame), frame
                self.robot.servo(self._joints + np.radians(axes))
            else:
                moved = self._moved(self._joints, frame) if frame.any() else self._joints
                self._joints = self.robot.servo(moved + np.radians(axes))
        except CommandError as error:
            self.refuse(_RSI, str(error))
            self._end("the pose cannot be reached")

    def _moved(self, joints: Array, frame: Array) -> Array:
        """Joints (joints,) at which the TCP is shifted and turned by a frame (6,) along the axes of $BASE."""
        place, by = self.robot.carrier_from_base @ self.robot.base_from_tcp(joints), pose_from(frame)
        moved = pose.from_rotation(by[:3, :3] @ place[:3, :3], place[:3, 3] + by[:3, 3])
        base_from_tcp = pose.inverse(self.robot.carrier_from_base) @ moved
        nearby = self.robot.joints_nearby(base_from_tcp)
        return self.robot.joints_for(base_from_tcp) if nearby is None else nearby

    def _end(self, reason: str) -> None:
        self.log(f"sensor-guided motion ends: {reason}")
        self.is_guided, self._corrections = False, {}
        self.robot.hold()


class RsiServer:
    """The controller's end of RSI: states to a sensor, corrections from it.

    Attributes
    ----------
    is_open
        True: datagrams have no connection.
    """

    is_open = True

    def __init__(self, controller: RsiController) -> None:
        self._controller = controller

    @property
    def is_started(self) -> bool:
        """Whether the sensor has answered the last packet."""
        return self._controller.is_answered

    def receive(self, received: bytes) -> bytes:
        """Take a packet of the sensor; there is no answer to it."""
        try:
            self._controller.take(answer_from(received))
        except MessageError as error:
            self._controller.refuse(_RSI, str(error))
        return b""

    def cycle(self) -> bytes:
        """State of the robot."""
        robot, controller = self._controller.robot, self._controller
        measured, commanded = (frame_of(robot.carrier_from_base @ place) for place in robot.tcp_poses)
        elements: dict[str, dict[str, float] | int] = {
            "RIst": dict(zip(FRAME, measured.tolist(), strict=True)),
            "RSol": dict(zip(FRAME, commanded.tolist(), strict=True)),
            "AIPos": dict(zip(AXES, np.degrees(robot.joints).tolist(), strict=True)),
            "ASPos": dict(zip(AXES, np.degrees(robot.targets).tolist(), strict=True)),
            "Delay": {"D": controller.late},
            "DiL": robot.inputs,
        }
        return state_packet(elements, controller.ipoc)

    def close(self) -> None:
        """End."""
