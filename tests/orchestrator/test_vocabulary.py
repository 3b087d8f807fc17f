"""One vocabulary: sessions, robot programs and live cells have the same names and parameters for the same commands."""

from __future__ import annotations

import inspect
import re
from dataclasses import fields
from itertools import combinations

import pytest

from scancell.live import state
from scancell.live.cell import LiveCell
from scancell.live.state import LiveState
from scancell.programs.robot import Robot
from scancell.programs.taught import COMMANDS as TAUGHT
from scancell.scanning.session import ScanSession

FACES = (ScanSession, Robot, LiveCell)


# Without `Cancel`, which cancels jobs; a session has none.
COMMANDS = {
    name: make
    for name, make in vars(state).items()
    if inspect.isfunction(make) and name[0].isupper() and make is not state.Cancel
}


def public(owner: type) -> dict[str, object]:
    return {name: getattr(owner, name) for name in dir(owner) if not name.startswith("_")}


def parameters(function: object) -> list[inspect.Parameter]:
    """All but self."""
    return list(inspect.signature(function).parameters.values())[1:]  # type: ignore[arg-type]


def shared() -> list[tuple[type, type, str]]:
    return [(a, b, name) for a, b in combinations(FACES, 2) for name in sorted({*public(a)} & {*public(b)})]


@pytest.mark.parametrize(("first", "second", "name"), shared())
def test_shared_name_has_same_leading_parameters(first: type, second: type, name: str) -> None:
    one, other = public(first)[name], public(second)[name]
    assert isinstance(one, property) == isinstance(other, property)
    if isinstance(one, property):
        return
    positional = [
        [each.name for each in parameters(function) if each.kind is each.POSITIONAL_OR_KEYWORD]
        for function in (one, other)
    ]
    least = min(map(len, positional))
    assert positional[0][:least] == positional[1][:least]
    longer = max((one, other), key=lambda function: len(parameters(function)))
    assert all(each.default is not each.empty for each in parameters(longer)[least:])


def test_every_command_of_a_program_is_a_command_of_the_session() -> None:
    own = {"approach", "depart", "move_home", "save", "set_speed", "set_tool", "wait_for_presence"}
    assert {*public(Robot)} - {*public(ScanSession)} == own


def test_taught_commands_are_those_of_robot_programs() -> None:
    for name, arguments in TAUGHT.items():
        names = [each.name for each in parameters(public(Robot)[name])]
        assert not arguments.value or names[-1] == arguments.value
        assert len(names) == (arguments.point is not None) + (arguments.value != "") + arguments.of_axis


@pytest.mark.parametrize("name", COMMANDS)
def test_command_of_operator_is_named_like_that_of_session(name: str) -> None:
    method = public(ScanSession)[re.sub(r"(?<!^)(?=[A-Z])", "_", name).lower()]
    expected = [each.name for each in parameters(method)]
    names = list(inspect.signature(COMMANDS[name]).parameters)
    assert [each for each in expected if each in names] == names


def test_readings_of_live_cell_are_named_like_those_of_session() -> None:
    readings = {
        "time",
        "joints",
        "table_angle",
        "destination",
        "presence",
        "distance",
        "gripper_width",
        "monitor_speed",
    }
    assert readings <= {field.name for field in fields(LiveState)}
    assert readings <= {*public(ScanSession)}
