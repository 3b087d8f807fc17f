"""Report of a sensor's calibration: parameters with uncertainty, range error, the calibrated sensor, files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from scancell.arguments import checked_fields
from scancell.calibration.report import SavedCalibration, comparison_text
from scancell.calibration.sensor.problem import FRAME, RADIUS_OFFSET, SensorParameters, TargetExposure
from scancell.calibration.sensor.simulated import calibrate_from, measure, poses_known, range_error
from scancell.calibration.sensor.solve import SensorCalibration
from scancell.calibration.sensor.targets import MeasuredExposures, read_exposures, write_exposures
from scancell.config.choices import SensorTarget
from scancell.config.loading import Setup, as_built_sensor, require_sensor_words
from scancell.config.sensor import SensorDescription
from scancell.errors import DescriptionError
from scancell.geometry import pose
from scancell.output.run_folder import RunFolder
from scancell.progress import Progress

_DOUBTFUL = 3.0  # times the stated noise of peaks, from which a warning says so
_MANY = 0.02  # share of discarded residuals, likewise

_MOUNTING_MM, _MOUNTING_DEG = 0.5, 0.3  # standard deviations of a simulated stage's mounting


@dataclass(frozen=True)
class SensorRow:
    """A calibrated key: value of the description, value found, half width of its interval, and true value if known."""

    name: str
    nominal: float
    value: float
    half_width: float
    true: float | None = None

    @property
    def deviation(self) -> float:
        """Value minus that of the description."""
        return self.value - self.nominal

    @property
    def error(self) -> float | None:
        """Value minus true value."""
        return None if self.true is None else self.value - self.true


@dataclass(frozen=True)
class RangeError:
    """RMS error of points over images and range, m, before and after; `aligned` on the true ones by a rigid motion."""

    before: float
    after: float
    aligned: bool


@dataclass(frozen=True, eq=False, repr=False)
class SensorCalibrationReport(SavedCalibration):
    """A calibration of a described sensor; `save` writes ``calibrated_sensor.toml`` and ``calibration.json`` as well.

    Attributes
    ----------
    result, exposures
        The solution, and the measured peaks of the target's exposures.
    setup
        With the description that the calibration started from.
    built
        The sensor as built, where it is simulated.
    inputs, run
        Files and settings for the manifest.
    probability
        Probability of the intervals.

    Examples
    --------
    >>> report = scancell.calibrate_sensor("ball", as_built={"sensor.laser.turn_y_deg": 0.1})
    >>> round(report.sensor.laser.turn_y_deg, 2)
    0.1
    >>> files = report.save("sensor")
    """

    result: SensorCalibration
    exposures: tuple[TargetExposure, ...]
    setup: Setup
    inputs: Sequence[Path]
    run: Mapping[str, Any]
    built: SensorDescription | None = None
    probability: float = 0.95
    _picture_name = "distances.png"

    @property
    def sensor(self) -> SensorDescription:
        """The calibrated description, for `estimated_sensor` of a scan."""
        return self.result.sensor

    @cached_property
    def rows(self) -> list[SensorRow]:
        """The keys that were free, in their units."""
        from scipy.special import ndtri  # noqa: PLC0415  (slow to import)

        result = self.result
        factor = float(ndtri(0.5 + self.probability / 2))
        nominal = SensorParameters(self.setup.sensor, result.names).start_values
        true = self._true
        return [
            SensorRow(name, float(start), float(value), factor * float(sigma), None if true is None else true[name])
            for name, start, value, sigma in zip(result.names, nominal, result.values, result.sigma, strict=True)
        ]

    @cached_property
    def range_error(self) -> RangeError | None:
        """Errors of the simulated sensor by its nominal and by its calibrated description; None of a real one."""
        if self.built is None:
            return None
        align = not poses_known(self.exposures)
        before, after = (range_error(self.built, used, align) for used in (self.setup.sensor, self.sensor))
        return RangeError(before, after, align)

    @property
    def warnings(self) -> list[str]:
        """Warnings about the result."""
        result, found = self.result, []
        scatter = float(np.sqrt(result.chi_square))
        if scatter > _DOUBTFUL:
            found.append(
                f"points scatter {scatter:.1f} times as much as the stated sigma of their peaks: is the target the"
                " described one, and does the sensor have other deviations than those to find?"
            )
        share = result.discarded / (result.used + result.discarded)
        if share > _MANY:
            found.append(f"{100 * share:.1f} % of the measurements do not fit and were discarded")
        if self.built is not None and self._true is None:
            found.append(
                "true values are not listed: with unknown poses the sheet and the first camera define the sensor frame,"
                " and as built they are elsewhere in it; the range error is compared after alignment"
            )
        return found

    @property
    def figures(self) -> dict[str, Any]:
        """Plain figures, in the units that their names state."""
        result, error = self.result, self.range_error
        return {
            "parameters": [{**asdict(row), "deviation": row.deviation, "error": row.error} for row in self.rows],
            "probability": self.probability,
            "covariance": result.covariance.tolist(),
            "covariance_scale": result.covariance_scale,
            "exposures": len(self.exposures),
            "residuals_used": result.used,
            "residuals_discarded": result.discarded,
            "chi_square": result.chi_square,
            "rms_um": 1e6 * self._rms,
            "range_error_um": None
            if error is None
            else {"before": 1e6 * error.before, "after": 1e6 * error.after, "aligned": error.aligned},
        }

    def summary(self) -> str:
        """The figures as lines of text."""
        result, error = self.result, self.range_error
        interval = f"{100 * self.probability:g} % interval"
        is_known = self.built is not None and self._true is not None
        lines = [
            f"{result.used} residuals of {len(self.exposures)} exposures, {result.discarded} discarded, "
            f"RMS {1e6 * self._rms:.2f} um",
            f"  {'parameter':34} {'nominal':>10} {'estimate':>10}    {interval:>14}"
            + (f" {'true':>10} {'error':>10}" if is_known else ""),
        ]
        for row in self.rows:
            text = f"  {row.name:34} {row.nominal:10.5f} {row.value:10.5f} +- {row.half_width:14.5f}"
            lines.append(text + comparison_text(row.true, row.value, row.half_width))
        if error is not None:
            how = " after alignment" if error.aligned else ""
            lines.append(f"  range error{how}: {1e6 * error.before:.2f} um before, {1e6 * error.after:.2f} um after")
        return "\n".join(lines)

    @property
    def _distances(self) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
        return self.result.distances, self.result.exposure

    def _write(self, folder: RunFolder, command_line: list[str]) -> None:
        super()._write(folder, command_line)
        self.sensor.to_toml(folder.path("calibrated_sensor.toml"))
        write_exposures(self.exposures, folder.path("peaks.parquet"))

    @property
    def _rms(self) -> float:
        return float(np.sqrt(np.mean(self.result.distances**2)))

    @cached_property
    def _true(self) -> dict[str, float] | None:
        """True values by key; None where they are unknown, or in another sensor frame than the calibrated one's."""
        if self.built is None:
            return None
        held = [name for name in FRAME if name not in self.result.names]
        as_built, described = (SensorParameters(one, held).start_values for one in (self.built, self.setup.sensor))
        if not np.array_equal(as_built, described):
            return None
        values = SensorParameters(self.built, self.result.names).start_values
        return dict(zip(self.result.names, values.tolist(), strict=True))


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
        away = None
        if not request.is_pose_known:
            shift, turn = np.random.default_rng(seed).normal(size=(2, 3))
            away = pose.from_euler_xyz(1e-3 * _MOUNTING_MM * shift, np.radians(_MOUNTING_DEG) * turn)
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
