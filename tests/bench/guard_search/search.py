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
from bench.guard_search.mutations import MutatedSimulation, Mutation
from bench.guard_search.pair_moves import PairMoves
from scancell.config.cell import CellDescription, ChannelDescription, LinkDescription
from scancell.geometry.mesh import Mesh
from scancell.guard.parts import Tool
from scancell.nominal.cell import nominal_cell
from scancell.studies.guard.draws import Draws
from scancell.studies.guard.scenario import FURTHER, JOGGED, Kind, Motion, Scenario
from scancell.studies.guard.simulation import SAMPLES, MotionRecord, Network
from scancell.studies.guard.worlds import World
from scancell.values import Closing

Array = NDArray[np.float64]

_DURATION = 8.0  # s, of a run: jogs accelerate slowly
_AFTER = 1.0  # s: a person who jogs at random collides later
_DRAWS = 5000  # starts of persons
_SWEPT = 400  # poses on the way of an axis that is jogged alone
_SLOWEST = 0.1  # share of the full speed
_REPLAY_MS = 90.0  # after which answers are delivered again: younger than those that a controller waits for
_HALVINGS = 4  # of the way between two states, to shift the start
_DEAD = 1e-4  # s after a state
_POLL = 2 * SAMPLES  # samples of the motion between two states
_STEP = 1e-4  # rad and m, of differences
_JOGGED = tuple(kind for kind in JOGGED if kind not in FURTHER)  # those of the table are of any axis beyond the joints
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
        world = World(limits.true, nominal_cell(limits.assumed, part), limits.settings)
        patience = mutation.patience * limits.max_age / limits.settings.max_age
        self._simulation = MutatedSimulation(replace(mutation, patience=patience), world, shows_jogs=False)
        self._draws = Draws(world, self._simulation.cycle)
        self._exact = np.zeros((len(world.names), 3))
        self._tool, self._seed, self._alone = Tool(world.nominal), seed, mutation.alone

    def close(self) -> None:
        """Free the cell."""
        self._simulation.close()

    @property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """Pairs of bodies that are judged."""
        return tuple(self._simulation.world.pairs)

    def by_hand(self) -> Iterator[Attempt]:
        """Attempts in manual operation, without an end."""
        number = 0
        while True:
            scenario, names = self._person(number)
            number += 1
            pair = np.array([names == one for one in self.pairs])
            live = self._attempt(scenario, pair)
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

    def _person(self, number: int) -> tuple[Scenario, tuple[str, str]]:
        """A person who jogs at random, or one axis alone, whose unguarded run ends in a contact, and its pair."""
        rng = np.random.default_rng([self._seed, number, 0])
        for _ in range(_DRAWS):
            start, motions, time = self._far_start(rng), list[Motion](), 0.0
            if self._alone:
                axis = self._tool.joints
                if self._alone == "further":
                    axis = int(rng.integers(axis + 1, len(start)))
                along = np.where(np.arange(len(start)) == axis, rng.choice([-1.0, 1.0]), 0.0)
                before = self._before_contact(start, along)
                if before is None:
                    continue
                start = before
            while time < _DURATION and not (self._alone and motions):
                kind = Kind.AXIS_JOG if self._alone else Kind(rng.choice(_JOGGED))
                speed = float(rng.choice([1.0, rng.uniform(_SLOWEST, 1.0)]))
                if not self._alone:
                    along = self._draws.along(np.zeros(len(start)), rng)
                motion = self._draws.motion(kind, along, 1.0, speed, start, rng)
                short = not self._alone and rng.random() < 0.5
                motion = replace(motion, duration=rng.uniform(0.3, 1.5) if short else rng.uniform(1.5, _DURATION))
                motions.append(replace(motion, duration=_DURATION) if self._alone else motion)
                time += motions[-1].duration
            scenario = Scenario(start, tuple(motions), _DURATION)
            contact = self._simulation.contact(self._simulation.run(scenario), self._exact)
            if contact is not None and contact[0] >= _AFTER:
                return scenario, contact[1]
        raise RuntimeError(f"person {number}: none of {_DRAWS} scenarios ends in a contact")

    def _before_contact(self, start: Array, along: Array) -> Array | None:
        """Axes (axes,) on the way from `start` along one axis that are the last far from all bodies before a contact.

        None, if that axis alone leads into none.
        """
        world, least = self._simulation.world, self._draws.least
        number, far = int(np.argmax(np.abs(along))), 2 * np.pi  # of the table, which has no limits
        if number > self._tool.joints:
            axis = world.nominal.further_axes[number - self._tool.joints - 1]
            far = abs((axis.max if along[number] > 0 else axis.min) - start[number])
        axes = start + np.linspace(0.0, far, _SWEPT)[:, None] * along
        near = world.scene.distances(world.nominal.body_poses(axes), least, 1)
        touching = np.flatnonzero((near == 0.0).any(1))
        if not len(touching):
            return None
        return np.asarray(axes[np.flatnonzero((near[: touching[0]] >= least - 1e-9).all(1))[-1]])

    def _far_start(self, rng: np.random.Generator) -> Array:
        """Axes (axes,), rad, far from all bodies."""
        world, least = self._simulation.world, self._draws.least
        while True:
            start = self._draws.anywhere(rng)
            if (world.scene.distances(world.nominal.body_poses(start[None]), least, 1)[0] >= least - 1e-9).all():
                return start

    def _distances(self, pair: NDArray[np.bool_], axes: Array) -> Array:
        """Nominal distances (n,), m, of the one `pair` (pairs,) of those judged at axes (n, axes)."""
        world = self._simulation.world
        poses = world.nominal.body_poses(axes)
        return np.asarray(world.scene.distances(poses, np.where(pair, np.inf, 0.0), 1)[:, pair][:, 0])

    def _attempt(self, scenario: Scenario, pair: NDArray[np.bool_], dead_from: float | None = None) -> Attempt:
        to_guard = ChannelDescription(dead_from_s=dead_from)
        to_cell = ChannelDescription(replay=1.0, replay_ms=_REPLAY_MS)
        course = self._simulation.run(scenario, Network(LinkDescription(to_guard=to_guard, to_cell=to_cell)))
        log = course.decisions
        stop = next((time for time, decision in log if decision.stop), np.inf)
        permitted = [time for time, _ in log if time < stop]
        found = self._simulation.contact(course, self._exact)
        clearance = float(self._distances(pair, course.axes).min())
        last = permitted[-1] if permitted and stop < np.inf else None
        return Attempt(scenario, course, dead_from, clearance, " - ".join(found[1]) if found else "", last)

    def _turned(self, live: Attempt, pair: NDArray[np.bool_]) -> Scenario:
        """The scenario, in which the person turns to the fastest approach of a pair at the last permitted state."""
        assert live.last_permitted is not None
        time = live.last_permitted
        axes = live.course.axes[int(np.searchsorted(live.course.times, time - 1e-9))]
        begun = [one for one in live.course.begun if one.time < time]
        last = begun[-1]
        kept = [*(one.motion for one in begun[:-1]), replace(last.motion, duration=time - last.time)]
        turned = replace(last.motion, by=self._approach(last.motion, axes, pair), duration=_DURATION)
        return replace(live.scenario, motions=(*kept, turned))

    def _approach(self, motion: Motion, axes: Array, pair: NDArray[np.bool_]) -> Array:
        """Deflections (axes,) of a jog like `motion` in which a pair approaches fastest at `axes`."""
        steps = _STEP * np.eye(len(axes))
        distance = self._distances(pair, np.vstack([axes + steps, axes - steps])).reshape(2, -1)
        slope = (distance[0] - distance[1]) / (2 * _STEP)
        if motion.kind in (Kind.JOINT_JOG, Kind.TABLE_JOG, Kind.AXIS_JOG):
            return np.where(np.abs(slope) > _CONCERNED, -np.sign(slope), 0.0)
        tool, jacobian = self._tool.poses(axes[None])
        if not self._tool.moves_straight(jacobian[0]):
            return motion.by
        turn = tool[0, :3, :3] if motion.kind is Kind.TOOL_JOG else np.eye(3)
        twists = np.asarray(np.kron(np.eye(2), turn.T), np.float64)  # rows: unit twists of the jog's frame, world axes
        rates = self._tool.rates(np.repeat(jacobian, 6, 0), twists)
        wanted = -(rates @ slope[: self._tool.joints])
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
