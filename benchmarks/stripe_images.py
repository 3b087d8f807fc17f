"""Stripe images of known rows, and the bound of the accuracy of a row; NumPy only."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

Array = NDArray[np.float64]


def stripe(rows: Array, sigma: Array | float, peak: Array | float, height: int) -> Array:
    """Electrons (height, width) of a Gaussian stripe whose column c is centred at ``rows[c]``, integrated over pixels.

    ``peak`` is the height of the Gaussian before integration.
    """
    edges = (np.arange(height + 1)[:, None] - 0.5 - rows) / sigma
    return peak * sigma * np.sqrt(2.0 * np.pi) * np.diff(ndtr(edges), axis=0)


def cramer_rao(sigma: float, peak: float, offset: float, variance_floor: float) -> float:
    """Cramér-Rao bound (px) of a stripe's row when row, width, area and background are unknown.

    ``offset`` is the sub-pixel position, ``variance_floor`` the variance (electrons²) that is not shot noise.
    """
    rows = np.arange(-40.0, 41.0)
    step = 1e-4

    def model(p: Array) -> Array:
        return p[3] + p[2] * np.diff(ndtr((np.append(rows - 0.5, rows[-1] + 0.5) - p[0]) / p[1]))

    truth = np.array([offset, sigma, peak * sigma * np.sqrt(2.0 * np.pi), 0.0])
    scale = np.array([1.0, 1.0, truth[2], peak])
    jacobian = np.stack(
        [(model(truth + step * scale * e) - model(truth - step * scale * e)) / (2 * step) for e in np.eye(4)]
    )
    information = (jacobian / (model(truth) + variance_floor)) @ jacobian.T
    return float(np.sqrt(np.linalg.inv(information)[0, 0]))


def mean_bound(sigma: float, peak: float, variance_floor: float) -> float:
    """Root mean square of `cramer_rao` over the positions between two pixels, px."""
    offsets = np.linspace(-0.5, 0.5, 9)
    return float(np.sqrt(np.mean([cramer_rao(sigma, peak, offset, variance_floor) ** 2 for offset in offsets])))
