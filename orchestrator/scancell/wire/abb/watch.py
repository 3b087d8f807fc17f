"""What a guard beside a robot of ABB must know of EGM."""

from __future__ import annotations

import numpy as np

from scancell.arrays import Array
from scancell.errors import MessageError
from scancell.wire.abb.packets import JOINTS, POSE, ROBOT, SENSOR, Kind, Message, packed, unpacked


class EgmInterface:
    """States and corrections of EGM: the robot is held where it is, by joints or by its pose as the program guides."""

    port = 6510

    def __init__(self) -> None:
        self._by_pose = False
        self._held: Message = {}
        self._number = 0

    def state(self, packet: bytes) -> tuple[float, Array]:
        """Time (s) and joint angles (joints,) of a state; raises `MessageError` if it is none."""
        message = unpacked(packet, ROBOT)
        feedback = message.get("feedBack", {})
        joints = feedback.get(JOINTS, {}).get(JOINTS, [])
        if "tm" not in message.get("header", {}) or not joints or POSE not in feedback:
            raise MessageError(key="EgmRobot", value=sorted(message), expected="header, feedBack with joints and pose")
        return 1e-3 * float(message["header"]["tm"]), np.radians(joints)

    def note(self, answer: bytes) -> None:
        """Take notice of a correction; raises `MessageError` if it is none."""
        message = unpacked(answer, SENSOR)
        if message.get("planned", {}).get(JOINTS) or message.get("speedRef", {}).get(JOINTS):
            self._by_pose = False
        elif POSE in message.get("planned", {}) or "cartesians" in message.get("speedRef", {}):
            self._by_pose = True

    def hold(self, packet: bytes, is_first: bool) -> bytes:
        """Correction to the place of the first state of a stop."""
        if is_first:
            key = POSE if self._by_pose else JOINTS
            self._held = {key: unpacked(packet, ROBOT)["feedBack"][key]}
        self._number += 1
        speed = {"cartesians": {"value": [0.0] * 6}} if self._by_pose else {JOINTS: {JOINTS: [0.0] * 6}}
        header = {"seqno": self._number % 2**32, "tm": 0, "mtype": Kind.CORRECTION}
        return packed({"header": header, "planned": self._held, "speedRef": speed}, SENSOR)
