"""SciPy: least squares of the distances of points from spheres and planes, as if the robot had no errors."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from benchmarks.board_views import pose_of
from benchmarks.planning_cases import path_poses
from benchmarks.track import Array
from benchmarks.tracks.acceptance import NAMES as ACCEPTANCE_NAMES
from benchmarks.tracks.table import NAMES

_REACH = 2.0  # mm, of points from the surface that they belong to
_SCALES = np.array([1.0, 1.0, 1.0, 0.1, 0.1, 0.1, 1.0, 1.0, 0.1, 0.1, 1.0, 1.0, 1.0])


def table(case: dict[str, Any]) -> dict[str, Any]:
    """Intervals from the Jacobian and the residuals."""
    flange = path_poses(case["exposures"])
    turns = np.stack(
        [pose_of(Rotation.from_euler("z", a, degrees=True), [0, 0, 0]) for a in case["exposures"]["table_deg"]]
    )
    exposure = case["points"]["exposure"].astype(int)
    points = 1e-3 * np.column_stack([np.zeros(len(exposure)), case["points"]["y_mm"], case["points"]["z_mm"]])
    start = np.r_[np.zeros(10), case["sphere_on_table_mm"]]

    def residuals(x: Any) -> Any:
        sensor = np.array(case["flange_from_sensor"]) @ _moved(x[:3], x[3:6])
        axis = np.array(case["base_from_table"]) @ _moved([*x[6:8], 0.0], [*x[8:10], 0.0])
        centres = np.linalg.inv(flange @ sensor) @ axis @ turns @ np.r_[1e-3 * x[10:], 1.0]
        return 1e3 * np.linalg.norm(points - centres[exposure, :3], axis=1) - case["radius_mm"]

    found = least_squares(residuals, start, method="lm", x_scale=_SCALES)
    variance = 2 * found.cost / (len(points) - len(start))
    sigma = np.sqrt(variance * np.diag(np.linalg.inv(found.jac.T @ found.jac)))
    return {"name": NAMES, "value": found.x[:10], "half_width": 1.96 * sigma[:10]}


def _moved(position: Any, angles_deg: Any) -> Any:
    return pose_of(Rotation.from_euler("XYZ", angles_deg, degrees=True), 1e-3 * np.asarray(position))


def ball_points(case: dict[str, Any]) -> list[Array]:
    """Points (n, 3), mm, within 2 mm of each nominal ball and away from its stem."""
    return [_points_of_ball(case, np.array(centre)) for centre in case["centres_mm"]]


def _points_of_ball(case: dict[str, Any], centre: Array) -> Array:
    points = _points(case)
    away = points - centre
    near = np.abs(np.linalg.norm(away, axis=1) - case["radius_mm"]) < _REACH
    stem = (away[:, 2] < 0) & (np.hypot(*away.T[:2]) < case["stem_radius_mm"] + _REACH)
    return np.asarray(points[near & ~stem])


def plate_points(case: dict[str, Any]) -> Array:
    """Points (n, 3), mm, within 2 mm of the plate's nominal top, away from its edges and the stems."""
    points, half = _points(case), np.array(case["plate_mm"]) / 2
    inside = (np.abs(points[:, 2]) < _REACH) & (np.abs(points[:, :2]) < half - 1.0).all(1)
    stems = [np.hypot(*(points - centre).T[:2]) < case["stem_radius_mm"] + _REACH for centre in case["centres_mm"]]
    return np.asarray(points[inside & ~np.any(stems, axis=0)])


def _points(case: dict[str, Any]) -> Array:
    return np.column_stack([case["points"][axis] for axis in ("x_mm", "y_mm", "z_mm")])


def range_of_95(residuals: Array) -> float:
    """Between the quantiles of 2.5 and 97.5 %."""
    low, high = np.quantile(residuals, [0.025, 0.975])
    return float(high - low)


def acceptance(case: dict[str, Any]) -> dict[str, Any]:
    """Robust loss (soft L1); form between quantiles of the residuals."""
    balls, forms, variances = [], [], []
    scale = 2 * case["noise_mm"]
    for points, centre in zip(ball_points(case), case["centres_mm"], strict=True):

        def residuals(x: Any, points: Array = points) -> Any:
            return np.linalg.norm(points - x[:3], axis=1) - x[3]

        found = least_squares(residuals, [*centre, case["radius_mm"]], loss="soft_l1", f_scale=scale)
        rest = residuals(found.x)
        variance = np.median(np.abs(rest)) ** 2 / 0.6745**2
        balls.append(found.x)
        forms.append(range_of_95(rest))
        variances.append(variance * np.linalg.inv(found.jac.T @ found.jac))
    on_plate = plate_points(case)
    level = np.column_stack([on_plate[:, :2], np.ones(len(on_plate))])
    plate = least_squares(lambda x: on_plate[:, 2] - level @ x, np.zeros(3), loss="soft_l1", f_scale=scale)
    forms.append(range_of_95(on_plate[:, 2] - level @ plate.x))
    spacing = np.linalg.norm(balls[1][:3] - balls[0][:3]) - np.linalg.norm(np.diff(case["centres_mm"], axis=0))
    sizes = [2 * (ball[3] - case["radius_mm"]) for ball in balls]
    sigma = [*(2 * np.sqrt(v[3, 3]) for v in variances), np.sqrt(sum(v[0, 0] for v in variances)), 0.0, 0.0, 0.0]
    value = 1e3 * np.array([*sizes, spacing, *forms])
    return {"name": ACCEPTANCE_NAMES, "value": value, "half_width": 1.96e3 * np.array(sigma)}
