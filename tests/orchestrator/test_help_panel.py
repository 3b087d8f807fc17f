"""Help of the workspace: the tour ticks itself off, and the keys exist."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.resources import files
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from scancell.browser.panels.help import KEYS, HelpPanel, tour_html
from scancell.cell.controller import Operation


class Gui:
    """Makes texts."""

    def __init__(self) -> None:
        self.texts: list[Any] = []

    @contextmanager
    def add_folder(self, *_: object, **__: object) -> Iterator[None]:
        yield

    def add_html(self, content: str) -> Any:
        self.texts.append(SimpleNamespace(content=content))
        return self.texts[-1]


class Rig:
    """A workspace whose state a test sets."""

    def __init__(self) -> None:
        self.gui = Gui()
        self.feed = SimpleNamespace(as_built=(), frame=None)
        self.scans = SimpleNamespace(lack="there is no finished scan", saved=None)
        self.panel = HelpPanel(self.gui, self.feed, self.scans, self.state())  # type: ignore[arg-type]

    def state(self, **changes: Any) -> Any:
        values = {"joints": np.zeros(6), "controller": "at rest", "guard_text": "", "operation": Operation.MANUAL}
        return SimpleNamespace(**values | changes)

    def done(self, **changes: Any) -> int:
        self.panel.show(self.state(**changes))
        found = re.search(r"(\d) of 7 steps done", self.gui.texts[-1].content)
        assert found is not None
        return int(found[1])


@pytest.fixture
def rig() -> Rig:
    return Rig()


def test_steps_are_ticked_off_when_they_are_done_and_stay_so(rig: Rig) -> None:
    assert rig.done() == 0
    assert rig.done(joints=np.full(6, 0.001)) == 0
    assert rig.done(joints=np.full(6, 0.1)) == 1
    assert rig.done() == 1
    rig.feed.frame = SimpleNamespace(points_in_sensor=np.zeros((0, 3)))
    assert rig.done() == 1
    rig.feed.frame = SimpleNamespace(points_in_sensor=np.zeros((5, 3)))
    assert rig.done() == 2
    stopped = {"controller": "emergency stop", "guard_text": "stop: sensor - table: 33 mm"}
    assert rig.done(controller="emergency stop") == 2  # by the button
    assert rig.done(**stopped) == 3
    assert rig.done(guard_text="no jog: sensor - table: 33 mm") == 3
    assert rig.done() == 4
    rig.feed.as_built = ("sensor.laser.turn_z_deg=1",)
    rig.scans.lack = ""
    assert rig.done() == 6
    rig.scans.saved = "scan_1"
    assert rig.done() == 7


def test_next_step_is_bold() -> None:
    shown = tour_html(["<one>", "two", "three"], [True, False, False])
    assert "<b>two</b>" in shown
    assert "<b>three</b>" not in shown
    assert "&lt;one&gt;" in shown


def test_listed_keys_are_those_of_the_page() -> None:
    script = files("scancell.browser.panels").joinpath("keys.js").read_text(encoding="utf-8")
    assert set(KEYS) == {"Escape", "J, K", "1 to 9", "Ctrl+K"}
    assert '"escape"' in script
    for key in "jk":
        assert re.search(rf'\b{key}: "Hold to jog', script)
