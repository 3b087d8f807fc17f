"""A recorded run as one HTML file that needs no network: the cell in 3D with a time slider."""

from __future__ import annotations

import html
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell.geometry import pose
from scancell.output.web_page import packed, packed_mesh, quantised, script_data, write_filled
from scancell.views.coloured_cloud import ColourBy, ColouredCloud, coloured_by
from scancell.views.pictures import painted
from scancell.views.recorded_run import RecordedRun

Array = NDArray[np.float64]

_SAMPLES = 1200  # of the poses at most
_STEP = 0.05  # s between them at least
_TEMPLATE = Path(__file__).with_name("page.html")


def write_page(run: RecordedRun, out: str | Path, *, colour: ColourBy = "deviation", threads: int = 0) -> int:
    """Write a run as one HTML file, and return its size in bytes: 17.3 for each point, and the meshes.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    return write_filled(_TEMPLATE, out, TITLE=html.escape(run.name), RUN=script_data(_content(run, colour, threads)))


def _content(run: RecordedRun, colour: ColourBy, threads: int) -> dict[str, Any]:
    motion, laser = run.motion, run.setup.sensor.laser
    length = motion.duration - motion.start
    samples = int(np.clip(np.ceil(length / _STEP) + 1, 2, _SAMPLES))
    times = motion.start + np.linspace(0.0, length, samples)
    frames = list(run.cell.frame_poses())
    poses = np.array([[at[name] for name in frames] for at in map(motion.frames, times.tolist())])
    flat = np.concatenate([poses[..., :3, 3], pose.quaternion_from_rotation(poses[..., :3, :3])], -1)
    bodies = [
        {**packed_mesh(body.mesh), "frame": frames.index(body.moves_with), "colour": painted(body, number).colour}
        for number, body in enumerate(run.cell.bodies)
    ]
    corners = np.concatenate(
        [pose.transform_points(poses[0, frames.index(body.moves_with)], body.mesh.bounds) for body in run.cell.bodies]
    )
    low, high = corners.min(0), corners.max(0)
    reach = 1e-3 * run.setup.sensor.range.far_mm - 1e-3 * laser.source_z_mm
    return {
        "name": run.name,
        "start": motion.start,
        "step": length / (samples - 1),
        "samples": samples,
        "frames": frames,
        "poses": packed(flat, "<f4"),
        "exposures": packed(motion.exposures, "<f4"),
        "bodies": bodies,
        "middle": ((low + high) / 2).tolist(),
        "radius": float(np.linalg.norm(high - low)) / 2,
        "floor": float(low[2]),
        "laser": [1e-3 * laser.source_z_mm, reach, reach * float(np.tan(np.radians(laser.fan_half_angle_deg)))],
        "cloud": _cloud(run, colour, threads),
    }


def _cloud(run: RecordedRun, colour: ColourBy, threads: int) -> dict[str, Any]:
    if run.cloud is None:
        shown = ColouredCloud(
            *(np.zeros((0, 3)),) * 2, np.zeros(0), np.zeros((0, 3)), 0, 1.0, np.zeros((0, 3)), (0, 0), ""
        )
    else:
        shown = coloured_by(run.cloud, run.cloud_points, run.part, colour, threads)
    return {
        **quantised(shown.points_in_part, "points"),
        "colours": packed(np.rint(255 * np.sqrt(shown.colours)), "u1"),
        "time": packed(shown.time, "<f4"),
        "total": shown.total,
        "spacing": shown.spacing,
        "scale": np.rint(shown.scale[::8]).astype(int).tolist(),
        "limits": list(shown.limits),
        "title": shown.title,
    }
