"""An exercise in a browser: the panel shows the task, ticks items off, takes figures and saves the sheet."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from chromium import Watched, chromium
from scancell import Scanner
from scancell.browser.server.quiet import address
from scancell.browser.server.workspace import WorkspaceSettings
from scancell.config.loading import load_setup
from scancell.exercises.catalogue import find_exercise
from tour import entry, fill, hosted, press, says, tab

SOLUTION = Path(__file__).parents[2] / "docs" / "examples" / "exercises" / "sensors.py"


@pytest.mark.slow
def test_student_solves_an_exercise_and_saves_the_sheet(tmp_path: Path) -> None:
    exercise = find_exercise("sensors")
    settings = WorkspaceSettings(tmp_path, "geometric", SOLUTION, exercise)
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
        tab(page, "Program")
        press(page, "Run the program")
        page.locator("b", has_text=re.compile("^sensors.py: done$")).wait_for()
        length, height = re.findall("length ([0-9.]+) mm, height ([0-9.]+) mm", page.content())[0]
        tab(page, "Exercise")
        says(page, "2 of 4 items done")
        fill(page, "length of the part along the belt, mm", float(length))
        fill(page, "height of the part, mm", float(height) + 1)
        says(page, "3 of 4 items done")
        fill(page, "height of the part, mm", float(height))
        says(page, "4 of 4 items done")
        entry(page, "your name").fill("Ada <Lovelace>")
        entry(page, "file").fill("ada")
        press(page, "Save result")
        says(page, f"saved: {tmp_path / 'ada.html'}")
        sheet = browser.new_page()
        sheet.goto((tmp_path / "ada.html").as_uri())
        text = sheet.locator("body").inner_text()
        press(page, "Start again")
        says(page, "0 of 4 items done")
    assert watched.errors == []
    assert "Ada <Lovelace>" in text
    assert re.search(r"result\s+passed", text)
    assert "not passed" not in text
