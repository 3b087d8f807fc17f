"""Adjustment of an element to points: least squares (Gauss-Newton, damped) and minimum zone (linear programs)."""

from __future__ import annotations

from typing import TypeVar

import numpy as np

from scancell.geometry.fits.elements import Array, Element

E = TypeVar("E", bound=Element)

_ITERATIONS = 500
_ROUNDING = 1e-15  # of the extent of the points: steps that move the surface less change nothing
_SETTLED = 1e-11  # of the extent: below, the sum of squares is constant within rounding and no longer decides
_DAMPING = 1e-4
_MOST_DAMPING = 1e12
_ZONE_ITERATIONS = 60
_ZONE_PRECISION = 1e-11  # relative decrease of the zone below which the search ends
_WORKING_SET = 400  # points of the first linear program of a step
_TRUST = 0.1  # first limit of a step, of the extent


def least_squares(element: E, points: Array, iterations: int = _ITERATIONS) -> tuple[E, float]:
    """Element with the least sum of squared distances from points (n, 3) of extent about 1, and that sum.

    Gauss-Newton steps, damped after Levenberg and Marquardt where a step does not lower the sum.
    """
    residual, jacobian = element.linearised(points)
    cost, damping, smallest = float(residual @ residual), 0.0, np.inf
    for _ in range(iterations):
        step = _damped_step(jacobian, residual, damping)
        change = float(np.abs(jacobian @ step).max())
        moved = element.moved(step)
        new_residual, new_jacobian = moved.linearised(points)
        new_cost = float(new_residual @ new_residual)
        if new_cost < cost or change < _SETTLED:
            if change >= smallest and change < _SETTLED:
                break
            element, residual, jacobian, cost = moved, new_residual, new_jacobian, new_cost
            damping = damping / 10 if damping > _DAMPING**2 else 0.0
            smallest = min(smallest, change)
            if change < _ROUNDING:
                break
        else:
            damping = max(10 * damping, _DAMPING)
            if damping > _MOST_DAMPING:
                break
    return element, cost


def _damped_step(jacobian: Array, residual: Array, damping: float) -> Array:
    length = np.sqrt(np.einsum("nk,nk->k", jacobian, jacobian)) + 1e-300
    matrix, right = jacobian / length, -residual
    if damping:
        size = jacobian.shape[1]
        matrix = np.concatenate([matrix, np.sqrt(damping) * np.eye(size)])
        right = np.concatenate([right, np.zeros(size)])
    q, r = np.linalg.qr(matrix)
    return np.asarray(np.linalg.lstsq(r, q.T @ right, rcond=1e-13)[0] / length)


def minimum_zone(element: E, points: Array) -> E:
    """Element with the least largest distance from points (n, 3) of extent about 1, from one that is near.

    Successive linear programs: the distances are linearised, the largest is minimised within a limit of the step,
    and the limit adapts to how well the prediction holds (Anthony, Anthony, Cox and Forbes, "Chebyshev reference
    software for the evaluation of coordinate measuring machine data", 1993).
    """
    residual, jacobian = element.linearised(points)
    zone, limit = float(np.abs(residual).max()), _TRUST
    for _ in range(_ZONE_ITERATIONS):
        if zone < _ROUNDING:
            break
        step, predicted = _chebyshev_step(residual, jacobian, zone, limit)
        moved = element.moved(step)
        new_residual, new_jacobian = moved.linearised(points)
        new_zone = float(np.abs(new_residual).max())
        gain, promised = zone - new_zone, zone - predicted
        if promised <= _ZONE_PRECISION * zone:
            break
        limit *= 2.0 if gain > 0.75 * promised else 0.25 if gain < 0.25 * promised else 1.0
        if gain > 0:
            element, residual, jacobian, zone = moved, new_residual, new_jacobian, new_zone
        elif limit < _ROUNDING:
            break
    return element


def _chebyshev_step(residual: Array, jacobian: Array, zone: float, limit: float) -> tuple[Array, float]:
    """Step (k,) that minimises the largest linearised distance, and that distance.

    The linear program holds few of the points; those that its solution violates are added until there is none.
    """
    from scipy.optimize import linprog  # noqa: PLC0415  (half a second)

    size = jacobian.shape[1]
    scaled = residual / zone
    chosen = np.argsort(-np.abs(scaled), kind="stable")[:_WORKING_SET]
    goal = np.append(np.zeros(size), 1.0)
    bounds = [(-limit / zone, limit / zone)] * size + [(0.0, None)]
    options = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}
    while True:
        rows, right, one = jacobian[chosen], scaled[chosen], np.ones((len(chosen), 1))
        matrix = np.concatenate([np.hstack([rows, -one]), np.hstack([-rows, -one])])
        found = linprog(goal, matrix, np.concatenate([-right, right]), bounds=bounds, method="highs", options=options)
        if found.x is None:
            return np.zeros(size), zone
        distance = np.abs(scaled + jacobian @ found.x[:-1])
        outside = np.flatnonzero(distance > found.x[-1] + 1e-9)
        missing = np.setdiff1d(outside, chosen)
        if len(missing) == 0:
            return zone * found.x[:-1], zone * float(distance.max())
        worst = missing[np.argsort(-distance[missing], kind="stable")[:_WORKING_SET]]
        chosen = np.concatenate([chosen, worst])
