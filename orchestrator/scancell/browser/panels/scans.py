"""Scans of the workspace: their start, their list and their playback."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial
from html import escape
from pathlib import Path
from threading import Event, Lock, RLock
from time import monotonic
from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from scancell.browser.panels.camera_panel import add_switch
from scancell.browser.panels.handles import (
    WARNING,
    Follower,
    colour_bar_html,
    report_errors,
    set_changed,
    show_message,
    small_html,
)
from scancell.browser.panels.operator_commands import OperatorCommands, can_end, can_move, can_start
from scancell.browser.scene.scene import LIVE_COLOURS, CellScene, LiveCloud
from scancell.browser.server.gate import address, quiet_server
from scancell.config.choices import LOOPBACK, Engine
from scancell.errors import CommandError
from scancell.files import first_free
from scancell.geometry.mesh import Mesh
from scancell.live.camera import CameraFeed
from scancell.live.cell import LiveCell
from scancell.live.scan import LiveChunk, LiveScan, LiveScanState
from scancell.live.state import Cancel, LiveState
from scancell.nominal.cell import NominalCell
from scancell.progress import Pace
from scancell.reconstruction.cloud_files import write_cloud
from scancell.results import ScanResult
from scancell.scanning.session import ScanSession
from scancell.views.motion import RunMotion, scan_motion
from scancell.views.recorded_run import RecordedRun
from scancell.views.renderer import ColourBy, coloured_by, displayed

if TYPE_CHECKING:
    import viser


_LINE_SPACING = 0.2e-3  # m between points of scan lines, whose distances are not known
_CHUNK = 20_000  # points of a cloud that is shown again

PLAYBACK = "the playback of the scan"  # name of its job

_STEP = 0.01  # s of the slider

_CHUNKS = 200  # of the cloud
_RATE = 30.0  # Hz, of updates
_SPEEDS = ("0.5 x", "1 x", "2 x", "5 x", "10 x", "20 x")


class Scans:
    """Starts scans in a live cell, and keeps the last one that measured something, finished or stopped.

    It is discarded when the next scan gives its first points.

    Parameters
    ----------
    part
        Mesh of the part; None: there is nothing to scan.
    out
        Folder in which `save` makes run folders.
    engine
        Initial engine.
    on_points
        Receives the points of scans and scan lines, too.

    Attributes
    ----------
    cloud
        The points that are shown.
    saved
        The last run folder; None before the first.
    figures
        Deviation of the scan that is kept from the part, as text; empty before it is known.
    discarded
        What the last scan replaced although it was not saved; empty if nothing.
    """

    def __init__(
        self,
        live: LiveCell,
        cloud: LiveCloud,
        part: Mesh | None,
        out: Path,
        engine: Engine = "ray-traced",
        on_points: Callable[[LiveChunk], object] = lambda _: None,
    ) -> None:
        self._live, self.cloud, self._part, self._out = live, cloud, part, out
        self.engine, self._on_points = engine, on_points
        self._lock = Lock()
        self._scan: LiveScan | None = None  # the last one that was started
        self._started = 0  # number of scans; callbacks refer to a scan by its number, so that its memory is released
        self._kept: ScanResult | None = None
        self._shown: object = None  # number of the scan, or the run of a program, whose points are shown
        self._shows_kept = self._is_saved = False
        self.saved: Path | None = None
        self.figures = self.discarded = ""

    @property
    def state(self) -> LiveScanState | None:
        """State of the last scan; None before the first."""
        return None if self._scan is None else self._scan.state

    @property
    def error(self) -> str:
        """Reason why the last scan failed; empty if it did not."""
        if self._scan is None or not self._scan.result.done():
            return ""
        error = self._scan.result.exception()
        return "" if error is None else str(error)

    @property
    def result(self) -> ScanResult:
        """The scan that is kept.

        Raises
        ------
        CommandError
            If no scan has finished.
        """
        if (kept := self._kept) is None:
            raise CommandError(self.lack)
        return kept

    @property
    def lack(self) -> str:
        """Reason why there is no `result`; empty if there is one."""
        return "there is no finished scan" if self._kept is None else ""

    @property
    def unsaved(self) -> str:
        """Results that the next scan, another part or run, or the end discards; empty if there are none."""
        if (kept := self._kept) is None or self._is_saved:
            return ""
        return f"a scan of {len(kept.cloud)} points that is not saved"

    @property
    def hindrance(self) -> str:
        """Reason why no scan can start; empty if one can."""
        if self._part is None:
            return "the table is empty: open a part first"
        if self._scan is not None and not self._scan.result.done():
            return "a scan is running: end it first"
        return ""

    def start(self, engine: Engine) -> None:
        """Plan and run the scan of the descriptions with `engine`.

        Raises
        ------
        CommandError
            If the table is empty, or a scan runs.
        """
        with self._lock:
            if self.hindrance:
                raise CommandError(self.hindrance)
            self.discarded = ""
            self._started += 1
            self._scan = scan = LiveScan(engine, on_points=partial(self._add, self._started))
            scan.result.add_done_callback(partial(self._keep, self._started))
        scan.start(self._live)

    def save(self) -> Path:
        """Write the run folder of the scan that is kept: the first of ``scan_1``, ``scan_2``, ... that does not exist.

        Raises
        ------
        ScancellError
            If there is no finished scan, or the folder cannot be written.
        """
        result, folder = self.result, first_free(self._out, "scan_{}")
        result.save(folder)
        self.saved, self._is_saved = folder, result is self._kept
        return folder

    def show_result(self) -> None:
        """Show the points of the scan that is kept again, where a program has replaced them.

        Raises
        ------
        CommandError
            If no scan has finished.
        """
        with self._lock:
            result = self.result
            if self._shows_kept or self._part is None:
                return
            self._shown, self._shows_kept = self._started, True
            self.cloud.clear()
        spacing = float(np.sqrt(self._part.areas.sum() / len(result.cloud)))
        whole = LiveChunk.of(result.cloud, result.deviation.distance)
        for first in range(0, len(result.cloud), _CHUNK):
            self.cloud.add(whole[first : first + _CHUNK], spacing)

    def points_of_program(self) -> Callable[[LiveChunk], object]:
        """Function that shows points of one run of a program; the first ones replace what is shown."""
        run = object()

        def add(chunk: LiveChunk) -> None:
            with self._lock:
                if self._shown is not run:
                    self._shown, self._shows_kept = run, False
                    self.cloud.clear()
            self._on_points(chunk)
            self.cloud.add(chunk, _LINE_SPACING)

        return add

    def _add(self, number: int, chunk: LiveChunk) -> None:
        scan = self._scan
        if number != self._started or scan is None or self._part is None:
            return
        state = scan.state
        with self._lock:
            if self._shown != number:
                self._shown, self.discarded = number, self.unsaved
                self._kept, self.figures, self._shows_kept = None, "", True
                self.cloud.clear()
        # The first chunk tells how many points there will be.
        expected = max(1, state.points) / max(1, state.sensed) * state.planned
        self._on_points(chunk)
        self.cloud.add(chunk, float(np.sqrt(self._part.areas.sum() / expected)))

    def _keep(self, number: int, result: Future[ScanResult]) -> None:
        """Called in the thread that senses, when a scan has ended."""
        if number == self._started and result.exception() is None:
            self._kept, self._is_saved = result.result(), False
            self.figures = self._kept.deviation.figures.text().strip()


@dataclass(frozen=True)
class _Played:
    result: ScanResult
    motion: RunMotion
    ended: Event
    job: Future[None]


class ScanPlayback:
    """Shows the last scan, finished or stopped, at a time of it, in real time while it plays.

    The robot rests meanwhile: playback is a job of the running cell, so that other commands are rejected until it
    ends, and a stop or `Cancel` ends it. Any thread may call.

    Parameters
    ----------
    live, cell
        The running cell, and its bodies, obstacles that planning does not know included.
    scans, feed, scene
        The scan, and what shows it.
    clock
        s.

    Attributes
    ----------
    time
        Time of the scan that is shown, s.
    """

    def __init__(
        self,
        live: LiveCell,
        cell: NominalCell,
        scans: Scans,
        feed: CameraFeed,
        scene: CellScene,
        clock: Callable[[], float] = monotonic,
    ) -> None:
        self._live, self._cell, self._clock = live, cell, clock
        self._scans, self._feed, self._scene = scans, feed, scene
        self._lock = RLock()
        self._played: _Played | None = None
        self._plays, self._before = False, 0.0
        self.time = 0.0

    @property
    def is_on(self) -> bool:
        """Whether the scan is shown in place of the running cell."""
        return self._played is not None

    @property
    def plays(self) -> bool:
        """Whether the time advances."""
        return self._plays

    @property
    def duration(self) -> float:
        """Duration of the scan that is played back, s; 0 without one."""
        played = self._played
        return 0.0 if played is None else played.motion.duration

    def play_or_pause(self) -> None:
        """Begin the playback; then pause it, or continue it, after its end from the start.

        Raises
        ------
        CommandError
            If there is no scan.
        """
        with self._lock:
            if self._played is None:
                self._begin()
            self._plays, self._before = not self._plays, self._clock()
            if self._plays and self.time >= self.duration:
                self.go_to(0.0)

    def go_to(self, time: float) -> None:
        """Show the scan at a time, s.

        Raises
        ------
        CommandError
            If no scan is played back.
        """
        with self._lock:
            if self._played is None:
                raise CommandError("no scan is played back: play it first")
            self.time = float(np.clip(time, self._played.motion.start, self._played.motion.duration))
            self._show(self._played)

    def leave(self) -> None:
        """Show the running cell again."""
        with self._lock:
            if self._played is None:
                return
            self._played.ended.set()
            self._played, self._plays = None, False
            self._feed.resume()
            self._scene.show_laser(True)
            self._scans.cloud.show_until(np.inf)

    def update(self) -> None:
        """Advance the time while it plays, and leave when the cell has ended the job; called periodically."""
        with self._lock:
            if self._played is not None and self._played.job.done():
                self.leave()
            if not self._plays:
                return
            now = self._clock()
            self.go_to(self.time + now - self._before)
            self._before = now
            self._plays = self.time < self.duration

    def _begin(self) -> None:
        result, ended = self._scans.result, Event()
        motion = scan_motion(self._cell, result.recording, result.plan)
        self._scans.show_result()

        def rest(session: ScanSession) -> None:
            while not ended.is_set():
                session.step()

        self._played = _Played(result, motion, ended, self._live.perform(rest, PLAYBACK))
        self.go_to(motion.start)

    def _show(self, played: _Played) -> None:
        taken = int(np.searchsorted(played.motion.times, self.time, side="right"))
        self._feed.replay(played.result, max(taken - 1, 0))
        self._scene.replay(played.motion.frames(self.time), played.motion.laser_on(self.time))
        self._scans.cloud.show_until(self.time)


class ScanPanel:
    """Runs the scan of the descriptions, and plays it back."""

    def __init__(self, gui: Any, operator: OperatorCommands, scans: Scans, playback: ScanPlayback) -> None:
        self._operator, self._scans, self._playback = operator, scans, playback
        connect, cloud = operator.connect, scans.cloud
        self._engine = gui.add_dropdown("engine", get_args(Engine), initial_value=scans.engine)
        operator.add_inputs([self._engine])
        connect(
            gui.add_button("Scan the part"),
            lambda: scans.start(self._engine.value),
            lambda state: scans.hindrance or can_move(state),
        )
        connect(gui.add_button("End the scan"), lambda: operator.submit(Cancel()), can_end)
        self._progress = gui.add_progress_bar(0.0)
        self._text = gui.add_html("")
        self._colour = Follower(gui.add_dropdown("colours show", LIVE_COLOURS))
        connect(self._colour.handle, lambda: cloud.colour_by(self._colour.value))
        self._bar = gui.add_html("")
        self._limits = Follower(gui.add_vector2("limits of the colours", (0.0, 1.0), visible=False))
        connect(self._limits.handle, lambda: cloud.limit(*self._limits.value))
        self._automatic = connect(gui.add_button("Automatic limits", visible=False), cloud.limit)
        save, download = gui.add_button("Save the run folder"), gui.add_button("Download the cloud (PLY)")
        connect(save, lambda: operator.show_message(f"saved: {scans.save()}"), lambda _: scans.lack)
        connect(download, self._download, lambda _: scans.lack, by_all=True)
        self._play = connect(
            gui.add_button("Play the scan back", icon="player-play"),
            playback.play_or_pause,
            lambda state: "" if playback.is_on else scans.lack or can_start(state),
        )
        self._time = Follower(gui.add_slider("time of the scan, s", 0.0, 1.0, _STEP, 0.0, visible=False))
        connect(self._time.handle, lambda: playback.go_to(self._time.value))
        self._leave = connect(gui.add_button("Back to the running cell", visible=False), playback.leave)

    def show(self, state: LiveState) -> None:
        """Show the progress of the scan."""
        self._show_colours()
        self._show_playback()
        scan = self._scans.state
        if scan is None:
            return
        share = 100.0 * scan.sensed / scan.planned if scan.planned else 0.0
        set_changed(self._progress, "value", share)
        lines = [
            f"<b>{scan.stage}</b>",
            f"{scan.sensed} of {scan.planned} profiles, {scan.points} points",
            escape(scan.ended_by),
            escape(self._scans.error),
            escape(self._scans.figures),
            *self._what_is_lost(),
        ]
        set_changed(self._text, "content", small_html(lines))

    def _what_is_lost(self) -> list[str]:
        """Sentences on points that are not shown, and scans that are not saved."""
        scans, lines = self._scans, []
        if scans.cloud.step > 1:
            lines.append(f"One point of {scans.cloud.step} is shown; the saved cloud has all.")
        if scans.discarded:
            lines.append(f"This scan has replaced {scans.discarded}.")
        if scans.unsaved:
            lines.append(
                f'<b style="color:{WARNING}">The next scan, another part or run, and the end of the workspace discard '
                f"{scans.unsaved}.</b>"
            )
        return lines

    def _show_playback(self) -> None:
        playback = self._playback
        set_changed(self._play, "label", "Pause" if playback.plays else "Play the scan back")
        for handle in (self._time.handle, self._leave):
            set_changed(handle, "visible", playback.is_on)
        if playback.is_on:
            set_changed(self._time.handle, "max", max(_STEP, float(np.ceil(playback.duration / _STEP) * _STEP)))
            self._time.show(round(playback.time, 2))

    def _show_colours(self) -> None:
        self._colour.show(self._scans.cloud.colour)
        bar = self._scans.cloud.bar
        set_changed(self._bar, "content", "" if bar is None else colour_bar_html(bar))
        for handle in (self._limits.handle, self._automatic):
            set_changed(handle, "visible", bar is not None)
        if bar is not None:
            self._limits.show(tuple(round(value, 3) for value in bar.limits))

    def _download(self) -> None:
        cloud = self._scans.result.cloud
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "cloud.ply"
            write_cloud(file, cloud)
            self._operator.send_file(file.name, file.read_bytes())


class Playback:
    """Plays a run back on a server of viser; all its browsers show and control the same time.

    Parameters
    ----------
    server
        Server of viser.
    run
        To be shown.
    colour
        What the colours of the cloud show.
    threads
        For the deviations of the cloud; 0 uses all cores.
    back
        Goes back to where the run was opened; None: there is nothing to go back to.

    Attributes
    ----------
    scene
        What is shown.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        run: RecordedRun,
        colour: ColourBy,
        threads: int = 0,
        back: Callable[[], None] | None = None,
    ) -> None:
        self._run, self._lock = run, RLock()
        self.scene = CellScene(server, run.cell, run.setup.sensor, run.setup.cell)
        motion, gui = run.motion, server.gui
        gui.set_panel_label(f"scancell: {run.name}")
        gui.main_panel.dock_right()
        if back is not None:
            gui.add_button("Back to the cell").on_click(
                lambda event: report_errors(back, partial(show_message, event.client))
            )
        first, last = np.floor(motion.start / _STEP) * _STEP, np.ceil(motion.duration / _STEP) * _STEP
        self._slider = gui.add_slider("time, s", round(first, 2), round(last, 2), _STEP, initial_value=round(first, 2))
        self._play = gui.add_button("Play")
        self._speed = gui.add_dropdown("speed", _SPEEDS, initial_value="5 x")
        for label, name in (("frames", "frames"), ("field of view", "field_of_view"), ("devices", "devices")):
            add_switch(gui, self.scene, label, name)
        self._text = gui.add_markdown("")
        self._chunk_ends = self._add_cloud(gui, colour, threads)
        self._playing = False
        self._slider.on_update(lambda _: self._show())
        self._play.on_click(lambda _: self.play_or_pause())
        self._show()

    def run(self, ended: Callable[[], bool]) -> None:
        """Advance the time during playback, until `ended`."""
        pace, before = Pace(1 / _RATE), monotonic()
        while not ended():
            pace.wait()
            now = monotonic()
            self.advance(now - before)
            before = now

    def join(self, client: viser.ClientHandle, is_wide: bool) -> None:
        """Do nothing: all browsers share one panel."""

    def leave(self, client: viser.ClientHandle) -> None:
        """Do nothing: no data are kept per browser."""

    @property
    def time(self) -> float:
        """Time of the run that is shown, s."""
        return float(np.clip(self._slider.value, self._run.motion.start, self._run.motion.duration))

    @property
    def speed(self) -> float:
        """Seconds of the run in a second."""
        return float(self._speed.value.split()[0])

    @property
    def plays(self) -> bool:
        """Whether playback is running."""
        return self._playing

    def go_to(self, time: float) -> None:
        """Show the run at a time, s."""
        with self._lock:
            self._slider.value = time  # which shows it

    def play_or_pause(self) -> None:
        """Resume playback, from the start after the end, or pause it."""
        with self._lock:
            self._playing = not self._playing
            if self._playing and self.time >= self._run.motion.duration:
                self.go_to(self._run.motion.start)
            self._play.label = "Pause" if self._playing else "Play"

    def advance(self, seconds: float) -> None:
        """Advance the time by `seconds` during playback, which ends with the run."""
        with self._lock:
            if not self._playing:
                return
            later, end = self.time + seconds * self.speed, self._run.motion.duration
            self.go_to(min(later, end))
            if later >= end:
                self.play_or_pause()

    def _show(self) -> None:
        with self._lock:
            time, motion = self.time, self._run.motion
            frames = motion.frames(time)
            self.scene.move(frames)
            self.scene.show_chunks(int(np.searchsorted(self._chunk_ends, time, side="right")))
            self.scene.show_laser(motion.laser_on(time))
            x, y, z = 1e3 * frames["sensor"][:3, 3]
            self._text.content = f"sensor at x {x:.1f}, y {y:.1f}, z {z:.1f} mm"

    def _add_cloud(self, gui: viser.GuiApi, colour: ColourBy, threads: int) -> list[float]:
        """Add the cloud in chunks of the order of measurement and its scale, and return their last times, s."""
        run = self._run
        if run.cloud is None or not len(run.cloud):
            return []
        cloud = coloured_by(run.cloud, run.cloud_points, run.cell.part, colour, threads)
        world_from_part = run.motion.frames(run.motion.start)["part"]
        ends = []
        for rows in np.array_split(np.arange(len(cloud.time)), min(_CHUNKS, len(cloud.time))):
            colours = displayed(cloud.shaded(rows, world_from_part))
            self.scene.add_points(cloud.points_in_part[rows], colours, 1.2 * cloud.spacing)
            ends.append(float(cloud.time[rows[-1]]))
        low, high = cloud.limits
        scale = np.tile(np.asarray(cloud.scale, np.uint8), (12, 1, 1))
        gui.add_image(scale, label=f"{cloud.title}: {low:.3g} to {high:.3g}", format="png")
        return ends


def serve_playback(
    run: RecordedRun,
    *,
    host: str = LOOPBACK,
    port: int = 8080,
    colour: ColourBy = "deviation",
    threads: int = 0,
    started: Callable[[str], None] = lambda _: None,
    stop: Event | None = None,
) -> None:
    """Show a run in browsers until `stop` is set.

    Parameters
    ----------
    port
        To listen on; the next free port is used if it is in use.
    started
        Receives the address to open.

    Raises
    ------
    ScancellError
        If viser is not installed, or the cloud has no such colours.
    """
    stop = stop or Event()
    with quiet_server(host, port) as server:
        playback = Playback(server, run, colour, threads)
        started(address(server))
        playback.run(stop.is_set)
