"""Calibration of a sensor's cameras and laser sheet from targets of known shape: `solve`.

One weighted least squares over all free parameters of the description and the unknown poses of the targets, and which
directions of the parameters it determines.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scancell.arrays import Array
from scancell.calibration.sensor.problem import (
    RADIUS_OFFSET,
    Block,
    Equations,
    Rows,
    SensorParameters,
    SensorProblem,
    State,
    normal_equations,
)
from scancell.config.sensor import SensorDescription
from scancell.errors import CalibrationError
from scancell.geometry import pose
from scancell.geometry.least_squares import NormalEquations, minimise, undetermined, without

# Measurements that determine a direction no better than the tolerances of the data sheet do not determine it.
_LIMIT = 1.0
_NAMED = 0.3  # share of the largest component from which a parameter is named
_DEPTH_SHARE = 0.4  # of the measuring range
_ONE_DIRECTION = 0.05  # standard deviation of normals across their mean

_STEPS = 60
_SETTLED = 1e-6  # of a parameter's tolerance: change of all weights
_BARRED = 1e-2  # decrease of the sum of squares beyond the bounds of the description, which does not count
_OUTLIER = 5.0  # standard deviations
_RUN = 64  # points whose errors may be correlated
_ROUNDS = 4  # of discarding outliers


def require_determined(sensor: SensorDescription, parameters: SensorParameters, blocks: Sequence[Block]) -> Array:
    """Information (k, k) on the parameters, in tolerances, the displacements of mountings eliminated.

    Raises `CalibrationError` if the standard deviation along a direction exceeds the tolerances; the message names the
    direction and what is missing.
    """
    count = len(parameters.names)
    information = without(normal_equations(blocks).information, count)
    weak = undetermined(information, np.eye(count), _LIMIT)
    if weak:
        lines = [_text(parameters, *one) for one in weak]
        missing = "; ".join(_missing(sensor, parameters, blocks, np.array([direction for direction, _ in weak])))
        raise CalibrationError(
            "the measurements do not determine all free parameters of the sensor. Undetermined:\n  "
            + "\n  ".join(lines)
            + f"\nMissing: {missing}"
        )
    return information


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
    require_determined(problem.sensor, parameters, _chosen(blocks, kept))
    for _ in range(_ROUNDS):
        before = state
        state = _adjusted(equations, parameters, state, blocks, kept)
        blocks = equations.blocks(state)
        was_kept, kept = kept, _without_outliers(blocks)
        moved = np.abs(state.values - before.values) / parameters.scales
        if moved.max(initial=0.0) < _SETTLED and all((a == b).all() for a, b in zip(was_kept, kept, strict=True)):
            break
    used = _chosen(blocks, kept)
    information = require_determined(problem.sensor, parameters, used)
    return _result(parameters, state, used, sum(int((~rows).sum()) for rows in kept), information)


def _adjusted(
    equations: Equations, parameters: SensorParameters, start: State, blocks: list[Block], kept: list[Rows]
) -> State:
    """The state of the least sum of squares of the residuals `kept`, in their standard deviations at the start.

    If these followed the geometry, they would lower the sum by steps to oblique views.
    """
    first = normal_equations(_chosen(blocks, kept))
    residuals = sum(int(rows.sum()) for rows in kept)
    if residuals <= first.rank:
        raise CalibrationError(f"{residuals} residuals for {first.rank} unknowns: take more exposures")
    left: list[CalibrationError] = []  # the bounds of the description

    def linearised(at: State) -> tuple[NormalEquations, Callable[[Array], State]]:
        try:
            found = blocks if at is start else equations.blocks(at)
        except CalibrationError as error:
            left.append(error)
            return replace(first, squares=np.inf), lambda _: at
        weighted = [one.with_deviations_of(before) for one, before in zip(found, blocks, strict=True)]
        used = _chosen(weighted, kept)
        return normal_equations(used), lambda step: _moved(equations, parameters, at, used, step)

    state, is_settled = minimise(linearised, start, _STEPS)
    if left and linearised(state)[0].step()[1] > _BARRED:
        raise left[-1]
    if not is_settled:
        raise CalibrationError(f"the calibration did not converge in {_STEPS} steps: check start and poses")
    return state


def _chosen(blocks: list[Block], kept: list[Rows]) -> list[Block]:
    return [block.chosen(rows) for block, rows in zip(blocks, kept, strict=True)]


def _moved(equations: Equations, parameters: SensorParameters, state: State, blocks: list[Block], step: Array) -> State:
    """The state after a step (k + displacements,) of the parameters, in tolerances, and of mountings."""
    count, centre = len(parameters.names), pose.translation(equations.centre)
    displacement = dict(state.displacement)
    for mounting, block in zip(equations.mountings, blocks, strict=True):
        if block.by_pose.shape[1]:
            own, count = step[count : count + 6], count + 6
            about = pose.from_rotation(pose.exp_rotation(own[:3]), own[3:])
            displacement[mounting] = centre @ about @ pose.inverse(centre) @ displacement[mounting]
    return State(state.values + step[: len(parameters.names)] * parameters.scales, displacement)


def _without_outliers(blocks: list[Block]) -> list[Rows]:
    """Residuals within the limit of the stated noise, or of their scatter (median) where that is larger."""
    every = np.abs(np.concatenate([block.residual for block in blocks]))
    scatter = max(1.0, 1.4826 * float(np.nanmedian(every)))
    return [np.abs(block.residual) <= _OUTLIER * scatter for block in blocks]


def _result(
    parameters: SensorParameters, state: State, used: list[Block], discarded: int, information: Array
) -> SensorCalibration:
    equations = normal_equations(used)
    residuals = sum(len(block.residual) for block in used)
    chi_square = equations.squares / (residuals - equations.rank)
    distances = np.concatenate([block.distance for block in used])
    of_stripes = np.isfinite(distances)
    scale = max(1.0, chi_square, _run_variance(used))
    return SensorCalibration(
        parameters.description(state.values),
        parameters.names,
        state.values,
        np.asarray(np.linalg.inv(information) * np.outer(parameters.scales, parameters.scales) * scale, float),
        state.displacement,
        distances[of_stripes],
        np.concatenate([block.exposure for block in used])[of_stripes],
        chi_square,
        scale,
        residuals,
        discarded,
        1.0 / np.sqrt(np.linalg.eigvalsh(information)),
    )


def _run_variance(blocks: list[Block]) -> float:
    """Variance of sums over runs of neighbouring stripe points, relative to that of independent residuals."""
    residual = np.concatenate([block.residual[np.isfinite(block.distance)] for block in blocks])
    runs = residual[: len(residual) // _RUN * _RUN].reshape(-1, _RUN)
    return float(np.mean(runs.sum(1) ** 2) / _RUN) if len(runs) else 0.0
