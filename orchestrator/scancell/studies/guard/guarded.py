"""Runs of a cell whose guard is behind a bad network."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from scancell.config.channel import LinkDescription
from scancell.guard.guard import Decision, Guard
from scancell.guard.link import Link, faulty_link
from scancell.guard.messages import CellState, GuardMessage
from scancell.guard.settings import GuardSettings
from scancell.guard.transport import InProcess
from scancell.studies.guard.scenario import Scenario
from scancell.studies.guard.simulation import Course, Simulation

_COMPUTE = 0.004  # s that an answer takes


@dataclass(frozen=True)
class Protection:
    """How runs are guarded; what is not given is as it should be.

    Attributes
    ----------
    guard
        Type of the guard.
    assumed
        What it assumes in place of the true settings.
    patience
        Time that the controller waits for answers, of what it should be.
    link
        Type of the cell's link.
    """

    guard: type[Guard] = Guard
    assumed: Callable[[GuardSettings], GuardSettings] = lambda true: true
    patience: float = 1.0
    link: type[Link] = Link


class GuardedRuns:
    """Runs scenarios with a guard.

    Parameters
    ----------
    simulation
        The cell.
    guard
        Its guard.
    max_age
        Of the controller, s; None: that of the guard.
    link_type
        How the cell receives answers.

    Attributes
    ----------
    log
        Decisions of the last run, with the times of their states on the controller's clock, s.
    """

    def __init__(
        self, simulation: Simulation, guard: Guard, max_age: float | None = None, link_type: type[Link] = Link
    ) -> None:
        self._simulation = simulation
        self._max_age = guard.settings.max_age if max_age is None else max_age
        self._link_type = link_type
        self.log: list[tuple[float, Decision]] = []
        self._observed = _Observed(guard, self.log)

    def run(self, scenario: Scenario, network: LinkDescription, seed: int = 0) -> Course:
        """What happens in a scenario; the faults of the network follow from `seed`."""
        self._observed.reset()

        def link() -> Link:
            transport = InProcess(self._observed, _COMPUTE)
            return faulty_link(transport, network, self._max_age, seed, self._link_type)

        return self._simulation.run(scenario, link, self._max_age)


class _Observed:
    """A guard whose decisions are written down with the times of the states."""

    def __init__(self, guard: Guard, log: list[tuple[float, Decision]]) -> None:
        self._guard, self._log = guard, log

    def answer(self, state: CellState) -> GuardMessage:
        """The guard's."""
        message = self._guard.answer(state)
        self._log.append((state.time, self._guard.decision))
        return message

    def reset(self) -> None:
        """The guard's."""
        self._log.clear()
        self._guard.reset()
