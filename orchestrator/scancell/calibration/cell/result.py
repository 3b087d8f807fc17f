"""Result of a calibration: deviations from nominal with covariance, residuals, and the size of the noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtri, stdtrit

from scancell.calibration.cell.kinematics import UNIT, written_unit

Array = NDArray[np.float64]

_EFFECT = {"mm": 1.0, "deg": 0.1, "ms": 0.05}  # mm, of 1 mm, 1 mrad at 100 mm, 1 ms at 50 mm/s
_MAIN = 0.3  # share of the largest effect in a direction from which an unknown is named


@dataclass(frozen=True)
class Direction:
    """A direction in the space of the deviations, in mm, mrad and ms: unit vector (p,), and its standard deviation."""

    vector: Array
    standard_deviation: float

    def text(self, names: Sequence[str]) -> str:
        """The deviations that it consists of, such as ``tool.z - table.x``."""
        effect = self.vector * np.array([_EFFECT[written_unit(name)[0]] for name in names])
        order = np.argsort(-np.abs(effect))
        main = [i for i in order if abs(effect[i]) >= _MAIN * abs(effect[order[0]])]
        sign = np.sign(effect[main[0]])
        words = [("+ " if sign * effect[i] > 0 else "- ") + names[i] for i in main]
        return " ".join(words).removeprefix("+ ")


@dataclass(frozen=True)
class CalibrationResult:
    """Calibrated deviations.

    Attributes
    ----------
    names, values
        The p deviations that were found, SI.
    covariance
        (p, p) of `values`.
    degrees_of_freedom
        (p,) of each variance; small where the noise of few exposures was estimated.
    held
        Deviations that were given and kept.
    platter_from_artefact
        (4, 4) pose of the artefact.
    sizes, size_standard_deviations
        Offsets (s,) of the surfaces with unknown size, m.
    residuals, frame
        Distance of each used point to the artefact (k,), m, and its exposure (k,).
    points
        Number of points, those that were not used included.
    noise_of_points
        Standard deviation of points relative to the stated one.
    noise_of_robot
        Standard deviations of pose errors: joints (rad), or position (m) and orientation (rad) of the flange.
    """

    names: tuple[str, ...]
    values: Array
    covariance: Array
    degrees_of_freedom: Array
    held: Mapping[str, float]
    platter_from_artefact: Array
    sizes: Array
    size_standard_deviations: Array
    residuals: Array
    frame: NDArray[np.intp]
    points: int
    noise_of_points: float
    noise_of_robot: tuple[float, ...]

    @property
    def deviations(self) -> dict[str, float]:
        """All deviations by name, SI: found and held ones."""
        return {**self.held, **dict(zip(self.names, self.values.tolist(), strict=True))}

    @property
    def standard_deviations(self) -> Array:
        """(p,) of `values`."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def directions(self) -> list[Direction]:
        """Principal directions of the covariance, the least certain one first: what the exposures determine least."""
        values, vectors = np.linalg.eigh(self.covariance / UNIT**2)
        return [Direction(vectors[:, i], float(np.sqrt(values[i]))) for i in reversed(range(len(values)))]

    @property
    def rms(self) -> float:
        """Root mean square distance of the used points to the artefact, m."""
        return float(np.sqrt(np.mean(self.residuals**2)))

    def half_widths(self, probability: float = 0.95) -> Array:
        """Half widths (p,) of the intervals about `values` that contain the true ones with `probability` each."""
        factor = stdtrit(self.degrees_of_freedom, 0.5 + probability / 2)
        return np.asarray(factor * self.standard_deviations)

    def contains(self, true: Array, probability: float = 0.95) -> bool:
        """Whether the joint confidence region (an ellipsoid) contains the true values (p,)."""
        away, count = true - self.values, len(self.values)
        square = float(away @ np.linalg.solve(self.covariance, away)) / count
        return bool(square <= fdtri(count, float(self.degrees_of_freedom.min()), probability))
