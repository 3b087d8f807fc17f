"""Start of a calibration from profiles of a sphere: circles in the profiles, then the sphere's centres.

It needs no nominal pose of the sensor that is good to millimetres, as the assignment of single points does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scancell.calibration.cell.kinematics import TOOL, CellKinematics
from scancell.calibration.cell.problem import Observations
from scancell.geometry import pose

Array = NDArray[np.float64]

_TRIALS = 200  # circles through three points of a profile
_LEAST_POINTS = 20  # on a circle
_NEAR = 30e-6  # m from a circle, at least; or five standard deviations of the points
_LARGEST = 1.01  # radius of a circle relative to that of the sphere
_STEPS = 50
_UNIT = 1e-3
_DAMPING = 1e-4


@dataclass(frozen=True)
class SphereStart:
    """Deviations of the tool (SI), the centre (3,) of the sphere on the platter, m, and the exposures that agree.

    `rms` is the distance between the centres that the exposures give and this one, m.
    """

    deviations: dict[str, float]
    centre: Array
    exposures: int
    rms: float


def circle_in(points: Array, sigma: float, largest: float, rng: np.random.Generator) -> tuple[Array, float] | None:
    """Centre (2,) and radius, m, of the circle in the plane on which most of points (n, 2) lie; None without one.

    Circles through three random points are tried (RANSAC; Fischler & Bolles 1981), up to a radius `largest`, and the
    best is fitted to its points by Kåsa's linear equations.
    """
    if len(points) < _LEAST_POINTS:
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
    if on_circle.sum() < _LEAST_POINTS:
        return None
    chosen = points[on_circle]
    middle = chosen.mean(0)
    rows = np.column_stack([2.0 * (chosen - middle), np.ones(len(chosen))])
    u, v, w = np.linalg.lstsq(rows, ((chosen - middle) ** 2).sum(1), rcond=None)[0]
    return middle + np.array([u, v]), float(np.sqrt(max(w + u**2 + v**2, 0.0)))


def sphere_start(
    kinematics: CellKinematics, data: Observations, radius: float, centre: Array, seed: int = 0
) -> SphereStart | None:
    """Deviations of the tool from the circles in profiles of a sphere of known radius; None with fewer than four.

    The plane of the laser cuts the sphere in a circle of radius r at a distance of ``sqrt(radius² - r²)`` from its
    centre, on one side or the other. The side is chosen anew in every step of the fit, by what agrees better.

    Parameters
    ----------
    centre
        (3,) about where the sphere is on the platter, m.
    """
    rng = np.random.default_rng(seed)
    frames, circles, sides = [], [], []
    for frame in np.unique(data.frame):
        rows = data.frame == frame
        points, sigma = data.points_in_sensor[rows][:, 1:], float(np.median(data.sigma[rows]))
        found = circle_in(points, sigma, _LARGEST * radius, rng)
        if found is not None:
            frames.append(frame)
            circles.append(found[0])
            sides.append(np.sqrt(max(radius**2 - found[1] ** 2, 0.0)))
    if len(frames) < 4:
        return None
    readings = data.readings.rows(np.array(frames, np.intp))
    across, in_plane = np.array(sides), np.array(circles)
    deviations, centre = dict.fromkeys(TOOL, 0.0), centre.copy()
    weights = np.ones(len(frames))
    away = np.zeros((len(frames), 3))
    for _ in range(_STEPS):
        poses = kinematics.poses(readings, deviations)
        both = [
            pose.transform_each(poses.platter_from_sensor, np.column_stack([side * across, in_plane]))
            for side in (1, -1)
        ]
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
        if np.abs(x).max() < 1e-3:
            break
    agree = np.linalg.norm(away, axis=1) < 5.0 * max(float(np.median(np.linalg.norm(away, axis=1))), 1e-6)
    return SphereStart(deviations, centre, int(agree.sum()), float(np.sqrt(np.mean((away[agree] ** 2).sum(1)))))
