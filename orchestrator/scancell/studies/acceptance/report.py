"""An acceptance test: run it, evaluate the repeats, and write ``acceptance.json``, ``.csv`` and ``.html``."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from scancell.arrays import Array
from scancell.config.choices import Engine
from scancell.config.loading import Setup
from scancell.config.study import load_study
from scancell.errors import DescriptionError, FitError
from scancell.evaluation.artefact import ArtefactEvaluation
from scancell.output.run_folder import RunFolder, SavedResult, manifest, versions, write_json
from scancell.output.tables import columns_of, write_csv
from scancell.progress import Progress
from scancell.scanner import Scanner
from scancell.studies.acceptance.measure import (
    RATES,
    REPEATABILITY,
    Measuring,
    Programme,
    Samples,
    SensorSweeps,
    Trial,
    artefact_scale,
    scaled_artefact,
    sensor_sweeps,
    unit_text,
)
from scancell.studies.analysis import summary
from scancell.studies.budget import Terms, variance_budget
from scancell.studies.factors import Factors, Inputs, population_of, trial_seed

PROBABILITY = 0.95

WHAT = (
    "figures in the style of VDI/VDE 2634-2 and -3 and ISO 10360-8 and -13; least-squares elements; uncertainty after"
    " JCGM 101 over the repeats"
)
_CSV_INTERVALS = ("interval_symmetric", "interval_shortest")


def figure_row(one: Samples) -> dict[str, Any]:
    """Row of a characteristic at a station: statistics of its error over the repeats (JCGM 101)."""
    errors = np.array(one.errors)
    statistics = summary(errors, PROBABILITY)
    fitted = np.array(one.fit_uncertainty)
    known = fitted[np.isfinite(fitted)]
    return {
        "artefact": one.station.artefact,
        "of": one.of,
        "name": one.name,
        "position": one.station.position,
        "standoff_mm": 1e3 * one.station.standoff,
        "mode": one.station.mode,
        "unit": one.unit,
        "repeats": len(errors),
        "mean": statistics["mean"],
        "standard_uncertainty": statistics["standard_deviation"],
        "interval_symmetric": statistics["interval_symmetric"],
        "interval_shortest": statistics["interval_shortest"],
        "minimum": statistics["minimum"],
        "maximum": statistics["maximum"],
        "fit_uncertainty": float(np.sqrt((known**2).mean())) if len(known) else None,
        "errors": errors.tolist(),
    }


def largest_rows(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """The row with the largest mean error, by amount, over positions and faces, for each characteristic and mode."""
    largest: dict[tuple[str, str, str], dict[str, Any]] = {}
    for row in rows:
        key = (row["artefact"], row["name"], row["mode"])
        if key not in largest or abs(row["mean"]) > abs(largest[key]["mean"]):
            largest[key] = row
    return [{name: value for name, value in row.items() if name != "errors"} for row in largest.values()]


def contributions(
    samples: Sequence[Samples],
    trials: Sequence[Trial],
    labels: Sequence[str],
    seed: int,
    correlation: Array | None = None,
) -> list[dict[str, Any]]:
    """Shares of position, mode and drawn factors in the variance of each characteristic; the rest is repeatability.

    A characteristic of an artefact is one population over faces, positions, modes and repeats, without the mean of each
    face. `correlation` (labels, labels) is that of drawn factors that are not independent.
    """
    found = []
    keys = dict.fromkeys((one.station.artefact, one.name) for one in samples)
    for artefact, name in keys:
        own = [one for one in samples if (one.station.artefact, one.name) == (artefact, name)]
        budget = _budget(own, trials, labels, seed, correlation)
        if budget:
            found.append({"artefact": artefact, "name": name, "unit": own[0].unit, **budget})
    return found


def _budget(
    own: Sequence[Samples], trials: Sequence[Trial], labels: Sequence[str], seed: int, correlation: Array | None
) -> dict[str, Any]:
    faces = np.concatenate([np.full(len(one.errors), one.of) for one in own])
    errors = np.concatenate([one.errors for one in own])
    for face in np.unique(faces):
        errors[faces == face] -= errors[faces == face].mean()
    columns: dict[str, list[Any]] = {
        "position": [one.station.position for one in own for _ in one.errors],
        "mode": [one.station.mode for one in own for _ in one.errors],
    }
    for j, label in enumerate(labels):
        columns[label] = [trials[k].values[j] for one in own for k in one.trials]
    between = block_diag(np.eye(2), np.eye(len(labels)) if correlation is None else correlation)
    chosen = [j for j, values in enumerate(columns.values()) if len(set(values)) > 1]
    varying = {name: values for j, (name, values) in enumerate(columns.items()) if j in chosen}
    if not varying:
        return {}
    terms = [Terms.of(values) for values in varying.values()]
    budget = variance_budget(terms, errors, PROBABILITY, seed, correlation=between[np.ix_(chosen, chosen)])
    if not budget:
        return {}
    rows = zip([*varying, REPEATABILITY], [*budget["budget"], budget["residual"]], strict=True)
    shares = [{"factor": name, **row} for name, row in rows]
    return {"regression": budget["regression"], "trials": len(errors), "budget": shares}


@dataclass(frozen=True)
class AcceptanceRequest:
    """Programme and inputs of the test.

    Attributes
    ----------
    as_built
        Deviations of the true cell and sensor as ``key=value`` words.
    factors
        Study description (TOML) whose factors are drawn for each repeat; nothing else of it is used.
    limits
        Largest permitted error by name of a figure, in its unit.
    """

    programme: Programme = field(default_factory=Programme)
    engine: Engine = "geometric"
    as_built: tuple[str, ...] = ()
    seed: int = 0
    factors: Path | None = None
    limits: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False, repr=False)
class AcceptanceReport(SavedResult):
    """Results of an acceptance test.

    Attributes
    ----------
    setup, request
        Descriptions, and the request.
    rows
        Statistics of each characteristic at each position, in each mode (see `figure_row`).
    budgets
        Contributions to the variance of each characteristic.
    sweeps
        Noise and linearity of the sensor over its range.
    failures
        Number of failed repeats by station and reason.
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
    def decisions(self) -> list[dict[str, Any]]:
        """For each limit: whether the largest mean error over artefacts, positions and modes keeps it, and which it is.

        `met` is None where nothing was measured; `clear` whether the interval of that error (without one, the error
        itself) lies on one side of the limit.
        """
        return [_decision(name, limit, self.rows) for name, limit in self.request.limits.items()]

    @property
    def warnings(self) -> list[str]:
        """Failed stations with the reason and the number of repeats."""
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
            "limits": self.decisions,
            "contributions": self.budgets,
            "sweeps": [one.as_json() for one in self.sweeps.sweeps],
            "linearity_percent": _finite({"of_mean": 100 * off.of_mean / span, "of_field": 100 * off.of_field / span}),
            "not_measured": dict(self.failures),
        }

    def summary(self) -> str:
        """The largest errors over the range, as text."""
        lines = [f"{self.setup.sensor.name} in {self.setup.cell.name}: {len(self.rows)} figures"]
        lines += [f"  {decision_text(found)}" for found in self.decisions]
        for row in self.largest:
            if row["name"] in _HEADLINES:
                spread = row["standard_uncertainty"]
                plus = "" if spread is None else f" +- {spread:.3g}"
                where = f"{row['of']}, {row['position']}, {row['mode']}"
                lines.append(
                    f"  {row['artefact']:9} {row['name']:18} {row['mean']:9.3g}{plus} {row['unit']:3} ({where})"
                )
        return "\n".join(lines)

    def _write(self, folder: RunFolder, command_line: list[str]) -> None:
        from scancell.studies.acceptance.page import acceptance_page  # noqa: PLC0415  (needs the extra "studies")

        inputs = [] if self.request.factors is None else [self.request.factors]
        figures = self.figures
        write_json(folder.path("acceptance.json"), {**figures, "versions": versions()})
        write_csv(folder.path("acceptance.csv"), columns_of([_csv_row(row) for row in self.rows]))
        folder.path("acceptance.html").write_text(acceptance_page(figures, self.pictures(), self.warnings))
        write_json(folder.path("manifest.json"), manifest(self.setup, inputs, {"command_line": command_line}))

    def pictures(self) -> dict[str, bytes]:
        """Picture (PNG) of the deviation of each artefact, by its name."""
        return {name: evaluation.picture() for name, evaluation in self.pictured.items()}


def _decision(name: str, limit: float, rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    own = [row for row in rows if row["name"] == name]
    if not own:
        return {"name": name, "limit": limit, "unit": None, "met": None}
    worst = max(own, key=lambda row: abs(row["mean"]))
    size, ends = abs(worst["mean"]), worst["interval_symmetric"] or (worst["mean"], worst["mean"])
    sizes = [abs(end) for end in ends]
    place = {key: worst[key] for key in ("artefact", "of", "position", "mode")}
    largest = {"largest": worst["mean"], "interval": worst["interval_symmetric"], **place}
    clear = max(sizes) <= limit or (min(sizes) > limit and ends[0] * ends[1] > 0)
    return {"name": name, "limit": limit, "unit": worst["unit"], "met": size <= limit, "clear": clear, **largest}


def decision_text(found: Mapping[str, Any]) -> str:
    """A decision as a line: met, not met or not measured, the figure and where it is largest."""
    if found["met"] is None:
        return f"not measured: {found['name']}, limit {found['limit']:g}"
    unit = unit_text(found)
    where = f"{found['artefact'].replace('_', ' ')}, {found['position']}, {found['mode']}"
    unsure = "" if found["clear"] else "; its interval contains the limit"
    state = "met" if found["met"] else "not met"
    return f"{state}: {found['name']} {found['largest']:.3g} {unit}, limit {found['limit']:g} {unit} ({where}{unsure})"


def limits_of(words: Mapping[str, float] | Sequence[str]) -> dict[str, float]:
    """Limits by name of a figure, from a mapping or ``NAME=VALUE`` words.

    Raises `DescriptionError` for a figure that no artefact has, a value that is no positive number, or a name given
    twice.
    """
    if isinstance(words, Mapping):
        words = [f"{name}={value}" for name, value in words.items()]
    found: dict[str, float] = {}
    for word in words:
        name, _, text = (part.strip() for part in word.rpartition("="))
        if name not in _LIMITED:
            raise DescriptionError(
                key="limit", value=word, expected=f"NAME=VALUE with one of the names: {'; '.join(_LIMITED)}"
            )
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not 0 < value < math.inf:
            raise DescriptionError(key="limit", value=word, expected="a number above 0, in the unit of the figure")
        if name in found:
            raise DescriptionError("is given twice", key="limit", value=name)
        found[name] = value
    return found


_FORMS = ("probing form", "flatness", "form")
_SIZES = ("probing size", "sphere spacing", "step height", "diameter", "cone angle")
_HEADLINES = (*_FORMS, *_SIZES, *RATES)
_LIMITED = (
    *(f"{name}{ending}" for name in _FORMS for ending in ("", ", 95 % of the points", ", minimum zone")),
    *(*_SIZES, "dispersion", "bias", "D95 %", "max - min", *RATES),
)


def run_acceptance(scanner: Scanner, request: AcceptanceRequest, progress: Progress) -> AcceptanceReport:
    """Scan the artefacts of the programme in the scanner's cell, and sweep the sensor.

    Raises
    ------
    ScancellError
        Naming what is wrong and what was expected; `FitError` if no station could be measured.
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
        rows=[figure_row(one) for one in found.samples],
        budgets=contributions(found.samples, trials, labels, request.seed, correlation),
        sweeps=sweeps,
        failures=found.failures,
        pictured=found.pictured,
        points=sum(found.points.values()) / max(len(found.points), 1),
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
    design = {"kind": "latin_hypercube", "trials": count}
    study = load_study(request.factors).replace({"design": design, "as_built": request.as_built, "seed": request.seed})
    source = str(request.factors)
    values = Factors(study, setup, source).draw()

    def inputs_of(k: int) -> Trial:
        return Trial(seeds[k], values[k], lambda own: Factors(study, own, source).inputs(values[k]))

    return [inputs_of(k) for k in range(count)], study.labels, population_of(study).correlation


def _csv_row(row: Mapping[str, Any]) -> dict[str, Any]:
    """Without the single errors; intervals as two columns."""
    plain = {name: value for name, value in row.items() if name not in ("errors", *_CSV_INTERVALS)}
    for name in _CSV_INTERVALS:
        low, high = row[name] or (None, None)
        plain |= {f"{name}_low": low, f"{name}_high": high}
    return plain


def _finite(values: Mapping[str, float]) -> dict[str, float | None]:
    return {name: None if math.isnan(value) else value for name, value in values.items()}
