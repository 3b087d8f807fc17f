"""A run and its deviations as HTML files: what they hold, and that a browser shows them without a request."""

from __future__ import annotations

import base64
import io
import json
import re
import shutil

import numpy as np
import pytest
from commands import PARTS, QUICK, scancell_here
from PIL import Image

import scancell
from chromium import Watched, chromium
from scancell.geometry import pose
from scancell.views.recorded_run import open_run


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Run folder of a small scan, and its page."""
    place = tmp_path_factory.mktemp("pages")
    for words in (("scan", PARTS / "free_form.stl", *QUICK, "--out", "run"), ("page", "run", "--out", "run.html")):
        done = scancell_here(*words, "--json", cwd=place)
        assert done.code == 0, done.err
    return place


@pytest.fixture(scope="module")
def run(folder):
    return open_run(folder / "run", 500_000)


@pytest.fixture(scope="module")
def held(folder) -> dict:
    """The data of the page."""
    text = (folder / "run.html").read_text(encoding="utf-8")
    return json.loads(re.search(r'<script type="application/json" id="run">(.*?)</script>', text, re.DOTALL)[1])


def array(text: str, kind: str, *shape: int) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), kind).reshape(shape)


def test_points_and_times_are_those_of_the_cloud(held, run) -> None:
    cloud = held["cloud"]
    points = cloud["low"] + np.array(cloud["size"]) * array(cloud["points"], "<u2", -1, 3) / 65535
    np.testing.assert_allclose(points, run.cloud.points_in_part, atol=np.max(cloud["size"]) / 65535)
    np.testing.assert_allclose(array(cloud["time"], "<f4", -1), run.cloud.time, rtol=1e-6)
    assert len(array(cloud["colours"], "u1", -1, 3)) == len(run.cloud)
    assert cloud["total"] == run.cloud_points


def test_bodies_are_those_of_the_cell_within_the_grid(held, run) -> None:
    assert len(held["bodies"]) == len(run.cell.bodies)
    for shown, body in zip(held["bodies"], run.cell.bodies, strict=True):
        assert held["frames"][shown["frame"]] == body.moves_with
        bounds = np.stack([shown["low"], np.add(shown["low"], shown["size"])])
        np.testing.assert_allclose(bounds, body.mesh.bounds, atol=np.ptp(body.mesh.bounds, axis=0).max() / 60)
        assert array(shown["faces"], "<u4", -1).max() < len(array(shown["vertices"], "<u2", -1, 3))


def test_poses_are_those_of_the_run(held, run) -> None:
    poses = array(held["poses"], "<f4", held["samples"], len(held["frames"]), 7)
    for sample in (0, held["samples"] // 3, held["samples"] - 1):
        frames = run.motion.frames(held["start"] + held["step"] * sample)
        for name, flat in zip(held["frames"], poses[sample].astype(float), strict=True):
            np.testing.assert_allclose(pose.pose(flat[:3], flat[3:]), frames[name], atol=1e-5)


def test_page_refers_to_nothing_outside(folder) -> None:
    text = (folder / "run.html").read_text(encoding="utf-8")
    assert "@RUN@" not in text
    assert not re.search(r"https?://|src=|href=|import\(|fetch\(|@import|url\(", text)


def test_name_of_the_part_cannot_end_the_script(folder, tmp_path) -> None:
    """A file name is text from outside."""
    other = tmp_path / "run"
    shutil.copytree(folder / "run", other)
    name = tmp_path / "<script>alert(1)<" / "b.stl"
    name.parent.mkdir()
    named = name.with_name("<b>&.stl")
    shutil.copy(PARTS / "free_form.stl", named)
    resolved = (other / "resolved.toml").read_text()
    (other / "resolved.toml").write_text(re.sub(r'part = ".*"', f'part = "{named}"', resolved))
    assert scancell_here("page", other, "--out", "odd.html", "--json", cwd=tmp_path).code == 0
    text = (tmp_path / "odd.html").read_text(encoding="utf-8")
    assert "<b>&.stl" not in text
    assert "<title>&lt;b&gt;&amp;.stl</title>" in text


def test_fewer_points_make_a_smaller_file(folder) -> None:
    done = scancell_here("page", "run", "--points", "1000", "--out", "few.html", "--json", cwd=folder)
    assert done.last_line["figures"]["points"] <= 1000
    assert (folder / "few.html").stat().st_size < (folder / "run.html").stat().st_size
    assert done.last_line["figures"]["megabytes"] * 1e6 == pytest.approx((folder / "few.html").stat().st_size)


def test_browser_shows_the_run_without_a_request(folder, run) -> None:
    """The slider moves the arm and the cloud; errors and requests are none."""
    with chromium() as browser:
        watched = Watched(browser, 480, 320)
        page = watched.page
        page.goto((folder / "run.html").as_uri())
        page.wait_for_function("window.scancell")
        seen = []
        for time in (run.motion.start, float(run.cloud.time[-1])):
            page.locator("#time").evaluate(
                "(slider, time) => { slider.value = time; slider.dispatchEvent(new Event('input')); }", time
            )
            page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
            state = page.evaluate("scancell.state")
            flat = np.array(page.evaluate("time => scancell.framePose('sensor', time)", state["time"]))
            np.testing.assert_allclose(flat.reshape(4, 4).T, run.motion.frames(state["time"])["sensor"], atol=5e-3)
            seen.append((state["shown"], np.asarray(Image.open(io.BytesIO(page.screenshot())).convert("RGB"), int)))
    assert watched.errors == []
    assert watched.requests == [(folder / "run.html").as_uri()]
    assert [shown for shown, _ in seen] == [0, len(run.cloud)]
    assert np.abs(seen[0][1] - seen[1][1]).max() > 60
    assert all(picture.std() > 10 for _, picture in seen)


def test_browser_turns_the_deviations_and_goes_to_outliers(folder, run, tmp_path) -> None:
    """A row of the list brings its outlier into the middle; each box of a layer changes the picture."""
    low, high = run.part.bounds
    points = np.concatenate([run.cloud.points_in_part, [[0.0, 0.0, high[2] + 0.01], [low[0] - 0.02, 0.0, 0.01]]])
    scancell.evaluate(points, mesh=PARTS / "free_form.stl", out=tmp_path)
    address = (tmp_path / "evaluation.html").as_uri()
    settled = "() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"
    with chromium() as browser:
        watched = Watched(browser, 1366, 768, 0.5)
        page = watched.page
        page.set_default_timeout(60_000)

        def view() -> np.ndarray:
            page.evaluate(settled)
            return np.asarray(Image.open(io.BytesIO(page.locator("#frame").screenshot())).convert("RGB"), int)

        # A scan without noise has no outliers.
        for one in ((folder / "run" / "deviation.html").as_uri(), address):
            page.goto(one)
            assert watched.errors == []
            page.wait_for_function("window.scancell")
            first = view()
            assert first.std() > 10
        for layer in ("surface", "cloud", "unseen"):
            page.locator(f"#show-{layer}").click()
            assert np.abs(view() - first).max() > 30
            page.locator(f"#show-{layer}").click()
        places = page.evaluate("scancell.places")
        np.testing.assert_allclose(places[0], points[-1], atol=1e-6)
        page.locator("tr[data-at]").first.click()
        page.evaluate(settled)
        np.testing.assert_allclose(page.evaluate("scancell.state.target"), places[0])
        box, mark = page.locator("#view").bounding_box(), page.locator(".mark").first.bounding_box()
        assert abs(mark["x"] + mark["width"] / 2 - box["x"] - box["width"] / 2) < 3
        for words in ("#verdict", "#outliers", "#unseen"):  # on the first screen
            assert page.locator(words).bounding_box()["y"] < 768
    assert watched.errors == []
    assert watched.requests == [(folder / "run" / "deviation.html").as_uri(), address]
