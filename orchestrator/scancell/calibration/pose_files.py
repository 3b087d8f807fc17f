"""Poses of the flange in programs and lists of robot controllers: each format is a row of one table."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scancell.arrays import Array
from scancell.calibration.measured_table import MeasuredTable
from scancell.errors import CalibrationError, DescriptionError
from scancell.files import read_file, require_file
from scancell.geometry.orientation import CONVENTIONS, PoseReading, StatedPoses, better_reading
from scancell.text_table import decoded, text_table

PREFIX = "flange_"
_MOST_WRONG = 1 / 3  # of the poses: more are no exceptions
_STATED = "orientation"  # in place of the convention in names of columns: an option states it

_PLAIN = r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)"
_N = rf"\s*{_PLAIN}\s*"
_LOCATION = r"^[ \t]*[A-Za-z][\w.]*(?:\[\d+\])*[ \t]+"  # of V+
_SIX = r"[ \t]+".join([_PLAIN] * 6)
_BINARY = (b"PAR1",)


def has_flange(table: MeasuredTable) -> bool:
    """Whether a table has columns of flange poses."""
    return any(name.startswith(PREFIX) for name in table.names)


def read_flange(table: MeasuredTable, convention: str | None = None) -> StatedPoses:
    """Poses (rows) by the columns ``flange_x_mm`` … and ``flange_CONVENTION_1`` …, see docs/calibration.md.

    Raises `DescriptionError` naming file, column, row, value and what was expected.

    Parameters
    ----------
    convention
        That of columns ``flange_orientation_1`` ….
    """
    length = "m" if f"{PREFIX}x_m" in table.names else "mm"
    position = np.column_stack([table.numbers(f"{PREFIX}{axis}_{length}") for axis in "xyz"])
    pattern = re.compile(rf"{PREFIX}({'|'.join((*CONVENTIONS, _STATED))})_\d+(?:_(deg|rad))?")
    found = {(match[1], match[2] or "") for match in map(pattern.fullmatch, table.names) if match}
    if len(found) != 1:
        raise DescriptionError(
            "the orientation of the flange is missing" if not found else "the orientation of the flange is given twice",
            file=table.path,
            key="columns " + ", ".join(name for name in table.names if name.startswith(PREFIX)),
            expected=f"{PREFIX}CONVENTION_1, … with one of {', '.join(CONVENTIONS)}, and _deg or _rad after angles",
        )
    ((word, unit),) = found
    name = _convention(table, word, convention)
    if CONVENTIONS[name].is_angle != bool(unit):
        expected = f"{PREFIX}{word}_1" + ("_deg or _rad" if CONVENTIONS[name].is_angle else "")
        raise DescriptionError(
            file=table.path,
            key=f"column '{PREFIX}{word}_1{unit and '_' + unit}'",
            expected=expected,
            problem="has a wrong unit",
        )
    columns = [f"{PREFIX}{word}_{i}{unit and '_' + unit}" for i in range(1, CONVENTIONS[name].count + 1)]
    orientation = np.column_stack([table.numbers(column) for column in columns])
    stated = StatedPoses(position, orientation, PoseReading(name, length, unit or "deg"))
    wrong = stated.wrong_row()
    if wrong:
        row, expected = wrong
        raise DescriptionError(
            file=table.path,
            key=f"columns '{columns[0]}' … '{columns[-1]}', row {row + 1}",
            value=tuple(orientation[row].tolist()),
            expected=expected,
        )
    return stated


def _convention(table: MeasuredTable, word: str, stated: str | None) -> str:
    if stated is not None and stated not in CONVENTIONS:
        raise DescriptionError(key="convention", value=stated, expected=f"one of {', '.join(CONVENTIONS)}")
    if word == _STATED:
        if stated is None:
            raise DescriptionError(
                "needs a `convention`",
                file=table.path,
                key=f"column '{PREFIX}{word}_1'",
                expected=f"one of {', '.join(CONVENTIONS)}",
            )
        return stated
    if stated is not None and stated != word:
        raise DescriptionError(
            f"the columns {PREFIX}{word}_1 … of {table.path.name} state another convention",
            key="convention",
            value=stated,
            expected=word,
        )
    return word


def flange_columns(flange: Array) -> dict[str, Array]:
    """Columns of poses (n, 4, 4), as `read_flange` reads them."""
    columns = {f"{PREFIX}{axis}_mm": 1e3 * flange[:, i, 3] for i, axis in enumerate("xyz")}
    numbers = flange[:, :3, :3].reshape(-1, 9).T
    return {**columns, **{f"{PREFIX}matrix_{i}": values for i, values in enumerate(numbers, 1)}}


def refuse_misread(
    stated: StatedPoses, misfit: Callable[[Array], float], measured: str, compared: str, file: Path | None
) -> None:
    """Raise `CalibrationError` if another convention or unit of the poses fits the measurements much better.

    `misfit` is the median distance, m, of what is `compared`, at poses (n, 4, 4) of the flange.
    """
    if (better := better_reading(stated, misfit)) is None:
        return
    reading, fits, own = better
    raise CalibrationError(
        f"the flange poses do not fit {measured} as {stated.reading.text()}: the median distance of {compared} is"
        f" {1e3 * own:.3g} mm; they fit to {1e3 * fits:.3g} mm as {reading.text()}",
        file=file,
    )


def refuse_wrong(
    away: Array,
    limit: float,
    name: Callable[[int], str],
    parts: tuple[str, str],
    file: Path | None,
    most_named: int | None = None,
) -> None:
    """Raise `CalibrationError` naming the few poses whose distances (n,), m, from the others exceed a limit.

    `parts` are what has a pose, and what agrees: images and boards.
    """
    wrong = np.flatnonzero(away > limit)
    if not len(wrong) or len(wrong) >= _MOST_WRONG * len(away):
        return
    named = ", ".join(f"{name(i)} by {1e3 * away[i]:.1f} mm" for i in wrong[:most_named])
    raise CalibrationError(
        f"{len(wrong)} of {len(away)} {parts[0]} disagree with the others, whose {parts[1]} agree to"
        f" {1e3 * float(np.median(away)):.3f} mm (median): {named}; correct their flange poses, or leave them out",
        file=file,
    )


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
        Convention, length and angle of the numbers, see `CONVENTIONS`.
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
