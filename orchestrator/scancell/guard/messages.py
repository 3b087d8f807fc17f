"""Messages between cell and guard, and their bytes (docs/guard_protocol.md).

A packet is a header of fixed size, a body and a CRC-32 of both, all little-endian.  Values are checked where a message
is made, so that the same rules hold for decoded messages and for those that are sent.  States of version 1 of the
format are read as well: their path ahead begins one spacing after the state, and they know joints and a table only.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from numbers import Integral, Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from scancell.arrays import Array
from scancell.cell.driver import Mode, Operation
from scancell.errors import MessageError

MAGIC = b"SCGD"
VERSION = 2
MAX_AXES = {1: 9, 2: 16}  # by version; of version 1 eight joints and a table
MAX_AHEAD = 64
MAX_GRIPPERS = 4
MAX_PARTS = 8
MAX_TEXT = 120  # bytes

_HEADER = struct.Struct("<4sBBHQQI")
_STATE = struct.Struct("<ddddBBBBH")
_AXES = struct.Struct("<IIBB")  # digest, prismatic axes, grippers, parts; version 2
_PART = struct.Struct("<BB7d")
_ANSWER = struct.Struct("<IddBBB")
_CRC = struct.Struct("<I")
_LENGTH_AT = 6
MIN_PACKET = _HEADER.size + _ANSWER.size + _CRC.size
_MAX_NUMBERS = MAX_AXES[VERSION] * (1 + MAX_AHEAD) + MAX_GRIPPERS
MAX_PACKET = _HEADER.size + _STATE.size + _AXES.size + 8 * _MAX_NUMBERS + MAX_PARTS * _PART.size + _CRC.size

_MOVING, _LIMITS_JOGS = 1, 2  # flags of a state
_MAX_TIME = 1e9  # s
_MAX_POSITION = 1e4  # of an axis, rad or m
_MAX_WIDTH = 10.0  # m
_MAX_PLACE = 1e3  # m
_UNIT = 1e-3  # deviation of the norm of a quaternion from 1
_SPACING = 1e-3, 10.0  # s, least and greatest


class Kind(IntEnum):
    """Kind of a packet."""

    STATE = 1
    ANSWER = 2


def axes_digest(names: Sequence[str], prismatic: int = 0) -> int:
    """CRC-32 of the names of the axes and their kinds, by which cell and guard notice that they mean other axes.

    Parameters
    ----------
    names
        Names of the axes in the order of their values, for example ``q[1]`` … ``q[6]``, ``table``, ``axis.track``.
    prismatic
        Bit i is set if axis i is prismatic.
    """
    kinds = ("prismatic" if prismatic >> i & 1 else "revolute" for i in range(len(names)))
    return zlib.crc32("".join(f"{name} {kind}\n" for name, kind in zip(names, kinds, strict=True)).encode())


def axis_bits(flags: Iterable[bool]) -> int:
    """The number whose bit i is set if flag i of the axes is."""
    return sum(1 << i for i, flag in enumerate(flags) if flag)


@dataclass(frozen=True)
class PlacedPart:
    """Pose of a part that the gripper or a belt can move.

    Attributes
    ----------
    number
        Number of the part, from 1, the one that is scanned.
    carrier
        What it moves with: 0 the world, else the number of an axis from 1 in the order of `CellState.axes`: the last
        joint for the flange, the next axis for the platter of the table, those behind it for what further axes carry.
    pose
        Position (x, y, z), m, and quaternion (w, x, y, z) in the frame behind that axis.

    Raises
    ------
    MessageError
        If a value is outside the bounds of the format.

    Examples
    --------
    >>> held = scancell.PlacedPart(1, 6, (0.0, -0.09, 0.1, 1.0, 0.0, 0.0, 0.0))  # on the flange of six joints
    """

    number: int
    carrier: int
    pose: tuple[float, ...]

    def __post_init__(self) -> None:
        _check_number(self, "number", 1, 255, Integral)
        _check_number(self, "carrier", 0, MAX_AXES[VERSION], Integral)
        pose = _numbers("pose", self.pose)
        _require(pose.shape == (7,) and _within(pose, _MAX_PLACE), "pose", self.pose, "position, m, and quaternion")
        norm = float(np.linalg.norm(pose[3:]))
        _require(abs(norm - 1) <= _UNIT, "pose", self.pose, "a unit quaternion")
        object.__setattr__(self, "pose", tuple(pose.tolist()))


@dataclass(frozen=True, eq=False)
class CellState:
    """State of the robot of a cell, as its controller reports it.

    Attributes
    ----------
    sequence
        Number of the state, modulo 2**32.
    time
        Time of the measurement, by the controller's clock, s.
    operation, mode
        As the controller names them.
    moving
        Whether an axis moves.
    axes
        Measured positions of the axes, in a cell of scancell joints, table and further axes, (n,), rad or m.
    rate
        Rate of the path clock, 0 to 1; 1 is the speed of the path ahead.
    ahead
        Axes on the path ahead, (m, n), rad or m, one row per `spacing` of path clock, or of time in a jog; the first
        row is the present set-point, in version 1 the one after it. m = 0 if nothing is shown.
    spacing
        s of path clock, 0.001 to 10; 0 if there is no path ahead.
    path_time
        Time at which the controller took up the path ahead, by its clock, s: only answers to later states let it move
        on the path. 0 if there is no path ahead.
    limits_jogs
        Whether the controller shows jogs at full speed, reports their present share of it as `rate`, and limits it to
        the monitor speed of the last answer.
    widths
        Measured distances between the pads of the grippers, (k,), m.
    parts
        Poses of the parts that the gripper or a belt has moved.
    prismatic
        Bit i is set if axis i is prismatic: its position is in m.
    digest
        Digest of names and kinds of the axes (`axes_digest`); 0: not stated.
    version
        Version of the format, 1 or 2.

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
    widths: ArrayLike = ()
    parts: tuple[PlacedPart, ...] = ()
    prismatic: int = 0
    digest: int = 0
    version: int = VERSION

    def __post_init__(self) -> None:
        _require(self.version in MAX_AXES, "version", self.version, "1 or 2")
        most = MAX_AXES[self.version]
        axes = _numbers("axes", self.axes)
        _require(axes.ndim == 1 and 2 <= len(axes) <= most, "axes", axes.shape, f"2 to {most} positions")
        ahead = _numbers("ahead", self.ahead)
        ahead = ahead.reshape(0, len(axes)) if ahead.size == 0 else ahead
        fits = ahead.ndim == 2 and ahead.shape[1] == len(axes) and len(ahead) <= MAX_AHEAD
        _require(fits, "ahead", ahead.shape, f"at most {MAX_AHEAD} rows of {len(axes)} positions")
        for name, array in (("axes", axes), ("ahead", ahead)):
            _require(_within(array, _MAX_POSITION), name, array, f"positions within {_MAX_POSITION:g} rad or m")
        widths = _numbers("widths", self.widths).reshape(-1)
        fits = len(widths) <= MAX_GRIPPERS and _within(widths, _MAX_WIDTH)
        _require(fits, "widths", widths, f"at most {MAX_GRIPPERS} widths within {_MAX_WIDTH:g} m")
        _check_number(self, "prismatic", 0, 2 ** len(axes) - 1, Integral)
        _check_number(self, "digest", 0, 2**32 - 1, Integral)
        numbers = [part.number for part in self.parts]
        fits = len(numbers) <= MAX_PARTS and len(set(numbers)) == len(numbers)
        _require(fits, "parts", numbers, f"at most {MAX_PARTS} parts, each once")
        for part in self.parts:
            _require(part.carrier <= len(axes), "carrier", part.carrier, f"0 to {len(axes)}")
        is_new = len(widths) > 0 or bool(self.parts or self.prismatic or self.digest)
        _require(self.version > 1 or not is_new, "version", 1, "2 for grippers, parts, kinds and names of axes")
        _require(isinstance(self.operation, Operation), "operation", self.operation, "an Operation")
        _require(isinstance(self.mode, Mode), "mode", self.mode, "a Mode")
        _check_number(self, "sequence", 0, 2**32 - 1, Integral)
        _check_number(self, "time", -_MAX_TIME, _MAX_TIME)
        _check_number(self, "rate", 0.0, 1.0)
        _check_number(self, "spacing", *(_SPACING if len(ahead) else (0.0, 0.0)))
        earliest, latest = (-_MAX_TIME, self.time) if len(ahead) else (0.0, 0.0)
        _check_number(self, "path_time", earliest, latest)
        for name, array in (("axes", axes), ("ahead", ahead), ("widths", widths)):
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    def encode(self, session: int, guard: int) -> bytes:
        """The packet of the session number `session`; `guard` is 0 until the guard's number is known."""
        axes, ahead, widths = np.asarray(self.axes), np.asarray(self.ahead), np.asarray(self.widths)
        flags = bool(self.moving) * _MOVING | bool(self.limits_jogs) * _LIMITS_JOGS
        number = len(axes) - (self.version == 1)  # of the joints in version 1
        counts = (self.operation, self.mode, flags, number, len(ahead))
        body = _STATE.pack(self.time, self.rate, self.spacing, self.path_time, *counts)
        if self.version > 1:
            body += _AXES.pack(self.digest, self.prismatic, len(widths), len(self.parts))
        body += np.concatenate([axes, ahead.ravel(), widths]).astype("<f8").tobytes()
        body += b"".join(_PART.pack(part.number, part.carrier, *part.pose) for part in self.parts)
        return _sealed(self.version, Kind.STATE, session, guard, self.sequence, body)


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

    def encode(self, session: int, guard: int, version: int = VERSION) -> bytes:
        """The packet of the session number `session` of the guard number `guard`, in the `version` of the state."""
        text = self.text.encode()
        values = (self.state_sequence, self.state_time, self.monitor_speed)
        body = _ANSWER.pack(*values, bool(self.emergency_stop), bool(self.beep), len(text))
        return _sealed(version, Kind.ANSWER, session, guard, self.sequence, body + text)


Message = CellState | GuardMessage


@dataclass(frozen=True)
class Packet:
    """A message with the numbers of the session that it belongs to; `guard` 0: the cell opens the session."""

    version: int
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
    _, version, kind, _, session, guard, sequence = _HEADER.unpack_from(packet)
    _require(kind in tuple(Kind), "kind", kind, "1 (state) or 2 (answer)")
    _require(session > 0, "session", session, "a number above 0")
    body = packet[_HEADER.size : -_CRC.size]
    message = _decoded_state(version, sequence, body) if kind == Kind.STATE else _decoded_answer(sequence, body)
    return Packet(version, session, guard, message)


def packet_length(start: bytes) -> int:
    """Length (bytes) of the packet with a header that begins with `start`, at least 8 bytes.

    Raises
    ------
    MessageError
        If no packet of a known version of the format begins so.
    """
    _require(start[:4] == MAGIC, "magic", start[:4].hex(), MAGIC.hex())
    _require(start[4] in MAX_AXES, "version", start[4], "1 or 2")
    length = int.from_bytes(start[_LENGTH_AT : _LENGTH_AT + 2], "little")
    _require(MIN_PACKET <= length <= MAX_PACKET, "length", length, f"{MIN_PACKET} to {MAX_PACKET}")
    return length


def _sealed(version: int, kind: Kind, session: int, guard: int, sequence: int, body: bytes) -> bytes:
    length = _HEADER.size + len(body) + _CRC.size
    packet = _HEADER.pack(MAGIC, version, kind, length, session, guard, sequence) + body
    return packet + _CRC.pack(zlib.crc32(packet))


def _decoded_state(version: int, sequence: int, body: bytes) -> CellState:
    fixed = _STATE.size + (_AXES.size if version > 1 else 0)
    _require(len(body) >= fixed, "state", f"{len(body)} bytes", f"at least {fixed}")
    time, rate, spacing, path_time, operation, mode, flags, number, rows = _STATE.unpack_from(body)
    digest, prismatic, grippers, parts = _AXES.unpack_from(body, _STATE.size) if version > 1 else (0, 0, 0, 0)
    axes, least = number + (version == 1), 1 if version == 1 else 2
    _require(least <= number and axes <= MAX_AXES[version], "axes", number, f"{least} to {MAX_AXES[version]}")
    numbers = axes * (1 + rows) + grippers
    size = fixed + 8 * numbers + _PART.size * parts
    _require(len(body) == size, "state", f"{len(body)} bytes", f"{size} for {axes} axes and {rows} rows ahead")
    _require(operation in tuple(Operation), "operation", operation, "0 (manual) or 1 (automatic)")
    _require(mode in tuple(Mode), "mode", mode, f"0 to {max(Mode)}")
    _require(flags <= _MOVING | _LIMITS_JOGS, "flags", flags, "0 to 3")
    values = np.frombuffer(body, "<f8", numbers, fixed)
    path = values[: len(values) - grippers].reshape(1 + rows, axes)
    placed = (_PART.unpack_from(body, fixed + 8 * numbers + _PART.size * i) for i in range(parts))
    return CellState(
        sequence,
        time,
        Operation(operation),
        Mode(mode),
        bool(flags & _MOVING),
        path[0],
        rate,
        path[1:],
        spacing,
        path_time,
        bool(flags & _LIMITS_JOGS),
        values[len(values) - grippers :],
        tuple(PlacedPart(of, carrier, tuple(pose)) for of, carrier, *pose in placed),
        prismatic,
        digest,
        version,
    )


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


def _flag(name: str, value: int) -> bool:
    _require(value in (0, 1), name, value, "0 or 1")
    return value == 1


def _check_number(message: object, name: str, low: float, high: float, kind: Any = Real) -> None:
    value: Any = getattr(message, name)
    _require(isinstance(value, kind) and low <= value <= high, name, value, f"{low:.10g} to {high:.10g}")


def _numbers(name: str, values: ArrayLike) -> Array:
    try:
        return np.array(values, np.float64)
    except (TypeError, ValueError, OverflowError):
        raise MessageError(key=name, value=values, expected="numbers") from None


def _within(values: Array, bound: float) -> bool:
    return bool((np.abs(values) <= bound).all())  # false for NaN


def _require(holds: bool, name: str, value: object, expected: str) -> None:
    if not holds:
        raise MessageError(key=name, value=value, expected=expected)
