"""Runs and sessions as MCAP files with Foxglove's protobuf schemas, which Foxglove and rerun open."""

from __future__ import annotations

import io
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image

from scancell.arguments import checked_arguments
from scancell.arrays import Array
from scancell.config.cell import sensor_frame
from scancell.errors import OutputError, require
from scancell.evaluation.deviation import deviation_from_mesh
from scancell.files import atomic_write
from scancell.geometry import pose
from scancell.live.camera import CameraFrame
from scancell.live.scan import LiveChunk
from scancell.live.state import LiveState
from scancell.nominal.cell import NominalCell
from scancell.nominal.parts import Body
from scancell.output.web_page import displayed
from scancell.progress import NullProgress, Progress
from scancell.values import Closing
from scancell.views.pictures import painted
from scancell.views.recorded_run import RecordedRun

_FLOAT32 = 7  # foxglove.PackedElementField.FLOAT32

_STEP = 0.02  # s between poses
_CHUNK = 0.1  # s of points in a message


class McapFile(Closing):
    """Writes a file message by message; any thread may. SI units; times are simulated seconds from 0.

    Raises
    ------
    MissingExtraError
        If the packages of the extra `workspace` are not installed.
    OutputError
        If the file cannot be written, or is closed; from all methods.
    """

    def __init__(self, path: Path) -> None:
        writer = require("mcap_protobuf.writer", "workspace")
        self._path, self._lock = path, threading.Lock()
        with self._naming_the_file():
            self._file = path.open("wb")
            self._writer = writer.Writer(self._file)

    def close(self) -> None:
        """Write the index, without which a file is incomplete."""
        with self._lock, self._naming_the_file():
            if not self._file.closed:
                with self._file:
                    self._writer.finish()

    def transforms(self, time: float, world_from_frame: Mapping[str, Array]) -> None:
        """Poses (4, 4) of frames in the world, on ``/tf``."""
        made = [
            _message(
                "FrameTransform",
                timestamp=_timestamp(time),
                parent_frame_id="world",
                child_frame_id=name,
                translation=_message("Vector3", **_xyz(value[:3, 3])),
                rotation=_quaternion(value),
            )
            for name, value in world_from_frame.items()
        ]
        self._write("/tf", time, _message("FrameTransforms", transforms=made))

    def joints(self, time: float, names: Sequence[str], positions: ArrayLike) -> None:
        """Positions (n,), rad or m, on ``/joints``."""
        values = zip(names, np.asarray(positions, float).tolist(), strict=True)
        made = [_message("JointState", name=name, position=value) for name, value in values]
        self._write("/joints", time, _message("JointStates", timestamp=_timestamp(time), joints=made))

    def points(self, topic: str, time: float, frame: str, xyz: Array, columns: Mapping[str, ArrayLike]) -> None:
        """Points (n, 3) in a frame with further columns (n,), as 32-bit numbers."""
        names = ["x", "y", "z", *columns]
        packed = np.column_stack([xyz, *columns.values()]).astype("<f4")
        fields = [
            _message("PackedElementField", name=name, offset=4 * i, type=_FLOAT32) for i, name in enumerate(names)
        ]
        cloud = _message(
            "PointCloud",
            timestamp=_timestamp(time),
            frame_id=frame,
            pose=_pose(np.eye(4)),
            point_stride=4 * len(names),
            fields=fields,
            data=packed.tobytes(),
        )
        self._write(topic, time, cloud)

    def image(self, topic: str, time: float, frame: str, image: NDArray[np.uint8]) -> None:
        """A grey image (height, width), as PNG."""
        data = io.BytesIO()
        Image.fromarray(image).save(data, "png", compress_level=1)
        made = _message(
            "CompressedImage", timestamp=_timestamp(time), frame_id=frame, format="png", data=data.getvalue()
        )
        self._write(topic, time, made)

    def note(self, time: float, text: str, name: str) -> None:
        """A line of text from `name`, on ``/log``."""
        made = _message("Log", timestamp=_timestamp(time), level=2, message=text, name=name)
        self._write("/log", time, made)

    def bodies(self, time: float, bodies: Iterable[Body]) -> None:
        """The meshes of bodies, each in the frame of its name, on ``/scene``; those with many faces coarser."""
        entities = [_entity(time, body, number) for number, body in enumerate(bodies)]
        self._write("/scene", time, _message("SceneUpdate", entities=entities))

    def _write(self, topic: str, time: float, message: Any) -> None:
        stamp = _nanoseconds(time)
        with self._lock, self._naming_the_file():
            if self._file.closed:
                raise OutputError("is closed", file=self._path)
            self._writer.write_message(topic, message, log_time=stamp, publish_time=stamp)

    @contextmanager
    def _naming_the_file(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise OutputError(f"cannot be written: {error.strerror or error}", file=self._path) from error


def _message(schema: str, **values: Any) -> Any:
    """A message of a schema ``foxglove.<schema>``."""
    return getattr(require(f"foxglove_schemas_protobuf.{schema}_pb2", "workspace"), schema)(**values)


def _nanoseconds(time: float) -> int:
    return round(time * 1e9)


def _timestamp(time: float) -> Any:
    seconds, nanos = divmod(_nanoseconds(time), 1_000_000_000)
    return require("google.protobuf.timestamp_pb2", "workspace").Timestamp(seconds=seconds, nanos=nanos)


def _xyz(values: Array) -> dict[str, float]:
    return dict(zip("xyz", values.tolist(), strict=True))


def _quaternion(world_from_frame: Array) -> Any:
    w, x, y, z = pose.quaternion_from_rotation(world_from_frame[:3, :3]).tolist()
    return _message("Quaternion", x=x, y=y, z=z, w=w)


def _pose(parent_from_frame: Array) -> Any:
    position = _message("Vector3", **_xyz(parent_from_frame[:3, 3]))
    return _message("Pose", position=position, orientation=_quaternion(parent_from_frame))


def _entity(time: float, body: Body, number: int) -> Any:
    mesh = displayed(body.mesh)
    red, green, blue = painted(body, number).colour
    triangles = _message(
        "TriangleListPrimitive",
        pose=_pose(np.eye(4)),
        points=[_message("Point3", x=x, y=y, z=z) for x, y, z in mesh.vertices.tolist()],
        color=_message("Color", r=red, g=green, b=blue, a=1.0),
        indices=mesh.faces.ravel().tolist(),
    )
    return _message(
        "SceneEntity",
        timestamp=_timestamp(time),
        frame_id=body.name,
        id=body.name,
        frame_locked=True,
        triangles=[triangles],
    )


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
    motion, progress = run.motion, progress or NullProgress()
    times = np.arange(motion.start, motion.duration, _STEP)
    progress.stage("exporting", len(times), "poses")
    with atomic_write(out) as temporary, McapFile(temporary) as file:
        file.bodies(float(times[0]), run.cell.bodies)
        for time in times.tolist():
            frames = motion.frames(time)
            file.transforms(time, {body.name: frames[body.moves_with] for body in run.cell.bodies})
            progress.advance(1)
        return 1 + len(times) + _write_cloud(run, file, threads)


def _write_cloud(run: RecordedRun, file: McapFile, threads: int) -> int:
    """Write the points; the number of messages."""
    cloud = run.cloud
    if cloud is None or not len(cloud):
        return 0
    columns = {"intensity": np.asarray(cloud.intensity), "quality": np.asarray(cloud.quality)}
    if run.part is not None:
        columns["deviation"] = deviation_from_mesh(cloud, run.part, threads).distance
    number = np.floor(cloud.time / _CHUNK)
    bounds = [0, *(np.flatnonzero(np.diff(number)) + 1).tolist(), len(cloud)]
    for first, end in pairwise(bounds):
        rows = slice(first, end)
        some = {name: values[rows] for name, values in columns.items()}
        file.points("/profiles", float(cloud.time[end - 1]), "part", cloud.points_in_part[rows], some)
    file.points("/cloud", float(cloud.time[-1]), "part", cloud.points_in_part, columns)
    return len(bounds)


class SessionRecorder(Closing):
    """Records a live cell as MCAP: it takes states, chunks of scans and camera frames as they arrive, from any thread.

    ``/tf`` holds the poses of all bodies, ``/scene`` their meshes, ``/joints`` angles, ``/profiles`` points of scans,
    ``/camera1`` … images (``/sensor2/camera1`` … of further sensors), and ``/log`` texts of the cell.

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
        further = [axis.name for axis in self._cell.further_axes]
        names = [*(f"joint {i + 1}" for i in range(len(state.joints))), "table", *further]
        self._file.joints(state.time, names, state.axes)
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
        own = sensor_frame(frame.sensor)
        body = next((body.name for body in self._cell.bodies if body.moves_with == own), "world")
        topic, body = ("", "sensor") if frame.sensor == 1 else (f"/sensor{frame.sensor}", body)
        for number, image in enumerate(() if frame.images is None else frame.images, start=1):
            self._file.image(f"{topic}/camera{number}", frame.time, body, image)

    def close(self) -> None:
        """Complete the file."""
        self._file.close()
