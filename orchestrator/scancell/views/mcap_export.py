"""Runs and sessions as MCAP files."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np

from scancell.arguments import checked_arguments
from scancell.closing import Closing
from scancell.evaluation.deviation import deviation_from_mesh
from scancell.files import atomic_write
from scancell.live.camera import CameraFrame
from scancell.live.scan import LiveChunk
from scancell.live.state import LiveState
from scancell.nominal.cell import NominalCell
from scancell.progress import NullProgress, Progress
from scancell.views.mcap_file import McapFile
from scancell.views.recorded_run import RecordedRun

_STEP = 0.02  # s between poses
_CHUNK = 0.1  # s of points in a message


def export_run(run: RecordedRun, out: str | Path, threads: int = 0, progress: Progress | None = None) -> int:
    """Write a recorded run, and return its number of messages.

    ``/tf`` holds the poses of all bodies every 20 ms, ``/scene`` their meshes, ``/profiles`` the points as they are
    measured, in messages of 0.1 s, and ``/cloud`` all of them at the end; points are in the frame ``part`` with
    intensity, quality and deviation from the mesh (m).

    Raises
    ------
    OutputError
        If the file cannot be written.
    MissingExtraError
        If the packages of the extra `workspace` are not installed.
    """
    motion, heard = run.motion, progress or NullProgress()
    times = np.arange(motion.start, motion.duration, _STEP)
    heard.stage("exporting", len(times), "poses")
    with atomic_write(out) as temporary, McapFile(temporary) as file:
        file.bodies(float(times[0]), run.cell.bodies)
        for time in times.tolist():
            frames = motion.frames(time)
            file.transforms(time, {body.name: frames[body.moves_with] for body in run.cell.bodies})
            heard.advance(1)
        return 1 + len(times) + _write_cloud(run, file, threads)


def _write_cloud(run: RecordedRun, file: McapFile, threads: int) -> int:
    """Write the points; the number of messages."""
    cloud = run.cloud
    if cloud is None or not len(cloud):
        return 0
    part = run.cell.part
    columns = {
        "intensity": np.asarray(cloud.intensity),
        "quality": np.asarray(cloud.quality),
        "deviation": deviation_from_mesh(cloud, part, threads).distance,
    }
    number = np.floor(cloud.time / _CHUNK)
    bounds = [0, *(np.flatnonzero(np.diff(number)) + 1).tolist(), len(cloud)]
    for first, end in pairwise(bounds):
        rows = slice(first, end)
        some = {name: values[rows] for name, values in columns.items()}
        file.points("/profiles", float(cloud.time[end - 1]), "part", cloud.points_in_part[rows], some)
    file.points("/cloud", float(cloud.time[-1]), "part", cloud.points_in_part, columns)
    return len(bounds)


class SessionRecorder(Closing):
    """Records a live cell as MCAP: hand it states, chunks of scans and camera frames as they come, from any thread.

    ``/tf`` holds the poses of all bodies, ``/scene`` their meshes, ``/joints`` angles, ``/profiles`` points of scans,
    ``/camera1`` … images, and ``/log`` texts of the cell.

    Parameters
    ----------
    path
        File to be written.
    cell
        The cell with all its bodies (``session.true``).

    Raises
    ------
    MissingExtraError
        If the packages of the extra `workspace` are not installed.
    OutputError
        If the file cannot be written, or is closed; from all methods.

    Examples
    --------
    >>> with scancell.Scanner() as scanner, scanner.session("part.stl", guarded=True) as session:
    ...     live = scancell.LiveCell(session)
    ...     with scancell.SessionRecorder("session.mcap", session.true) as recorder:
    ...         live.submit(scancell.MoveJoints(session.home, table_angle=0.1))
    ...         while session.time < 0.5:
    ...             live.step()
    ...             recorder.state(live.state)
    """

    @checked_arguments
    def __init__(self, path: str | Path, cell: NominalCell) -> None:
        self._file, self._cell = McapFile(Path(path)), cell
        self._last: LiveState | None = None

    @checked_arguments
    def state(self, state: LiveState) -> None:
        """Record `state` (``live.state``), unless it was the last one."""
        last, self._last = self._last, state
        if last is None:
            self._file.bodies(state.time, self._cell.bodies)
        elif state.time <= last.time:
            return
        self._file.transforms(state.time, state.world_from_body)
        names = [*(f"joint {i + 1}" for i in range(len(state.joints))), "table"]
        self._file.joints(state.time, names, np.append(state.joints, state.table_angle))
        for name in ("controller", "message", "refusal", "guard_text", "job"):
            text = getattr(state, name) or ""
            if text != (("" if last is None else getattr(last, name)) or ""):
                self._file.note(state.time, text, name)

    @checked_arguments
    def points(self, chunk: LiveChunk) -> None:
        """Record a `chunk` of points that `LiveScan` handed over, at the time of the last state."""
        columns = {"intensity": chunk.intensity, "quality": chunk.quality, "deviation": chunk.deviation}
        time = 0.0 if self._last is None else self._last.time
        self._file.points("/profiles", time, "part", chunk.points_in_part, columns)

    @checked_arguments
    def cameras(self, frame: CameraFrame) -> None:
        """Record the images of a `frame` of `CameraFeed`, where it has any."""
        for number, image in enumerate(() if frame.images is None else frame.images, start=1):
            self._file.image(f"/camera{number}", frame.time, "sensor", image)

    def close(self) -> None:
        """Complete the file."""
        self._file.close()
