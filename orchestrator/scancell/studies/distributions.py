"""Variation of the factors of a study: distributions by their quantiles, and the population by design."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import block_diag
from scipy.special import ndtr, ndtri

from scancell.config.variation import (
    DiscreteDescription,
    DistributionDescription,
    FactorDescription,
    NormalDescription,
    TruncatedNormalDescription,
    UniformDescription,
    VaryingScansDescription,
)
from scancell.studies.designs import design

Array = NDArray[np.float64]
# Probabilities of exactly 0 or 1 have no finite quantile under a normal distribution.
_SMALLEST = 2.0**-53
Value = bool | int | float | str

_QUANTILES = 20_000  # the variance of a normal distribution is 1e-4 too small by these


def quantiles(distribution: DistributionDescription, probability: ArrayLike) -> NDArray[np.generic]:
    """Values (n,) at cumulative probabilities (n,) in [0, 1]; for a discrete distribution, indices of its values."""
    p = np.clip(np.asarray(probability, float), _SMALLEST, 1 - _SMALLEST)
    match distribution:
        case TruncatedNormalDescription():
            a, b = ndtr((np.array([distribution.low, distribution.high]) - distribution.mean) / distribution.std)
            values = distribution.mean + distribution.std * ndtri(a + p * (b - a))
            return np.asarray(np.clip(values, distribution.low, distribution.high))
        case UniformDescription():
            return np.asarray(distribution.low + p * (distribution.high - distribution.low))
        case NormalDescription():
            return np.asarray(distribution.mean + distribution.std * ndtri(p))
        case DiscreteDescription():
            weights = distribution.weights or (1.0,) * len(distribution.values)
            edges = np.cumsum(weights) / np.sum(weights)
            return np.asarray(np.minimum(np.searchsorted(edges, p, side="right"), len(weights) - 1))


def middles(distribution: DistributionDescription) -> Array | None:
    """Probabilities in the middle of each value of a discrete distribution with a weight above 0; else None."""
    if not isinstance(distribution, DiscreteDescription):
        return None
    weights = np.array(distribution.weights or (1.0,) * len(distribution.values))
    share = weights / weights.sum()
    return np.asarray((np.cumsum(share) - share / 2)[share > 0])


def extremes(distribution: DistributionDescription) -> list[bool | int | float | str]:
    """Bounds of a bounded distribution, all values of a discrete one, the mean of an unbounded one."""
    match distribution:
        case DiscreteDescription():
            return list(distribution.values)
        case UniformDescription():  # includes the truncated normal
            return [distribution.low, distribution.high]
        case _:
            return [distribution.mean]


def correlated_normal(probability: Array, mean: Array, covariance: Array) -> Array:
    """Values (n, k) of a multivariate normal distribution from independent probabilities (n, k).

    Uses the symmetric root of the covariance, which exists for singular matrices too.
    """
    scores = ndtri(np.clip(probability, _SMALLEST, 1 - _SMALLEST))
    size, vectors = np.linalg.eigh(covariance)
    root = (vectors * np.sqrt(np.clip(size, 0, None))) @ vectors.T
    return np.asarray(mean + scores @ root)


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
