"""Scenarios with a known unguarded outcome.

Contacts are found at full speed.  A slow motion to the same contact begins a short way before it, so that it arrives
within the time of a run at any speed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from scancell.cell.controller import Mode, Operation
from scancell.config.units import si_value, to_si
from scancell.studies.guard.jogs import BEGIN, Draws, Jog, line_move
from scancell.studies.guard.scenario import Command, Scenario, pressed
from scancell.studies.guard.simulation import MotionRecord, Simulation
from scancell.studies.guard.strata import THIRDS, Stratum

Array = NDArray[np.float64]

NEAR_MISS = 0.05  # m
_AFTER = 1.0  # s: a person who jogs at random collides later
_WITHIN_ARM = 0.3  # share of the contacts of two bodies of the arm that is kept: random motion finds many
_TOUCHING = 1e-3  # m
_STILL = 1e-6  # m: least change of the clearance of a pair that moves
_START_OUTSIDE, _START_INSIDE = 0.06, 0.015  # m: least clearances of a random start, to other bodies, within the arm
_TRIED = 60  # random axes
_DRAWS = 2000  # scenarios tried for a run
_SPARSE = 2  # samples of a rough course to each of a first look
_ROUGH = 0.01  # m by which bodies may be nearer between them
_SEEN = 0.1  # m: clearances are not looked for beyond
_LOOK = 4.0  # s of motion at full speed in which a contact is looked for
_LONGEST = (40.0, 15.0, 6.0)  # s, of a motion to a contact, by decade
_ORDINARY = (4.0, 4.0, 4.0)  # s, of a run without a near miss
_PERSON = 4.0  # s, of a run of a person who jogs at random
_AT_RANDOM = (0.0, 0.25, 0.5)  # share of random persons and programs among the colliding twins, by decade
_GAPS = (4e-3, 40e-3), (4e-3, 80e-3), (4e-3, 150e-3)  # m, of the start from the contact, by decade
_SILENT_GAP = 20e-3  # m: from nearer a controller that does not show its jogs may collide before the first answer
_STEPS = 64  # points between two samples of a rough course at which a start is looked for
_POINTS = 320  # at most
_TAIL = 0.5, 1.15  # s and share, by which runs last longer than the motion to the contact is estimated to take
_RESETS, _RESET_TIME = 40, 14.0  # of a person who insists, and the time for it, s
_PRESSES = 25
_BEYOND = 0.3, 0.05  # share of its length and rad by which a program continues behind a contact, at most


@dataclass(frozen=True)
class Twin:
    """A scenario without a guard: its course, the first contact, and the smallest distance to other bodies, m."""

    scenario: Scenario
    course: MotionRecord
    contact: tuple[float, str] | None
    clearance: float
    draws: int


@dataclass(frozen=True)
class _Approach:
    """A motion at full speed into a contact.

    Attributes
    ----------
    axes
        Points (n, joints + 1), rad, of its last part; the last one is in contact.
    times
        Time, s, that the motion takes from each to the last.
    distances
        Smallest distance (n,), m, of all pairs, at most `_SEEN`.
    jog, command
        What moves the robot.
    """

    axes: Array
    times: Array
    distances: Array
    jog: Jog | None
    command: Command | None


class Twins:
    """Draws scenarios by their outcome without a guard.

    Parameters
    ----------
    simulation
        The cell as it is.
    seed
        Of all of them.
    is_clear
        Whether a guard of the nominal cell lets the robot rest at axes (joints + 1,).
    """

    def __init__(self, simulation: Simulation, seed: int, is_clear: Callable[[Array], bool] = lambda _: True) -> None:
        self._simulation, self._seed, self._is_clear = simulation, seed, is_clear
        self._draws = Draws(simulation.nominal)

    def draw(self, stratum: Stratum) -> Twin:
        """The twin of a stratum.

        Raises
        ------
        RuntimeError
            If none of many scenarios is one.
        """
        rng = np.random.default_rng([self._seed, stratum.number, 0])
        for draws, scenario in enumerate(self._scenarios(stratum, rng), start=1):
            twin = scenario and self._twin(scenario, stratum.third, draws)
            if twin:
                return twin
            if draws == _DRAWS:
                break
        raise RuntimeError(f"run {stratum.number}: none of {_DRAWS} scenarios is one of '{stratum.third}'")

    def persons(self, number: int, duration: float, of_table: bool = False) -> Twin:
        """The twin with a number in which random jogs at full speed for `duration` s end in a collision.

        With `of_table` the operator jogs the table alone, in one direction.
        """
        draw = self._draws.table_jog if of_table else self._draws.person
        rng = np.random.default_rng([self._seed, number, 0])
        for draws in range(1, _DRAWS + 1):
            scenario = draw(self._start(rng), 1.0, duration, rng)
            twin = self._possible(scenario, THIRDS[0]) and self._twin(scenario, THIRDS[0], draws)
            if twin and twin.contact and twin.contact[0] >= _AFTER:
                return twin
        raise RuntimeError(f"run {number}: none of {_DRAWS} scenarios ends in a contact")

    def _twin(self, scenario: Scenario, third: str, draws: int) -> Twin | None:
        """The twin of a scenario, if it is one of its third."""
        simulation = self._simulation
        course = simulation.run(scenario)
        contact = simulation.contact(course) if course.touched else None
        if (contact is not None) != (third == THIRDS[0]) or (course.touched and contact is None):
            return None
        if course.rejected and scenario.operation is Operation.AUTOMATIC:
            return None
        clearance = simulation.clearance(course, _SEEN, rough=True)
        if contact is None and (clearance < NEAR_MISS) != (third == THIRDS[1]):
            return None
        return Twin(scenario, course, contact, clearance, draws)

    def _scenarios(self, stratum: Stratum, rng: np.random.Generator) -> Iterator[Scenario | None]:
        """Endless candidates for the scenario of a stratum; None: a rejected one."""
        manual = stratum.operation is Operation.MANUAL
        while True:
            speed = stratum.random_speed(rng)
            if stratum.third == THIRDS[2]:
                kind = self._draws.person if manual else self._draws.moves
                yield kind(self._start(rng), speed, _ORDINARY[stratum.decade], rng)
            elif rng.random() < _AT_RANDOM[stratum.decade] and stratum.third == THIRDS[0]:
                kind = self._draws.person if manual else self._draws.moves
                scenario = kind(self._start(rng), speed, _PERSON, rng)
                yield scenario if self._possible(scenario, stratum.third) else None
            else:
                approach = self._approach(manual, rng)
                if approach is None:
                    yield None
                    continue
                # What failed at one speed for want of room or time may succeed at another.
                for _ in range(4):
                    found = self._slow(approach, stratum, speed, rng)
                    yield found
                    if found is not None:
                        break
                    speed = stratum.random_speed(rng)

    def _possible(self, scenario: Scenario, third: str) -> bool:
        """Whether a first look at a scenario agrees with its third."""
        rough = self._simulation.run(scenario, rough=True)
        distances = self._distances(rough.axes[::_SPARSE], 2 * _ROUGH)
        return bool(distances.min() <= _ROUGH) == (third == THIRDS[0])

    def _distances(self, axes: Array, farthest: float = _SEEN) -> Array:
        """Smallest distance (n,), m, of all pairs, within 1 mm, at most `farthest`; within the arm at most 10 mm."""
        bounds = np.where(self._simulation.inner, _ROUGH + 1e-6, farthest)
        found = self._simulation.clearances(axes, bounds, rough=True)
        return np.asarray(np.where((found < bounds) & ~self._is_rigid, found, farthest).min(1))

    @cached_property
    def _at_random(self) -> Array:
        """Clearances (n, pairs), m, at random axes, at most twice the least ones of a start."""
        rng = np.random.default_rng(0)
        axes = np.array([self._draws.start(rng) for _ in range(_TRIED)])
        return self._simulation.clearances(axes, 2 * self._least_apart, rough=True)

    @cached_property
    def _least_apart(self) -> Array:
        return np.where(self._simulation.inner, _START_INSIDE, _START_OUTSIDE)

    @cached_property
    def _least(self) -> Array:
        """Least clearances (pairs,), m, of a start: smaller for pairs that are always near each other."""
        return np.asarray(np.minimum(self._least_apart, self._at_random.max(0) / 2))

    @cached_property
    def _is_rigid(self) -> NDArray[np.bool_]:
        """Which pairs (pairs,) are near each other and stay as they are, such as a gripper and its finger."""
        found = self._at_random
        return np.asarray((np.ptp(found, axis=0) < _STILL) & (found[0] < self._least_apart))

    def _start(self, rng: np.random.Generator) -> Array:
        while True:
            start = self._draws.start(rng)
            if (self._simulation.clearances(start[None], self._least, rough=True)[0] >= self._least).all():
                return start

    def _approach(self, manual: bool, rng: np.random.Generator) -> _Approach | None:
        """A random motion at full speed into a contact; None: it does not lead to one."""
        start = self._start(rng)
        jog = self._draws.jog(rng) if manual else None
        command = None if jog else self._draws.move(start, 1.0, rng)
        if jog:
            scenario = pressed(start, jog.mode, jog.values, jog.frame, _LOOK)
        else:
            assert command is not None
            scenario = Scenario(Operation.AUTOMATIC, start, (command,), _LOOK)
        course = self._simulation.run(scenario, rough=True)
        near = np.flatnonzero(self._distances(course.axes[::_SPARSE], 2 * _ROUGH) <= _ROUGH)
        if not len(near):
            return None
        last = min(int(near[0] + 1) * _SPARSE, len(course.axes) - 1)
        first = max(last - _POINTS // _STEPS, 0)
        approach = self._before_contact(course.axes[first : last + 1], jog, command)
        rare = rng.random() < _WITHIN_ARM
        return approach if approach and (rare or self._is_outside(approach.axes[-1])) else None

    def _is_outside(self, contact: Array) -> bool:
        """Whether the arm touches another body at axes (joints + 1,)."""
        found = self._simulation.clearances(contact[None], _TOUCHING, rough=True)[0]
        return bool((found[~self._simulation.inner] <= 0.0).any())

    def _before_contact(self, axes: Array, jog: Jog | None, command: Command | None) -> _Approach | None:
        """The part of a motion through samples (n, joints + 1) that ends with its first contact."""
        share = np.arange(0, len(axes) - 1 + 1e-9, 1 / _STEPS)
        numbers = np.arange(len(axes))
        fine = np.stack([np.interp(share, numbers, column) for column in axes.T], 1)
        distances = self._distances(fine)
        touching = np.flatnonzero(distances <= 0.0)
        if not len(touching) or touching[0] == 0:
            return None
        end = int(touching[0])
        fine, distances = fine[: end + 1], distances[: end + 1]
        step = self._step_times(fine, jog, command)
        times = np.append(np.cumsum(step[::-1])[::-1], 0.0)
        return _Approach(fine, times, distances, jog, command)

    def _step_times(self, axes: Array, jog: Jog | None, command: Command | None) -> Array:
        """Times (n - 1,), s, that the motion through axes (n, joints + 1) takes at full speed, once accelerated."""
        nominal, robot = self._simulation.nominal, self._simulation.description.robot
        motion, limits = robot.motion, to_si(robot.motion.model_dump())
        turned = np.abs(np.diff(axes, axis=0))
        line = command is not None and command.mode is Mode.LINE_MOVE
        if line or (jog and jog.mode is Mode.CARTESIAN_JOG and jog.values[:6].any()):
            sensor = nominal.world_from_sensor(axes[:, :-1])
            moved = np.linalg.norm(np.diff(sensor[:, :3, 3], axis=0), axis=1)
            change = np.swapaxes(sensor[:-1, :3, :3], -1, -2) @ sensor[1:, :3, :3]
            angle = np.arccos(np.clip((np.trace(change, axis1=1, axis2=2) - 1) / 2, -1.0, 1.0))
            speeds = ("line_speed", "turn_speed") if line else ("jog_speed", "jog_turn_speed")
            return np.asarray(np.maximum(moved / limits[speeds[0]], angle / limits[speeds[1]]))
        share = motion.jog_joint_share if jog else 1.0
        return np.asarray((turned / (share * nominal.axis_max_speed)).max(1))

    def _slow(self, approach: _Approach, stratum: Stratum, speed: float, rng: np.random.Generator) -> Scenario | None:
        """The motion at a share of the full speed, from a random place before the contact."""
        low, high = _GAPS[stratum.decade]
        low = max(low, _SILENT_GAP) if stratum.silent and approach.jog else low
        near_miss = stratum.third == THIRDS[1]
        high = min(high, NEAR_MISS) if near_miss else high
        gap = low * (high / low) ** rng.random()
        begin = BEGIN + speed * _acceleration_time(self._simulation)
        within = approach.times / speed <= _LONGEST[stratum.decade] - begin
        far = np.flatnonzero(within & (approach.distances >= gap))
        first = int(far[-1]) if len(far) else int(np.argmax(within))
        start = approach.axes[first]
        if approach.distances[first] < low or not self._is_clear(start):
            return None
        duration = _TAIL[0] + _TAIL[1] * (begin + float(approach.times[first]) / speed)
        if approach.jog is None:
            end = self._end_of_near_miss(approach, first, rng) if near_miss else len(approach.axes) - 1
            return None if end is None else self._moved(approach, first, end, speed, duration, near_miss)
        if near_miss:
            return self._missed(approach, first, speed, duration, rng)
        return _insisted(approach.jog, start, speed, duration, _LONGEST[stratum.decade], stratum.silent, rng)

    def _end_of_near_miss(self, approach: _Approach, first: int, rng: np.random.Generator) -> int | None:
        """Number of the point at which a motion from the `first` one ends before the contact."""
        nearest = rng.uniform(0.1, 0.9) * min(approach.distances[first], NEAR_MISS)
        behind = np.flatnonzero(approach.distances[first:] <= nearest)
        end = first + int(behind[0]) if len(behind) else first
        return end if first < end < len(approach.axes) - 1 else None

    def _moved(
        self, approach: _Approach, first: int, end: int, speed: float, duration: float, ends: bool
    ) -> Scenario | None:
        """An automatic motion from a point of an approach to another, or through it."""
        given, start, last = approach.command, approach.axes[first], approach.axes[end]
        assert given is not None
        if given.mode is Mode.PROGRAM:
            way = last - start
            middle = approach.axes[(first + end) // 2]
            size = float(np.linalg.norm(way))
            behind = [] if ends or size == 0.0 else [last + min(_BEYOND[0], _BEYOND[1] / size) * way]
            command = self._draws.program([start, middle, last, *behind], speed)
            duration = max(duration, len(command.values) * self._simulation.cycle + BEGIN)
            if duration > 1.5 * _LONGEST[0]:
                return None
        elif not ends:
            command = replace(given, speed=speed)
        elif given.mode is Mode.LINE_MOVE:
            command = line_move(self._simulation.nominal.world_from_sensor(last[:-1]), float(last[-1]), speed)
        else:
            command = replace(given, values=last, speed=speed)
        return Scenario(Operation.AUTOMATIC, start, (command,), duration, speed)

    def _missed(
        self, approach: _Approach, first: int, speed: float, duration: float, rng: np.random.Generator
    ) -> Scenario:
        """An operator who releases the jog before the contact, retreats, or jogs in another direction."""
        jog, start = approach.jog, approach.axes[first]
        assert jog is not None
        kind = rng.random()
        if kind < 0.5:
            share = rng.uniform(0.1, 0.9)
            begin = BEGIN + speed * _acceleration_time(self._simulation)
            end = begin + share * float(approach.times[first]) / speed
            scenario = pressed(start, jog.mode, jog.values * speed, jog.frame, end + 1.0, [(BEGIN, 1.0), (end, 0.0)])
            return replace(scenario, speed=speed)
        duration = min(duration, _ORDINARY[0])
        if kind > 0.75:
            jog = self._draws.jog(rng)
        turned = -1.0 if kind <= 0.75 else 1.0
        return pressed(start, jog.mode, turned * speed * jog.values, jog.frame, duration, speed=speed)


def _acceleration_time(simulation: Simulation) -> float:
    """Time, s, that a jog of the tool needs to its full speed."""
    motion = simulation.description.robot.motion
    return si_value(motion, "jog_speed_mm_s") / si_value(motion, "jog_acceleration_mm_s2")


def _insisted(
    jog: Jog, start: Array, speed: float, duration: float, longest: float, silent: bool, rng: np.random.Generator
) -> Scenario:
    """An operator who jogs into a contact: continuously, with pauses, or to and fro, perhaps again after each stop."""
    kind = rng.random()
    presses = [(BEGIN, 1.0)]
    if kind > 0.5:
        # Each stroke is followed by a pause, or by one in the other direction.
        back = -1.0 if kind > 0.75 else 0.0
        stroke = max(float(rng.uniform(0.1, 1.0)), duration / _PRESSES)
        other = float(rng.uniform(0.2, 0.6)) * stroke
        gained = (stroke + back * other) / (stroke + other)
        if duration / gained <= 1.5 * longest:
            duration /= gained
            times = np.arange(BEGIN, duration, stroke + other)
            presses = [pair for time in times for pair in ((float(time), 1.0), (float(time + stroke), back))]
    # What a controller that does not show its jogs moves before the first answer adds up over the resets.
    resets = _RESETS if rng.random() < 0.3 and not silent else 0
    duration = max(duration, _RESET_TIME) if resets else duration
    return pressed(start, jog.mode, speed * jog.values, jog.frame, duration, presses, speed, resets)
