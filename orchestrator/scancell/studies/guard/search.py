"""A search for the worst moment: it steers the person and the network towards a collision.

It begins with scenarios whose twins collide and changes them a little at random: when commands are given, in which
direction, and when the link dies.  A change is kept if the robot comes nearer to something than before.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from scancell.cell.controller import Mode
from scancell.studies.guard.campaign import THIRDS, Campaign
from scancell.studies.guard.scenario import DURATION, Command, Scenario

_STALE = 25  # changes without success after which another scenario is taken
_SHIFT = 0.06  # s
_NUMBERS = 2 * len(THIRDS)  # of runs: a colliding twin in manual operation comes every so many


@dataclass(frozen=True)
class Attempt:
    """A scenario over a link that dies at `dead_from` (s; None: it does not).

    Attributes
    ----------
    clearance
        Smallest distance in the guarded run of bodies that are not near each other by design, m.
    contact
        Pair that python-fcl finds in contact; empty: none.
    """

    scenario: Scenario
    dead_from: float | None
    clearance: float
    contact: str


def search(campaign: Campaign, runs: int, seed: int, progress: Callable[[Attempt], None] | None = None) -> Attempt:
    """The worst attempt of `runs` guarded runs; it ends with the first contact.

    A third of the runs are the scenarios of colliding twins as they are; the worst of these are changed.
    """
    if runs < 1:
        raise ValueError(f"runs = {runs}: expected at least 1")
    rng = np.random.default_rng([seed, 1])
    worst: list[Attempt] = []  # of each scenario, the worst one first
    since = 0
    for run in range(runs):
        if run <= runs // 3:
            scenario = campaign.colliding_twin(_NUMBERS * run).scenario
            found = Attempt(scenario, None, *campaign.attempt(scenario, None))
            worst = sorted([*worst, found], key=lambda attempt: attempt.clearance)
        else:
            if since >= _STALE:  # the next scenario has its turn
                worst, since = [*worst[1:], worst[0]], 0
            changed = _changed(worst[0], rng)
            found = Attempt(*changed, *campaign.attempt(*changed))
            since += 1
            if found.clearance < worst[0].clearance:
                worst[0], since = found, 0
        if progress:
            progress(found)
        if found.contact:
            return found
    return min(worst, key=lambda attempt: attempt.clearance)


def _changed(attempt: Attempt, rng: np.random.Generator) -> tuple[Scenario, float | None]:
    """Another scenario and death of the link."""
    commands = list(attempt.scenario.commands)
    dead_from = attempt.dead_from
    at = int(rng.integers(len(commands)))
    kind = rng.integers(5)
    if kind == 0:
        time = float(np.clip(commands[at].time + rng.normal(0.0, _SHIFT), 0.1, DURATION))
        commands[at] = replace(commands[at], time=time)
    elif kind == 1:
        commands[at] = _turned(commands[at], rng)
    elif kind == 2:  # a change of mind on the way
        time = float(rng.uniform(commands[at].time, DURATION))
        commands.append(_turned(replace(commands[at], time=time), rng))
    elif kind == 3 and len(commands) > 1:
        del commands[at]
    else:
        dead_from = None if rng.random() < 0.2 else float(rng.uniform(0.3, DURATION))
    # Another kind of jog begins when the arm is at rest.
    modes = {command.mode for command in commands}
    if len(modes) > 1:
        kept = commands[-1].mode
        commands = [command for command in commands if command.mode is kept]
    ordered = tuple(sorted(commands, key=lambda command: command.time))
    return replace(attempt.scenario, commands=ordered), dead_from


def _turned(command: Command, rng: np.random.Generator) -> Command:
    """The jog in another direction, at full deflection along one axis or several."""
    values = command.values.copy()
    used = 6 if command.mode is Mode.TOOL_JOG else len(values)
    axis = int(rng.integers(used))
    values[axis] = rng.choice([-1.0, 0.0, 1.0])
    if rng.random() < 0.3:
        values = -values
    return replace(command, values=values)
