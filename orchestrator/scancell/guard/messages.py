"""Messages between cell and guard, and their bytes (docs/guard_protocol.md).

A packet is a header of fixed size, a body and a CRC-32 of both, all little-endian.  Values are checked where a message
is made, so that the same rules hold for decoded messages and for those that are sent.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from numbers import Integral, Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.cell.controller import Mode, Operation
from scancell.errors import MessageError

Array = NDArray[np.float64]

MAGIC = b"SCGD"
VERSION = 1
MAX_JOINTS = 8
MAX_AHEAD = 64
MAX_TEXT = 120  # bytes

_HEADER = struct.Struct("<4sBBHQQI")
_STATE = struct.Struct("<ddddBBBBH")
_ANSWER = struct.Struct("<IddBBB")
_CRC = struct.Struct("<I")
_LENGTH_AT = 6
MIN_PACKET = _HEADER.size + _ANSWER.size + _CRC.size
MAX_PACKET = _HEADER.size + _STATE.size + 8 * (MAX_JOINTS + 1) * (1 + MAX_AHEAD) + _CRC.size

_MOVING, _LIMITS_JOGS = 1, 2  # flags of a state
_MAX_TIME = 1e9  # s
_MAX_ANGLE = 1e4  # rad
_SPACING = 1e-3, 10.0  # s, least and greatest


class Kind(IntEnum):
    """Kind of a packet."""

    STATE = 1
    ANSWER = 2


@dataclass(frozen=True, eq=False)
class CellState:
    """State of the robot of a cell, as its controller reports it.

    Attributes
    ----------
    sequence
        Number of the state, modulo 2**32.
    time
        Of the measurement, by the controller's clock, s.
    operation, mode
        As the controller names them.
    moving
        Whether an axis moves.
    axes
        Measured joints and table, (joints + 1,), rad.
    rate
        Rate of the path clock, 0 to 1; 1 is the speed of the path ahead.
    ahead
        Axes on the path ahead, (m, joints + 1), rad, one row per `spacing` of path clock, or of time in a jog; m = 0 if
        nothing is shown.
    spacing
        s of path clock, 0.001 to 10; 0 if there is no path ahead.
    path_time
        Time at which the controller took up the path ahead, by its clock, s: only answers to later states let it move
        on the path. 0 if there is no path ahead.
    limits_jogs
        Whether the controller shows jogs at full speed, reports their present share of it as `rate`, and limits it to
        the monitor speed of the last answer.

    Raises
    ------
    MessageError
        If a value is outside the bounds of the format.

    Examples
    --------
    >>> setup = scancell.load_setup()
    >>> nominal = scancell.nominal_cell(setup.cell, scancell.load_part("part.stl"))
    >>> axes = np.append(nominal.home, 0.0)
    >>> state = scancell.CellState(1, 0.016, scancell.Operation.AUTOMATIC, scancell.Mode.HOLD, False, axes)
    >>> scancell.Guard(nominal, setup.cell.robot).answer(state).monitor_speed
    1.0
    """

    sequence: int
    time: float
    operation: Operation
    mode: Mode
    moving: bool
    axes: ArrayLike
    rate: float = 1.0
    ahead: ArrayLike = ()
    spacing: float = 0.0
    path_time: float = 0.0
    limits_jogs: bool = False

    def __post_init__(self) -> None:
        axes = _numbers("axes", self.axes)
        _require(axes.ndim == 1 and 2 <= len(axes) <= MAX_JOINTS + 1, "axes", axes.shape, "2 to 9 angles")
        ahead = _numbers("ahead", self.ahead)
        ahead = ahead.reshape(0, len(axes)) if ahead.size == 0 else ahead
        fits = ahead.ndim == 2 and ahead.shape[1] == len(axes) and len(ahead) <= MAX_AHEAD
        _require(fits, "ahead", ahead.shape, f"at most {MAX_AHEAD} rows of {len(axes)} angles")
        _require(_within(axes, _MAX_ANGLE), "axes", axes, f"angles within {_MAX_ANGLE:g} rad")
        _require(_within(ahead, _MAX_ANGLE), "ahead", ahead, f"angles within {_MAX_ANGLE:g} rad")
        _require(isinstance(self.operation, Operation), "operation", self.operation, "an Operation")
        _require(isinstance(self.mode, Mode), "mode", self.mode, "a Mode")
        _check_number(self, "sequence", 0, 2**32 - 1, Integral)
        _check_number(self, "time", -_MAX_TIME, _MAX_TIME)
        _check_number(self, "rate", 0.0, 1.0)
        _check_number(self, "spacing", *(_SPACING if len(ahead) else (0.0, 0.0)))
        earliest, latest = (-_MAX_TIME, self.time) if len(ahead) else (0.0, 0.0)
        _check_number(self, "path_time", earliest, latest)
        for name, array in (("axes", axes), ("ahead", ahead)):
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    def encode(self, session: int, guard: int) -> bytes:
        """The packet of the session number `session`; `guard` is 0 until the guard's number is known."""
        axes, ahead = np.asarray(self.axes), np.asarray(self.ahead)
        flags = bool(self.moving) * _MOVING | bool(self.limits_jogs) * _LIMITS_JOGS
        counts = (self.operation, self.mode, flags, len(axes) - 1, len(ahead))
        body = _STATE.pack(self.time, self.rate, self.spacing, self.path_time, *counts)
        angles = np.concatenate([axes, ahead.ravel()]).astype("<f8").tobytes()
        return _sealed(Kind.STATE, session, guard, self.sequence, body + angles)


@dataclass(frozen=True)
class GuardMessage:
    """Answer of the guard to a state.

    Attributes
    ----------
    sequence
        Number of the answer, modulo 2**32.
    state_sequence, state_time
        Those of the state. The controller measures the age of the answer by its own clock; no clocks are synchronised.
    monitor_speed
        Greatest rate of the path clock allowed, 0 to 1; in a jog, of its full speed.
    emergency_stop
        Whether the robot must stop at once. Single answers may be lost: the guard repeats it until the robot rests.
    text
        For the pendant, printable, at most 120 bytes of UTF-8.
    beep
        Whether the pendant beeps.

    Raises
    ------
    MessageError
        If a value is outside the bounds of the format.

    Examples
    --------
    >>> answer = scancell.GuardMessage(1, 7, 0.25, monitor_speed=0.5, emergency_stop=False, text="sensor - table")
    >>> scancell.GuardMessage(1, 7, 0.25, monitor_speed=2.0, emergency_stop=False)
    Traceback (most recent call last):
        ...
    scancell.errors.MessageError: monitor_speed = 2.0: expected 0 to 1
    """

    sequence: int
    state_sequence: int
    state_time: float
    monitor_speed: float
    emergency_stop: bool
    text: str = ""
    beep: bool = False

    def __post_init__(self) -> None:
        _check_number(self, "sequence", 0, 2**32 - 1, Integral)
        _check_number(self, "state_sequence", 0, 2**32 - 1, Integral)
        _check_number(self, "state_time", -_MAX_TIME, _MAX_TIME)
        _check_number(self, "monitor_speed", 0.0, 1.0)
        is_text = isinstance(self.text, str) and self.text.isprintable()
        fits = is_text and len(self.text.encode(errors="replace")) <= MAX_TEXT
        _require(fits, "text", self.text, f"at most {MAX_TEXT} bytes of printable UTF-8")

    def encode(self, session: int, guard: int) -> bytes:
        """The packet of the session number `session` of the guard number `guard`."""
        text = self.text.encode()
        values = (self.state_sequence, self.state_time, self.monitor_speed)
        body = _ANSWER.pack(*values, bool(self.emergency_stop), bool(self.beep), len(text))
        return _sealed(Kind.ANSWER, session, guard, self.sequence, body + text)


Message = CellState | GuardMessage


@dataclass(frozen=True)
class Packet:
    """A message with the numbers of the session that it belongs to; `guard` 0: the cell opens the session."""

    session: int
    guard: int
    message: Message


def decode(packet: bytes) -> Packet:
    """The message in a packet.

    Raises
    ------
    MessageError
        Naming what was expected, if the packet is anything else than what `encode` makes.
    """
    _require(len(packet) >= MIN_PACKET, "packet", f"{len(packet)} bytes", f"at least {MIN_PACKET}")
    expected = packet_length(packet)
    _require(len(packet) == expected, "packet", f"{len(packet)} bytes", f"the {expected} that its header states")
    _require(_CRC.unpack(packet[-4:])[0] == zlib.crc32(packet[:-4]), "CRC-32", packet[-4:].hex(), "that of the packet")
    _, _, kind, _, session, guard, sequence = _HEADER.unpack_from(packet)
    _require(kind in _DECODERS, "kind", kind, "1 (state) or 2 (answer)")
    _require(session > 0, "session", session, "a number above 0")
    return Packet(session, guard, _DECODERS[kind](sequence, packet[_HEADER.size : -_CRC.size]))


def packet_length(start: bytes) -> int:
    """Length (bytes) of the packet with a header that begins with `start`, at least 8 bytes.

    Raises
    ------
    MessageError
        If no packet of this version of the format begins so.
    """
    _require(start[:4] == MAGIC, "magic", start[:4].hex(), MAGIC.hex())
    _require(start[4] == VERSION, "version", start[4], str(VERSION))
    length = int.from_bytes(start[_LENGTH_AT : _LENGTH_AT + 2], "little")
    _require(MIN_PACKET <= length <= MAX_PACKET, "length", length, f"{MIN_PACKET} to {MAX_PACKET}")
    return length


def _sealed(kind: Kind, session: int, guard: int, sequence: int, body: bytes) -> bytes:
    length = _HEADER.size + len(body) + _CRC.size
    packet = _HEADER.pack(MAGIC, VERSION, kind, length, session, guard, sequence) + body
    return packet + _CRC.pack(zlib.crc32(packet))


def _decoded_state(sequence: int, body: bytes) -> CellState:
    _require(len(body) >= _STATE.size, "state", f"{len(body)} bytes", f"at least {_STATE.size}")
    time, rate, spacing, path_time, operation, mode, flags, joints, rows = _STATE.unpack_from(body)
    _require(1 <= joints <= MAX_JOINTS, "joints", joints, f"1 to {MAX_JOINTS}")
    size = _STATE.size + 8 * (joints + 1) * (1 + rows)
    _require(len(body) == size, "state", f"{len(body)} bytes", f"{size} for {joints} joints and {rows} rows ahead")
    _require(operation in tuple(Operation), "operation", operation, "0 (manual) or 1 (automatic)")
    _require(mode in tuple(Mode), "mode", mode, f"0 to {max(Mode)}")
    _require(flags <= _MOVING | _LIMITS_JOGS, "flags", flags, "0 to 3")
    angles = np.frombuffer(body, "<f8", offset=_STATE.size).reshape(1 + rows, joints + 1)
    known = (Operation(operation), Mode(mode), bool(flags & _MOVING))
    limits_jogs = bool(flags & _LIMITS_JOGS)
    return CellState(sequence, time, *known, angles[0], rate, angles[1:], spacing, path_time, limits_jogs)


def _decoded_answer(sequence: int, body: bytes) -> GuardMessage:
    state_sequence, state_time, speed, stop, beep, length = _ANSWER.unpack_from(body)
    text = body[_ANSWER.size :]
    _require(len(text) == length, "text", f"{len(text)} bytes", f"the {length} that are stated")
    try:
        words = text.decode()
    except UnicodeDecodeError:
        raise MessageError(key="text", value=text.hex(), expected="UTF-8") from None
    stop, beep = _flag("emergency_stop", stop), _flag("beep", beep)
    return GuardMessage(sequence, state_sequence, state_time, speed, stop, words, beep)


_DECODERS: dict[int, Callable[[int, bytes], Message]] = {Kind.STATE: _decoded_state, Kind.ANSWER: _decoded_answer}


def _flag(name: str, value: int) -> bool:
    _require(value in (0, 1), name, value, "0 or 1")
    return value == 1


def _check_number(message: Message, name: str, low: float, high: float, kind: Any = Real) -> None:
    value: Any = getattr(message, name)
    _require(isinstance(value, kind) and low <= value <= high, name, value, f"{low:.10g} to {high:.10g}")


def _numbers(name: str, values: ArrayLike) -> Array:
    try:
        return np.array(values, np.float64)
    except (TypeError, ValueError, OverflowError):
        raise MessageError(key=name, value=values, expected="angles") from None


def _within(values: Array, bound: float) -> bool:
    return bool((np.abs(values) <= bound).all())  # false for NaN


def _require(holds: bool, name: str, value: object, expected: str) -> None:
    if not holds:
        raise MessageError(key=name, value=value, expected=expected)
