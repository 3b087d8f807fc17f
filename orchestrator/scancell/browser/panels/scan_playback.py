"""Playback of the last scan in the workspace: robot and table, camera images and profile, and the cloud so far."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from threading import Event, RLock
from time import monotonic

import numpy as np

from scancell.browser.panels.scans import Scans
from scancell.browser.scene.scene import CellScene
from scancell.errors import CommandError
from scancell.live.camera import CameraFeed
from scancell.live.cell import LiveCell
from scancell.nominal.cell import NominalCell
from scancell.results import ScanResult
from scancell.scanning.session import ScanSession
from scancell.views.motion import RunMotion, scan_motion

PLAYBACK = "the playback of the scan"  # name of its job


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
        Of the scan, that is shown, s.
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
        """Of the scan that is played back, s; 0 without one."""
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
