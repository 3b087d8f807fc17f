"""Paired runs with and without a guard, over a bad network.

A third of the twins without a guard collides, another third has near misses, the others do ordinary work, in every
decade of speed, by hand and in automatic operation.  Cells, parts, network faults and geometry errors alternate.
Everything follows from the campaign's seed and the number of a run, so that campaigns can be
interrupted, and single runs repeated.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scancell.cell.controller import Operation
from scancell.closing import Closing
from scancell.config.cell import CellDescription
from scancell.config.channel import LinkDescription
from scancell.geometry.mesh import Mesh
from scancell.guard.guard import Guard
from scancell.studies.guard.simulation import GuardedRuns, MotionRecord, Protection, Simulation
from scancell.studies.guard.strata import DECADES, FAULTS, Stratum, random_network, stratum_of
from scancell.studies.guard.twins import Twin, Twins
from scancell.studies.guard.worlds import KnownWorld, known_world, world_of

Array = NDArray[np.float64]

_SEEN = 0.06  # m: clearances of guarded runs are not looked for beyond
_KNOWN = 8  # cells with a part that are kept
_FALSE = 5e-3  # m beyond the stated distance
_HELD = 0.1  # rate of the path clock: a robot slows down more and more before an obstacle on its path
_LATER = 1.25  # factor on the duration of the twin, for a motion that the guard slows down on a path to a contact
_ON_PATH = 5e-3  # m: distance at which a motion on a known path is stopped at most

# Distance, m, at which a robot that is jogged towards a body comes to rest (docs/guard.md): with a controller that
# predicts and limits jogs, and with one that does not, by the speed, m/s.
_SHOWN = 0.005
_SILENT = ((0.0, 0.030), (0.005, 0.030), (0.0125, 0.031), (0.025, 0.033), (0.05, 0.036), (0.125, 0.049), (0.25, 0.072))


def stated_distance(speed: float, silent: bool) -> float:
    """Largest distance, m, at which the guard stops a jog of `speed`, m/s; in proportion beyond the last one."""
    if not silent:
        return _SHOWN
    speeds, distances = np.transpose(_SILENT)
    return float(np.interp(speed, speeds, distances) * max(1.0, speed / speeds[-1]))


@dataclass(frozen=True)
class RunRow:
    """Outcome of a run.

    Attributes
    ----------
    number, third, operation, decade, fault, cell, part, silent, draws
        Stratum of the run, and the number of scenarios drawn until the twin had the outcome of its third.
    speed
        Largest share of the full speed.
    motion
        How the robot is moved: the modes of the controller, and `+ resets` if the operator resets it after stops.
    twin_contact_at, twin_contact
        Of the twin, s and pair; NaN and empty: none.
    twin_clearance
        Smallest distance of the arm to other bodies in the twin, m, within 1 mm, at most about 0.1.
    contact, touched
        Pair that python-fcl finds in contact in the guarded run; whether the cell's own outputs reported one.
    clearance
        Smallest distance of the arm to other bodies in the guarded run, m, at most 0.06.
    stop, stop_at, stopped_pair
        First cause that held the robot: a stop by the ``guard``, by the ``age`` of the last answer, a jog held at rest
        (``refused``), or none; its time, s, and its pair.
    false_stop
        Whether the twin never came near what the guard stopped for.
    halted
        Whether the guard has slowed the robot without a stop: a jog at any time, or a motion on a path at the end to at
        most a tenth of its speed.
    warnings, warned_retreating
        Answers with a warning, and those whose pair did not approach.
    twin_arrived_at, arrived_at
        Times at which the program was done, s; NaN: not.
    """

    number: int
    third: str
    operation: str
    decade: str
    fault: str
    cell: str
    part: str
    silent: bool
    draws: int
    speed: float
    motion: str
    twin_contact_at: float
    twin_contact: str
    twin_clearance: float
    contact: str
    touched: bool
    clearance: float
    stop: str
    stop_at: float
    stopped_pair: str
    false_stop: bool
    halted: bool
    warnings: int
    warned_retreating: int
    twin_arrived_at: float
    arrived_at: float

    @property
    def collided(self) -> bool:
        """Whether the guarded robot collided, by either judge."""
        return bool(self.contact) or self.touched


class Campaign(Closing):
    """Runs of a campaign.

    Parameters
    ----------
    cells
        Descriptions by name, which alternate.
    parts
        Meshes by name, m, one of which is on the table.
    seed
        Of the campaign.
    protection
        Error of the guard.
    folder
        For the files of the FMU; None: where the system keeps temporary files.
    """

    def __init__(
        self,
        cells: Mapping[str, CellDescription],
        parts: Mapping[str, Mesh],
        seed: int,
        protection: Protection | None = None,
        folder: Path | None = None,
    ) -> None:
        self._cells, self._parts, self._seed, self._folder = cells, parts, seed, folder
        self._protection = protection or Protection()
        self._known = lru_cache(_KNOWN)(lambda cell, part: known_world(cells[cell], parts[part]))
        self._guard = lru_cache(_KNOWN)(self._made_guard)
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
        twin = block.twins.draw(stratum)
        rng = np.random.default_rng([self._seed, number, 1])
        network = random_network(stratum.fault, twin.scenario.duration, rng)
        longer = _LATER if twin.contact and stratum.operation is Operation.AUTOMATIC else 1.0
        course = block.guarded.run(replace(twin.scenario, duration=longer * twin.scenario.duration), *network)
        return _Pair(block, stratum, twin, course, network[0]).row()

    def _block_of(self, stratum: Stratum) -> _Block:
        if self._block is None or self._block.number != stratum.block:
            self.close()
            rng = np.random.default_rng([self._seed, stratum.block, 2])
            turn = stratum.block + stratum.block // len(FAULTS)
            cell = list(self._cells)[turn % len(self._cells)]
            part = str(rng.choice(list(self._parts)))
            known = self._known(cell, part)
            described, nominal = world_of(known, rng)
            simulation = Simulation(described, nominal, known.ignored, self._folder, not stratum.silent)
            twins = Twins(simulation, self._seed, known.is_clear)
            guard = self._guard(cell, part)
            patience = self._protection.patience * guard.settings.max_age
            guarded = GuardedRuns(simulation, guard, patience, self._protection.link)
            self._block = _Block(stratum.block, cell, part, known, simulation, twins, guarded)
        return self._block

    def _made_guard(self, cell: str, part: str) -> Guard:
        known = self._known(cell, part)
        return known.guard(self._protection.guard, self._protection.assumed(known.settings))


@dataclass(frozen=True)
class _Block:
    """Runs with one cell."""

    number: int
    cell: str
    part: str
    known: KnownWorld
    simulation: Simulation
    twins: Twins
    guarded: GuardedRuns


@dataclass(frozen=True)
class _Pair:
    """A run and its twin."""

    block: _Block
    stratum: Stratum
    twin: Twin
    course: MotionRecord
    link: LinkDescription

    def row(self) -> RunRow:
        """Outcome of the run."""
        simulation, twin, course, stratum = self.block.simulation, self.twin, self.course, self.stratum
        contact = simulation.contact(course)
        stop, stop_at, pair = self._stop()
        warnings = list(self._warnings())
        modes = dict.fromkeys(command.mode.name.lower() for command in twin.scenario.commands)
        return RunRow(
            stratum.number,
            stratum.third,
            twin.scenario.operation.name.lower(),
            DECADES[stratum.decade],
            stratum.fault,
            self.block.cell,
            self.block.part,
            stratum.silent,
            twin.draws,
            twin.scenario.speed,
            " + ".join([*modes, *(["resets"] if twin.scenario.resets else [])]),
            twin.contact[0] if twin.contact else np.nan,
            twin.contact[1] if twin.contact else "",
            twin.clearance,
            contact[1] if contact else "",
            course.touched,
            simulation.clearance(course, _SEEN),
            stop,
            stop_at,
            " - ".join(pair),
            stop in ("guard", "refused") and not self._was_near(pair),
            stop == "" and self._is_slowed(),
            len(warnings),
            sum(not approaches for approaches in warnings),
            np.nan if twin.course.arrived_at is None else twin.course.arrived_at,
            np.nan if course.arrived_at is None else course.arrived_at,
        )

    def _stop(self) -> tuple[str, float, tuple[str, ...]]:
        """First cause that held the robot, its time, s, and the pair for which the guard did."""
        course, log = self.course, self.block.guarded.log
        stopped = np.inf if course.stopped_at is None else course.stopped_at
        if course.refused_at is not None and course.refused_at < stopped:
            held = (decision for _, decision in log if decision.monitor_speed == 0.0 and not decision.stop)
            return "refused", course.refused_at, next((decision.pair for decision in held), ())
        if stopped == np.inf:
            return "", np.nan, ()
        if not any(answer.emergency_stop and time <= stopped + 1e-9 for time, answer in course.answers):
            return "age", stopped, ()
        return "guard", stopped, next((decision.pair for _, decision in log if decision.stop), ())

    def _is_slowed(self) -> bool:
        """Whether the guard has slowed the robot: a jog at any time, a motion on a path to a tenth at the end."""
        if self.stratum.operation is Operation.AUTOMATIC:
            return self.course.rate <= _HELD and self.course.arrived_at is None
        return any(decision.beep for _, decision in self.block.guarded.log)

    def _was_near(self, pair: tuple[str, ...]) -> bool:
        """Whether the twin came nearer than the stated distance and 5 mm, with `pair` or a body around the arm.

        The distance is that for the largest speed of the pair in the twin.  On a path that is known nothing but a
        contact is a reason to stop.
        """
        simulation, course = self.block.simulation, self.twin.course
        distance = _ON_PATH
        if self.twin.scenario.operation is Operation.MANUAL:
            speed = simulation.fastest(course, (pair[0], pair[1])) if pair else 0.0
            distance = stated_distance(speed, self.stratum.silent)
        concerned = ~simulation.inner | np.array([found == pair for found in simulation.scene.pairs])
        within = np.where(concerned, distance + _FALSE, 0.0)
        axes = course.axes[course.spaced(1e-3)]
        return bool((simulation.clearances(axes, within, rough=True) < within).any())

    def _warnings(self) -> Iterator[bool]:
        """Whether the pair of each warning truly approached when the state was measured."""
        simulation, course, link = self.block.simulation, self.course, self.link
        for shown, decision in self.block.guarded.log:
            if "contact in" in decision.text:
                time = (shown - 1e-3 * link.clock_offset_ms) / (1 + 1e-6 * link.clock_drift_ppm)
                at = int(np.searchsorted(course.times, time - 1e-9))
                near = course.axes[[max(at - 1, 0), min(at + 1, len(course.axes) - 1)]]
                concerned = np.array([pair == decision.pair for pair in simulation.scene.pairs])
                before, after = simulation.distances_of(concerned, near)
                yield bool(after < before)
