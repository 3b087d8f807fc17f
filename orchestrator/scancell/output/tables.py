"""Tables as text: columns of numbers and words to CSV files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell.reconstruction.reconstruct import ProfilePoints

_ROWS = 1 << 16  # written at a time
_MM = 1e3


def write_csv(path: Path, columns: Mapping[str, NDArray[Any]]) -> None:
    """Write columns (n,) under their names, comma-separated (RFC 4180).

    Whole numbers stay whole, others get six decimals, NaN is left empty, words are quoted where they must be.
    """
    count = len(next(iter(columns.values())))
    with path.open("w", newline="", encoding="utf-8") as stream:
        stream.write(",".join(map(_quoted, columns)) + "\r\n")
        for start in range(0, count, _ROWS):
            fields = [_field(values[start : start + _ROWS]) for values in columns.values()]
            line = ",".join(pattern for pattern, _ in fields) + "\r\n"
            stream.write("".join(map(line.__mod__, zip(*(values for _, values in fields), strict=True))))


def _field(values: NDArray[Any]) -> tuple[str, list[Any]]:
    """The pattern by which a column's values are written, and the values."""
    if np.issubdtype(values.dtype, np.integer):
        return "%d", values.tolist()
    if np.issubdtype(values.dtype, np.floating):
        numbers = values.tolist()
        if not np.isnan(values).any():
            return "%.6f", numbers
        return "%s", ["" if number != number else f"{number:.6f}" for number in numbers]  # noqa: PLR0124 (NaN)
    different, number = np.unique(values, return_inverse=True)
    return "%s", np.array([_quoted(word) for word in different.tolist()], object)[number].tolist()


def _quoted(word: str) -> str:
    return '"' + word.replace('"', '""') + '"' if any(letter in word for letter in ',"\r\n') else word


def columns_of(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Columns for `write_csv` of rows that may lack some of the keys."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    return {name: _column([row.get(name) for row in rows]) for name in names}


def _column(values: Sequence[Any]) -> Any:
    if any(isinstance(value, str) for value in values):
        return np.array([value or "" for value in values])
    if all(isinstance(value, int) for value in values):
        return np.array([int(value) for value in values])
    return np.array([np.nan if value is None else float(value) for value in values])


def write_profile_csv(
    path: Path, profile: ProfilePoints, rows: NDArray[np.float64], points_in_part: NDArray[np.float64]
) -> None:
    """Points of one exposure in pixels, with image rows (m,), and in mm in the frames of sensor and part.

    `points_in_part` is (m, 3), m.
    """
    in_sensor, in_part = np.asarray(profile.points_in_sensor) * _MM, points_in_part * _MM
    write_csv(
        path,
        {
            "camera": np.asarray(profile.camera),
            "column_px": np.asarray(profile.column),
            "row_px": np.asarray(rows, float),
            **{f"{axis}_sensor_mm": in_sensor[:, i] for i, axis in enumerate("xyz")},
            **{f"{axis}_part_mm": in_part[:, i] for i, axis in enumerate("xyz")},
            "sigma_mm": np.asarray(profile.sigma, float) * _MM,
            "intensity_dn": np.asarray(profile.intensity, float),
        },
    )
