"""Calibration of a sensor's cameras and laser sheet from targets of known shape: `solve`.

One weighted least squares over all free parameters of the description and the unknown poses of the targets
(Gauss-Newton), from which the poses are eliminated (`reduced`); and which directions of the parameters it determines.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scancell.calibration.sensor.equations import Block, Equations, Rows, State, chosen, pose_step, reduced
from scancell.calibration.sensor.parameters import RADIUS_OFFSET, SensorParameters
from scancell.calibration.sensor.problem import SensorProblem
from scancell.config.sensor import SensorDescription
from scancell.errors import CalibrationError
from scancell.geometry import pose

Array = NDArray[np.float64]

# Measurements that determine a direction no better than the tolerances of the data sheet do not determine it.
_LIMIT = 1.0
_NAMED = 0.3  # share of the largest component from which a parameter is named
_DEPTH_SHARE = 0.4  # of the measuring range
_ONE_DIRECTION = 0.05  # standard deviation of normals across their mean

_ITERATIONS = 40
_SETTLED = 1e-3  # of a parameter's standard deviation
_HALVINGS = 8  # of a step that does not lower the residuals
_COST_TOLERANCE = 1e-3  # weights follow the geometry, so that the sum of squares may rise a little at the solution
_OUTLIER = 5.0  # standard deviations
_RUN = 64  # points whose errors may be correlated
_ROUNDS = 4  # of discarding outliers


def require_observable(sensor: SensorDescription, parameters: SensorParameters, blocks: Sequence[Block]) -> Array:
    """Standard deviations (k,) along the principal directions of the parameters, in tolerances, descending.

    Raises `CalibrationError` if one of them exceeds 1; the message names the direction and what is missing.
    """
    system = reduced(blocks)
    _, singular, directions = np.linalg.svd(
        system.by_parameter, full_matrices=len(system.residual) < len(parameters.names)
    )
    singular = np.concatenate([singular, np.zeros(len(parameters.names) - len(singular))])
    with np.errstate(divide="ignore"):
        deviations = 1.0 / np.abs(singular)  # LAPACK gives -0.0, too
    weak = deviations > _LIMIT
    if weak.any():
        lines = [_text(parameters, *pair) for pair in zip(directions[weak], deviations[weak], strict=True)]
        missing = "; ".join(_missing(sensor, parameters, blocks, directions[weak]))
        raise CalibrationError(
            "the measurements do not determine all free parameters of the sensor. Undetermined:\n  "
            + "\n  ".join(lines)
            + f"\nMissing: {missing}"
        )
    return np.asarray(deviations[::-1])


def _text(parameters: SensorParameters, direction: Array, deviation: float) -> str:
    """The direction by its main components, in units of the keys, relative to the first."""
    share = np.abs(direction)
    order = [k for k in np.argsort(-share) if share[k] >= _NAMED * share.max()]
    amounts = direction * parameters.scales / (direction * parameters.scales)[order[0]]
    terms = " ".join(f"{amounts[k]:+.3g} {parameters.names[k].removeprefix('sensor.')}" for k in order)
    spread = min(deviation * float(share[order[0]] * parameters.scales[order[0]]), 1e9)
    return f"{terms.removeprefix('+')} (standard deviation of the first: {spread:.2g})"


def _missing(
    sensor: SensorDescription, parameters: SensorParameters, blocks: Sequence[Block], weak: Array
) -> list[str]:
    """Measurements that would determine the weak directions (w, k)."""
    by_parameter = np.concatenate([block.by_parameter for block in blocks])
    direct = np.linalg.norm(by_parameter @ weak.T, axis=0)
    found = []
    if RADIUS_OFFSET in parameters.names and not by_parameter[:, parameters.names.index(RADIUS_OFFSET)].any():
        found.append("a ball: no target has a radius to find")
    if (direct > 1.0 / _LIMIT).any():
        found.append(
            "the targets' poses in the sensor frame, or fewer free parameters: unknown poses of the targets take up"
            " these directions"
        )
    point = np.concatenate([block.point for block in blocks])
    own = np.isfinite(point).all(1)
    if not own.any():
        return [*found, "the laser's stripe on targets: the measurements hold none"]
    z_mm = 1e3 * np.quantile(point[own, 2], [0.02, 0.98])
    limits = sensor.range
    if z_mm[1] - z_mm[0] < _DEPTH_SHARE * (limits.far_mm - limits.near_mm):
        found.append(
            f"heights: all points lie at z = {z_mm[0]:.4g} .. {z_mm[1]:.4g} mm of the range"
            f" {limits.near_mm:g} .. {limits.far_mm:g} mm"
        )
    normal = np.concatenate([block.normal for block in blocks])[own]
    if (normal - normal.mean(0)).std(0).max() < _ONE_DIRECTION:
        found.append("directions: all surfaces face the same way; tilt the target about X and Y, or use a ball")
    if not found:
        found.append(
            "other places and directions of the target, or a checkered target, which separates the cameras'"
            " direction, principal point and field of view"
        )
    return found


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
    raise CalibrationError(f"the calibration did not converge in {_ITERATIONS} iterations: check start and poses")


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
    raise CalibrationError("the calibration finds no better solution near its start: check target, poses and start")


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
