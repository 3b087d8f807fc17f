"""pyRANSAC-3D (pip install pyransac3d): spheres and planes by random sample consensus."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyransac3d

from benchmarks.entries.scipy import ball_points, plate_points, range_of_95
from benchmarks.tracks.acceptance import NAMES


def acceptance(case: dict[str, Any]) -> dict[str, Any]:
    """``Sphere.fit`` and ``Plane.fit`` with a threshold of three standard deviations; form between quantiles."""
    threshold = 3 * case["noise_mm"]
    found = [pyransac3d.Sphere().fit(points, thresh=threshold, maxIteration=1000)[:2] for points in ball_points(case)]
    residuals = [
        np.linalg.norm(points - np.array(centre), axis=1) - radius
        for points, (centre, radius) in zip(ball_points(case), found, strict=True)
    ]
    plane = np.array(pyransac3d.Plane().fit(plate_points(case), thresh=threshold, maxIteration=1000)[0])
    residuals.append((plate_points(case) @ plane[:3] + plane[3]) / np.linalg.norm(plane[:3]))
    centres = [np.array(centre) for centre, _ in found]
    spacing = np.linalg.norm(centres[1] - centres[0]) - np.linalg.norm(np.diff(case["centres_mm"], axis=0))
    sizes = [2 * (radius - case["radius_mm"]) for _, radius in found]
    return {"name": NAMES, "value": 1e3 * np.array([*sizes, spacing, *map(range_of_95, residuals)])}
