"""Opening of parts and runs, recording, and pictures."""

from __future__ import annotations

from html import escape
from pathlib import Path, PurePath
from typing import Any, Protocol

from scancell.browser.panels.colours import WARNING
from scancell.browser.panels.handles import Follower, set_changed, small_html
from scancell.browser.panels.operator_commands import OperatorCommands
from scancell.browser.panels.recording import SessionRecording
from scancell.browser.panels.scans import Scans
from scancell.errors import DescriptionError
from scancell.live.state import LiveState
from scancell.nominal.parts import PART_FORMATS

_UNITS = ("mm", "m", "inch")
_LONGEST_NAME = 200  # bytes


class Opener(Protocol):
    """Opens another view."""

    def start_again(self) -> None:
        """Open the cell anew, with the same part."""

    def open_part(self, name: str, content: bytes, unit: str) -> None:
        """Show the cell with the file of a part, by its name, content and unit."""

    def open_run(self, name: str, content: bytes) -> None:
        """Play back a run, by the name and content of a zip file of its folder."""


class FilePanel:
    """Opens another part or a run, records the session, and saves pictures."""

    def __init__(
        self, gui: Any, operator: OperatorCommands, opener: Opener, recording: SessionRecording, scans: Scans
    ) -> None:
        self._operator, self._opener, self._recording, self._scans = operator, opener, recording, scans
        self._lost = gui.add_html("")
        self._unit = gui.add_dropdown("unit of the mesh", _UNITS)
        self._upload = gui.add_upload_button("Open a part (STL, OBJ, PLY, TOML)", mime_type=",".join(PART_FORMATS))
        self._run = gui.add_upload_button("Open a run (zip of a run folder)", mime_type=".zip,application/zip")
        self._record = gui.add_checkbox("Record (MCAP)", recording.is_on)
        self._shown_record = Follower(self._record)
        self._text = gui.add_html("")
        picture = gui.add_button("Download a picture")
        self._upload.on_upload(operator.operator_callback(self._open))
        self._run.on_upload(operator.operator_callback(self._open_run))
        self._record.on_update(operator.operator_callback(self._switch_recording))
        picture.on_click(operator.callback(self._take_picture))
        operator.add_inputs([self._unit, self._upload, self._run, self._record])

    def show(self, state: LiveState) -> None:
        """Show the state and the file of the recording, and what another part or run discards."""
        lost = self._scans.unsaved and f"Another part or run discards {self._scans.unsaved}."
        set_changed(self._lost, "content", small_html([f'<b style="color:{WARNING}">{lost}</b>' if lost else ""]))
        recording = self._recording
        self._shown_record.show(recording.is_on)
        text = recording.error
        if not text and recording.path is not None:
            text = f"{'recording' if recording.is_on else 'recorded'}: {recording.path}"
        set_changed(self._text, "content", small_html([escape(text)]))

    def _switch_recording(self) -> None:
        if self._recording.is_on:
            self._recording.stop()
        else:
            self._start_recording()

    def _start_recording(self) -> None:
        try:
            self._recording.start()
        finally:
            set_changed(self._record, "value", self._recording.is_on)

    def _open_run(self) -> None:
        file = self._run.value
        self._opener.open_run(_checked_name(file), file.content)

    def _open(self) -> None:
        file = self._upload.value
        name = _checked_name(file)
        if Path(name).suffix.lower() not in PART_FORMATS:
            raise DescriptionError(f"{name}: expected the file of a part, {', '.join(PART_FORMATS)}")
        self._opener.open_part(name, file.content, self._unit.value)

    def _take_picture(self) -> None:
        self._operator.send_file("scancell.png", self._operator.picture())


def _checked_name(file: Any) -> str:
    name = PurePath(file.name).name
    if not name.isprintable() or not 0 < len(name.encode()) <= _LONGEST_NAME:
        shown = ascii(name if len(name) <= 60 else f"{name[:40]}...{name[-10:]}")
        raise DescriptionError(f"{shown}: expected a file name of at most {_LONGEST_NAME} printable characters")
    return name
