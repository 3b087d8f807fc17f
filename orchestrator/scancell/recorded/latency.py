"""Delay of the exposures after the latched joints, from measurements of a part in different directions of motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from scancell.calibration.cell.kinematics import LATENCY
from scancell.calibration.cell.problem import Artefact, CalibrationProblem, Observations, surface_of
from scancell.calibration.cell.scan import kinematics_of, on_artefact
from scancell.calibration.cell.solve import solve
from scancell.errors import CalibrationError
from scancell.nominal.cell import NominalCell
from scancell.recorded.measurements import Measurements


@dataclass(frozen=True)
class Latency:
    """A delay, s; `half_width` is that of its 95 % interval where it was estimated, else None."""

    value: float
    half_width: float | None = None


def estimate_latency(found: Measurements, nominal: NominalCell, start: Mapping[str, float], has_part: bool) -> Latency:
    """The delay at which the points of the part agree best, as `scancell calibrate latency` estimates it.

    The pose of the part is found as well: what determines the delay is that points of motions in different directions
    agree with one shape.

    Raises `CalibrationError` if rates or the part are not given, or the measurements do not determine the delay.

    Parameters
    ----------
    nominal
        The cell with its part.
    start
        Deviations of the cell by name, SI, with the delay to start from.
    """
    if found.stated is not None:
        raise CalibrationError(
            "flange poses state no rates, without which a delay cannot be estimated",
            file=found.poses_file,
            expected="joints with rates (q1_deg, qd1_deg_s, …), or `latency_ms` as a number",
        )
    if not found.moves:
        raise CalibrationError(
            "all rates are 0: exposures at rest do not depend on a delay",
            file=found.poses_file,
            key="columns 'qd1_deg_s' …, 'table_rate_deg_s'",
            expected="the rates at which joints and table moved",
        )
    if not has_part:
        raise CalibrationError(
            "is estimated from the agreement of points with a part", key="latency_ms", expected="`part`, or a number"
        )
    profiles = found.profiles
    good = np.asarray(profiles.flags) == 0
    points = np.asarray(profiles.points_in_sensor, float)[good]
    observations = Observations(
        readings=found.readings,
        points_in_sensor=points,
        sigma=np.asarray(profiles.sigma, float)[good],
        direction=found.directions[good],
        frame=np.asarray(profiles.frame, np.intp)[good],
        time_offset=np.asarray(profiles.time_offset, float)[good],
    )
    problem = CalibrationProblem(
        kinematics=kinematics_of(nominal),
        observations=observations,
        artefact=Artefact(surface_of(nominal.part), nominal.table_from_part, False),
        free=(LATENCY,),
        start=start,
    )
    result = solve(replace(problem, observations=observations.chosen(on_artefact(problem))))
    return Latency(float(result.values[0]), float(result.half_widths(0.95)[0]))
