"""A run played back in a browser: what the slider, the buttons and the command do."""

from __future__ import annotations

import shutil
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from urllib.request import urlopen

import numpy as np
import pytest
from commands import COMMAND, PARTS, PATIENCE_S, QUICK, environment, scancell_here

from chromium import Watched, chromium
from scancell.views.recorded_run import open_run

viser = pytest.importorskip("viser")

from scancell.browser.panels.scans import Playback, serve_playback  # noqa: E402
from scancell.browser.server.gate import address, quiet_server  # noqa: E402


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Run folder of a small scan."""
    place = tmp_path_factory.mktemp("playback")
    done = scancell_here("scan", PARTS / "free_form.stl", *QUICK, "--out", "run", "--json", cwd=place)
    assert done.code == 0, done.err
    return place / "run"


@pytest.fixture(scope="module")
def run(folder):
    return open_run(folder, most_points=20_000)


@pytest.fixture
def server() -> Iterator[viser.ViserServer]:
    with quiet_server(port=0) as made:
        yield made


def wait_for(condition: Callable[[], bool], what: str) -> None:
    """Until `condition` holds; only a hang takes as long as the patience for one."""
    for _ in range(PATIENCE_S * 20):
        if condition():
            return
        time.sleep(0.05)
    raise AssertionError(f"timed out waiting for {what}")


def cloud_points(server) -> int:
    """Number of points that are shown."""
    count, number = 0, 0
    while (chunk := server.scene.get_handle_by_name(f"/frames/part/cloud/{number}")) is not None:
        count += len(chunk.points) if chunk.visible else 0
        number += 1
    return count


def test_slider_moves_everything_and_the_cloud_grows_with_it(server, run) -> None:
    playback = Playback(server, run, "deviation")
    counts = []
    for moment in np.linspace(run.motion.start, run.motion.duration, 9).tolist():
        playback.go_to(moment)
        assert playback.time == moment
        frames = run.motion.frames(moment)
        for name in ("link[3]", "sensor", "part"):
            np.testing.assert_allclose(playback.scene.position(name), frames[name][:3, 3], atol=3e-5)
        counts.append(cloud_points(server))
        assert counts[-1] <= (run.cloud.time <= moment).sum()
    assert counts == sorted(counts)
    assert counts[0] == 0
    assert counts[-1] == len(run.cloud)
    sheet = server.scene.get_handle_by_name("/frames/sensor/laser")
    for moment in (float(run.motion.times[5]), run.motion.start):
        playback.go_to(moment)
        assert sheet.visible == run.motion.laser_on(moment)


def test_it_plays_at_its_speed_to_the_end_and_starts_over(server, run) -> None:
    playback = Playback(server, run, "intensity")
    playback.advance(1.0)
    assert playback.time == run.motion.start  # it does not play yet
    playback.play_or_pause()
    playback.advance(0.1)
    assert playback.time == pytest.approx(run.motion.start + 0.1 * playback.speed)
    playback.play_or_pause()
    playback.advance(0.1)
    assert playback.time == pytest.approx(run.motion.start + 0.1 * playback.speed)
    playback.play_or_pause()
    playback.advance(1e6)
    assert playback.time == run.motion.duration
    assert not playback.plays
    playback.play_or_pause()
    assert playback.time == run.motion.start


def test_run_without_a_cloud_plays(server, folder, tmp_path) -> None:
    other = tmp_path / "run"
    shutil.copytree(folder, other, ignore=shutil.ignore_patterns("cloud.ply"))
    Playback(server, open_run(other), "deviation").go_to(1.0)
    assert cloud_points(server) == 0


def test_browser_asks_nobody_else_and_its_slider_moves_the_arm(server, run) -> None:
    playback = Playback(server, run, "deviation")
    home = playback.scene.position("sensor")
    with chromium() as browser:
        watched = Watched(browser, 640, 420, sharpness=0.0)
        page = watched.page
        watched.opens(address(server))
        page.get_by_role("slider").first.press("End")
        wait_for(lambda: playback.time > run.motion.duration - 0.02, "the slider's end")
        last = playback.scene.position("sensor")
        np.testing.assert_allclose(last, run.motion.frames(playback.time)["sensor"][:3, 3], atol=3e-5)
        page.get_by_role("button", name="Play").click()
        wait_for(lambda: playback.plays, "the button")
        playback.advance(0.2 * run.motion.duration / playback.speed)
        assert np.linalg.norm(playback.scene.position("sensor") - home) > 0.01
        page.get_by_role("button", name="Pause").click()
        wait_for(lambda: not playback.plays, "the button")
    assert watched.errors == []
    place = address(server).removeprefix("http://")
    assert {"ws"} < {url.partition(":")[0] for url in watched.requests}
    own = ("http://", "ws://")
    allowed = ("data:", "blob:", *(f"{kind}{place}" for kind in own))
    assert all(url.startswith(allowed) for url in watched.requests), watched.requests


def test_serving_ends_when_it_is_told(run) -> None:
    stop, at = threading.Event(), []
    served = threading.Thread(target=lambda: serve_playback(run, port=18080, started=at.append, stop=stop))
    served.start()
    wait_for(lambda: bool(at), "the server")
    with urlopen(at[0], timeout=PATIENCE_S) as page:
        assert b"<html" in page.read(2000).lower()
    stop.set()
    served.join(PATIENCE_S)
    assert not served.is_alive()


def test_command_says_where_and_ends_with_ctrl_c(folder) -> None:
    words = [*COMMAND, "workspace", str(folder), "--port", "18090"]
    pipe = subprocess.PIPE
    with subprocess.Popen(words, env=environment(), stdout=pipe, stderr=pipe, text=True) as process:
        assert process.stdout is not None
        said = process.stdout.readline().split()
        assert said[:2] == ["workspace:", "open"]
        with urlopen(said[2], timeout=PATIENCE_S) as page:
            assert page.status == 200
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130, err
    assert "viser" not in out + err
