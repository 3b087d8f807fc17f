"""Capability of a cell: which characteristics of a part it can decide, by simulated measurements."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import numpy as np
from scipy.special import ndtri, stdtrit

from scancell.arrays import Array
from scancell.config.inspection import InspectionDescription, SizeKind
from scancell.config.loading import Setup
from scancell.config.study import load_study
from scancell.errors import DescriptionError, ScancellError
from scancell.files import read_json, require_format_version
from scancell.geometry.cad import CadMesh
from scancell.inspection.inspection import Decision, Effect, Inspection, inspect_part
from scancell.output.run_folder import RunFolder, SavedResult, write_json
from scancell.output.tables import columns_of, write_csv
from scancell.planning.plan import Plan
from scancell.progress import Progress
from scancell.scanner import Scanner
from scancell.studies.factors import Factors, Inputs, trial_seed
from scancell.values import Value

FORMAT_VERSION = 1
GOOD, USABLE = 0.1, 0.25  # expanded uncertainty over tolerance
_STUDY = 6.0  # standard deviations of the gauge that count against the tolerance (AIAG MSA)
_CATEGORIES = 2**0.5  # standard deviations of the gauge within which parts are of one category
_CLAMPING = ("cell.part.", "as_built.grasp.")  # factors that are drawn at each clamping, the others at each calibration
_SURE = 0.975  # quantile by which the spread of few measurements is widened
_LEAST_MEASURED = 0.5  # share of the measurements that must evaluate a characteristic


@dataclass(frozen=True)
class Gauge:
    """Standard deviations of a characteristic by repeating, clamping and calibrating again, m or rad.

    0 is one that the scatter within hides; NaN is one that was not repeated. `tolerance` is the width between limits.
    """

    repeat: float
    clamp: float
    calibrate: float
    tolerance: float

    @property
    def total(self) -> float:
        """Standard deviation of the gauge: of all that was repeated."""
        return float(np.sqrt(np.nansum(np.square([self.repeat, self.clamp, self.calibrate]))))

    @property
    def share(self) -> float:
        """Six standard deviations of the gauge over the tolerance (%GRR)."""
        return _STUDY * self.total / self.tolerance

    @property
    def categories(self) -> float:
        """Number of distinct categories of parts whose six standard deviations fill the tolerance."""
        return float(np.floor(_CATEGORIES * self.tolerance / _STUDY / self.total)) if self.total > 0 else float("inf")


def variance_components(values: Array) -> tuple[float, float, float]:
    """Standard deviations by repeating, clamping and calibrating, of values (calibrations, clampings, repeats).

    Analysis of variance of nested random effects; NaN where there is one clamping, or one calibration.
    """
    calibrations, clampings, repeats = values.shape
    of_clamping, of_calibration = values.mean(2), values.mean((1, 2))
    within = float(values.var(2, ddof=1).mean())
    between = repeats * float(of_clamping.var(1, ddof=1).mean()) if clampings > 1 else within
    among = clampings * repeats * float(of_calibration.var(ddof=1)) if calibrations > 1 else float("nan")
    clamp = max(0.0, between - within) / repeats if clampings > 1 else float("nan")
    calibrate = max(0.0, among - between) / (clampings * repeats) if calibrations > 1 else float("nan")
    return float(np.sqrt(within)), float(np.sqrt(clamp)), float(np.sqrt(calibrate))


@dataclass(frozen=True, eq=False, repr=False)
class CapabilityRow(Value):
    """Errors and uncertainties of a characteristic in simulated measurements, in m or rad.

    Attributes
    ----------
    name, kind
        Of the characteristic.
    errors
        (n,) error of the value in each measurement; NaN where it was not evaluated.
    random
        (n,) standard uncertainty by the noise of the points that each measurement states.
    tolerance
        Width between the limits, or of the zone; NaN with one limit alone.
    reason
        Why it was not evaluated, if so.
    nested
        Numbers of calibrations, of clampings in each, and of repeats in each of these: the order of the errors.
    """

    name: str
    kind: str
    errors: Array
    random: Array
    tolerance: float
    reason: str
    nested: tuple[int, int, int] = (1, 1, 1)

    @property
    def gauge(self) -> Gauge | None:
        """Gauge repeatability and reproducibility; None without repeats, or if a measurement did not evaluate it."""
        if self.nested[2] < 2 or len(self.errors) != math.prod(self.nested) or not np.isfinite(self.errors).all():
            return None
        return Gauge(*variance_components(self.errors.reshape(self.nested)), self.tolerance)

    @property
    def effect(self) -> Effect:
        """Mean error of a size, and the spread that noise of the points does not explain; of a zone both together."""
        found = self.errors[np.isfinite(self.errors)]
        if len(found) < 2:
            return Effect()
        noise, count = float(np.nanmean(self.random**2)), len(found)
        # Few measurements tell the spread with few degrees of freedom, and its mean is uncertain, too (JCGM 100 G.3).
        wider = float(stdtrit(count - 1, _SURE) / ndtri(_SURE)) * (1 + 1 / count) ** 0.5
        made = Effect(float(found.mean()), wider * float(np.sqrt(max(0.0, found.var(ddof=1) - noise))))
        return made if self._is_size else made.of_zone

    @property
    def expanded(self) -> float:
        """Expanded uncertainty (coverage factor 2) of a size that is corrected for the mean error, or of a zone."""
        found = self.errors[np.isfinite(self.errors)]
        if len(found) < 2:
            return float("nan")
        deviation = float(found.std(ddof=1))
        return 2 * (deviation if self._is_size else float(np.hypot(deviation, found.mean())))

    @property
    def _is_size(self) -> bool:
        return self.kind in get_args(SizeKind)

    @property
    def share(self) -> float:
        """Expanded uncertainty over tolerance."""
        return self.expanded / self.tolerance

    @property
    def answer(self) -> str:
        """Whether the characteristic can be decided, and what limits that."""
        if np.isfinite(self.errors).mean() < _LEAST_MEASURED:
            return f"cannot be evaluated: {self.reason}"
        if not np.isfinite(self.share):
            return "one limit: depends on the value"
        limit = "errors of the cell" if self.effect.deviation**2 > float(np.nanmean(self.random**2)) else "noise"
        if self.share <= GOOD:
            return "can be decided"
        return f"can be decided with a guard band ({limit})" if self.share <= USABLE else f"too uncertain ({limit})"

    def as_row(self) -> dict[str, Any]:
        """Plain data: mm, µm and degrees."""
        unit, scale, tolerance = ("deg", 180 / np.pi, 180 / np.pi) if self.kind == "angle" else ("um", 1e6, 1e3)
        values = {
            f"tolerance_{'deg' if unit == 'deg' else 'mm'}": tolerance * self.tolerance,
            f"mean_error_{unit}": scale * self.effect.bias,
            f"by_cell_{unit}": scale * self.effect.deviation,
            f"by_noise_{unit}": scale * float(np.sqrt(np.nanmean(self.random**2)))
            if self._is_measured
            else float("nan"),
            f"expanded_{unit}": scale * self.expanded,
            "share_of_tolerance": self.share,
        }
        if self.nested[2] > 1:
            gauge = self.gauge
            for name in ("repeat", "clamp", "calibrate", "total"):
                found = float("nan") if gauge is None else getattr(gauge, name)
                values[f"gauge_{name}_{unit}"] = scale * found
            values["gauge_share"] = float("nan") if gauge is None else gauge.share
            values["gauge_categories"] = float("nan") if gauge is None else gauge.categories
        plain = {key: value if np.isfinite(value) else None for key, value in values.items()}
        measured = int(np.isfinite(self.errors).sum())
        return {"name": self.name, "kind": self.kind, **plain, "measurements": measured, "answer": self.answer}

    @property
    def _is_measured(self) -> bool:
        return bool(np.isfinite(self.random).any())


@dataclass(frozen=True, eq=False, repr=False)
class Capability(SavedResult):
    """Uncertainties of characteristics by simulated measurements; `save` writes ``capability.json`` and ``.csv``.

    Attributes
    ----------
    part
        File of the part.
    rows
        One for each characteristic.
    measurements
        Number of simulated measurements.
    labels
        Names of the factors that were drawn.
    seconds
        Duration of the planned scan, s.

    Examples
    --------
    >>> capability = scancell.capability("block.step", "block.toml", draws=10)  # doctest: +SKIP
    >>> capability.rows[0].answer  # doctest: +SKIP
    'can be decided'
    """

    part: str
    rows: tuple[CapabilityRow, ...]
    measurements: int
    labels: tuple[str, ...]
    seconds: float

    @property
    def effects(self) -> dict[str, Effect]:
        """Effect of the cell on each characteristic, as `scancell.inspect` uses it."""
        return {row.name: row.effect for row in self.rows}

    @property
    def figures(self) -> dict[str, Any]:
        """Plain data of all rows, as in ``capability.json``."""
        return {
            "format_version": FORMAT_VERSION,
            "part": self.part,
            "measurements": self.measurements,
            "factors": list(self.labels),
            "scan_s": self.seconds,
            "characteristics": [
                {**row.as_row(), "bias_si": row.effect.bias, "deviation_si": row.effect.deviation} for row in self.rows
            ],
        }

    def summary(self) -> str:
        """Expanded uncertainty, share of the tolerance and answer of each characteristic as lines of text."""
        drawn = f"with {len(self.labels)} factors" if self.labels else "by noise alone"
        lines = [
            f"{Path(self.part).name}: {self.measurements} simulated measurements {drawn}, {self.seconds:.0f} s each"
        ]
        width = max(len(row.name) for row in self.rows)
        for row in self.rows:
            size = (
                f"{np.degrees(row.expanded):.2g}\N{DEGREE SIGN}"
                if row.kind == "angle"
                else f"{1e6 * row.expanded:.3g} um"
            )
            share = f"{100 * row.share:.0f} % of the tolerance" if np.isfinite(row.share) else ""
            lines.append(f"  {row.name:{width}}  {row.kind:17}  U = {size:10}  {share:22}  {row.answer}")
        if self.rows[0].nested[2] > 1:
            lines += [
                "standard deviations by repeating, clamping and calibrating again; gauge over tolerance, categories"
            ]
            lines += [f"  {row.name:{width}}  {_gauge_text(row)}" for row in self.rows]
        return "\n".join(lines)

    def _write(self, folder: RunFolder, command_line: list[str]) -> None:
        write_json(folder.path("capability.json"), {**self.figures, "command_line": command_line})
        write_csv(folder.path("capability.csv"), columns_of([row.as_row() for row in self.rows]))


def _gauge_text(row: CapabilityRow) -> str:
    gauge = row.gauge
    if gauge is None:
        return "not evaluated in each measurement"
    unit, scale = ("\N{DEGREE SIGN}", 180 / np.pi) if row.kind == "angle" else (" um", 1e6)
    found = [gauge.repeat, gauge.clamp, gauge.calibrate]
    texts = [f"{scale * one:.3g}{unit}" if np.isfinite(one) else "-" for one in found]
    if np.isfinite(gauge.share):
        texts += [f"{100 * gauge.share:.3g} %", f"{gauge.categories:.0f}"]
    return "  ".join(f"{text:>10}" for text in texts)


def read_effects(capability: str | Path | SavedResult) -> dict[str, Effect]:
    """Effects by name of the characteristic, from a `Capability` or its JSON file.

    Raises `DescriptionError` naming the file and what is wrong.
    """
    if isinstance(capability, Capability):
        return capability.effects
    if isinstance(capability, SavedResult):
        raise DescriptionError(key="capability", value=capability, expected="a result of scancell.capability")
    content = read_json(capability)
    rows = content.get("characteristics") if isinstance(content, dict) else None
    if not isinstance(rows, list):
        raise DescriptionError("is no capability", file=capability, expected="a file of `scancell capability`")
    require_format_version(content.get("format_version"), FORMAT_VERSION, capability)
    try:
        return {str(row["name"]): Effect(float(row["bias_si"]), float(row["deviation_si"])) for row in rows}
    except (KeyError, TypeError, ValueError):
        raise DescriptionError(
            "is no capability", file=capability, expected="a file of `scancell capability`"
        ) from None


def run_capability(
    scanner: Scanner,
    part: CadMesh,
    description: InspectionDescription,
    *,
    factors: Path | None,
    draws: int,
    clampings: int = 1,
    repeats: int = 1,
    seed: int,
    engine: Any,
    as_built: Sequence[str],
    progress: Progress,
    source: str = "",
    each: Callable[[Inspection], None] | None = None,
) -> Capability:
    """Measure the nominal part in simulation, each time with its own noise and drawn deviations of the cell.

    All measurements follow the plan of their nominal cell.

    Raises `ScancellError` if the part cannot be scanned, or no measurement succeeds.

    Parameters
    ----------
    factors
        Study description (TOML) whose factors are drawn; None: noise alone.
    draws, clampings, repeats
        Number of draws of all factors; of draws of the place of the part (factors ``cell.part``, ``as_built.grasp``) in
        each; and of measurements in each of these.
    each
        Receives the inspection of each measurement.
    """
    inputs, labels = _inputs(scanner, factors, draws, clampings, repeats, seed, as_built)
    plan: Plan | None = None
    planned: Setup | None = None
    found: list[Inspection] = []
    fault: ScancellError | None = None
    progress.stage("measuring", len(inputs), "measurements")
    for number, own in enumerate(inputs):
        try:
            result = scanner.scan(
                part,
                engine=engine,
                as_built=own.as_built,
                seed=trial_seed(seed, number),
                setup=None if own.setup is scanner.setup else own.setup,
                plan=plan if own.setup is planned else None,
                normals=False,
                samples=False,
            )
            plan, planned = result.plan, own.setup
            cloud = result.cloud
            threads = scanner.pipeline.threads
            points, profile = cloud.points_in_part, cloud.profile
            found.append(
                inspect_part(part, points, description, profile=profile, effects={}, source=source, threads=threads)
            )
            seconds = float(cloud.time.max())
            if each is not None:
                each(found[-1])
        except DescriptionError:
            raise
        except ScancellError as error:
            fault = error
        progress.advance(1)
    if not found:
        raise fault or DescriptionError(key="draws", value=draws, expected="at least 1")
    nested = (draws, clampings, repeats)
    rows = [_row(decisions, nested) for decisions in zip(*(one.decisions for one in found), strict=True)]
    return Capability(part.source, tuple(rows), len(found), tuple(labels), seconds)


def _row(decisions: Sequence[Decision], nested: tuple[int, int, int]) -> CapabilityRow:
    """Row of one characteristic by its decisions in all measurements."""
    one = decisions[0].description
    measured = [decision.measured for decision in decisions]
    errors = np.array([np.nan if m is None else m.value - m.nominal for m in measured])
    random = np.array([np.nan if m is None else m.random for m in measured])
    known = [decision for decision in decisions if decision.measured is not None]
    tolerance = float("nan")
    if known:
        tolerance = known[0].high - (known[0].low if one.is_size else 0.0)
    reason = next((decision.reason for decision in decisions if decision.measured is None), "")
    tolerance = tolerance if np.isfinite(tolerance) else np.nan
    return CapabilityRow(one.name, one.kind, errors, random, tolerance, reason, nested)


def _inputs(
    scanner: Scanner,
    factors: Path | None,
    draws: int,
    clampings: int,
    repeats: int,
    seed: int,
    as_built: Sequence[str],
) -> tuple[list[Inputs], Sequence[str]]:
    """Inputs of each measurement, calibrations first, and the labels of the factors."""
    if factors is None:
        return [Inputs(scanner.setup, tuple(as_built))] * (draws * clampings * repeats), ()
    design: Mapping[str, Any] = {"kind": "latin_hypercube", "trials": draws * clampings}
    study = load_study(factors).replace({"design": design, "as_built": list(as_built), "seed": seed})
    drawn = Factors(study, scanner.setup, str(factors))
    found: list[Inputs] = []
    paths = [*(factor.path for factor in study.factor), *(path for block in study.block for path in block.paths)]
    values = drawn.draw()
    for number, own in enumerate(values):
        calibrated = values[number - number % clampings]
        chosen = [a if path.startswith(_CLAMPING) else b for path, a, b in zip(paths, own, calibrated, strict=True)]
        found += [drawn.inputs(chosen)] * repeats
    return found, study.labels
