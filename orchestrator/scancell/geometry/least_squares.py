"""Least squares by damped Gauss-Newton steps, none of which raises the sum of squares, and what its data determine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np

from scancell.arrays import Array

S = TypeVar("S")

_SETTLED = 1e-10  # predicted decrease of the sum of squares that moves no unknown any more
_ROUNDING = 1e-8  # share of the sum of squares, by which rounding and curvature may hide a decrease
_MOST_DAMPING = 1e2  # beyond which steps are too short to matter
_DAMPING = 1e-4  # first damping after a step that raises the sum
_DEPENDENT = 1e-11  # share of the largest information, of columns of equal length, that is rounding
_ROUNDING_OF_ROWS = 1e-13  # share of the largest singular value, likewise


class Linearised(Protocol):
    """Residuals to first order in a step of the unknowns: `LinearResiduals` or `NormalEquations`."""

    @property
    def squares(self) -> float:
        """Sum of squares."""

    def step(self, damping: float = 0.0) -> tuple[Array, float]:
        """The step (p,), damped after Levenberg and Marquardt, and the decrease of the sum that it promises."""


@dataclass(frozen=True)
class LinearResiduals:
    """Residuals (n,) and their derivatives (n, p): a step by QR keeps the digits that normal equations lose."""

    residual: Array
    jacobian: Array

    @property
    def squares(self) -> float:
        """Sum of squares."""
        return float(self.residual @ self.residual)

    def step(self, damping: float = 0.0) -> tuple[Array, float]:
        """See `Linearised`."""
        length = np.sqrt(np.einsum("np,np->p", self.jacobian, self.jacobian)) + 1e-300
        damped = np.sqrt(damping) * np.eye(len(length))
        q, r = np.linalg.qr(np.concatenate([self.jacobian / length, damped]))
        right = q.T @ np.concatenate([-self.residual, np.zeros(len(length))])
        scaled = np.linalg.lstsq(r, right, rcond=_ROUNDING_OF_ROWS)[0]
        change = r @ scaled
        return scaled / length, float(change @ (2.0 * right - change))


@dataclass(frozen=True)
class NormalEquations:
    """Information (p, p) and gradient (p,) of the unknowns, and the sum of squares, in units of the noise.

    The step to the least sum solves ``information @ step = gradient``. Where other parameters are eliminated, such as
    errors of poses, `reduced` is the sum to which they can lower it alone.
    """

    information: Array
    gradient: Array
    squares: float
    reduced: float

    @property
    def rank(self) -> int:
        """Number of combinations of unknowns that change anything."""
        values = np.linalg.eigvalsh(_scaled(self.information)[0])
        return int((values > _DEPENDENT * max(values[-1], 0.0)).sum())

    def step(self, damping: float = 0.0) -> tuple[Array, float]:
        """The step (p,), damped after Levenberg and Marquardt, and the decrease of the sum that it promises.

        Combinations of unknowns that change nothing stay.
        """
        scaled, length = _scaled(self.information)
        values, vectors = np.linalg.eigh(scaled)
        inverse = np.where(values > _DEPENDENT * max(values[-1], 0.0), 1.0 / np.maximum(values + damping, 1e-300), 0.0)
        step = vectors @ (inverse * (vectors.T @ (self.gradient / length))) / length
        gain = float(2.0 * self.gradient @ step - step @ self.information @ step)
        return step, self.squares - self.reduced + gain


def minimise(
    linearised: Callable[[S], tuple[Linearised, Callable[[Array], S]]],
    state: S,
    most_steps: int,
    settled: float = _SETTLED,
) -> tuple[S, bool]:
    """The state of the least sum of squares near a start, and whether the steps ended there.

    A step that does not lower the sum is repeated with more damping. Where rounding hides the decrease, steps go on as
    long as they become shorter: where a surface has facets, they do not become zero.

    Parameters
    ----------
    linearised
        Residuals to first order at a state, and the state after a step of the unknowns from it.
    settled
        Predicted decrease of the sum of squares, in units of the noise, that no longer counts: 1e-4 moves unknowns by
        0.01 of their standard deviations at most.
    """
    (at, moved), damping, last = linearised(state), 0.0, np.inf
    for _ in range(most_steps):
        step, promised = at.step(damping)
        if promised <= settled:
            return state, True
        further = moved(step)
        beyond, moved_further = linearised(further)
        is_hidden = promised <= _ROUNDING * at.squares
        if promised < last if is_hidden else beyond.squares < at.squares:
            state, at, moved, last = further, beyond, moved_further, promised
            damping = damping / 10 if damping > _DAMPING**2 else 0.0
        elif is_hidden or damping > _MOST_DAMPING:
            return state, True
        else:
            damping = max(10 * damping, _DAMPING)
    return state, False


def undetermined(information: Array, effect: Array, largest: float) -> list[tuple[Array, float]]:
    """Directions (p,) of unit length that the data do not determine, with their standard deviations.

    They are those without information, and those along which the uncertainty has too large an effect.

    Parameters
    ----------
    information
        (p, p) on the unknowns, all others eliminated.
    effect
        (p, p) mean square of what the unknowns move, as a quadratic form.
    largest
        Limit of its root.
    """
    scaled, length = _scaled(information)
    values, vectors = np.linalg.eigh(scaled)
    missing = values <= _DEPENDENT * max(values[-1], 0.0)
    found = [(vector / length, np.inf) for vector in vectors.T[missing]]
    if not found:
        root = vectors / np.sqrt(values) / length[:, None]  # root @ root.T is the covariance
        spread, turned = np.linalg.eigh(root.T @ effect @ root)
        far = np.sqrt(np.maximum(spread, 0.0)) > largest
        found = [(root @ one, 1.0) for one in turned.T[far][::-1]]
    return [(vector / np.linalg.norm(vector), deviation * float(np.linalg.norm(vector))) for vector, deviation in found]


def without(information: Array, count: int) -> Array:
    """Information (count, count) on the first unknowns, the others eliminated."""
    across, others = information[:count, count:], information[count:, count:]
    reduced = information[:count, :count]
    if len(others):
        scaled, length = _scaled(others)
        across = across / length
        reduced = reduced - across @ np.linalg.pinv(scaled, _DEPENDENT, True) @ across.T
    return np.asarray((reduced + reduced.T) / 2)


def _scaled(information: Array) -> tuple[Array, Array]:
    """Information with unknowns in units of their own standard deviations, and those factors (p,)."""
    length = np.sqrt(np.maximum(np.diag(information), 0.0))
    length = np.where(length > 0, length, 1.0)
    return information / np.outer(length, length), length
