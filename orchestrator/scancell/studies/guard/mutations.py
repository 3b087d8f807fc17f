"""Deliberate errors of a guard: whether a search finds a collision shows what it can find."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from scancell.guard.guard import Guard
from scancell.guard.link import Link
from scancell.guard.messages import GuardMessage, decode
from scancell.guard.motion import Hypothesis, Path
from scancell.guard.settings import GuardSettings

_POLL = 0.032  # s


@dataclass(frozen=True)
class Mutation:
    """An error.

    Attributes
    ----------
    guard
        Another guard.
    assumed
        What it assumes in place of the true settings.
    patience
        Time that the controller waits for answers, of what it should be.
    link
        Another link of the cell.
    ignored
        A pair of bodies that the guard does not compare.
    """

    guard: type[Guard] = Guard
    assumed: Callable[[GuardSettings], GuardSettings] = lambda true: true
    patience: float = 1.0
    link: type[Link] = Link
    ignored: tuple[str, str] | None = None


class _Credulous(Link):
    """A link that takes every answer for one to the present state."""

    _received = -float("inf")

    def poll(self, time: float) -> list[GuardMessage]:
        messages = [decode(arrival.packet).message for arrival in self._transport.receive(time)]
        answers = [message for message in messages if isinstance(message, GuardMessage)]
        if answers:
            self._received = time
        return answers

    def age(self, time: float) -> float:
        return time - self._received


def _without(path: Path) -> Mutation:
    class Forgetful(Guard):
        """A guard that does not think of one way to go on."""

        def _hypotheses(self) -> Sequence[Hypothesis]:
            return [found for found in super()._hypotheses() if found.path is not path]

    return Mutation(Forgetful)


MUTATIONS: dict[str, Mutation] = {
    "short-delay": Mutation(assumed=lambda true: replace(true, max_age=true.max_age - _POLL)),
    "high-deceleration": Mutation(assumed=lambda true: replace(true, deceleration=1.25 * true.deceleration)),
    "no-joint-path": _without(Path.JOINT),
    "no-base-path": _without(Path.BASE),
    "no-tool-path": _without(Path.TOOL),
    "double-age": Mutation(patience=2.0),
    "stale-answers": Mutation(link=_Credulous),
}
