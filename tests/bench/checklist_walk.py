"""Walk of a newcomer through the tour of the workspace: ``python -m bench.checklist_walk``.

The newcomer knows nothing but what the page shows. It reads the steps of the tour, opens the tabs that they name, reads
their help, and uses the visible inputs whose labels share words with the step, the most similar ones first. Printed
are the number of clicks and entries for each step, and every step that could not be done: a dead end.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from playwright.sync_api import TimeoutError as PageTimeoutError

from chromium import Watched, chromium
from scancell import Scanner
from scancell.browser.server.gate import address
from scancell.browser.server.workspace import WorkspaceSettings
from scancell.config.loading import load_setup
from tour import PART, choose, entry, fill, hosted, tab

_FOLDER = "Keys and tour"
_DONE, _OPEN = "\u2611", "\u2610"
_POLL_MS, _PATIENCE_MS, _MOST_MS = 500, 20_000, 240_000
_BUSY = ("waiting", "planning", "approaching", "scanning", "sensing", "running")  # stages of scans and programs
_STEP = 10.0  # added to a number
_MOST = 6  # inputs that are tried for a step
_TRIPLE = re.compile(r"(-?[\d.]+), (-?[\d.]+),? (?:and )?(-?[\d.]+)\s*(mm|°)?")
_COMMON = frozenset({"the", "a", "an", "to", "of", "and", "until", "at", "with", "this", "for", "deg", "mm", "about"})


def words(text: str) -> set[str]:
    """Words of a text without case, endings and common words."""
    found = re.findall(r"[a-z]+|\d+", text.lower())
    return {word.removesuffix("s") for word in found} - _COMMON


@dataclass(frozen=True)
class Control:
    """A visible input."""

    kind: str  # button or label
    name: str

    def similarity(self, text: str) -> float:
        """Words that the name shares with a text, less for longer names."""
        own = words(self.name)
        return len(own & words(text)) - 0.1 * len(own - words(text)) if own else 0.0


class Newcomer:
    """Walks the tour on a page."""

    def __init__(self, page: Any) -> None:
        self._page, self.count = page, 0
        self.dead_ends: list[str] = []

    def walk(self) -> None:
        """Do each step of the tour, and print what it took."""
        self._click(self._page.get_by_text(_FOLDER, exact=True))
        for number in range(len(self._tour())):
            before, (text, is_done) = self.count, self._tour()[number]
            done = is_done or self._does(text, number)
            if not done:
                self.dead_ends.append(text)
            print(f"{'done' if done else 'DEAD END':9} {self.count - before:3} acts: {text}", flush=True)
            if not done:
                print(f"The page shows: {self._shown()}", flush=True)

    def _tour(self) -> list[tuple[str, bool]]:
        """The steps that the page shows, and whether they are ticked off."""
        shown = self._page.get_by_text(re.compile(r"\d of \d+ steps done")).last
        shown.wait_for()
        lines = shown.inner_text().splitlines()
        return [(line[1:].strip(), line[0] == _DONE) for line in lines if line[:1] in (_DONE, _OPEN)]

    def _does(self, text: str, number: int) -> bool:
        place, _, instruction = text.rpartition(":")
        if not self._opens(place):
            return False
        hints = f"{instruction} {self._help()}"
        self._chooses(instruction)
        self._types_triples(hints)
        times = 2 if "two" in words(instruction) else 1
        for control in self._candidates(instruction):
            for _ in range(times):
                self._uses(control)
            if self._is_ticked(number):
                return True
        return False

    def _opens(self, place: str) -> bool:
        """Open the tabs that the step names, one in another."""
        for name in filter(None, place.split(", ")):
            tabs = self._page.get_by_role("tab", name=name, exact=True).locator("visible=true")
            if not tabs.count():
                return False
            tab(self._page, name)
            self.count += 1
        return True

    def _shown(self) -> str:
        """Text of the open tab, in a line."""
        panel = self._page.get_by_role("tabpanel").locator("visible=true").last
        return ", ".join(panel.inner_text().split("\n"))

    def _help(self) -> str:
        """Texts of the help of the open tab."""
        folder = self._page.get_by_text("Help", exact=True).locator("visible=true")
        if not folder.count():
            return ""
        self._click(folder.last)
        return str(folder.last.locator("xpath=ancestor::*[4]").inner_text())

    def _candidates(self, instruction: str) -> list[Control]:
        rated = [(control.similarity(instruction), control) for control in self._controls()]
        chosen = [control for rating, control in sorted(rated, key=lambda one: -one[0]) if rating > 0]
        return chosen[:_MOST]

    def _controls(self) -> Iterator[Control]:
        for kind, found in (("button", self._page.get_by_role("button")), ("label", self._page.locator("label"))):
            for name in dict.fromkeys(found.locator("visible=true").all_inner_texts()):
                if name.strip():
                    yield Control(kind, name.strip())

    def _uses(self, control: Control) -> None:
        """Press a button, hold one that says so, or change a number."""
        if control.kind == "button":
            button = self._page.get_by_role("button", name=control.name, exact=True).locator("visible=true").first
            if button.is_enabled():
                self._holds(button) if control.name.startswith("Hold") else self._click(button)
            return
        field = entry(self._page, control.name)
        value = field.input_value()
        self.count += 1
        if re.fullmatch(r"-?[\d.]+", value):
            fill(self._page, control.name, float(value) + _STEP)

    def _chooses(self, instruction: str) -> None:
        """Choose the options of lists that the step names; the longest where it names several."""
        for control in self._controls():
            field = entry(self._page, control.name) if control.kind == "label" else None
            if field is None or not field.count() or field.get_attribute("aria-haspopup") != "listbox":
                continue
            field.click()
            options = self._page.get_by_role("option").all_inner_texts()
            field.blur()  # closes the list; the Escape key would stop the robot
            named = [option for option in options if re.search(rf"\b{re.escape(option)}\b", instruction)]
            if named:
                choose(self._page, control.name, max(named, key=len))
                self.count += 1

    def _types_triples(self, hints: str) -> None:
        """Type the positions and angles that the page states into the inputs with their units."""
        for *values, unit in _TRIPLE.findall(hints):
            wanted = "mm" if unit == "mm" else "angles, deg"
            names = [one.name for one in self._controls() if one.kind == "label" and one.name.endswith(wanted)]
            for name in names:
                if entry(self._page, name, 2).count():
                    for place, value in enumerate(values):
                        fill(self._page, name, float(value), place)
                        self.count += 1

    def _holds(self, button: Any) -> None:
        """Hold a button until the page speaks of the guard, or nothing moves for a while."""
        button.hover()
        self._page.mouse.down()
        self.count += 1
        guard = self._page.get_by_text("The guard permits no jog").first
        with suppress(PageTimeoutError):
            guard.wait_for(timeout=_PATIENCE_MS)
        self._page.mouse.up()

    def _is_busy(self) -> bool:
        return any(self._page.get_by_text(word, exact=True).count() for word in _BUSY)

    def _is_ticked(self, number: int) -> bool:
        """Wait until the step is ticked off; end when nothing has gone on for a while."""
        waited_ms = idle_ms = 0
        while idle_ms < _PATIENCE_MS and waited_ms < _MOST_MS:
            if self._tour()[number][1]:
                return True
            self._page.wait_for_timeout(_POLL_MS)
            waited_ms += _POLL_MS
            idle_ms = 0 if self._is_busy() else idle_ms + _POLL_MS
        return False

    def _click(self, target: Any) -> None:
        target.click()
        self.count += 1


def main() -> None:
    """Walk, and print the result."""
    setup = load_setup(settings=["scan.max_profiles=120", "scan.sweep.enabled=false"])
    with (
        tempfile.TemporaryDirectory() as out,
        Scanner(setup=setup) as scanner,
        chromium() as browser,
        hosted(scanner, PART, WorkspaceSettings(Path(out), "geometric")) as (_, server),
    ):
        watched = Watched(browser, 1280, 900, sharpness=0.0)
        watched.opens(address(server))
        newcomer = Newcomer(watched.page)
        newcomer.walk()
    print(f"{newcomer.count} acts, {len(newcomer.dead_ends)} dead ends")


if __name__ == "__main__":
    main()
