"""Properties of distributions and designs."""

from __future__ import annotations

import numpy as np
import pytest

from scancell.config.study import (
    DesignDescription,
    DiscreteDescription,
    NormalDescription,
    TruncatedNormalDescription,
    UniformDescription,
)
from scancell.errors import DescriptionError
from scancell.studies.factors import correlated_normal, design, extremes, hashed, middles, quantiles, trial_seed

EVEN = (np.arange(100_000) + 0.5) / 100_000
KINDS = ["monte_carlo", "latin_hypercube", "sobol", "full_factorial", "one_at_a_time", "morris"]


def cube_of(kind: str, factors: int = 3, trials: int = 16, seed: int = 5, **more):
    return design(DesignDescription(kind=kind, trials=trials, **more), [None] * factors, seed)


def test_normal() -> None:
    drawn = quantiles(NormalDescription(kind="normal", mean=2, std=0.5), EVEN)
    assert drawn.mean() == pytest.approx(2)
    assert drawn.std() == pytest.approx(0.5, rel=1e-3)
    assert np.mean(np.abs(drawn - 2) < 0.5) == pytest.approx(0.6827, abs=1e-3)


def test_uniform() -> None:
    drawn = quantiles(UniformDescription(kind="uniform", low=-1, high=3), EVEN)
    assert (drawn.min(), drawn.max()) == pytest.approx((-1, 3), abs=1e-3)
    assert drawn.std() == pytest.approx(4 / np.sqrt(12), rel=1e-3)


def test_truncated_normal() -> None:
    distribution = TruncatedNormalDescription(kind="truncated_normal", mean=0, std=1, low=-1, high=1)
    drawn = quantiles(distribution, EVEN)
    assert np.abs(drawn).max() <= 1
    # Variance of a standard normal cut at ±1: 1 - 2 phi(1) / (2 Phi(1) - 1).
    assert drawn.var() == pytest.approx(1 - 2 * 0.24197072 / 0.68268949, rel=1e-3)
    assert extremes(distribution) == [-1, 1]


def test_discrete_by_weights() -> None:
    distribution = DiscreteDescription(kind="discrete", values=(1, 2, 3), weights=(1, 0, 3))
    positions, counts = np.unique(quantiles(distribution, EVEN), return_counts=True)
    assert positions.tolist() == [0, 2]
    assert counts / len(EVEN) == pytest.approx([0.25, 0.75], abs=1e-4)
    assert quantiles(distribution, middles(distribution)).tolist() == [0, 2]


@pytest.mark.parametrize("covariance", [[[4.0, 1.2], [1.2, 1.0]], [[1.0, 1.0], [1.0, 1.0]]], ids=["full", "singular"])
def test_correlated_normal(covariance) -> None:
    drawn = correlated_normal(
        np.random.default_rng(0).random((200_000, 2)), np.array([1.0, -2.0]), np.array(covariance)
    )
    assert drawn.mean(0) == pytest.approx([1, -2], abs=0.02)
    assert np.cov(drawn.T) == pytest.approx(np.array(covariance), abs=0.04)


@pytest.mark.parametrize("kind", KINDS)
def test_equal_seeds_give_equal_points_and_others_do_not(kind) -> None:
    assert np.array_equal(cube_of(kind), cube_of(kind))
    assert cube_of(kind).min() >= 0
    assert cube_of(kind).max() <= 1
    if kind not in {"full_factorial", "one_at_a_time"}:
        assert not np.array_equal(cube_of(kind), cube_of(kind, seed=6))


def test_a_longer_monte_carlo_begins_with_the_shorter() -> None:
    assert np.array_equal(cube_of("monte_carlo", trials=40)[:16], cube_of("monte_carlo"))


def test_rows_of_monte_carlo_are_those_of_generators_with_their_keys() -> None:
    drawn = design(DesignDescription(kind="monte_carlo", trials=5), [None] * 7, 3)
    fresh = [np.random.Generator(np.random.Philox(key=hashed(3, 1, n))).random(7) for n in range(5)]
    np.testing.assert_array_equal(drawn, fresh)


@pytest.mark.parametrize(
    ("kind", "key", "value"),
    [("full_factorial", "levels", 1000), ("sobol", "trials", 2**19), ("morris", "trials", 10**6)],
)
def test_designs_of_too_many_trials_are_refused_before_they_are_drawn(kind: str, key: str, value: int) -> None:
    description = DesignDescription.model_validate({"kind": kind, key: value})
    with pytest.raises(DescriptionError, match=rf"design.{key} = {value}: \d+ trials of 20 factors; expected"):
        design(description, [None] * 20, 1)


def test_latin_hypercube_has_one_point_in_every_stratum() -> None:
    strata = np.floor(cube_of("latin_hypercube", trials=50) * 50)
    assert all(sorted(column) == list(range(50)) for column in strata.T)


def test_sobol_rows_are_saltellis_scheme() -> None:
    table = cube_of("sobol", factors=3, trials=8).reshape(8, 5, 3)
    a, b = table[:, 0], table[:, 4]
    for j in range(3):
        mixed = a.copy()
        mixed[:, j] = b[:, j]
        assert np.array_equal(table[:, 1 + j], mixed)
    assert sorted(np.floor(a[:, 0] * 8)) == list(range(8)), "the base is a balanced sequence"


def test_full_factorial_has_every_combination_once() -> None:
    listed = middles(DiscreteDescription(kind="discrete", values=("a", "b")))
    description = DesignDescription(kind="full_factorial", levels=3, quantiles=(0.1, 0.9))
    rows = design(description, [None, listed, None], 0)
    assert len(rows) == len({tuple(row) for row in rows}) == 18
    assert np.unique(rows[:, 0]) == pytest.approx([0.1, 0.5, 0.9])
    assert np.unique(rows[:, 1]) == pytest.approx([0.25, 0.75])


def test_one_at_a_time_moves_one_factor_per_row() -> None:
    rows = cube_of("one_at_a_time", factors=3, levels=4)
    assert len(rows) == 1 + 3 * 4
    assert np.all(rows[0] == 0.5)
    assert np.all((rows[1:] != 0.5).sum(1) == 1)


def test_morris_moves_one_factor_per_step() -> None:
    steps = np.diff(cube_of("morris", factors=3, trials=5, levels=4).reshape(5, 4, 3), axis=1)
    assert np.all((np.abs(steps) > 1e-12).sum(2) == 1)
    assert np.all((np.abs(steps) > 1e-12).sum(1) == 1), "every factor once in a trajectory"


def test_seeds_of_trials_are_a_function_of_their_number() -> None:
    seeds = [trial_seed(1, n) for n in range(10_000)]
    assert len(set(seeds)) > 9_990, "31 bits: hardly any duplicates"
    assert max(seeds) < 2**31
    assert trial_seed(2, 5) != trial_seed(1, 5) == seeds[5]
