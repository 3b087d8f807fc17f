"""Trajectories: axis limits of speed, acceleration and jerk, rest at both ends, constant speed during exposures."""

import numpy as np
import pytest

from scancell.planning.motion import trajectory
from scancell.planning.motion.trajectory import Limits

CYCLE = 0.016
LIMITS = Limits(np.array([5.7, 5.2, 6.5, 6.5, 6.5, 10.5]), np.full(6, 17.0), np.full(6, 350.0))


@pytest.mark.parametrize("scale", [1e-8, 1e-4, 0.01, 0.3, 3.0])
def test_move_keeps_limits_and_is_rest_to_rest(scale):
    start = np.array([0.1, -0.5, 2.0, 0.3, 1.0, -2.0])
    end = start + scale * np.array([1.0, -0.4, 0.2, 0.9, -0.7, 0.3])
    path = trajectory.move(start, end, LIMITS, CYCLE)
    assert (path[0] == start).all()
    assert np.abs(path[-1] - end).max() < 1e-15
    rest = np.concatenate([*3 * [path[:1]], path, *3 * [path[-1:]]])  # at rest before and after
    assert trajectory.limit_fractions(rest, LIMITS, CYCLE).max() <= 1 + 1e-6


@pytest.mark.parametrize("axis", range(3))
def test_move_is_synchronised_and_as_fast_as_one_limit_allows(axis):
    """Rest to rest over d: d / v + v / a + a / j where speed and acceleration are reached."""
    end = np.array([2.0, -0.4, 0.2, 0.9, -0.7, 0.3])
    fine = 1e-4
    path = trajectory.move(np.zeros(6), end, LIMITS, fine)
    fraction = path[:, 0] / end[0]
    assert np.abs(path - fraction[:, None] * end).max() < 1e-14
    assert (np.diff(fraction) > 0).all()
    d, v, a, j = 2.0, LIMITS.speed[0], LIMITS.acceleration[0], LIMITS.jerk[0]
    low = np.sqrt(d * a + (a * a / (2 * j)) ** 2) - a * a / (2 * j)  # top speed where v is not reached
    expected = d / min(v, low) + min(v, low) / a + a / j
    assert (len(path) - 1) * fine == pytest.approx(expected, abs=1.5 * fine)
    peaks = trajectory.limit_fractions(path, LIMITS, fine)
    assert peaks.max(1)[1:].tolist() == pytest.approx([1.0, 1.0], abs=0.01)


def test_a_slowdown_stretches_a_move():
    end = np.array([2.0, -0.4, 0.2, 0.9, -0.7, 0.3])
    fast, slow = (trajectory.move(np.zeros(6), end, LIMITS, 1e-3, factor) for factor in (1.0, 2.5))
    assert len(slow) - 1 == pytest.approx(2.5 * (len(fast) - 1), abs=3)
    speed, acceleration, jerk = (
        trajectory.limit_fractions(slow, LIMITS, 1e-3) / trajectory.limit_fractions(fast, LIMITS, 1e-3)
    )[:, 0]
    assert [speed, acceleration, jerk] == pytest.approx([1 / 2.5, 1 / 2.5**2, 1 / 2.5**3], rel=0.02)


def test_a_move_to_where_it_starts_stays_there():
    assert (trajectory.move(np.ones(6), np.ones(6), LIMITS, CYCLE) == 1.0).all()


@pytest.mark.parametrize(
    ("count", "interval", "speed", "acceleration", "jerk"),
    [
        (233, 0.027, 0.698, 5.0, np.inf),
        (233, 0.027, 0.698, 5.0, 10.0),
        (67, 0.00077, 0.05, 0.5, np.inf),
        (2, 0.1, 0.05, 0.5, 1.0),
        (1000, 1e-4, 0.01, 2.0, np.inf),
    ],
)
@pytest.mark.parametrize("change", [None, "slowed", "rested"])
def test_run_has_constant_speed_between_ramps(count, interval, speed, acceleration, jerk, change):
    run = trajectory.run(count, interval, speed, acceleration, CYCLE, jerk)
    if change == "slowed":
        run, speed = run.slowed(1.7), speed / 1.7
    elif change == "rested":
        run = run.rested(0.013)
    fine = CYCLE / 40
    times = np.arange(-3, run.duration / fine + 4) * fine
    path = run.at(times)
    rates = np.diff(path) / fine
    assert (rates >= -1e-9).all()
    assert np.abs(np.diff(path, 2)).max() <= acceleration * fine**2 * (1 + 1e-9)
    assert np.abs(np.diff(path, 3)).max() <= min(jerk, 1e9) * fine**3 * (1 + 1e-9) + 1e-13
    # Constant speed from two cycles before the first exposure to two cycles after `trigger_to`.
    steady = (times[:-1] >= run.trigger_from - 1.99 * CYCLE) & (times[1:] <= run.trigger_to + 1.99 * CYCLE)
    assert np.abs(rates[steady] - speed).max() < 1e-9
    # First exposure at path 0; `trigger_to` is after the last exposure and before a further one.
    assert run.at(run.trigger_from) == pytest.approx(0.0, abs=1e-12)
    assert (count - 1) * interval < run.at(run.trigger_to) < count * interval
    assert run.at(-1.0) == run.at(0.0)
    assert run.at(run.duration + 1.0) == pytest.approx(run.at(run.duration), abs=1e-12)


def test_limit_fractions_and_slowdown_of_known_motions():
    t = np.arange(100) * CYCLE
    limits = Limits(np.array([6.0, 100.0, 1e3]), np.array([1.0, 8.0, 1e3]), np.array([1.0, 1.0, 12.0]))
    p = np.column_stack([3.0 * t, 2.0 * t**2, 0.5 * t**3])
    fractions = trajectory.limit_fractions(p, limits, CYCLE)
    assert fractions[:, 0] == pytest.approx([0.5, 0.0, 0.0], abs=1e-8)
    assert fractions[1:, 1] == pytest.approx([0.5, 0.0], abs=1e-6)
    assert fractions[2, 2] == pytest.approx(0.25, abs=1e-6)
    needed = trajectory.needed_slowdown(fractions)
    assert needed.max(0) == pytest.approx((fractions ** np.c_[[1, 1 / 2, 1 / 3]]).max(0))
