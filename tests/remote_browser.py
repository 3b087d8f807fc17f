"""A connection to a workspace in another process that finds inputs by their labels, as a page does."""

from __future__ import annotations

import time
from typing import Any, Self

import msgspec
import viser
import zstandard
from websockets.sync.client import connect

WAITS = 600.0  # s: only a hang takes longer
_CAMERA = {"wxyz": [1, 0, 0, 0], "position": [1, 1, 1], "fov": 1.0, "near": 0.01, "far": 100.0}
_SIZE = {"image_height": 500, "image_width": 500, "look_at": [0, 0, 0], "up_direction": [0, 0, 1]}


class RemoteBrowser:
    """Presses buttons and reads texts of the page at an address."""

    def __init__(self, address: str) -> None:
        protocol = f"viser-v{viser.__version__}"
        url = address.replace("http", "ws")
        self._socket = connect(url, subprotocols=[protocol], max_size=None, max_queue=None)
        self._inputs: dict[str, str] = {}
        self._texts: dict[str, str] = {}
        self.send({"type": "ViewerCameraMessage", **_CAMERA, **_SIZE})

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()

    def send(self, message: dict[str, Any]) -> None:
        """Send a message."""
        self._socket.send(msgspec.msgpack.encode(message))

    def enter(self, label: str, value: Any) -> None:
        """Enter a value in the input with a label, as soon as it is there."""
        self._receive_until(lambda: label in self._inputs, label)
        self.send({"type": "GuiUpdateMessage", "uuid": self._inputs[label], "updates": {"value": value}})

    def press(self, label: str) -> None:
        """Press a button."""
        self.enter(label, True)

    def shows(self, text: str) -> None:
        """Wait until a text is shown."""
        self._receive_until(lambda: any(text in shown for shown in self._texts.values()), text)

    def _receive_until(self, condition: Any, what: str) -> None:
        end = time.monotonic() + WAITS
        while not condition():
            frame = self._socket.recv(timeout=max(0.0, end - time.monotonic()))
            assert isinstance(frame, bytes), what
            self._take(frame)

    def _take(self, frame: bytes) -> None:
        size, packed = int.from_bytes(frame[:8], "little"), int.from_bytes(frame[8:16], "little")
        inner = zstandard.ZstdDecompressor().decompress(frame[16 : 16 + packed], max_output_size=size)
        for message in msgspec.msgpack.decode(inner)["messages"]:
            props = message.get("props") or message.get("updates") or {}
            if isinstance(props, dict) and "uuid" in message:
                if "label" in props:
                    self._inputs[str(props["label"])] = message["uuid"]
                if "content" in props:
                    self._texts[message["uuid"]] = str(props["content"])
