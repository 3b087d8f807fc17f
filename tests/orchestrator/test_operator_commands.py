"""Commands of one browser, without a browser: operator, operation that a command needs, and messages."""

from __future__ import annotations

import io
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image

from scancell.browser.panels.operator_commands import OTHER_OPERATOR, OperatorCommands, can_end, can_jog, can_move
from scancell.browser.server.gate import Operators
from scancell.cell.driver import Operation
from scancell.live.state import Cancel, Command, JogJoints, MoveJoints, SetOperation

JOG, MOVE = JogJoints([0.5]), MoveJoints([0.0] * 6)


class Rig:
    """The browser with number 1, a cell in automatic operation, and a clock that is set."""

    def __init__(self) -> None:
        self.submitted: list[Command] = []
        self.messages: list[str] = []
        self.time = 0.0
        self.state = SimpleNamespace(operation=Operation.AUTOMATIC, moving=False)
        self.operators = Operators()
        self.operators.join(1)
        self.operators.join(2)
        client: Any = SimpleNamespace(
            client_id=1,
            add_notification=lambda _title, text, **_options: self.messages.append(text),
            get_render=lambda height, width, **_options: self.draws(height, width),
        )
        live: Any = SimpleNamespace(state=self.state, submit=self.submitted.append)
        session: Any = SimpleNamespace(nominal=None)
        self.commands = OperatorCommands(client, self.operators, live, session, lambda: self.time)

    def draws(self, height: int, width: int) -> np.ndarray:
        """The scene as the browser draws it; a second picture is asked for meanwhile."""
        self.enter_picture()
        return np.full((height, width, 3), (10, 20, 30), np.uint8)

    def enter_picture(self) -> None:
        self.commands.callback(self.commands.picture)(SimpleNamespace(client=object()))

    def enter(self, command: Command) -> None:
        """As input of the user."""
        self.commands.callback(lambda: self.commands.submit(command))(SimpleNamespace(client=object()))


def contents(commands: list[Command]) -> list[tuple[str, Any]]:
    """Names and arguments of commands."""
    return [(command.name, command.arguments) for command in commands]


@pytest.fixture
def rig() -> Rig:
    return Rig()


def test_motion_changes_operation_at_rest(rig: Rig) -> None:
    rig.enter(JOG)
    assert contents(rig.submitted) == contents([SetOperation(Operation.MANUAL), JOG])
    rig.state.operation = Operation.MANUAL
    rig.enter(JOG)
    assert rig.submitted[2:] == [JOG]
    rig.enter(MOVE)
    assert contents(rig.submitted[3:]) == contents([SetOperation(Operation.AUTOMATIC), MOVE])
    assert not rig.messages


@pytest.mark.parametrize(
    ("operation", "command"), [(Operation.AUTOMATIC, JOG), (Operation.MANUAL, MOVE)], ids=["jog", "move"]
)
def test_motion_that_needs_other_operation_is_rejected_with_message_while_robot_moves(
    rig: Rig, operation: Operation, command: Command
) -> None:
    rig.state.operation, rig.state.moving = operation, True
    rig.enter(command)
    assert not rig.submitted
    (message,) = rig.messages
    assert f"moves in {operation.name.lower()} operation" in message
    rig.enter(Cancel())
    assert contents(rig.submitted) == contents([Cancel()])


def test_repeated_message_is_shown_again_after_it_has_disappeared(rig: Rig) -> None:
    rig.state.moving = True
    for rig.time in (0.0, 0.1, 0.2):
        rig.enter(JOG)
    assert len(rig.messages) == 1
    rig.time = 60.0
    rig.enter(JOG)
    assert len(rig.messages) == 2


def test_browser_without_control_submits_nothing(rig: Rig) -> None:
    rig.operators.take(2)
    rig.enter(MOVE)
    assert not rig.submitted
    assert "take control first" in rig.messages[0]
    rig.commands.take_control()
    rig.enter(MOVE)
    assert rig.submitted == [MOVE]


def test_inputs_that_cannot_work_are_disabled_and_their_hints_state_why(rig: Rig) -> None:
    """Without its operator a browser may use the inputs that are for all."""
    move, download, text = (SimpleNamespace(disabled=False, hint=hint) for hint in ("or the key J", None, None))
    finished: list[str] = []
    rig.commands.add_inputs([move], can_move)
    rig.commands.add_inputs([download], lambda _: "" if finished else "there is no finished scan", by_all=True)
    rig.commands.add_inputs([text])

    def shown(**state: Any) -> list[tuple[bool, str | None]]:
        rig.commands.enable_inputs(SimpleNamespace(**{"controller": "at rest", "job": None, **state}))
        return [(handle.disabled, handle.hint) for handle in (move, download, text)]

    missing = (True, "there is no finished scan")
    assert shown() == [(False, "or the key J"), missing, (False, None)]
    assert shown(job="pick.py")[0] == (True, "pick.py runs: end it first")
    disabled, hint = shown(controller="emergency stop")[0]
    assert disabled
    assert hint is not None
    assert "Reset after a stop" in hint
    finished.append("scan")
    assert shown() == [(False, "or the key J"), (False, None), (False, None)]
    rig.operators.take(2)
    assert shown() == [(True, OTHER_OPERATOR), (False, None), (True, OTHER_OPERATOR)]


@pytest.mark.parametrize(
    ("moving", "operation", "job", "jogs", "ends"),
    [
        (False, Operation.AUTOMATIC, None, True, False),
        (True, Operation.AUTOMATIC, None, False, True),
        (True, Operation.MANUAL, None, True, True),
        (False, Operation.AUTOMATIC, "scan", False, True),
    ],
)
def test_jogs_and_ends_of_motions_depend_on_the_state(
    moving: bool, operation: Operation, job: str | None, jogs: bool, ends: bool
) -> None:
    state: Any = SimpleNamespace(controller="at rest", moving=moving, operation=operation, job=job)
    assert (can_jog(state) == "") is jogs
    assert (can_end(state) == "") is ends


def test_picture_is_that_of_the_browser_one_at_a_time(rig: Rig) -> None:
    picture = np.asarray(Image.open(io.BytesIO(rig.commands.picture())))
    assert (picture == (10, 20, 30)).all()
    assert rig.messages == ["a picture is being made: wait for it"]
    rig.commands.picture()
