"""Statistics of a study's rows: figures with intervals, shares of the factors, convergence, notes on their limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell.arrays import Array
from scancell.config.study import StudyDescription
from scancell.errors import require
from scancell.studies.budget import Fit, ShapleyForms, Terms, shares_of, undetected_factors, variance_budget
from scancell.studies.factors import Population, design, hashed, middles, morris_problem, population_of

_RESAMPLES = 500

# Figures with a sensitivity analysis: those of the deviation, and those of each fitted sphere.
_ANALYSED = ("mean_um", "rms_um", "d95_um")
_ANALYSED_OF_SPHERES = (".diameter_error_um", ".form_um", ".x_um", ".y_um", ".z_um")
_TRIALS_PER_FACTOR = 10
_SIZED_BY_METHOD = {"morris", "one_at_a_time"}


def symmetric_interval(sample: Array, probability: float) -> tuple[float, float] | None:
    """Probabilistically symmetric coverage interval of a sample (n,); None if it is too small.

    JCGM 101:2008, 7.7.2: of the values in rising order, y(r) and y(r + q) with q = p M, r = (M - q) / 2.
    """
    count, held = _held(sample, probability)
    if held is None:
        return None
    ordered = np.sort(sample)
    start = (count - held + 1) // 2
    return float(ordered[start - 1]), float(ordered[start + held - 1])


def shortest_interval(sample: Array, probability: float) -> tuple[float, float] | None:
    """Shortest coverage interval of a sample (n,); None if it is too small. JCGM 101:2008, 7.7.4."""
    count, held = _held(sample, probability)
    if held is None:
        return None
    ordered = np.sort(sample)
    start = int(np.argmin(ordered[held:] - ordered[: count - held]))
    return float(ordered[start]), float(ordered[start + held])


def _held(sample: Array, probability: float) -> tuple[int, int | None]:
    """Size of the sample, and the number of steps between its values that the interval spans; one stays outside."""
    held = int(probability * len(sample) + 0.5)
    return len(sample), held if 1 <= held < len(sample) else None


def summary(sample: Array, probability: float) -> dict[str, Any]:
    """Figures of a sample (n,) as plain data."""
    count = len(sample)
    std = float(sample.std(ddof=1)) if count > 1 else None
    return {
        "trials": count,
        "mean": float(sample.mean()) if count else None,
        "standard_deviation": std,
        "standard_error": None if std is None else std / count**0.5,
        "minimum": float(sample.min()) if count else None,
        "maximum": float(sample.max()) if count else None,
        "interval_symmetric": symmetric_interval(sample, probability),
        "interval_shortest": shortest_interval(sample, probability),
    }


def convergence(sample: Array) -> list[dict[str, float]]:
    """Mean, its standard error, and standard deviation of the first n values, for growing n."""
    if len(sample) < 2:
        return []
    counts = np.unique(np.geomspace(2, len(sample), 24).round().astype(int))
    rows = []
    for n in counts:
        std = float(sample[:n].std(ddof=1))
        rows.append(
            {
                "trials": int(n),
                "mean": float(sample[:n].mean()),
                "standard_error": std / n**0.5,
                "standard_deviation": std,
            }
        )
    return rows


def sobol_indices(
    outputs: Array, factors: int, probability: float, seed: int
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """First-order and total indices with bootstrap intervals, and their convergence.

    Parameters
    ----------
    outputs
        (n (factors + 2),) in the order of Saltelli's scheme (`designs`); NaN for trials that failed, whose whole base
        sample is excluded.

    Returns
    -------
    tuple
        Per factor ``first``, ``total`` and their intervals; and, for growing n, lists of ``first`` and ``total``.

    Notes
    -----
    First order by Saltelli et al. 2010, table 2 (b); total by Jansen 1999, table 2 (f) of the same.
    """
    table = outputs.reshape(-1, factors + 2)
    table = table[np.isfinite(table).all(1)]
    if len(table) < 4 or not np.ptp(table) > 0:
        return [], []
    first, total = _saltelli(table)
    rng = np.random.default_rng(seed)
    drawn = [_saltelli(table[rng.integers(0, len(table), len(table))]) for _ in range(_RESAMPLES)]
    tails = [(1 - probability) / 2, (1 + probability) / 2]
    first_ends, total_ends = (np.quantile([d[k] for d in drawn], tails, axis=0) for k in (0, 1))
    rows = [
        {
            "first": float(first[j]),
            "first_interval": first_ends[:, j].tolist(),
            "total": float(total[j]),
            "total_interval": total_ends[:, j].tolist(),
        }
        for j in range(factors)
    ]
    counts = [n for n in 2 ** np.arange(3, 24) if n < len(table)] + [len(table)]
    growing = [(int(n), *_saltelli(table[:n])) for n in counts]
    return rows, [{"base_samples": n, "first": f.tolist(), "total": t.tolist()} for n, f, t in growing]


def _saltelli(table: Array) -> tuple[Array, Array]:
    """First-order and total indices (k,) from outputs (n, k + 2): A, A with column j of B, B."""
    a, mixed, b = table[:, 0], table[:, 1:-1].T, table[:, -1]
    variance = np.var(np.concatenate([a, b]))
    if variance == 0:
        return np.zeros(len(mixed)), np.zeros(len(mixed))
    centred = b - np.mean(np.concatenate([a, b]))
    first = (centred * (mixed - a)).mean(1) / variance
    total = ((a - mixed) ** 2).mean(1) / (2 * variance)
    return first, total


def morris_effects(
    unit_cube: Array, outputs: Array, levels: int, probability: float, seed: int
) -> list[dict[str, Any]]:
    """Elementary effects of each factor: mean, mean of magnitudes with its confidence, spread.

    `unit_cube` (n, k) and `outputs` (n,) are whole trajectories of k + 1 rows; those with a failed trial (NaN) are
    excluded.
    """
    morris = require("SALib.analyze.morris", "studies")
    factors = unit_cube.shape[1]
    whole = np.isfinite(outputs.reshape(-1, factors + 1)).all(1).repeat(factors + 1)
    if whole.sum() < 2 * (factors + 1):
        return []
    found = morris.analyze(
        morris_problem(factors), unit_cube[whole], outputs[whole], conf_level=probability, num_levels=levels, seed=seed
    )
    names = {"mean": "mu", "mean_magnitude": "mu_star", "mean_magnitude_confidence": "mu_star_conf", "spread": "sigma"}
    return [{name: float(found[key][j]) for name, key in names.items()} for j in range(factors)]


def one_at_a_time_budget(
    values: Sequence[Array],
    outputs: Array,
    levels: Sequence[int],
    spreads: Sequence[float],
    probability: float,
    seed: int,
) -> list[dict[str, Any]]:
    """Slope of each factor through its levels, times its standard uncertainty, combined as in GUM 5.1.

    The shares are those of the combined variance of independent factors with linear effects and add up to 1. Intervals
    have the scatter of the outputs about all slopes; they are None where two levels per factor leave none.

    Parameters
    ----------
    outputs
        (1 + sum of levels,), first the trial in which all factors are at their median.
    spreads
        Standard deviation of each factor.
    """
    slopes, precisions, squares, free, start = [], [], 0.0, 0, 1
    for j, count in enumerate(levels):
        chosen = slice(start, start + count)
        good = np.isfinite(outputs[chosen])
        x, y = values[j][chosen][good], outputs[chosen][good]
        fitted = len(x) > 1 and np.ptp(x) > 0
        coefficients = np.polyfit(x, y, 1) if fitted else np.full(2, np.nan)
        slopes.append(float(coefficients[0]))
        precisions.append(float(((x - x.mean()) ** 2).sum()) if fitted else np.inf)
        if fitted:
            squares += float(((y - np.polyval(coefficients, x)) ** 2).sum())
            free += len(x) - 2
        start += count
    known = np.isfinite(slopes)
    scatter = squares / free if free else 0.0
    effects = np.where(known, slopes, 0.0) * spreads
    covariance = np.diag(scatter * np.square(spreads) / precisions)
    forms = ShapleyForms(np.eye(len(slopes)), [(j,) for j in range(len(slopes))], len(slopes))
    *rows, _ = shares_of(Fit(effects, covariance, 0.0, max(free, 1)), forms, probability, seed)
    missing = {} if free else {"share_interval": None, "uncertainty_interval": None}
    return [{"slope": slope, **row, **missing} for slope, row in zip(slopes, rows, strict=True)]


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
    largest = {name: found["budget"][0] for name, found in fitted.items()}
    unsettled = [name for name, row in largest.items() if np.ptp(row["share_interval"]) > row["share"]]
    if unsettled:
        notes.append(f"the interval of the largest share is wider than the share itself: {', '.join(unsettled)}")
    return notes


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
    are_numbers = all(isinstance(value, int | float) for row in rows.plain for value in row["values"][: len(labels)])
    if kind == "one_at_a_time" and whole and are_numbers:
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


def _design_size(study: StudyDescription) -> int:
    listed = [middles(factor.distribution) for factor in study.factor]
    listed += [None] * sum(len(block.paths) for block in study.block)
    return len(design(study.design, listed, study.seed))


def _named(labels: Sequence[str], rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    return [{"factor": label, **row} for label, row in zip(labels, rows, strict=False)]


def _ranked(rows: list[dict[str, Any]], key: str) -> list[dict[str, Any]]:
    return sorted(rows, key=lambda row: -row[key])
