"""Scenarios of which it is known what comes of them without a guard."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scancell.cell.controller import Operation
from scancell.studies.guard.scenario import Scenario, random_scenario, random_start
from scancell.studies.guard.simulation import Course, Simulation

Array = NDArray[np.float64]

THIRDS = ("collision", "near miss", "ordinary")
_AFTER = 1.0  # s: twins that collide do it later
_NEAR_MISS = 0.05  # m
_START_OUTSIDE, _START_INSIDE = 0.06, 0.015  # m: least clearances at the start, to other bodies and within the arm
_DRAWS = 1000  # scenarios tried for a run
_SPARSE = 8  # cycles between the samples of a first look
_ROUGH = 0.01  # m by which bodies may be nearer between them
_SEEN = 0.1  # m: clearances are not looked for beyond


@dataclass(frozen=True)
class Twin:
    """A scenario without a guard: its course, the first contact, and the smallest distance to other bodies, m."""

    scenario: Scenario
    course: Course
    contact: tuple[float, str] | None
    clearance: float
    draws: int


class Twins:
    """Draws scenarios by what comes of them without a guard.

    Parameters
    ----------
    simulation
        The cell.
    seed
        Of all of them.
    duration
        Of a run, s.
    """

    def __init__(self, simulation: Simulation, seed: int, duration: float) -> None:
        self._simulation, self._seed, self._duration = simulation, seed, duration

    def draw(self, number: int, third: str, operation: Operation) -> Twin:
        """The twin with this number that does what its `third` says.

        Raises
        ------
        RuntimeError
            If none of many scenarios does.
        """
        simulation, inner = self._simulation, self._simulation.inner
        looked = np.where(inner, _ROUGH, _NEAR_MISS + _ROUGH)
        rng = np.random.default_rng([self._seed, number, 0])
        for draws in range(1, _DRAWS + 1):
            scenario = random_scenario(operation, simulation.nominal, self._start(rng), self._duration, rng)
            rough = simulation.run(scenario, rough=True)
            least = simulation.clearances(rough.axes[::_SPARSE], looked, rough=True)
            outside = least[:, ~inner].min(1)
            # What the twin can be by this first look; a course into a contact is ended before it for a near miss.
            possible = {
                THIRDS[0]: outside.min() <= _ROUGH or (least[:, inner] < _ROUGH).any(),
                THIRDS[1]: outside.min() <= _NEAR_MISS,
                THIRDS[2]: outside.min() >= _NEAR_MISS,
            }
            if not possible[third]:
                continue
            if third == THIRDS[1] and outside.min() < _ROUGH:
                scenario = _ended_before(scenario, rough, outside, rng)
            course = simulation.run(scenario)
            clearance = simulation.clearance(course, _SEEN, rough=True)
            contact = simulation.contact(course) if course.touched else None
            if contact is None:
                found = THIRDS[1 if clearance < _NEAR_MISS else 2]
            else:
                found = THIRDS[0] if contact[0] >= _AFTER else ""
            if found == third:
                return Twin(scenario, course, contact, clearance, draws)
        raise RuntimeError(f"run {number}: none of {_DRAWS} scenarios is one of '{third}'")

    def _start(self, rng: np.random.Generator) -> Array:
        simulation = self._simulation
        least = np.where(simulation.inner, _START_INSIDE, _START_OUTSIDE)
        while True:
            start = random_start(simulation.nominal, rng)
            if (simulation.clearances(start[None], least)[0] >= least).all():
                return start


def _ended_before(scenario: Scenario, course: Course, clearance: Array, rng: np.random.Generator) -> Scenario:
    """A scenario that ends in a random near miss of its `course`; `clearance` (m) is that of its sparse samples."""
    near = max(rng.uniform(0.1, 0.9) * _NEAR_MISS, clearance.min())
    after = int(np.argmax(clearance <= near))
    at = round(_SPARSE * np.interp(-near, -clearance[after - 1 : after + 1], [after - 1, after]))
    time = float(course.times[at])
    given = [command for command in scenario.commands if command.time < time]
    if scenario.operation is Operation.MANUAL and given:
        last = replace(given[-1], time=time, values=np.zeros_like(given[-1].values))
        return replace(scenario, commands=(*given, last))
    return replace(scenario, commands=(replace(scenario.commands[0], values=course.axes[at]),))
