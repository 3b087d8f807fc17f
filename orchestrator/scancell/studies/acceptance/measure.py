"""Programme of an acceptance test, the scans of its stations, and the figures of each."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from scancell.arrays import Array
from scancell.config.artefact import ArtefactDescription
from scancell.config.choices import Engine, ScanMode
from scancell.config.description import validate
from scancell.config.files import assets_dir, plain_data
from scancell.config.loading import Setup
from scancell.errors import EmptyScanError, FitError, PlanningError
from scancell.evaluation.artefact import GUARD, ArtefactEvaluation, evaluate_against_artefact
from scancell.evaluation.plane_trial import Linearity, PlaneTarget, linearity, measure_plane
from scancell.geometry.mesh import Mesh, sample_surface
from scancell.geometry.shapes import ShapeGroup
from scancell.nominal.parts import shape_group
from scancell.progress import Progress
from scancell.results import ScanResult
from scancell.scanner import Scanner
from scancell.studies.factors import Inputs, Value, trial_seed

ALL_ROUND = "all round"
REPEATABILITY = "repeatability"  # in budgets: what no factor explains
MODES: tuple[ScanMode, ...] = get_args(ScanMode)

_TURNED = ("sphere", "ball_bar", "cylinder")  # artefacts that are also scanned from all sides
_ALL_ROUND_PROFILES = 4  # times those of passes alone
_RANGE_MARGIN = 0.05  # of the measuring range, left free at both ends
_FULL_SIZE = 60.0  # mm: with a shorter measuring range artefacts are made smaller in proportion
_SEEN = 0.4  # cosine of the incidence up to which a surface counts for the depth of an artefact
_COARSE = 100e-6  # m
_SAMPLES = 4000

_DETERMINED = 0.01  # of the nominal size: largest standard uncertainty of a fit that counts as determined
_OUTLIER = 5.0  # robust standard deviations from the fitted element
_TO_SIGMA = 1.4826  # median absolute deviation of a normal distribution
RATES = ("outlier rate", "missing-point rate")
_UNIT = {"m": ("um", 1e6), "rad": ("deg", 180 / np.pi)}
_WHOLE = "all"

_SWEEP_RANGE_MARGIN = 0.02  # of the measuring range, left free at both ends
_STEEPEST = np.radians(60.0)
_REFLECTANCES = (0.02, 0.95)
_SLOPE = np.radians(30.0)  # of the moving target: motion along a level one changes nothing
_FASTEST = 4.0  # times the speed of the passes


def unit_text(row: Mapping[str, Any]) -> str:
    """Unit of a row of figures as texts show it."""
    return "µm" if row["unit"] == "um" else str(row["unit"])


@dataclass(frozen=True)
class Programme:
    """Size of the test.

    Attributes
    ----------
    artefacts
        Names of shipped artefacts.
    positions
        Names of the positions of an artefact from the near to the far end of the measuring range.
    repeats
        Scans of each artefact at each position in each mode, with noise of their own.
    profiles
        Most profiles of a scan.
    points
        Points of a scan that are evaluated, evenly chosen.
    exposures, steps
        Of the sweeps over range, angles, reflectance and speed: exposures of a target, targets of a sweep.
    """

    artefacts: tuple[str, ...] = ("sphere", "ball_bar", "plane", "step", "cylinder", "cone")
    positions: tuple[str, ...] = ("near", "middle", "far")
    repeats: int = 20
    profiles: int = 200
    points: int = 20_000
    exposures: int = 10
    steps: int = 13


QUICK = Programme(positions=("near", "far"), repeats=2, profiles=60, points=5000, exposures=3, steps=5)


@dataclass(frozen=True)
class Station:
    """An artefact at a position of the measuring range, scanned in a mode.

    `standoff` is the distance along sensor Z to the top of the artefact, m.
    """

    artefact: str
    position: str
    standoff: float
    mode: ScanMode

    def setup(self, setup: Setup, profiles: int) -> Setup:
        """The descriptions with the views of this station: passes over the top, and for `ALL_ROUND` sweeps, too.

        `profiles` is the largest number of those of passes alone.
        """
        changes = {
            "mode": self.mode,
            "max_profiles": profiles * (_ALL_ROUND_PROFILES if self.position == ALL_ROUND else 1),
            "sweep.enabled": self.position == ALL_ROUND,
            "sweep.standoff_mm": 1e3 * self.standoff,
            "raster.enabled": True,
            "coverage.enabled": False,
            "pose": (),
            "path": (),
        }
        return Setup(setup.cell, setup.sensor, setup.scan.replace(changes))


def artefact_scale(setup: Setup) -> float:
    """Size of the artefacts in proportion to the shipped ones: those of short measuring ranges are smaller."""
    return min(1.0, (setup.sensor.range.far_mm - setup.sensor.range.near_mm) / _FULL_SIZE)


def scaled_artefact(name: str, scale: float) -> ShapeGroup:
    """A shipped artefact with all lengths multiplied by `scale`."""
    shipped = ArtefactDescription.from_toml(assets_dir() / "artefacts" / f"{name}.toml")
    if scale == 1.0:
        return shape_group(shipped)
    data = _scaled(plain_data(shipped), scale)
    return shape_group(validate(ArtefactDescription, data, f"{name}, {scale:.3g} times its size"))


def _scaled(data: Any, scale: float, is_length: bool = False) -> Any:
    if isinstance(data, dict):
        return {key: _scaled(value, scale, key.endswith("_mm")) for key, value in data.items()}
    if isinstance(data, list):
        return [_scaled(value, scale, is_length) for value in data]
    return data * scale if is_length else data


def stations(name: str, artefact: ShapeGroup, setup: Setup, programme: Programme) -> Iterator[Station]:
    """Positions of an artefact over the measuring range, and from all sides in the middle, each in both modes.

    The whole visible surface of the artefact stays inside the range; where it is too deep for that, the positions are
    the one in the middle.
    """
    near, far = 1e-3 * setup.sensor.range.near_mm, 1e-3 * setup.sensor.range.far_mm
    margin, depth = _RANGE_MARGIN * (far - near), _depth(artefact)
    first, last = near + margin, far - margin - depth
    middle = max(first, (near + far - depth) / 2)
    count = len(programme.positions)
    standoffs = np.linspace(first, last, count).tolist() if count > 1 else [middle]
    places = dict(zip(programme.positions, standoffs, strict=True)) if first < last else {"middle": middle}
    if name in _TURNED:
        places[ALL_ROUND] = middle
    for position, standoff in places.items():
        for mode in MODES:
            yield Station(name, position, standoff, mode)


def _depth(artefact: ShapeGroup) -> float:
    """Height, m, from the lowest visible measured surface to the top of the artefact, seen from above."""
    mesh = artefact.mesh(_COARSE)
    points, faces = sample_surface(mesh, _SAMPLES, 0)
    signed, _, number = artefact.nearest(points)
    measured = np.array([one.role == "measured" for one in artefact.shapes])
    seen = (mesh.normals[faces, 2] > _SEEN) & (signed > -2 * _COARSE) & measured[number]
    return float(mesh.bounds[1, 2] - points[seen, 2].min())


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
    """Results of all stations.

    Attributes
    ----------
    pictured
        An evaluation of each artefact, for a picture.
    failures
        Number of failed repeats by station and reason.
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
            If the cell or a factor is wrong. A scan that cannot be planned or gives no points is a failure of its
            station.
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
                points = scan.cloud.points_in_part
                chosen = np.linspace(0, len(points) - 1, min(len(points), self.programme.points)).astype(int)
                evaluation = evaluate_against_artefact(points[chosen], group, guard=GUARD * self.scale)
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
            missing = max(0.0, 1.0 - len(scan.cloud) / max(ideal, 1))
            undetermined = _undetermined(evaluation)
            for reason in undetermined.values():
                what = f"{station.artefact}, {station.position}, {station.mode}: {reason}"
                found.failures[what] = found.failures.get(what, 0) + 1
            for of, name, unit, nominal, value, uncertainty in _errors(evaluation, missing):
                if not undetermined.keys().isdisjoint([of, *of.split(" - ")]):
                    continue
                own = samples.setdefault((of, name), Samples(station, of, name, unit, nominal))
                own.errors.append(value)
                own.trials.append(number)
                own.fit_uncertainty.append(uncertainty)
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


def _quiet(inputs: Inputs) -> Inputs:
    setup = inputs.setup
    return Inputs(Setup(setup.cell, setup.sensor.replace({"render.noise": False}), setup.scan), inputs.as_built)


def _errors(evaluation: ArtefactEvaluation, missing: float) -> Iterator[tuple[str, str, str, float, float, float]]:
    """Face, name, unit, nominal value, error and uncertainty of the fit, of each characteristic and of the rates."""
    for one in evaluation.characteristics:
        unit, scale = _UNIT[one.unit]
        yield one.of, one.name, unit, one.nominal, scale * one.error, scale * one.uncertainty
    residuals = [one.fit.residuals for one in evaluation.faces]
    far = sum(int(_is_outlier(one).sum()) for one in residuals)
    beyond = evaluation.outlier_rate * len(evaluation.face)
    outliers = (far + beyond) / (sum(map(len, residuals)) + beyond)
    for name, rate in zip(RATES, (outliers, missing), strict=True):
        yield _WHOLE, name, "%", 0.0, 100 * rate, float("nan")


def _undetermined(evaluation: ArtefactEvaluation) -> dict[str, str]:
    """Faces and pairs of faces whose fitted elements the points do not determine, with the reason."""
    return {
        one.of: f"{one.of}: the points do not determine the {one.name}"
        for one in evaluation.characteristics
        if one.nominal > 0 and one.uncertainty > _DETERMINED * one.nominal
    }


def _is_outlier(residuals: Array) -> NDArray[np.bool_]:
    from_median = np.abs(residuals - np.median(residuals))
    # Exact scans have no spread beyond rounding.
    return np.asarray(from_median > max(_OUTLIER * _TO_SIGMA * float(np.median(from_median)), 1e-9))


@dataclass(frozen=True)
class Sweep:
    """Figures of a matt plane while one quantity changes; `values` in `unit`, and a row of figures for each."""

    name: str
    unit: str
    values: tuple[float, ...]
    rows: tuple[dict[str, Any], ...]

    def as_json(self) -> dict[str, Any]:
        """Plain data."""
        return {
            "name": self.name,
            "unit": self.unit,
            "rows": [{"value": value, **row} for value, row in zip(self.values, self.rows, strict=True)],
        }


@dataclass(frozen=True)
class SensorSweeps:
    """All sweeps, and the linearity over the range."""

    sweeps: tuple[Sweep, ...]
    linearity: Linearity


def sensor_sweeps(
    setup: Setup,
    as_built: Sequence[str],
    programme: Programme,
    engine: Engine,
    seed: int,
    threads: int,
    progress: Progress,
) -> SensorSweeps:
    """Expose a matt plane at rest, or moving, in front of the sensor alone.

    Raises
    ------
    ScancellError
        If the sensor is wrong.
    """
    listed = _targets(setup, programme.steps)
    progress.stage("sensor", sum(len(values) for _, _, values, _ in listed), "targets")
    found, over_range = [], Linearity(float("nan"), float("nan"))
    for name, unit, values, target in listed:
        readings = []
        for value in values:
            progress.advance(1)
            at, exposures = target(value), programme.exposures
            readings.append(
                measure_plane(setup.sensor, at, exposures, engine, as_built=as_built, seed=seed, threads=threads)
            )
        rows = tuple(one.figures().as_row() for one in readings)
        found.append(Sweep(name, unit, tuple(values), rows))
        seen = [one for one in readings if len(one.signed)]
        if name == "range" and len(seen) > 2:
            over_range = linearity(seen)
    return SensorSweeps(tuple(found), over_range)


def _targets(setup: Setup, steps: int) -> list[tuple[str, str, list[float], Callable[[float], PlaneTarget]]]:
    """Name, unit, values and target of each sweep."""
    near, far = setup.sensor.range.near_mm, setup.sensor.range.far_mm
    free, middle = _SWEEP_RANGE_MARGIN * (far - near), 0.5e-3 * (near + far)
    steepest = float(np.degrees(_STEEPEST))
    angles = np.linspace(-steepest, steepest, steps).tolist()
    fastest = _FASTEST * setup.scan.raster.speed_mm_s
    return [
        ("range", "mm", np.linspace(near + free, far - free, steps).tolist(), lambda z: PlaneTarget(1e-3 * z)),
        ("in-plane angle", "deg", angles, lambda angle: PlaneTarget(middle, in_plane=np.radians(angle))),
        ("out-of-plane angle", "deg", angles, lambda angle: PlaneTarget(middle, out_of_plane=np.radians(angle))),
        (
            "reflectance",
            "1",
            np.geomspace(*_REFLECTANCES, steps).tolist(),
            lambda share: PlaneTarget(middle, reflectance=share),
        ),
        (
            "speed",
            "mm/s",
            np.linspace(0.0, fastest, steps).tolist(),
            lambda speed: PlaneTarget(middle, out_of_plane=_SLOPE, speed=1e-3 * speed),
        ),
    ]
