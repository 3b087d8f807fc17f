"""Mistakes that the circles in profiles of a sphere tell: a wrong size or unit, and flange poses that disagree."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from scancell.calibration.cell.points import MeasuredPoints
from scancell.calibration.cell.problem import CalibrationProblem
from scancell.calibration.cell.sphere_start import Circles, SphereStart, circles_of, sphere_start
from scancell.calibration.flange_poses import refuse_misread, refuse_wrong
from scancell.errors import CalibrationError

Array = NDArray[np.float64]

AGREED = 1e-3  # m: rms distance of a sphere's centres up to which they agree
_MOST_NAMED_POSES = 5
_MUCH_BETTER = 1 / 3  # of the distance of the centres, with which a mistake explains it
_UNITS = {"m": 1e3, "um": 1e-3}
_MOST_RADII = 2.5  # radius of circles of a sphere of another size, at most
_LEAST_CIRCLES = 6
_SHARES = (1.0, 1.01, 1.03, 1.1)  # radius of the sphere in terms of that of the largest circle but one
_ABOUT = 0.05  # share
_TINY = 0.05  # of the radius: smaller circles are chance
_WRONG = 2e-3  # m: and ten times the median distance, from which a pose is wrong


def _distance(found: SphereStart | None) -> float:
    """Median distance, m, of the centres of a sphere from the common one; infinite without one."""
    return float("inf") if found is None else float(np.median(found.away))


def wrong_sphere(problem: CalibrationProblem, radius: float, centre: Array) -> str:
    """Size or unit of profiles of a sphere that makes the centres of its circles agree, as a sentence; else empty.

    Parameters
    ----------
    radius, centre
        Of the described sphere, the latter (3,) about where it is on the platter, m.
    """
    data, readings = problem.observations, problem.observations.readings

    def misfit(circles: Circles) -> float:
        return _distance(sphere_start(problem.kinematics, readings, circles, centre))

    own = circles_of(data, radius)
    # A few circles agree by chance.
    limit = min(AGREED, _MUCH_BETTER * misfit(own)) if len(own) >= _LEAST_CIRCLES else AGREED
    if not len(own) or own.radius.max() < _TINY * radius:
        for unit, scale in _UNITS.items():
            scaled = replace(data, points_in_sensor=scale * data.points_in_sensor)
            if misfit(circles_of(scaled, radius)) < limit:
                return f"in {unit} the points of the profiles fit the sphere: check their unit"
    # The first set has all circles of a larger sphere, of which the second has the small ones only.
    for circles in (circles_of(data, radius, _MOST_RADII), own):
        if len(circles) < _LEAST_CIRCLES:
            continue
        top = float(np.sort(circles.radius)[-2])
        least, size = min((misfit(circles.of_sphere(share * top)), share * top) for share in _SHARES)
        if least < limit:
            is_radius = abs(size / (2 * radius) - 1.0) < _ABOUT
            return (
                f"the profiles show circles up to {2e3 * top:.2f} mm across, whose centres agree for a diameter of"
                f" about {2e3 * size:.1f} mm; the description says {2e3 * radius:.6g} mm: correct diameter_mm"
                + (", which seems to hold the radius" if is_radius else "")
            )
    return ""


def check_flange(measured: MeasuredPoints, problem: CalibrationProblem, radius: float, centre: Array) -> None:
    """Raise `CalibrationError` if poses of the flange disagree with the circles in profiles of a sphere.

    The message names what fits (the poses of other rows, another size of the sphere, another convention), or the
    exposures that do not. `radius` and `centre` as in `wrong_sphere`.
    """
    readings, stated = measured.observations.readings, measured.flange
    kinematics, circles = problem.kinematics, circles_of(problem.observations, radius)
    start = sphere_start(kinematics, readings, circles, centre)
    if start is None or stated is None:
        return
    own = _distance(start)

    def misfit(flange: Array) -> float:
        return _distance(sphere_start(kinematics, replace(readings, flange=flange), circles, centre))

    if own > AGREED:
        for rows in (1, -1):
            fits = misfit(np.roll(stated.matrices(), rows, axis=0))
            if fits < min(AGREED, _MUCH_BETTER * own):
                raise CalibrationError(
                    f"the flange poses do not belong to the profiles: the median distance of the sphere's centres is"
                    f" {1e3 * own:.3g} mm; it is {1e3 * fits:.3g} mm with the poses shifted by"
                    f" one exposure, so that each profile has the pose of the exposure"
                    f" {'before' if rows > 0 else 'after'} it",
                    file=measured.flange_path,
                )
        if wrong := wrong_sphere(problem, radius, centre):
            raise CalibrationError(wrong, file=measured.flange_path)
        refuse_misread(stated, misfit, "the profiles of the sphere", "its centres", measured.flange_path)
        return
    limit = max(_WRONG, 10.0 * own)
    name = lambda i: f"exposure {measured.exposures[circles.frame[i]]:g}"  # noqa: E731
    refuse_wrong(start.away, limit, name, ("exposures", "centres of the sphere"), measured.flange_path, _MOST_NAMED_POSES)
