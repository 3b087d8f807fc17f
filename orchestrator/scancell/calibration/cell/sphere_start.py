"""Start of a calibration from profiles of a sphere: circles in the profiles, then the sphere's centres.

It needs no nominal pose of the sensor that is good to millimetres, as the assignment of single points does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scancell.calibration.cell.kinematics import TOOL, AxisReadings, CellKinematics
from scancell.calibration.cell.problem import Observations
from scancell.geometry import pose

Array = NDArray[np.float64]

_TRIALS = 200  # circles through three points of a profile
_LEAST_CIRCLE_POINTS = 20  # on a circle
_LEAST_CIRCLES = 4
_NEAR = 30e-6  # m from a circle, at least; or five standard deviations of the points
_LARGEST_CIRCLE = 1.01  # radius of a circle relative to that of the sphere
_STEPS = 50
_HOPELESS = 10e-3, 15  # m, steps: centres that are farther apart after so many do not come to agree
_UNIT = 1e-3
_DAMPING = 1e-4


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
    chosen = points[on_circle]
    middle = chosen.mean(0)
    rows = np.column_stack([2.0 * (chosen - middle), np.ones(len(chosen))])
    u, v, w = np.linalg.lstsq(rows, ((chosen - middle) ** 2).sum(1), rcond=None)[0]
    return middle + np.array([u, v]), float(np.sqrt(max(w + u**2 + v**2, 0.0)))


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


def circles_of(data: Observations, radius: float, largest: float = _LARGEST_CIRCLE, seed: int = 0) -> Circles:
    """Circles in the profiles of a sphere of known radius, up to `largest` radii.

    The plane of the laser cuts the sphere in a circle of radius r at a distance of ``sqrt(radius² - r²)`` from its
    centre, on one side or the other.
    """
    rng = np.random.default_rng(seed)
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
        Of all exposures.
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
    nominal = kinematics.flange_from_sensor
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
        u, _, vt = np.linalg.svd(np.column_stack([np.cross(y_axis, z_axis), y_axis, z_axis]))
        axes = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
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
