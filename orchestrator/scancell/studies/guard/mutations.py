"""Deliberate errors of a guard, each of which must lead to collisions: they show that a campaign can fail."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from scancell.guard.guard import Guard
from scancell.guard.link import Link
from scancell.guard.messages import GuardMessage, decode
from scancell.guard.motion import Hypothesis, Path
from scancell.guard.settings import GuardSettings
from scancell.studies.guard.campaign import Campaign
from scancell.studies.guard.simulation import Simulation

_POLL = 0.032  # s
Mutation = Callable[[Simulation, GuardSettings, int], Campaign]


def _assuming(wrong: Callable[[GuardSettings], GuardSettings]) -> Mutation:
    """A guard that assumes another worst case than the controller's."""

    def made(simulation: Simulation, settings: GuardSettings, seed: int) -> Campaign:
        guard = Guard(simulation.nominal, simulation.description.robot, wrong(settings))
        return Campaign(simulation, guard, seed, settings.max_age)

    return made


def _with_age(factor: float) -> Mutation:
    """A controller that waits longer for answers than the guard believes."""

    def made(simulation: Simulation, settings: GuardSettings, seed: int) -> Campaign:
        guard = Guard(simulation.nominal, simulation.description.robot, settings)
        return Campaign(simulation, guard, seed, factor * settings.max_age)

    return made


def _without(path: Path) -> Mutation:
    class Forgetful(Guard):
        """A guard that does not think of one way to go on."""

        def _hypotheses(self) -> Sequence[Hypothesis]:
            return [found for found in super()._hypotheses() if found.path is not path]

    def made(simulation: Simulation, settings: GuardSettings, seed: int) -> Campaign:
        return Campaign(simulation, Forgetful(simulation.nominal, simulation.description.robot, settings), seed)

    return made


class _Credulous(Link):
    """A link that takes every answer, however old, for one to the present state."""

    def poll(self, time: float) -> list[GuardMessage]:
        messages = (decode(arrival.packet).message for arrival in self._transport.receive(time))
        return [message for message in messages if isinstance(message, GuardMessage)]

    def age(self, time: float) -> float:
        return 0.0


def _stale(simulation: Simulation, settings: GuardSettings, seed: int) -> Campaign:
    class Believing(Campaign):
        link_type = _Credulous

    return Believing(simulation, Guard(simulation.nominal, simulation.description.robot, settings), seed)


def without_pair(pair: tuple[str, str]) -> Mutation:
    """A guard that ignores a pair of bodies."""

    def made(simulation: Simulation, settings: GuardSettings, seed: int) -> Campaign:
        guard = Guard(simulation.nominal, simulation.description.robot, settings, ignored=[frozenset(pair)])
        return Campaign(simulation, guard, seed)

    return made


MUTATIONS: dict[str, Mutation] = {
    "short-delay": _assuming(lambda true: replace(true, max_age=true.max_age - _POLL)),
    "high-deceleration": _assuming(lambda true: replace(true, deceleration=1.25 * true.deceleration)),
    "no-joint-path": _without(Path.JOINT),
    "no-base-path": _without(Path.BASE),
    "no-tool-path": _without(Path.TOOL),
    "double-age": _with_age(2.0),
    "stale-answers": _stale,
}
