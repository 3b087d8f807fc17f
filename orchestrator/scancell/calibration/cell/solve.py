"""Joint calibration: weighted least squares of the distances of measured points to the surface of an artefact.

All unknowns are found together: deviations of tool, table, joints and trigger, the pose of the artefact, and its sizes.
A point's distance to the surface changes with each of them by the power of a wrench, the surface normal at the point,
on the screw of the unknown; see `kinematics`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scancell.calibration.cell.kinematics import LATENCY, UNIT, SensorPoses
from scancell.calibration.cell.noise import Estimate, Moments, estimate, normal_equations, pose_errors
from scancell.calibration.cell.observability import determined_basis, require_determined
from scancell.calibration.cell.problem import MOST_OBLIQUE, CalibrationProblem, CalibrationResult, points_on_platter
from scancell.errors import CalibrationError
from scancell.geometry import pose

Array = NDArray[np.float64]

_MOST_STEPS = 60
_MOST_ASSIGNMENTS = 10
_DAMPING = 1e-6  # of the coarse fit
_COARSE = 1e-3  # of UNIT: last step of the coarse fit
_CONVERGED = 1e-4  # variances: an error of the fit of 0.01 standard deviations
_GROWTH = 1.001  # of the sum of squares, that facets explain
_OUTLIER = 5.0  # standard deviations
_COARSE_FLOOR = 2e-6  # m: least scale of residuals of the coarse fit
_NOISE_ROUNDS = 3
# Starts of the search for the size of pose errors: points as stated, joints and table, position and orientation.
_START_VARIANCES = {"none": (1.0,), "joints": (1.0, 1e-5**2), "flange": (1.0, 1e-5**2, 2e-5**2)}
_LEAST_POINTS = 5  # of an exposure, and per unknown


@dataclass(frozen=True)
class _Residuals:
    """Distances (m,) of points to the surface, their wrenches (m, 6) and variances (m,), at `poses`."""

    distance: Array
    wrench: Array
    variance: Array
    poses: SensorPoses


@dataclass
class _State:
    deviations: dict[str, float]
    platter_from_artefact: Array
    sizes: Array


def moments_of(problem: CalibrationProblem) -> Moments:
    """The problem linearised at its start, in the basis of what the artefact's surface can determine."""
    state = _start(problem)
    problem = _assigned(problem, state)
    found = _residuals(problem, state)
    moments = _moments(problem, found, np.ones(len(found.distance)))
    return replace(moments, design=moments.design @ determined_basis(moments, len(problem.free)))


def solve(problem: CalibrationProblem) -> CalibrationResult:
    """Calibrated deviations with their covariance.

    First a robust fit without pose errors finds what belongs to the artefact; then outliers are removed, the noise is
    estimated, and all is fitted again.

    Raises `CalibrationError` if there are too few points, or the poses do not determine the unknowns; the message
    states what is missing.
    """
    _check(problem)
    state = _start(problem)
    log_variances = np.log(_START_VARIANCES[problem.robot_noise])
    _require_determined_at(_assigned(problem, state), state, log_variances)
    problem, kept = _coarse_fit(problem, state)
    for _ in range(_NOISE_ROUNDS):
        inner = replace(problem, observations=problem.observations.chosen(kept))
        _, moments, _ = _converge(inner, state, log_variances)
        log_variances = estimate(moments, log_variances).log_variances
        kept = _inliers(problem, state, log_variances)
    inner = replace(problem, observations=problem.observations.chosen(kept))
    residuals, moments, basis = _converge(inner, state, log_variances)
    last = estimate(moments, log_variances)
    return _result(inner, state, last, basis, residuals, len(kept))


def _coarse_fit(problem: CalibrationProblem, state: _State) -> tuple[CalibrationProblem, NDArray[np.bool_]]:
    """Robust fits with points assigned anew, until these stay; the problem of these points, and which fit (m,)."""
    assigned = _assigned(problem, state)
    for _ in range(_MOST_ASSIGNMENTS):
        kept = _coarse(assigned, state)
        before, assigned = assigned, _assigned(problem, state)
        if np.array_equal(_shapes(before), _shapes(assigned)):
            return before, kept
    return assigned, _coarse(assigned, state)


def _shapes(problem: CalibrationProblem) -> NDArray[np.intp]:
    assert problem.observations.shape is not None
    return problem.observations.shape


def _assigned(problem: CalibrationProblem, state: _State) -> CalibrationProblem:
    """The problem with the points that belong to a shape."""
    data = problem.observations
    if data.shape is None:
        local = _points_in_artefact(problem, state, problem.kinematics.poses(data.readings, state.deviations))[1]
        data = replace(data, shape=problem.artefact.surface.assign(local))
    assert data.shape is not None
    usable = data.shape >= 0
    if usable.sum() < _LEAST_POINTS * len(problem.free):
        raise CalibrationError(
            f"{usable.sum()} points lie on the artefact", expected=f"{_LEAST_POINTS * len(problem.free)} or more"
        )
    return replace(problem, observations=data.chosen(usable))


def _require_determined_at(problem: CalibrationProblem, state: _State, log_variances: Array) -> None:
    found = _residuals(problem, state)
    moments = _moments(problem, found, np.ones(len(found.distance)))
    require_determined(problem, moments, determined_basis(moments, len(problem.free)), log_variances)


def _start(problem: CalibrationProblem) -> _State:
    return _State(
        dict.fromkeys(problem.free, 0.0) | dict(problem.start),
        problem.artefact.platter_from_artefact.copy(),
        np.zeros(len(problem.artefact.unknown_sizes)),
    )


def _check(problem: CalibrationProblem) -> None:
    names = problem.kinematics.names
    unknown = [name for name in problem.free if name not in names]
    if unknown:
        raise CalibrationError(
            "is not a deviation of the cell", key="also", value=unknown[0], expected=f"one of {', '.join(names)}"
        )
    if problem.observations.readings.flange is not None:
        of_joints = [name for name in problem.free if name == LATENCY or name.startswith("dh[")]
        if of_joints or problem.robot_noise == "joints":
            raise CalibrationError(
                "flange poses do not determine " + (", ".join(of_joints) or "the noise of joints"), expected="joints"
            )
    used = np.bincount(problem.observations.frame, minlength=len(problem.observations.readings))
    exposures = int((used >= _LEAST_POINTS).sum())
    wanted = -(-len(problem.free) // 3) + (0 if problem.artefact.is_pose_known else 1)
    if exposures < wanted:
        raise CalibrationError(
            f"{exposures} exposures show the artefact with {_LEAST_POINTS} points or more: {len(problem.free)} unknowns"
            f" need {wanted} at least"
        )


def _points_in_artefact(problem: CalibrationProblem, state: _State, poses: SensorPoses) -> tuple[Array, Array]:
    """Points (m, 3) on the platter and in the artefact."""
    points = points_on_platter(problem.observations, poses)
    return points, pose.transform_points(pose.inverse(state.platter_from_artefact), points)


def _residuals(problem: CalibrationProblem, state: _State) -> _Residuals:
    data, artefact, shape = problem.observations, problem.artefact, _shapes(problem)
    poses = problem.kinematics.poses(data.readings, state.deviations)
    points, local = _points_in_artefact(problem, state, poses)
    distance, normal = artefact.surface.distance(local, shape)
    for number, size in zip(artefact.unknown_sizes, state.sizes, strict=True):
        distance = distance - np.where(shape == number, size, 0.0)
    normal = normal @ state.platter_from_artefact[:3, :3].T
    sensor = poses.platter_from_sensor[data.frame, :3, :3]
    cosine = np.einsum("ni,ni->n", normal, np.einsum("nij,nj->ni", sensor, data.direction))
    variance = data.sigma**2 * np.maximum(cosine**2, MOST_OBLIQUE**2)
    return _Residuals(distance, np.hstack([normal, np.cross(points, normal)]), variance, poses)


def _moments(problem: CalibrationProblem, found: _Residuals, weights: Array) -> Moments:
    """Regressors are the six components of the wrench, then the sizes; unknowns in units of `UNIT`."""
    artefact, data, shape = problem.artefact, problem.observations, _shapes(problem)
    sizes = [-np.equal(shape, number).astype(float) for number in artefact.unknown_sizes]
    rows = np.column_stack([found.wrench, *sizes, found.distance])
    used = np.flatnonzero(weights > 0)
    rows, weight, frame = rows[used], (weights / found.variance)[used], data.frame[used]
    n, k = len(data.readings), rows.shape[1] - 1
    second = np.zeros((n, k + 1, k + 1))
    order = np.argsort(frame, kind="stable")
    starts = np.flatnonzero(np.diff(frame[order], prepend=-1))
    for part, number in zip(np.split(order, starts[1:]), frame[order][starts], strict=True):
        second[number] = (rows[part] * weight[part, None]).T @ rows[part]
    return Moments(second, _design(problem, found.poses, k), _modes(problem, found.poses, k), len(used))


def _design(problem: CalibrationProblem, poses: SensorPoses, k: int) -> Array:
    """(n, k, unknowns): deviations, then the twist of the artefact about the platter's origin, then sizes."""
    n, artefact = len(poses.platter_from_sensor), problem.artefact
    columns = [np.stack([poses.deviations[name] for name in problem.free], -1)]
    if not artefact.is_pose_known:
        columns.append(np.broadcast_to(-np.eye(6), (n, 6, 6)))
    motion = np.concatenate(columns, -1)
    sizes = len(artefact.unknown_sizes)
    design = np.zeros((n, k, motion.shape[-1] + sizes))
    design[:, :6, : motion.shape[-1]] = motion
    design[:, 6:, motion.shape[-1] :] = np.eye(sizes)
    return design * UNIT


def _modes(problem: CalibrationProblem, poses: SensorPoses, k: int) -> tuple[Array, ...]:
    if problem.robot_noise == "none":
        return ()
    if problem.robot_noise == "joints":
        kinds: tuple[Array, ...] = (np.concatenate([poses.joints, poses.table[:, :, None]], -1),)
    else:
        kinds = (poses.flange[:, :, :3], poses.flange[:, :, 3:])
    return tuple(np.concatenate([kind, np.zeros((len(kind), k - 6, kind.shape[-1]))], 1) for kind in kinds)


def _coarse(problem: CalibrationProblem, state: _State) -> NDArray[np.bool_]:
    """Robust fit without pose errors, by Tukey's weights; which points (m,) belong to the artefact."""
    weights = np.ones(len(problem.observations.sigma))
    for _ in range(_MOST_STEPS):
        found = _residuals(problem, state)
        scale = max(1.4826 * float(np.median(np.abs(found.distance))), _COARSE_FLOOR)
        relative = found.distance / (_OUTLIER * scale)
        weights = np.where(np.abs(relative) < 1, (1 - relative**2) ** 2, 0.0)
        moments = _moments(problem, replace(found, variance=np.full_like(found.variance, scale**2)), weights)
        basis = determined_basis(moments, len(problem.free))
        x = _step(replace(moments, modes=()), basis, np.zeros(1), _DAMPING)
        _apply(problem, state, x)
        if np.abs(x).max() < _COARSE:
            break
    return np.asarray(weights > 0)


def _converge(problem: CalibrationProblem, state: _State, log_variances: Array) -> tuple[_Residuals, Moments, Array]:
    """Gauss-Newton at given noise; residuals, moments in the determined basis, and that basis.

    It ends when the sum of squares, in variances, falls no more: facets of a mesh keep steps from becoming zero.
    """
    before = np.inf
    for _ in range(_MOST_STEPS):
        found = _residuals(problem, state)
        moments = _moments(problem, found, np.ones(len(found.distance)))
        basis = determined_basis(moments, len(problem.free))
        require_determined(problem, moments, basis, log_variances)
        squares = normal_equations(moments, log_variances)[2]
        if before - _CONVERGED < squares < _GROWTH * before:
            return found, replace(moments, design=moments.design @ basis), basis
        before = squares
        _apply(problem, state, _step(moments, basis, log_variances, 0.0))
    raise CalibrationError(f"the calibration did not converge in {_MOST_STEPS} steps: check start and artefact")


def _step(moments: Moments, basis: Array, log_variances: Array, damping: float) -> Array:
    """Step of the unknowns, by Gauss-Newton with Levenberg's damping."""
    information, gradient, _, _ = normal_equations(replace(moments, design=moments.design @ basis), log_variances)
    damped = information + damping * np.diag(np.diag(information))
    return np.asarray(basis @ np.linalg.solve(damped, gradient))


def _apply(problem: CalibrationProblem, state: _State, x: Array) -> None:
    """Add a step (unknowns,) in units of `UNIT` to the state."""
    step, count = x * UNIT, len(problem.free)
    for name, change in zip(problem.free, step[:count].tolist(), strict=True):
        state.deviations[name] += change
    if not problem.artefact.is_pose_known:
        velocity, rate = step[count : count + 3], step[count + 3 : count + 6]
        state.platter_from_artefact = (
            pose.from_rotation(pose.exp_rotation(rate), velocity) @ state.platter_from_artefact
        )
        count += 6
    state.sizes = state.sizes + step[count:]


def _inliers(problem: CalibrationProblem, state: _State, log_variances: Array) -> NDArray[np.bool_]:
    """Which points (m,) agree with the fit and the pose error of their exposure, within `_OUTLIER` deviations."""
    found = _residuals(problem, state)
    moments = _moments(problem, found, np.ones(len(found.distance)))
    errors = pose_errors(moments, log_variances)[problem.observations.frame]
    rest = found.distance - np.einsum("mk,mk->m", found.wrench, errors[:, :6])
    return np.asarray(np.abs(rest) < _OUTLIER * np.sqrt(found.variance * np.exp(log_variances[0])))


def _result(
    problem: CalibrationProblem, state: _State, last: Estimate, basis: Array, found: _Residuals, points: int
) -> CalibrationResult:
    count = len(problem.free)
    spread = basis[:count] @ last.covariance @ basis[:count].T * UNIT**2
    of_sizes = basis[len(basis) - len(state.sizes) :]
    # Of each deviation by the unknown of the basis that carries most of it.
    main = np.abs(basis[:count] * np.sqrt(np.diag(last.covariance))).argmax(1)
    noise = np.exp(0.5 * last.log_variances)
    return CalibrationResult(
        names=problem.free,
        values=np.array([state.deviations[name] for name in problem.free]),
        covariance=spread,
        degrees_of_freedom=last.degrees_of_freedom[main],
        held={name: value for name, value in state.deviations.items() if name not in problem.free},
        platter_from_artefact=state.platter_from_artefact,
        sizes=state.sizes,
        size_standard_deviations=np.sqrt(np.diag(of_sizes @ last.covariance @ of_sizes.T)) * UNIT,
        residuals=found.distance,
        frame=problem.observations.frame,
        points=points,
        noise_of_points=float(noise[0]),
        noise_of_robot=tuple(noise[1:].tolist()),
    )
