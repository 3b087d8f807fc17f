"""Paired runs with and without a guard, over a bad network.

Kinds, lengths and speeds of motions, cells, parts, network faults and errors of bodies alternate.  Everything follows
from the campaign's seed and the number of a run, so that campaigns can be interrupted, and single runs repeated.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from scancell.config.cell import CellDescription
from scancell.geometry.mesh import Mesh
from scancell.guard.messages import VERSION
from scancell.studies.guard.draws import DECADES, FAULTS, Draw, Draws, Stratum, random_network, stratum_of
from scancell.studies.guard.scenario import Begun, Kind
from scancell.studies.guard.simulation import RIVALS, MotionRecord, Network, Simulation
from scancell.studies.guard.worlds import World, world_of
from scancell.values import Closing

_SEEN = 0.02  # m: clearances of guarded runs are not looked for beyond
_FALSE = 5e-3  # m beyond the stated distance
_RIVALS = 0.1  # share of the runs with each
_DISPLACED = 1e-3  # m: a part that has moved by more is not where the guard assumes it
_REST, _REST_TIME = 1e-5, 0.05  # rad and s: a robot that moves less before a contact of its fingers rests

# Distance, m, at which a robot that moves towards a body comes to rest (docs/guard.md): on a known path or with a
# controller that predicts and limits jogs, and by the speed, m/s, with one that does not.
_SHOWN = 0.005
_SILENT = ((0.0, 0.030), (0.005, 0.030), (0.0125, 0.031), (0.025, 0.033), (0.05, 0.036), (0.125, 0.049), (0.25, 0.072))


def stated_distance(speed: float, silent: bool) -> float:
    """Largest distance, m, at which the guard stops a motion of `speed`, m/s; in proportion beyond the last one."""
    if not silent:
        return _SHOWN
    speeds, distances = np.transpose(_SILENT)
    return float(np.interp(speed, speeds, distances) * max(1.0, speed / speeds[-1]))


@dataclass(frozen=True)
class RunRow:
    """Outcome of a run.

    Attributes
    ----------
    number, kind, decade, length, near, fault, cell, part, silent, version
        Stratum of the run; `kind` and `length` may be ``mixed``.
    rival
        Second cell or guard on the link; empty: none.
    pair, gap
        Pair that the robot approaches, and its distance at the start, m; empty and NaN: none.
    speed
        Share of the full speed.
    motions, short
        Motions in the twin, and those of them that took at most a cycle of the controller.
    twin_contact_at, twin_contact
        Contact of the twin, s and pair; NaN and empty: none.
    contact_at, contact
        The same of the guarded run.
    by_gripper
        Whether the robot rested when a finger came into contact, or the part that did had slipped in the gripper or
        been pushed by a finger: the guard controls no fingers, and they may touch parts.
    contact_kind, contact_length
        Kind of the motion in which the contact came, and its largest angle, rad.
    clearance
        Smallest distance of bodies that are not both of the arm in the guarded run, m, at most 0.02.
    stop, stop_at, stopped_pair
        First cause that held the robot: a stop by the ``guard``, by the ``age`` of the last answer, a jog held at rest
        (``refused``), a motion that the guard held until the operator gave it up (``held``), or none; its time, s, and
        its pair.
    stop_kind
        Kind of the motion that was held.
    false_stop
        Whether the twin never came near what the guard stopped for.
    slowed
        Whether the guard has slowed the robot without a stop.
    resets, sessions
        Resets of the controller, and new sessions.
    """

    number: int
    kind: str
    decade: str
    length: str
    near: bool
    fault: str
    cell: str
    part: str
    silent: bool
    version: int
    rival: str
    pair: str
    gap: float
    speed: float
    motions: int
    short: int
    twin_contact_at: float
    twin_contact: str
    contact_at: float
    contact: str
    by_gripper: bool
    contact_kind: str
    contact_length: float
    clearance: float
    stop: str
    stop_at: float
    stopped_pair: str
    stop_kind: str
    false_stop: bool
    slowed: bool
    resets: int
    sessions: int

    @property
    def collided(self) -> bool:
        """Whether the guarded robot collided: a contact of a finger while the robot rests is none of its motion."""
        return bool(self.contact) and not self.by_gripper


class Campaign(Closing):
    """Runs of a campaign.

    Parameters
    ----------
    cells
        Descriptions by name, which alternate.
    parts
        Meshes by name, m, one of which is on the table.
    seed
        Seed of the campaign.
    folder
        For the files of the FMU; None: where the system keeps temporary files.
    simulation
        Makes the simulation of a world.
    """

    def __init__(
        self,
        cells: Mapping[str, CellDescription],
        parts: Mapping[str, Mesh],
        seed: int,
        folder: Path | None = None,
        simulation: Callable[..., Simulation] = Simulation,
    ) -> None:
        self._cells, self._parts, self._seed, self._folder = cells, parts, seed, folder
        self._simulation = simulation
        self._block: _Block | None = None

    def close(self) -> None:
        """Free the cell."""
        if self._block is not None:
            self._block.simulation.close()
            self._block = None

    def run(self, number: int) -> RunRow:
        """Run with the number `number`; faster in the order of numbers."""
        stratum = stratum_of(number)
        block = self._block_of(stratum)
        stratum = replace(stratum, version=block.version)
        draw = block.draws.draw(stratum, np.random.default_rng([self._seed, number, 0]))
        rng = np.random.default_rng([self._seed, number, 1])
        drawn = rng.random()
        rival = RIVALS[1] if drawn < _RIVALS else RIVALS[2] if drawn < 2 * _RIVALS else RIVALS[0]
        faults, seed = random_network(stratum.fault, draw.scenario.duration, rng)
        twin = block.simulation.run(draw.scenario)
        guarded = block.simulation.run(draw.scenario, Network(faults, seed, rival))
        return _Pair(block, stratum, draw, rival, twin, guarded).row()

    def _block_of(self, stratum: Stratum) -> _Block:
        if self._block is None or self._block.number != stratum.block:
            self.close()
            rng = np.random.default_rng([self._seed, stratum.block, 2])
            turn = stratum.block + stratum.block // len(FAULTS)
            cell = list(self._cells)[turn % len(self._cells)]
            part = str(rng.choice(list(self._parts)))
            world = world_of(self._cells[cell], self._parts[part], part, rng)
            version = VERSION if world.nominal.further_axes else stratum.version  # the first one does not know these
            simulation = self._simulation(world, self._folder, not stratum.silent, version)
            draws = Draws(world, simulation.cycle)
            named = "gripped" if world.grips else part
            self._block = _Block(stratum.block, cell, named, version, world, simulation, draws)
        return self._block


@dataclass(frozen=True)
class _Block:
    """Runs with one cell."""

    number: int
    cell: str
    part: str
    version: int
    world: World
    simulation: Simulation
    draws: Draws


@dataclass(frozen=True)
class _Pair:
    """A run and its twin."""

    block: _Block
    stratum: Stratum
    draw: Draw
    rival: str
    twin: MotionRecord
    guarded: MotionRecord

    def row(self) -> RunRow:
        """Outcome of the run."""
        simulation, draw, stratum, guarded, twin = (
            self.block.simulation, self.draw, self.stratum, self.guarded, self.twin,
        )  # fmt: skip
        outside = ~self.block.world.inner
        contacts = [simulation.contact(record, draw.shifts) for record in (twin, guarded)]
        seen = simulation.clearances(guarded, draw.shifts, np.where(outside, _SEEN, 0.0))
        smallest = float(seen[:, outside].min())
        stop, stop_at, pair = self._stop()
        motion = None if contacts[1] is None else self._motion_at(contacts[1][0])
        held = None if stop == "" else self._motion_at(stop_at)
        return RunRow(
            number=stratum.number,
            kind=stratum.kind,
            decade=DECADES[stratum.decade],
            length=stratum.lengths,
            near=stratum.near,
            fault=stratum.fault,
            cell=self.block.cell,
            part=self.block.part,
            silent=stratum.silent,
            version=stratum.version,
            rival=self.rival,
            pair=" - ".join(draw.pair),
            gap=draw.gap,
            speed=max(begun.motion.speed for begun in twin.begun),
            motions=len(twin.begun),
            short=sum(begun.cycles <= 1 for begun in twin.begun),
            twin_contact_at=contacts[0][0] if contacts[0] else np.nan,
            twin_contact=" - ".join(contacts[0][1]) if contacts[0] else "",
            contact_at=contacts[1][0] if contacts[1] else np.nan,
            contact=" - ".join(contacts[1][1]) if contacts[1] else "",
            by_gripper=contacts[1] is not None
            and (self._rests_before(*contacts[1]) or self._is_displaced(*contacts[1])),
            contact_kind=motion.motion.kind.value if motion else "",
            contact_length=motion.motion.length if motion else np.nan,
            clearance=smallest,
            stop=stop,
            stop_at=stop_at,
            stopped_pair=" - ".join(pair),
            stop_kind=held.motion.kind.value if held else "",
            false_stop=self._is_false(stop, pair, held),
            slowed=stop == "" and any(decision.beep for _, decision in guarded.decisions),
            resets=guarded.resets,
            sessions=guarded.sessions,
        )

    def _is_displaced(self, time: float, pair: tuple[str, str]) -> bool:
        """Whether the part of a `pair` in contact at `time`, s, is not where the gripper took it or left it."""
        grips = self.block.world.grips and "part" in pair
        return grips and self.block.simulation.displacement(self.guarded, time) > _DISPLACED

    def _motion_at(self, time: float) -> Begun | None:
        """Motion of the guarded run that had begun last at `time`, s."""
        before = [begun for begun in self.guarded.begun if begun.time <= time + 1e-9]
        return before[-1] if before else None

    def _rests_before(self, time: float, pair: tuple[str, str]) -> bool:
        """Whether a finger of `pair` has moved while all axes rested before `time`, s."""
        times, axes = self.guarded.times, self.guarded.axes
        before = axes[(times <= time) & (times >= time - _REST_TIME)]
        return any(name.startswith("finger") for name in pair) and bool(np.ptp(before, axis=0).max() < _REST)

    def _stop(self) -> tuple[str, float, tuple[str, ...]]:
        """First cause that held the robot, its time, s, and the pair for which the guard did."""
        guarded = self.guarded
        causes = {"guard": guarded.stopped_at, "refused": guarded.refused_at, "held": guarded.held_at}
        known = {cause: time for cause, time in causes.items() if time is not None}
        if not known:
            return "", np.nan, ()
        cause = min(known, key=lambda name: known[name])
        time = known[cause]
        if cause == "guard":
            if not any(answer.emergency_stop and at <= time + 1e-9 for at, answer in guarded.answers):
                return "age", time, ()
            return cause, time, next((found.pair for _, found in guarded.decisions if found.stop), ())
        pairs = [found.pair for at, found in guarded.decisions if at <= time + 1e-9 and found.monitor_speed < 1.0]
        if cause == "held" and not pairs:
            return "age", time, ()
        return cause, time, pairs[-1] if pairs else ()

    def _is_false(self, stop: str, pair: tuple[str, ...], held: Begun | None) -> bool:
        """Whether the twin never came nearer than the stated distance and 5 mm, with `pair` or bodies around the arm.

        The distance is that for the largest speed of the pair in the twin. Servo mode is always stopped.
        """
        if stop in ("", "age") or (held is not None and held.motion.kind is Kind.SERVO):
            return False
        simulation, world = self.block.simulation, self.block.world
        silent = self.stratum.silent and held is not None and "jog" in held.motion.kind
        known = pair if pair and set(pair) <= set(world.names) else ()
        speed = simulation.fastest(self.twin, (known[0], known[1])) if known and silent else 0.0
        concerned = ~world.inner | np.array([set(one) == set(known) for one in world.pairs])
        within = np.where(concerned, stated_distance(speed, silent) + _FALSE, 0.0)
        return not bool((simulation.clearances(self.twin, self.draw.shifts, within) < within).any())
