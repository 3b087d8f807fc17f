"""Poses of the flange in programs and lists of robot controllers: each format is a row of one table."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scancell.calibration.flange_poses import PREFIX
from scancell.calibration.measured_table import MeasuredTable
from scancell.errors import DescriptionError
from scancell.files import read_file, require_file
from scancell.geometry.pose_conventions import CONVENTIONS
from scancell.text_table import decoded, text_table

_PLAIN = r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)"
_N = rf"\s*{_PLAIN}\s*"
_LOCATION = r"^[ \t]*[A-Za-z][\w.]*(?:\[\d+\])*[ \t]+"  # of V+
_SIX = r"[ \t]+".join([_PLAIN] * 6)
_BINARY = (b"PAR1",)


def _listed(count: int) -> str:
    return ",".join([_N] * count)


@dataclass(frozen=True)
class PoseFormat:
    """Poses of a controller as text.

    Attributes
    ----------
    name
        For messages.
    content
        Regular expression of what only such files hold.
    begin, record
        Regular expressions of the beginning of a pose, and of its six or seven numbers: each beginning must be that
        of a record.
    convention, length, angle
        Of the numbers, see `CONVENTIONS`.
    """

    name: str
    content: str
    begin: str
    record: str
    convention: str
    length: str = "mm"
    angle: str = "deg"


POSE_FORMATS = (
    PoseFormat(
        "KUKA KRL (E6POS: X, Y, Z, A, B, C)",
        r"\bE6POS\b|\{\s*X\s+[-+\d.]",
        r"\{\s*(?:E6POS:\s*)?X\s+[^=]",
        rf"\{{\s*(?:E6POS:\s*)?X{_N},\s*Y{_N},\s*Z{_N},\s*A{_N},\s*B{_N},\s*C{_N}[,}}]",
        "zyx",
    ),
    PoseFormat(
        "ABB RAPID (robtarget: position, quaternion)",
        r"\brobtarget\b",
        r"\brobtarget\s+[^;:]*:=\s*\[\s*\[",
        rf"\brobtarget\s+[^;:]*:=\s*\[\s*\[{_listed(3)}\]\s*,\s*\[{_listed(4)}\]",
        "wxyz",
    ),
    PoseFormat(
        "FANUC TP program (X, Y, Z, W, P, R)",
        r"^/POS\b",
        r"\bP\[\d+[^\]]*\]\s*\{",
        rf"\bP\[\d+[^\]]*\]\s*\{{[^{{}}]*?\bX\s*={_N}mm\s*,\s*Y\s*={_N}mm\s*,\s*Z\s*={_N}mm\s*,"
        rf"\s*W\s*={_N}deg\s*,\s*P\s*={_N}deg\s*,\s*R\s*={_N}deg",
        "xyzwpr",
    ),
    PoseFormat(
        "RobPoses list (X, Y, Z, W, P, R)", r'"RobPoses"', r"\[\s*[-+\d.]", rf"\[{_listed(6)}\]", "xyzwpr"
    ),
    PoseFormat(
        "Universal Robots poses (m, rotation vector in rad)",
        r"\bp\[|^\s*\[\s*[-+\d.]",
        r"(?<!set_tcp\()\bp\[|^\s*\[",
        rf"(?:(?<!set_tcp\()\bp|^\s*)\[{_listed(6)}\]",
        "rotvec",
        "m",
        "rad",
    ),
    PoseFormat(
        "V+ locations (X, Y, Z, yaw, pitch, roll)",
        r"\bTRANS\s*\(|^\.(?:LOCATIONS|TRANS)\b",
        rf"\bTRANS\s*\(|{_LOCATION}[-+\d.]",
        rf"\bTRANS\s*\({_listed(6)}\)|{_LOCATION}{_SIX}[ \t]*$",
        "zyz",
    ),
)  # fmt: skip


def read_pose_file(path: Path) -> tuple[MeasuredTable, str]:
    """Table of flange poses, ``exposure`` 1 and so on in the order of the file, and what the file was taken for.

    Tables of six or seven numbers without names are positions in mm and the numbers of a stated convention, in deg.

    Raises `DescriptionError` naming file, line and what was expected.
    """
    require_file(path)
    with path.open("rb") as stream:
        if stream.read(4) in _BINARY or path.suffix.lower() in (".yaml", ".yml"):
            return MeasuredTable(path), ""
    text, encoding = decoded(read_file(path), path)
    for form in POSE_FORMATS:
        if re.search(form.content, text, re.MULTILINE):
            return _of_format(path, text, form)
    found = text_table(text, encoding, path)
    if found.names:
        return MeasuredTable(path), ""
    width = len(found.rows[0].split(None if found.separator == " " else found.separator))
    if width not in (6, 7):
        return MeasuredTable(path), ""
    numbers = found.columns(range(width))
    unit = "_deg" if width == 6 else ""
    return _table(path, numbers, "orientation", "mm", unit), f"poses as {width} numbers in mm and deg, {found.kind}"


def _of_format(path: Path, text: str, form: PoseFormat) -> tuple[MeasuredTable, str]:
    begins = list(re.finditer(form.begin, text, re.MULTILINE))
    records = {match.start(): match for match in re.finditer(form.record, text, re.MULTILINE)}
    lost = next((match for match in begins if match.start() not in records), None)
    if lost is not None or not records:
        line = "" if lost is None else f"line {text.count(chr(10), 0, lost.start()) + 1}"
        raise DescriptionError(
            f"is taken for {form.name}, and " + (f"{line} holds no such pose" if line else "holds no pose"), file=path,
            expected=f"poses of the flange as position and {CONVENTIONS[form.convention].text}, no joints",
        )  # fmt: skip
    rows = [[float(number) for number in match.groups() if number is not None] for match in records.values()]
    unit = f"_{form.angle}" if CONVENTIONS[form.convention].is_angle else ""
    made = _table(path, np.array(rows), form.convention, form.length, unit)
    return made, f"{form.name}, {len(rows)} poses, which are read as those of the flange in the base"


def _table(path: Path, numbers: np.ndarray, convention: str, length: str, unit: str) -> MeasuredTable:
    columns = {"exposure": np.arange(1, len(numbers) + 1)}
    columns |= {f"{PREFIX}{axis}_{length}": numbers[:, i] for i, axis in enumerate("xyz")}
    columns |= {f"{PREFIX}{convention}_{i}{unit}": column for i, column in enumerate(numbers[:, 3:].T, 1)}
    return MeasuredTable(path, columns)
