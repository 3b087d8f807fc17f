"""Joint calibration: weighted least squares of the distances of measured points to the surface of an artefact.

All unknowns are found together: deviations of tool, table, joints and trigger, the pose of the artefact, and its sizes.
A point's distance to the surface changes with each of them by the power of a wrench, the surface normal at the point,
on the screw of the unknown; see `kinematics`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scancell.arrays import Array
from scancell.calibration.cell.kinematics import LATENCY, TOOL, UNIT, AxisReadings, CellKinematics, SensorPoses
from scancell.calibration.cell.problem import (
    MOST_OBLIQUE,
    CalibrationProblem,
    CalibrationResult,
    Direction,
    Observations,
    points_on_platter,
)
from scancell.calibration.variance_components import (
    Estimate,
    Moments,
    equal_shares,
    equations_at,
    estimate,
    left_out,
    normal_equations,
)
from scancell.errors import CalibrationError
from scancell.geometry import pose
from scancell.geometry.fits import algebraic_sphere
from scancell.geometry.least_squares import NormalEquations, minimise, undetermined, without

_TRIALS = 200  # circles through three points of a profile
_LEAST_CIRCLE_POINTS = 20  # on a circle
_LEAST_CIRCLES = 4
_NEAR = 30e-6  # m from a circle, at least; or five standard deviations of the points
_LARGEST_CIRCLE = 1.01  # radius of a circle relative to that of the sphere
_STEPS = 50
_HOPELESS = 10e-3, 15  # m, steps: centres that are farther apart after so many do not come to agree
_UNIT = 1e-3
_DAMPING = 1e-4

_SYMMETRY = 1e-9  # share of the largest information below which the artefact looks the same after a motion
_LARGEST_CHANGE = 1.0  # share of the extent of the points
_DOUBTFUL = 5.0  # times the stated sigma
_LEAST_TURN = np.radians(10.0)  # of the sensor
_LEAST_TABLE_TURN = np.radians(30.0)
_LEAST_RATE = 1e-3  # rad/s

_MOST_STEPS = 60
_MOST_ASSIGNMENTS = 10
_DIVERGED = 10.0  # m or rad, of one step
_COARSE = 1e-3  # of UNIT: last step of the coarse fit
_SETTLED = 1e-4  # of logarithms of variances
_OUTLIER = 5.0  # standard deviations
_LEAST_ON_BELT = (
    0.9  # of the points near a part on a belt, that agree with it: others are on faces mistaken for its own
)
_LEAST_SHARE = 2 / 3  # of the points, that agree with the artefact: the robust fit alone keeps a half of any points
_COARSE_FLOOR = 2e-6  # m: least scale of residuals of the coarse fit
_ROUNDS = 12  # of noise and outliers
# Assumed before the data show it: variances of points as stated, of joints and table, or of position and orientation,
# and of the offset of the surface.
_ASSUMED = {
    "none": (1.0,),
    "joints": (1.0, 1e-5**2, 1e-6**2),
    "flange": (1.0, 1e-5**2, 2e-5**2, 1e-6**2),
}
_SHARED = 7  # regressors of what the points of an exposure share
_LEAST_POINTS = 5  # of an exposure, and per unknown


@dataclass(frozen=True)
class SphereStart:
    """Deviations of the tool (SI), the centre (3,) of the sphere on the platter, m, and the exposures that agree.

    `away` (n,) are the distances between the centres that the circles give and this one, m, and `rms` those of the
    exposures that agree.
    """

    deviations: dict[str, float]
    centre: Array
    exposures: int
    rms: float
    away: Array


def circle_in(points: Array, sigma: float, largest: float, rng: np.random.Generator) -> tuple[Array, float] | None:
    """Centre (2,) and radius, m, of the circle in the plane on which most of points (n, 2) lie; None without one.

    Circles through three random points are tried (RANSAC; Fischler & Bolles 1981), up to a radius `largest`, and the
    best is fitted to its points by Kåsa's linear equations.
    """
    if len(points) < _LEAST_CIRCLE_POINTS:
        return None
    near = max(_NEAR, 5.0 * sigma)
    three = points[rng.integers(len(points), size=(_TRIALS, 3))]
    left = 2.0 * (three[:, 1:] - three[:, :1])
    right = (three[:, 1:] ** 2).sum(-1) - (three[:, :1] ** 2).sum(-1)
    determinant = left[:, 0, 0] * left[:, 1, 1] - left[:, 0, 1] * left[:, 1, 0]
    usable = np.abs(determinant) > 1e-14
    left, right, three = left[usable], right[usable], three[usable]
    if not len(left):
        return None
    centres = np.linalg.solve(left, right[..., None])[..., 0]
    radii = np.linalg.norm(three[:, 0] - centres, axis=1)
    centres, radii = centres[radii < largest], radii[radii < largest]
    if not len(radii):
        return None
    distance = np.abs(np.linalg.norm(points - centres[:, None], axis=2) - radii[:, None])
    on_circle = distance[(distance < near).sum(1).argmax()] < near
    if on_circle.sum() < _LEAST_CIRCLE_POINTS:
        return None
    middle = points[on_circle].mean(0)
    centre, radius = algebraic_sphere(points[on_circle] - middle)
    return middle + centre, radius


@dataclass(frozen=True)
class Circles:
    """Circles in the profiles of a sphere.

    Attributes
    ----------
    frame
        (n,) exposure of each.
    centre
        (n, 2) in the plane of the laser, m.
    across
        (n,) distance of the sphere's centre from that plane, m.
    radius
        (n,) of each, m.
    """

    frame: NDArray[np.intp]
    centre: Array
    across: Array
    radius: Array

    def __len__(self) -> int:
        return len(self.frame)

    def of_sphere(self, radius: float) -> Circles:
        """The same circles on a sphere of another radius, m."""
        return replace(self, across=np.sqrt(np.maximum(radius**2 - self.radius**2, 0.0)))

    def in_sensor(self, side: Array | float) -> Array:
        """Centres (n, 3) of the sphere, on `side` 1 or -1 of the plane."""
        return np.column_stack([side * self.across, self.centre])


def circles_of(data: Observations, radius: float, largest: float = _LARGEST_CIRCLE) -> Circles:
    """Circles in the profiles of a sphere of known radius, up to `largest` radii.

    The plane of the laser cuts the sphere in a circle of radius r at a distance of ``sqrt(radius² - r²)`` from its
    centre, on one side or the other.
    """
    rng = np.random.default_rng(0)
    frames, circles = [], []
    for frame in np.unique(data.frame):
        rows = data.frame == frame
        points, sigma = data.points_in_sensor[rows][:, 1:], float(np.median(data.sigma[rows]))
        found = circle_in(points, sigma, largest * radius, rng)
        if found is not None:
            frames.append(frame)
            circles.append([*found[0], found[1]])
    y, z, radii = np.array(circles).reshape(-1, 3).T
    return Circles(np.array(frames, np.intp), np.column_stack([y, z]), np.zeros(len(radii)), radii).of_sphere(radius)


def sphere_start(
    kinematics: CellKinematics, readings: AxisReadings, circles: Circles, centre: Array
) -> SphereStart | None:
    """Deviations of the tool from the circles in profiles of a sphere; None with fewer than four.

    The side of the sphere's centre is chosen anew in every step of the fit, by what agrees better. With flange poses,
    the fit also starts from poses of the sensor that need no description of it: with the sphere's centre near the plane
    of the laser, and on the same side of it in all profiles.

    Parameters
    ----------
    readings
        Readings of all exposures.
    centre
        (3,) about where the sphere is on the platter, m.
    """
    if len(circles) < _LEAST_CIRCLES:
        return None
    own = readings.rows(circles.frame)
    found = _refined(kinematics, own, circles, dict.fromkeys(TOOL, 0.0), centre)
    if readings.flange is not None:
        starts = [_linear_start(kinematics, own, circles, is_one_sided) for is_one_sided in (False, True)]
        others = [_refined(kinematics, own, circles, *start) for start in starts]
        found = min(found, *others, key=lambda one: float(np.median(one.away)))
    return found


def _linear_start(
    kinematics: CellKinematics, readings: AxisReadings, circles: Circles, is_one_sided: bool
) -> tuple[dict[str, float], Array]:
    """Deviations of the tool and centre of the sphere on the platter, without start values.

    ``R_i (X p_i + x) + t_i = c`` is linear in the columns of the rotation X, in x and c. The column that multiplies the
    unknown side is the cross product of the other two, by the solution before. At first it is left out, or, where the
    centre `is_one_sided`, found with the others.
    """
    nominal = kinematics.carrier_from_sensor
    platter_from_flange = kinematics.poses(readings, {}).platter_from_sensor @ pose.inverse(nominal)
    rotation, offset = platter_from_flange[:, :3, :3], platter_from_flange[:, :3, 3]
    identity = np.broadcast_to(-np.eye(3), rotation.shape)
    y, z = (rotation * circles.centre[:, i, None, None] for i in (0, 1))
    design = np.concatenate([y, z, rotation, identity], -1)
    across, weights = np.zeros_like(offset), np.ones(len(circles))
    if is_one_sided:
        x = rotation * circles.across[:, None, None]
        whole = np.concatenate([x, design], -1).reshape(-1, 15)
        across = x @ np.linalg.lstsq(whole, -offset.ravel(), rcond=None)[0][:3]
    found, centre = np.eye(4), np.zeros(3)
    for _ in range(_STEPS):
        w = np.sqrt(weights)[:, None]
        left, right = (w[..., None] * design).reshape(-1, 12), (-w * (offset + across)).ravel()
        y_axis, z_axis, position, centre = np.linalg.lstsq(left, right, rcond=None)[0].reshape(4, 3)
        axes = pose.nearest_rotation(np.column_stack([np.cross(y_axis, z_axis), y_axis, z_axis]))
        found = pose.from_rotation(axes, position)
        sensor_from_platter = pose.inverse(platter_from_flange @ found)
        side = np.sign(pose.transform_each(sensor_from_platter, np.broadcast_to(centre, offset.shape))[:, 0])
        across = rotation @ axes[:, 0] * (side * circles.across)[:, None]
        away = pose.transform_each(platter_from_flange @ found, circles.in_sensor(side)) - centre
        length = np.linalg.norm(away, axis=1)
        weights = 1.0 / (1.0 + (length / (3.0 * max(float(np.median(length)), 1e-6))) ** 2)
    deviation = pose.inverse(nominal) @ found
    values = [*deviation[:3, 3], *pose.euler_xyz_from_rotation(deviation[:3, :3])]
    return dict(zip(TOOL, map(float, values), strict=True)), centre


def _refined(
    kinematics: CellKinematics, readings: AxisReadings, circles: Circles, deviations: dict[str, float], centre: Array
) -> SphereStart:
    deviations = dict(deviations)
    away = np.zeros((len(circles), 3))
    for step in range(_STEPS):
        poses = kinematics.poses(readings, deviations)
        both = [pose.transform_each(poses.platter_from_sensor, circles.in_sensor(side)) for side in (1, -1)]
        nearer = np.linalg.norm(both[0] - centre, axis=1) < np.linalg.norm(both[1] - centre, axis=1)
        at = np.where(nearer[:, None], both[0], both[1])
        away = at - centre
        length = np.linalg.norm(away, axis=1)
        scale = max(float(np.median(length)), 1e-6)
        weights = 1.0 / (1.0 + (length / (3.0 * scale)) ** 2)
        motion = [poses.deviations[name][:, :3] + np.cross(poses.deviations[name][:, 3:], at) for name in TOOL]
        design = np.stack([*motion, *(np.broadcast_to(-axis, at.shape) for axis in np.eye(3))], -1) * _UNIT
        information = np.einsum("n,nik,nil->kl", weights, design, design)
        gradient = np.einsum("n,nik,ni->k", weights, design, away)
        damped = information + _DAMPING * np.diag(np.diag(information))
        x = -np.linalg.solve(damped, gradient)
        for name, change in zip(TOOL, (_UNIT * x[:6]).tolist(), strict=True):
            deviations[name] += change
        centre = centre + _UNIT * x[6:]
        if np.abs(x).max() < 1e-3 or (scale > _HOPELESS[0] and step > _HOPELESS[1]):
            break
    distance = np.linalg.norm(away, axis=1)
    agree = distance < 5.0 * max(float(np.median(distance)), 1e-6)
    rms = float(np.sqrt(np.mean(distance[agree] ** 2)))
    return SphereStart(deviations, centre, int(agree.sum()), rms, distance)


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

    That is one without information, or along which the uncertainty moves the measured points by more than
    `_LARGEST_CHANGE` of their extent: neither depends on frames, units or the number of points.
    """
    count, data = len(problem.free), problem.observations
    information = normal_equations(moments.by_basis(basis), log_variances).information
    points = points_on_platter(data, problem.kinematics.poses(data.readings, problem.start))
    mean = np.zeros((len(data.readings), 6, 6))
    # Points move by v + w x p: squares of their displacements as quadratic forms of a screw.
    jacobian = np.concatenate([np.broadcast_to(np.eye(3), (len(points), 3, 3)), -pose.skew(points)], -1)
    np.add.at(mean, data.frame, jacobian.swapaxes(1, 2) @ jacobian)
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


def _advice(problem: CalibrationProblem) -> str:
    """Measurements that the exposures lack."""
    if problem.kinematics.belt is not None:
        return (
            "Let the belt carry a part with slopes or curved surfaces in all directions: faces that are parallel or"
            " square to the travel do not show where along it they pass, and are mistaken for one another"
        )
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
    if {name.partition(".")[0] for name in problem.free} >= {"axis", "table"}:
        return (
            "An axis that carries the arm displaces it as the table's deviations displace the table, and one that"
            " carries the table moves it along and about itself as they do: hold deviations of the table, or of the"
            " axis"
        )
    if any(name.startswith(("table.", "platter.")) for name in problem.free):
        is_turned = np.ptp(readings.table) >= _LEAST_TABLE_TURN
        return (
            "Measure a sphere off the axis of the table, or an artefact with several spheres at different heights and"
            " distances from the axis"
            if is_turned
            else "The table hardly turns: measure at three or more table angles, 90 deg apart or more"
        )
    return "Free fewer deviations, or add exposures from other directions and distances"


@dataclass(frozen=True)
class _State:
    """Values of all unknowns, and errors (n, d) that the points of each exposure share, as multiples of the modes."""

    deviations: dict[str, float]
    platter_from_artefact: Array
    sizes: Array
    errors: Array


@dataclass(frozen=True)
class _Residuals:
    """Distances of points from the surface, in the plane of the laser, at `poses`.

    Attributes
    ----------
    gap, variance
        (m,) distances in that plane, without what errors of the exposures add, and variances of points.
    explained
        (m,) what these errors add.
    cosine
        (m,) of the plane to the surface's normals: a distance along them is ``gap * cosine``.
    wrench
        (m, 6) of the normals, where they meet the surface. At the measured points an error of a point would turn its
        normal, and unknowns that tell such directions apart would explain the noise.
    motion
        (n, 6, unknowns) screws by which deviations and the pose of the artefact move points.
    modes
        Kinds (n, 7, d) of errors that the points of an exposure share: screws, and an offset from the surface.
    """

    gap: Array
    variance: Array
    explained: Array
    cosine: Array
    wrench: Array
    motion: Array
    modes: tuple[Array, ...]
    poses: SensorPoses


def moments_of(problem: CalibrationProblem) -> Moments:
    """The problem linearised at its start, in the basis of what the artefact's surface can determine.

    Its modes are those of the robot alone.
    """
    state = _start(problem)
    _, moments, basis = _linearised(_assigned(problem, state), state)
    return replace(moments.by_basis(basis), modes=moments.modes[:-1])


def solve(problem: CalibrationProblem) -> CalibrationResult:
    """Calibrated deviations with their covariance.

    First a robust fit without pose errors finds what belongs to the artefact; then outliers are removed, the noise is
    estimated, and all is fitted again.

    A laser sheet that is not the plane of the triangulation displaces points in the same way in every scan, which no
    scatter shows: how far it displaces the unknowns, by the description of the sensor, counts as a standard deviation
    beside that of the noise.

    Raises `CalibrationError` if there are too few points, or the poses do not determine the unknowns; the message
    states what is missing.
    """
    _check(problem)
    state, observed = _start(problem), len(problem.observations.sigma)
    assigned = _assigned(problem, state)
    _, moments, basis = _linearised(assigned, state)
    require_determined(assigned, moments, basis, np.log(_ASSUMED[problem.robot_noise]))
    problem, state, kept = _coarse_fit(problem, state)
    inner = replace(problem, observations=problem.observations.chosen(kept))
    found, moments, basis = _linearised(inner, state)
    log_variances = equal_shares(moments)
    for _ in range(_ROUNDS):
        state = _fitted(inner, state, found.variance, log_variances)
        state = _with_lost_exposures(problem, state, kept, log_variances)
        residuals = _residuals(problem, state)
        limit = _OUTLIER * np.sqrt(residuals.variance * np.exp(log_variances[0]))
        was_kept, kept = kept, np.abs(residuals.gap) < limit
        inner = replace(problem, observations=problem.observations.chosen(kept))
        found, moments, basis = _linearised(inner, state)
        try:
            last = estimate(moments.by_basis(basis))
        except np.linalg.LinAlgError:  # what the data allow for the errors of exposures explains all that they show
            raise CalibrationError(f"the exposures hardly determine the unknowns. {_advice(problem)}") from None
        change = np.abs(last.log_variances - log_variances).max()
        log_variances = last.log_variances
        if change < _SETTLED and np.array_equal(was_kept, kept):
            break
    require_determined(inner, moments, basis, log_variances)
    if problem.kinematics.belt is not None and kept.sum() < _LEAST_ON_BELT * observed:
        raise CalibrationError(
            f"{kept.mean():.0%} of the points near the part agree with it, expected {_LEAST_ON_BELT:.0%}."
            f" {_advice(problem)}"
        )
    if kept.sum() < _LEAST_SHARE * observed:
        raise CalibrationError(
            f"{kept.sum()} of {observed} points agree with the artefact", expected="two thirds of them"
        )
    return _result(inner, state, moments, basis, last, found, len(kept))


def _coarse_fit(problem: CalibrationProblem, state: _State) -> tuple[CalibrationProblem, _State, NDArray[np.bool_]]:
    """Robust fits with points assigned anew, until these stay; the problem of these points, and which fit (m,)."""
    assigned = _assigned(problem, state)
    for _ in range(_MOST_ASSIGNMENTS):
        state, kept = _coarse(assigned, state)
        before, assigned = assigned, _assigned(problem, state)
        if np.array_equal(_shapes(before), _shapes(assigned)):
            return before, state, kept
    return assigned, *_coarse(assigned, state)


def _shapes(problem: CalibrationProblem) -> NDArray[np.intp]:
    assert problem.observations.shape is not None
    return problem.observations.shape


def _assigned(problem: CalibrationProblem, state: _State) -> CalibrationProblem:
    """The problem with the points that belong to a shape."""
    data = problem.observations
    if data.shape is None:
        points = points_on_platter(data, problem.kinematics.poses(data.readings, state.deviations))
        local = pose.transform_points(pose.inverse(state.platter_from_artefact), points)
        data = replace(data, shape=problem.artefact.surface.assign(local))
    assert data.shape is not None
    usable = data.shape >= 0
    if usable.sum() < _LEAST_POINTS * len(problem.free):
        raise CalibrationError(
            f"{usable.sum()} points lie on the artefact", expected=f"{_LEAST_POINTS * len(problem.free)} or more"
        )
    return replace(problem, observations=data.chosen(usable))


def _linearised(problem: CalibrationProblem, state: _State) -> tuple[_Residuals, Moments, Array]:
    """Residuals, moments of all unknowns, and the basis of those that the artefact's surface can determine."""
    found = _residuals(problem, state)
    moments = _moments(problem, found, found.variance)
    return found, moments, determined_basis(moments, len(problem.free))


def _start(problem: CalibrationProblem) -> _State:
    return _State(
        dict.fromkeys(problem.free, 0.0) | dict(problem.start),
        problem.artefact.platter_from_artefact.copy(),
        np.zeros(len(problem.artefact.unknown_sizes)),
        np.zeros((len(problem.observations.readings), 0)),
    )


def require_known(free: Sequence[str], kinematics: CellKinematics) -> None:
    """Raise `CalibrationError` naming the first of the deviations `free` that is none of the cell."""
    names = kinematics.names
    unknown = [name for name in free if name not in names]
    if unknown:
        raise CalibrationError(
            "is not a deviation of the cell", key="also", value=unknown[0], expected=f"one of {', '.join(names)}"
        )


def _check(problem: CalibrationProblem) -> None:
    require_known(problem.free, problem.kinematics)
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


def _residuals(problem: CalibrationProblem, state: _State, is_coarse: bool = False) -> _Residuals:
    """Residuals; `is_coarse` ones are distances along the normals, which are safe far from the solution."""
    data = problem.observations
    poses = problem.kinematics.poses(data.readings, state.deviations)
    modes = _modes(problem, poses)
    errors = np.zeros((len(data.readings), _SHARED))
    if state.errors.shape[1]:
        errors = np.einsum("nkd,nd->nk", np.concatenate(modes, -1), state.errors)
    correction = pose.from_rotation(pose.exp_rotation(-errors[:, 3:6]), -errors[:, :3])
    sensor = correction @ poses.platter_from_sensor
    points, own = points_on_platter(data, replace(poses, platter_from_sensor=sensor)), errors[data.frame]
    distance, normal = _distances(problem, state, points)
    distance = distance - own[:, 6]
    gap, cosine = distance, np.ones(len(distance))
    if not is_coarse:
        across = sensor[data.frame, :3, 0]
        along = normal - np.einsum("mi,mi->m", normal, across)[:, None] * across
        along /= np.maximum(np.linalg.norm(along, axis=1), MOST_OBLIQUE)[:, None]
        gap = distance / np.maximum(np.einsum("mi,mi->m", normal, along), MOST_OBLIQUE)
        # A second step of Newton's method: where the surface is curved, the first ends beside it.
        points = points - gap[:, None] * along
        distance, normal = _distances(problem, state, points)
        cosine = np.maximum(np.einsum("mi,mi->m", normal, along), MOST_OBLIQUE)
        gap = gap + (distance - own[:, 6]) / cosine
    wrench = np.hstack([normal, np.cross(points, normal)])
    variance = (data.sigma / cosine) ** 2
    if data.direction is not None:
        in_normal = np.einsum("mi,mi->m", normal, np.einsum("mij,mj->mi", sensor[data.frame, :3, :3], data.direction))
        variance = variance * np.maximum(in_normal**2, MOST_OBLIQUE**2)
    modes = tuple(_about(errors, mode) for mode in modes)
    if state.errors.shape[1]:
        own = np.einsum("nkd,nd->nk", np.concatenate(modes, -1), state.errors)[data.frame]
    explained = (np.einsum("mk,mk->m", wrench, own[:, :6]) + own[:, 6]) / cosine
    motion = np.stack([poses.deviations[name] for name in problem.free], -1)
    rotation, offset = correction[:, :3, :3], correction[:, :3, 3]
    turned = np.concatenate([rotation @ motion[:, :3], rotation @ motion[:, 3:]], 1)
    turned[:, :3] += np.cross(offset[:, :, None], turned[:, 3:], axis=1)
    if not problem.artefact.is_pose_known:
        turned = np.concatenate([turned, np.broadcast_to(-np.eye(6), (len(turned), 6, 6))], -1)
    return _Residuals(gap, variance, explained, cosine, wrench, turned, modes, poses)


def _about(errors: Array, mode: Array) -> Array:
    """Derivative (n, 7, d) of the motion by errors (n, 7) in the direction of a mode: rotations do not commute."""
    rate = errors[:, 3:6, None]
    across = np.cross(rate, mode[:, 3:6], axis=1)
    turn = mode[:, 3:6] - across / 2 + np.cross(rate, across, axis=1) / 6
    velocity = mode[:, :3] + np.cross(turn, errors[:, :3, None], axis=1)
    return np.concatenate([velocity, turn, mode[:, 6:]], 1)


def _distances(problem: CalibrationProblem, state: _State, points: Array) -> tuple[Array, Array]:
    """Distances (m,) of points (m, 3) on the platter from the surface, and its normals (m, 3)."""
    artefact, shape = problem.artefact, _shapes(problem)
    local = pose.transform_points(pose.inverse(state.platter_from_artefact), points)
    distance, normal = artefact.surface.distance(local, shape)
    for number, size in zip(artefact.unknown_sizes, state.sizes, strict=True):
        distance = distance - np.where(shape == number, size, 0.0)
    return distance, normal @ state.platter_from_artefact[:3, :3].T


def _moments(problem: CalibrationProblem, found: _Residuals, variance: Array) -> Moments:
    """Regressors are the six components of the wrench, an offset, and the sizes; unknowns in units of `UNIT`.

    Points of infinite variance are left out.
    """
    artefact, data, shape = problem.artefact, problem.observations, _shapes(problem)
    sizes = [-np.equal(shape, number).astype(float) for number in artefact.unknown_sizes]
    regressors = np.column_stack([found.wrench, np.ones(len(shape)), *sizes]) / found.cosine[:, None]
    rows = np.column_stack([regressors, found.gap + found.explained])
    used = np.isfinite(variance)
    n, k = len(data.readings), rows.shape[1] - 1
    second = Moments.of_exposures(rows[used] / np.sqrt(variance[used, None]), data.frame[used], n)[None]
    moved, count = found.motion.shape[-1], len(sizes)
    design = np.zeros((n, k, moved + count))
    design[:, :6, :moved], design[:, _SHARED:, moved:] = found.motion, np.eye(count)
    modes = tuple(np.pad(mode, ((0, 0), (0, count), (0, 0))) for mode in found.modes)
    return Moments(second, UNIT * design, modes, np.array([used.sum()]))


def _modes(problem: CalibrationProblem, poses: SensorPoses) -> tuple[Array, ...]:
    """Errors that all points of an exposure share: of the robot, and last an offset from the surface.

    The offset models errors of sensor and artefact that no motion explains, such as an error of the sphere's radius
    that differs between profiles; without it the distance from the sphere's centre would seem better known than it is.
    """
    if problem.robot_noise == "none":
        return ()
    if problem.robot_noise == "joints":
        kinds: tuple[Array, ...] = (np.concatenate([poses.joints, poses.table[:, :, None]], -1),)
    else:
        kinds = (poses.flange[:, :, :3], poses.flange[:, :, 3:])
    offset = np.tile(np.eye(_SHARED)[:, -1:], (len(poses.table), 1, 1))
    return (*(np.pad(kind, ((0, 0), (0, 1), (0, 0))) for kind in kinds), offset)


def _coarse(problem: CalibrationProblem, state: _State) -> tuple[_State, NDArray[np.bool_]]:
    """Robust fit without pose errors, by Tukey's weights; which points (m,) belong to the artefact."""
    weights = np.ones(len(problem.observations.sigma))
    for _ in range(_MOST_STEPS):
        found = _residuals(problem, state, is_coarse=True)
        scale = max(1.4826 * float(np.median(np.abs(found.gap))), _COARSE_FLOOR)
        relative = found.gap / (_OUTLIER * scale)
        weights = np.where(np.abs(relative) < 1, (1 - relative**2) ** 2, 0.0)
        with np.errstate(divide="ignore"):
            variance = scale**2 / weights
        before, state = state, _fitted(problem, state, variance, np.zeros(1), 1)
        if np.abs(_difference(before, state)).max() < _COARSE * UNIT:
            break
    return state, np.asarray(weights > 0)


def _fitted(
    problem: CalibrationProblem, state: _State, variance: Array, log_variances: Array, steps: int = _MOST_STEPS
) -> _State:
    """The state of the least sum of squares at given variances.

    If the variances of points followed the geometry, they would lower the sum by steps to oblique views. Without those
    of shared errors there are none.

    Raises `CalibrationError` if more than one step is permitted, and they do not suffice.
    """

    def equations(at: _State) -> tuple[NormalEquations, Callable[[Array], _State]]:
        found = _residuals(problem, at, is_coarse=steps == 1)
        moments = _moments(problem, found, variance)
        if len(log_variances) == 1:
            moments = replace(moments, modes=())
        squares = np.array([np.sum(found.gap**2 / variance)])
        normal, errors_after = equations_at(moments, squares, at.errors, log_variances)
        return normal, lambda step: replace(_moved(problem, at, step), errors=errors_after(step))

    state, is_settled = minimise(equations, state, steps)
    if steps > 1 and not is_settled:
        raise CalibrationError(f"the calibration did not converge in {_MOST_STEPS} steps: check start and artefact")
    return state


def _moved(problem: CalibrationProblem, state: _State, x: Array) -> _State:
    """The state after a step (unknowns,) in units of `UNIT`."""
    step, count = x * UNIT, len(problem.free)
    if not np.abs(step).max(initial=0.0) < _DIVERGED:
        raise CalibrationError(f"the fit of the artefact diverges. {_advice(problem)}")
    deviations = dict(state.deviations)
    for name, change in zip(problem.free, step[:count].tolist(), strict=True):
        deviations[name] += change
    artefact = state.platter_from_artefact
    if not problem.artefact.is_pose_known:
        velocity, rate = step[count : count + 3], step[count + 3 : count + 6]
        artefact = pose.from_rotation(pose.exp_rotation(rate), velocity) @ artefact
        count += 6
    return _State(deviations, artefact, state.sizes + step[count:], state.errors)


def _difference(a: _State, b: _State) -> Array:
    """Differences of all unknowns."""
    deviations = [b.deviations[name] - value for name, value in a.deviations.items()]
    artefact = (b.platter_from_artefact - a.platter_from_artefact).ravel()
    return np.concatenate([deviations, artefact, b.sizes - a.sizes])


def _with_lost_exposures(
    problem: CalibrationProblem, state: _State, kept: NDArray[np.bool_], log_variances: Array
) -> _State:
    """The state with errors of exposures whose points are left out, by these points, where they are plausible.

    The coarse fit takes points that a large pose error moves far for outliers: where exposures show pose errors to
    different extents, by the slopes of a surface, these are whole exposures, and without them the errors that remain
    would seem too small.
    """
    data, counts = problem.observations, len(state.errors)
    used = np.bincount(data.frame[kept], minlength=counts)
    lost = (used < _LEAST_POINTS) & (np.bincount(data.frame, minlength=counts) >= _LEAST_POINTS)
    if not (lost.any() and state.errors.shape[1]):
        return state
    found = _residuals(problem, state)
    moments = _moments(problem, found, np.where(lost[data.frame], found.variance, np.inf))
    errors = equations_at(moments, np.zeros(1), state.errors, log_variances)[1](np.zeros(moments.design.shape[-1]))
    deviations = np.repeat(np.exp(0.5 * log_variances[1:]), [mode.shape[-1] for mode in found.modes])
    plausible = lost & (np.abs(errors) <= _OUTLIER * deviations).all(1)
    return replace(state, errors=np.where(plausible[:, None], errors, state.errors))


def _result(
    problem: CalibrationProblem,
    state: _State,
    moments: Moments,
    basis: Array,
    last: Estimate,
    found: _Residuals,
    points: int,
) -> CalibrationResult:
    count = len(problem.free)
    rows = basis[:count]
    noise = np.exp(0.5 * last.log_variances)
    moments = moments.by_basis(basis)
    neglected = _neglected(problem, found, basis, last)
    whole = replace(last, covariance=last.covariance + np.outer(neglected, neglected))
    # A profile is displaced along y and z of the sensor, and offset along its normals.
    by_displacement = np.zeros((len(found.motion), moments.design.shape[1], 3))
    by_displacement[:, :3, :2], by_displacement[:, 6, 2] = found.poses.platter_from_sensor[:, :3, 1:3], 1.0
    return CalibrationResult(
        names=problem.free,
        values=np.array([state.deviations[name] for name in problem.free]),
        joint_covariance=basis @ whole.covariance @ basis.T * UNIT**2,
        degrees_of_freedom=whole.of_values(rows)[1],
        neglected=rows @ neglected * UNIT,
        held={name: value for name, value in state.deviations.items() if name not in problem.free},
        platter_from_artefact=state.platter_from_artefact,
        sizes=state.sizes,
        residuals=(found.gap + found.explained) * found.cosine,
        frame=problem.observations.frame,
        points=points,
        noise_of_points=float(noise[0]),
        noise_of_robot=tuple(noise[1:-1].tolist()),
        noise_of_surface=float(noise[-1]) if len(noise) > 1 else 0.0,
        left_out=left_out(moments, last, by_displacement, 2),
    )


def _neglected(problem: CalibrationProblem, found: _Residuals, basis: Array, last: Estimate) -> Array:
    """Change (r,) of the fit, in units of `UNIT`, if the points were on the described laser sheet."""
    data = problem.observations
    if data.off_sheet is None:
        return np.zeros(basis.shape[1])
    sensor = found.poses.platter_from_sensor[data.frame, :3, :3]
    effect = np.einsum("mi,mij,mj->m", found.wrench[:, :3], sensor, data.off_sheet)
    displaced = replace(found, gap=effect / found.cosine, explained=np.zeros(len(effect)))
    moments = _moments(problem, displaced, found.variance).by_basis(basis)
    return np.asarray(last.covariance @ normal_equations(moments, last.log_variances).gradient)
