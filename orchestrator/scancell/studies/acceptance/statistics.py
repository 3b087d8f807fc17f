"""Statistics of an acceptance test: mean, standard uncertainty, intervals, contributions, largest over the range."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from scancell.studies.acceptance.measure import Samples, Trial
from scancell.studies.budget import Terms, variance_budget
from scancell.studies.intervals import summary

Array = NDArray[np.float64]

PROBABILITY = 0.95
REPEATABILITY = "repeatability"


def figure_rows(samples: Sequence[Samples]) -> list[dict[str, Any]]:
    """A row per characteristic and station: statistics of its error over the repeats (JCGM 101)."""
    return [_row(one) for one in samples]


def _row(one: Samples) -> dict[str, Any]:
    errors = np.array(one.errors)
    said = summary(errors, PROBABILITY)
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
        "mean": said["mean"],
        "standard_uncertainty": said["standard_deviation"],
        "interval_symmetric": said["interval_symmetric"],
        "interval_shortest": said["interval_shortest"],
        "minimum": said["minimum"],
        "maximum": said["maximum"],
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
    faces = np.concatenate([np.full(len(one.errors), _number_of(one.of, own)) for one in own])
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


def _number_of(face: str, own: Sequence[Samples]) -> int:
    """Number of a face among those of a characteristic."""
    return list(dict.fromkeys(one.of for one in own)).index(face)
