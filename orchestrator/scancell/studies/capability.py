"""Capability of a cell: which characteristics of a part it can decide, by simulated measurements."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from scancell.arrays import Array
from scancell.config.inspection import InspectionDescription
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
_LEAST_MEASURED = 0.5  # share of the measurements that must evaluate a characteristic


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
    """

    name: str
    kind: str
    errors: Array
    random: Array
    tolerance: float
    reason: str

    @property
    def effect(self) -> Effect:
        """Mean error, and the spread that the noise of the points does not explain."""
        found = self.errors[np.isfinite(self.errors)]
        if len(found) < 2:
            return Effect()
        noise = float(np.nanmean(self.random**2))
        return Effect(float(found.mean()), float(np.sqrt(max(0.0, found.var(ddof=1) - noise))))

    @property
    def expanded(self) -> float:
        """Expanded uncertainty (coverage factor 2) of a value that is corrected for the mean error."""
        found = self.errors[np.isfinite(self.errors)]
        return 2 * float(found.std(ddof=1)) if len(found) > 1 else float("nan")

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
        return "\n".join(lines)

    def _write(self, folder: RunFolder, command_line: list[str]) -> None:
        write_json(folder.path("capability.json"), {**self.figures, "command_line": command_line})
        write_csv(folder.path("capability.csv"), columns_of([row.as_row() for row in self.rows]))


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
    require_format_version(content.get("format_version") if rows is not None else None, FORMAT_VERSION, capability)
    try:
        return {str(row["name"]): Effect(float(row["bias_si"]), float(row["deviation_si"])) for row in rows or ()}
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
    seed: int,
    engine: Any,
    as_built: Sequence[str],
    progress: Progress,
    source: str = "",
    each: Callable[[Inspection], None] | None = None,
) -> Capability:
    """Measure the nominal part `draws` times in simulation, each with its own noise and drawn deviations of the cell.

    All measurements follow the plan of the nominal cell.

    Raises `ScancellError` if the part cannot be scanned, or no measurement succeeds.

    Parameters
    ----------
    factors
        Study description (TOML) whose factors are drawn for each measurement; None: noise alone.
    each
        Receives the inspection of each measurement.
    """
    inputs, labels = _inputs(scanner, factors, draws, seed, as_built)
    plan: Plan | None = None
    found: list[Inspection] = []
    fault: ScancellError | None = None
    progress.stage("measuring", draws, "measurements")
    for number, own in enumerate(inputs):
        try:
            result = scanner.scan(
                part,
                engine=engine,
                as_built=own.as_built,
                seed=trial_seed(seed, number),
                setup=None if own.setup is scanner.setup else own.setup,
                plan=plan if own.setup is scanner.setup else None,
                normals=False,
                samples=False,
            )
            plan = result.plan if own.setup is scanner.setup else plan
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
    rows = map(_row, zip(*(one.decisions for one in found), strict=True))
    return Capability(part.source, tuple(rows), len(found), tuple(labels), seconds)


def _row(decisions: Sequence[Decision]) -> CapabilityRow:
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
    return CapabilityRow(one.name, one.kind, errors, random, tolerance if np.isfinite(tolerance) else np.nan, reason)


def _inputs(
    scanner: Scanner, factors: Path | None, draws: int, seed: int, as_built: Sequence[str]
) -> tuple[list[Inputs], Sequence[str]]:
    """Inputs of each measurement, and the labels of the factors."""
    if factors is None:
        return [Inputs(scanner.setup, tuple(as_built))] * draws, ()
    design: Mapping[str, Any] = {"kind": "latin_hypercube", "trials": draws}
    study = load_study(factors).replace({"design": design, "as_built": list(as_built), "seed": seed})
    drawn = Factors(study, scanner.setup, str(factors))
    return [drawn.inputs(values) for values in drawn.draw()], study.labels
