"""scikit-spatial (pip install scikit-spatial): linear least squares of spheres and planes."""

from __future__ import annotations

from typing import Any

import numpy as np
from skspatial.objects import Plane, Sphere

from benchmarks.entries.scipy import ball_points, plate_points, range_of_95
from benchmarks.tracks.acceptance import NAMES

_THINNED = 20  # `Plane.best_fit` of n points takes memory for n × n values


def acceptance(case: dict[str, Any]) -> dict[str, Any]:
    """``Sphere.best_fit`` and ``Plane.best_fit`` through all points near an element; form between quantiles."""
    points, on_plate = ball_points(case), plate_points(case)
    balls = [Sphere.best_fit(one) for one in points]
    plate = Plane.best_fit(on_plate[::_THINNED])
    spacing = balls[0].point.distance_point(balls[1].point) - np.linalg.norm(np.diff(case["centres_mm"], axis=0))
    residuals = [
        np.linalg.norm(one - ball.point, axis=1) - ball.radius for one, ball in zip(points, balls, strict=True)
    ]
    residuals.append((on_plate - plate.point) @ plate.normal)
    sizes = [2 * (ball.radius - case["radius_mm"]) for ball in balls]
    return {"name": NAMES, "value": 1e3 * np.array([*sizes, spacing, *map(range_of_95, residuals)])}
