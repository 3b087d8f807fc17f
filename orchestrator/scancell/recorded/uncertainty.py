"""Systematic uncertainty of a cloud: what the uncertainty of calibrated values adds to the noise of its points.

A calibration states the covariance C of its values. All points of a cloud share their errors, which therefore do not
average out: to first order a point is displaced by J e, with J its derivative by the values and e their error, and has
the covariance J C Jᵀ (JCGM 102, 6.2).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.calibration.sensor.parameters import SensorParameters
from scancell.config.sensor import SensorDescription
from scancell.errors import DescriptionError

Array = NDArray[np.float64]

_STEP = 1e-5  # m, rad, s: half the interval of difference quotients by deviations of the cell
_SENSOR_STEP = 1e-3  # of a parameter's tolerance: the same by keys of the sensor
_BLOCK = 1 << 16  # points at a time, which bounds the memory

Derivatives = Callable[[slice], Iterator[Array]]
"""Derivatives (m, 3) of some points by each value, m per unit of the value."""


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
