"""Observability: which unknowns, alone or together, the exposures determine."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scancell.calibration.cell.kinematics import LATENCY
from scancell.calibration.cell.problem import CalibrationProblem, Direction, points_on_platter
from scancell.calibration.least_squares import undetermined, without
from scancell.calibration.variance_components import Moments, normal_equations
from scancell.errors import CalibrationError
from scancell.geometry import pose

Array = NDArray[np.float64]

_SYMMETRY = 1e-9  # share of the largest information below which the artefact looks the same after a motion
_LARGEST_CHANGE = 1.0  # share of the extent of the points
_DOUBTFUL = 5.0  # times the stated sigma
_LEAST_TURN = np.radians(10.0)  # of the sensor
_LEAST_TABLE_TURN = np.radians(30.0)
_LEAST_RATE = 1e-3  # rad/s


def determined_basis(moments: Moments, count: int) -> Array:
    """Basis (unknowns, r) of all unknowns without motions of the artefact that change nothing (a sphere's rotations).

    The first `count` unknowns, the deviations, are all in it.
    """
    unknowns = moments.design.shape[-1]
    if unknowns == count:
        return np.eye(unknowns)
    design = moments.design[:, :, count:]
    k = design.shape[1]
    own = (design.swapaxes(1, 2) @ moments.second.sum(0)[:, :k, :k] @ design).sum(0)
    values, vectors = np.linalg.eigh(own)
    seen = vectors[:, values > _SYMMETRY * values[-1]]
    basis = np.zeros((unknowns, count + seen.shape[1]))
    basis[:count, :count] = np.eye(count)
    basis[count:, count:] = seen
    return basis


def require_determined(problem: CalibrationProblem, moments: Moments, basis: Array, log_variances: Array) -> None:
    """Raise `CalibrationError` where a direction is undetermined, with what is missing.

    That is one without information, or along which the uncertainty moves the measured points by more than `_LARGEST_CHANGE` of
    their extent: neither depends on frames, units or the number of points.
    """
    count, data = len(problem.free), problem.observations
    information = normal_equations(moments.by_basis(basis), log_variances).information
    points = points_on_platter(data, problem.kinematics.poses(data.readings, problem.start))
    mean = np.zeros((len(data.readings), 6, 6))
    np.add.at(mean, data.frame, _displacement(points))
    motion = moments.design[:, :6, :count]
    effect = np.einsum("nip,nij,njq->pq", motion, mean / len(points), motion)
    extent = float(np.sqrt(points.var(0).sum()))
    weak = [Direction(*one) for one in undetermined(without(information, count), effect, _LARGEST_CHANGE * extent)]
    if weak:
        named = "; ".join(one.text(problem.free) for one in weak)
        scatter = float(np.exp(0.5 * log_variances[0]))
        advice = _advice(problem)
        if scatter > _DOUBTFUL:
            advice = (
                f"Their points scatter {scatter:.0f} times as much as their stated sigma: is the artefact the described"
                " one, and near where the cell description puts it? Faces nearer to each other than the deviations"
                " to be found are mistaken for one another"
            )
        raise CalibrationError(f"the exposures do not determine: {named}. {advice}")


def _displacement(points: Array) -> Array:
    """Squares of the displacements of points (m, 3) as quadratic forms (m, 6, 6) of a screw."""
    turned = pose.skew(points)
    jacobian = np.concatenate([np.broadcast_to(np.eye(3), turned.shape), -turned], -1)
    return np.asarray(jacobian.swapaxes(1, 2) @ jacobian)


def _advice(problem: CalibrationProblem) -> str:
    """Measurements that the exposures lack."""
    readings = problem.observations.readings
    readings = readings.rows(np.unique(problem.observations.frame))
    poses = problem.kinematics.poses(readings, problem.start).platter_from_sensor
    turns = np.linalg.norm(pose.log_rotation(np.swapaxes(poses[:1, :3, :3], 1, 2) @ poses[:, :3, :3]), axis=1)
    if turns.max() < _LEAST_TURN:
        return (
            f"The orientation of the sensor to the artefact differs by {np.degrees(turns.max()):.1f} deg at most: turn"
            " the sensor about two axes, by 20 deg or more"
        )
    if LATENCY in problem.free and np.abs(readings.rates).max() < _LEAST_RATE:
        return "Nothing moves: measure while the sensor passes the artefact in opposite directions"
    if any(name.startswith(("table.", "platter.")) for name in problem.free):
        if np.ptp(readings.table) < _LEAST_TABLE_TURN:
            return "The table hardly turns: measure at three or more table angles, 90 deg apart or more"
        return (
            "Measure a sphere off the axis of the table, or an artefact with several spheres at different heights and"
            " distances from the axis"
        )
    return "Free fewer deviations, or add exposures from other directions and distances"
