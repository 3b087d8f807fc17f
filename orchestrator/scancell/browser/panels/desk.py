"""Commands of one browser to the cell."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from time import monotonic
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from scancell.browser.panels.messages import said_to_person, say
from scancell.browser.server.operators import Operators
from scancell.cell.controller import Operation, Tool
from scancell.live.cell import LiveCell
from scancell.live.commands import (
    Command,
    JogJoints,
    JogSensor,
    MoveJoints,
    MoveLine,
    MoveTool,
    SetOperation,
)
from scancell.scanning.session import ScanSession

if TYPE_CHECKING:
    import viser

Array = NDArray[np.float64]

_RENDERS = 60.0  # s, within which a browser makes a picture


class Desk:
    """Hands commands of one browser to the cell while it is the operator; tells its person where that fails.

    Parameters
    ----------
    client
        Of viser.
    operators
        Who controls the cell.
    live, session
        The running cell; the session gives nominal geometry alone, for `live` steps it.

    Attributes
    ----------
    nominal
        Nominal cell.
    """

    def __init__(self, client: viser.ClientHandle, operators: Operators, live: LiveCell, session: ScanSession) -> None:
        self._client, self._operators, self._live, self._session = client, operators, live, session
        self._inputs: list[Any] = []
        self.nominal = session.nominal

    @property
    def is_operator(self) -> bool:
        """Whether this browser controls the cell."""
        return self._operators.operator == int(self._client.client_id)

    @property
    def has_gripper(self) -> bool:
        """Whether the arm carries a gripper."""
        return self.nominal.flange_from_finger is not None

    def submit(self, command: Command) -> None:
        """Hand over a command; a motion changes the operation first, where that is needed."""
        self.as_operator(lambda: self._submit(command))

    def _submit(self, command: Command) -> None:
        wanted = _operation_for(command)
        state = self._live.state
        if wanted is not None and wanted is not state.operation:
            if state.moving:
                return
            self._live.submit(SetOperation(wanted))
        self._live.submit(command)

    def as_operator(self, act: Callable[[], object]) -> None:
        """Act if this browser controls the cell, else say that it does not: a page can send what it does not offer."""
        if self.is_operator:
            act()
        else:
            self.say("Another browser controls the cell: take control first")

    def send_file(self, name: str, content: bytes) -> None:
        """Let the browser download a file."""
        self._client.send_file_download(name, content, save_immediately=True)

    def render(self, height: int, width: int) -> NDArray[np.uint8]:
        """What this browser shows of the scene (height, width, 3)."""
        return np.asarray(self._client.get_render(height, width, timeout=_RENDERS), np.uint8)

    def take_control(self) -> None:
        """Become the operator."""
        self._operators.take(self._client.client_id)

    def joints_for(self, world_from_tool: Array, tool: Tool, configuration: str | None = None) -> Array:
        """Joint angles (joints,) of a pose (4, 4) of a tool, see `ScanSession.joints_for`."""
        near = self._live.state.joints
        return self._session.joints_for(world_from_tool, tool, near, configuration)

    def world_from_tool(self, tool: Tool, joints: Array) -> Array:
        """Pose (4, 4) of a tool by nominal geometry."""
        return np.asarray(self.nominal.arm.fk(joints) @ self._session.flange_from_tool(tool))

    def world_from_frame(self, name: str, table_angle: float) -> Array:
        """Pose (4, 4) of ``base`` or ``table``."""
        if name == "base":
            return self.nominal.arm.world_from_base
        return self.nominal.frame_poses(self.nominal.home, table_angle)[name]

    def say(self, text: str) -> None:
        """Show a message in this browser for a while."""
        say(self._client, text)

    # What panels are made of

    def add_inputs(self, handles: Iterable[Any]) -> None:
        """Inputs that only the operator may use."""
        self._inputs += handles

    def enable(self) -> None:
        """Let inputs be used where this browser is the operator."""
        for handle in self._inputs:
            if handle.disabled == self.is_operator:
                handle.disabled = not self.is_operator

    def by_person(self, act: Callable[[], object]) -> Callable[[Any], None]:
        """See `said_to_person`."""
        return said_to_person(act)


class Settled:
    """A value that a person still changes: it counts once it has stayed for 0.2 s."""

    def __init__(self, clock: Callable[[], float] = monotonic, stays: float = 0.2) -> None:
        self._clock, self._stays = clock, stays
        self._changed: float | None = None

    @property
    def is_pending(self) -> bool:
        """Whether there is a change that was not taken."""
        return self._changed is not None

    def change(self) -> None:
        """The value has changed now."""
        self._changed = self._clock()

    def take(self) -> bool:
        """Whether a change has stayed; it is taken then."""
        if self._changed is None or self._clock() - self._changed < self._stays:
            return False
        self._changed = None
        return True


def _operation_for(command: Command) -> Operation | None:
    match command:
        case JogJoints() | JogSensor():
            return Operation.MANUAL
        case MoveJoints() | MoveTool() | MoveLine():
            return Operation.AUTOMATIC
        case _:
            return None
