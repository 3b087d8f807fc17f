"""`CalibratingCell`: calibrations of the cell and of its sensor."""

from __future__ import annotations

from pathlib import Path

from scancell.arguments import Seed, checked_arguments
from scancell.config.choices import CalibrationTarget, Engine, SensorTarget
from scancell.config.files import assets_dir
from scancell.config.keys import Assignments, assignments
from scancell.config.loading import Setup
from scancell.geometry.mesh import Mesh
from scancell.jobs.calibration import CalibrationScan
from scancell.jobs.calibration_job import (
    CalibrationRequest,
    calibrate_from_points,
    calibrate_in_cell,
    start_of,
)
from scancell.jobs.calibration_report import CalibrationReport
from scancell.jobs.prepared_cell import PreparedCell
from scancell.jobs.sensor_calibration_job import SensorCalibrationRequest, calibrate_described
from scancell.jobs.sensor_calibration_report import SensorCalibrationReport
from scancell.progress import Progress, ProgressCallback, as_progress
from scancell.scanning.job import Job


class CalibratingCell(PreparedCell):
    """Calibrates the cell that it prepares; the poses of the last calibration are kept."""

    _calibration: CalibrationScan | None = None

    @checked_arguments
    def calibrate(
        self,
        request: CalibrationRequest | CalibrationTarget = "all",
        artefact: str | Path | Mesh | None = None,
        *,
        unit: str = "mm",
        engine: Engine = "geometric",
        as_built: Assignments = (),
        seed: Seed = 0,
        setup: Setup | None = None,
        from_points: str | Path | None = None,
        progress: Progress | ProgressCallback | None = None,
    ) -> CalibrationReport:
        """Scan an artefact and find the deviations of the cell from its description.

        The other parameters are those of `Scanner.scan`.

        Parameters
        ----------
        request
            What to calibrate, and how.
        artefact
            Artefact description or mesh of any part, placed by ``cell.part``; default: a sphere or ball plate.
        setup
            Descriptions of this calibration in place of the scanner's.
        from_points
            Table of measured points and joints of a real cell (docs/calibration.md), in place of a simulated scan.

        Raises
        ------
        ScancellError
            Naming what is wrong and what was expected; `CalibrationError` where the data do not determine the unknowns.

        Examples
        --------
        >>> with scancell.Scanner() as scanner:
        ...     report = scanner.calibrate("tool", as_built={"tool.x_mm": 1.0})
        ...     result = scanner.scan(
        ...         "part.stl", engine="geometric", as_built={"tool.x_mm": 1.0}, estimated=report.estimated
        ...     )
        >>> result.deviation.rms < 5e-6
        True
        """
        wanted = CalibrationRequest(request) if isinstance(request, str) else request
        part = assets_dir() / wanted.artefact if artefact is None else artefact
        job = self._job(part, unit, as_built, seed, setup)
        scan = self._calibration_scan(self._job(part, unit, setup=setup), wanted)
        if from_points is not None:
            return calibrate_from_points(scan, job, wanted, Path(from_points))
        return calibrate_in_cell(scan, job, wanted, engine, as_progress(progress))

    @checked_arguments
    def calibrate_sensor(
        self,
        request: SensorCalibrationRequest | SensorTarget = "ball",
        *,
        as_built: Assignments = (),
        seed: Seed = 0,
        progress: Progress | ProgressCallback | None = None,
    ) -> SensorCalibrationReport:
        """Find the deviations of the sensor's cameras and laser sheet from its description.

        The other parameters are those of `Scanner.scan`.

        Parameters
        ----------
        request
            Simulated targets, or measurements of a real sensor, and what is known of them.

        Raises
        ------
        ScancellError
            Naming what is wrong and what was expected; `CalibrationError` where the data do not determine the unknowns.

        Examples
        --------
        >>> bent = {"sensor.camera[1].tilt_deg": 29.4}
        >>> with scancell.Scanner() as scanner:
        ...     report = scanner.calibrate_sensor("ball", as_built=bent)
        ...     result = scanner.scan("part.stl", engine="geometric", as_built=bent, estimated_sensor=report.sensor)
        >>> result.deviation.rms < 5e-6
        True
        """
        wanted = SensorCalibrationRequest((request,)) if isinstance(request, str) else request
        words = assignments(as_built)
        return calibrate_described(self.setup, wanted, words, seed, self.pipeline.threads, as_progress(progress))

    def _calibration_scan(self, nominal: Job, request: CalibrationRequest) -> CalibrationScan:
        """The one made last, whose plan is kept, where it is for the same cell and request."""
        kept, options = self._calibration, request.options
        if (
            kept is None
            or kept.job.loaded is not nominal.loaded
            or (kept.job.setup, kept.options) != (nominal.setup, options)
        ):
            kept = self._calibration = CalibrationScan(self.pipeline, nominal, options, start_of(nominal.setup))
        return kept
