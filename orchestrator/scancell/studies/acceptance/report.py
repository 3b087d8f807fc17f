"""An acceptance test: run it, evaluate the repeats, and write ``acceptance.json``, ``.csv`` and ``.html``."""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from scancell.config.choices import Engine
from scancell.config.loading import Setup
from scancell.config.study import load_study
from scancell.errors import DescriptionError, FitError, require
from scancell.evaluation.artefact import ArtefactEvaluation
from scancell.output.run_files import write_json
from scancell.output.run_folder import RunFolder, SavedResult, manifest, versions
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
from scancell.studies.page import BLUE, GREY, INK, ORANGE, format_figure, rendered, svg

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = NDArray[np.float64]

PROBABILITY = 0.95

WHAT = (
    "figures in the style of VDI/VDE 2634-2 and -3 and ISO 10360-8 and -13; least-squares elements; uncertainty after"
    " JCGM 101 over the repeats"
)
_CSV_INTERVALS = ("interval_symmetric", "interval_shortest")

_TITLES = {
    "sphere": ("Sphere: probing", ("probing form, 95 % of the points", "probing size", "D95 %")),
    "ball_bar": ("Ball bar: sphere spacing", ("sphere spacing", "probing form, 95 % of the points")),
    "plane": ("Plane: flatness", ("flatness, 95 % of the points", "flatness", "bias")),
    "step": ("Step artefact: length", ("step height",)),
    "cylinder": ("Cylinder: form and size", ("form, 95 % of the points", "diameter")),
    "cone": ("Cone: form and angle", ("form, 95 % of the points", "cone angle")),
}
_ANSWERED = ("probing form, 95 % of the points", "probing size", "sphere spacing", "flatness", "step height")
_STATISTICS = {
    "mean": "mean",
    "standard_uncertainty": "std. uncertainty",
    "interval_symmetric": "95 % interval",
}
_DETAILS = {**_STATISTICS, "interval_shortest": "shortest interval"}
_COLOURS = (BLUE, ORANGE)
_SHIFT = 0.12  # between the marks of the two modes
_MOST_FACES = 6  # with a line of their own


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


def acceptance_page(figures: Mapping[str, Any], pictures: Mapping[str, bytes], failures: Sequence[str]) -> str:
    """HTML of the whole report.

    Parameters
    ----------
    figures
        Content of ``acceptance.json``.
    pictures
        PNG of the deviation of each artefact.
    """
    markup = require("markupsafe", "studies").Markup
    budgets_head, budgets = _budgets([found for found in figures["contributions"] if _is_shown(found)])
    return rendered(
        "acceptance.html.j2",
        title=f"Acceptance test of {figures['sensor']}",
        facts=_facts(figures),
        what=figures["what"],
        answer=_answer(figures, failures),
        limits=[_limit(found) for found in figures["limits"]],
        few=figures["programme"]["repeats"] < 11,
        failures=failures,
        largest_head=["artefact", "characteristic", "of", "position", "mode", "unit", *_STATISTICS.values()],
        largest=[_largest(row) for row in figures["largest"] if _is_shown(row)],
        rates=_rates(figures["figures"]),
        artefacts=[_artefact(name, figures, pictures, markup) for name in _measured(figures)],
        sweeps=[(found["name"], markup(_sweep_plot(found))) for found in figures["sweeps"]],
        linearity=figures["linearity_percent"],
        budgets_head=budgets_head,
        budgets=budgets,
        about=[["engine", figures["engine"]], ["seed", figures["seed"]], *_words(figures)],
    )


def _answer(figures: Mapping[str, Any], failures: Sequence[str]) -> str:
    """One sentence: how many limits are met, and what was not measured; without limits the largest errors."""
    limits = figures["limits"]
    items = f"{len(failures)} item was" if len(failures) == 1 else f"{len(failures)} items were"
    missing = f"; {items} not measured" if failures else "; everything was measured"
    if not limits:
        shown = [row for row in figures["largest"] if row["name"] in _ANSWERED]
        worst = {row["name"]: row for row in sorted(shown, key=lambda row: abs(row["mean"]))}
        errors = [f"{name} {format_figure(abs(row['mean']))} {unit_text(row)}" for name, row in worst.items()]
        return f"No limits are stated; largest errors: {', '.join(errors) or 'none'}{missing}."
    states = [found["met"] for found in limits]
    failed = [found["name"] for found in limits if found["met"] is False]
    unknown = [found["name"] for found in limits if found["met"] is None]
    words = [f"{states.count(True)} of {len(states)} limits are met"]
    words += [f"not met: {', '.join(failed)}"] if failed else []
    words += [f"not measured: {', '.join(unknown)}"] if unknown else []
    return f"{'; '.join(words)}{missing}."


def _limit(found: Mapping[str, Any]) -> list[Any]:
    """State, figure, limit, largest error with its interval, and where."""
    if found["met"] is None:
        return ["not measured", found["name"], found["limit"], "", "", "no artefact gave this figure: see the reasons"]
    state = ("met" if found["met"] else "not met") + ("" if found["clear"] else " (interval contains the limit)")
    where = f"{found['artefact'].replace('_', ' ')}, {found['of']}, {found['position']}, {found['mode']}"
    return [state, f"{found['name']}, {unit_text(found)}", found["limit"], found["largest"], found["interval"], where]


def _facts(figures: Mapping[str, Any]) -> str:
    near, far = figures["range_mm"]
    programme = figures["programme"]
    size = "" if figures["artefact_scale"] == 1.0 else f", artefacts {figures['artefact_scale']:.3g} times their size"
    return (
        f"measuring range {near:g} to {far:g} mm, cell {figures['cell']}, {figures['engine']} engine, "
        f"{programme['repeats']} repeats{size}"
    )


def _words(figures: Mapping[str, Any]) -> list[list[str]]:
    listed = {"as built": figures["as_built"], "factors drawn for each repeat": figures["factors"]}
    return [[name, ", ".join(words)] for name, words in listed.items() if words]


def _measured(figures: Mapping[str, Any]) -> list[str]:
    return list(dict.fromkeys(row["artefact"] for row in figures["figures"]))


def _largest(row: Mapping[str, Any]) -> list[Any]:
    names = [row["artefact"].replace("_", " "), row["name"], row["of"], row["position"], row["mode"]]
    return [*names, unit_text(row), *(row[key] for key in _STATISTICS)]


def _rates(rows: Sequence[Mapping[str, Any]]) -> list[list[Any]]:
    """Artefact, position, mode, outlier and missing-point rate in %."""
    places: dict[tuple[str, str, str], dict[str, float]] = {}
    for row in rows:
        if row["name"] in RATES:
            place = (row["artefact"].replace("_", " "), row["position"], row["mode"])
            places.setdefault(place, {})[row["name"]] = row["mean"]
    return [[*place, *(rates[name] for name in RATES)] for place, rates in places.items()]


def _artefact(name: str, figures: Mapping[str, Any], pictures: Mapping[str, bytes], markup: Any) -> dict[str, Any]:
    rows = [row for row in figures["figures"] if row["artefact"] == name and row["name"] not in RATES]
    title, shown = _TITLES.get(name, (name, ()))
    drawings = []
    for characteristic in shown:
        own = [row for row in rows if row["name"] == characteristic]
        if own:
            drawings.append(markup(_plot_over_positions(own, characteristic)))
    table = [
        [
            *(row["of"], row["name"], row["position"], round(row["standoff_mm"], 1), row["mode"]),
            *(unit_text(row), row["repeats"], *(row[key] for key in _DETAILS)),
            *(row["minimum"], row["maximum"], row["fit_uncertainty"]),
        ]
        for row in rows
    ]
    picture = pictures.get(name)
    return {
        "title": title,
        "drawings": drawings,
        "head": [
            *("of", "characteristic", "position", "standoff, mm", "mode", "unit", "repeats", *_DETAILS.values()),
            *("minimum", "maximum", "uncertainty by the fit"),
        ],
        "rows": table,
        "picture": None if picture is None else base64.b64encode(picture).decode(),
    }


def _is_shown(found: Mapping[str, Any]) -> bool:
    return found["name"] in _TITLES.get(found["artefact"], ("", ()))[1]


def _budgets(found: Sequence[Mapping[str, Any]]) -> tuple[list[str], list[list[Any]]]:
    """Head and rows: share of each factor in %."""
    factors = list(dict.fromkeys(row["factor"] for one in found for row in one["budget"]))
    ordered = [*(name for name in factors if name != REPEATABILITY), REPEATABILITY]
    rows = []
    for one in found:
        shares = {row["factor"]: 100.0 * row["share"] for row in one["budget"]}
        size = sum(row["uncertainty"] ** 2 for row in one["budget"]) ** 0.5
        names = [one["artefact"].replace("_", " "), one["name"], unit_text(one)]
        rows.append([*names, size, *(shares.get(factor) for factor in ordered)])
    return ["artefact", "characteristic", "unit", "std. deviation", *(f"{name}, %" for name in ordered)], rows


def _plot_over_positions(rows: Sequence[dict[str, Any]], name: str) -> str:
    """Mean errors with their 95 % intervals, or twice their standard uncertainty, by position; a colour per mode."""
    positions = list(dict.fromkeys(row["position"] for row in rows))
    modes = list(dict.fromkeys(row["mode"] for row in rows))
    faces = list(dict.fromkeys(row["of"] for row in rows))

    def draw(axes: Axes) -> None:
        for m, mode in enumerate(modes):
            for f, face in enumerate(faces[:_MOST_FACES]):
                own = [row for row in rows if (row["mode"], row["of"]) == (mode, face)]
                x = np.array([positions.index(row["position"]) for row in own]) + (m - (len(modes) - 1) / 2) * _SHIFT
                x = x + 0.3 * _SHIFT * (f - (min(len(faces), _MOST_FACES) - 1) / 2)
                mean, ends = np.array([row["mean"] for row in own]), np.array([_ends(row) for row in own])
                spread = np.clip(np.stack([mean - ends[:, 0], ends[:, 1] - mean]), 0.0, None)
                label = mode if f == 0 else None
                axes.errorbar(x, mean, spread, fmt="o", ms=4, capsize=3, color=_COLOURS[m % 2], label=label)
        axes.axhline(0.0, color=GREY, linewidth=0.8)
        axes.set(xticks=range(len(positions)), xticklabels=positions, ylabel=unit_text(rows[0]))
        axes.set_xlim(-0.5, len(positions) - 0.5)
        axes.set_title(name, fontsize=10, loc="left")
        axes.legend()

    return svg(5.0, 2.8, 1, draw)


def _ends(row: dict[str, Any]) -> tuple[float, float]:
    if row["interval_symmetric"]:
        low, high = row["interval_symmetric"]
        return low, high
    half = 2.0 * (row["standard_uncertainty"] or 0.0)
    return row["mean"] - half, row["mean"] + half


def _sweep_plot(found: dict[str, Any]) -> str:
    """Bias with the standard deviation of points as a band, and shares of outliers and missing points."""
    value, bias, std, outliers, missing = (
        np.array([np.nan if row[key] is None else row[key] for row in found["rows"]], float)
        for key in ("value", "bias_um", "std_um", "outlier_rate", "missing_rate")
    )
    scale = "log" if found["name"] == "reflectance" else "linear"
    label = found["name"] if found["unit"] == "1" else f"{found['name']} ({found['unit']})"

    def draw(left: Axes, right: Axes) -> None:
        left.fill_between(value, bias - std, bias + std, color=BLUE, alpha=0.25, linewidth=0, label="± std of points")
        left.plot(value, bias, "o-", ms=3, color=BLUE, label="bias")
        left.axhline(0.0, color=GREY, linewidth=0.8)
        left.set(xlabel=label, ylabel="µm", xscale=scale)
        left.legend()
        right.plot(value, 100 * missing, "o-", ms=3, color=ORANGE, label="missing points")
        right.plot(value, 100 * outliers, "s--", ms=3, color=INK, label="outliers")
        right.set(xlabel=label, ylabel="%", xscale=scale)
        right.set_ylim(bottom=0.0, top=max(1.0, 110 * float(np.nanmax(np.append(missing, outliers)))))
        right.legend()

    return svg(8.4, 2.7, 2, draw)
