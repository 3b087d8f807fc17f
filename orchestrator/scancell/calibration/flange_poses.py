"""Flange poses of a real robot in a table of measurements."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scancell.calibration.measured_table import MeasuredTable
from scancell.errors import CalibrationError, DescriptionError
from scancell.geometry.pose_conventions import CONVENTIONS, PoseReading, StatedPoses, better_reading

Array = NDArray[np.float64]

PREFIX = "flange_"
_MOST_WRONG = 1 / 3  # of the poses: more are no exceptions
_STATED = "orientation"  # in place of the convention in names of columns: an option states it


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
