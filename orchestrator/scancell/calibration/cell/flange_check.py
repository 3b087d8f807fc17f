"""Flange poses that disagree with profiles of a sphere: all by a wrong convention, or single ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from scancell.calibration.cell.kinematics import CellKinematics
from scancell.calibration.cell.points import MeasuredPoints
from scancell.calibration.cell.sphere_start import Circles, sphere_start
from scancell.calibration.flange_poses import refuse_misread, refuse_wrong

Array = NDArray[np.float64]

AGREED = 1e-3  # m: rms distance of a sphere's centres up to which they agree
_MOST_NAMED = 5
_WRONG = 2e-3  # m: and ten times the median distance, from which a pose is wrong


def check_flange(measured: MeasuredPoints, kinematics: CellKinematics, circles: Circles, centre: Array) -> None:
    """Raise `CalibrationError` if poses of the flange disagree with the circles in profiles of a sphere.

    The message names the convention that fits, or the exposures that do not.
    """
    readings, stated = measured.observations.readings, measured.flange
    start = sphere_start(kinematics, readings, circles, centre)
    if start is None or stated is None:
        return

    def misfit(flange: Array) -> float:
        found = sphere_start(kinematics, replace(readings, flange=flange), circles, centre)
        return float("inf") if found is None else float(np.median(found.away))

    if np.median(start.away) > AGREED:
        refuse_misread(stated, misfit, "the profiles of the sphere", "its centres", measured.flange_path)
        return
    limit = max(_WRONG, 10.0 * float(np.median(start.away)))
    name = lambda i: f"exposure {measured.exposures[circles.frame[i]]:g}"  # noqa: E731
    refuse_wrong(start.away, limit, name, ("exposures", "centres of the sphere"), measured.flange_path, _MOST_NAMED)
