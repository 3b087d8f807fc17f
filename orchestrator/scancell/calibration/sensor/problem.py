"""Measurements for the calibration of a sensor: stripe peaks and corners on targets of known shape."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.config.sensor import SensorDescription
from scancell.geometry.shapes import ShapeGroup

Array = NDArray[np.float64]

PEAK_SPACING = 8
"""Columns between stripe peaks: nearer ones share errors, add no accuracy, and would understate the covariance."""


@dataclass(frozen=True)
class StripePeaks:
    """Stripe peaks of an exposure: camera (n,), column (n,), row (n,) and standard deviation of the row (n,), px."""

    camera: NDArray[np.int32]
    column: Array
    row: Array
    sigma: Array

    @classmethod
    def of(cls, peaks: sensor_rt.Peaks, frame: int = 0) -> StripePeaks:
        """Accepted peaks of one frame of `scancell.sensor.extract`, one of `PEAK_SPACING` neighbours."""
        accepted = (np.asarray(peaks.frame) == frame) & ((np.asarray(peaks.flags) & sensor_rt.PEAK_REJECTED) == 0)
        own = np.flatnonzero(accepted)[::PEAK_SPACING]
        column, row, sigma = (np.asarray(getattr(peaks, key), float)[own] for key in ("column", "row", "row_sigma"))
        return cls(np.asarray(peaks.camera)[own], column, row, sigma)


@dataclass(frozen=True)
class Corners:
    """Corners of a checkered target: camera (n,), pixels (n, 2), points_in_target (n, 3), m; deviation sigma, px."""

    camera: NDArray[np.int32]
    pixels: Array
    points_in_target: Array
    sigma: float


@dataclass(frozen=True)
class TargetExposure:
    """A target of known shape at rest.

    Attributes
    ----------
    target
        Its surfaces; those with the role `measured` count.
    sensor_from_target
        Pose (4, 4); a start where it is unknown.
    stripe, corners
        Measurements in the images.
    mounting
        Exposures of the same number share an unknown rigid displacement of their poses in the sensor frame, as those
        of a target on a stage that was mounted somewhere. None: the pose is known.
    """

    target: ShapeGroup
    sensor_from_target: Array
    stripe: StripePeaks | None = None
    corners: Corners | None = None
    mounting: int | None = None


@dataclass(frozen=True)
class SensorProblem:
    """Start description, exposures, and the names of the free parameters (see `SensorParameters`)."""

    sensor: SensorDescription
    exposures: tuple[TargetExposure, ...]
    free: tuple[str, ...]
