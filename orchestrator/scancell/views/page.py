"""A recorded run as one HTML file that needs no network: the cell in 3D with a time slider."""

from __future__ import annotations

import base64
import html
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.files import atomic_write
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh, clustered
from scancell.views.coloured_cloud import ColourBy, ColouredCloud, coloured_by
from scancell.views.pictures import painted
from scancell.views.recorded_run import RecordedRun

Array = NDArray[np.float64]

_SAMPLES = 1200  # of the poses at most
_STEP = 0.05  # s between them at least
_MANY_FACES = 25_000  # of a body, from which on it is shown by a coarser mesh
_CELLS = 120  # of that mesh along the largest extent
_TEMPLATE = Path(__file__).with_name("page.html")


def write_page(run: RecordedRun, out: str | Path, *, colour: ColourBy = "deviation", threads: int = 0) -> int:
    """Write a run as one HTML file, and return its size in bytes: 17.3 for each point, and the meshes.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    data = json.dumps(_content(run, colour, threads), separators=(",", ":")).replace("<", "\\u003c")
    text = _TEMPLATE.read_text(encoding="utf-8").replace("@TITLE@", html.escape(run.name)).replace("@RUN@", data)
    with atomic_write(out) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return len(text.encode("utf-8"))


def _content(run: RecordedRun, colour: ColourBy, threads: int) -> dict[str, Any]:
    motion, laser = run.motion, run.setup.sensor.laser
    length = motion.duration - motion.start
    samples = int(np.clip(np.ceil(length / _STEP) + 1, 2, _SAMPLES))
    times = motion.start + np.linspace(0.0, length, samples)
    frames = list(run.cell.frame_poses(run.cell.home, 0.0))
    poses = np.array([[at[name] for name in frames] for at in map(motion.frames, times.tolist())])
    flat = np.concatenate([poses[..., :3, 3], pose.quaternion_from_rotation(poses[..., :3, :3])], -1)
    bodies = [
        {**_mesh(body.mesh), "frame": frames.index(body.moves_with), "colour": painted(body, number).colour}
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
        "poses": _packed(flat, "<f4"),
        "exposures": _packed(motion.exposures, "<f4"),
        "bodies": bodies,
        "middle": ((low + high) / 2).tolist(),
        "radius": float(np.linalg.norm(high - low)) / 2,
        "floor": float(low[2]),
        "laser": [1e-3 * laser.source_z_mm, reach, reach * float(np.tan(np.radians(laser.fan_half_angle_deg)))],
        "cloud": _cloud(run, colour, threads),
    }


def displayed(mesh: Mesh) -> Mesh:
    """The mesh, coarser where it has many faces."""
    if len(mesh.faces) <= _MANY_FACES:
        return mesh
    return clustered(mesh, float(np.ptp(mesh.bounds, axis=0).max()) / _CELLS)


def _mesh(mesh: Mesh) -> dict[str, Any]:
    mesh = displayed(mesh)
    return {**_quantised(mesh.vertices, "vertices"), "faces": _packed(mesh.faces, "<u4")}


def _cloud(run: RecordedRun, colour: ColourBy, threads: int) -> dict[str, Any]:
    if run.cloud is None:
        shown = ColouredCloud(
            *(np.zeros((0, 3)),) * 2, np.zeros(0), np.zeros((0, 3)), 0, 1.0, np.zeros((0, 3)), (0, 0), ""
        )
    else:
        shown = coloured_by(run.cloud, run.cloud_points, run.part, colour, threads)
    return {
        **_quantised(shown.points_in_part, "points"),
        "colours": _packed(np.rint(255 * np.sqrt(shown.colours)), "u1"),
        "time": _packed(shown.time, "<f4"),
        "total": shown.total,
        "spacing": shown.spacing,
        "scale": np.rint(shown.scale[::8]).astype(int).tolist(),
        "limits": list(shown.limits),
        "title": shown.title,
    }


def _quantised(points: Array, name: str) -> dict[str, Any]:
    """Points (n, 3) as 16-bit shares of their bounding box."""
    low = points.min(0) if len(points) else np.zeros(3)
    size = np.maximum(points.max(0) - low, 1e-9) if len(points) else np.ones(3)
    return {"low": low.tolist(), "size": size.tolist(), name: _packed(np.rint((points - low) / size * 65535), "<u2")}


def _packed(values: ArrayLike, kind: str) -> str:
    return base64.b64encode(np.asarray(values).astype(kind).tobytes()).decode("ascii")
