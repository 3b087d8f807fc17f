"""Recording of a workspace session as an MCAP file."""

from __future__ import annotations

from pathlib import Path
from threading import Event, RLock, Thread

from scancell.closing import Closing
from scancell.errors import OutputError
from scancell.files import first_free
from scancell.live.camera import CameraFeed
from scancell.live.cell import LiveCell
from scancell.live.scan import LiveChunk
from scancell.nominal.cell import NominalCell
from scancell.stopwatch import Pace
from scancell.views.mcap_export import SessionRecorder

_RATE = 30.0  # Hz, of states


class SessionRecording(Closing):
    """Writes states, camera frames and points of scans in a thread of its own. All methods are thread-safe.

    Parameters
    ----------
    live, cell, feed
        The running cell, its bodies, and its cameras.
    out
        Folder of the files ``session_1.mcap``, ``session_2.mcap``, ...
    """

    def __init__(self, live: LiveCell, cell: NominalCell, feed: CameraFeed, out: Path) -> None:
        self._live, self._cell, self._feed, self._out = live, cell, feed, out
        self._lock, self._ending = RLock(), Event()
        self._recorder: SessionRecorder | None = None
        self._thread: Thread | None = None
        self._path: Path | None = None
        self._error = ""

    @property
    def is_on(self) -> bool:
        """Whether recording is active."""
        return self._recorder is not None

    @property
    def path(self) -> Path | None:
        """The last file; None before the first."""
        return self._path

    @property
    def error(self) -> str:
        """Reason why the last recording ended early; empty if it did not."""
        return self._error

    def start(self) -> None:
        """Begin a file, unless recording is active.

        Raises
        ------
        ScancellError
            If the file cannot be written, or packages of the extra `workspace` are missing.
        """
        with self._lock:
            if self.is_on:
                return
            path = first_free(self._out, "session_{}.mcap")
            try:
                self._out.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise OutputError(f"cannot be written: {error.strerror or error}", file=path) from error
            self._recorder = SessionRecorder(path, self._cell)
            self._path, self._error = path, ""
            self._ending.clear()
            self._thread = Thread(target=self._record, name="record", daemon=True)
            self._thread.start()

    def stop(self) -> None:
        """Complete the file, if recording is active."""
        self._ending.set()
        if self._thread is not None:
            self._thread.join()

    def points(self, chunk: LiveChunk) -> None:
        """Record points of a scan, if recording is active."""
        with self._lock:
            if self._recorder is not None:
                self._recorder.points(chunk)

    def close(self) -> None:
        """As `stop`."""
        self.stop()

    def _record(self) -> None:
        pace, number = Pace(1 / _RATE), 0
        try:
            while not self._ending.is_set() and self._recorder is not None:
                self._recorder.state(self._live.state)
                frame = self._feed.frame
                if frame is not None and frame.number != number and not frame.is_replayed:
                    number = frame.number
                    self._recorder.cameras(frame)
                pace.wait()
        except OutputError as error:
            self._error = str(error)
        finally:
            with self._lock:
                recorder, self._recorder = self._recorder, None
                if recorder is not None:
                    self._complete(recorder)

    def _complete(self, recorder: SessionRecorder) -> None:
        try:
            recorder.close()
        except OutputError as error:
            self._error = self._error or str(error)
