"""Deliberate errors of a guard: whether they lead to collisions shows what a campaign can find."""

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


class _Credulous(Link):
    """A link that takes every answer, however old, for one to the present state."""

    def poll(self, time: float) -> list[GuardMessage]:
        messages = (decode(arrival.packet).message for arrival in self._transport.receive(time))
        return [message for message in messages if isinstance(message, GuardMessage)]

    def age(self, time: float) -> float:
        return 0.0


class _Believing(Campaign):
    """A campaign whose cell receives answers by a credulous link."""

    link_type = _Credulous


def _mutated(
    guard: type[Guard] = Guard,
    assumed: Callable[[GuardSettings], GuardSettings] = lambda true: true,
    longer: float = 1.0,
    campaign: type[Campaign] = Campaign,
) -> Mutation:
    """Another guard, which may assume another worst case; the controller waits `longer` times as long for answers."""

    def made(simulation: Simulation, settings: GuardSettings, seed: int) -> Campaign:
        wrong = guard(simulation.nominal, simulation.description.robot, assumed(settings))
        return campaign(simulation, wrong, seed, longer * settings.max_age)

    return made


def _without(path: Path) -> Mutation:
    class Forgetful(Guard):
        """A guard that does not think of one way to go on."""

        def _hypotheses(self) -> Sequence[Hypothesis]:
            return [found for found in super()._hypotheses() if found.path is not path]

    return _mutated(Forgetful)


MUTATIONS: dict[str, Mutation] = {
    "short-delay": _mutated(assumed=lambda true: replace(true, max_age=true.max_age - _POLL)),
    "high-deceleration": _mutated(assumed=lambda true: replace(true, deceleration=1.25 * true.deceleration)),
    "no-joint-path": _without(Path.JOINT),
    "no-base-path": _without(Path.BASE),
    "no-tool-path": _without(Path.TOOL),
    "double-age": _mutated(longer=2.0),
    "stale-answers": _mutated(campaign=_Believing),
}
