"""Set-points of programs through given points."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from scancell.nominal.cell import NominalCell

Array = NDArray[np.float64]

_CYCLE = 0.016  # s
_WITHIN = 0.9  # of the limits of the axes
_SAMPLES = 400
_LONGER = 1.05
_LONGEST = 120.0  # s
_RAMP = 0.15  # share of the time in which the speed rises, and falls


def program_points(nominal: NominalCell, through: Sequence[Array], speed: float, cycle: float = _CYCLE) -> Array:
    """Set-points (n, joints + 1), rad, one per `cycle` (s), through points at a share of the full speed.

    The path is a cubic spline through the points; its speed rises smoothly from rest, is even, and falls to rest.
    """
    points = np.array(through)
    lengths = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1) + 1e-9))
    path = CubicSpline(lengths / lengths[-1], points)
    share = np.linspace(0.0, 1.0, _SAMPLES)
    axes = path(_eased(share))
    rates = np.abs(np.gradient(axes, share, axis=0)).max(0)
    bends = np.abs(np.gradient(np.gradient(axes, share, axis=0), share, axis=0)).max(0)
    by_speed = float((rates / (_WITHIN * speed * nominal.axis_max_speed)).max())
    by_bend = float(np.sqrt(bends / (_WITHIN * nominal.axis_max_acceleration)).max())
    cycles = max(int(np.ceil(min(_LONGER * max(by_speed, by_bend), _LONGEST) / cycle)), 8)
    return np.asarray(path(_eased(np.linspace(0.0, 1.0, cycles + 1))))


def _eased(share: Array) -> Array:
    """Course (n,) from 0 to 1, at rest with no acceleration at both ends; even but for the `_RAMP` at each end."""
    ramp = np.clip(np.minimum(share, 1.0 - share) / _RAMP, 0.0, 1.0)
    gained = _RAMP * ramp**3 * (1.0 - ramp / 2)  # integral of the speed ramp² (3 - 2 ramp)
    even = gained + np.clip(np.minimum(share, 1.0 - share) - _RAMP, 0.0, None)
    total = 1.0 - _RAMP
    return np.asarray(np.where(share < 0.5, even, total - even) / total)
