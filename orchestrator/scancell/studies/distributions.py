"""Distributions by their quantiles, so that any design of points in the unit cube becomes values."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr, ndtri

from scancell.config.variation import (
    DiscreteDescription,
    DistributionDescription,
    NormalDescription,
    TruncatedNormalDescription,
    UniformDescription,
)

Array = NDArray[np.float64]
# Probabilities of exactly 0 or 1 have no finite quantile under a normal distribution.
_SMALLEST = 2.0**-53


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
