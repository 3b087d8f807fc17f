"""Ray Shooting and the optimum on maps with known answers: corridors, walls, speed limits."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from numpy.typing import NDArray

from scancell.config.scan import WeightsDescription
from scancell.planning.motion.trajectory import Limits, limit_fractions
from scancell.planning.path_map import ray_shooting
from scancell.planning.path_map.configuration_map import ConfigurationMap
from scancell.planning.path_map.table_motion import Lattice, TableMotion

SAMPLES, PERIOD = 2, 0.1
MAX_RATE, MAX_ACCELERATION = 1.0, 2.0


class KnownMap(ConfigurationMap):
    """A map whose qualities (columns, rows) are given; cells count as evaluated when they are asked for."""

    def __init__(self, given: NDArray[np.float64], rate: float = np.inf) -> None:
        self._given = given.astype(np.float32)
        self.quality = np.full(given.shape, np.nan, np.float32)
        self.cause = np.zeros(given.shape, np.int8)
        self.lowest_rate = np.full(given.shape, -rate, np.float32)
        self.highest_rate = np.full(given.shape, rate, np.float32)

    def require(self, column: object, row: object) -> None:
        self.quality[column, row] = self._given[column, row]


def lattice(given: NDArray[np.float64], rate: float = np.inf) -> Lattice:
    return Lattice(KnownMap(given, rate), SAMPLES, PERIOD, MAX_RATE, MAX_ACCELERATION, WeightsDescription())


def check(motion: TableMotion, on: Lattice) -> None:
    """From rest to rest within the limits, through free cells, and as it says of itself."""
    rate = np.cumsum(motion.accelerations)
    assert rate[-1] == 0
    assert np.abs(rate).max() <= on.rates
    assert np.abs(motion.rate).max() <= MAX_RATE * (1 + 1e-9)
    change = np.abs(np.diff(motion.rate)) / PERIOD
    assert change.max(initial=0.0) <= MAX_ACCELERATION * (1 + 1e-9)
    # The angle is the integral of the piecewise linear speed.
    np.testing.assert_allclose(np.diff(motion.angle), PERIOD * (motion.rate[1:] + motion.rate[:-1]) / 2, atol=1e-9)
    rows = np.rint(motion.angle * on.map.rows / (2 * np.pi)).astype(int) % on.map.rows
    assert (on.map.quality[np.arange(on.map.columns), rows] > 0).all()
    check_smoothed(motion, on)


def check_smoothed(motion: TableMotion, on: Lattice) -> None:
    """The motion that the table makes keeps a jerk limit, too, and stays near the motion on the map."""
    jerk = 40 * MAX_ACCELERATION
    window = on.window(jerk)
    times = PERIOD * np.arange(on.map.columns)
    deviation = np.abs(on.angle_at(motion, times, window) - motion.angle)
    assert deviation.max() <= MAX_ACCELERATION * window**2 / 24 * (1 + 1e-6)
    fine = 1e-3
    angle = on.angle_at(motion, np.arange(-window, times[-1] + window, fine), window)
    limits = Limits(*(np.array([x]) for x in (MAX_RATE, MAX_ACCELERATION, jerk)))
    assert limit_fractions(angle[:, None], limits, fine).max() <= 1 + 1e-6
    assert angle[[0, -1]] == pytest.approx(motion.angle[[0, -1]], abs=1e-9)


def ridge(columns: int, rows: int, slope: float, width: float) -> NDArray[np.float64]:
    """A corridor of free cells around an angle that moves at a constant rate, best in its middle."""
    column, row = np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij")
    off = np.remainder(row / rows * 2 * np.pi - slope * PERIOD * column + np.pi, 2 * np.pi) - np.pi
    return np.where(np.abs(off) < width, 0.6 * np.cos(off * np.pi / (2.2 * width)), 0.0)


def test_poses_of_a_step_have_constant_acceleration_and_end_at_the_next_state() -> None:
    on = lattice(np.ones((2 * SAMPLES + 1, 5000)))
    rng = np.random.default_rng(1)
    angle = rng.integers(0, on.angles, 200)
    rate = rng.integers(-on.rates, on.rates + 1, 200)
    acceleration = rng.integers(-on.accelerations, on.accelerations + 1, 200)
    column, row, speed = on.cells(1, angle, rate, acceleration)
    after, rate_after = on.after(angle, rate, acceleration)
    part = np.arange(1, SAMPLES + 1) / SAMPLES
    turned = 2 * rate[:, None] * part + acceleration[:, None] * part**2
    off = row - (angle[:, None] + turned) * on.map.rows / on.angles
    assert np.abs(np.remainder(off + on.map.rows / 2, on.map.rows) - on.map.rows / 2).max() <= 0.5 + 1e-6
    np.testing.assert_array_equal(column[0], SAMPLES + np.arange(1, SAMPLES + 1))
    assert np.isin((row[:, -1] - on.row(after)) % on.map.rows, [0, 1, on.map.rows - 1]).all()
    mean = turned[:, -1] * (2 * np.pi / on.angles) / (SAMPLES * PERIOD)
    before = on.cells(0, angle, rate, 0 * rate)[2][:, -1]
    np.testing.assert_allclose((before + speed[:, -1]) / 2, mean, atol=1e-9)
    np.testing.assert_allclose(speed[:, -1], on.cells(0, angle, rate_after, 0 * rate)[2][:, -1], atol=1e-9)
    np.testing.assert_array_equal(on.cells(1, angle, rate, acceleration, only_end=True)[1][:, 0], row[:, -1])


@pytest.mark.parametrize("slope", [0.0, 0.5, -0.8])
def test_a_motion_follows_a_corridor(slope: float) -> None:
    given = ridge(81, 180, slope, 0.5)
    found = ray_shooting.shoot(lattice(given))
    best = ray_shooting.best_motion(lattice(given))
    assert found is not None
    assert best is not None
    check(found, lattice_of(given))
    check(best, lattice_of(given))
    assert best.cost <= found.cost * (1 + 1e-6)
    assert found.cost < 1.1 * best.cost


def lattice_of(given: NDArray[np.float64]) -> Lattice:
    """A lattice whose map is evaluated."""
    made = lattice(given)
    made.map.require_all()
    return made


def test_a_corridor_faster_than_the_table_is_blocked() -> None:
    given = ridge(81, 180, 2.5 * MAX_RATE, 0.3)
    assert ray_shooting.best_motion(lattice(given)) is None
    assert ray_shooting.shoot(lattice(given)) is None


def test_joint_speed_limits_forbid_fast_motions() -> None:
    given = ridge(81, 180, 0.5, 0.4)
    assert ray_shooting.best_motion(lattice(given, rate=0.6)) is not None
    assert ray_shooting.best_motion(lattice(given, rate=0.2)) is None
    assert ray_shooting.shoot(lattice(given, rate=0.2)) is None


def test_a_wall_with_a_gap_is_passed_through_the_gap() -> None:
    given = np.full((81, 180), 0.8)
    given[40] = 0.0
    given[40, 60:75] = 0.8
    for motion in (ray_shooting.shoot(lattice(given)), ray_shooting.best_motion(lattice(given))):
        assert motion is not None
        row = np.rint(motion.angle[40] * 90 / np.pi) % 180
        assert 60 <= row < 75


def test_a_whole_wall_is_blocked() -> None:
    given = np.full((81, 180), 0.8)
    given[40] = 0.0
    assert ray_shooting.shoot(lattice(given)) is None
    assert ray_shooting.best_motion(lattice(given)) is None


def test_the_optimum_is_the_best_of_all_motions_of_a_small_lattice() -> None:
    """Against the enumeration of every sequence of accelerations from every angle."""
    given = np.random.default_rng(2).uniform(0.2, 1.0, (4 * SAMPLES + 1, 12))
    given[3, :6] = 0.0
    made = lattice(given)
    best = ray_shooting.best_motion(made)
    assert best is not None
    found = np.inf
    choices = range(-made.accelerations, made.accelerations + 1)
    for accelerations in itertools.product(choices, repeat=made.steps):
        rate = np.cumsum(accelerations)
        if rate[-1] != 0 or np.abs(rate).max() > made.rates:
            continue
        before = np.concatenate([[0], rate[:-1]])
        turned = np.concatenate([[0], np.cumsum(2 * before + accelerations)[:-1]])
        angle = np.arange(made.angles)[:, None] + turned
        cost = made.cost(np.arange(made.steps), angle % made.angles, before, np.array(accelerations)).mean(-1)
        cost[made.map.quality[0, made.row(np.arange(made.angles))] <= 0] = np.inf
        found = min(found, float(cost.min()))
    assert best.cost == pytest.approx(found, rel=1e-5)


def test_few_cells_of_a_smooth_map_are_evaluated() -> None:
    column, row = np.meshgrid(np.arange(241), np.arange(360), indexing="ij")
    given = 0.55 + 0.4 * np.cos(row / 180 * np.pi - 0.015 * column) * np.cos(0.01 * column)
    made = lattice(given)
    found = ray_shooting.shoot(made)
    assert found is not None
    share = np.isfinite(made.map.quality).mean()
    best = ray_shooting.best_motion(lattice(given))
    assert best is not None
    assert share < 0.12
    assert found.cost < 1.05 * best.cost


def test_columns_that_do_not_fit_the_steps_are_rejected() -> None:
    with pytest.raises(ValueError, match="columns = 80: expected a multiple of samples = 2, plus 1"):
        lattice(np.ones((80, 36)))
