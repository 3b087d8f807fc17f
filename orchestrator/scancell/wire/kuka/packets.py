"""Packets of KUKA.RobotSensorInterface (RSI) as bytes: XML, one element for each signal."""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from xml.etree import ElementTree
from xml.sax.saxutils import escape, quoteattr

import numpy as np

from scancell.arrays import Array
from scancell.errors import MessageError
from scancell.geometry import pose

AXES = ("A1", "A2", "A3", "A4", "A5", "A6")
FRAME = ("X", "Y", "Z", "A", "B", "C")
AXIS_CORRECTION, POSE_CORRECTION, OUTPUTS, TEXT = "AKorr", "RKorr", "DiO", "EStr"

_IPOC = "IPOC"
_CORRECTIONS = {AXIS_CORRECTION: AXES, POSE_CORRECTION: FRAME}
_WITHOUT_EFFECT = re.compile(r"Tech|SenP\w*|EKorr")
_MOST = 8000  # bytes of a packet
_LARGEST = 1e4  # mm or deg, of a correction
_DIGITS = re.compile(r"\s*\d{1,18}\s*")


@dataclass(frozen=True)
class Answer:
    """What a sensor answers to a packet.

    Attributes
    ----------
    ipoc
        Number of the packet.
    corrections
        Numbers (6,) of `AXIS_CORRECTION` (deg) and `POSE_CORRECTION` (mm, deg); missing ones are 0.
    outputs
        Digital outputs, bit by bit; None: not stated.
    text
        Message of the sensor.
    unknown
        Names of elements that have no meaning here.
    sensor
        Name of the sensor, ``Type``.
    """

    ipoc: int
    corrections: Mapping[str, Array] = field(default_factory=dict)
    outputs: int | None = None
    text: str = ""
    unknown: tuple[str, ...] = ()
    sensor: str = "ImFree"


def state_packet(elements: Mapping[str, Mapping[str, float] | int], ipoc: int) -> bytes:
    """Packet of the robot: elements with attributes, or with a number."""
    parts = []
    for name, value in elements.items():
        if isinstance(value, int):
            parts.append(f"<{name}>{value}</{name}>")
        else:
            attributes = " ".join(
                f'{key}="{number}"' if isinstance(number, int) else f'{key}="{number:.6f}"'
                for key, number in value.items()
            )
            parts.append(f"<{name} {attributes}/>")
    return f'<Rob Type="KUKA">{"".join(parts)}<{_IPOC}>{ipoc}</{_IPOC}></Rob>'.encode()


def state_from(packet: bytes) -> tuple[int, dict[str, dict[str, float]]]:
    """IPOC, and elements of which all attributes are numbers, of a packet of the robot.

    Raises
    ------
    MessageError
        If it is no packet.
    """
    root, elements = _root(packet, "Rob"), {}
    for element in root:
        with contextlib.suppress(MessageError):
            elements[element.tag] = _numbers(element)
    return _ipoc(root), elements


def answer_packet(answer: Answer) -> bytes:
    """Packet of a sensor."""
    parts = [f"<{TEXT}>{escape(answer.text)}</{TEXT}>"]
    for name, numbers in answer.corrections.items():
        attributes = " ".join(f'{key}="{x:.6f}"' for key, x in zip(_CORRECTIONS[name], numbers, strict=True))
        parts.append(f"<{name} {attributes}/>")
    if answer.outputs is not None:
        parts.append(f"<{OUTPUTS}>{answer.outputs}</{OUTPUTS}>")
    return f"<Sen Type={quoteattr(answer.sensor)}>{''.join(parts)}<{_IPOC}>{answer.ipoc}</{_IPOC}></Sen>".encode()


def answer_from(packet: bytes) -> Answer:
    """Answer of a sensor.

    Raises
    ------
    MessageError
        If it is no packet of a sensor.
    """
    root = _root(packet, "Sen")
    corrections, outputs, text, unknown = {}, None, "", []
    for element in root:
        if (names := _CORRECTIONS.get(element.tag)) is not None:
            numbers = _numbers(element)
            if not set(numbers) <= set(names) or max(map(abs, numbers.values()), default=0.0) > _LARGEST:
                raise MessageError(
                    key=element.tag, value=numbers, expected=f"{', '.join(names)} of at most {_LARGEST:g}"
                )
            corrections[element.tag] = np.array([numbers.get(name, 0.0) for name in names])
        elif element.tag == OUTPUTS:
            outputs = _integer(OUTPUTS, element.text)
        elif element.tag == TEXT:
            text = (element.text or "").strip()
        elif element.tag != _IPOC and not _WITHOUT_EFFECT.fullmatch(element.tag):
            unknown.append(element.tag)
    return Answer(_ipoc(root), corrections, outputs, text, tuple(unknown), root.get("Type", ""))


def frame_of(place: Array) -> Array:
    """X, Y, Z (mm) and A, B, C (deg) (6,) of a pose (4, 4); turns about z by A, then y by B, then x by C."""
    angles = -pose.euler_xyz_from_rotation(place[:3, :3].T)[::-1]
    return np.append(1e3 * place[:3, 3], np.degrees(angles))


def pose_from(frame: Array) -> Array:
    """Pose (4, 4) of X, Y, Z (mm) and A, B, C (deg) (6,), see `frame_of`."""
    rotation = pose.rotation_from_euler_xyz(-np.radians(frame[:2:-1])).T
    return pose.from_rotation(rotation, 1e-3 * frame[:3])


def _root(packet: bytes, tag: str) -> ElementTree.Element:
    if len(packet) > _MOST or b"<!" in packet:  # a document type could define entities
        raise MessageError(key="packet", value=f"{len(packet)} bytes", expected=f"at most {_MOST}, no document type")
    try:
        root = ElementTree.fromstring(packet)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise MessageError(key="packet", value=f"{packet[:40]!r}: {error}", expected="XML") from None
    if root.tag != tag:
        raise MessageError(key="packet", value=root.tag[:40], expected=tag)
    return root


def _ipoc(root: ElementTree.Element) -> int:
    return _integer(_IPOC, root.findtext(_IPOC))


def _integer(name: str, text: str | None) -> int:
    if text is None or not _DIGITS.fullmatch(text):
        raise MessageError(key=name, value=text, expected="a whole number")
    return int(text)


def _numbers(element: ElementTree.Element) -> dict[str, float]:
    try:
        numbers = {name: float(text) for name, text in element.attrib.items()}
    except ValueError:
        raise MessageError(key=element.tag, value=element.attrib, expected="numbers") from None
    if not all(math.isfinite(x) for x in numbers.values()):
        raise MessageError(key=element.tag, value=numbers, expected="finite numbers")
    return numbers
