"""Calibration of a sensor's cameras and laser sheet from targets of known shape: `solve`.

One weighted least squares over all free parameters of the description and the unknown poses of the targets
(Gauss-Newton), from which the poses are eliminated (`sensor_reduction`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scancell.calibration.sensor.equations import Block, Equations, State
from scancell.calibration.sensor.observability import require_observable
from scancell.calibration.sensor.parameters import SensorParameters
from scancell.calibration.sensor.problem import SensorProblem
from scancell.calibration.sensor.reduction import Rows, chosen, pose_step, reduced
from scancell.config.sensor import SensorDescription
from scancell.errors import CalibrationError
from scancell.geometry import pose

Array = NDArray[np.float64]

_ITERATIONS = 40
_SETTLED = 1e-3  # of a parameter's standard deviation
_HALVINGS = 8  # of a step that does not lower the residuals
_COST_TOLERANCE = 1e-3  # weights follow the geometry, so that the sum of squares may rise a little at the solution
_OUTLIER = 5.0  # standard deviations
_RUN = 64  # points whose errors may be correlated
_ROUNDS = 4  # of discarding outliers


@dataclass(frozen=True)
class SensorCalibration:
    """Result of `solve`.

    Attributes
    ----------
    sensor
        Calibrated description; triangulates on its sheet.
    names, values, covariance
        Free parameters (k,), their values (k,) and covariance (k, k), in the units of the keys. The covariance is that
        of the stated noise, scaled by `covariance_scale`.
    displacement
        Solved displacement (4, 4) of each mounting in the sensor frame; those of symmetric targets are not unique.
    distances, exposure
        (n,) signed distances of all used points from their targets, m, and the index of each one's exposure.
    chi_square
        Sum of squared residuals in standard deviations, per degree of freedom.
    covariance_scale
        1, or the variance of single residuals or of runs of 64 neighbours relative to the stated noise, if larger:
        errors that neighbouring columns share do not average out.
    used, discarded
        Number of residuals.
    directions
        (k,) standard deviations along the principal directions of the parameters, each in units of its tolerance, in
        descending order: what the measurements determine worst comes first.
    """

    sensor: SensorDescription
    names: tuple[str, ...]
    values: Array
    covariance: Array
    displacement: Mapping[int | None, Array]
    distances: Array
    exposure: NDArray[np.intp]
    chi_square: float
    covariance_scale: float
    used: int
    discarded: int
    directions: Array

    @property
    def sigma(self) -> Array:
        """Standard deviations (k,) of the values."""
        return np.sqrt(np.diag(self.covariance))


def solve(problem: SensorProblem) -> SensorCalibration:
    """Solve for the free parameters.

    Raises `CalibrationError` if the measurements do not determine all free parameters (the message names the directions
    and what is missing), are fewer than the unknowns, or the iteration does not converge.
    """
    if not problem.exposures:
        raise CalibrationError("no measurements: the calibration of a sensor needs exposures of a target")
    parameters = SensorParameters(problem.sensor, problem.free)
    equations = Equations(problem, parameters)
    state = State(parameters.start_values, {mounting: np.eye(4) for mounting in equations.mountings})
    blocks = equations.blocks(state)
    kept = [np.isfinite(block.residual) for block in blocks]
    require_observable(problem.sensor, parameters, chosen(blocks, kept))
    for _ in range(_ROUNDS):
        state, blocks = _converged(equations, parameters, state, blocks, kept)
        before, kept = kept, _without_outliers(blocks)
        if all((a == b).all() for a, b in zip(before, kept, strict=True)):
            break
    used = chosen(blocks, kept)
    directions = require_observable(problem.sensor, parameters, used)
    return _result(parameters, state, used, sum(int((~rows).sum()) for rows in kept), directions)


def _converged(
    equations: Equations, parameters: SensorParameters, state: State, blocks: list[Block], kept: list[Rows]
) -> tuple[State, list[Block]]:
    """The state after Gauss-Newton steps with the residuals `kept`, and its blocks with all residuals."""
    for _ in range(_ITERATIONS):
        used = chosen(blocks, kept)
        system = reduced(used)
        if system.degrees_of_freedom <= 0:
            unknowns = len(system.residual) - system.degrees_of_freedom
            raise CalibrationError(f"{len(system.residual)} residuals for {unknowns} unknowns: take more exposures")
        step: Array = np.linalg.lstsq(system.by_parameter, -system.residual, rcond=None)[0].astype(float)
        state, blocks = _improved(equations, parameters, state, used, step, kept)
        if np.abs(step / np.sqrt(np.diag(system.covariance))).max(initial=0.0) < _SETTLED:
            return state, blocks
    raise CalibrationError(f"the calibration did not converge in {_ITERATIONS} iterations: are start and poses right?")


def _improved(
    equations: Equations, parameters: SensorParameters, state: State, used: list[Block], step: Array, kept: list[Rows]
) -> tuple[State, list[Block]]:
    """The state after the largest of the steps 1, 1/2, 1/4, … (of `step`, per tolerance) that lowers the residuals."""
    before = _cost(used)
    for halvings in range(_HALVINGS):
        part = step * 0.5**halvings
        moved = State(state.values + part * parameters.scales, state.displacement)
        moved = _displaced(equations, moved, [pose_step(block, part) for block in used])
        try:
            blocks = equations.blocks(moved)
        except CalibrationError:  # outside the bounds of the description
            if halvings + 1 == _HALVINGS:
                raise
            continue
        if _cost(chosen(blocks, kept)) <= before * (1.0 + _COST_TOLERANCE):
            return moved, blocks
    raise CalibrationError(
        "the calibration finds no better solution near its start: are target, poses and start right?"
    )


def _cost(blocks: list[Block]) -> float:
    return float(sum(block.residual @ block.residual for block in blocks))


def _displaced(equations: Equations, state: State, steps: list[Array]) -> State:
    """Mountings after the displacement steps, (6,) or (0,) where the pose is known."""
    centre = pose.translation(equations.centre)
    displacement = dict(state.displacement)
    for mounting, step in zip(equations.mountings, steps, strict=True):
        if len(step):
            about = pose.from_rotation(pose.exp_rotation(step[:3]), step[3:])
            displacement[mounting] = centre @ about @ pose.inverse(centre) @ displacement[mounting]
    return State(state.values, displacement)


def _without_outliers(blocks: list[Block]) -> list[Rows]:
    """Residuals within the limit of the stated noise, or of their scatter (median) where that is larger."""
    every = np.abs(np.concatenate([block.residual for block in blocks]))
    scatter = max(1.0, 1.4826 * float(np.nanmedian(every)))
    return [np.abs(block.residual) <= _OUTLIER * scatter for block in blocks]


def _result(
    parameters: SensorParameters, state: State, used: list[Block], discarded: int, directions: Array
) -> SensorCalibration:
    system = reduced(used)
    chi_square = float(system.residual @ system.residual) / system.degrees_of_freedom
    distances = np.concatenate([block.distance for block in used])
    of_stripes = np.isfinite(distances)
    scale = max(1.0, chi_square, _run_variance(used))
    return SensorCalibration(
        parameters.description(state.values),
        parameters.names,
        state.values,
        system.covariance * np.outer(parameters.scales, parameters.scales) * scale,
        state.displacement,
        distances[of_stripes],
        np.concatenate([block.exposure for block in used])[of_stripes],
        chi_square,
        scale,
        len(system.residual),
        discarded,
        directions,
    )


def _run_variance(blocks: list[Block]) -> float:
    """Variance of sums over runs of neighbouring stripe points, relative to that of independent residuals."""
    residual = np.concatenate([block.residual[np.isfinite(block.distance)] for block in blocks])
    runs = residual[: len(residual) // _RUN * _RUN].reshape(-1, _RUN)
    return float(np.mean(runs.sum(1) ** 2) / _RUN) if len(runs) else 0.0
