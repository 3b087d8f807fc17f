"""Scans of the workspace without a browser: what is kept of them, and their playback in the running cell."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
import pytest
from live_cells import PATIENCE, running

from scancell import Scanner
from scancell.browser.panels.operator_commands import can_jog, can_move, can_start
from scancell.browser.panels.scans import PLAYBACK, ScanPlayback, Scans
from scancell.browser.panels.status import advice
from scancell.browser.scene.scene import CellScene, LiveCloud
from scancell.browser.server.gate import quiet_server
from scancell.cell.driver import Operation
from scancell.config.choices import Engine
from scancell.config.loading import assets_dir, load_setup
from scancell.errors import CommandError
from scancell.live.camera import CameraFeed, CameraFrame
from scancell.live.cell import LiveCell
from scancell.live.scan import LiveChunk
from scancell.live.state import Cancel, JogJoints, MoveJoints, Reset, SetOperation
from scancell.results import ScanResult
from scancell.scanning.session import ScanSession

pytest.importorskip("viser")

PART = assets_dir() / "parts" / "free_form.stl"


def until(condition: Callable[[], bool], what: str) -> None:
    """Wait; only a hang takes as long as the patience."""
    waited = Event()
    for _ in range(PATIENCE * 100):
        if condition():
            return
        waited.wait(0.01)
    raise AssertionError(f"timed out waiting for {what}")


class Rig:
    """A cell that runs as fast as it can in another thread, its scene without a browser, and a clock of the test."""

    def __init__(self, session: ScanSession, server: Any, feed: CameraFeed, live: LiveCell, out: Path) -> None:
        self.session, self.live, self.feed, self.server, self.now = session, live, feed, server, 0.0
        setup = session.world.setup
        self.scene = CellScene(server, session.true, setup.sensor, setup.cell)
        self.scans = Scans(live, LiveCloud(self.scene), session.nominal.part, out)
        self.playback = ScanPlayback(live, session.true, self.scans, feed, self.scene, lambda: self.now)

    def scan(self, engine: Engine = "geometric", during: Callable[[], object] = lambda: None) -> ScanResult:
        """Scan, and do something when the first exposures are taken."""
        self.scans.start(engine)
        until(lambda: self.scans.state.taken > 0, "exposures")
        during()
        until(lambda: self.scans.state.stage in ("done", "stopped") and self.scans.figures != "", "the scan")
        until(lambda: self.live.state.job is None, "the end of its job")
        return self.scans.result

    def last_scan(self) -> ScanResult:
        """The scan that is kept; a new one if there is none."""
        return self.scan() if self.scans.lack else self.scans.result

    def stopped_scan(self) -> ScanResult:
        result = self.scan(during=lambda: self.live.submit(Cancel()))
        assert len(result.recording) < len(result.plan.segment)
        return result

    def play(self) -> None:
        self.playback.play_or_pause()
        until(lambda: self.live.state.job == PLAYBACK, "playback")

    def leave(self) -> None:
        self.playback.leave()
        until(lambda: self.live.state.job is None, "the running cell")

    def frame(self, time: float) -> CameraFrame:
        """The replayed frame of an exposure."""
        until(lambda: self.feed.frame is not None and self.feed.frame.is_replayed, "a replayed frame")
        until(lambda: abs(self.feed.frame.time - time) < 1e-9, "the frame of the exposure")
        return self.feed.frame

    @property
    def shown_points(self) -> int:
        count, number = 0, 0
        while (chunk := self.server.scene.get_handle_by_name(f"/frames/part/cloud/{number}")) is not None:
            count += len(chunk.points) if chunk.visible else 0
            number += 1
        return count


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    setup = load_setup(settings=["scan.max_profiles=40", "scan.raster.enabled=false", "scan.sweep.elevations_deg=[45]"])
    out = tmp_path_factory.mktemp("scans")
    with (
        Scanner(setup=setup, threads=2) as scanner,
        scanner.session(PART, seed=3, as_built={"tool.x_mm": 0.05}) as session,
        quiet_server(port=0) as server,
    ):
        live = LiveCell(session)
        with CameraFeed(live, session) as feed, running(live):
            feed.wanted = True
            yield Rig(session, server, feed, live, out)


@pytest.fixture(autouse=True)
def _at_rest(rig: Rig) -> Iterator[None]:
    yield
    rig.leave()
    rig.feed.engine = "geometric"
    rig.feed.perturb([])


@pytest.mark.parametrize("engine", ["geometric", "ray-traced"])
def test_playback_shows_recorded_poses_profiles_cloud_and_the_images_of_the_scan(rig: Rig, engine: Engine) -> None:
    result = rig.scan(engine)
    times, cloud = result.recording.measured.time, result.cloud
    rig.play()
    rig.playback.play_or_pause()
    sensor, part = (result.recording.truth_at_middle(name) for name in ("sensor", "part[1]"))
    for row in (0, 17, len(times) - 1):
        rig.playback.go_to(float(times[row]))
        np.testing.assert_allclose(rig.scene.position("sensor"), sensor[row, :3, 3], atol=3e-5)
        np.testing.assert_allclose(rig.scene.position("part"), part[row, :3, 3], atol=3e-5)
        points = result.profiles.points_in_sensor[result.profiles.frame == row]
        np.testing.assert_allclose(rig.frame(times[row]).points_in_sensor, points, atol=1e-9)
        assert rig.shown_points <= (cloud.time <= times[row]).sum()
    assert rig.shown_points == len(cloud)
    for sample in result.sample_images[1:3]:
        row = int(np.searchsorted(result.recording.measured.index, sample.trigger))
        rig.playback.go_to(float(times[row]))
        np.testing.assert_array_equal(rig.frame(times[row]).images, sample.images >> (sample.bit_depth - 8))
    assert len(result.sample_images) == (4 if engine == "ray-traced" else 0)
    rig.playback.go_to(0.0)
    assert rig.shown_points == 0
    np.testing.assert_allclose(rig.scene.position("link[3]"), _nominal_start(rig, result), atol=1e-3)


def _nominal_start(rig: Rig, result: ScanResult) -> np.ndarray:
    start = result.plan.program.start
    return np.asarray(rig.session.nominal.frame_poses(start)["link[3]"])[:3, 3]


def test_engine_and_sensor_are_those_with_which_the_scan_started(rig: Rig) -> None:
    def change() -> None:
        rig.feed.engine = "ray-traced"
        rig.feed.perturb(["sensor.laser.turn_z_deg=1"])
        rig.scans.engine = "ray-traced"

    result = rig.scan("geometric", change)
    assert (result.engine, result.as_built) == ("geometric", ("tool.x_mm=0.05",))
    assert result.sample_images == ()
    assert result.deviation.rms < 0.1e-3  # a laser turned by 1 degree shifts points by more
    rig.play()
    frame = rig.frame(float(result.recording.measured.time[0]))
    assert (frame.engine, frame.images, frame.as_built) == ("geometric", None, ())
    rig.leave()
    until(lambda: rig.feed.frame.engine == "ray-traced" and not rig.feed.frame.is_replayed, "the running cell")
    assert rig.feed.frame.as_built == ("sensor.laser.turn_z_deg=1",)


def test_robot_cannot_be_moved_during_playback_and_a_sentence_says_so(rig: Rig) -> None:
    rig.last_scan()
    rig.live.submit(SetOperation(Operation.MANUAL))
    until(lambda: rig.live.state.operation is Operation.MANUAL, "manual operation")
    joints = rig.live.state.joints
    rig.play()
    assert "played back" in advice(rig.live.state)
    assert all("playback" in condition(rig.live.state) for condition in (can_move, can_jog, can_start))
    for command in (JogJoints([0.5]), MoveJoints(joints + 0.1)):
        rig.live.submit(command)
        until(lambda name=command.name: rig.live.state.message.startswith(name), "the rejection")
        assert "playback of the scan is running" in rig.live.state.message
    np.testing.assert_allclose(rig.live.state.joints, joints, atol=1e-4)
    rig.leave()
    assert advice(rig.live.state) == ""
    rig.live.submit(JogJoints([0.5]))
    until(lambda: rig.live.state.moving, "the jog")
    until(lambda: not rig.live.state.moving, "its end")


def test_time_advances_in_real_time_to_the_end_and_starts_over(rig: Rig) -> None:
    rig.last_scan()
    playback = rig.playback
    rig.play()
    for step in (0.25, 0.5):
        before, rig.now = playback.time, rig.now + step
        playback.update()
        assert playback.time == pytest.approx(before + step)
    playback.play_or_pause()
    rig.now += 1.0
    playback.update()
    assert playback.time == pytest.approx(0.75)
    playback.play_or_pause()
    rig.now += 1e4
    playback.update()
    assert playback.time == playback.duration
    assert not playback.plays
    playback.play_or_pause()
    assert playback.time == 0.0


def test_stopped_scan_is_played_to_its_last_exposure(rig: Rig) -> None:
    result = rig.stopped_scan()
    rig.play()
    assert rig.playback.duration == result.recording.measured.time[-1]


def test_stop_ends_playback(rig: Rig) -> None:
    rig.last_scan()
    rig.play()
    rig.live.emergency_stop()
    until(lambda: rig.live.state.controller == "emergency stop", "the stop")
    rig.playback.update()
    assert not rig.playback.is_on
    rig.play()  # a stopped robot is no obstacle
    rig.leave()
    rig.live.submit(Reset())
    until(lambda: rig.live.state.controller == "at rest", "the reset")


def test_scan_that_fails_leaves_the_last_one_and_one_that_measures_replaces_it(rig: Rig) -> None:
    first = rig.scan()
    assert f"{len(first.cloud)} points" in rig.scans.unsaved
    ended = Event()
    rig.live.perform(lambda session: [session.step() for _ in iter(ended.is_set, True)], "another job")
    until(lambda: rig.live.state.job == "another job", "another job")
    rig.scans.start("geometric")
    until(lambda: rig.scans.error != "", "the failure")
    assert rig.scans.result is first
    ended.set()
    until(lambda: rig.live.state.job is None, "its end")
    unsaved = rig.scans.unsaved
    second = rig.scan()
    assert rig.scans.discarded == unsaved
    assert rig.scans.result is second
    folder = rig.scans.save()
    assert (folder / "cloud.ply").is_file()
    assert rig.scans.unsaved == ""


def test_points_of_a_program_replace_the_scan_until_it_is_played_back(rig: Rig) -> None:
    result = rig.last_scan()
    add = rig.scans.points_of_program()
    assert rig.shown_points == len(result.cloud)
    chunk = LiveChunk.of(result.cloud[:500], result.deviation.distance[:500])
    add(chunk)
    add(chunk)
    assert rig.shown_points == 1000
    rig.play()
    rig.playback.go_to(rig.playback.duration)
    assert rig.shown_points == len(result.cloud)


def test_nothing_is_played_back_without_a_scan(rig: Rig) -> None:
    scans = Scans(rig.live, rig.scans.cloud, None, Path("unused"))
    playback = ScanPlayback(rig.live, rig.session.true, scans, rig.feed, rig.scene)
    with pytest.raises(CommandError, match="no finished scan"):
        playback.play_or_pause()
    with pytest.raises(CommandError, match="no scan is played back"):
        playback.go_to(1.0)
