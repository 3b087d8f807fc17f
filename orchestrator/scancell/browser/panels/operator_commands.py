"""Commands of the user of one browser to the cell, and messages to that user."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable, Mapping
from threading import Lock
from time import monotonic
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image

from scancell.arrays import Array
from scancell.browser.panels.handles import SHOWN, report_errors, set_changed, show_message
from scancell.browser.server.gate import Operators
from scancell.cell.driver import Operation, Tool
from scancell.errors import CommandError
from scancell.live.cell import LiveCell
from scancell.live.state import Command, LiveState, SetOperation
from scancell.scanning.session import ScanSession

if TYPE_CHECKING:
    import viser


OTHER_OPERATOR = "another browser controls the cell: take control first"

Condition = Callable[[LiveState], str]  # reason why an input cannot work now; empty if it can

_PICTURE = (720, 1280)  # px, height and width
_RENDER_TIMEOUT = 60.0  # s, within which a browser renders a picture


def always(state: LiveState) -> str:
    """No condition."""
    return ""


def can_move(state: LiveState) -> str:
    """Moves need a cell without an emergency stop and without a job."""
    if state.controller == "emergency stop":
        return 'the robot is stopped: press "Reset after a stop" first'
    return _no_job(state)


def is_stopped(state: LiveState) -> str:
    """There is a stop to release."""
    return "" if state.controller == "emergency stop" else "the robot is not stopped"


def can_start(state: LiveState) -> str:
    """Jobs that do not move the robot need it at rest, stopped or not, and without another job."""
    return _no_job(state) or ("the robot moves: wait until it is at rest" if state.moving else "")


def can_jog(state: LiveState) -> str:
    """Jogs also need manual operation, which is chosen at rest."""
    if state.moving and state.operation is Operation.AUTOMATIC:
        return "the robot moves in automatic operation: wait until it is at rest"
    return can_move(state)


def _no_job(state: LiveState) -> str:
    return "" if state.job is None else f"{state.job} runs: end it first"


def can_end(state: LiveState) -> str:
    """A motion or a job that can be ended."""
    return "" if state.moving or state.job is not None else "nothing moves the robot"


class OperatorCommands:
    """Submits the commands of one browser to the cell while this browser is the operator, and reports errors in it.

    Parameters
    ----------
    client
        Client of viser.
    operators
        Selects the browser that controls the cell.
    live, session
        The running cell; only the nominal geometry of the session is used, because `live` steps it.
    clock
        Function that returns the time, s.

    Attributes
    ----------
    nominal
        Nominal cell.
    """

    _rendering = Lock()  # a browser that does not answer blocks one thread of the server, not all

    def __init__(
        self,
        client: viser.ClientHandle,
        operators: Operators,
        live: LiveCell,
        session: ScanSession,
        clock: Callable[[], float] = monotonic,
    ) -> None:
        self._client, self._operators, self._live, self._session = client, operators, live, session
        self._clock = clock
        self._inputs: list[tuple[Any, str | None, Condition, bool]] = []
        self._last_message, self._message_ends = "", 0.0
        self.nominal = session.nominal

    @property
    def is_operator(self) -> bool:
        """Whether this browser controls the cell."""
        return self._operators.operator == int(self._client.client_id)

    @property
    def state(self) -> LiveState:
        """State of the cell now; panels are shown an older one."""
        return self._live.state

    def submit(self, command: Command) -> None:
        """Submit a command as the operator; a motion that needs another operation first changes to it.

        Raises
        ------
        CommandError
            If the command needs another operation while the robot moves.
        """
        self.as_operator(lambda: self._submit(command))

    def _submit(self, command: Command) -> None:
        needed, state = command.needs_operation, self._live.state
        if needed is not None and needed is not state.operation:
            if state.moving:
                current, other = state.operation.name.lower(), needed.name.lower()
                raise CommandError(
                    f"The robot moves in {current} operation, and this command needs {other} operation: "
                    "stop the robot, or wait until it is at rest"
                )
            self._live.submit(SetOperation(needed))
        self._live.submit(command)

    def as_operator(self, act: Callable[[], object]) -> None:
        """Call `act` if this browser controls the cell, else show a message: a page can send disabled inputs."""
        if self.is_operator:
            act()
        else:
            self.show_message(OTHER_OPERATOR)

    def send_file(self, name: str, content: bytes) -> None:
        """Let the browser download a file."""
        self._client.send_file_download(name, content, save_immediately=True)

    def picture(self) -> bytes:
        """PNG of the scene as this browser shows it.

        Raises
        ------
        CommandError
            While another picture is made.
        """
        if not self._rendering.acquire(blocking=False):
            raise CommandError("a picture is being made: wait for it")
        try:
            pixels = self._client.get_render(*_PICTURE, timeout=_RENDER_TIMEOUT)
        finally:
            self._rendering.release()
        file = io.BytesIO()
        Image.fromarray(np.asarray(pixels, np.uint8)).save(file, "PNG")
        return file.getvalue()

    def take_control(self) -> None:
        """Become the operator."""
        self._operators.take(self._client.client_id)

    def joints_for(self, world_from_tool: Array, tool: Tool, configuration: str | None = None) -> Array:
        """Joint angles (joints,) of a pose (4, 4) of a tool, see `ScanSession.joints_for`."""
        return self._session.joints_for(world_from_tool, tool, None, configuration, self._live.state.axes)

    def world_from_tool(self, tool: Tool, axes: Array) -> Array:
        """Pose (4, 4) of a tool at positions (axes,) by nominal geometry."""
        nominal = self.nominal
        return np.asarray(nominal.world_from(nominal.arm.flange, axes) @ self._session.flange_from_tool(tool))

    def show_message(self, text: str) -> None:
        """Show a message in this browser; not again while it is shown, as a held button repeats its command."""
        now = self._clock()
        if text == self._last_message and now < self._message_ends:
            return
        self._last_message, self._message_ends = text, now + SHOWN
        show_message(self._client, text)

    # For panels

    def add_inputs(self, handles: Iterable[Any], condition: Condition = always, by_all: bool = False) -> None:
        """Add inputs with the condition for their use; `by_all`: every browser may use them, not the operator alone."""
        self._inputs += [(handle, handle.hint, condition, by_all) for handle in handles]

    def connect(
        self,
        handle: Any,
        act: Callable[[], object],
        condition: Condition = always,
        by_all: bool = False,
    ) -> Any:
        """Add an input, see `add_inputs`, which calls `act` when the user presses or changes it; returns the input."""
        self.add_inputs([handle], condition, by_all)
        event = next(event for event in ("on_click", "on_upload", "on_update") if hasattr(handle, event))
        getattr(handle, event)(self.callback(act) if by_all else self.operator_callback(act))
        return handle

    def connect_group(self, group: Any, acts: Mapping[str, Callable[[], object]]) -> None:
        """Call the act of the button of a group that the operator presses."""

        def act() -> None:
            acts[group.value]()

        group.on_click(self.operator_callback(act))

    def enable_inputs(self, state: LiveState) -> None:
        """Enable the inputs that can work now; the hint of a disabled one states the reason."""
        for handle, hint, condition, by_all in self._inputs:
            reason = condition(state) if by_all or self.is_operator else OTHER_OPERATOR
            set_changed(handle, "disabled", reason != "")
            set_changed(handle, "hint", reason or hint)

    def callback(self, act: Callable[[], object]) -> Callable[[Any], None]:
        """Callback of viser that calls `act` on input of the user and reports errors."""

        def called(event: Any) -> None:
            if event.client is not None:  # None: the program has set the value
                report_errors(act, self.show_message)

        return called

    def operator_callback(self, act: Callable[[], object]) -> Callable[[Any], None]:
        """Callback as of `callback`, for the operator only."""
        return self.callback(lambda: self.as_operator(act))
