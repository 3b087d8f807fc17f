"""A live cell: pairs of camera images while it moves by the wall clock, cycles, and a scan that is seen growing."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

from scancell import Scanner
from scancell.config.choices import Engine
from scancell.config.loading import assets_dir, load_setup
from scancell.geometry import pose
from scancell.scanning.session import ScanSession
from scancell.workspace.live import LiveCell
from scancell.workspace.live_camera import CameraFeed
from scancell.workspace.live_scan import LiveScan
from scancell.workspace.robot import deg, location, mm

from .table import Row

_PART = assets_dir() / "parts" / "free_form.stl"
_SPAN_S = 10.0
_LEAST = 15.0  # pairs/s on 2 cores with AVX-512
_ENGINES: tuple[Engine, ...] = ("geometric", "ray-traced")


def live_rows() -> Iterator[Row]:
    """Frames and cycles each second while the arm goes to and fro above the part, guarded; then a scan."""
    with Scanner.from_setup(load_setup()) as scanner:
        for engine in _ENGINES:
            with scanner.session(_PART, guarded=True) as session:
                yield from _camera_rows(session, engine)
        for engine in _ENGINES:
            with scanner.session(_PART, guarded=True) as session:
                yield from _scan_rows(session, engine)


@contextmanager
def _running(session: ScanSession) -> Iterator[LiveCell]:
    live, ended = LiveCell(session), threading.Event()
    thread = threading.Thread(target=live.run, args=(ended.is_set,))
    thread.start()
    try:
        yield live
    finally:
        ended.set()
        thread.join()


def _camera_rows(session: ScanSession, engine: Engine) -> Iterator[Row]:
    above = location(450 * mm, 0, 0.0, rx=180 * deg)
    above[:3, 3] = session.nominal.world_from_table[:3, 3] + [0, 0, 190 * mm]
    session.move_joints(session.joints_for(above))

    def sway(cell: ScanSession) -> None:
        while True:
            for x in (10 * mm, -10 * mm):
                cell.move_line(above @ pose.translation((x, 0, 0)), speed=0.1)

    with _running(session) as live, CameraFeed(live, session, engine, interval=0.0) as feed:
        live.perform(sway, "to and fro")
        feed.wanted = True
        while feed.frame is None or feed.frame.number < 5:
            time.sleep(0.05)
        first, simulated, start = feed.frame.number, live.state.time, time.perf_counter()
        time.sleep(_SPAN_S)
        span = time.perf_counter() - start
        frames, simulated = feed.frame.number - first, live.state.time - simulated
        points = len(feed.frame.points_in_sensor)
    name = f"live cameras, {engine}, {points} points"
    yield Row(name, frames / span, "pairs/s", "wanted on 2 cores", _LEAST, None, "at least")
    yield Row(f"{name}: simulated time", simulated / span, "s/s", "real time", 1.0, None, "at least", 0.95)


def _scan_rows(session: ScanSession, engine: Engine) -> Iterator[Row]:
    scan = LiveScan(engine)
    with _running(session) as live:
        start = time.perf_counter()
        scan.start(live)
        most = 0
        while not scan.result.done():
            most = max(most, scan.state.behind)
            time.sleep(0.02)
        result = scan.result.result()
    seconds = time.perf_counter() - start
    name = f"live scan, {engine}, {len(result.recording)} profiles, {len(result.cloud)} points"
    planned = result.plan.program.duration
    yield Row(name, seconds, "s", "planned motion", planned)
    yield Row(f"{name}: driving", result.timings["drive"], "s", "planned motion", planned)
    yield Row(f"{name}: most profiles behind", most, "profiles", "all", len(result.recording))
