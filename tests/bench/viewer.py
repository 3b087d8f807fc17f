"""A client of a viser server in a process of its own, which takes what a browser would and draws nothing."""

from __future__ import annotations

import multiprocessing
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

_MOST = 200_000  # updates
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
        words = (url.replace("http", "ws"), nodes, self._count, self._times, self._size)
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

    def close(self) -> None:
        """End the process."""
        self._process.terminate()
        self._process.join()


def _receive(place: str, nodes: str, count: Any, times: Any, size: Any) -> None:
    import msgspec  # noqa: PLC0415  (viser's)
    import viser  # noqa: PLC0415
    import zstandard  # noqa: PLC0415
    from websockets.sync.client import connect  # noqa: PLC0415
    from websockets.typing import Subprotocol  # noqa: PLC0415

    unpack = zstandard.ZstdDecompressor()
    with connect(place, max_size=None, subprotocols=[Subprotocol(f"viser-v{viser.__version__}")]) as socket:
        socket.send(msgspec.msgpack.encode(_CAMERA))  # makes this client one that has panels
        for message in socket:
            assert isinstance(message, bytes)
            packed = int.from_bytes(message[8:16], "little")
            content = msgspec.msgpack.decode(unpack.decompress(message[16 : 16 + packed]))
            if any(one["type"] in _POSES and one["name"].startswith(nodes) for one in content["messages"]):
                times[count.value] = time.monotonic()
                count.value += 1
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
