"""Flange poses that disagree with profiles of a sphere: all by a wrong convention, or single ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from scancell.calibration.cell.kinematics import CellKinematics
from scancell.calibration.cell.points import MeasuredPoints
from scancell.calibration.cell.sphere_start import Circles, sphere_start
from scancell.errors import CalibrationError
from scancell.geometry.pose_conventions import better_reading

Array = NDArray[np.float64]

AGREED = 1e-3  # m: rms distance of a sphere's centres up to which they agree
_WRONG = 2e-3  # m: and ten times the median distance, from which a pose is wrong
_MOST_WRONG = 1 / 3  # of the exposures
_MOST_NAMED = 5


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
        better = better_reading(stated, misfit)
        if better is None:
            return
        reading, fits, own = better
        raise CalibrationError(
            f"the flange poses do not fit the profiles of the sphere as {stated.reading.text()}: the median distance of"
            f" its centres is {1e3 * own:.3g} mm; they fit to {1e3 * fits:.3g} mm as {reading.text()}",
            file=measured.flange_path,
        )
    wrong = np.flatnonzero(start.away > max(_WRONG, 10.0 * float(np.median(start.away))))
    if len(wrong) and len(wrong) < _MOST_WRONG * len(circles):
        named = [
            f"exposure {measured.exposures[circles.frame[i]]:g} by {1e3 * start.away[i]:.1f} mm"
            for i in wrong[:_MOST_NAMED]
        ]
        raise CalibrationError(
            f"{len(wrong)} of {len(circles)} exposures disagree with the others, whose centres of the sphere agree to"
            f" {1e3 * float(np.median(start.away)):.3f} mm (median): {', '.join(named)}; correct their flange poses, or"
            " leave them out",
            file=measured.flange_path,
        )
