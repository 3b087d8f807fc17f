"""Contacts ahead and proved stops, against dense sampling of true motions near walls, in a cell of boxes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from guard_walls import behind_wall, boxes, distances, is_clear, near_home, square, straight

from guard_motions import KINDS, NOISE, POLLS, Motion, random_motion, stopping_motion, unit
from scancell.guard.check import ManualCheck
from scancell.guard.endpoints import Identifier
from scancell.guard.parts import JogLimits, NearPairs, Tool
from scancell.guard.stopping import Hypothesis, MeasuredState, Path, WorstCase
from scancell.nominal.cell import NominalCell
from scancell.proximity.scene import ProximityScene

DECELERATION = np.radians([800.0, 800.0, 800.0, 900.0, 900.0, 1600.0, 340.0])
WORST = WorstCase(age=0.02, period=0.032, delay=0.04, deceleration=DECELERATION, angle_error=5 * NOISE)
CONTACT = 0.5e-3  # m
HORIZON = 0.5  # s
TICK = 0.004  # s


def manual_check(cell: NominalCell, scene: ProximityScene, worst: WorstCase) -> ManualCheck:
    return ManualCheck(cell, scene, NearPairs(cell, scene.pairs, CONTACT, worst.angle_error), worst, HORIZON)


def hypothesis_of(axes: np.ndarray, rates: np.ndarray) -> Hypothesis:
    return Hypothesis(Path.BASE, MeasuredState(0.0, axes), rates, np.zeros(7), 0.032)


def walled(rng: np.random.Generator, names: tuple[str, ...], times: np.ndarray, gaps: tuple[float, float], count: int):
    """Random motions (motion, cell, scene); mostly there is a wall where the sensor moves, across or aslant."""
    found, tool = 0, Tool(boxes())
    while found < count:
        motion = random_motion("six_axis", names[found % len(names)], rng, times, near_home(rng))
        way = np.diff(tool.poses(motion.axes[1:3, :-1])[0][:, :3, 3], axis=0)[0]
        ahead = way / np.linalg.norm(way) if np.linalg.norm(way) > 1e-6 else unit(rng)
        direction = ahead * rng.choice([1, 1, 1, -1]) + 0.5 * unit(rng)
        gap, now = float(rng.uniform(*gaps)), motion.axes[2]
        cell, scene = behind_wall(now, direction / np.linalg.norm(direction), gap)
        slow = np.abs(np.diff(motion.axes, axis=0) / np.diff(times)[:, None]).max() < 1.5
        if slow and is_clear(cell, scene, now, gap):
            found += 1
            yield motion, cell, scene


def test_contact_ahead_is_at_the_time_and_distance_of_the_wall():
    """Translation square to a wall: the stated interval of 8 ms holds (gap - contact) / speed, within 1.5 mm of way."""
    rng = np.random.default_rng(31)
    hits = 0
    for axes, direction, gap, cell, scene in square(rng, (0.005, 0.06), 20):
        speed = float(rng.uniform(0.03, 0.25))
        time = (gap - CONTACT) / speed
        verdict = manual_check(cell, scene, WORST).check([hypothesis_of(axes, straight(axes, speed * direction))])
        if time > HORIZON - 0.01:
            continue
        (contact,) = verdict.contacts
        if (contact.approach.body_a, contact.approach.body_b) != ("sensor", "wall"):
            assert contact.free_until <= time  # another body is earlier
            continue
        hits += 1
        assert contact.approach.distance == pytest.approx(gap, abs=1e-6)
        assert contact.approach.rate == pytest.approx(-speed, rel=0.02)
        assert contact.free_until - 0.0015 / speed <= time <= contact.contact_by + 0.0015 / speed
        assert contact.contact_by - contact.free_until <= 0.008
        assert contact.travel == pytest.approx(speed * contact.free_until, abs=1.5e-3)
    assert hits >= 8


def test_time_of_contact_matches_dense_sampling_of_random_motions():
    """Joint and Cartesian motion as identified from noisy states: the first sampled contact is in the stated interval.

    Within 10 ms, and 5 % for the noise of the rates. Only pairs that approach from the beginning are compared.
    """
    rng = np.random.default_rng(32)
    times = np.append(POLLS, POLLS[-1] + TICK * np.arange(1, int(HORIZON / TICK) + 1))
    compared = 0
    for motion, cell, scene in walled(rng, KINDS[2:], times, (0.003, 0.05), 60):
        verdict, sampled = judged(cell, scene, motion, rng), distances(cell, scene, motion.axes[2:])
        first = int(np.argmax((sampled < CONTACT).any(1)))
        if first == 0:
            continue
        pair = scene.pairs[int(np.argmin(sampled[first]))]
        if np.diff(sampled[:2, scene.pairs.index(pair)])[0] >= -1e-5:
            continue
        found = [contact for contact in verdict.contacts if contact.path is motion.path] or list(verdict.contacts)
        true = TICK * first
        if true > 0.9 * HORIZON:
            continue
        assert found, (motion.name, pair, true)
        assert found[0].free_until - 0.01 - 0.05 * true <= true <= found[0].contact_by + 0.01 + 0.05 * true
        compared += 1
    assert compared >= 12


def judged(cell, scene, motion: Motion, rng: np.random.Generator, worst: WorstCase = WORST):
    hypotheses = Identifier(cell, NOISE).identify(motion.states(rng)).hypotheses
    return manual_check(cell, scene, worst).check(hypotheses)


def test_warned_pairs_approach():
    """Random motions of all kinds close to a wall: no pair that truly moves away is warned of."""
    rng = np.random.default_rng(33)
    times = np.append(POLLS, POLLS[-1] + 0.001)
    warned = 0
    for motion, cell, scene in walled(rng, KINDS, times, (0.001, 0.02), 120):
        for contact in judged(cell, scene, motion, rng).contacts:
            pair = scene.pairs.index((contact.approach.body_a, contact.approach.body_b))
            before, after = distances(cell, scene, motion.axes[2:4], np.inf)[:, pair]
            assert after < before
            warned += 1
    assert warned >= 20


@pytest.mark.parametrize("gap", [0.001, 0.005, 0.02])
def test_moving_away_from_a_wall_is_allowed_and_towards_it_is_not(gap):
    """Square to a wall that is nearer than the stopping distance, from noisy states."""
    rng = np.random.default_rng(34)
    for axes, direction, _, cell, scene in square(rng, (gap, gap), 8):
        check = manual_check(cell, scene, WORST)
        for sign in (-1.0, 1.0):
            rates = straight(axes, sign * 0.2 * direction)
            motion = Motion("translation", Path.BASE, POLLS, axes + (POLLS - POLLS[-1])[:, None] * rates)
            verdict = check.check(Identifier(cell, NOISE).identify(motion.states(rng)).hypotheses)
            concerned = [found for found in verdict.without_stop if found.body_b == "wall"]
            warned = [contact for contact in verdict.contacts if contact.approach.body_b == "wall"]
            if sign < 0:
                assert not concerned
                assert not warned
            else:
                assert not verdict.stop_is_proved
                assert verdict.contacts


def collisions_of_proved_stops(assumed: WorstCase, count: int, seed: int) -> tuple[int, int, int]:
    """Proved stops, collisions among them, and collisions among the others, in random worst cases."""
    rng = np.random.default_rng(seed)
    reaction = WORST.reaction
    times = np.append(POLLS, POLLS[-1] + np.linspace(0, reaction, 25)[1:])
    proved = collided = others = 0
    for motion, cell, scene in walled(rng, KINDS[2:], times, (0.002, 0.06), count):
        verdict = judged(cell, scene, motion, rng, assumed)
        rates = (motion.axes[-1] - motion.axes[-2]) / (times[-1] - times[-2])
        braked = motion.axes[-1] + stopping_motion(rates, 0.0, DECELERATION, np.linspace(0, 0.6, 60))
        hit = bool((distances(cell, scene, np.vstack([motion.axes[2:], braked])) <= 0).any())
        proved += verdict.stop_is_proved
        collided += hit and verdict.stop_is_proved
        others += hit and not verdict.stop_is_proved
    return proved, collided, others


def test_proved_stops_are_free_of_contact_in_the_worst_case():
    """With a tenth of the reaction time, motions would be released into walls."""
    proved, collided, others = collisions_of_proved_stops(WORST, 120, 35)
    assert collided == 0
    assert proved >= 30
    assert others >= 8
    hasty = replace(WORST, age=0.0, period=0.0, delay=0.009)
    assert collisions_of_proved_stops(hasty, 120, 35)[1] >= 3


def test_motion_too_slow_to_measure_needs_room_near_a_wall():
    """States that move by less than the noise: the motion may lead anywhere within the errors of the rates."""
    rng = np.random.default_rng(36)
    for gap, proved in ((0.0025, False), (0.01, True)):
        for axes, direction, _, cell, scene in square(rng, (gap, gap), 5):
            rates = straight(axes, rng.choice([-1.0, 1.0]) * 0.25e-3 * direction)
            motion = Motion("crawl", Path.BASE, POLLS, axes + (POLLS - POLLS[-1])[:, None] * rates)
            assert judged(cell, scene, motion, rng).stop_is_proved == proved


def test_no_hypothesis_is_no_proof():
    axes, _, _, cell, scene = next(iter(square(np.random.default_rng(37), (0.05, 0.05), 1)))
    assert axes is not None
    assert not manual_check(cell, scene, WORST).check([]).stop_is_proved


def test_unseen_changes_take_room():
    """A person who may change the motion unseen needs more distance to walls: fewer stops are proved."""
    rng = np.random.default_rng(37)
    plain = careful = 0
    for motion, cell, scene in walled(rng, KINDS[2:], POLLS, (0.02, 0.06), 40):
        hypotheses = Identifier(cell, NOISE).identify(motion.states(rng)).hypotheses
        one, other = (
            manual_check(cell, scene, worst).check(hypotheses).stop_is_proved
            for worst in (WORST, replace(WORST, unseen=JogLimits(np.full(7, 1.5), 0.8, 3.0)))
        )
        assert one or not other
        plain, careful = plain + one, careful + other
    assert 0 < careful < plain
