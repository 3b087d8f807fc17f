"""A recorded run in a browser, played back with a slider of its time."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from threading import Event, RLock
from time import monotonic
from typing import TYPE_CHECKING

import numpy as np

from scancell.browser.panels.messages import report_errors, show_message
from scancell.browser.panels.view_options import add_switch
from scancell.browser.scene.scene import CellScene
from scancell.browser.server.quiet import address, quiet_server
from scancell.config.choices import LOOPBACK
from scancell.stopwatch import Pace
from scancell.views.coloured_cloud import ColourBy, coloured_by
from scancell.views.recorded_run import RecordedRun
from scancell.views.shading import displayed

if TYPE_CHECKING:
    import viser

_CHUNKS = 200  # of the cloud
_STEP = 0.01  # s of the slider
_RATE = 30.0  # Hz, of updates
_SPEEDS = ("0.5 x", "1 x", "2 x", "5 x", "10 x", "20 x")


class Playback:
    """Plays a run back on a server of viser; all its browsers show and control the same time.

    Parameters
    ----------
    server
        Of viser.
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
