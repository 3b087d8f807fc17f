"""SciPy: ordinary least squares of the distances of all points from the sphere, as if the robot had no errors."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from benchmarks.board_views import pose_of
from benchmarks.planning_cases import path_poses
from benchmarks.tracks.table import NAMES

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
