"""Measured points for calibration as a table, so that profiles of a real cell can be used."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scancell.calibration.cell.kinematics import AxisReadings
from scancell.calibration.cell.problem import Observations
from scancell.calibration.flange_poses import flange_columns, has_flange, read_flange
from scancell.calibration.measured_table import MeasuredTable, write_measured_table
from scancell.calibration.pose_files import read_pose_file
from scancell.errors import DescriptionError
from scancell.geometry.pose_conventions import StatedPoses

Array = NDArray[np.float64]

_DEFAULT_SIGMA_UM = 10.0
_SAME = 1e-9  # deg: readings of one exposure must agree
_MOST_NAMED = 3


def write_points(data: Observations, path: Path) -> None:
    """Write CSV or Parquet (by suffix), a row per point; see docs/calibration.md for the columns.

    Raises `OutputError` if the file cannot be written.
    """
    readings, frame = data.readings, data.frame
    columns: dict[str, NDArray[np.generic]] = {"exposure": frame + 1}
    if readings.flange is not None:
        columns |= {name: values[frame] for name, values in flange_columns(readings.flange).items()}
    columns |= {name: values[frame] for name, values in readings.columns().items()}
    for axis, values in zip("xyz", data.points_in_sensor.T, strict=True):
        columns[f"{axis}_mm"] = 1e3 * values
    if data.direction is not None:
        columns |= {f"error_{axis}": values for axis, values in zip("xyz", data.direction.T, strict=True)}
    columns["sigma_um"] = 1e6 * data.sigma
    columns["time_offset_ms"] = 1e3 * data.time_offset
    write_measured_table(path, columns)


@dataclass(frozen=True)
class MeasuredPoints:
    """Observations from files.

    Attributes
    ----------
    path, flange_path
        The tables of points and of flange poses, which may be the same.
    exposures
        (n,) number of each exposure in the table.
    flange
        Flange poses (n) as stated; None where joints are given.
    poses_kind
        What the file of flange poses was taken for; empty for a table with names of columns.
    """

    path: Path
    observations: Observations
    exposures: Array
    flange: StatedPoses | None = None
    flange_path: Path | None = None
    poses_kind: str = ""


def read_points(
    path: Path,
    joints: int,
    flange_path: Path | None = None,
    convention: str | None = None,
    table: MeasuredTable | None = None,
) -> MeasuredPoints:
    """Observations from CSV, Parquet or YAML; rows without ``z_mm`` are left out.

    Raises `DescriptionError` if a file is missing, lacks a column or a pose, holds values that are not finite numbers,
    or the readings of an exposure differ.

    Parameters
    ----------
    joints
        Number of joints of the arm.
    flange_path
        Table of flange poses by exposure; by default they, or joints, are in the table of points.
    convention
        Of flange poses, see `read_flange`.
    table
        That of the points, where it has been read.
    """
    if table is None:
        table = MeasuredTable(path)
        table.leave_out_missing("z_mm")
    numbers, first, frame = np.unique(table.numbers("exposure"), return_index=True, return_inverse=True)
    frame = np.asarray(frame, np.intp).reshape(-1)
    stated, kind = None, ""
    if flange_path is not None:
        poses, kind = read_pose_file(flange_path)
        stated = _poses_of(poses, numbers, path, convention)
    elif has_flange(table):
        every = read_flange(table, convention)
        stated = every.rows(first)
        per_point = {"flange position": every.position, "flange orientation": every.orientation}
        _require_equal(per_point, first, frame, numbers, table)
    elif convention is not None:
        raise DescriptionError("has no flange poses", file=path, key="convention", value=convention)
    readings = read_axes(table, joints if stated is None else 0, first, frame, numbers)
    if stated is not None:
        readings = AxisReadings.of_flange(stated.matrices(), readings.table)
    direction = None
    if any(f"error_{axis}" in table.names for axis in "xyz"):
        stated_direction = np.column_stack([table.numbers(f"error_{axis}", 0.0) for axis in "xyz"])
        length = np.linalg.norm(stated_direction, axis=1, keepdims=True)
        direction = stated_direction / np.where(length > 0, length, np.nan)
    sigma = table.numbers("sigma_um", _DEFAULT_SIGMA_UM)
    if (sigma <= 0).any() or (direction is not None and np.isnan(direction).any()):
        raise DescriptionError("sigma_um and the length of error_x, error_y, error_z must be above 0", file=path)
    time_offset = table.numbers("time_offset_ms", 0.0)
    if stated is not None and time_offset.any():
        table.refuse(int(np.flatnonzero(time_offset)[0]), "time_offset_ms", "0 with flange poses, which state no rates")
    observations = Observations(
        readings,
        1e-3 * _coordinates(table, stated is not None),
        1e-6 * sigma,
        direction,
        frame,
        1e-3 * time_offset,
    )
    return MeasuredPoints(path, observations, numbers, stated, flange_path or path, kind)


def _coordinates(table: MeasuredTable, with_flange: bool) -> Array:
    """Points (m, 3), mm; in a table of flange poses without y_mm, x_mm is along the line of the sensor."""
    if with_flange and "x_mm" in table.names and "y_mm" not in table.names:
        return np.column_stack([np.zeros(len(table)), table.numbers("x_mm"), table.numbers("z_mm")])
    return np.column_stack([table.numbers("x_mm", 0.0), table.numbers("y_mm"), table.numbers("z_mm")])


def _poses_of(table: MeasuredTable, numbers: Array, points: Path, convention: str | None) -> StatedPoses:
    """Flange poses of the exposures `numbers` (n,)."""
    stated, own = read_flange(table, convention), table.numbers("exposure")
    unique, row, count = np.unique(own, return_index=True, return_counts=True)
    if (count > 1).any():
        twice = float(unique[count > 1][0])
        table.refuse(int(np.flatnonzero(own == twice)[1]), "exposure", "one pose of each exposure")
    missing = np.setdiff1d(numbers, unique)
    if len(missing):
        raise DescriptionError(
            f"holds no flange pose of {len(missing)} of the {len(numbers)} exposures of {points.name}",
            file=table.path,
            key="column 'exposure'",
            expected="a row with exposure " + ", ".join(f"{number:g}" for number in missing[:_MOST_NAMED]),
        )
    return stated.rows(row[np.searchsorted(unique, numbers)])


def read_axes(
    table: MeasuredTable, joints: int, first: NDArray[np.intp], frame: NDArray[np.intp], numbers: Array
) -> AxisReadings:
    """Readings of joints and table, by the rows `first` (n,) of exposures; with no joints the table may be missing.

    `frame` (m,) is the exposure of each row, `numbers` (n,) those of the exposures for messages.

    Raises `DescriptionError` if a column is missing, or the readings of an exposure differ.
    """

    names = ("q", "table", "deg"), ("qd", "table_rate", "deg_s"), ("qdd", "table_acceleration", "deg_s2")
    per_point: dict[str, Array] = {}
    for name, of_table, unit in names:
        default = None if name == "q" else 0.0
        columns = [table.numbers(f"{name}{joint}_{unit}", default) for joint in range(1, 1 + joints)]
        columns.append(table.numbers(f"{of_table}_{unit}", default if joints else 0.0))
        per_point[name] = np.column_stack(columns)
    _require_equal(per_point, first, frame, numbers, table)
    return AxisReadings(*(np.radians(values[first]) for values in per_point.values()))


def _require_equal(
    per_point: dict[str, Array], first: NDArray[np.intp], frame: NDArray[np.intp], numbers: Array, table: MeasuredTable
) -> None:
    for name, values in per_point.items():
        away = np.abs(values - values[first][frame]).reshape(len(values), -1).max(1, initial=0.0)
        if away.max() > _SAME:
            row = int(away.argmax())
            raise DescriptionError(
                f"{name} differs from that in the first row of exposure {numbers[frame[row]]:g}",
                file=table.path,
                key=f"row {table.row_number(row)}",
                expected="equal readings in all rows of an exposure",
            )
