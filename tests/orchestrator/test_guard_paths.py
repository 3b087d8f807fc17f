"""Paths ahead in automatic operation: what is free, how fast the robot may go, and stops by the controller's law."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pytest
from guard_walls import boxes, distances, square, straight

from guard_motions import POLL, unit
from scancell.guard.check import RATE_SLOPE, PathCheck
from scancell.guard.parts import FreePath, NearPairs
from scancell.nominal.cell import NominalCell
from scancell.proximity.scene import ProximityScene, cell_scene

CONTACT = 1e-3  # m
MAX_AGE, CYCLE = 0.12, 0.016  # s
REACTION = MAX_AGE + 2 * CYCLE
AHEAD = 32
TICK = 0.002  # s


def deceleration() -> np.ndarray:
    return 0.95 * boxes().axis_max_acceleration


@dataclass(frozen=True)
class Line:
    """A path at constant rates (joints + 1,), rad/s, from `start` on, towards a wall that is `gap` (m) away."""

    start: np.ndarray
    rates: np.ndarray
    speed: float
    gap: float
    cell: NominalCell
    scene: ProximityScene

    def at(self, clock: np.ndarray) -> np.ndarray:
        return self.start + np.asarray(clock)[:, None] * self.rates

    def ahead(self, clock: float) -> np.ndarray:
        return self.at(clock + POLL * np.arange(AHEAD + 1))

    def nearest(self, clock: np.ndarray) -> np.ndarray:
        return distances(self.cell, self.scene, self.at(clock)).min(1)

    @cached_property
    def contact(self) -> float:
        """Path clock of the first contact, s; infinite: none within 4 s."""
        clock = np.linspace(0, 4, 4000)
        touching = self.nearest(clock) < CONTACT
        return float(clock[np.argmax(touching)]) if touching.any() else np.inf

    def check(self, reaction: float = REACTION) -> PathCheck:
        return PathCheck(free_path(self.cell, self.scene), reaction, deceleration())


def free_path(cell: NominalCell, scene: ProximityScene) -> FreePath:
    return FreePath(cell, scene, NearPairs(cell, scene.pairs, CONTACT, 0.0))


def on_path(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Measured axes without an error, and the path."""
    return points[0], points


def lines(rng: np.random.Generator, count: int, gaps: tuple[float, float] = (0.05, 0.2)) -> Iterator[Line]:
    """The sensor moves mostly square to the wall, at 0.1 to 0.6 m/s."""
    for axes, direction, gap, cell, scene in square(rng, gaps, count):
        aslant = direction + 0.4 * unit(rng)
        speed = float(rng.uniform(0.1, 0.6))
        yield Line(axes, straight(axes, speed * aslant / np.linalg.norm(aslant)), speed, gap, cell, scene)


def blocked(rng: np.random.Generator, count: int) -> Iterator[Line]:
    """Lines that lead to a contact after 1 to 4 s."""
    found = (line for line in lines(rng, 1000, (0.25, 0.3)) if 1.0 < line.contact < 4.0)
    return itertools.islice(found, count)


def test_free_path_ends_where_dense_sampling_finds_the_first_contact():
    """Never later, and earlier by at most a quarter of the spacing and 2 mm of way."""
    rng = np.random.default_rng(61)
    ended = 0
    dense = np.linspace(0, AHEAD * POLL, 4000)
    for line in lines(rng, 25):
        verdict = line.check().check(*on_path(line.ahead(0.0)), POLL, 1.0, 1.0)
        touching = line.nearest(dense) < CONTACT
        if not touching.any():
            assert verdict.clash is None
            assert verdict.free == pytest.approx(AHEAD * POLL)
            continue
        first = dense[np.argmax(touching)]
        assert verdict.clash is not None
        assert first - POLL / 4 - 2e-3 / line.speed <= verdict.free <= first
        ended += 1
    assert ended >= 15


def test_bends_between_points_take_room():
    """Half-way between points of a wave that curves towards the wall, the path is nearer than at the points."""
    rng = np.random.default_rng(62)
    line = next(iter(lines(rng, 1)))
    bent = line.ahead(0.0)
    bent[1::2] += 0.01
    plain, wavy = (line.check().check(*on_path(points), POLL, 1.0, 1.0).free for points in (line.ahead(0.0), bent))
    assert wavy < plain


def drive(line: Line, check: PathCheck, delay: float, duration: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Path clock, monitor speed and proof at each poll, of a controller that gets answers `delay` (s) late.

    Its rate follows the monitor speed by at most `RATE_SLOPE`.
    """
    clock, rate, monitor, rows = 0.0, 1.0, 1.0, []
    answers: list[tuple[float, float]] = []
    for k in range(round(duration / TICK)):
        time = k * TICK
        if k % round(POLL / TICK) == 0:
            in_force = max([monitor, *(speed for _, speed in answers)])
            verdict = check.check(*on_path(line.ahead(clock)), POLL, rate, in_force)
            rows.append((clock, verdict.monitor_speed, verdict.stop_is_proved))
            answers.append((time + delay, verdict.monitor_speed))
        while answers and answers[0][0] <= time:
            monitor = answers.pop(0)[1]
        rate += np.clip(monitor - rate, -RATE_SLOPE * TICK, RATE_SLOPE * TICK)
        clock += rate * TICK
    found = np.array(rows, float)
    return found[:, 0], found[:, 1], found[:, 2] > 0


@pytest.mark.parametrize("delay", [0.0, 0.05, MAX_AGE])
def test_robot_slows_down_gradually_and_waits_in_front_of_an_obstacle(delay):
    """Whatever the delay of answers: no emergency stop, the speed only falls, to 0, near to the wall but not at it."""
    rng = np.random.default_rng(63)
    for line in blocked(rng, 4):
        clock, speed, proved = drive(line, line.check(), delay, line.contact + 4.0)
        assert speed[0] == 1.0
        assert proved.all()
        assert (np.diff(speed) <= 0).all()
        assert speed[-1] == 0.0
        assert line.contact - 2 * POLL < clock[-1] < line.contact
        assert np.count_nonzero((speed < 1) & (speed > 0)) * POLL >= 0.4  # not at once


def test_speed_rises_again_when_the_path_is_clear():
    """The wall is taken away in front of the waiting robot, or the path leads away from it."""
    rng = np.random.default_rng(64)
    cell = boxes()
    free_scene = cell_scene(cell, {body.name: body.mesh for body in cell.bodies})
    without = PathCheck(free_path(cell, free_scene), REACTION, deceleration())
    # Lines on which no link is in the way behind the wall.
    through = (
        line
        for line in blocked(rng, 100)
        if without.check(*on_path(line.ahead(line.contact)), POLL, 0, 0).clash is None
    )
    for line in itertools.islice(through, 4):
        check = line.check()
        clock, speed, _ = drive(line, check, 0.0, line.contact + 2.0)
        assert speed[-1] == 0.0
        back = line.at(clock[-1] - POLL * np.arange(AHEAD))
        for verdict in (
            check.check(*on_path(back), POLL, 0.0, 0.0),
            without.check(*on_path(line.ahead(clock[-1])), POLL, 0.0, 0.0),
        ):
            assert (verdict.clash, verdict.monitor_speed, verdict.stop_is_proved) == (None, 1.0, True)


def test_speed_is_zero_below_the_minimum_free_path():
    """At rest with 10 ms of path clock to the wall: it waits, and a stop is proved."""
    rng = np.random.default_rng(67)
    for line in blocked(rng, 4):
        verdict = line.check().check(*on_path(line.ahead(line.contact - 0.01)), POLL, 0.0, 0.0)
        assert 0 <= verdict.free < 0.02
        assert (verdict.monitor_speed, verdict.stop_is_proved) == (0.0, True)


def test_end_of_a_motion_needs_no_free_space_beyond_it():
    """A path that ends within what is known is free however near the wall is; of one that goes on, that is unknown."""
    rng = np.random.default_rng(65)
    ended = 0
    for line in lines(rng, 20):
        braking, end = 0.3, min(line.contact - 5e-3 / line.speed, AHEAD * POLL * 0.8)
        if end < braking:
            continue
        time = np.minimum(POLL * np.arange(AHEAD + 1), end + braking / 2)
        points = line.at(time - np.maximum(time - end + braking / 2, 0) ** 2 / (2 * braking))
        ending = line.check().check(*on_path(points), POLL, 1.0, 1.0)
        assert (ending.clash, ending.free, ending.monitor_speed, ending.stop_is_proved) == (None, np.inf, 1.0, True)
        going_on = line.check().check(*on_path(points[:4]), POLL, 1.0, 1.0)
        assert going_on.free == pytest.approx(3 * POLL)
        assert not going_on.stop_is_proved
        ended += 1
    assert ended >= 5


def worst_stop(line: Line, rate: float, allowed: float) -> np.ndarray:
    """Path clock (n,) of the latest stop: the rate grows to `allowed` until the reaction time is over.

    At the start of a path it is that at once.
    """
    times = np.arange(0, REACTION, TICK)
    rates = np.minimum((rate or allowed) + RATE_SLOPE * times, max(allowed, rate))
    braking = (np.abs(line.rates) / deceleration()).max()  # s from the rate 1
    slowing = np.arange(rates[-1], 0, -TICK / braking)
    return np.cumsum(np.concatenate([rates, slowing])) * TICK


def collisions(reaction: float, seed: int) -> tuple[int, int, int]:
    """Stops proved, contacts among them, and contacts among the others, of random speeds and places."""
    rng = np.random.default_rng(seed)
    proved = collided = others = 0
    for line in lines(rng, 40, (0.02, 0.12)):
        check = line.check(reaction)
        for _ in range(3):
            rate = float(rng.choice([0.0, 1.0, rng.random()]))
            allowed = float(rng.uniform(rate, 1.0))
            clock = float(rng.uniform(0.0, 0.5) * line.gap / line.speed)
            verdict = check.check(*on_path(line.ahead(clock)), POLL, rate, allowed)
            hit = bool((line.nearest(clock + worst_stop(line, rate, allowed)) <= 0).any())
            proved += verdict.stop_is_proved
            collided += hit and verdict.stop_is_proved
            others += hit and not verdict.stop_is_proved
    return proved, collided, others


def test_stops_proved_are_free_in_the_worst_case():
    """With a quarter of the reaction time, robots would be released into walls."""
    proved, collided, others = collisions(REACTION, 66)
    assert collided == 0
    assert proved >= 40
    assert others >= 10
    assert collisions(REACTION / 4, 66)[1] >= 3
