"""How the factors of a study vary by design: their distributions and correlations, not those of the trials."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from scancell.config.variation import DiscreteDescription, FactorDescription, NormalDescription, VaryingScansDescription
from scancell.studies.designs import design
from scancell.studies.distributions import middles, quantiles

Array = NDArray[np.float64]
Value = bool | int | float | str

_QUANTILES = 20_000  # the variance of a normal distribution is 1e-4 too small by these


@dataclass(frozen=True)
class Population:
    """Equally probable values of each factor, and the correlation (factors, factors) of normally distributed ones."""

    values: Sequence[NDArray[np.generic]]
    correlation: Array


def population_of(study: VaryingScansDescription) -> Population:
    """The population of a study's factors, blocks last; of a full factorial design its points."""
    middle = (np.arange(_QUANTILES) + 0.5) / _QUANTILES
    probabilities = np.tile(middle[:, None], len(study.labels))
    if study.design.kind == "full_factorial":
        probabilities = design(study.design, [middles(factor.distribution) for factor in study.factor], study.seed)
    values = [np.array(values_at(factor, probabilities[:, j])) for j, factor in enumerate(study.factor)]
    correlations = [np.eye(len(study.factor))]
    for block in study.block:
        std = np.sqrt(np.diag(block.covariance_matrix))
        correlations.append(block.covariance_matrix / np.outer(std, std))
        for mean, deviation in zip(block.mean or np.zeros(len(std)), std, strict=True):
            normal = NormalDescription(kind="normal", mean=float(mean), std=float(deviation))
            values.append(quantiles(normal, middle))
    return Population(values, block_diag(*correlations))


def values_at(factor: FactorDescription, probabilities: Array) -> list[Value]:
    """Values (n,) of a factor at cumulative probabilities (n,)."""
    drawn = quantiles(factor.distribution, probabilities).tolist()
    if isinstance(factor.distribution, DiscreteDescription):
        return [factor.distribution.values[position] for position in drawn]
    return list(drawn)
