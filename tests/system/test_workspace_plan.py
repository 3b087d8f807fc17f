"""Plan, runs and recordings in the workspace: what a person does in a browser, and what the robot does then."""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import PARTS, QUICK, scancell_here
from mcap.reader import make_reader
from test_workspace import Opened, entry, fill

from chromium import chromium
from scancell import Scanner
from scancell.browser.panels.plans import Plans
from scancell.browser.panels.scans import Playback
from scancell.browser.server.workspace import WorkspaceSettings
from scancell.planning.path_map.configuration_map import CLEARANCE, FREE, ConfigurationMap
from scene_nodes import visible_bodies
from spiral_cell import PART, spiral_setup
from tour import hosted, tab, waits


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as made:
        yield made


@pytest.fixture(scope="module")
def scanner(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Scanner]:
    """A post beside the table forbids some of the poses along a spiral."""
    with Scanner(setup=spiral_setup(tmp_path_factory.mktemp("post")), threads=1) as made:
        yield made


@pytest.fixture
def opened(scanner: Scanner, browser: Any, tmp_path: Path) -> Iterator[Opened]:
    with hosted(scanner, PART, WorkspaceSettings(tmp_path)) as (host, server):
        assert host.workspace is not None
        host.workspace.feed.wanted = False  # images take the processor, which draws the pages, too
        yield Opened(host, server, tmp_path, browser)
    for context in browser.contexts:
        context.close()


def some_cell(map_: ConfigurationMap, cause: int) -> tuple[float, float]:
    """Share of the way and turn, 0 to 1, of a cell away from the edges amid those that a constraint forbids."""
    columns, rows = np.nonzero(map_.cause == cause)
    inner = np.abs(rows / map_.rows - 0.5) < 0.45
    columns, rows = columns[inner], rows[inner]
    middle = len(columns) // 2
    return columns[middle] / (map_.columns - 1), rows[middle] / map_.rows


def click_map(page: Any, plans: Plans, place: tuple[float, float]) -> None:
    """Click a place of the map until it is looked at: inputs that appear move the map away from under a click.

    A map that is drawn again has no box for a moment.
    """
    drawn = page.locator("[data-map]")

    def is_looked_at() -> bool:
        return plans.picked is not None and np.allclose((plans.share, plans.angle / (2 * np.pi)), place, atol=0.01)

    def clicked() -> bool:
        if not is_looked_at() and (box := drawn.bounding_box()) is not None:
            drawn.click(position={"x": place[0] * box["width"], "y": (1 - place[1]) * box["height"]})
        return is_looked_at()

    waits(page, clicked, "the pose in the map")


def test_map_is_clicked_the_robot_goes_there_and_the_plan_plays(opened: Opened) -> None:
    page, plans = opened.page().page, opened.workspace.plans
    tab(page, "Scan")
    page.get_by_text("Plan", exact=True).click()
    page.get_by_role("button", name="Plan the scan").click()
    waits(page, lambda: plans.map is not None and plans.state.stage == "ready", "the plan")
    page.locator("[data-map]").wait_for()
    assert plans.map is not None

    click_map(page, plans, some_cell(plans.map, FREE))
    page.locator("b", has_text="free, quality").wait_for()
    opened.until(lambda _: visible_bodies(opened.server, "/preview", opened.nominal) != (), "the ghost")
    np.testing.assert_allclose((plans.share, plans.angle / (2 * np.pi)), some_cell(plans.map, FREE), atol=0.01)
    picked = plans.picked
    assert picked is not None
    assert picked.axes is not None
    page.get_by_role("button", name="Go there").click()
    opened.until(lambda state: np.abs(state.joints - picked.axes[:-1]).max() < 1e-5 and not state.moving, "the pose")
    turned = (opened.state.table_angle - picked.axes[-1]) / (2 * np.pi)
    assert turned == pytest.approx(round(turned), abs=1e-6)
    opened.until(
        lambda _: visible_bodies(opened.server, "/preview", opened.nominal) == (), "no ghost where the robot is"
    )

    click_map(page, plans, some_cell(plans.map, CLEARANCE))
    page.locator("b", has_text="forbidden: ").wait_for()
    before = opened.state.joints
    page.get_by_role("button", name="Go there").click()
    opened.until(lambda state: "no collision-free path to the pose in the map" in state.message, "the refusal")
    np.testing.assert_allclose(opened.state.joints, before, atol=1e-6)

    fill(page, "time of the plan, s", 1.0)
    opened.until(lambda _: plans.time == pytest.approx(1.0), "the time")
    page.get_by_role("button", name="Play the plan").click()
    opened.until(lambda _: plans.time > 2.0, "a second of play-back")
    page.get_by_role("button", name="Pause").click()
    opened.until(lambda _: not plans.plays, "the pause")
    np.testing.assert_allclose(opened.state.joints, before, atol=1e-6)  # the ghost alone moves


def test_run_is_opened_and_left_and_the_session_is_recorded(opened: Opened, tmp_path: Path) -> None:
    page = opened.page().page
    page.get_by_role("tab", name="File").click()
    chooser = page.locator("input[type=file]").nth(1)
    chooser.set_input_files({"name": "run.zip", "mimeType": "application/zip", "buffer": b"PK no run"})
    page.locator(".mantine-Notification-root", has_text=re.compile("run.zip: .*expected a zip file")).wait_for()
    assert opened.host.workspace is not None

    chooser.set_input_files({"name": "run.zip", "mimeType": "application/zip", "buffer": zipped_run(tmp_path)})
    back = page.get_by_role("button", name="Back to the cell")
    # The page of a view is there a moment before the view.
    back.wait_for()
    waits(page, lambda: isinstance(opened.host.view, Playback), "the run")
    view = opened.host.view
    assert isinstance(view, Playback)
    fill(page, "time, s", 2.0)
    waits(page, lambda: view.time == pytest.approx(2.0), "the time")
    back.click()
    page.get_by_role("tab", name="File").wait_for()
    waits(page, lambda: opened.host.workspace is not None, "the cell")
    opened.until(lambda state: state.time > 0.2, "the cell")

    page.get_by_role("tab", name="File").click()
    entry(page, "Record (MCAP)").check()
    page.get_by_text("recording: ").wait_for()
    tab(page, "Move")
    fill(page, "speed, %", 2)  # long enough for some records
    fill(page, "joint 1, deg", 5.0)
    opened.until(lambda state: abs(state.joints[0] - np.radians(5.0)) < 1e-6, "joint 1 at 5 deg")
    page.get_by_role("tab", name="File").click()
    entry(page, "Record (MCAP)").uncheck()
    page.get_by_text("recorded: ").wait_for()
    with (tmp_path / "session_1.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    counts = {summary.channels[number].topic: n for number, n in summary.statistics.channel_message_counts.items()}
    assert counts["/joints"] == counts["/tf"] > 2  # begin, motion, end; a loaded machine records fewer states a second
    assert counts["/scene"] == 1


def zipped_run(folder: Path) -> bytes:
    """A small scan as a zip file of its folder."""
    done = scancell_here("scan", PARTS / "free_form.stl", *QUICK, "--out", "run", "--json", cwd=folder)
    assert done.code == 0, done.err
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in (folder / "run").rglob("*"):
            archive.write(path, path.relative_to(folder))
    return made.getvalue()
