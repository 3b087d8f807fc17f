"""Many runs with a guard over a bad network, each beside its twin without a guard.

A third of the twins collides, another third has near misses, the others do ordinary work; manual and automatic
operation and the faults of the network take turns.  Everything follows from the campaign's seed and the number of a
run, so that campaigns can be interrupted, and single runs repeated.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scancell.cell.controller import Operation
from scancell.closing import Closing
from scancell.config.channel import ChannelDescription, LinkDescription
from scancell.config.units import si_value
from scancell.guard.guard import Guard
from scancell.guard.settings import GuardSettings
from scancell.guard.stopping import braking_time
from scancell.guard.unseen import UnseenApproach, jog_limits
from scancell.proximity.motion_bounds import MotionBounds
from scancell.studies.guard.guarded import GuardedRuns
from scancell.studies.guard.simulation import SAMPLES, Course, Simulation
from scancell.studies.guard.twins import THIRDS, Twin, Twins

Array = NDArray[np.float64]

_DURATION = 4.0  # s, of a run
_SEEN = 0.06  # m: clearances of guarded runs are not looked for beyond
_SLOW = ChannelDescription(delay_ms=4.0, jitter_ms=2.0)


def _both(name: str, **faults: float) -> tuple[str, LinkDescription]:
    channel = _SLOW.model_copy(update=faults)
    return name, LinkDescription(to_guard=channel, to_cell=channel)


FAULTS: dict[str, LinkDescription] = dict(
    [
        _both("none", delay_ms=0.0, jitter_ms=0.0),
        _both("delay"),
        _both("jitter", jitter_ms=10.0),
        _both("loss", loss=0.05),
        _both("bursts", burst=0.01, burst_packets=4.0),
        _both("reordering", jitter_ms=20.0),
        _both("duplication", duplication=0.3, replay=0.1, replay_ms=300.0),
        ("clock", LinkDescription(to_guard=_SLOW, to_cell=_SLOW, clock_offset_ms=-700.0, clock_drift_ppm=2000.0)),
        ("stale", LinkDescription(to_guard=_SLOW, to_cell=_SLOW, stale=0.2)),
        ("dead", LinkDescription(to_guard=_SLOW, to_cell=_SLOW)),
    ]
)


@dataclass(frozen=True)
class RunRow:
    """Outcome of a run.

    Attributes
    ----------
    number, third, operation, fault, draws
        Which run, and how many scenarios were drawn until the twin did what its third does.
    twin_contact_at, twin_contact
        Of the twin, s and pair; NaN and empty: none.
    twin_clearance
        Smallest distance of the arm to other bodies in the twin, m, within 1 mm, at most about 0.1.
    contact, touched
        Pair that python-fcl finds in contact in the guarded run; whether the cell's own outputs reported one.
    clearance
        Smallest distance of the arm to other bodies in the guarded run, m, at most 0.06.
    stop, stop_at, stopped_pair
        What stopped the robot: ``guard``, ``age`` of the last answer, or nothing; when, s, and for which pair.
    false_stop
        Whether the twin never came near what the guard stopped for.
    halted
        Whether the robot waits on its path for a monitor speed above 0.
    warnings, warned_retreating
        Answers with a warning, and those whose pair did not approach.
    twin_arrived_at, arrived_at
        Times at which the program was done, s; NaN: not.
    """

    number: int
    third: str
    operation: str
    fault: str
    draws: int
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


class Campaign(Closing):
    """Runs of a campaign.

    Parameters
    ----------
    simulation
        The cell.
    guard
        Its guard.
    seed
        Of the campaign.
    """

    def __init__(self, simulation: Simulation, guard: Guard, seed: int) -> None:
        self._simulation, self._seed = simulation, seed
        self._twins = Twins(simulation, seed, _DURATION)
        self._guarded = GuardedRuns(simulation, guard)
        self._distance = stopping_distances(simulation, guard.settings)

    def close(self) -> None:
        """Free the cell."""
        self._simulation.close()

    def run(self, number: int) -> RunRow:
        """Run number `number`."""
        third = THIRDS[number % len(THIRDS)]
        operation = Operation(number // len(THIRDS) % 2)
        fault = list(FAULTS)[number // (2 * len(THIRDS)) % len(FAULTS)]
        twin = self._twins.draw(number, third, operation)
        course = self._guarded.run(twin.scenario, *self._network(number, fault))
        return self._row(number, third, fault, twin, course)

    def _network(self, number: int, fault: str) -> tuple[LinkDescription, int]:
        """Faults and their seed."""
        rng = np.random.default_rng([self._seed, number, 1])
        description, seed = FAULTS[fault], int(rng.integers(2**32))
        if fault == "dead":
            dead = description.to_cell.model_copy(update={"dead_from_s": float(rng.uniform(0.5, 3.0))})
            description = description.model_copy(update={"to_cell": dead})
        return description, seed

    def _row(self, number: int, third: str, fault: str, twin: Twin, course: Course) -> RunRow:
        simulation = self._simulation
        contact = simulation.contact(course)
        stop, pair = self._stop_of(course)
        warnings = list(self._warnings(course, FAULTS[fault]))
        return RunRow(
            number,
            third,
            twin.scenario.operation.name.lower(),
            fault,
            twin.draws,
            twin.contact[0] if twin.contact else np.nan,
            twin.contact[1] if twin.contact else "",
            twin.clearance,
            contact[1] if contact else "",
            course.touched,
            simulation.clearance(course, _SEEN),
            stop,
            course.stopped_at if course.stopped_at is not None else np.nan,
            " - ".join(pair),
            stop == "guard" and not self._was_near(twin, pair),
            stop == "" and course.rate == 0 and course.arrived_at is None and twin.course.arrived_at is not None,
            len(warnings),
            sum(not approaches for approaches in warnings),
            np.nan if twin.course.arrived_at is None else twin.course.arrived_at,
            np.nan if course.arrived_at is None else course.arrived_at,
        )

    def _was_near(self, twin: Twin, pair: tuple[str, ...]) -> bool:
        """Whether a twin came nearer than the worst-case stopping distance and 10 mm, with `pair` or another body.

        On a path that is known, nothing but a contact is a reason to stop: there the distance is 0.
        """
        simulation = self._simulation
        manual = twin.scenario.operation is Operation.MANUAL
        concerned = ~simulation.inner | np.array([found == pair for found in simulation.scene.pairs])
        within = np.where(concerned, (self._distance if manual else 0.0) + 0.01, 0.0)
        return bool((simulation.clearances(twin.course.axes[::SAMPLES], within, rough=True) < within).any())

    def _stop_of(self, course: Course) -> tuple[str, tuple[str, ...]]:
        """What stopped the robot, and the pair for which the guard did."""
        if course.stopped_at is None:
            return "", ()
        if not any(answer.emergency_stop and time <= course.stopped_at + 1e-9 for time, answer in course.answers):
            return "age", ()
        return "guard", next(decision.pair for _, decision in self._guarded.log if decision.stop)

    def _warnings(self, course: Course, link: LinkDescription) -> Iterator[bool]:
        """Whether the pair of each warning truly approached when the state was measured."""
        pairs = self._simulation.scene.pairs
        for shown, decision in self._guarded.log:
            if "contact in" in decision.text:
                time = (shown - 1e-3 * link.clock_offset_ms) / (1 + 1e-6 * link.clock_drift_ppm)
                at = int(np.searchsorted(course.times, time - 1e-9))
                near = course.axes[[max(at - 1, 0), min(at + 1, len(course.axes) - 1)]]
                concerned = np.array([pair == decision.pair for pair in pairs])
                before, after = self._simulation.distances_of(concerned, near)
                yield bool(after < before)


def stopping_distances(simulation: Simulation, settings: GuardSettings) -> Array:
    """Worst-case stopping distance (pairs,), m, by hand of the pairs of a simulation's scene.

    The tool moves at its jog speed for the reaction time, accelerates all the while, and brakes as long as its slowest
    axis does. Bodies of the arm approach each other by what the joints between them do in that time, if that is less.
    """
    nominal, robot = simulation.nominal, simulation.description.robot
    limits = jog_limits(robot, nominal)
    rates = robot.motion.jog_joint_share * nominal.axis_max_speed
    braking = braking_time(rates, settings.deceleration * nominal.axis_max_acceleration)
    longest = settings.reaction + braking / 2
    time_squared = settings.reaction**2 + settings.reaction * braking
    pairs = simulation.scene.pairs
    changed = UnseenApproach(nominal, pairs, limits).bound(np.append(nominal.home, 0.0), time_squared)
    by_joints = MotionBounds(nominal, pairs).pairs(np.append(nominal.home, 0.0)[None], (rates * longest)[None])[0]
    by_tool = si_value(robot.motion, "jog_speed_mm_s") * longest
    return np.asarray(np.where(simulation.inner, np.minimum(by_joints, by_tool), by_tool) + changed)
