"""Results of a calibration for a sensor and its pose on the robot, from the folder of results."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell.calibration.sensor.parameters import RADIUS_OFFSET
from scancell.config.cell import CellDescription
from scancell.config.estimated import EstimatedDescription, EstimatedToolDescription
from scancell.config.robot import MAX_JOINTS
from scancell.errors import DescriptionError
from scancell.files import read_json
from scancell.geometry import pose
from scancell.recorded.uncertainty import ValueCovariance

_DIGITS = 12  # of mm and deg


@dataclass(frozen=True)
class FoundByCalibration:
    """Files with the calibrated cell and sensor, pose (4, 4) of the sensor on the flange, quarter turns of images.

    None where the calibration did not find it. The pose is that of a calibration by images of a board; that of a cell
    is in its `cell`. `uncertainty` holds those of a cell's deviations and of a sensor's keys, where they are stated.
    """

    cell: Path | None
    sensor: Path | None
    flange_from_sensor: NDArray[np.float64] | None
    quarter_turns: int = 0
    uncertainty: tuple[ValueCovariance, ...] = ()


def read_calibration(folder: Path) -> FoundByCalibration:
    """What the folder of results of `scancell calibrate`, or its ``calibration.json``, holds.

    Raises `DescriptionError` naming the file, key and what was expected.
    """
    file = folder / "calibration.json" if folder.is_dir() else folder
    if not file.exists():
        raise DescriptionError("no such file", file=file, expected="results of `scancell calibrate`")
    found = read_json(file)
    if not isinstance(found, dict):
        raise DescriptionError("is not a JSON object", file=file, expected="the JSON of a calibration")
    cell, sensor = (file.parent / name for name in ("calibrated.toml", "calibrated_sensor.toml"))
    by_images = "quarter_turns" in found
    turns = found.get("quarter_turns", 0)
    if turns not in (0, 1, 2, 3):
        raise DescriptionError(file=file, key="quarter_turns", value=turns, expected="0, 1, 2 or 3")
    return FoundByCalibration(
        cell if cell.is_file() else None,
        sensor if sensor.is_file() else None,
        _pose(found.get("flange_from_sensor_m"), file) if by_images else None,
        int(turns),
        _uncertainty(found, file),
    )


def _uncertainty(found: dict[str, Any], file: Path) -> tuple[ValueCovariance, ...]:
    """Covariances of deviations of the cell and of keys of the sensor; that of a board's calibration is neither."""
    stated = []
    for rows, key, of_sensor in (("deviations", "covariance_si", False), ("parameters", "covariance", True)):
        if rows not in found or key not in found:
            continue
        try:
            names = tuple(str(row["name"]) for row in found[rows])
            matrix = np.asarray(found[key], float)
        except (KeyError, TypeError, ValueError):
            raise DescriptionError(file=file, key=key, value=found[key], expected="numbers, and names") from None
        is_covariance = (
            matrix.shape == (len(names), len(names))
            and np.isfinite(matrix).all()
            and np.allclose(matrix, matrix.T, rtol=1e-6, atol=0.0)
            and bool((np.diag(matrix) >= 0.0).all())
        )
        if not is_covariance:
            expected = f"a covariance, {len(names)} x {len(names)}, one row for each of {rows}"
            raise DescriptionError(file=file, key=key, value=f"an array {matrix.shape}", expected=expected)
        if not of_sensor:
            _require_deviations(names, file)
        kept = [row for row, name in enumerate(names) if name != RADIUS_OFFSET]  # belongs to the target
        stated.append(ValueCovariance(tuple(names[row] for row in kept), matrix[np.ix_(kept, kept)], of_sensor))
    return tuple(stated)


def _require_deviations(names: tuple[str, ...], file: Path) -> None:
    try:
        EstimatedDescription.of(dict.fromkeys(names, 0.0), MAX_JOINTS)
    except DescriptionError as error:
        raise DescriptionError(str(error), file=file, key="deviations") from None


def _pose(values: Any, file: Path) -> NDArray[np.float64]:
    try:
        matrix = np.asarray(values, float)
        is_pose = matrix.shape == (4, 4) and bool(
            np.abs(matrix[:3, :3].T @ matrix[:3, :3] - np.eye(3)).max() < 1e-6
            and np.linalg.det(matrix[:3, :3]) > 0
            and (matrix[3] == [0, 0, 0, 1]).all()
        )
    except (TypeError, ValueError):
        is_pose = False
    if not is_pose:
        raise DescriptionError(file=file, key="flange_from_sensor_m", value=values, expected="a pose, 4 x 4")
    return matrix


def with_sensor_at(cell: CellDescription, flange_from_sensor: NDArray[np.float64]) -> CellDescription:
    """The cell with the sensor at a pose (4, 4) on the flange, which includes what was estimated of it before."""
    turn = np.degrees(pose.euler_xyz_from_rotation(flange_from_sensor[:3, :3]))
    place = 1e3 * flange_from_sensor[:3, 3]
    values = [round(float(value), _DIGITS) for value in (*place, *turn)]
    names = ("x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg")
    tool = cell.tool.replace({"fixture": None, "flange_from_sensor": dict(zip(names, values, strict=True))})
    estimated = cell.estimated
    if estimated is not None:
        estimated = estimated.model_copy(update={"tool": EstimatedToolDescription()})
    return cell.model_copy(update={"tool": tool, "estimated": estimated})
