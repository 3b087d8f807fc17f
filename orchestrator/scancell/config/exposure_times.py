"""When the exposures of a profile begin and end, and how fast profiles can follow one another."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scancell.config.sensor import SensorDescription, read_out

Array = NDArray[np.float64]


def exposure_windows(sensor: SensorDescription) -> Array:
    """Middle of each exposure of a profile, after the middle of all, and its duration (k, 2), s.

    With a rolling shutter these are the times of the middle row.
    """
    durations = _durations(sensor)
    middles = _starts(sensor)[:-1] + durations / 2
    return np.column_stack([middles - exposure_span(sensor) / 2, durations])


def exposure_span(sensor: SensorDescription) -> float:
    """Time (s) from the start of the first exposure of a profile to the end of the last one, in one row."""
    return float(_starts(sensor)[-2] + _durations(sensor)[-1])


def profile_time(sensor: SensorDescription) -> float:
    """Shortest time from a profile to the next one, s; with automatic exposure that of the longest one."""
    return float(_starts(sensor, longest=True)[-1])


def _durations(sensor: SensorDescription, longest: bool = False) -> Array:
    first = sensor.exposure.longest_ms if longest else None
    return 1e-3 * np.array([first or sensor.detector.exposure_ms, *sensor.exposure.further_ms])


def _starts(sensor: SensorDescription, longest: bool = False) -> Array:
    """Earliest starts (k + 1,) of the exposures of a profile, s; the last one is that of the next profile.

    An image with the laser off follows each exposure and takes as long. With a rolling shutter the rows of an image are
    read after one another before the next one begins; with a global shutter an image is read during the next exposure.
    The rows are those of the region that is read; binned ones count once.
    """
    detector = sensor.detector
    rows = max(camera.height_px for camera in read_out(sensor).camera)
    readout = 1e-6 * (detector.row_readout_us or 0.0) * (rows - 1)
    durations = _durations(sensor, longest)
    images = np.repeat(durations, 2 if detector.laser_off_frame else 1)
    times = images + readout if detector.shutter == "rolling" else np.maximum(images, readout)
    return np.concatenate([[0.0], np.cumsum(times.reshape(len(durations), -1).sum(1))])
