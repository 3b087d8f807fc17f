"""Static constraint metric: factors in [0, 1] and their product (Dumitrache & Borangiu, Eqs. 6-8, corrected)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from scancell.arrays import Array
from scancell.geometry.arm import Arm


def joint_range(q: ArrayLike, lower: ArrayLike, upper: ArrayLike, gamma: ArrayLike = 1.0) -> Array:
    """Joint-range factor of Eq. 7, ``sin(pi (q - lower) / (upper - lower)) ** gamma``, of broadcast shape.

    1 in mid-range, 0 at a limit and outside. The published sine is negative outside, so that two joints outside
    their limits would multiply to a positive score. Angles in radians.
    """
    q, lower, upper = (np.asarray(x, float) for x in (q, lower, upper))
    fraction = (q - lower) / (upper - lower)
    inside = (fraction > 0) & (fraction < 1)
    sine = np.sin(np.pi * np.where(inside, fraction, 0.5))
    return np.asarray(np.where(inside, sine ** np.asarray(gamma, float), 0.0))


def clearance(
    distance: ArrayLike, low: ArrayLike, high: ArrayLike, gamma: float | Array = 1.0, printed: bool = False
) -> Array:
    """Clearance factor of Eq. 8 with pi/2: 0 below `low`, 1 above `high` (m), a quarter period of a sine between.

    With the pi that is `printed` the factor returns to 0 at `high` and then jumps to 1.
    """
    distance, low, high = (np.asarray(x, float) for x in (distance, low, high))
    fraction = np.clip((distance - low) / (high - low), 0.0, 1.0)
    if printed:
        return np.asarray(np.where(fraction < 1, np.maximum(np.sin(np.pi * fraction), 0.0) ** gamma, 1.0))
    return np.asarray(np.sin(np.pi / 2 * fraction) ** gamma)


def product(*factors: ArrayLike) -> Array:
    """Product of all factors (Eq. 6), of broadcast shape; 0 where any factor is NaN (no inverse kinematics)."""
    result = np.prod(np.broadcast_arrays(*(np.asarray(f, float) for f in factors)), axis=0)
    return np.asarray(np.nan_to_num(result, nan=0.0))


def arm_metric(arm: Arm, q: ArrayLike, gamma: ArrayLike = 1.0) -> Array:
    """Product (...,) of the joint-range factors of q (..., joints), rad; 0 for NaN. `gamma`: one, or (joints,)."""
    lower, upper = arm.limits
    factors = joint_range(q, lower, upper, gamma)
    return product(*np.moveaxis(factors, -1, 0))
