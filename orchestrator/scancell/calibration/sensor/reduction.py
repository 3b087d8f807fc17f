"""Elimination of the targets' unknown poses from the linearised residuals of a sensor's calibration.

The rows of a mounting are projected on the complement of what a displacement of its targets can explain, which leaves
a least-squares problem of the sensor's parameters alone (variable projection).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from scancell.calibration.sensor.equations import Block

Array = NDArray[np.float64]
Rows = NDArray[np.bool_]

_RANK = 1e-9  # relative singular value below which a target's symmetry leaves a displacement undetermined
_SCALES = np.array([0.01, 0.01, 0.01, 1e-3, 1e-3, 1e-3])  # rad, m


@dataclass(frozen=True)
class Reduced:
    """Residuals (n,) and their derivative (n, k), per tolerance, and the number of displacements eliminated."""

    residual: Array
    by_parameter: Array
    eliminated: int

    @property
    def degrees_of_freedom(self) -> int:
        """Number of residuals less that of the unknowns."""
        return int(self.residual.size) - int(self.by_parameter.shape[1]) - self.eliminated

    @property
    def covariance(self) -> Array:
        """(k, k) in units of the tolerances, of the stated noise."""
        return np.asarray(np.linalg.pinv(self.by_parameter.T @ self.by_parameter, hermitian=True))


def reduced(blocks: Sequence[Block]) -> Reduced:
    """The least-squares problem of the parameters alone."""
    bases = [_basis(block)[0] for block in blocks]
    pairs = list(zip(blocks, bases, strict=True))
    return Reduced(
        np.concatenate([block.residual - basis @ (basis.T @ block.residual) for block, basis in pairs]),
        np.concatenate([block.by_parameter - basis @ (basis.T @ block.by_parameter) for block, basis in pairs]),
        sum(basis.shape[1] for basis in bases),
    )


def pose_step(block: Block, parameter_step: Array) -> Array:
    """Displacement (6,), or (0,) for known poses, that goes with a step (k,) of the parameters, per tolerance."""
    u, s, vt = _basis(block)
    step = vt.T @ ((u.T @ -(block.residual + block.by_parameter @ parameter_step)) / s)
    return np.asarray(step * _SCALES[: len(step)])


def chosen(blocks: Sequence[Block], kept: Sequence[Rows]) -> list[Block]:
    """The rows of each block that are kept."""
    return [
        Block(*(getattr(block, one.name)[rows] for one in fields(Block)))
        for block, rows in zip(blocks, kept, strict=True)
    ]


def _basis(block: Block) -> tuple[Array, Array, Array]:
    """Singular value decomposition of the scaled derivative by the pose, without undetermined displacements."""
    u, s, vt = np.linalg.svd(block.by_pose * _SCALES[: block.by_pose.shape[1]], full_matrices=False)
    rank = int((s > _RANK * s.max(initial=0.0)).sum())
    return u[:, :rank], s[:rank], vt[:rank]
