"""Scans of the part: start, progress, colours of the cloud, and saving."""

from __future__ import annotations

import tempfile
from html import escape
from pathlib import Path
from typing import Any, get_args

import numpy as np

from scancell.browser.panels.colour_bar import colour_bar_html
from scancell.browser.panels.colours import WARNING
from scancell.browser.panels.conditions import can_end, can_move, can_start
from scancell.browser.panels.handles import Follower, set_changed, small_html
from scancell.browser.panels.operator_commands import OperatorCommands
from scancell.browser.panels.scan_playback import ScanPlayback
from scancell.browser.panels.scans import Scans
from scancell.browser.scene.live_cloud import LIVE_COLOURS
from scancell.config.choices import Engine
from scancell.live.commands import Cancel
from scancell.live.state import LiveState
from scancell.reconstruction.cloud_files import write_cloud

_STEP = 0.01  # s of the slider


class ScanPanel:
    """Runs the scan of the descriptions, and plays it back."""

    def __init__(self, gui: Any, operator: OperatorCommands, scans: Scans, playback: ScanPlayback) -> None:
        self._operator, self._scans, self._playback = operator, scans, playback
        self._engine = gui.add_dropdown("engine", get_args(Engine), initial_value=scans.engine)
        start, cancel = gui.add_button("Scan the part"), gui.add_button("End the scan")
        self._progress = gui.add_progress_bar(0.0)
        self._text = gui.add_html("")
        self._colour = gui.add_dropdown("colours show", LIVE_COLOURS)
        self._shown_colour = Follower(self._colour)
        self._bar = gui.add_html("")
        self._limits = gui.add_vector2("limits of the colours", (0.0, 1.0), visible=False)
        self._shown_limits = Follower(self._limits)
        self._automatic = gui.add_button("Automatic limits", visible=False)
        save, download = gui.add_button("Save the run folder"), gui.add_button("Download the cloud (PLY)")
        self._play = gui.add_button("Play the scan back", icon="player-play")
        self._time = gui.add_slider("time of the scan, s", 0.0, 1.0, _STEP, 0.0, visible=False)
        self._shown_time = Follower(self._time)
        self._leave = gui.add_button("Back to the running cell", visible=False)
        start.on_click(operator.operator_callback(lambda: scans.start(self._engine.value)))
        cancel.on_click(operator.callback(lambda: operator.submit(Cancel())))
        self._colour.on_update(operator.callback(lambda: scans.cloud.colour_by(self._colour.value)))
        self._limits.on_update(operator.callback(lambda: scans.cloud.limit(*self._limits.value)))
        self._automatic.on_click(operator.callback(scans.cloud.limit))
        save.on_click(operator.operator_callback(lambda: operator.show_message(f"saved: {scans.save()}")))
        download.on_click(operator.callback(self._download))
        self._play.on_click(operator.operator_callback(playback.play_or_pause))
        self._time.on_update(operator.operator_callback(lambda: playback.go_to(self._time.value)))
        self._leave.on_click(operator.operator_callback(playback.leave))
        operator.add_inputs([self._time, self._leave])
        operator.add_inputs([self._play], lambda state: "" if playback.is_on else scans.lack or can_start(state))
        operator.add_inputs([self._engine, self._colour, self._limits, self._automatic])
        operator.add_inputs([start], lambda state: scans.hindrance or can_move(state))
        operator.add_inputs([cancel], can_end)
        operator.add_inputs([save], lambda _: scans.lack)
        operator.add_inputs([download], lambda _: scans.lack, by_all=True)

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
        for handle in (self._time, self._leave):
            set_changed(handle, "visible", playback.is_on)
        if playback.is_on:
            set_changed(self._time, "max", max(_STEP, float(np.ceil(playback.duration / _STEP) * _STEP)))
            self._shown_time.show(round(playback.time, 2))

    def _show_colours(self) -> None:
        self._shown_colour.show(self._scans.cloud.colour)
        bar = self._scans.cloud.bar
        set_changed(self._bar, "content", "" if bar is None else colour_bar_html(bar))
        for handle in (self._limits, self._automatic):
            set_changed(handle, "visible", bar is not None)
        if bar is not None:
            self._shown_limits.show(tuple(round(value, 3) for value in bar.limits))

    def _download(self) -> None:
        cloud = self._scans.result.cloud
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "cloud.ply"
            write_cloud(file, cloud)
            self._operator.send_file(file.name, file.read_bytes())
