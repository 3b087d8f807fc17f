"""Guards at the other end of a link: restarted, with a second guard beside it, or with a second cell that calls it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from scancell.cell.driver import Mode, Operation
from scancell.guard.endpoints import CellEndpoint
from scancell.guard.guard import Decision, Guard
from scancell.guard.messages import CellState, GuardMessage
from scancell.guard.transport import Arrival, InProcess

COMPUTE = 0.004  # s that an answer takes
RIVALS = ("", "cell", "guard")  # beside the cell and its guard
_CALLS = 0.05  # s between states of a second cell
_OTHER_AGE = 1.0  # s


class Servers:
    """A transport to a guard.

    Parameters
    ----------
    make
        Makes a guard that knows nothing of the past.
    rival
        One of `RIVALS`: a second cell at rest at `home` (axes,), rad, that asks the guard for a session all the
        time; or a second guard of the same cell that gets the same states, whose answers come 2 ms later.

    Attributes
    ----------
    log
        Decisions, with the times of their states on the controller's clock, s.
    """

    def __init__(self, make: Callable[[], Guard], rival: str, home: np.ndarray) -> None:
        self.log: list[tuple[float, Decision]] = []
        self._make, self._home = make, home
        self._guard = InProcess(_Observed(make(), self.log), COMPUTE)
        self._second = InProcess(make(), COMPUTE + 2e-3) if rival == "guard" else None
        self._caller = CellEndpoint(_OTHER_AGE) if rival == "cell" else None
        self._calls = 0

    def restart(self) -> None:
        """Replace the guard by a new one; what was under way is lost."""
        self._guard = InProcess(_Observed(self._make(), self.log), COMPUTE)

    def send(self, packet: bytes, time: float) -> None:
        """Hand a packet to all guards."""
        self._guard.send(packet, time)
        if self._second is not None:
            self._second.send(packet, time)

    def receive(self, time: float) -> list[Arrival]:
        """Answers of all guards until `time`, s."""
        if self._caller is not None and time >= self._calls * _CALLS:
            self._calls += 1
            state = CellState(self._calls, time, Operation.AUTOMATIC, Mode.HOLD, False, self._home)
            self._guard.send(self._caller.packet(state), time)
        return sorted([*self._guard.receive(time), *(self._second.receive(time) if self._second else ())])

    def reset(self) -> None:
        """Nothing: there is no connection."""

    def close(self) -> None:
        """Nothing: there is no connection."""


class _Observed:
    """A guard that logs its decisions with the times of the states."""

    def __init__(self, guard: Guard, log: list[tuple[float, Decision]]) -> None:
        self._guard, self._log = guard, log

    def answer(self, state: CellState) -> GuardMessage:
        """Answer of the guard to a state."""
        message = self._guard.answer(state)
        self._log.append((state.time, self._guard.decision))
        return message

    def reset(self) -> None:
        """A session begins."""
        self._guard.reset()
