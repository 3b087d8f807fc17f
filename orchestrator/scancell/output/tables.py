"""Tables as CSV files."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell.reconstruction.reconstruct import ProfilePoints

_ROWS = 1 << 16  # formatted at a time
_MM = 1e3


def write_csv(path: Path, columns: Mapping[str, NDArray[Any]]) -> None:
    """Write columns (n,) under their names: integers as they are, other numbers with six decimals, NaN as empty."""
    count = len(next(iter(columns.values())))
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(columns)
        for start in range(0, count, _ROWS):
            writer.writerows(
                zip(*(_written(values[start : start + _ROWS]) for values in columns.values()), strict=True)
            )


def _written(values: NDArray[Any]) -> list[Any]:
    if np.issubdtype(values.dtype, np.floating):
        return [f"{number:.6f}" if number == number else "" for number in values.tolist()]  # noqa: PLR0124 (NaN)
    return list(values.tolist())


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
