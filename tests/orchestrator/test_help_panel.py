"""Help of the workspace: the tour ticks itself off, and the keys exist."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.resources import files
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from scancell.browser.panels.help import KEYS, HelpPanel, checklist_html
from scancell.cell.driver import Operation


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
        self.taught = SimpleNamespace(path=Path("taught.py"), count=0)
        self.program = SimpleNamespace(state=None)
        workspace: Any = (self.feed, self.scans, self.taught, self.program)
        self.panel = HelpPanel(self.gui, *workspace, self.state(), np.array([0.45, 0.0, 0.25]))

    def state(self, **changes: Any) -> Any:
        values = {
            "joints": np.zeros(6),
            "controller": "at rest",
            "guard_text": "",
            "operation": Operation.MANUAL,
            "moving": False,
            "time": 0.0,
        }
        return SimpleNamespace(**values | changes)

    def done(self, **changes: Any) -> int:
        self.panel.show(self.state(**changes))
        found = re.search(r"(\d) of 9 steps done", self.gui.texts[-1].content)
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
    assert "<b>2 of 9</b> Move, Pose" in rig.panel.next_step
    for nothing_or_elsewhere in (np.zeros((0, 3)), np.zeros((5, 3))):
        rig.feed.frame = SimpleNamespace(points_in_base=nothing_or_elsewhere, time=1.0)
        assert rig.done() == 1
    rig.feed.frame = SimpleNamespace(points_in_base=np.full((5, 3), [0.45, 0.01, 0.13]), time=1.0)
    assert rig.done(moving=True, time=2.0) == 1
    assert rig.done(time=3.0) == 1  # the frame is older than the motion
    rig.feed.frame.time = 2.5
    assert rig.done(time=3.0) == 2
    assert rig.done(controller="emergency stop") == 2  # by the button
    assert rig.done(guard_text="slowed: sensor - table: 12 mm") == 2
    assert rig.done(guard_text="no jog: sensor - table: 3 mm") == 3
    assert rig.done(controller="emergency stop") == 3
    assert rig.done() == 3  # still where the guard held it
    assert rig.done(joints=np.full(6, 0.1)) == 4
    rig.feed.as_built = ("sensor.laser.turn_z_deg=1",)
    rig.scans.lack = ""
    assert rig.done() == 6
    rig.scans.saved = "scan_1"
    assert rig.done() == 7
    rig.taught.count = 2
    assert rig.done() == 8
    rig.program.state = SimpleNamespace(file=Path("other.py"), stage="done")
    assert rig.done() == 8
    rig.program.state = SimpleNamespace(file=rig.taught.path, stage="done")
    assert rig.done() == 9
    assert rig.panel.next_step == ""


def test_profile_at_the_start_does_not_tick_off_the_way_back_over_the_part(rig: Rig) -> None:
    rig.feed.frame = SimpleNamespace(points_in_base=np.full((5, 3), [0.45, 0.01, 0.13]), time=1.0)
    assert rig.done() == 0
    assert "<b>1 of 9</b> Move, Joints" in rig.panel.next_step


@pytest.mark.parametrize("text", ["no jog: sensor - table: 3 mm", "stop: sensor - table: 33 mm"])
def test_guard_that_holds_a_jog_is_noticed(rig: Rig, text: str) -> None:
    rig.done(joints=np.full(6, 0.1))
    assert rig.done(guard_text=text) == 2
    assert rig.done(guard_text=text, operation=Operation.AUTOMATIC) == 2
    assert rig.done(joints=np.full(6, 0.1)) == 3


def test_next_step_is_bold() -> None:
    shown = checklist_html("Tour", "steps", ["<one>", "two", "three"], [True, False, False])
    assert "<b>two</b>" in shown
    assert "<b>three</b>" not in shown
    assert "&lt;one&gt;" in shown


def test_listed_keys_are_those_of_the_page() -> None:
    script = files("scancell.browser.panels").joinpath("keys.js").read_text(encoding="utf-8")
    assert set(KEYS) == {"Escape", "J, K", "1 to 9", "Ctrl+K"}
    assert '"escape"' in script
    for key in "jk":
        assert re.search(rf'\b{key}: "Hold to jog', script)
