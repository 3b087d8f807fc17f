"""A client of a viser server in a process of its own, which takes what a browser would and draws nothing."""

from __future__ import annotations

import multiprocessing
import re
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

_MOST = 200_000  # updates

_FRAME_TIME = re.compile(r" points, (\d+\.\d+) s")  # of the text beside the images
_POSES = ("SetPositionMessage", "SetOrientationMessage")


class Viewer:
    """Receives until it is closed.

    Parameters
    ----------
    url
        Of the server, http.
    nodes
        Of the scene, by the beginning of their names; an update counts when it moves one of them. All changes of an
        update come in one message.
    """

    def __init__(self, url: str, nodes: str) -> None:
        self.url = url
        context = multiprocessing.get_context("spawn")
        self._count, self._size = context.Value("q", 0), context.Value("q", 0)
        self._times = context.Array("d", _MOST, lock=False)
        self._frame_count, self._frames = context.Value("q", 0), context.Array("d", 2 * _MOST, lock=False)
        shared = (self._count, self._times, self._size, self._frame_count, self._frames)
        words = (url.replace("http", "ws"), nodes, *shared)
        self._process = context.Process(target=_receive, args=words, daemon=True)
        self._process.start()
        while self.size == 0:
            time.sleep(0.1)

    @property
    def size(self) -> int:
        """Bytes that were received."""
        return int(self._size.value)

    @property
    def times(self) -> NDArray[np.float64]:
        """When updates came, s of `time.monotonic`."""
        return np.array(self._times[: self._count.value])

    @property
    def frames(self) -> NDArray[np.float64]:
        """Camera images (n, 2), decoded: when they came, s of `time.monotonic`, and their simulated time, s."""
        return np.array(self._frames[: 2 * self._frame_count.value]).reshape(-1, 2)

    def close(self) -> None:
        """End the process."""
        self._process.terminate()
        self._process.join()


def _receive(place: str, nodes: str, count: Any, times: Any, size: Any, frame_count: Any, frames: Any) -> None:
    import cv2  # noqa: PLC0415
    import msgspec  # noqa: PLC0415  (viser's)
    import viser  # noqa: PLC0415
    import zstandard  # noqa: PLC0415
    from websockets.sync.client import connect  # noqa: PLC0415
    from websockets.typing import Subprotocol  # noqa: PLC0415

    unpack = zstandard.ZstdDecompressor()
    frame_time = 0.0  # of the text that came last
    with connect(place, max_size=None, subprotocols=[Subprotocol(f"viser-v{viser.__version__}")]) as socket:
        socket.send(msgspec.msgpack.encode(_CAMERA))  # makes this client one that has panels
        for message in socket:
            assert isinstance(message, bytes)
            packed = int.from_bytes(message[8:16], "little")
            content = msgspec.msgpack.decode(unpack.decompress(message[16 : 16 + packed]))
            if any(one["type"] in _POSES and one["name"].startswith(nodes) for one in content["messages"]):
                times[count.value] = time.monotonic()
                count.value += 1
            for update in (one["updates"] for one in content["messages"] if one["type"] == "GuiUpdateMessage"):
                if text := _FRAME_TIME.search(str(update.get("content"))):
                    frame_time = float(text[1])
                elif isinstance(image := update.get("_data"), bytes):
                    assert cv2.imdecode(np.frombuffer(image, np.uint8), cv2.IMREAD_UNCHANGED) is not None
                    frames[2 * frame_count.value : 2 * frame_count.value + 2] = (time.monotonic(), frame_time)
                    frame_count.value += 1
            size.value += len(message)


_CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": (1.0, 0.0, 0.0, 0.0),
    "position": (0.0, 0.0, 1.0),
    "fov": 1.0,
    "near": 0.01,
    "far": 100.0,
    "image_height": 720,
    "image_width": 1280,
    "look_at": (0.0, 0.0, 0.0),
    "up_direction": (0.0, 0.0, 1.0),
}
