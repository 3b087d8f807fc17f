"""One scan with drawn values, by a worker that keeps the data that many scans have in common."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from scancell.calibration.cell.report import CalibrationReport
from scancell.calibration.cell.request import CalibrationRequest
from scancell.config.choices import Engine
from scancell.config.estimated import EstimatedDescription
from scancell.config.loading import Setup
from scancell.config.study import CalibrateDescription
from scancell.config.variation import VaryingScansDescription
from scancell.geometry.mesh import Mesh
from scancell.nominal.cell import NominalCell
from scancell.results import ScanResult
from scancell.scanner import Scanner
from scancell.scanning.drive import FOLDER_PREFIX
from scancell.scanning.sense import OnImages
from scancell.studies.distributions import Value
from scancell.studies.factors import Factors, Units
from scancell.studies.task_store import is_running


@dataclass(frozen=True)
class Trial:
    """A numbered scan: the seed of its random numbers, its engine, and the drawn value of each factor."""

    number: int
    seed: int
    engine: Engine
    values: tuple[Value, ...]


class ScanWorker:
    """Scans one part in this process; `source` names the file of the variation in messages."""

    def __init__(self, scans: VaryingScansDescription, setup: Setup, part: Mesh, source: str) -> None:
        self._part = part
        self._factors = Factors(scans, setup, source)
        self._scanner = Scanner(setup=setup, threads=1)

    def calibrated(self, trial: Trial, calibrate: CalibrateDescription) -> CalibrationReport:
        """Calibrate the cell of the trial.

        Raises
        ------
        ScancellError
            If any of it cannot be done.
        """
        inputs = self._factors.inputs(trial.values)
        return self._scanner.calibrate(
            CalibrationRequest.of(calibrate),
            calibrate.artefact,
            engine=trial.engine,
            as_built=inputs.as_built,
            seed=trial.seed,
            setup=inputs.setup,
        )

    def scan(
        self,
        trial: Trial,
        on_images: OnImages | None = None,
        normals: bool = False,
        estimated: EstimatedDescription | None = None,
    ) -> ScanResult:
        """Scan with the values of the trial; `estimated` are deviations that reconstruction assumes.

        Raises
        ------
        ScancellError
            If any of it cannot be done.
        """
        inputs = self._factors.inputs(trial.values)
        return self._scanner.scan(
            self._part,
            engine=trial.engine,
            as_built=inputs.as_built,
            seed=trial.seed,
            setup=inputs.setup,
            estimated=estimated,
            normals=normals,
            samples=False,
            on_images=on_images,
        )

    @property
    def setup(self) -> Setup:
        """The nominal descriptions around which factors vary."""
        return self._scanner.setup

    @cached_property
    def nominal(self) -> NominalCell:
        """The cell of these descriptions."""
        return self._scanner.pipeline.load(self.setup, self._part).nominal

    def units(self) -> Units:
        """Units of the deviations of the FMU."""
        pipeline = self._scanner.pipeline
        return pipeline.runner.units(pipeline.load(self.setup, self._part))

    def close(self) -> None:
        """Free the FMU and the files of this worker."""
        self._scanner.close()


def trial_of(plain: Mapping[str, Any]) -> Trial:
    """A trial from plain data."""
    return Trial(plain["number"], plain["seed"], plain["engine"], tuple(plain["values"]))


def sweep_temporary() -> None:
    """Remove the temporary files of workers of this machine that were killed."""
    for folder in Path(tempfile.gettempdir()).glob(f"{FOLDER_PREFIX}*"):
        pid = folder.name.removeprefix(FOLDER_PREFIX).split("-")[0]
        if pid.isdigit() and not is_running(int(pid)):
            shutil.rmtree(folder, ignore_errors=True)
