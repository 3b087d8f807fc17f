"""Statistics of a study's rows: figures with intervals, shares of the factors, convergence, notes on their limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell.config.study import StudyDescription
from scancell.studies.budget import Terms, undetected_factors, variance_budget
from scancell.studies.designs import design, hashed
from scancell.studies.distributions import Population, middles, population_of
from scancell.studies.intervals import convergence, summary
from scancell.studies.sensitivity import morris_effects, one_at_a_time_budget, sobol_indices

Array = NDArray[np.float64]

# Figures with a sensitivity analysis: those of the deviation, and those of each fitted sphere.
_ANALYSED = ("mean_um", "rms_um", "d95_um")
_ANALYSED_OF_SPHERES = (".diameter_error_um", ".form_um", ".x_um", ".y_um", ".z_um")
_TRIALS_PER_FACTOR = 10
_SIZED_BY_METHOD = {"morris", "one_at_a_time"}


@dataclass(frozen=True)
class Rows:
    """Rows of one engine by trial number, aligned with the design; `figures` (n,) are NaN where a trial gave none."""

    plain: Sequence[dict[str, Any]]
    figures: dict[str, Array]

    @classmethod
    def of(cls, rows: Sequence[dict[str, Any]]) -> Rows:
        """Sort rows and make columns of their figures."""
        ordered = sorted(rows, key=lambda row: int(row["number"]))
        names = list(dict.fromkeys(name for row in ordered for name in row["figures"]))
        columns = {
            name: np.array([np.nan if (v := row["figures"].get(name)) is None else v for row in ordered], float)
            for name in names
        }
        return cls(ordered, columns)

    def terms(self, chosen: NDArray[np.bool_], population: Population) -> list[Terms]:
        """Regressors of each factor in the chosen rows."""
        values = [row["values"] for row, take in zip(self.plain, chosen, strict=True) if take]
        return [Terms.of([row[j] for row in values], of_factor) for j, of_factor in enumerate(population.values)]


def analyse(study: StudyDescription, labels: Sequence[str], rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Plain data for ``study.json``: the trials, the failed ones, and per engine statistics of the figures."""
    failed = [row for row in rows if row["status"] != "ok"]
    names = list(dict.fromkeys(row["engine"] for row in sorted(rows, key=lambda row: int(row["number"]))))
    population = population_of(study)
    engines = {
        name: _engine(study, labels, population, Rows.of([row for row in rows if row["engine"] == name]))
        for name in names
    }
    return {
        "name": study.name,
        "design": study.design.model_dump(mode="json"),
        "factors": list(labels),
        "probability": study.probability,
        "trials": len(rows),
        "failed": [{"trial": r["number"], "seed": r["seed"], "message": r["message"]} for r in failed],
        "notes": [
            f"{name}: {note}" if len(engines) > 1 else note
            for name, engine in engines.items()
            for note in engine.pop("notes")
        ],
        "engines": engines,
    }


def independent_rows(kind: str, factors: int, count: int) -> NDArray[np.bool_]:
    """(count,) rows that are independent draws: all but the mixed ones of Saltelli's scheme."""
    if kind != "sobol":
        return np.ones(count, bool)
    position = np.arange(count) % (factors + 2)
    return np.asarray((position == 0) | (position == factors + 1))


def _engine(study: StudyDescription, labels: Sequence[str], population: Population, rows: Rows) -> dict[str, Any]:
    drawn = independent_rows(study.design.kind, len(labels), len(rows.plain))
    names = [name for name in rows.figures if name in _ANALYSED or name.endswith(_ANALYSED_OF_SPHERES)]
    sensitivity = {
        name: {
            "convergence": convergence(_finite(rows.figures[name][drawn])),
            **_contributions(study, labels, population, rows, rows.figures[name]),
        }
        for name in names
    }
    return {
        "figures": {name: summary(_finite(values[drawn]), study.probability) for name, values in rows.figures.items()},
        "sensitivity": sensitivity,
        "undetected": [labels[j] for j in _undetected(rows, population)],
        "notes": _notes(study.design.kind, len(labels), rows, sensitivity),
    }


def _finite(values: Array) -> Array:
    return values[np.isfinite(values)]


def _undetected(rows: Rows, population: Population) -> list[int]:
    good = np.array([row["status"] == "ok" for row in rows.plain])
    if not good.any():
        return []
    figures = [values[good] for values in rows.figures.values()]
    return undetected_factors(rows.terms(good, population), [values for values in figures if np.isfinite(values).all()])


def _notes(kind: str, factors: int, rows: Rows, sensitivity: dict[str, dict[str, Any]]) -> list[str]:
    """Limits of the variance budgets that a reader must know."""
    fitted = {name: found for name, found in sensitivity.items() if "regression" in found}
    trials, recommended = len(rows.plain), _TRIALS_PER_FACTOR * factors
    notes = []
    if trials < recommended and kind not in _SIZED_BY_METHOD:
        notes.append(
            f"{trials} trials for {factors} factors: too few for reliable shares; {recommended} or more are recommended"
        )
    unsettled = [name for name, found in fitted.items() if _is_wide(found["budget"][0])]
    if unsettled:
        notes.append(f"the interval of the largest share is wider than the share itself: {', '.join(unsettled)}")
    return notes


def _is_wide(row: dict[str, Any]) -> bool:
    low, high = row["share_interval"]
    return bool(high - low > row["share"])


def _contributions(
    study: StudyDescription, labels: Sequence[str], population: Population, rows: Rows, outputs: Array
) -> dict[str, Any]:
    """Sensitivities that the design supports; ``budget`` and ``morris`` in falling order."""
    seed, kind = hashed(study.seed, 3, 0) >> 33, study.design.kind
    whole = kind in {"sobol", "morris", "one_at_a_time"} and len(rows.plain) == _design_size(study)
    if kind == "sobol" and whole:
        indices, growing = sobol_indices(outputs, len(labels), study.probability, seed)
        budget = _budget(study, labels, population, rows, outputs, len(labels) + 2)
        return {"sobol": _named(labels, indices), "sobol_convergence": growing, **budget}
    if kind == "morris" and whole:
        low, high = study.design.quantiles
        cube = (design(study.design, [None] * len(labels), study.seed) - low) / (high - low)
        effects = morris_effects(cube, outputs, study.design.levels, study.probability, seed)
        return {"morris": _ranked(_named(labels, effects), "mean_magnitude")}
    if kind == "one_at_a_time" and whole and _all_numbers(rows, len(labels)):
        slopes = _named(labels, _slopes(study, population, rows, outputs))
        return {"budget": _ranked([row for row in slopes if np.isfinite(row["slope"])], "share")}
    return _budget(study, labels, population, rows, outputs)


def _budget(
    study: StudyDescription,
    labels: Sequence[str],
    population: Population,
    rows: Rows,
    outputs: Array,
    rows_per_sample: int = 1,
) -> dict[str, Any]:
    """Variance budget of the rows in which the figure exists; of rows that belong together, all or none."""
    good = np.isfinite(outputs.reshape(-1, rows_per_sample)).all(1).repeat(rows_per_sample)
    if rows_per_sample == 1:
        good &= independent_rows(study.design.kind, len(labels), len(outputs))
    if not good.any():
        return {}
    seed = hashed(study.seed, 3, 0) >> 33
    terms = rows.terms(good, population)
    found = variance_budget(
        terms, outputs[good], study.probability, seed, rows_per_sample, correlation=population.correlation
    )
    return {**found, "budget": _ranked(_named(labels, found["budget"]), "share")} if found else {}


def _slopes(study: StudyDescription, population: Population, rows: Rows, outputs: Array) -> list[dict[str, Any]]:
    values = [np.array([row["values"][j] for row in rows.plain], float) for j in range(len(study.factor))]
    listed = [middles(factor.distribution) for factor in study.factor]
    levels = [study.design.levels if found is None else len(found) for found in listed]
    spreads = [float(np.std(np.asarray(drawn, float))) for drawn in population.values]
    return one_at_a_time_budget(values, outputs, levels, spreads, study.probability, hashed(study.seed, 3, 0) >> 33)


def _all_numbers(rows: Rows, factors: int) -> bool:
    return all(isinstance(row["values"][j], int | float) for row in rows.plain for j in range(factors))


def _design_size(study: StudyDescription) -> int:
    listed = [middles(factor.distribution) for factor in study.factor]
    listed += [None] * sum(len(block.paths) for block in study.block)
    return len(design(study.design, listed, study.seed))


def _named(labels: Sequence[str], rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    return [{"factor": label, **row} for label, row in zip(labels, rows, strict=False)]


def _ranked(rows: list[dict[str, Any]], key: str) -> list[dict[str, Any]]:
    return sorted(rows, key=lambda row: -row[key])
