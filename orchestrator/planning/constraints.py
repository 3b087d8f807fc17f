"""Static constraints as factors in [0, 1] and their product (Dumitrache & Borangiu, Eqs. 6-8, corrected)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orchestrator.geometry.arm import Arm

Array = NDArray[np.float64]


def joint_range(q: ArrayLike, lower: ArrayLike, upper: ArrayLike, gamma: ArrayLike = 1.0) -> Array:
    """Eq. 7, ``sin(pi (q - lower) / (upper - lower)) ** gamma``: 1 in mid-range, 0 at a limit and beyond it.

    The sine alone is negative outside, so that two joints outside would multiply to a positive score.
    """
    q, lower, upper = (np.asarray(x, float) for x in (q, lower, upper))
    fraction = (q - lower) / (upper - lower)
    inside = (fraction > 0) & (fraction < 1)
    sine = np.sin(np.pi * np.where(inside, fraction, 0.5))
    return np.asarray(np.where(inside, sine ** np.asarray(gamma, float), 0.0))


def clearance(distance: ArrayLike, low: float, high: float, gamma: float = 1.0) -> Array:
    """Eq. 8 with pi/2: 0 below `low`, 1 above `high` (metres), a quarter sine between.

    The published pi falls back to 0 at `high` and then jumps to 1.
    """
    fraction = np.clip((np.asarray(distance, float) - low) / (high - low), 0.0, 1.0)
    return np.asarray(np.sin(np.pi / 2 * fraction) ** gamma)


def product(*factors: ArrayLike) -> Array:
    """Eq. 6: the product of all factors, 0 where any is NaN (a pose that does not exist)."""
    result = np.prod(np.broadcast_arrays(*(np.asarray(f, float) for f in factors)), axis=0)
    return np.asarray(np.nan_to_num(result, nan=0.0))


def arm_metric(arm: Arm, q: ArrayLike) -> Array:
    """Product (...,) of Eq. 7 over the joints of q (..., joints); 0 for NaN."""
    lower, upper = arm.limits
    factors = joint_range(q, lower, upper)
    return product(*np.moveaxis(factors, -1, 0))
