"""`calibrate sensor`: a sensor's calibration by simulated targets, or by peaks of a real sensor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from scancell.arguments import checked_fields
from scancell.calibration.sensor.parameters import RADIUS_OFFSET, SensorParameters
from scancell.calibration.sensor.points import MeasuredExposures, read_exposures
from scancell.calibration.sensor.report import SensorCalibrationReport
from scancell.calibration.sensor.simulated import calibrate_from, measure
from scancell.config.choices import SensorTarget
from scancell.config.loading import Setup, as_built_sensor, require_sensor_words
from scancell.errors import DescriptionError
from scancell.geometry import pose
from scancell.progress import Progress

_MOUNTING_MM, _MOUNTING_DEG = 0.5, 0.3  # standard deviations of a simulated stage's mounting


@checked_fields
@dataclass(frozen=True)
class SensorCalibrationRequest:
    """Measurements for the calibration of a sensor, and assumptions about them.

    Attributes
    ----------
    targets
        Simulated targets, see `scancell.calibration.sensor.simulated.measure`.
    from_points
        Table of peaks of a real sensor (docs/calibration_sensor.md) in place of simulated targets.
    is_pose_known
        Whether the simulated targets are at their stated positions in the sensor frame. Otherwise the stage that moves
        them is mounted elsewhere, at random, and only its travel is known.
    is_size_known
        Whether the balls' radius is exact; else it is found, too.
    also
        Further keys to find: ``sensor.camera[1].distortion[2]``.

    Examples
    --------
    >>> request = scancell.SensorCalibrationRequest(("ball",), is_pose_known=False)
    >>> report = scancell.calibrate_sensor(request)
    """

    targets: tuple[SensorTarget, ...] = ("ball",)
    from_points: Path | None = None
    is_pose_known: bool = True
    is_size_known: bool = True
    also: tuple[str, ...] = ()


def calibrate_described(
    setup: Setup,
    request: SensorCalibrationRequest,
    as_built: Sequence[str],
    seed: int,
    threads: int,
    progress: Progress,
) -> SensorCalibrationReport:
    """Calibrate the sensor of a setup; `as_built` are perturbations as ``key=value`` words.

    Raises `ScancellError` naming what is wrong and what was expected; `CalibrationError` where the measurements do not
    determine the unknowns.
    """
    words = tuple(as_built)
    require_sensor_words(words, "the calibration of a sensor is without the robot")
    sensor, file = setup.sensor, request.from_points
    SensorParameters(sensor, request.also).start_values  # noqa: B018  (names are checked before the work)
    if file is None:
        built = as_built_sensor(sensor, words)
        away = None if request.is_pose_known else _mounting(seed)
        targets = tuple(dict.fromkeys(request.targets))
        for target in targets:
            if target not in get_args(SensorTarget):
                raise DescriptionError(key="targets", value=target, expected=", ".join(get_args(SensorTarget)))
        measured = MeasuredExposures(measure(sensor, words, targets, away, seed, threads, progress), ())
    elif words:
        raise DescriptionError(
            f"{file} holds peaks of a sensor as it is built", key="as_built", value=words[0], expected="none"
        )
    else:
        built, measured = None, read_exposures(file, sensor)
    progress.stage("solving", 1, "solution")
    size = () if request.is_size_known else (RADIUS_OFFSET,)
    result = calibrate_from(sensor, measured.exposures, (*size, *request.also))
    progress.advance(1)
    run = {
        "what": "sensor",
        "targets": sorted({one.target.source for one in measured.exposures}),
        "seed": seed,
        "as_built": list(words),
        "free": list(result.names),
    }
    return SensorCalibrationReport(result, measured.exposures, setup, measured.files, run, built)


def _mounting(seed: int) -> NDArray[np.float64]:
    """Mounting error (4, 4) of a simulated stage."""
    rng = np.random.default_rng(seed)
    shift, turn = rng.normal(size=(2, 3))
    return pose.from_euler_xyz(1e-3 * _MOUNTING_MM * shift, np.radians(_MOUNTING_DEG) * turn)
