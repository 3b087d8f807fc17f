"""One trial: a whole scan with the drawn values, as one row of figures."""

from __future__ import annotations

import json
import os
import socket
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from scancell.calibration.cell.report import CalibrationReport
from scancell.config.description import validate
from scancell.config.loading import Setup
from scancell.config.study import FittedSphereDescription, StudyDescription
from scancell.config.units import to_si
from scancell.errors import FitError
from scancell.geometry.fits import fit_sphere
from scancell.nominal.parts import load_part
from scancell.output.manifest import build_version
from scancell.reconstruction.cloud import Cloud
from scancell.results import ScanResult
from scancell.stopwatch import Stopwatch
from scancell.studies.factors import checked_sections
from scancell.studies.scan_worker import ScanWorker, Trial, sweep_temporary, trial_of
from scancell.studies.task_store import disk_error
from scancell.visibility.measurable import MeasurableSurface, cache_folder, measurable_surface

ROWS = "rows.json"
TIMINGS = "timings.json"

_SPHERE_FIGURES = ("x_um", "y_um", "z_um", "diameter_error_um", "form_um", "rms_um")
_LEAST_POINTS = 10  # for the figures of a sphere
_FORM_QUANTILES = (0.025, 0.975)  # 95 % of the points, against outliers of a noisy cloud


class TrialWorker(ScanWorker):
    """Runs trials of one study in this process."""

    def __init__(self, study: StudyDescription, setup: Setup, part: Path) -> None:
        super().__init__(study, setup, load_part(part, study.unit), study.name)
        self._study = study

    @cached_property
    def _measurable(self) -> MeasurableSurface:
        """Measurable surface in the nominal cell of the study: the denominator of coverage in all trials."""
        return measurable_surface(self.nominal, self.setup.sensor, cache=cache_folder(), threads=1)

    def __call__(self, payload: Sequence[Mapping[str, Any]], folder: Path) -> None:
        """Make the trials of a task and write their rows and their timings into `folder`."""
        rows, timings = [], []
        for plain in payload:
            watch, start = Stopwatch(), time.process_time()
            rows.append(self.row(trial_of(plain), watch))
            spent = time.process_time() - start
            timings.append({"trial": plain["number"], **_process(), "processor_s": spent, "seconds": watch.seconds})
        (folder / ROWS).write_text(json.dumps(rows, indent=1, allow_nan=False) + "\n")
        (folder / TIMINGS).write_text(json.dumps(timings, indent=1) + "\n")

    def row(self, trial: Trial, watch: Stopwatch) -> dict[str, Any]:
        """Figures of a trial, or the message of its failure."""
        plain = {**asdict(trial), "values": list(trial.values)}
        try:
            with watch.measure("all"):
                figures = self._trial(trial, watch)
        except Exception as error:  # a trial that fails is a result, too; the others go on
            if disk_error(error):
                raise
            return {**plain, "status": "failed", "message": f"{type(error).__name__}: {error}", "figures": {}}
        return {**plain, "status": "ok", "message": "", "figures": figures}

    def _trial(self, trial: Trial, watch: Stopwatch) -> dict[str, Any]:
        """Figures of the scan, and of a calibration before it where the study has one."""
        figures, estimated = {}, None
        if self._study.calibrate is not None:
            with watch.measure("calibrate"):
                report = self.calibrated(trial, self._study.calibrate)
            figures, estimated = calibration_figures(report), report.estimated
        scan = self.scan(trial, estimated=estimated)
        figures = {**self._figures(scan), **figures}
        watch.seconds.update(scan.timings)
        return figures

    def _figures(self, scan: ScanResult) -> dict[str, Any]:
        figures = deviation_figures(scan)
        if self._study.coverage_samples:
            covered = scan.coverage_of(self._study.coverage_samples, self._measurable).fraction
            figures["coverage"] = None if np.isnan(covered) else covered
        for sphere in self._study.sphere:
            figures.update(_sphere_figures(sphere, scan.cloud))
        return figures


def deviation_figures(scan: ScanResult) -> dict[str, Any]:
    """Numbers of profiles and points, and the deviation from the mesh in um."""
    in_um = {name: value for name, value in scan.deviation.figures.as_um().items() if name != "count"}
    return {"profiles": len(scan.recording), "points": len(scan.cloud), **in_um}


def calibration_figures(report: CalibrationReport) -> dict[str, Any]:
    """Errors of the deviations that were found, and the half widths of their intervals, by name and unit."""
    figures: dict[str, Any] = {"calibration.rms_um": 1e6 * report.result.rms}
    for row in report.rows:
        figures[f"calibration.{row.name}_error_{row.unit}"] = row.error
        figures[f"calibration.{row.name}_half_width_{row.unit}"] = row.half_width
    return figures


def open_trials(spec: Mapping[str, Any]) -> TrialWorker:
    """A worker from plain data, see `Study.spec`."""
    sweep_temporary()
    study = validate(StudyDescription, spec["study"], "study")
    return TrialWorker(study, Setup(**checked_sections(spec["setup"])), Path(spec["part"]))


def _sphere_figures(description: FittedSphereDescription, cloud: Cloud) -> dict[str, Any]:
    """Displacement of the centre, error of the diameter, form and rms in um of the points near a nominal sphere."""
    si = to_si(description.model_dump(exclude={"name"}))
    lowest = -np.inf if si["above"] is None else si["above"]
    centre, points = np.array(si["centre"]), cloud.points_in_part
    near = np.abs(np.linalg.norm(points - centre, axis=1) - si["radius"]) <= si["reach"]
    chosen = points[near & (points[:, 2] >= lowest)]
    values = np.full(len(_SPHERE_FIGURES), np.nan)
    if len(chosen) >= _LEAST_POINTS:
        with suppress(FitError):
            found = fit_sphere(chosen)
            form = np.ptp(np.quantile(found.residuals, _FORM_QUANTILES))
            values = 1e6 * np.array([*(found.centre - centre), 2 * (found.radius - si["radius"]), form, found.rms])
    named = dict(zip(_SPHERE_FIGURES, values.tolist(), strict=True))
    plain = {"points": len(chosen), **{key: None if np.isnan(value) else value for key, value in named.items()}}
    return {f"{description.name}.{key}": value for key, value in plain.items()}


def _process() -> dict[str, Any]:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    memory_mb = pages * os.sysconf("SC_PAGE_SIZE") / 1e6
    return {
        "host": socket.gethostname(),
        "worker": os.getpid(),
        "memory_mb": memory_mb,
        "scancell": build_version(),
    }
