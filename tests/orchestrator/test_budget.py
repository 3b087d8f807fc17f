"""Variance budgets: shares with known closed forms, sums, intervals, and factors without effect."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest

from scancell.studies import shapley
from scancell.studies.budget import Terms, undetected_factors, variance_budget
from scancell.studies.shapley import shapley_shares


def budget_of(values: np.ndarray, outputs: np.ndarray, rows_per_sample: int = 1):
    factors = [Terms.of(column.tolist()) for column in values.T]
    return variance_budget(factors, outputs, 0.95, 0, rows_per_sample)


def shares_of(found) -> list[float]:
    return [row["share"] for row in found["budget"]]


def test_independent_linear_factors_have_the_shares_of_their_variances() -> None:
    values = np.random.default_rng(0).standard_normal((4000, 2))
    found = budget_of(values, values @ [3.0, 4.0])
    assert shares_of(found) == pytest.approx([0.36, 0.64], abs=0.02)
    assert found["explained"] == pytest.approx(1)
    for row, exact in zip(found["budget"], (0.36, 0.64), strict=True):
        low, high = row["share_interval"]
        assert low < exact < high < low + 0.1
    assert [row["uncertainty"] for row in found["budget"]] == pytest.approx([3, 4], rel=0.05)


@pytest.mark.parametrize(("weights", "correlation"), [((2.0, 1.0), 0.6), ((1.0, 0.0), 0.6), ((1.0, 1.0), -0.9)])
def test_two_correlated_normal_factors_have_the_shares_of_lindeman_merenda_gold(weights, correlation) -> None:
    covariance = np.array([[1, correlation], [correlation, 1]])
    values = np.random.default_rng(1).multivariate_normal([0, 0], covariance, 20_000)
    b = np.array(weights)
    variance = b @ covariance @ b
    alone = (covariance @ b) ** 2 / variance  # R² of each factor without the other
    exact = [(alone[0] + 1 - alone[1]) / 2, (alone[1] + 1 - alone[0]) / 2]
    found = budget_of(values, values @ b)
    assert shares_of(found) == pytest.approx(exact, abs=0.01)
    assert sum(shares_of(found)) == pytest.approx(1)


def test_line_square_word_and_noise() -> None:
    rng = np.random.default_rng(0)
    x, noise = rng.standard_normal((2, 20_000))
    z = rng.uniform(-np.sqrt(3), np.sqrt(3), len(x))
    word = rng.choice(["matt", "shiny"], len(x))
    y = 3 * x + np.sqrt(5) * z**2 + 4 * (word == "shiny") + noise
    found = variance_budget([Terms.of(values.tolist()) for values in (x, z, word)], y, 0.95, 0)
    variances = np.array([9.0, 4.0, 4.0])  # of 3 x; of sqrt(5) z²: 5 * 9 (1/5 - 1/9); of 4 times a fair coin
    assert shares_of(found) == pytest.approx(variances / 18, rel=0.05)
    assert found["unexplained"] == pytest.approx(1 / 18, rel=0.05)
    assert found["predicted"] == pytest.approx(17 / 18, abs=0.01)


def test_a_product_belongs_to_both_factors_equally() -> None:
    values = np.random.default_rng(2).standard_normal((3000, 3))
    found = budget_of(values, values[:, 0] * values[:, 1] + values[:, 2])
    assert found["regression"] == "quadratic with interactions"
    assert shares_of(found) == pytest.approx([0.25, 0.25, 0.5], abs=0.03)


@pytest.mark.parametrize(("factors", "trials"), [(1, 9), (3, 40), (7, 200), (10, 100), (12, 60)])
def test_shares_are_positive_and_add_up_to_what_is_explained(factors, trials) -> None:
    rng = np.random.default_rng(factors)
    values = rng.standard_normal((trials, factors)) @ rng.standard_normal((factors, factors))  # correlated
    found = budget_of(values, np.abs(values @ np.ones(factors)) + rng.standard_normal(trials))
    assert min(shares_of(found)) > -1e-9
    assert sum(shares_of(found)) == pytest.approx(found["explained"], abs=1e-6)
    assert found["explained"] + found["unexplained"] == pytest.approx(1)
    for row in found["budget"]:
        assert 0 <= row["share_interval"][0] <= row["share_interval"][1]


def correlations(rng: np.random.Generator, factors: int, products: list[tuple[int, ...]]) -> np.ndarray:
    values = rng.standard_normal((200, factors)) @ rng.standard_normal((factors, factors))
    columns = [values, *(values[:, i] * values[:, j] for i, j in products)]
    outputs = values.sum(1) + values[:, 0] * values[:, -1] + rng.standard_normal(200)
    return np.corrcoef(np.column_stack([*columns, outputs]).T)[None]


def test_shares_of_all_subsets_are_the_mean_over_all_orders() -> None:
    products = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
    owners = [(0,), (1,), (2,), (3,), *products]
    matrix = correlations(np.random.default_rng(3), 4, products)

    def explained(subset: tuple[int, ...]) -> float:
        chosen = [c for c, terms in enumerate(owners) if set(terms) <= set(subset)]
        cross = matrix[0][chosen, -1]
        return float(cross @ np.linalg.solve(matrix[0][np.ix_(chosen, chosen)], cross)) if chosen else 0.0

    expected = np.zeros(4)
    for order in permutations(range(4)):
        for position, factor in enumerate(order):
            expected[factor] += (explained(order[: position + 1]) - explained(order[:position])) / 24
    assert shapley_shares(matrix, owners, 4, 0)[0] == pytest.approx(expected)


def test_sampled_orders_agree_with_all_subsets(monkeypatch) -> None:
    owners = [(j,) for j in range(8)] + [(0, 7)]
    matrix = correlations(np.random.default_rng(4), 8, [(0, 7)])
    exact = shapley_shares(matrix, owners, 8, 0)
    monkeypatch.setattr(shapley, "MAX_EXACT_FACTORS", 7)
    sampled = shapley_shares(matrix, owners, 8, 0)
    assert not np.array_equal(sampled, exact)
    assert sampled == pytest.approx(exact, abs=0.02)
    assert sampled.sum() == pytest.approx(exact.sum(), abs=1e-6)


def test_equal_factors_share_equally_and_a_constant_one_has_no_share() -> None:
    x = np.random.default_rng(5).standard_normal(50)
    found = budget_of(np.column_stack([x, x, np.full(50, 2.0)]), 3 * x)
    assert shares_of(found) == pytest.approx([0.5, 0.5, 0], abs=1e-6)


def test_terms_that_fit_noise_are_left_out() -> None:
    rng = np.random.default_rng(6)
    values = rng.standard_normal((60, 5))
    found = budget_of(values, values[:, 0] + rng.standard_normal(60))
    assert found["regression"] == "linear"
    assert found["predicted"] < found["explained"]


def test_intervals_contain_the_true_shares_about_as_often_as_they_say() -> None:
    rng, exact, hits = np.random.default_rng(7), np.array([0.36, 0.64, 0.0]) / 1.5, np.zeros(3)
    for _ in range(100):
        values = rng.standard_normal((60, 3))
        found = budget_of(values, values @ [0.6, 0.8, 0.0] + np.sqrt(0.5) * rng.standard_normal(60))
        ends = np.array([row["share_interval"] for row in found["budget"]])
        hits += (ends[:, 0] <= exact) & (exact <= ends[:, 1])
    assert min(hits) >= 85


def test_dependent_rows_are_resampled_together() -> None:
    rng = np.random.default_rng(8)
    values = rng.standard_normal((100, 2))
    outputs = values @ [1.0, 1.0] + rng.standard_normal(100)
    repeated = values.repeat(9, axis=0), outputs.repeat(9)

    def width(found) -> float:
        low, high = found["budget"][0]["share_interval"]
        return high - low

    assert width(budget_of(*repeated, rows_per_sample=9)) == pytest.approx(width(budget_of(values, outputs)), rel=0.2)
    assert width(budget_of(*repeated)) < 0.5 * width(budget_of(values, outputs))


def test_nothing_varies_or_too_few_trials() -> None:
    values = np.random.default_rng(9).standard_normal((6, 5))
    assert budget_of(values, np.ones(6)) == {}
    assert budget_of(values, values.sum(1)) == {}


def test_factors_without_effect_are_found_among_noisy_figures() -> None:
    rng = np.random.default_rng(10)
    values = rng.standard_normal((80, 4))
    noise = rng.standard_normal((80, 2))
    figures = [values[:, 0] + noise[:, 0], 2 * values[:, 1] ** 2 + noise[:, 1], np.full(80, 7.0)]
    factors = [Terms.of(column.tolist()) for column in values.T]
    assert undetected_factors(factors, figures) == [2, 3]
    exact = [values[:, 0] + 1e-6 * values[:, 3], values[:, 1]]
    assert undetected_factors(factors, exact) == [2], "without noise the smallest effect counts"
