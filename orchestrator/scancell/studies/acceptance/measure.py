"""Scans of the stations of an acceptance test, and the figures of each."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from scancell.config.choices import Engine
from scancell.config.loading import Setup
from scancell.errors import EmptyScanError, FitError, PlanningError
from scancell.evaluation.artefact import GUARD, ArtefactEvaluation, evaluate_against_artefact
from scancell.geometry.mesh import Mesh
from scancell.geometry.shapes import ShapeGroup
from scancell.progress import Progress
from scancell.results import ScanResult
from scancell.scanner import Scanner
from scancell.studies.acceptance.programme import Programme, Station, stations
from scancell.studies.designs import trial_seed
from scancell.studies.factors import Inputs
from scancell.studies.population import Value

Array = NDArray[np.float64]

_OUTLIER = 5.0  # robust standard deviations from the fitted element
_TO_SIGMA = 1.4826  # median absolute deviation of a normal distribution
_UNIT = {"m": ("um", 1e6), "rad": ("deg", 180 / np.pi)}
_WHOLE = "all"


@dataclass(frozen=True)
class Trial:
    """One repeat: its seed, the drawn values of the factors, and the inputs that follow from them."""

    seed: int
    values: tuple[Value, ...]
    inputs: Callable[[Setup], Inputs]


@dataclass
class Samples:
    """Errors (measured minus nominal) of a characteristic at a station, in `unit`, one per repeat that gave it.

    `trials` are the numbers of these repeats, `fit_uncertainty` the standard uncertainties by the covariance of the
    fits.
    """

    station: Station
    of: str
    name: str
    unit: str
    nominal: float
    errors: list[float] = field(default_factory=list)
    trials: list[int] = field(default_factory=list)
    fit_uncertainty: list[float] = field(default_factory=list)


@dataclass
class Measurement:
    """What all stations gave.

    Attributes
    ----------
    pictured
        An evaluation of each artefact, for a picture.
    failures
        What could not be measured and why, each once.
    points
        Points of a scan by station, mean over the repeats.
    """

    samples: list[Samples] = field(default_factory=list)
    pictured: dict[str, ArtefactEvaluation] = field(default_factory=dict)
    failures: dict[str, int] = field(default_factory=dict)
    points: dict[Station, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Measuring:
    """Runs a programme with one scanner."""

    scanner: Scanner
    programme: Programme
    engine: Engine
    trials: Sequence[Trial]
    scale: float

    def run(self, artefacts: Mapping[str, ShapeGroup], progress: Progress) -> Measurement:
        """Scan and evaluate all stations.

        Raises
        ------
        ScancellError
            If the cell or a factor is wrong; what cannot be planned or gives no points is a failure of a station.
        """
        found = Measurement()
        work = [
            (group, station)
            for name, group in artefacts.items()
            for station in stations(name, group, self.scanner.setup, self.programme)
        ]
        progress.stage("measuring", len(work) * len(self.trials), "scans")
        for number, (group, station) in enumerate(work):
            own = [replace(trial, seed=trial_seed(trial.seed, number)) for trial in self.trials]
            self._measure(group, station, own, found, progress)
        return found

    def _measure(
        self, group: ShapeGroup, station: Station, trials: Sequence[Trial], found: Measurement, progress: Progress
    ) -> None:
        mesh, counts = group.mesh(), []
        samples: dict[tuple[str, str], Samples] = {}
        ideal = self._points_without_noise(mesh, station, trials[0])
        for number, trial in enumerate(trials):
            progress.advance(1)
            try:
                scan = self._scan(mesh, station, trial)
                evaluation = self._evaluated(scan, group)
            except (PlanningError, EmptyScanError, FitError) as error:
                what = f"{station.artefact}, {station.position}, {station.mode}: {error}"
                # Without drawn factors all repeats have the same plan.
                hopeless = isinstance(error, PlanningError) and not trial.values
                lost = len(trials) - number if hopeless else 1
                found.failures[what] = found.failures.get(what, 0) + lost
                if hopeless:
                    progress.advance(lost - 1)
                    break
                continue
            counts.append(len(scan.cloud))
            if station.artefact not in found.pictured:
                found.pictured[station.artefact] = evaluation
            _collect(samples, station, evaluation, number)
            _collect_rates(samples, station, evaluation, 1.0 - len(scan.cloud) / max(ideal, 1), number)
        if counts:
            found.points[station] = float(np.mean(counts))
        found.samples += samples.values()

    def _scan(self, mesh: Mesh, station: Station, trial: Trial) -> ScanResult:
        inputs = trial.inputs(station.setup(self.scanner.setup, self.programme.profiles))
        return self.scanner.scan(
            mesh,
            engine=self.engine,
            as_built=inputs.as_built,
            seed=trial.seed,
            setup=inputs.setup,
            normals=False,
            samples=False,
        )

    def _points_without_noise(self, mesh: Mesh, station: Station, trial: Trial) -> int:
        """Number of points of the same scan by the sensor without noise; 0 where it gives none."""
        quiet = replace(trial, inputs=lambda setup: _quiet(trial.inputs(setup)))
        try:
            return len(self._scan(mesh, station, quiet).cloud)
        except (PlanningError, EmptyScanError):
            return 0

    def _evaluated(self, scan: ScanResult, group: ShapeGroup) -> ArtefactEvaluation:
        points = scan.cloud.points_in_part
        chosen = np.linspace(0, len(points) - 1, min(len(points), self.programme.points)).astype(int)
        return evaluate_against_artefact(points[chosen], group, guard=GUARD * self.scale)


def _quiet(inputs: Inputs) -> Inputs:
    setup = inputs.setup
    return Inputs(Setup(setup.cell, setup.sensor.replace({"render.noise": False}), setup.scan), inputs.as_built)


def _collect(
    samples: dict[tuple[str, str], Samples], station: Station, evaluation: ArtefactEvaluation, trial: int
) -> None:
    for one in evaluation.characteristics:
        unit, scale = _UNIT[one.unit]
        own = samples.setdefault((one.of, one.name), Samples(station, one.of, one.name, unit, one.nominal))
        own.errors.append(scale * one.error)
        own.trials.append(trial)
        own.fit_uncertainty.append(scale * one.uncertainty)


def _collect_rates(
    samples: dict[tuple[str, str], Samples],
    station: Station,
    evaluation: ArtefactEvaluation,
    missing: float,
    trial: int,
) -> None:
    residuals = [one.fit.residuals for one in evaluation.faces]
    far = sum(int(_is_outlier(one).sum()) for one in residuals)
    beyond = evaluation.outlier_rate * len(evaluation.face)
    rates = {
        "outlier rate": (far + beyond) / (sum(map(len, residuals)) + beyond),
        "missing-point rate": max(0.0, missing),
    }
    for name, rate in rates.items():
        own = samples.setdefault((_WHOLE, name), Samples(station, _WHOLE, name, "%", 0.0))
        own.errors.append(100 * rate)
        own.trials.append(trial)
        own.fit_uncertainty.append(float("nan"))


def _is_outlier(residuals: Array) -> NDArray[np.bool_]:
    from_median = np.abs(residuals - np.median(residuals))
    # Exact scans have no spread beyond rounding.
    return np.asarray(from_median > max(_OUTLIER * _TO_SIGMA * float(np.median(from_median)), 1e-9))
