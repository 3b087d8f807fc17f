"""Cost of showing a moving cell and a growing cloud to a client: ``python -m bench --only browser``."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import viser
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from scancell import Scanner
from scancell.config.loading import assets_dir, load_setup
from scancell.workspace.browser.cloud import MOST_POINTS
from scancell.workspace.browser.quiet import address, quiet_server
from scancell.workspace.browser.scene import CellScene
from scancell.workspace.live import LiveCell
from scancell.workspace.live_commands import MoveJoints
from scancell.workspace.live_state import LiveState

from .table import Row

_UPDATES, _RATE = 300, 60.0  # states that are shown, and how often, Hz
_CHUNK, _GROWING_RATE = 25_000, 30.0  # points of a chunk, and how often one is added, Hz
_POINT = 15  # bytes of a point's position and colour
_SHOW_LIMIT_MS, _SENT, _GROWING = 5.0, 30.0, 20


class _Client:
    """Receives what a browser would, in a process of its own."""

    def __init__(self, server: viser.ViserServer) -> None:
        context = multiprocessing.get_context("spawn")
        self._windows, self._size = context.Value("q", 0), context.Value("q", 0)
        words = (address(server).replace("http", "ws"), self._windows, self._size)
        self._process = context.Process(target=_receive, args=words, daemon=True)
        self._process.start()
        while self.size == 0:
            time.sleep(0.1)

    @property
    def windows(self) -> int:
        """Number of messages that were received; each holds all changes of an update."""
        return int(self._windows.value)

    @property
    def size(self) -> int:
        """Bytes that were received."""
        return int(self._size.value)


def _receive(place: str, windows: Any, size: Any) -> None:
    with connect(place, max_size=None, subprotocols=[Subprotocol(f"viser-v{viser.__version__}")]) as socket:
        for message in socket:
            windows.value += 1
            size.value += len(message)


def browser_rows() -> Iterator[Row]:
    """Processor time of an update of the default cell, updates that reach a client, and the growing cloud."""
    setup = load_setup()
    part = assets_dir() / "parts" / "free_form.stl"
    with quiet_server(port=0) as server, Scanner.from_setup(setup, threads=1) as scanner:
        with scanner.session(part) as session:
            states = _moving(LiveCell(session))
            scene = CellScene(server, session.true, setup.sensor, setup.cell)
        client = _Client(server)
        time.sleep(1.0)  # the first picture has gone out
        yield from _show_rows(scene, states, client)
        yield from _cloud_rows(scene, states, client)


def _moving(live: LiveCell) -> list[LiveState]:
    target = live.state.joints + np.array([0.8, 0.2, 0.1, 0.3, 0.3, 0.5])
    live.submit(MoveJoints(target, table=3.0, speed=0.15))
    live.cycle()
    states = []
    for _ in range(_UPDATES):
        live.cycle()
        states.append(live.state)
    return states


def _show_rows(scene: CellScene, states: list[LiveState], client: _Client) -> Iterator[Row]:
    before, begin, seconds = client.windows, time.perf_counter(), []
    for number, state in enumerate(states, 1):
        start = time.thread_time()
        scene.show(state)
        seconds.append(time.thread_time() - start)
        time.sleep(max(0.0, begin + number / _RATE - time.perf_counter()))
    sent = (client.windows - before) / (time.perf_counter() - begin)
    mean = 1e3 * float(np.mean(seconds))
    yield Row("an update shown, arm moving", mean, "ms", "limit", _SHOW_LIMIT_MS, None, "at most", 1.0, "processor")
    yield Row("updates that reach a client", sent, "1/s", "limit", _SENT, None, "at least")


def _cloud_rows(scene: CellScene, states: list[LiveState], client: _Client) -> Iterator[Row]:
    rng = np.random.default_rng(0)
    points = rng.normal(scale=0.02, size=(_CHUNK, 3))
    colours = rng.integers(0, 256, (_CHUNK, 3), dtype=np.uint8)
    before, begin, ends = client.size, time.perf_counter(), []
    while scene.add_points(points, colours, 1e-4):
        scene.show(states[len(ends) % len(states)])
        ends.append(time.perf_counter() - begin)
        time.sleep(max(0.0, len(ends) / _GROWING_RATE - ends[-1]))
    while client.size < before + _POINT * MOST_POINTS:
        time.sleep(0.01)
    whole = len(ends) / (time.perf_counter() - begin)
    slowest = float(_GROWING / np.max(np.subtract(ends[_GROWING:], ends[:-_GROWING])))
    limit = float(_GROWING)
    yield Row("updates with a chunk, 5 M points received", whole, "1/s", "limit", limit, None, "at least")
    yield Row(f"the slowest {_GROWING} of them in a row", slowest, "1/s", "limit", limit, None, "at least")
