"""The workspace as a person runs it, seen by a client in another process: ``python -m bench --only workspace``."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import get_args

import numpy as np

from scancell import Scanner
from scancell.browser.scene.cloud import MOST_POINTS
from scancell.browser.server.gate import address, quiet_server
from scancell.browser.server.serve import Host, PartFile
from scancell.browser.server.workspace import Workspace, WorkspaceSettings
from scancell.config.choices import Engine
from scancell.config.loading import assets_dir, load_setup
from scancell.geometry import pose
from scancell.live.state import Cancel
from scancell.programs.robot import deg, location, mm
from scancell.scanning.session import ScanSession

from .display_speed import display_rows
from .table import Row
from .viewer import Viewer

_PART = PartFile(assets_dir() / "parts" / "free_form.stl")
_NODES = "/frames/"  # of arm, table and part
_SPAN_S, _LONG_S = 10.0, 60.0
_LENS = {f"sensor.camera[{number}].psf_sigma_px": 0.5 for number in (1, 2)}  # of a good real lens
_LATENCY_S = 0.15  # from a pose to its images in the client, wanted
_CYCLES, _SENT, _PAIRS, _GROWING = 60.0, 30.0, 30.0, 20  # wanted each second
_CHUNK, _CHUNKS = 25_000, 30.0  # points of a chunk, and chunks each second
_POINT = 15  # bytes of a point's position and colour


def workspace_rows() -> Iterator[Row]:
    """Cycles, updates and pairs of images each second while the arm moves, guarded; scans; a growing cloud."""
    with Scanner(setup=load_setup(settings=_LENS)) as scanner, opened(scanner, "ray-traced") as (workspace, viewer):
        _sway(workspace)
        yield from _moving_rows(workspace, viewer, "ray-traced cameras", _LONG_S, with_pairs=True)
    with Scanner(setup=load_setup()) as scanner:
        with opened(scanner, "geometric") as (workspace, viewer):
            _sway(workspace)
            yield from _moving_rows(workspace, viewer, "geometric cameras")
            yield from _cloud_rows(workspace, viewer)
            workspace.live.submit(Cancel())
            for engine in get_args(Engine):
                yield from _scan_rows(workspace, viewer, engine)
        with opened(scanner, "geometric") as (workspace, viewer):
            viewer.close()  # the page is the operator
            yield from display_rows(workspace, viewer.url)


@contextmanager
def opened(scanner: Scanner, engine: Engine) -> Iterator[tuple[Workspace, Viewer]]:
    """The workspace of the default cell with a client that has panels."""

    def open_session(file: PartFile | None) -> AbstractContextManager[ScanSession]:
        return scanner.session(None if file is None else file.path, guarded=True)

    stop, started = threading.Event(), threading.Event()
    with TemporaryDirectory() as out, quiet_server(port=0) as server:
        host = Host(server, open_session, WorkspaceSettings(Path(out), engine))
        running = threading.Thread(target=host.run, args=(_PART, stop, started.set))
        running.start()
        started.wait()
        viewer = Viewer(address(server), _NODES)
        try:
            assert host.workspace is not None
            yield host.workspace, viewer
        finally:
            viewer.close()
            stop.set()
            running.join()


def _sway(workspace: Workspace) -> None:
    """Let the arm go to and fro above the part, and return when it does."""
    above = location(450 * mm, 0, 0.0, rx=180 * deg)
    above[:3, 3] = workspace.nominal.world_from_table[:3, 3] + [0, 0, 190 * mm]

    def sway(cell: ScanSession) -> None:
        while True:
            for x in (10 * mm, -10 * mm):
                cell.move_line(above @ pose.translation((x, 0, 0)), speed=0.1)

    live = workspace.live
    live.perform(lambda cell: cell.move_joints(cell.joints_for(above)), "above the part").result()
    live.perform(sway, "to and fro")
    time.sleep(2.0)


def _moving_rows(
    workspace: Workspace, viewer: Viewer, name: str, seconds: float = _SPAN_S, with_pairs: bool = False
) -> Iterator[Row]:
    live = workspace.live
    simulated, sent, first = live.state.time, len(viewer.times), len(viewer.frames)
    start, processor = time.perf_counter(), time.process_time()
    reached: dict[float, float] = {}  # when each simulated time was first seen, s of `time.monotonic`
    while time.perf_counter() < start + seconds:
        reached.setdefault(live.state.time, time.monotonic())
        time.sleep(0.002)
    span, processor = time.perf_counter() - start, time.process_time() - processor
    cycles = (live.state.time - simulated) / (1e-6 * load_setup().cell.world.controller_cycle_us)
    yield _at_least(f"{name}: cycles of the cell", cycles / span, _CYCLES)
    yield _at_least(f"{name}: updates received", (len(viewer.times) - sent) / span, _SENT)
    if with_pairs:
        frames = viewer.frames[first:]
        yield _at_least(f"{name}: pairs of images received", len(frames) / span, _PAIRS)
        posed = np.interp(frames[:, 1], list(reached), list(reached.values()))
        latency = float(np.quantile(frames[:, 0] - posed, 0.95))
        yield Row(f"{name}: latency, 95 % below", latency, "s", "wanted", _LATENCY_S, None, "at most")
    yield Row(f"{name}: processor", processor / span, "cores", "all", len(os.sched_getaffinity(0)))


def _cloud_rows(workspace: Workspace, viewer: Viewer) -> Iterator[Row]:
    rng = np.random.default_rng(0)
    points = rng.normal(scale=0.02, size=(_CHUNK, 3))
    colours = rng.integers(0, 256, (_CHUNK, 3), dtype=np.uint8)
    size, sent, begin, added = viewer.size, len(viewer.times), time.perf_counter(), 0
    while workspace.scene.add_points(points, colours, 1e-4):
        added += 1
        time.sleep(max(0.0, begin + added / _CHUNKS - time.perf_counter()))
    while viewer.size < size + _POINT * MOST_POINTS:
        time.sleep(0.01)
    times = viewer.times[sent:]
    yield _at_least("cloud growing to 5 M points: updates", len(times) / (time.perf_counter() - begin), float(_GROWING))
    slowest = _GROWING / float(np.max(times[_GROWING:] - times[:-_GROWING]))
    yield _at_least(f"the slowest {_GROWING} of them in a row", slowest, float(_GROWING))
    workspace.scene.clear_points()


def _scan_rows(workspace: Workspace, viewer: Viewer, engine: Engine) -> Iterator[Row]:
    live, scans = workspace.live, workspace.scans
    while live.state.job is not None or scans.hindrance:
        time.sleep(0.05)
    scans.start(engine)
    while scans.state is None or scans.state.stage != "scanning" or scans.state.taken == 0:
        time.sleep(0.05)
    yield from _moving_rows(workspace, viewer, f"{engine} scan")
    live.submit(Cancel())


def _at_least(name: str, value: float, limit: float) -> Row:
    return Row(name, value, "1/s", "wanted", limit, None, "at least")
