"""Measured points for calibration as a table, so that profiles of a real cell can be used."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scancell.calibration.cell.kinematics import AxisReadings
from scancell.calibration.cell.problem import Observations
from scancell.calibration.measured_table import MeasuredTable, write_measured_table
from scancell.errors import DescriptionError

Array = NDArray[np.float64]

_DEFAULT_SIGMA_UM = 10.0
_SAME = 1e-9  # deg: readings of one exposure must agree


def write_points(data: Observations, path: Path) -> None:
    """Write CSV or Parquet (by suffix), a row per point; see docs/calibration.md for the columns.

    Raises `OutputError` if the file cannot be written.
    """
    readings, frame = data.readings, data.frame
    columns: dict[str, NDArray[np.generic]] = {"exposure": frame + 1}
    for name, values, unit in (
        ("q", readings.q, "deg"),
        ("qd", readings.qd, "deg_s"),
        ("qdd", readings.qdd, "deg_s2"),
    ):
        for joint, column in enumerate(np.degrees(values).T, 1):
            columns[f"{name}{joint}_{unit}"] = column[frame]
    columns["table_deg"] = np.degrees(readings.table)[frame]
    columns["table_rate_deg_s"] = np.degrees(readings.table_rate)[frame]
    columns["table_acceleration_deg_s2"] = np.degrees(readings.table_acceleration)[frame]
    for axis, values in zip("xyz", data.points_in_sensor.T, strict=True):
        columns[f"{axis}_mm"] = 1e3 * values
    for axis, values in zip("xyz", data.direction.T, strict=True):
        columns[f"error_{axis}"] = values
    columns["sigma_um"] = 1e6 * data.sigma
    columns["time_offset_ms"] = 1e3 * data.time_offset
    write_measured_table(path, columns)


def read_points(path: Path, joints: int) -> Observations:
    """Observations from CSV or Parquet.

    Raises `DescriptionError` if the file is missing, lacks a column, holds values that are not finite numbers, or the
    readings of an exposure differ.

    Parameters
    ----------
    joints
        Number of joints of the arm.
    """
    table = MeasuredTable(path)
    number, first, frame = np.unique(table.numbers("exposure"), return_index=True, return_inverse=True)
    per_point = {
        "q": np.column_stack([table.numbers(f"q{joint}_deg") for joint in range(1, joints + 1)]),
        "qd": np.column_stack([table.numbers(f"qd{joint}_deg_s", 0.0) for joint in range(1, joints + 1)]),
        "qdd": np.column_stack([table.numbers(f"qdd{joint}_deg_s2", 0.0) for joint in range(1, joints + 1)]),
        "table": table.numbers("table_deg"),
        "table_rate": table.numbers("table_rate_deg_s", 0.0),
        "table_acceleration": table.numbers("table_acceleration_deg_s2", 0.0),
    }
    readings = {}
    for name, values in per_point.items():
        away = np.abs(values - values[first][frame]).reshape(len(values), -1).max(1)
        if len(away) and away.max() > _SAME:
            row = int(away.argmax())
            raise DescriptionError(
                f"{name} differs from that in the first row of exposure {number[frame[row]]:g}",
                file=path,
                key=f"row {row + 1}",
                expected="equal readings in all rows of an exposure",
            )
        readings[name] = np.radians(values[first])
    direction = np.column_stack([table.numbers(f"error_{axis}", float(axis == "z")) for axis in "xyz"])
    length = np.linalg.norm(direction, axis=1, keepdims=True)
    sigma = table.numbers("sigma_um", _DEFAULT_SIGMA_UM)
    if (sigma <= 0).any() or (length == 0).any():
        raise DescriptionError("sigma_um and the length of error_x, error_y, error_z must be above 0", file=path)
    points = [table.numbers("x_mm", 0.0), table.numbers("y_mm"), table.numbers("z_mm")]
    return Observations(
        AxisReadings(**readings),
        1e-3 * np.column_stack(points),
        1e-6 * sigma,
        direction / length,
        np.asarray(frame, np.intp).reshape(-1),
        1e-3 * table.numbers("time_offset_ms", 0.0),
    )
