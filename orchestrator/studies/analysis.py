"""What a study's rows say: figures with their intervals, who contributes how much, and how settled that is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.config.study import StudyDescription
from orchestrator.studies.designs import design, hashed
from orchestrator.studies.distributions import middles, quantiles
from orchestrator.studies.intervals import convergence, summary
from orchestrator.studies.sensitivity import (
    morris_effects,
    one_at_a_time_budget,
    regression_budget,
    regressors,
    sobol_indices,
)

Array = NDArray[np.float64]

# Figures that are looked at more closely, where a study has them.
_CLOSER = ("mean_um", "rms_um", "d95_um", ".diameter_error_um", ".form_um", ".x_um", ".y_um", ".z_um")
# Fewer rows than this per regressor make a square a guess.
_ROWS_PER_REGRESSOR = 5


@dataclass(frozen=True)
class Rows:
    """Rows of one engine by trial number, aligned with the design; `figures` (n,) have NaN where a trial gave none."""

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


def analyse(study: StudyDescription, labels: Sequence[str], rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Plain data for ``study.json``: what was made, what failed, and per engine what the figures say."""
    failed = [row for row in rows if row["status"] != "ok"]
    engines = list(dict.fromkeys(row["engine"] for row in sorted(rows, key=lambda row: int(row["number"]))))
    return {
        "name": study.name,
        "design": study.design.model_dump(mode="json"),
        "factors": list(labels),
        "probability": study.probability,
        "trials": len(rows),
        "failed": [{"trial": r["number"], "seed": r["seed"], "message": r["message"]} for r in failed],
        "engines": {
            engine: _engine(study, labels, Rows.of([row for row in rows if row["engine"] == engine]))
            for engine in engines
        },
    }


def closer_figures(names: Sequence[str]) -> list[str]:
    """Those of the figures whose contributors are worth a look."""
    return [name for name in names if name in _CLOSER or name.endswith(tuple(c for c in _CLOSER if c[0] == "."))]


def _engine(study: StudyDescription, labels: Sequence[str], rows: Rows) -> dict[str, Any]:
    drawn = independent_rows(study.design.kind, len(labels), len(rows.plain))
    found: dict[str, Any] = {
        "figures": {name: summary(_known(values[drawn]), study.probability) for name, values in rows.figures.items()},
        "closer": {},
    }
    for name in closer_figures(list(rows.figures)):
        found["closer"][name] = {
            "convergence": convergence(_known(rows.figures[name][drawn])),
            **_contributors(study, labels, rows, rows.figures[name]),
        }
    return found


def _known(values: Array) -> Array:
    return values[np.isfinite(values)]


def independent_rows(kind: str, factors: int, count: int) -> NDArray[np.bool_]:
    """(count,) which rows of a kind of design are independent draws: all but the mixed ones of Saltelli's scheme."""
    if kind != "sobol":
        return np.ones(count, bool)
    place = np.arange(count) % (factors + 2)
    return np.asarray((place == 0) | (place == factors + 1))


def _contributors(study: StudyDescription, labels: Sequence[str], rows: Rows, outputs: Array) -> dict[str, Any]:
    """What the design allows to say about who contributes; `ranking` names factors in falling order."""
    seed, kind = hashed(study.seed, 3, 0) >> 33, study.design.kind
    whole = kind in {"sobol", "morris", "one_at_a_time"} and len(rows.plain) == _design_size(study)
    if kind == "sobol" and whole:
        indices, growing = sobol_indices(outputs, len(labels), study.probability, seed)
        shares = [{"share": row["first"], "share_interval": row["first_interval"]} for row in indices]
        named = _named(labels, indices)
        return {"sobol": named, "sobol_convergence": growing, "budget": _ranked(_named(labels, shares), "share")}
    if kind == "morris" and whole:
        low, high = study.design.quantiles
        cube = (design(study.design, [None] * len(labels), study.seed) - low) / (high - low)
        effects = morris_effects(cube, outputs, study.design.levels, study.probability, seed)
        return {"morris": _ranked(_named(labels, effects), "mean_magnitude")}
    if kind == "one_at_a_time" and whole and _all_numbers(rows, len(labels)):
        return {"budget": _ranked(_named(labels, _slopes(study, rows, outputs)), "share")}
    return _regression(study, labels, rows, outputs, seed)


def _regression(
    study: StudyDescription, labels: Sequence[str], rows: Rows, outputs: Array, seed: int
) -> dict[str, Any]:
    good = np.isfinite(outputs)
    kept = [row["values"] for row, ok in zip(rows.plain, good, strict=True) if ok]
    if not kept:
        return {"budget": []}
    quadratic = len(kept) >= _ROWS_PER_REGRESSOR * 2 * len(labels)
    columns = [regressors([values[j] for values in kept], quadratic) for j in range(len(labels))]
    shares, explained = regression_budget(columns, outputs[good], study.probability, seed)
    if not shares:
        return {"budget": []}
    return {"budget": _ranked(_named(labels, shares), "share"), "explained": explained, "quadratic": quadratic}


def _slopes(study: StudyDescription, rows: Rows, outputs: Array) -> list[dict[str, Any]]:
    values = [np.array([row["values"][j] for row in rows.plain], float) for j in range(len(study.factor))]
    listed = [middles(factor.distribution) for factor in study.factor]
    levels = [study.design.levels if found is None else len(found) for found in listed]

    def spread(j: int) -> float:
        distribution = study.factor[j].distribution
        drawn = quantiles(distribution, (np.arange(2000) + 0.5) / 2000)
        if listed[j] is not None:
            drawn = np.array(getattr(distribution, "values"), float)[drawn.astype(int)]  # noqa: B009
        return float(np.std(drawn.astype(float)))

    return one_at_a_time_budget(values, outputs, levels, spread)


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
