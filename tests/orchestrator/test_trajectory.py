"""Motions: limits kept, rest at both ends, constant speed where exposures fire."""

import numpy as np
import pytest

from orchestrator.planning import trajectory

CYCLE = 0.016
SPEED = np.array([5.7, 5.2, 6.5, 6.5, 6.5, 10.5])
ACCELERATION = np.full(6, 17.0)


@pytest.mark.parametrize("scale", [1e-4, 0.01, 0.3, 3.0])
def test_moves_keep_the_limits_and_start_and_end_at_rest(scale):
    start = np.array([0.1, -0.5, 2.0, 0.3, 1.0, -2.0])
    end = start + scale * np.array([1.0, -0.4, 0.2, 0.9, -0.7, 0.3])
    path = trajectory.move(start, end, SPEED, ACCELERATION, CYCLE)
    assert (path[0] == start).all()
    assert np.abs(path[-1] - end).max() < 1e-15
    rest = np.concatenate([path[:1], path, path[-1:]])  # standing before and after
    speed, acceleration = trajectory.share_of_limits(rest, SPEED, ACCELERATION, CYCLE)
    assert speed.max() <= 1.0
    assert acceleration.max() <= 1.0


def test_moves_are_straight_and_synchronised_and_use_a_limit():
    start, end = np.zeros(6), np.array([1.0, -0.4, 0.2, 0.9, -0.7, 0.3])
    path = trajectory.move(start, end, SPEED, ACCELERATION, CYCLE)
    fraction = path[:, 0]
    assert np.abs(path - fraction[:, None] * end).max() < 1e-14
    assert (np.diff(fraction) > 0).all()
    duration = (len(path) - 1) * CYCLE
    assert (
        trajectory.move_time(end, SPEED, ACCELERATION)
        <= duration
        < trajectory.move_time(end, SPEED, ACCELERATION) + CYCLE
    )
    # In continuous time the axis that needs longest reaches its limit exactly.
    t = np.linspace(0, 1, 20001)
    fine = trajectory.quintic(t)[:, None] * end
    needed = trajectory.move_time(end, SPEED, ACCELERATION)
    speed, acceleration = trajectory.share_of_limits(fine, SPEED, ACCELERATION, needed / 20000)
    assert max(speed.max(), acceleration.max()) == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize(
    ("count", "interval", "speed", "acceleration"),
    [(233, 0.027, 0.698, 5.0), (67, 0.00077, 0.05, 0.5), (2, 0.1, 0.05, 0.5), (1000, 1e-4, 0.01, 2.0)],
)
def test_runs_fire_at_constant_speed_between_gentle_ramps(count, interval, speed, acceleration):
    run = trajectory.run(count, interval, speed, acceleration, CYCLE)
    assert np.abs(np.diff(run.times) - CYCLE).max() < 1e-9
    # Rest at both ends: the neighbours of the ends hardly move yet.
    rates = np.diff(run.path) / CYCLE
    assert (rates >= -1e-12).all()
    changes = np.diff(np.concatenate([[0.0], rates, [0.0]])) / CYCLE
    assert np.abs(changes).max() <= acceleration * (1 + 1e-9)
    # At constant speed from two cycles before the first exposure to two after the gate closes.
    steady = (run.times[:-1] >= run.trigger_from - 2.001 * CYCLE) & (run.times[1:] <= run.trigger_to + 2.001 * CYCLE)
    assert np.abs(rates[steady] - speed).max() < 1e-9 * speed + 1e-12
    assert run.times[-1] >= run.trigger_to + 2 * CYCLE
    # The first exposure is due at path 0, and the gate closes between the last and a superfluous one.
    assert np.interp(run.trigger_from, run.times, run.path) == pytest.approx(0.0, abs=1e-12)
    closed = np.interp(run.trigger_to, run.times, run.path)
    assert (count - 1) * interval < closed < count * interval


def test_share_of_limits_of_known_motions():
    t = np.arange(100) * CYCLE
    steady, falling = trajectory.share_of_limits(
        np.column_stack([3.0 * t, 2.0 * t**2]), [6.0, 100.0], [1.0, 8.0], CYCLE
    )
    assert steady[0] == pytest.approx(0.5)
    assert falling[0] == pytest.approx(0.0, abs=1e-9)
    assert falling[1] == pytest.approx(0.5)
