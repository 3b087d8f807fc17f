"""One vocabulary: sessions, robot programs and live cells have the same names and parameters for the same commands."""

from __future__ import annotations

import inspect
from dataclasses import fields, is_dataclass
from itertools import combinations

import pytest

from scancell.live.cell import LiveCell
from scancell.live.commands import Cancel, Command
from scancell.live.state import LiveState
from scancell.programs.robot import Robot
from scancell.scanning.session import ScanSession

FACES = (ScanSession, Robot, LiveCell)


def concrete(command: type) -> set[type]:
    """The commands below a class."""
    own = set() if inspect.isabstract(command) or not is_dataclass(command) else {command}
    return own.union(*map(concrete, command.__subclasses__()))


# Without `Cancel`, which cancels jobs; a session has none.
COMMANDS = sorted(concrete(Command) - {Cancel}, key=lambda command: command.__name__)


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


@pytest.mark.parametrize("command", COMMANDS)
def test_command_of_operator_is_named_like_that_of_session(command: type) -> None:
    method = public(ScanSession)[object.__new__(command).name]
    expected = [each.name for each in parameters(method)]
    names = [field.name for field in fields(command)]
    assert [name for name in expected if name in names] == names


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
