"""A search for the worst moment, in a cell at the limits of what its guard assumes.

By hand: a person jogs towards a contact; the controller does not show its jogs.  The guarded run shows which state is
the last that the guard permits to go on from.  The start is shifted towards the contact as far as it remains the last
one.  Then the run is repeated with a link that dies just after this state, with a person who goes on, and with one who
turns there to where the bodies approach fastest.  In automatic operation: moves whose first contact is that of a given
pair of bodies.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bench.guard_search.limits import at_limits
from bench.guard_search.mutations import Mutation
from bench.guard_search.pair_moves import PairMoves
from scancell.cell.controller import JogFrame, Mode
from scancell.closing import Closing
from scancell.config.cell import CellDescription
from scancell.config.channel import ChannelDescription, LinkDescription
from scancell.geometry.mesh import Mesh
from scancell.guard.tool import Tool
from scancell.nominal.cell import nominal_cell
from scancell.studies.guard.scenario import Command, Scenario
from scancell.studies.guard.simulation import SAMPLES, GuardedRuns, MotionRecord, Simulation
from scancell.studies.guard.twins import Twins

Array = NDArray[np.float64]

_DURATION = 8.0  # s, of a run: jogs accelerate slowly
_REPLAY_MS = 90.0  # after which answers are delivered again: younger than those that a controller waits for
_HALVINGS = 4  # of the way between two states, to shift the start
_DEAD = 1e-4  # s after a state
_POLL = 2 * SAMPLES  # samples of the motion between two states
_STEP = 1e-4  # rad, of differences
_CONCERNED = 0.02  # m/rad: axes that move the bodies less are left alone


@dataclass(frozen=True)
class Attempt:
    """A guarded run.

    Attributes
    ----------
    scenario, course
        What was tried, and what happened.
    dead_from
        Time from which on the guard gets no states, s; None: it gets all.
    clearance
        Smallest distance of the bodies that were steered to each other, m.
    contact
        Pair that python-fcl finds in contact; empty: none.
    last_permitted
        Time of the last state before the guard stopped the robot, s; None: it did not.
    """

    scenario: Scenario
    course: MotionRecord
    dead_from: float | None
    clearance: float
    contact: str
    last_permitted: float | None


class Search(Closing):
    """Attempts at a collision.

    Parameters
    ----------
    described
        The cell; it is taken to its limits.
    part
        Mesh of the part, m.
    seed
        Of the scenarios.
    mutation
        Error of the guard.
    """

    def __init__(self, described: CellDescription, part: Mesh, seed: int, mutation: Mutation | None = None) -> None:
        mutation = mutation or Mutation()
        limits = at_limits(described)
        nominal = nominal_cell(limits.assumed, part)
        ignored = () if mutation.ignored is None else (mutation.ignored,)
        guard = mutation.guard(nominal, limits.assumed.robot, mutation.assumed(limits.settings), ignored)
        self._simulation = Simulation(limits.true, nominal, shows_jogs=False)
        self._guarded = GuardedRuns(self._simulation, guard, mutation.patience * limits.max_age, mutation.link)
        self._tool, self._seed, self._of_table = Tool(nominal), seed, mutation.of_table

    def close(self) -> None:
        """Free the cell."""
        self._simulation.close()

    @property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """Pairs of bodies that a guard compares."""
        return self._simulation.scene.pairs

    def by_hand(self) -> Iterator[Attempt]:
        """Attempts in manual operation, without an end."""
        twins = Twins(self._simulation, self._seed)
        number = 0
        while True:
            twin = twins.persons(number, _DURATION, self._of_table)
            number += 1
            assert twin.contact is not None
            pair = np.array([" - ".join(names) == twin.contact[1] for names in self.pairs])
            live = self._attempt(twin.scenario, pair)
            yield live
            for step in 0.5 ** np.arange(1, _HALVINGS + 1):
                if live.last_permitted is None:
                    break
                shifted = self._attempt(_shifted(live, float(step)), pair)
                yield shifted
                if shifted.last_permitted == live.last_permitted:
                    live = shifted
            if live.last_permitted is None:
                continue
            dead_from = live.last_permitted + _DEAD
            yield self._attempt(live.scenario, pair, dead_from)
            yield self._attempt(self._turned(live, pair), pair, dead_from)

    def on_path(self, pair: tuple[str, str]) -> Iterator[Attempt]:
        """Attempts in automatic operation with a pair of bodies; none, if no move to its contact is found."""
        concerned = np.array([pair == names for names in self.pairs])
        for scenario in PairMoves(self._simulation, self._seed).moves(concerned, _DURATION):
            yield self._attempt(scenario, concerned)

    def _attempt(self, scenario: Scenario, pair: NDArray[np.bool_], dead_from: float | None = None) -> Attempt:
        to_guard = ChannelDescription(dead_from_s=dead_from)
        to_cell = ChannelDescription(replay=1.0, replay_ms=_REPLAY_MS)
        course = self._guarded.run(scenario, LinkDescription(to_guard=to_guard, to_cell=to_cell))
        log = self._guarded.log
        stop = next((time for time, decision in log if decision.stop), np.inf)
        permitted = [time for time, _ in log if time < stop]
        found = self._simulation.contact(course)
        clearance = float(self._simulation.distances_of(pair, course.axes).min())
        last = permitted[-1] if permitted and stop < np.inf else None
        return Attempt(scenario, course, dead_from, clearance, found[1] if found else "", last)

    def _turned(self, live: Attempt, pair: NDArray[np.bool_]) -> Scenario:
        """The scenario, in which the person turns to the fastest approach of a pair at the last permitted state."""
        assert live.last_permitted is not None
        time = live.last_permitted
        axes = live.course.axes[int(np.searchsorted(live.course.times, time - 1e-9))]
        before = [command for command in live.scenario.commands if command.time < time]
        last = before[-1]
        return replace(
            live.scenario, commands=(*before, replace(last, time=time, values=self._approach(last, axes, pair)))
        )

    def _approach(self, command: Command, axes: Array, pair: NDArray[np.bool_]) -> Array:
        """Deflections (joints + 1,) of a jog like `command` in which a pair approaches fastest at `axes`."""
        steps = _STEP * np.eye(len(axes))
        distance = self._simulation.distances_of(pair, np.vstack([axes + steps, axes - steps])).reshape(2, -1)
        slope = (distance[0] - distance[1]) / (2 * _STEP)
        if command.mode is Mode.JOINT_JOG:
            return np.where(np.abs(slope) > _CONCERNED, -np.sign(slope), 0.0)
        tool, jacobian = self._tool.poses(axes[None, :-1])
        if not self._tool.moves_straight(jacobian[0]):
            return command.values
        turn = tool[0, :3, :3] if command.frame is JogFrame.SENSOR else np.eye(3)
        twists = np.asarray(np.kron(np.eye(2), turn.T), np.float64)  # rows: unit twists of the jog's frame, world axes
        rates = self._tool.rates(np.repeat(jacobian, 6, 0), twists)
        wanted = -(rates @ slope[:-1])
        values = np.zeros(len(axes))
        for part in (slice(0, 3), slice(3, 6)):
            values[part] = wanted[part] / max(float(np.linalg.norm(wanted[part])), 1e-9)
        return values


def _shifted(live: Attempt, share: float) -> Scenario:
    """The scenario from a start shifted by a `share` of the motion from the last permitted state to the next one."""
    assert live.last_permitted is not None
    course = live.course
    last = int(np.searchsorted(course.times, live.last_permitted - 1e-9))
    step = course.axes[min(last + _POLL, len(course.axes) - 1)] - course.axes[last]
    return replace(live.scenario, start=live.scenario.start + share * step)
