"""Cloud of a run, and how the uncertainty of a calibration displaces its points, all by the same errors."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scancell.arrays import Array
from scancell.config.loading import Setup, load_resolved
from scancell.errors import DescriptionError
from scancell.geometry.mesh import Mesh
from scancell.reconstruction.cloud import Cloud
from scancell.reconstruction.cloud_files.read import CloudFile
from scancell.recorded.reconstruct import (
    ReconstructedData,
    ValueCovariance,
    derivatives_of,
    read_calibration,
    reconstruct_measurements,
)
from scancell.recorded.runs import read_run

_LEAST = 1e-12  # of the largest variance of scaled values, below which a direction has none


@dataclass(frozen=True, eq=False)
class CalibratedRun:
    """Cloud of a run, reconstructed again, with the uncertainty of the calibration.

    Attributes
    ----------
    data
        The cloud with its inputs.
    setup
        Descriptions of the run.
    uncertainty
        Covariances of calibrated values; those of different calibrations are independent.
    """

    data: ReconstructedData
    setup: Setup
    uncertainty: tuple[ValueCovariance, ...]

    @property
    def cloud(self) -> Cloud:
        """The cloud."""
        return self.data.made.cloud

    @property
    def source(self) -> CloudFile:
        """Points of the cloud, and what is doubtful about them."""
        points = self.cloud.points_in_part
        return CloudFile(points, "run folder", len(self.data.made.rows), warnings=self.data.warnings)

    def displacements(self, rows: NDArray[np.intp]) -> Array:
        """Displacements (k, r, 3) of some points of the cloud, m, by the independent errors of the calibration.

        Each is that of one standard deviation along an eigenvector of the correlation of the calibrated values; the
        points share its sign and size.
        """
        data, made = self.data, self.data.made
        profiles = data.found.profiles[np.asarray(made.rows)[rows]]
        found: list[Array] = []
        for one in self.uncertainty:
            by_value = np.zeros((len(one.names), len(rows), 3))
            for number in np.unique(profiles.sensor).tolist():
                if one.of_sensor and number != 1:  # the keys are those of the main sensor
                    continue
                own = np.flatnonzero(profiles.sensor == number)
                of_sensor = (profiles[own], self.setup, data.measured_cell, data.readings, made, number)
                by_value[:, own] = np.stack([*derivatives_of(one, *of_sensor)(slice(0, len(own)))])
            found += [np.tensordot(column, by_value, 1) for column in _root(one.covariance).T]
        return np.array(found).reshape(-1, len(rows), 3)


def calibrated_run(folder: Path, calibration: Path, part: Mesh, threads: int = 0) -> CalibratedRun:
    """Cloud of a run folder in the frame of `part`, with the uncertainty that a calibration states.

    Raises `DescriptionError` naming the file and what was expected, where the folder holds no measurements or the
    calibration no covariance.

    Parameters
    ----------
    calibration
        Folder of results of a calibration of the cell or the sensor, or its ``calibration.json``.
    """
    resolved = folder / "resolved.toml"
    if not resolved.is_file():
        raise DescriptionError(
            "an uncertainty by a calibration needs the measured joints", file=folder, expected="a run folder"
        )
    found = read_calibration(calibration)
    if not found.uncertainty:
        raise DescriptionError(
            "states no covariance of deviations or sensor parameters",
            file=calibration,
            key="covariance_si",
            expected="results of `scancell calibrate` with at least one deviation",
        )
    setup, made = load_resolved(resolved)
    is_simulated = "measured" not in made
    measured = read_run(folder, setup, is_simulated)
    latency = None if is_simulated else 1e-3 * float(made["latency_ms"])
    keep_all = bool(made.get("keep_all", False))
    data = reconstruct_measurements(measured, setup, part, latency, keep_all, threads)
    return CalibratedRun(data, setup, found.uncertainty)


def _root(covariance: Array) -> Array:
    """(k, j) columns whose outer products add up to a covariance (k, k), by the eigenvectors of its correlation."""
    scale = np.sqrt(np.diag(covariance))
    safe = np.where(scale > 0, scale, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(safe, safe))
    used = values > _LEAST * max(float(values.max()), 0.0)
    return np.asarray(scale[:, None] * vectors[:, used] * np.sqrt(values[used]))
