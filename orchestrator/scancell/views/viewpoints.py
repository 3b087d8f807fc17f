"""Where the camera of a picture stands: fixed, turning around the cell, or following the sensor."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from scancell.geometry import pose
from scancell.nominal.cell import Body
from scancell.views.camera import PinholeCamera, direction, framing, looking_at
from scancell.views.recorded_run import RecordedRun

Array = NDArray[np.float64]
View = Literal["cell", "part", "orbit", "sensor"]
# Camera at a time of the run, with this share (0 to 1) of the pictures taken.
CameraPath = Callable[[float, float], PinholeCamera]

_AZIMUTH, _ELEVATION = -52.0, 24.0  # deg, of the standard view
_PART_ELEVATION = 38.0  # deg: from lower, a part's top is hardly seen
_SAMPLES = 16  # of the run, at which everything is kept in view
_MOST_VERTICES = 150  # of a body that framing looks at


def camera_path(view: View, run: RecordedRun, size: tuple[int, int]) -> CameraPath:
    """The camera of a view for pictures of `size` (width, height), px.

    ``cell`` is fixed and has the whole cell in view at all times, ``part`` the table and the part, larger; ``orbit``
    goes once around the cell; ``sensor`` keeps the sensor and what it measures in the middle.
    """
    times = np.linspace(run.motion.start, run.motion.duration, _SAMPLES)
    bodies = run.cell.bodies
    if view == "part":
        near = [body for body in bodies if body.moves_with in ("table", "part")]
        fixed = framing(_swept(near, run, times), _AZIMUTH, _PART_ELEVATION, size)
        return lambda time, share: fixed
    if view == "sensor":
        return _following(run, size)
    swept = _swept(bodies, run, times)
    if view == "cell":
        whole = framing(swept, _AZIMUTH, _ELEVATION, size)
        return lambda time, share: whole
    return _orbiting(swept, size)


def _swept(bodies: list[Body] | tuple[Body, ...], run: RecordedRun, times: Array) -> Array:
    """World points (n, 3) of some vertices of bodies at some times."""
    found = []
    for frames in map(run.motion.frames, times.tolist()):
        for body in bodies:
            vertices = body.mesh.vertices[:: max(1, len(body.mesh.vertices) // _MOST_VERTICES)]
            found.append(pose.transform_points(frames[body.moves_with], vertices))
    return np.concatenate(found)


def _orbiting(points: Array, size: tuple[int, int]) -> CameraPath:
    """Once around points (n, 3), which stay in view, each taken as the circle that it draws around the middle."""
    middle = (points.min(0) + points.max(0)) / 2
    radius = np.hypot(*(points - middle)[:, :2].T)
    around = np.radians(np.arange(0, 360, 15))[:, None]
    circles = np.stack(np.broadcast_arrays(radius * np.cos(around), radius * np.sin(around), points[:, 2] - middle[2]))
    framed = framing(middle + circles.reshape(3, -1).T, _AZIMUTH, _ELEVATION, size)

    def camera(time: float, share: float) -> PinholeCamera:
        turn = pose.rotation_about(2, 2 * np.pi * share)
        about_middle = pose.from_rotation(turn, middle - turn @ middle)
        return replace(framed, world_from_camera=about_middle @ framed.world_from_camera)

    return camera


def _following(run: RecordedRun, size: tuple[int, int]) -> CameraPath:
    """From a fixed direction, with the middle of sensor and stripe in the middle of the picture."""
    far = 1e-3 * run.setup.sensor.range.far_mm
    housing = next((body.mesh for body in run.cell.bodies if body.moves_with == "sensor"), None)
    extent = far if housing is None else float(np.linalg.norm(np.ptp(housing.bounds, axis=0)))
    away = 2.0 * (far + extent) * direction(_AZIMUTH, _ELEVATION)

    def camera(time: float, share: float) -> PinholeCamera:
        frames: Mapping[str, Array] = run.motion.frames(time)
        target = frames["sensor"][:3, 3] + 0.4 * far * frames["sensor"][:3, 2]
        return looking_at(target + away, target, size)

    return camera
