"""Texts above the panels: what stopped the robot, and what to do."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import pytest
from live_cells import SteppedCell

from scancell import Scanner
from scancell.browser.panels.status import advice, state_html
from scancell.cell.controller import GUARD_TOO_OLD, Operation
from scancell.config.loading import load_setup
from scancell.live.commands import JogSensor, Reset, SetOperation
from scancell.programs.robot import deg, location, mm


@pytest.fixture(scope="module")
def cell() -> Iterator[SteppedCell]:
    with Scanner(setup=load_setup(), threads=1) as scanner, scanner.session(guarded=True) as session:
        yield SteppedCell(session)


def test_stops_and_their_reset_are_stated_in_one_sentence(cell: SteppedCell) -> None:
    """A jog that the guard stops, one that it rejects, one away from the bodies, and the stop button."""
    down = JogSensor([0, 0, 0.5, 0, 0, 0])
    cell.at(location(450 * mm, 0, 260 * mm, rx=180 * deg))
    assert advice(cell.live.state) == ""
    cell.live.submit(SetOperation(Operation.MANUAL))
    cell.cycle(30)
    warned = cell.until(lambda state: state.guarded_pair is not None, down)
    stopped = cell.until(lambda state: state.controller == "emergency stop" and not state.moving, down)
    pair = stopped.guarded_pair
    assert warned.guarded_pair == pair
    assert pair is not None
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
