"""Scans of the part in the workspace: one at a time, shown to all browsers."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from pathlib import Path
from threading import Lock

import numpy as np

from scancell.browser.scene.live_cloud import LiveCloud
from scancell.config.choices import Engine
from scancell.errors import CommandError
from scancell.files import first_free
from scancell.geometry.mesh import Mesh
from scancell.live.cell import LiveCell
from scancell.live.scan import LiveChunk, LiveScan, LiveScanState
from scancell.results import ScanResult

_LINE_SPACING = 0.2e-3  # m between points of scan lines, whose distances are not known
_CHUNK = 20_000  # points of a cloud that is shown again


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
        """Of the scan that is kept.

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
        """What is lost with the next scan, another part or run, and the end; empty if nothing."""
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
