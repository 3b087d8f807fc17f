"""MCAP files with messages of Foxglove's schemas in protobuf, which Foxglove and rerun open."""

from __future__ import annotations

import io
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image

from scancell.closing import Closing
from scancell.errors import OutputError
from scancell.extras import require
from scancell.geometry import pose
from scancell.nominal.cell import Body
from scancell.views.page import displayed
from scancell.views.pictures import painted

Array = NDArray[np.float64]

_FLOAT32 = 7  # foxglove.PackedElementField.FLOAT32


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
        """Angles (n,), rad, on ``/joints``."""
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
