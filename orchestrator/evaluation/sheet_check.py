"""How far off the laser's sheet the points of a profile truly lie, told by cameras that see the same place."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

import sensor_rt

Array = NDArray[np.float64]

_GAP = 0.3e-3  # m along the profile: points farther apart do not tell what is between them


def off_sheet(profiles: Any, sensor: sensor_rt.Sensor) -> Array:
    """Distance (m,), m, along the sensor's X by which each point is off its sheet; NaN where no second camera sees it.

    A camera with its centre at C places what it sees at P, where its ray meets the sheet. Something that is truly d off
    the sheet lies on that ray at ``P + d (s, t)`` in z and y, with ``s = (P_z - C_z) / (P_x - C_x)`` and t alike. Two
    cameras on different sides see it in different places of the sheet; with the profile ``z(y)`` of the other one, to
    first order, ``d = (P_z - z(P_y)) / (s' - s + (t - t') dz/dy)``.
    """
    points = np.asarray(profiles.points_in_sensor, float)
    frame, camera = np.asarray(profiles.frame), np.asarray(profiles.camera)
    centres = np.array([one.sensor_from_camera[:3, 3] for one in sensor.cameras])
    found = np.full(len(points), np.nan)
    for one_frame in np.unique(frame):
        of_frame = np.flatnonzero(frame == one_frame)
        for own in range(len(centres)):
            rows = of_frame[camera[of_frame] == own]
            others = of_frame[camera[of_frame] == (own + 1) % len(centres)]
            if len(rows) and len(others) > 1 and len(centres) > 1:
                found[rows] = _departure(points[rows], centres[own], points[others], centres[(own + 1) % len(centres)])
    return found


def _departure(points: Array, centre: Array, others: Array, other_centre: Array) -> Array:
    """Distances (n,) of points (n, 3) off the sheet, by the points (m, 3) of the other camera."""
    others = others[np.argsort(others[:, 1], kind="stable")]
    y, z = others[:, 1], others[:, 2]
    after = np.clip(np.searchsorted(y, points[:, 1]), 1, len(y) - 1)
    step = y[after] - y[after - 1]
    inside = (points[:, 1] >= y[after - 1]) & (points[:, 1] <= y[after]) & (step > 0) & (step < _GAP)
    slope = np.divide(z[after] - z[after - 1], step, out=np.zeros(len(step)), where=inside)
    across = z[after - 1] + slope * (points[:, 1] - y[after - 1])
    t, s = _lean(points, centre)
    there = np.stack([points[:, 0], points[:, 1], across], -1)
    other_t, other_s = _lean(there, other_centre)
    lever = other_s - s + (t - other_t) * slope
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(inside, (points[:, 2] - across) / lever, np.nan)


def _lean(points: Array, centre: Array) -> tuple[Array, Array]:
    """Change (n,) of y and of z along the rays to points (n, 3) per change of x."""
    way = points - centre
    return way[:, 1] / way[:, 0], way[:, 2] / way[:, 0]
