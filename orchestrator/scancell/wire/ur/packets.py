"""Packets of RTDE, protocol version 2, as bytes: big-endian, with a header of size and kind.

The protocol is that of the maker's "Real-Time Data Exchange (RTDE) Guide".
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from scancell.errors import MessageError

PROTOCOL_VERSION = 2
HEADER = struct.Struct(">HB")
NOT_FOUND, IN_USE = "NOT_FOUND", "IN_USE"
MAX_TEXT = 255  # bytes of a text and of its source

_FREQUENCY = struct.Struct(">d")
_VERSION = struct.Struct(">H")
_CONTROLLER_VERSION = struct.Struct(">4I")
_FORMATS = {
    "BOOL": "?",
    "UINT8": "B",
    "UINT32": "I",
    "UINT64": "Q",
    "INT32": "i",
    "DOUBLE": "d",
    "VECTOR3D": "3d",
    "VECTOR6D": "6d",
    "VECTOR6INT32": "6i",
    "VECTOR6UINT32": "6I",
}
_BOUNDS = {"B": (0, 2**8 - 1), "I": (0, 2**32 - 1), "Q": (0, 2**64 - 1), "i": (-(2**31), 2**31 - 1)}

Numbers = Sequence[float] | np.ndarray


class Kind(IntEnum):
    """Kinds of packets; the same number is used for a request and its answer."""

    PROTOCOL_VERSION = ord("V")
    CONTROLLER_VERSION = ord("v")
    TEXT = ord("M")
    DATA = ord("U")
    OUTPUTS = ord("O")
    INPUTS = ord("I")
    START = ord("S")
    PAUSE = ord("P")


class Level(IntEnum):
    """Levels of text messages."""

    EXCEPTION = 0
    ERROR = 1
    WARNING = 2
    INFO = 3


class Packet(NamedTuple):
    """Kind and content of a packet, without its header."""

    kind: int
    payload: bytes


class PacketBuffer:
    """Packets of a stream of bytes."""

    def __init__(self) -> None:
        self._bytes = b""

    def packets(self, received: bytes) -> Iterator[Packet]:
        """Packets that are complete with the bytes `received`.

        Raises
        ------
        MessageError
            At a size that no packet has: nothing after it can be read.
        """
        self._bytes += received
        start = 0
        try:
            while len(self._bytes) - start >= HEADER.size:
                size, kind = HEADER.unpack_from(self._bytes, start)
                if size < HEADER.size:
                    raise MessageError(key="size", value=size, expected=f"at least {HEADER.size} bytes")
                if len(self._bytes) - start < size:
                    return
                payload = self._bytes[start + HEADER.size : start + size]
                start += size
                yield Packet(kind, payload)
        finally:
            self._bytes = self._bytes[start:]


def packed(kind: int, payload: bytes = b"") -> bytes:
    """Bytes of a packet."""
    return HEADER.pack(HEADER.size + len(payload), kind) + payload


class Recipe:
    """Layout of data packages: a number, then the values of variables of given types.

    Raises `MessageError` for an unknown type.
    """

    def __init__(self, number: int, names: Sequence[str], types: Sequence[str]) -> None:
        for name, kind in zip(names, types, strict=True):
            if kind not in _FORMATS:
                raise MessageError(key=name, value=kind, expected="a variable that is there and free")
        self.number, self.names, self.types = number, tuple(names), tuple(types)
        self._layout = struct.Struct(">B" + "".join(_FORMATS[kind] for kind in types))
        self._lengths = [int(_FORMATS[kind][:-1] or 1) for kind in types]
        self._letters = [_FORMATS[kind][-1] for kind in types]

    def pack(self, values: Sequence[Numbers | float]) -> bytes:
        """Payload of a data package; integers beyond their type are clipped."""
        flat: list[float] = []
        for value, letter in zip(values, self._letters, strict=True):
            items = np.atleast_1d(value).tolist()
            if letter in _BOUNDS:
                low, high = _BOUNDS[letter]
                items = [min(max(int(item), low), high) for item in items]
            flat += items
        return self._layout.pack(self.number, *flat)

    def unpack(self, payload: bytes) -> dict[str, tuple[float, ...]]:
        """Values of each variable by name; one number is a tuple of one.

        Raises
        ------
        MessageError
            If the size does not match, or a number is not finite.
        """
        if len(payload) != self._layout.size:
            raise MessageError(key="size", value=len(payload), expected=f"{self._layout.size} bytes of recipe")
        _, *flat = self._layout.unpack(payload)
        if not all(np.isfinite(flat)):
            raise MessageError(key="data", value="a number that is not finite", expected="finite numbers")
        values, start = {}, 0
        for name, length in zip(self.names, self._lengths, strict=True):
            values[name], start = tuple(flat[start : start + length]), start + length
        return values


def names_from(payload: bytes) -> list[str]:
    """Names of variables, separated by commas; one comma at the end is ignored.

    Raises `MessageError` if there is none, or a name is empty or no ASCII.
    """
    try:
        names = payload.decode("ascii").removesuffix(",").split(",")
    except UnicodeDecodeError:
        raise MessageError(key="variables", value=payload[:40], expected="ASCII names") from None
    if not all(names):
        raise MessageError(key="variables", value=payload[:40], expected="names, separated by commas")
    return names


def outputs_request_from(payload: bytes) -> tuple[float, list[str]]:
    """Frequency, Hz, and names of the variables of a request for outputs; raises `MessageError`."""
    if len(payload) < _FREQUENCY.size:
        raise MessageError(key="size", value=len(payload), expected="a frequency and names of variables")
    frequency: float = _FREQUENCY.unpack_from(payload)[0]
    return frequency, names_from(payload[_FREQUENCY.size :])


def outputs_request(frequency: float, names: Sequence[str]) -> bytes:
    """Payload of a request for outputs."""
    return _FREQUENCY.pack(frequency) + ",".join(names).encode()


def recipe_answer(number: int, types: Sequence[str]) -> bytes:
    """Payload of the answer to a request for outputs or inputs; number 0: the recipe is invalid."""
    return bytes([number]) + ",".join(types).encode()


def recipe_from(payload: bytes, names: Sequence[str]) -> Recipe:
    """Recipe of an answer; raises `MessageError` if it is invalid."""
    types = names_from(payload[1:])
    if len(types) != len(names):
        raise MessageError(key="types", value=len(types), expected=f"{len(names)}")
    return Recipe(payload[0], names, types)


def version_request(version: int = PROTOCOL_VERSION) -> bytes:
    """Payload of a request for a protocol version."""
    return _VERSION.pack(version)


def version_from(payload: bytes) -> int:
    """Protocol version of a request; raises `MessageError`."""
    if len(payload) != _VERSION.size:
        raise MessageError(key="size", value=len(payload), expected=f"{_VERSION.size} bytes")
    return int(_VERSION.unpack(payload)[0])


def controller_version(version: Sequence[int]) -> bytes:
    """Payload of major, minor, bug-fix and build number."""
    return _CONTROLLER_VERSION.pack(*version)


def controller_version_from(payload: bytes) -> tuple[int, ...]:
    """Major, minor, bug-fix and build number; raises `MessageError`."""
    if len(payload) != _CONTROLLER_VERSION.size:
        raise MessageError(key="size", value=len(payload), expected=f"{_CONTROLLER_VERSION.size} bytes")
    return tuple(_CONTROLLER_VERSION.unpack(payload))


def text_message(text: str, source: str, level: Level) -> bytes:
    """Payload of a text message; texts are cut at 255 bytes."""
    parts = [part.encode(errors="replace")[:MAX_TEXT] for part in (text, source)]
    return b"".join(bytes([len(part)]) + part for part in parts) + bytes([level])


def text_message_from(payload: bytes) -> tuple[str, str, int]:
    """Text, source and level of a text message; raises `MessageError`."""
    texts, rest = [], payload
    for _ in range(2):
        if not rest or len(rest) < 1 + rest[0]:
            raise MessageError(key="text", value=payload[:40], expected="two texts behind their lengths, and a level")
        texts.append(rest[1 : 1 + rest[0]].decode(errors="replace"))
        rest = rest[1 + rest[0] :]
    if len(rest) != 1:
        raise MessageError(key="level", value=rest[:40], expected="one byte")
    return texts[0], texts[1], rest[0]
