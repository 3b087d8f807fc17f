"""Messages of EGM as bytes: protocol buffers, by the numbers of the fields in the maker's ``egm.proto``.

The fields are those that "Application manual - Externally Guided Motion" describes. A message is a dictionary of its
fields: numbers, lists of numbers, and messages in it.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from enum import IntEnum
from typing import Any

import numpy as np

from scancell.arrays import Array
from scancell.errors import MessageError
from scancell.geometry import pose

Message = dict[str, Any]
# Fields of a message by their numbers: name, and kind (a number, a list of doubles) or the fields of the message in it.
Fields = Mapping[int, "tuple[str, str | Fields]"]

JOINTS, POSE = "joints", "cartesian"

_VARINT, _DOUBLE, _BYTES, _SINGLE = 0, 1, 2, 5  # wire types of protocol buffers
_F64 = struct.Struct("<d")
_MOST_VARINT = 10  # bytes
_MOST_NUMBERS = 32  # in a list
_FARTHEST = 1e5  # mm, of a position


def _numbered(kind: str | Fields, *names: str) -> Fields:
    return {number: (name, kind) for number, name in enumerate(names, start=1)}


_HEADER = _numbered("integer", "seqno", "tm", "mtype")
_LIST = _numbered("doubles", "joints")
_POSITION = _numbered("double", "x", "y", "z")
_POSE: Fields = {1: ("pos", _POSITION), 2: ("orient", _numbered("double", "u0", "u1", "u2", "u3"))}
_CLOCK = _numbered("integer", "sec", "usec")
_PLACE: Fields = {1: (JOINTS, _LIST), 2: (POSE, _POSE), 3: ("externalJoints", _LIST), 4: ("time", _CLOCK)}
_STATE = _numbered("integer", "state")
_SPEED: Fields = {1: (JOINTS, _LIST), 2: ("cartesians", _numbered("doubles", "value")), 3: ("externalJoints", _LIST)}

# From the controller to the sensor, and back.
ROBOT: Fields = {
    1: ("header", _HEADER),
    2: ("feedBack", _PLACE),
    3: ("planned", _PLACE),
    4: ("motorState", _STATE),
    5: ("mciState", _STATE),
    6: ("mciConvergenceMet", "integer"),
    8: ("rapidExecState", _STATE),
}
SENSOR: Fields = {1: ("header", _HEADER), 2: ("planned", _PLACE), 3: ("speedRef", _SPEED)}


class Kind(IntEnum):
    """Kinds of messages, ``mtype`` of the header."""

    DATA = 2
    CORRECTION = 3
    PATH_CORRECTION = 4


def packed(message: Message, fields: Fields) -> bytes:
    """Bytes of a message."""
    parts = []
    for number, (name, kind) in fields.items():
        if name not in message:
            continue
        value = message[name]
        if kind == "integer":
            parts += [_varint(number << 3 | _VARINT), _varint(int(value))]
        elif kind == "double":
            parts += [_varint(number << 3 | _DOUBLE), _F64.pack(value)]
        elif kind == "doubles":
            tag = _varint(number << 3 | _DOUBLE)
            parts += [tag + _F64.pack(x) for x in value]
        else:
            assert not isinstance(kind, str)
            content = packed(value, kind)
            parts += [_varint(number << 3 | _BYTES), _varint(len(content)), content]
    return b"".join(parts)


def unpacked(payload: bytes, fields: Fields) -> Message:
    """Message of bytes; fields that are not listed are left out.

    Raises
    ------
    MessageError
        If the bytes are no such message.
    """
    message: Message = {}
    at = 0
    while at < len(payload):
        tag, at = _varint_from(payload, at)
        wire, end = tag & 7, at
        value: int | bytes
        if wire == _VARINT:
            value, end = _varint_from(payload, at)
        else:
            if wire == _BYTES:
                size, at = _varint_from(payload, at)
            else:
                size = {_DOUBLE: 8, _SINGLE: 4}.get(wire, len(payload) + 1)
            end = at + size
            if end > len(payload):
                raise MessageError(key="field", value=tag >> 3, expected="a field that ends within the packet")
            value = payload[at:end]
        at = end
        if (field := fields.get(tag >> 3)) is not None:
            _take(message, *field, wire, value)
    return message


def _take(message: Message, name: str, kind: str | Fields, wire: int, value: int | bytes) -> None:
    """Put the value of a field into a message."""
    if not isinstance(kind, str):
        if wire != _BYTES:
            raise MessageError(key=name, value=f"wire type {wire}", expected="a message")
        assert isinstance(value, bytes)
        message[name] = {**message.get(name, {}), **unpacked(value, kind)}
    elif kind == "integer" and wire == _VARINT:
        message[name] = value
    elif kind == "double" and wire == _DOUBLE:
        message[name] = _doubles(name, value)[0]
    elif kind == "doubles" and wire in (_DOUBLE, _BYTES):  # one by one, or packed
        message[name] = [*message.get(name, []), *_doubles(name, value)]
        if len(message[name]) > _MOST_NUMBERS:
            raise MessageError(key=name, value=len(message[name]), expected=f"at most {_MOST_NUMBERS} numbers")
    else:
        raise MessageError(key=name, value=f"wire type {wire}", expected=kind)


def _doubles(name: str, value: int | bytes) -> list[float]:
    assert isinstance(value, bytes)
    if len(value) % _F64.size:
        raise MessageError(key=name, value=f"{len(value)} bytes", expected="doubles of 8 bytes")
    numbers = [x for (x,) in _F64.iter_unpack(value)]
    if not all(math.isfinite(x) for x in numbers):
        raise MessageError(key=name, value=numbers, expected="finite numbers")
    return numbers


def pose_message(base_from_tcp: Array) -> Message:
    """Pose (4, 4) as a message: mm, and a quaternion."""
    quaternion = pose.quaternion_from_rotation(base_from_tcp[:3, :3])
    position = dict(zip("xyz", (1e3 * base_from_tcp[:3, 3]).tolist(), strict=True))
    return {"pos": position, "orient": {f"u{i}": float(x) for i, x in enumerate(quaternion)}}


def pose_from(message: Message) -> Array:
    """Pose (4, 4) of a message.

    Raises
    ------
    MessageError
        If position or quaternion are missing, the position is out of all reach, or the quaternion has no direction.
    """
    position = [message.get("pos", {}).get(name) for name in "xyz"]
    quaternion = [message.get("orient", {}).get(f"u{i}") for i in range(4)]
    if None in position or None in quaternion:
        raise MessageError(key=POSE, value=sorted(message), expected="pos (x, y, z) and orient (u0 to u3)")
    if max(map(abs, position)) > _FARTHEST:
        raise MessageError(key="pos", value=position, expected=f"within {_FARTHEST:g} mm")
    if max(map(abs, quaternion)) > 1.1 or not 0.9 < float(np.linalg.norm(quaternion)) < 1.1:
        raise MessageError(key="orient", value=quaternion, expected="a quaternion of length 1")
    return pose.pose(1e-3 * np.array(position), quaternion)


def _varint(number: int) -> bytes:
    digits = bytearray()
    number &= 2**64 - 1
    while number > 127:
        digits.append(number & 127 | 128)
        number >>= 7
    digits.append(number)
    return bytes(digits)


def _varint_from(payload: bytes, at: int) -> tuple[int, int]:
    """A number, and where it ends."""
    number = 0
    for i, byte in enumerate(payload[at : at + _MOST_VARINT]):
        number |= (byte & 127) << 7 * i
        if byte < 128:
            return number, at + i + 1
    raise MessageError(key="number", value=payload[at : at + _MOST_VARINT].hex(), expected="one of at most 10 bytes")
