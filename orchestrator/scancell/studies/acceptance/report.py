"""An acceptance test: run it, and write ``acceptance.json``, ``acceptance.csv`` and ``acceptance.html``."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell.config.choices import Engine
from scancell.config.loading import Setup
from scancell.config.study import StudyDescription, load_study
from scancell.errors import FitError
from scancell.evaluation.artefact import ArtefactEvaluation
from scancell.output.manifest import command_words, manifest, versions
from scancell.output.run_files import write_json
from scancell.output.run_folder import RunFolder
from scancell.output.tables import columns_of, write_csv
from scancell.progress import Progress
from scancell.scanner import Scanner
from scancell.studies.acceptance.measure import Measurement, Measuring, Trial
from scancell.studies.acceptance.programme import Programme, artefact_scale, scaled_artefact
from scancell.studies.acceptance.statistics import PROBABILITY, contributions, figure_rows, largest_rows
from scancell.studies.acceptance.sweeps import SensorSweeps, sensor_sweeps
from scancell.studies.designs import trial_seed
from scancell.studies.factors import Factors, Inputs
from scancell.studies.population import population_of
from scancell.values import Result

Array = NDArray[np.float64]

WHAT = (
    "figures in the style of VDI/VDE 2634-2 and -3 and ISO 10360-8 and -13; least-squares elements; uncertainty after"
    " JCGM 101 over the repeats"
)
_CSV_INTERVALS = ("interval_symmetric", "interval_shortest")


@dataclass(frozen=True)
class AcceptanceRequest:
    """What to test, and how.

    Attributes
    ----------
    as_built
        Deviations of the true cell and sensor as ``key=value`` words.
    factors
        Study description (TOML) whose factors are drawn for each repeat; nothing else of it is used.
    """

    programme: Programme = field(default_factory=Programme)
    engine: Engine = "geometric"
    as_built: tuple[str, ...] = ()
    seed: int = 0
    factors: Path | None = None


@dataclass(frozen=True, eq=False, repr=False)
class AcceptanceReport(Result):
    """Results of an acceptance test.

    Attributes
    ----------
    setup, request
        Descriptions, and what was asked for.
    rows
        Statistics of each characteristic at each position, in each mode (see `statistics.figure_rows`).
    budgets
        Contributions to the variance of each characteristic.
    sweeps
        Noise and linearity of the sensor over its range.
    failures
        What could not be measured, with the number of repeats.
    pictured
        An evaluation of each artefact.
    points, scale
        Mean number of points of a scan; size of the artefacts in proportion to the shipped ones.
    labels
        Names of the factors that were drawn.

    Examples
    --------
    See the example of `acceptance`.
    """

    setup: Setup
    request: AcceptanceRequest
    rows: list[dict[str, Any]]
    budgets: list[dict[str, Any]]
    sweeps: SensorSweeps
    failures: Mapping[str, int]
    pictured: Mapping[str, ArtefactEvaluation]
    points: float
    scale: float
    labels: tuple[str, ...] = ()

    @property
    def largest(self) -> list[dict[str, Any]]:
        """For each characteristic and mode the row with the largest mean error."""
        return largest_rows(self.rows)

    @property
    def warnings(self) -> list[str]:
        """What could not be measured."""
        scans = self.request.programme.repeats
        return [f"{what} ({count} of {scans} repeats)" for what, count in self.failures.items()]

    @property
    def figures(self) -> dict[str, Any]:
        """Plain data for ``acceptance.json``."""
        sensor = self.setup.sensor
        span = 1e-3 * (sensor.range.far_mm - sensor.range.near_mm)
        off = self.sweeps.linearity
        return {
            "what": WHAT,
            "sensor": sensor.name,
            "cell": self.setup.cell.name,
            "engine": self.request.engine,
            "seed": self.request.seed,
            "as_built": list(self.request.as_built),
            "factors": list(self.labels),
            "range_mm": [sensor.range.near_mm, sensor.range.far_mm],
            "artefact_scale": self.scale,
            "programme": asdict(self.request.programme),
            "probability": PROBABILITY,
            "points_of_a_scan": self.points,
            "figures": self.rows,
            "largest": self.largest,
            "contributions": self.budgets,
            "sweeps": [one.as_json() for one in self.sweeps.sweeps],
            "linearity_percent": _finite({"of_mean": 100 * off.of_mean / span, "of_field": 100 * off.of_field / span}),
            "not_measured": dict(self.failures),
        }

    def summary(self) -> str:
        """The largest errors over the range, as text."""
        lines = [f"{self.setup.sensor.name} in {self.setup.cell.name}: {len(self.rows)} figures"]
        for row in self.largest:
            if row["name"] in _HEADLINES:
                spread = row["standard_uncertainty"]
                plus = "" if spread is None else f" +- {spread:.3g}"
                where = f"{row['of']}, {row['position']}, {row['mode']}"
                lines.append(
                    f"  {row['artefact']:9} {row['name']:18} {row['mean']:9.3g}{plus} {row['unit']:3} ({where})"
                )
        return "\n".join(lines)

    def save(self, folder: str | Path, command_line: Sequence[str] | None = None) -> list[Path]:
        """Write the report, whole or not at all; the page needs the extra ``studies``.

        `command_line`: words that the manifest keeps; by default those of this process.

        Raises
        ------
        OutputError
            If the folder cannot be written.
        MissingExtraError
            If matplotlib or jinja2 is not installed.
        """
        from scancell.studies.acceptance.page import acceptance_page  # noqa: PLC0415  (needs the extra "studies")

        inputs = [] if self.request.factors is None else [self.request.factors]
        words = command_words(command_line)
        figures = self.figures
        with RunFolder(Path(folder)) as run:
            write_json(run.path("acceptance.json"), {**figures, "versions": versions()})
            write_csv(run.path("acceptance.csv"), columns_of([_csv_row(row) for row in self.rows]))
            run.path("acceptance.html").write_text(acceptance_page(figures, self.pictures(), self.warnings))
            write_json(run.path("manifest.json"), manifest(self.setup, inputs, {"command_line": words}))
        return run.paths

    def pictures(self) -> dict[str, bytes]:
        """Picture (PNG) of the deviation of each artefact, by its name."""
        return {name: evaluation.picture() for name, evaluation in self.pictured.items()}


_HEADLINES = (
    *("probing form", "probing size", "sphere spacing", "flatness", "step height", "form", "diameter", "cone angle"),
    *("outlier rate", "missing-point rate"),
)


def run_acceptance(scanner: Scanner, request: AcceptanceRequest, progress: Progress) -> AcceptanceReport:
    """Scan the artefacts of the programme in the scanner's cell, and sweep the sensor.

    Raises
    ------
    ScancellError
        Naming what is wrong and what was expected; `FitError` if nothing could be measured at all.
    """
    setup, programme = scanner.setup, request.programme
    trials, labels, correlation = _trials(setup, request, programme.repeats)
    scale = artefact_scale(setup)
    artefacts = {name: scaled_artefact(name, scale) for name in programme.artefacts}
    sweeps = sensor_sweeps(
        setup, request.as_built, programme, request.engine, request.seed, scanner.pipeline.threads, progress
    )
    found = Measuring(scanner, programme, request.engine, trials, scale).run(artefacts, progress)
    if not found.samples:
        raise FitError(f"nothing could be measured: {next(iter(found.failures), 'no station')}")
    return AcceptanceReport(
        setup=setup,
        request=request,
        rows=figure_rows(found.samples),
        budgets=contributions(found.samples, trials, labels, request.seed, correlation),
        sweeps=sweeps,
        failures=found.failures,
        pictured=found.pictured,
        points=_mean_points(found),
        scale=scale,
        labels=tuple(labels),
    )


def _trials(setup: Setup, request: AcceptanceRequest, count: int) -> tuple[list[Trial], list[str], Array | None]:
    """Repeats with seeds of their own and, where the request names a study, its factors drawn for each.

    Also the labels of these factors, and their correlation.
    """
    seeds = [trial_seed(request.seed, k) for k in range(count)]
    if request.factors is None:
        return [Trial(seed, (), lambda own: Inputs(own, request.as_built)) for seed in seeds], [], None
    study = _varying(load_study(request.factors), request, count)
    source = str(request.factors)
    values = Factors(study, setup, source).draw()

    def inputs_of(k: int) -> Trial:
        return Trial(seeds[k], values[k], lambda own: Factors(study, own, source).inputs(values[k]))

    return [inputs_of(k) for k in range(count)], study.labels, population_of(study).correlation


def _varying(study: StudyDescription, request: AcceptanceRequest, count: int) -> StudyDescription:
    """Of a study its factors, drawn once for each repeat."""
    changes = {"design": {"kind": "latin_hypercube", "trials": count}, "as_built": request.as_built}
    return study.replace({**changes, "seed": request.seed})


def _mean_points(found: Measurement) -> float:
    return sum(found.points.values()) / max(len(found.points), 1)


def _csv_row(row: Mapping[str, Any]) -> dict[str, Any]:
    """Without the single errors; intervals as two columns."""
    plain = {name: value for name, value in row.items() if name not in ("errors", *_CSV_INTERVALS)}
    for name in _CSV_INTERVALS:
        low, high = row[name] or (None, None)
        plain |= {f"{name}_low": low, f"{name}_high": high}
    return plain


def _finite(values: Mapping[str, float]) -> dict[str, float | None]:
    return {name: None if math.isnan(value) else value for name, value in values.items()}
