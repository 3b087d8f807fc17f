"""Messages by category: what is heard with logging on, off and filtered."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest
from cell_fixture import START_DEG, Build, CellFmu

OK, WARNING, ERROR = 0, 1, 3


def live(cell: CellFmu) -> None:
    """Exposures, and a joint that a limit keeps from its set-point."""
    cell.command(np.radians(START_DEG) + np.array([0, 0, 0, 0, 0, 50.0]), table=1.0)
    cell.trigger(1, 0.05)
    cell.step(16_000, 20)


def offend(cell: CellFmu) -> None:
    """A call that is refused."""
    with contextlib.suppress(Exception):
        cell.slave.doStep(-5.0, 0.001)


@pytest.mark.parametrize("version", [2, 3])
def test_with_logging_off_errors_alone_are_heard(build: Build, version: int) -> None:
    cell = build(version)
    live(cell)
    assert cell.messages == []
    offend(cell)
    assert cell.log == [(ERROR, "logStatusError")]
    assert "is not where the last step ended" in cell.messages[0]


@pytest.mark.parametrize("version", [2, 3])
def test_with_logging_on_events_are_heard(build: Build, version: int) -> None:
    cell = build(version, loggingOn=True)
    live(cell)
    cell.slave.terminate()
    assert set(cell.log) == {(OK, "logEvents")}
    said = "\n".join(cell.messages)
    for words in ("cell is made from", "exposure 1, whose middle", "a limit keeps axis 6", "terminated at 0.32"):
        assert said.count(words) == 1, words
    exposures = [m for m in cell.messages if m.startswith("exposure ")]
    assert len(exposures) == cell.get_int("trigger.index")


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize(
    ("categories", "heard"),
    [
        (["logStatusError"], set()),
        (["logStatusWarning"], set()),
        (["logEvents"], {"logEvents"}),
        (["logStatusError", "logEvents"], {"logEvents"}),
        (["logAll"], {"logEvents"}),
        ([], {"logEvents"}),
    ],
)
def test_categories_are_switched_on_one_by_one(
    build: Build, version: int, categories: list[str], heard: set[str]
) -> None:
    cell = build(version)
    cell.slave.setDebugLogging(True, categories)
    live(cell)
    assert {category for _, category in cell.log} == heard
    offend(cell)
    assert cell.log[-1] == (ERROR, "logStatusError")


@pytest.mark.parametrize(
    ("version", "on", "categories", "heard"),
    [
        (2, False, [], False),
        (2, False, ["logStatusWarning"], False),  # FMI 2: off is off, whatever the categories
        (2, True, ["logStatusWarning"], False),  # only those that are named
        (3, False, [], False),
        (3, False, ["logAll"], False),
        (3, False, ["logEvents"], False),
        (3, False, ["logStatusWarning"], True),  # FMI 3: the switch is that of the named ones
        (3, True, ["logStatusWarning"], True),
    ],
)
def test_switching_follows_the_version(
    build: Build, version: int, on: bool, categories: list[str], heard: bool
) -> None:
    cell = build(version, loggingOn=True)
    cell.log.clear()
    cell.slave.setDebugLogging(on, categories)
    live(cell)
    assert any(category == "logEvents" for _, category in cell.log) == heard
    offend(cell)
    assert cell.log[-1] == (ERROR, "logStatusError")


@pytest.mark.parametrize("version", [2, 3])
def test_an_unknown_category_is_a_warning(build: Build, version: int) -> None:
    """What is known among the names counts, and the instance goes on."""
    cell = build(version)
    cell.slave.setDebugLogging(True, ["logStatusWarning", "logNothing%s", "logEvents"])
    assert cell.log == [(WARNING, "logStatusWarning")]
    assert "logNothing%" in cell.messages[0]
    live(cell)
    assert "logEvents" in {category for _, category in cell.log}


@pytest.mark.parametrize("version", [2, 3])
def test_the_description_names_the_categories(build: Build, version: int) -> None:
    cell = build(version)
    named = [category.name for category in cell.description.logCategories]
    assert named == ["logStatusError", "logStatusWarning", "logEvents", "logAll"]
