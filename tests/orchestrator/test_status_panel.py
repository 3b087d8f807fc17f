"""Texts above the panels: what stopped the robot, and what to do."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from importlib.resources import files
from types import SimpleNamespace
from typing import Any

import pytest
from live_cells import SteppedCell

from chromium import chromium
from scancell import Scanner
from scancell.browser.panels.status import Status, advice, pace, share_done, state_html
from scancell.cell.driver import GUARD_TOO_OLD, Operation
from scancell.config.loading import load_setup
from scancell.guard.guard import Decision, Guard
from scancell.live.scan import LiveScanState
from scancell.live.state import JogSensor, Reset, SetOperation
from scancell.programs.robot import deg, location, mm


@pytest.fixture(scope="module")
def cell() -> Iterator[SteppedCell]:
    with Scanner(setup=load_setup(), threads=1) as scanner, scanner.session(guarded=True) as session:
        yield SteppedCell(session)


def test_stops_and_their_reset_are_stated_in_one_sentence(cell: SteppedCell) -> None:
    """A jog that the guard holds, one that it stops, one away from the bodies, and the stop button."""
    down = JogSensor([0, 0, 0.5, 0, 0, 0])
    cell.at(location(450 * mm, 0, 260 * mm, rx=180 * deg))
    assert advice(cell.live.state) == ""
    cell.live.submit(SetOperation(Operation.MANUAL))
    cell.cycle(30)
    warned = cell.until(lambda state: state.guarded_pair is not None, down)
    held = cell.until(lambda state: state.guard_text.startswith("no jog") and not state.moving, down)
    pair = held.guarded_pair
    assert warned.guarded_pair == pair
    assert pair is not None
    assert "no jog in this direction" in advice(held)
    stop = Decision(True, 1.0, f"stop: {' - '.join(pair)}: 2 mm", True, pair)
    with pytest.MonkeyPatch.context() as patch:  # for a body that was not on the path before
        patch.setattr(Guard, "_by_hand", lambda *_: stop)
        stopped = cell.until(lambda state: state.controller == "emergency stop" and not state.moving, down)
    assert stopped.guarded_pair == pair
    assert stopped.pendant_text == f"Emergency stop: {' - '.join(pair)}: 2 mm"
    sentence = advice(stopped)
    assert sentence.startswith(f"The guard stopped the robot ({pair[0]} and {pair[1]}, ")
    assert "Reset after a stop" in sentence
    assert sentence.count(".") == 1
    cell.cycle(20, Reset())
    assert advice(cell.live.state) == ""
    assert "no jog in this direction" in advice(cell.cycle(30, down))
    assert advice(cell.cycle(30, JogSensor([0, 0, -0.5, 0, 0, 0]))) == ""
    cell.live.emergency_stop()
    assert advice(cell.cycle(60)).startswith("The Stop button stopped the robot")


def test_sentence_is_shown_once_and_escaped(cell: SteppedCell) -> None:
    state = replace(cell.live.state, controller="emergency stop", guard_text="stop: <b> - table: 33 mm", moving=False)
    shown = state_html(state)
    assert shown.count("table") == 1
    assert "&lt;b&gt; and table, 33 mm" in shown
    assert "in force" not in shown


def test_what_is_below_the_state_stays_in_its_place(cell: SteppedCell) -> None:
    """The state has the same height with few lines and with many."""
    state = replace(cell.live.state, moving=False, colliding=(), nearest=None)
    crowded = replace(state, job="a scan", moving=True, controller="emergency stop", nearest=("a", "b", 0.1))
    heights = {
        re.search(r"data-status style=\"height:([\d.]+)em", shown)[1]  # type: ignore[index]
        for shown in (state_html(state), state_html(crowded, "slow simulation: 40% of real time"))
    }
    assert len(heights) == 1


@pytest.mark.parametrize(
    ("moving", "refusal", "parts"),
    [
        (True, "", ("The Stop button", "wait until it is at rest")),
        (False, GUARD_TOO_OLD, ("did not answer in time", "Reset after a stop")),
    ],
)
def test_sentence_names_other_causes(cell: SteppedCell, moving: bool, refusal: str, parts: tuple[str, ...]) -> None:
    stopped = replace(cell.live.state, controller="emergency stop", guard_text="", moving=moving, refusal=refusal)
    assert all(part in advice(stopped) for part in parts)


def test_path_that_the_guard_holds_is_explained(cell: SteppedCell) -> None:
    held = replace(cell.live.state, controller="moving", guard_text="slowed to 0%: sensor - part", moving=True)
    assert "end the motion" in advice(held)
    assert advice(replace(held, guard_text="slowed to 40%: sensor - part")) == ""


# --- pace and connection --------------------------------------------------------------------------------------------


class Texts:
    """Makes texts, and keeps them in their order."""

    def __init__(self) -> None:
        self.made: list[Any] = []

    def add_html(self, content: str, order: float) -> Any:
        self.made.append(SimpleNamespace(content=content, order=order))
        return self.made[-1]

    def add_button(self, _name: str, **_: object) -> Any:
        return SimpleNamespace(on_click=lambda _: None)

    @property
    def all(self) -> str:
        return "".join(text.content for text in self.made)


def test_slow_simulation_is_shown_with_its_rate_and_the_time_left(cell: SteppedCell) -> None:
    """40 % of real time, at which a motion advances by 2 % a second; then real time, at rest."""
    now, texts = SimpleNamespace(time=100.0), Texts()
    status = Status(texts, lambda: None, lambda: now.time)
    state = replace(cell.live.state, moving=True, job=None, guard_text="")

    def shows(seconds: int, rate: float, moving: bool) -> str:
        nonlocal state
        for _ in range(10 * seconds):
            now.time += 0.1
            progress = state.progress + 0.002 if moving else 1.0
            state = replace(state, time=state.time + 0.1 * rate, progress=progress, moving=moving)
            status.show(state)
        return texts.all

    state = replace(state, progress=0.0)
    assert "slow simulation" not in shows(1, 0.4, True)
    shown = shows(9, 0.4, True)
    assert "slow simulation: 40% of real time" in shown
    assert "about 40 s left" in shown
    shown = shows(10, 1.0, False)
    assert "slow simulation" not in shown
    assert "s left" not in shown


def test_time_left_of_a_scan_is_that_of_its_profiles(cell: SteppedCell) -> None:
    scan = LiveScanState("scanning", planned=200, taken=80, sensed=50, points=0, ended_by="")
    moving = replace(cell.live.state, moving=True, progress=0.9)
    assert share_done(moving, scan) == 0.25
    assert share_done(moving, replace(scan, stage="done")) == 0.9
    assert share_done(replace(moving, moving=False), None) == 0.0
    assert pace(1.0, 0.25, 0.05) == "about 15 s left"
    assert pace(None, 0.25, None) == ""


def test_page_without_news_from_the_server_says_so() -> None:
    """The pulse changes, stops, and changes again; the state fades meanwhile."""
    script = files("scancell.browser.panels").joinpath("connection.js").read_text(encoding="utf-8")
    with chromium() as browser:
        page = browser.new_page()
        page.clock.install()
        page.set_content('<span data-pulse="1"></span><div data-status="">at rest</div>')
        page.evaluate(script)
        banner, status = page.get_by_role("alert"), page.locator("[data-status]")
        for pulse in range(6):
            page.evaluate("n => { document.querySelector('[data-pulse]').dataset.pulse = n; }", pulse)
            page.clock.run_for(2000)
            assert banner.is_hidden()
        page.clock.fast_forward(60_000)  # the page itself was busy
        assert banner.is_hidden()
        page.clock.run_for(6000)
        assert "Connection lost" in banner.inner_text()
        assert float(status.evaluate("one => getComputedStyle(one).opacity")) < 0.5
        page.evaluate("document.querySelector('[data-pulse]').dataset.pulse = 'new'")
        page.clock.run_for(1000)
        assert banner.is_hidden()
        assert float(status.evaluate("one => getComputedStyle(one).opacity")) == 1.0
