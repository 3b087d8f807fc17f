"""Scans of the part in the workspace: one at a time, shown to all browsers."""

from __future__ import annotations

from collections.abc import Callable
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


class Scans:
    """Starts scans in a live cell, and keeps the result of the last one.

    Parameters
    ----------
    part
        Mesh of the part; None: there is nothing to scan.
    out
        Folder in which `save` makes run folders.
    engine
        Initial engine.
    on_points
        Receives the points of scans, too.

    Attributes
    ----------
    cloud
        The points that are shown.
    saved
        The last run folder; None before the first.
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
        self._scan: LiveScan | None = None
        self.saved: Path | None = None

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
        """Of the last scan.

        Raises
        ------
        CommandError
            If no scan has finished.
        """
        if self.lack or self._scan is None:
            raise CommandError(self.lack)
        return self._scan.result.result()

    @property
    def lack(self) -> str:
        """Reason why there is no `result`; empty if there is one."""
        finished = self._scan is not None and self._scan.result.done() and not self.error
        return "" if finished else "there is no finished scan"

    @property
    def hindrance(self) -> str:
        """Reason why no scan can start; empty if one can."""
        if self._part is None:
            return "the table is empty: open a part first"
        if self._scan is not None and not self._scan.result.done():
            return "a scan is running: end it first"
        return ""

    def start(self, engine: Engine) -> None:
        """Plan and run the scan of the descriptions.

        Raises
        ------
        CommandError
            If the table is empty, or a scan runs.
        """
        with self._lock:
            if self.hindrance:
                raise CommandError(self.hindrance)
            self.cloud.clear()
            scan = LiveScan(engine, on_points=lambda chunk: self._add(scan, chunk))
            self._scan = scan
        scan.start(self._live)

    def save(self) -> Path:
        """Write the run folder of the last scan: the first of ``scan_1``, ``scan_2``, ... that does not exist.

        Raises
        ------
        ScancellError
            If there is no finished scan, or the folder cannot be written.
        """
        result, folder = self.result, first_free(self._out, "scan_{}")
        result.save(folder)
        self.saved = folder
        return folder

    def _add(self, scan: LiveScan, chunk: LiveChunk) -> None:
        state = scan.state
        if scan is not self._scan or self._part is None:
            return
        # The first chunk tells how many points there will be.
        expected = max(1, state.points) / max(1, state.sensed) * state.planned
        self._on_points(chunk)
        self.cloud.add(chunk, float(np.sqrt(self._part.areas.sum() / expected)))
