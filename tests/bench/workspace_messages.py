"""Mutated messages to a workspace: ``python -m bench.workspace_messages [--messages N] [--seed N]``.

PYTHONPATH=tests. Connections of no browser send them to a running cell with an empty table: values of every input that
it does not offer, wrong types and sizes, uploads, bytes that are damaged. Some take control before. Beside them, a
connection moves a slider as a browser does, and the robot must follow; the cell's clock must go on.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import msgspec
import numpy as np
import viser
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from scancell import Scanner
from scancell.browser.server.gate import address
from scancell.browser.server.serve import Host
from scancell.browser.server.workspace import WorkspaceSettings
from scancell.config.loading import load_setup
from tour import hosted

WAITS = 600.0  # s: only a hang takes longer
AGAIN = 3.0  # s after which an honest browser asks again
SESSION_LENGTH = 1000  # messages of a connection
HONEST_EVERY = 500  # messages
_NUMBERS = (np.nan, np.inf, -np.inf, 1e308, -1e308, 5e-324, 0.0, -1.0, 1e4, 2**63 - 1, -(2**63), 0.5, 1, 45.0)
_TEXTS = ("", "nan", "inf", "1e999", "\0", "a" * 300, "é" * 5000, "../../x", "table.x_mm=nan", "automatic", "tool")
_NAMES = ("a.stl", "a" * 300 + ".stl", "a\0b.stl", "../../b.stl", "", "run.zip", "é" * 120 + ".ply", ".toml", "c.obj")


class Mutants:
    """Messages that no page sends, of the inputs of a server and one of its browsers."""

    def __init__(self, seed: int, server: Any, client_id: int) -> None:
        self.rng = np.random.default_rng(seed)
        client = server.get_clients()[client_id]
        inputs = {**server.gui._gui_input_handle_from_uuid, **client.gui._gui_input_handle_from_uuid}
        self._inputs = list(inputs.items())
        self._commands = list(client.gui._command_handle_from_uuid)

    def frame(self) -> bytes | str:
        """One of them."""
        message = self._message()
        if self.rng.random() < 0.2:
            message = self._other(message)
        packed = msgspec.msgpack.encode(message)
        way = self.rng.integers(12)
        if way == 0:
            return self._damaged(packed)
        if way == 1:
            return packed[: int(self.rng.integers(len(packed)))]
        if way == 2:
            return self.rng.bytes(int(self.rng.integers(200)))
        return str(self._any(_TEXTS)) if way == 3 else packed

    def _message(self) -> dict[str, Any]:
        uuid, handle = self._inputs[int(self.rng.integers(len(self._inputs)))]
        way = self.rng.integers(10)
        if way < 6:
            return {"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": self._value(handle)}}
        if way == 6:
            return {"type": "GuiButtonHoldMessage", "uuid": uuid, "frequency": self._any(_NUMBERS)}
        if way == 7:
            pose = {"wxyz": self._list(4), "position": self._list(3)}
            return {"type": "TransformControlsUpdateMessage", "name": "/gizmo", **pose}
        if way == 8 and self._commands:
            return {"type": "CommandTriggerMessage", "uuid": self._any(self._commands)}
        return self._upload(uuid)

    def _upload(self, uuid: str) -> dict[str, Any]:
        transfer = str(self.rng.integers(5))
        if self.rng.random() < 0.5:
            part = {"part_index": int(self.rng.integers(-1, 3)), "content": self.rng.bytes(int(self.rng.integers(50)))}
            return {"type": "FileTransferPart", "source_component_uuid": uuid, "transfer_uuid": transfer, **part}
        sizes = {"part_count": self._any((0, 1, 2, -1, 2**40)), "size_bytes": self._any((0, 50, 100, -5, 2**40))}
        file = {"filename": self._any(_NAMES), "mime_type": self._any(_TEXTS)}
        start = {"source_component_uuid": uuid, "transfer_uuid": transfer}
        return {"type": "FileTransferStartUpload", **start, **file, **sizes}

    def _value(self, handle: Any) -> Any:
        options = getattr(handle, "options", None)
        if options is not None and self.rng.random() < 0.5:
            return self._any(options)
        if self.rng.random() < 0.2 and isinstance(handle.value, bool | int | float | str):
            return handle.value
        way = self.rng.integers(6)
        if way < 2:
            return self._any(_NUMBERS)
        if way == 2:
            return self._any(_TEXTS)
        if way == 3:
            return self._list(int(self.rng.integers(5)))
        return self._any((True, False, None, {}, [[]], b"\0"))

    def _list(self, length: int) -> list[Any]:
        return [self._any(_NUMBERS) for _ in range(length)]

    def _other(self, message: dict[str, Any]) -> dict[str, Any]:
        """With another field, without one, or of another kind."""
        changed = dict(message)
        name = str(self._any(list(message)))
        way = self.rng.integers(4)
        if way == 0:
            del changed[name]
        elif way == 1:
            changed[name] = self._any((*_NUMBERS, *_TEXTS, None, [], {}))
        elif way == 2:
            changed["update_cb"] = 1
        elif "updates" in changed:
            changed["updates"] = {str(self._any(("disabled", "update_cb", "removed", "x"))): 1}
        else:
            changed["type"] = self._any(("ShareUrlRequest", "GuiFormSubmitMessage", "ResetGuiMessage", "Message"))
        return changed

    def _damaged(self, packed: bytes) -> bytes:
        changed = bytearray(packed)
        for bit in self.rng.integers(0, 8 * len(packed), int(self.rng.integers(1, 9))):
            changed[bit // 8] ^= 1 << bit % 8
        return bytes(changed)

    def _any(self, choices: Any) -> Any:
        chosen = choices[int(self.rng.integers(len(choices)))]
        return chosen.item() if isinstance(chosen, np.generic) else chosen


def _connected(server: Any) -> tuple[ClientConnection, int]:
    """A connection, and its number at the server once it has its panels."""
    before = set(server.get_clients())
    protocol = f"viser-v{viser.__version__}"
    made = connect(address(server).replace("http", "ws"), subprotocols=[protocol], max_size=None, max_queue=None)
    camera = {"wxyz": [1, 0, 0, 0], "position": [1, 1, 1], "fov": 1.0, "near": 0.01, "far": 100.0}
    size = {"image_height": 500, "image_width": 500, "look_at": [0, 0, 0], "up_direction": [0, 0, 1]}
    made.send(msgspec.msgpack.encode({"type": "ViewerCameraMessage", **camera, **size}))
    number = _until(lambda: next(iter(set(server.get_clients()) - before), None), "the connection")
    _until(lambda: _handle(server, number, "Record (MCAP)"), "the panels")
    return made, number


def _handle(server: Any, client_id: int, label: str) -> Any:
    """Identifier and input of a browser, by its label."""
    inputs = server.get_clients()[client_id].gui._gui_input_handle_from_uuid
    return next(((uuid, one) for uuid, one in list(inputs.items()) if getattr(one, "label", "") == label), None)


def _until(found: Any, what: str, waits: float = WAITS) -> Any:
    end = time.monotonic() + waits
    while time.monotonic() < end:
        if (result := found()) is not None:
            return result
        time.sleep(0.01)
    raise TimeoutError(f"{what} never came")


class Honest:
    """A browser's inputs: it takes control, resets a stop, and turns a joint."""

    def __init__(self, host: Host, server: Any) -> None:
        self._host, self._server = host, server
        self._turns = 0

    def turns_a_joint(self) -> float:
        """Have the robot follow a slider; returns the time until it does, s."""
        start = time.monotonic()
        connection, number = _connected(self._server)
        with connection:
            workspace = self._host.workspace
            assert workspace is not None
            self._turns += 1
            angle = 3.0 if self._turns % 2 else -3.0
            wanted = (("speed, %", 100), ("monitor speed, %", 100), ("joint 1, deg", angle))

            def at_angle() -> bool | None:
                return abs(np.degrees(workspace.live.state.joints[0]) - angle) < 1e-3 or None

            def asked() -> bool | None:
                """A person tries again: messages of the last browser may still take the control, or stop the robot."""
                self._press(connection, number, "Take control")
                self._press(connection, number, "Reset after a stop")
                for label, value in wanted:
                    self._send(connection, number, label, value)
                with contextlib.suppress(TimeoutError):
                    return _until(at_angle, "the angle", AGAIN)
                return None

            try:
                _until(asked, f"joint 1 at {angle} deg")
            except TimeoutError as error:
                state = workspace.live.state
                names = [
                    "controller",
                    "operation",
                    "job",
                    "message",
                    "refusal",
                    "guard_text",
                    "joints",
                    "monitor_speed",
                ]
                shown = {"operator": workspace._operators.operator == number}
                shown |= {name: getattr(state, name) for name in names}
                raise TimeoutError(f"{error}: {shown}") from None
        return time.monotonic() - start

    def _press(self, connection: ClientConnection, number: int, label: str) -> None:
        self._send(connection, number, label, True)

    def _send(self, connection: ClientConnection, number: int, label: str, value: Any) -> None:
        uuid, _ = _handle(self._server, number, label)
        update = {"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": value}}
        connection.send(msgspec.msgpack.encode(update))


def run(host: Host, server: Any, messages: int, seed: int, counts: Counter[str], length: int = SESSION_LENGTH) -> None:
    """Send mutants; between connections, a browser must have the robot follow it."""
    honest = Honest(host, server)
    sent = session = 0
    while sent < messages:
        session += 1
        connection, number = _connected(server)
        mutants = Mutants(seed + session, server, number)
        if session % 2:  # this one is the operator
            honest._press(connection, number, "Take control")
        with connection:
            for _ in range(min(length, messages - sent)):
                with contextlib.suppress(ConnectionClosed):
                    connection.send(mutants.frame())
                sent += 1
        longest = honest.turns_a_joint()
        counts["longest time until the robot followed a browser, ms"] = max(
            counts["longest time until the robot followed a browser, ms"], round(1e3 * longest)
        )
    counts["mutants sent"] += sent
    counts["connections"] += session


@contextlib.contextmanager
def workspace(out: Path) -> Iterator[tuple[Host, Any]]:
    """A running cell with an empty table."""
    setup = load_setup(ideal=True, settings=["scan.max_profiles=20", "scan.sweep.enabled=false"])
    with Scanner(setup=setup, threads=1) as scanner, hosted(scanner, None, WorkspaceSettings(out)) as opened:
        yield opened


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.workspace_messages", description=__doc__)
    parser.add_argument("--messages", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    counts: Counter[str] = Counter()
    start, printed = time.perf_counter(), io.StringIO()
    try:
        with TemporaryDirectory() as out, workspace(Path(out)) as (host, server), contextlib.redirect_stderr(printed):
            run(host, server, options.messages, options.seed, counts)
    finally:
        print(printed.getvalue()[-3000:])
    for name, number in counts.items():
        print(f"{number:>10,} {name}")
    print(f"{printed.getvalue().count('Traceback'):>10,} tracebacks printed")
    print(f"{time.perf_counter() - start:.0f} s")


if __name__ == "__main__":
    main()
