"""Trajectories: axis limits, rest at both ends, constant speed during exposures."""

import numpy as np
import pytest

from scancell.planning import trajectory

CYCLE = 0.016
SPEED = np.array([5.7, 5.2, 6.5, 6.5, 6.5, 10.5])
ACCELERATION = np.full(6, 17.0)


@pytest.mark.parametrize("scale", [1e-4, 0.01, 0.3, 3.0])
def test_move_keeps_limits_and_is_rest_to_rest(scale):
    start = np.array([0.1, -0.5, 2.0, 0.3, 1.0, -2.0])
    end = start + scale * np.array([1.0, -0.4, 0.2, 0.9, -0.7, 0.3])
    path = trajectory.move(start, end, SPEED, ACCELERATION, CYCLE)
    assert (path[0] == start).all()
    assert np.abs(path[-1] - end).max() < 1e-15
    rest = np.concatenate([path[:1], path, path[-1:]])  # at rest before and after
    speed, acceleration = trajectory.limit_fractions(rest, SPEED, ACCELERATION, CYCLE)
    assert speed.max() <= 1.0
    assert acceleration.max() <= 1.0


def test_move_is_synchronised_and_time_optimal():
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
    # In continuous time the slowest axis reaches its limit exactly.
    t = np.linspace(0, 1, 20001)
    fine = trajectory.quintic(t)[:, None] * end
    needed = trajectory.move_time(end, SPEED, ACCELERATION)
    speed, acceleration = trajectory.limit_fractions(fine, SPEED, ACCELERATION, needed / 20000)
    assert max(speed.max(), acceleration.max()) == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize(
    ("count", "interval", "speed", "acceleration"),
    [(233, 0.027, 0.698, 5.0), (67, 0.00077, 0.05, 0.5), (2, 0.1, 0.05, 0.5), (1000, 1e-4, 0.01, 2.0)],
)
def test_run_has_constant_speed_between_ramps(count, interval, speed, acceleration):
    run = trajectory.run(count, interval, speed, acceleration, CYCLE)
    assert np.abs(np.diff(run.times) - CYCLE).max() < 1e-9
    # Acceleration, including from and to rest.
    rates = np.diff(run.path) / CYCLE
    assert (rates >= -1e-12).all()
    changes = np.diff(np.concatenate([[0.0], rates, [0.0]])) / CYCLE
    assert np.abs(changes).max() <= acceleration * (1 + 1e-9)
    # Constant speed from two cycles before the first exposure to two cycles after `trigger_to`.
    steady = (run.times[:-1] >= run.trigger_from - 2.001 * CYCLE) & (run.times[1:] <= run.trigger_to + 2.001 * CYCLE)
    assert np.abs(rates[steady] - speed).max() < 1e-9 * speed + 1e-12
    assert run.times[-1] >= run.trigger_to + 2 * CYCLE
    # First exposure at path 0; `trigger_to` is after the last exposure and before a further one.
    assert np.interp(run.trigger_from, run.times, run.path) == pytest.approx(0.0, abs=1e-12)
    end = np.interp(run.trigger_to, run.times, run.path)
    assert (count - 1) * interval < end < count * interval


def test_limit_fractions_of_known_motions():
    t = np.arange(100) * CYCLE
    steady, falling = trajectory.limit_fractions(
        np.column_stack([3.0 * t, 2.0 * t**2]), [6.0, 100.0], [1.0, 8.0], CYCLE
    )
    assert steady[0] == pytest.approx(0.5)
    assert falling[0] == pytest.approx(0.0, abs=1e-9)
    assert falling[1] == pytest.approx(0.5)
