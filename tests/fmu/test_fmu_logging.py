"""Log messages by category, with logging on, off and filtered."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest
from cell_fixture import START, Build, CellFmu

OK, WARNING, ERROR = 0, 1, 3


def run_scan(cell: CellFmu) -> None:
    """Fire exposures, and command a joint beyond its limit."""
    cell.command(START + np.array([0, 0, 0, 0, 0, 50.0]), table=1.0)
    cell.trigger(1, 0.05)
    cell.step(16_000, 20)


def make_illegal_call(cell: CellFmu) -> None:
    """Make an illegal call."""
    with contextlib.suppress(Exception):
        cell.slave.doStep(-5.0, 0.001)


@pytest.mark.parametrize("version", [2, 3])
def test_only_errors_are_logged_with_logging_off(build: Build, version: int) -> None:
    cell = build(version)
    run_scan(cell)
    assert cell.messages == []
    make_illegal_call(cell)
    assert cell.log == [(ERROR, "logStatusError")]
    assert "differs from the end of the last step" in cell.messages[0]


@pytest.mark.parametrize("version", [2, 3])
def test_events_are_logged_with_logging_on(build: Build, version: int) -> None:
    cell = build(version, loggingOn=True)
    run_scan(cell)
    cell.slave.terminate()
    assert set(cell.log) == {(OK, "logEvents")}
    text = "\n".join(cell.messages)
    for words in ("cell loaded from", "record of exposure 1 ", "axis 6 is at a limit", "terminated at 0.32"):
        assert text.count(words) == 1, words
    exposures = [m for m in cell.messages if m.startswith("record of exposure ")]
    assert len(exposures) == cell.get_int("trigger.index")


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize(
    ("categories", "logged"),
    [
        (["logStatusError"], set()),
        (["logStatusWarning"], set()),
        (["logEvents"], {"logEvents"}),
        (["logStatusError", "logEvents"], {"logEvents"}),
        (["logAll"], {"logEvents"}),
        ([], {"logEvents"}),
    ],
)
def test_log_categories_are_selected(build: Build, version: int, categories: list[str], logged: set[str]) -> None:
    cell = build(version)
    cell.slave.setDebugLogging(True, categories)
    run_scan(cell)
    assert {category for _, category in cell.log} == logged
    make_illegal_call(cell)
    assert cell.log[-1] == (ERROR, "logStatusError")


@pytest.mark.parametrize(
    ("version", "on", "categories", "logged"),
    [
        (2, False, [], False),
        (2, False, ["logStatusWarning"], False),  # FMI 2: off applies to all categories
        (2, True, ["logStatusWarning"], False),  # only the named categories
        (3, False, [], False),
        (3, False, ["logAll"], False),
        (3, False, ["logEvents"], False),
        (3, False, ["logStatusWarning"], True),  # FMI 3: the switch applies to the named categories
        (3, True, ["logStatusWarning"], True),
    ],
)
def test_set_debug_logging_follows_fmi_version(
    build: Build, version: int, on: bool, categories: list[str], logged: bool
) -> None:
    cell = build(version, loggingOn=True)
    cell.log.clear()
    cell.slave.setDebugLogging(on, categories)
    run_scan(cell)
    assert any(category == "logEvents" for _, category in cell.log) == logged
    make_illegal_call(cell)
    assert cell.log[-1] == (ERROR, "logStatusError")


@pytest.mark.parametrize("version", [2, 3])
def test_unknown_log_category_is_a_warning(build: Build, version: int) -> None:
    """Known names are applied, and the instance continues."""
    cell = build(version)
    cell.slave.setDebugLogging(True, ["logStatusWarning", "logNothing%s", "logEvents"])
    assert cell.log == [(WARNING, "logStatusWarning")]
    assert "logNothing%" in cell.messages[0]
    run_scan(cell)
    assert "logEvents" in {category for _, category in cell.log}


@pytest.mark.parametrize("version", [2, 3])
def test_model_description_lists_log_categories(build: Build, version: int) -> None:
    cell = build(version)
    named = [category.name for category in cell.description.logCategories]
    assert named == ["logStatusError", "logStatusWarning", "logEvents", "logAll"]
