"""Design of poses: which exposures determine the unknowns best, by the covariance that is to be expected."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scancell.calibration.cell.kinematics import UNIT
from scancell.calibration.cell.noise import informations
from scancell.calibration.cell.problem import CalibrationProblem
from scancell.calibration.cell.solve import moments_of

Array = NDArray[np.float64]

_PRIOR = 1e-4  # information per unit² (10 mm, 100 ms ...): the first poses alone determine nothing


@dataclass(frozen=True)
class PoseDesign:
    """Chosen candidates.

    Attributes
    ----------
    rows
        (c,) rows of the candidates, best first.
    expected
        (c, p) standard deviations of the free deviations to be expected after each choice, SI.
    """

    rows: NDArray[np.intp]
    expected: Array


def design_poses(candidates: CalibrationProblem, log_variances: Array, count: int) -> PoseDesign:
    """Choose `count` of the exposures in a problem, each time the one that lowers the mean variance most (A-optimal).

    Parameters
    ----------
    candidates
        Problem whose observations are those to be expected: exact points, with standard deviations.
    log_variances
        Logarithms of the variances of points, relative to their stated one, and of pose errors, SI.

    Notes
    -----
    Variances are added in units of 1 mm, 1 mrad and 1 ms. A candidate is chosen once at most.
    """
    each = informations(moments_of(candidates), log_variances)
    free = len(candidates.free)
    total = _PRIOR * np.eye(each.shape[-1])
    left = np.ones(len(each), bool)
    rows, expected = [], []
    for _ in range(min(count, len(each))):
        covariance = np.linalg.inv(total + each)
        cost = np.where(left, np.trace(covariance[:, :free, :free], axis1=1, axis2=2), np.inf)
        best = int(cost.argmin())
        left[best] = False
        total = total + each[best]
        rows.append(best)
        expected.append(np.sqrt(np.diag(covariance[best])[:free]) * UNIT)
    return PoseDesign(np.array(rows, np.intp), np.array(expected))
