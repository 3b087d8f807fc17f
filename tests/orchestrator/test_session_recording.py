"""Recording of a live cell while it runs: what the files hold, and how they begin and end."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from scancell import Scanner
from scancell.browser.panels.teach_panel import SessionRecording
from scancell.errors import OutputError
from scancell.live.camera import CameraFeed
from scancell.live.cell import LiveCell
from scancell.live.scan import LiveChunk

mcap_reader = pytest.importorskip("mcap.reader")

POINTS = np.arange(12.0).reshape(4, 3)
CHUNK = LiveChunk(POINTS, *np.ones((3, 4)), np.zeros(4, np.int32), np.zeros(4), np.zeros(4))


class Rig:
    """A live cell that runs at the pace of the recorder, which is the wall clock's."""

    def __init__(self, live: LiveCell, feed: CameraFeed, cell: object) -> None:
        self.live, self.feed, self.cell = live, feed, cell

    def recording(self, out: Path) -> SessionRecording:
        return SessionRecording(self.live, self.cell, self.feed, out)  # type: ignore[arg-type]

    def wait(self, seconds: float) -> None:
        end = self.live.state.time + seconds
        self.live.run(lambda: self.live.state.time >= end)


@pytest.fixture(scope="module")
def rig(ideal_scanner: Scanner) -> Iterator[Rig]:
    with ideal_scanner.session(None) as session:
        live = LiveCell(session)
        with CameraFeed(live, session) as feed:
            yield Rig(live, feed, session.true)


def topics(path: Path) -> dict[str, list[float]]:
    """Times of the messages of each topic, s; the file must be complete."""
    found: dict[str, list[float]] = {}
    with path.open("rb") as file:
        reader = mcap_reader.make_reader(file)
        assert reader.get_summary() is not None
        for _, channel, message in reader.iter_messages():
            found.setdefault(channel.topic, []).append(message.log_time * 1e-9)
    return found


def test_states_and_points_are_recorded_while_it_is_on(rig: Rig, tmp_path: Path) -> None:
    with rig.recording(tmp_path / "new") as recording:
        recording.points(CHUNK)  # before: not recorded
        begin = rig.live.state.time
        recording.start()
        assert recording.is_on
        rig.wait(0.3)
        recording.points(CHUNK)
        recording.stop()
        assert not recording.is_on
        end = rig.live.state.time
        rig.wait(0.1)
    found = topics(tmp_path / "new" / "session_1.mcap")
    assert len(found["/profiles"]) == 1
    assert len(found["/scene"]) == 1
    assert begin - 1e-9 <= min(found["/tf"]) < max(found["/tf"]) <= end + 1e-9
    assert (np.diff(found["/tf"]) > 0).all()


def test_each_recording_has_a_file_of_its_own_and_the_end_completes_it(rig: Rig, tmp_path: Path) -> None:
    with rig.recording(tmp_path) as recording:
        for _ in range(2):
            recording.start()
            recording.start()  # it records already
            rig.wait(0.1)
            recording.stop()
        recording.start()
        rig.wait(0.1)
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["session_1.mcap", "session_2.mcap", "session_3.mcap"]
    assert all(topics(tmp_path / name)["/tf"] for name in names)


def test_folder_that_cannot_be_created_is_reported(rig: Rig, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    recording = rig.recording(tmp_path / "file" / "folder")
    with pytest.raises(OutputError, match=r"session_1\.mcap: cannot be written"):
        recording.start()
    assert not recording.is_on
    recording.stop()
