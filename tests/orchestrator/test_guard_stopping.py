"""Stopping in closed form, against integration, a controller's cycles and random worst cases."""

from __future__ import annotations

import numpy as np
import pytest

from guard_motions import stopping_motion, stopping_travel
from scancell.guard.parts import JogLimits
from scancell.guard.stopping import (
    Hypothesis,
    MeasuredState,
    Path,
    WorstCase,
    braking_time,
    latest_stop,
)

DECELERATION = np.radians([900.0, 900.0, 1000.0, 1200.0, 1200.0, 2000.0, 340.0])


def random_rates(rng: np.random.Generator) -> np.ndarray:
    return np.radians(rng.uniform(-60, 60, 7)) * (rng.random(7) < 0.6)


def test_one_axis_needs_v_t_plus_v_squared_over_2_a():
    """36 mm at 250 mm/s, with 80 ms of reaction and 2 m/s²."""
    assert stopping_travel([0.25], 0.08, 2.0) == pytest.approx([0.25 * 0.08 + 0.25**2 / 4], rel=1e-12)
    assert stopping_travel([0.25], 0.08, 2.0)[0] == pytest.approx(0.0356, abs=1e-4)


def test_motion_is_that_of_constant_deceleration():
    """Integrated rates: constant in the reaction, then falling linearly together; no axis brakes harder than stated."""
    rng = np.random.default_rng(1)
    for _ in range(20):
        rates, reaction = random_rates(rng), rng.uniform(0, 0.2)
        braking = braking_time(rates, DECELERATION)
        times = np.linspace(0, reaction + braking + 0.05, 4001)
        share = np.clip(1 - (times - reaction) / max(braking, 1e-12), 0, 1)
        integrated = np.concatenate([[0.0], np.cumsum((share[1:] + share[:-1]) / 2 * np.diff(times))])[:, None] * rates
        found = stopping_motion(rates, reaction, DECELERATION, times)
        assert np.allclose(found, integrated, atol=2e-6)
        assert np.allclose(found[-1], stopping_travel(rates, reaction, DECELERATION), atol=1e-12)
        if braking > 0:
            assert np.max(np.abs(rates) / braking / DECELERATION) == pytest.approx(1.0)


def test_controller_that_brakes_in_cycles_stands_one_cycle_later_at_most():
    """Every cycle takes the share of the rates that the slowest axis can lose in it, as the cell's controller does."""
    rng, cycle = np.random.default_rng(2), 0.016
    for _ in range(50):
        rates = random_rates(rng)
        travel, now = np.zeros(7), rates.copy()
        while now.any():
            cycles = (np.abs(now) / (DECELERATION * cycle)).max()
            after = now * (1 - 1 / cycles if cycles > 1 else 0.0)
            travel, now = travel + cycle * (now + after) / 2, after
        closed = stopping_travel(rates, 0.0, DECELERATION)
        assert (np.abs(travel) >= np.abs(closed) - 1e-12).all()
        assert (np.abs(travel - closed) <= DECELERATION * cycle**2 / 8 + 1e-12).all()
        assert (np.abs(travel) <= np.abs(stopping_travel(rates, cycle, DECELERATION)) + 1e-12).all()


def test_latest_stop_bounds_every_earlier_and_harder_one():
    """Random rates within their errors, changed unseen, braked sooner and harder: axes stay near the way."""
    rng = np.random.default_rng(3)
    unseen = np.radians(100.0)
    worst = WorstCase(0.03, 0.032, 0.04, DECELERATION, np.radians(0.02), JogLimits(np.full(7, unseen), 1.0, 1.0))
    largest = 0.0
    for _ in range(300):
        rates = random_rates(rng)
        error = np.full(7, np.radians(0.5))
        state = MeasuredState(0.0, np.zeros(7))
        stop = latest_stop(Hypothesis(Path.JOINT, state, rates, error, 0.032), worst)
        way = np.linspace(0, worst.reaction + stop.braking_time / 2, 400)[:, None] * rates
        before = rates + error * rng.choice([-1, 1], 7)
        change = unseen * rng.choice([-1, 0, 1], 7)
        axes = np.radians(0.02) * rng.choice([-1, 1], 7)
        # The rates are as old as the middle of the samples; the position is measured after that.
        now = before + change * 0.032
        reaction = worst.reaction * rng.choice([1.0, rng.random()])
        axes = axes + now * reaction + change * reaction**2 / 2
        now = now + change * reaction
        positions = axes + stopping_motion(now, 0.0, DECELERATION * rng.uniform(1, 1.5), np.linspace(0, 0.3, 40))
        away = np.abs(positions[:, None] - way[None])
        share = (away / (stop.deviation + unseen * stop.unseen / 2)).max(2).min(1)
        assert (share <= 1 + 1e-9).all()
        largest = max(largest, float(share.max()))
    assert largest > 0.5  # the bound is not true only because it is huge
