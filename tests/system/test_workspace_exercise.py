"""An exercise in a browser: the panel shows the task, takes figures and saves the sheet."""

from __future__ import annotations

import re
from pathlib import Path

from chromium import Watched, chromium
from scancell import Scanner
from scancell.browser.server.gate import address
from scancell.browser.server.workspace import WorkspaceSettings
from scancell.config.loading import load_setup
from scancell.exercises import find_exercise
from tour import entry, fill, hosted, press, says


def test_student_opens_an_exercise_types_figures_and_saves_the_sheet(tmp_path: Path) -> None:
    """Solutions are tested without a browser in test_exercises."""
    exercise = find_exercise("sensors")
    settings = WorkspaceSettings(tmp_path, "geometric", exercise=exercise)
    with (
        Scanner(setup=load_setup(exercise.cell_file)) as scanner,
        chromium() as browser,
        hosted(scanner, exercise.part_file, settings) as (_, server),
    ):
        watched = Watched(browser, 1280, 900, sharpness=0.0)
        watched.opens(address(server))
        page = watched.page
        says(page, exercise.task)
        says(page, "0 of 4 items done")
        fill(page, "height of the part, mm", 1.0)
        entry(page, "your name").fill("Ada <Lovelace>")
        entry(page, "file").fill("ada")
        press(page, "Save result")
        says(page, f"saved: {tmp_path / 'ada.html'}")
        sheet = browser.new_page()
        sheet.goto((tmp_path / "ada.html").as_uri())
        text = sheet.locator("body").inner_text()
    assert watched.errors == []
    assert "Ada <Lovelace>" in text
    assert re.search(r"result\s+not passed", text)
