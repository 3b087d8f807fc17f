"""Offset of profile points from the assumed laser sheet, from the disagreement of two cameras."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt

Array = NDArray[np.float64]

_MAX_GAP = 0.3e-3  # m: largest spacing of points between which a profile is interpolated


def sheet_deviation(profiles: Any, sensor: sensor_rt.Sensor) -> Array:
    """Offset (m,), m, of each point from the laser sheet along the sensor's X; NaN unless a second camera sees it.

    A camera with its centre at C triangulates P, where its ray meets the nominal sheet. A surface point at an offset d
    from the sheet lies on the same ray at ``P + d (s, t)`` in z and y, with ``s = (P_z - C_z) / (P_x - C_x)`` and
    ``t = (P_y - C_y) / (P_x - C_x)``. With the profile ``z(y)`` of a second camera (slopes s', t'), to first order,
    ``d = (P_z - z(P_y)) / (s' - s + (t - t') dz/dy)``.

    Parameters
    ----------
    profiles
        Points of any number of frames, with `points_in_sensor` (m, 3), `frame` and `camera` (m,).
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
                found[rows] = _offset(points[rows], centres[own], points[others], centres[(own + 1) % len(centres)])
    return found


def _offset(points: Array, centre: Array, others: Array, other_centre: Array) -> Array:
    """Offsets (n,) of points (n, 3) from the sheet, by the points (m, 3) of the other camera."""
    others = others[np.argsort(others[:, 1], kind="stable")]
    y, z = others[:, 1], others[:, 2]
    after = np.clip(np.searchsorted(y, points[:, 1]), 1, len(y) - 1)
    step = y[after] - y[after - 1]
    inside = (points[:, 1] >= y[after - 1]) & (points[:, 1] <= y[after]) & (step > 0) & (step < _MAX_GAP)
    slope = np.divide(z[after] - z[after - 1], step, out=np.zeros(len(step)), where=inside)
    across = z[after - 1] + slope * (points[:, 1] - y[after - 1])
    t, s = _ray_slopes(points, centre)
    interpolated = np.stack([points[:, 0], points[:, 1], across], -1)
    other_t, other_s = _ray_slopes(interpolated, other_centre)
    sensitivity = other_s - s + (t - other_t) * slope
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(inside, (points[:, 2] - across) / sensitivity, np.nan)


def _ray_slopes(points: Array, centre: Array) -> tuple[Array, Array]:
    """Slopes dy/dx and dz/dx (n,) of the rays from a camera centre (3,) to points (n, 3)."""
    ray = points - centre
    return ray[:, 1] / ray[:, 0], ray[:, 2] / ray[:, 0]
