"""Systematic uncertainty of a cloud: what the uncertainty of calibrated values adds to the noise of its points.

A calibration states the covariance C of its values. All points of a cloud share their errors, which therefore do not
average out: to first order a point is displaced by J e, with J its derivative by the values and e their error, and has
the covariance J C Jᵀ (JCGM 102, 6.2).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.arrays import Array
from scancell.calibration.sensor.problem import RADIUS_OFFSET, SensorParameters
from scancell.config.cell import CellDescription, EstimatedDescription, EstimatedToolDescription
from scancell.config.robot import MAX_JOINTS
from scancell.config.sensor import SensorDescription
from scancell.errors import DescriptionError
from scancell.files import read_json
from scancell.geometry import pose

_STEP = 1e-5  # m, rad, s: half the interval of difference quotients by deviations of the cell
_SENSOR_STEP = 1e-3  # of a parameter's tolerance: the same by keys of the sensor
_BLOCK = 1 << 16  # points at a time, which bounds the memory

Derivatives = Callable[[slice], Iterator[Array]]
"""Derivatives (m, 3) of some points by each value, m per unit of the value."""

_DIGITS = 12  # of mm and deg


@dataclass(frozen=True)
class ValueCovariance:
    """Covariance (k, k) of calibrated values by name.

    They are deviations of the cell, such as ``tool.x``, in SI, or, with `of_sensor`, keys of the sensor in the units of
    the keys.
    """

    names: tuple[str, ...]
    covariance: Array
    of_sensor: bool


def propagated(covariance: Array, derivatives: Derivatives, count: int) -> Array:
    """Covariances (count, 3, 3) of points, m², by the covariance (k, k) of values."""
    found = np.empty((count, 3, 3))
    for start in range(0, count, _BLOCK):
        rows = slice(start, min(start + _BLOCK, count))
        jacobian = np.stack([*derivatives(rows)], -1)
        found[rows] = jacobian @ covariance @ np.swapaxes(jacobian, 1, 2)
    return found


def by_poses(
    names: tuple[str, ...],
    poses: Callable[[str, float], Array],
    points_in_sensor: Array,
    frame: NDArray[np.intp],
) -> Derivatives:
    """Derivatives of points (m, 3), m, of exposures (m,) by deviations of the cell.

    `poses` gives the poses (n, 4, 4) of the sensor of all exposures with a deviation changed by an amount, SI.
    """
    slopes = [(poses(name, _STEP) - poses(name, -_STEP)) / (2 * _STEP) for name in names]

    def derivatives(rows: slice) -> Iterator[Array]:
        for slope in slopes:
            turn, shift = slope[frame[rows], :3, :3], slope[frame[rows], :3, 3]
            yield np.einsum("nij,nj->ni", turn, points_in_sensor[rows]) + shift

    return derivatives


def by_sensor(
    names: tuple[str, ...],
    sensor: SensorDescription,
    points_in_sensor: Array,
    camera: NDArray[np.integer],
    turn: Callable[[slice], Array],
) -> Derivatives:
    """Derivatives of points (m, 3), m, by keys of the sensor.

    The pixel of a point is that at which its camera (m,) sees it; points merged from several cameras (-1) move by the
    mean of all cameras. `turn` gives rotations (m, 3, 3) from the sensor to the frame of the cloud.

    Raises `DescriptionError` if the sensor has no such camera.
    """
    parameters = SensorParameters(sensor, names)
    values, steps = parameters.start_values, _SENSOR_STEP * parameters.scales
    base = parameters.sensor(values)
    moved = [[parameters.sensor(values + sign * step) for sign in (1, -1)] for step in np.diag(steps)]
    cameras = range(len(base.cameras))
    if len(camera) and camera.max() >= len(cameras):
        raise DescriptionError(
            "of a point is none of the sensor's", key="camera", value=int(camera.max()), expected=f"0 to {cameras[-1]}"
        )

    def moves(pair: list[sensor_rt.Sensor], step: float, pixels: Array, number: int) -> Array:
        up, down = (sensor_rt.triangulate_pixels(pixels, one, number, "sheet") for one in pair)
        return np.asarray((up - down) / (2 * step))

    def derivatives(rows: slice) -> Iterator[Array]:
        points, own, rotation = points_in_sensor[rows], camera[rows], turn(rows)
        # Of each camera: rows of points, and their pixels.
        seen = [np.flatnonzero((own == number) | (own < 0)) for number in cameras]
        pixels = [base.cameras[number].project(points[chosen]) for number, chosen in zip(cameras, seen, strict=True)]
        weight = np.where(own < 0, 1.0 / len(cameras), 1.0)
        for pair, step in zip(moved, steps, strict=True):
            found = np.zeros_like(points)
            for number in cameras:
                chosen = seen[number]
                found[chosen] += weight[chosen, None] * moves(pair, float(step), pixels[number], number)
            yield np.einsum("nij,nj->ni", rotation, found)

    return derivatives


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
    """Values and uncertainties in a folder of results of `scancell calibrate`, or in its ``calibration.json``.

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
