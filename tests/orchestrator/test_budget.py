"""Variance budgets: shares with known closed forms, sums, intervals, and factors without effect."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from scipy.special import ndtri

from bench.study_intervals import MIDDLES, coverage
from scancell.studies import budget
from scancell.studies.budget import ShapleyForms, Terms, regressions, undetected_factors, variance_budget

NORMAL = ndtri(MIDDLES)


def budget_of(values: np.ndarray, outputs: np.ndarray, rows_per_sample: int = 1, correlation=None):
    factors = [Terms.of(column.tolist(), NORMAL) for column in values.T]
    return variance_budget(factors, outputs, 0.95, 0, rows_per_sample, correlation)


def shares_of(found) -> list[float]:
    return [row["share"] for row in found["budget"]]


@pytest.mark.parametrize("trials", [4, 24, 4000])
def test_independent_linear_factors_have_the_shares_of_their_variances(trials) -> None:
    values = np.random.default_rng(0).standard_normal((trials, 2))
    found = budget_of(values, values @ [3.0, 4.0])
    assert shares_of(found) == pytest.approx([0.36, 0.64])
    assert found["explained"] == pytest.approx(1)
    for row, share, uncertainty in zip(found["budget"], (0.36, 0.64), (3, 4), strict=True):
        assert row["share_interval"] == pytest.approx([share, share])
        assert row["uncertainty"] == pytest.approx(uncertainty, rel=1e-3)
        assert row["uncertainty_interval"] == pytest.approx([row["uncertainty"]] * 2)


def test_factor_without_effect_gets_no_share_of_a_factor_that_it_resembles_by_chance() -> None:
    rng = np.random.default_rng(0)
    z = rng.standard_normal(24)
    rx = 0.3 * z + rng.standard_normal(24)
    exact = budget_of(np.column_stack([z, rx]), 50.0 * z)
    assert shares_of(exact) == pytest.approx([1.0, 0.0], abs=1e-9)
    noisy = budget_of(np.column_stack([z, rx]), 50.0 * z + 0.5 * rng.standard_normal(24))
    (row,) = noisy["budget"][1:]
    assert row["share"] < 1e-3
    assert row["share_interval"][0] == 0.0
    assert row["share_interval"][1] < 1e-3
    assert row["uncertainty_interval"][1] < 1.0


@pytest.mark.parametrize(("weights", "correlation"), [((2.0, 1.0), 0.6), ((1.0, 0.0), 0.6), ((1.0, 1.0), -0.9)])
def test_two_correlated_normal_factors_have_the_shares_of_lindeman_merenda_gold(weights, correlation) -> None:
    covariance = np.array([[1, correlation], [correlation, 1]])
    values = np.random.default_rng(1).multivariate_normal([0, 0], covariance, 20_000)
    b = np.array(weights)
    variance = b @ covariance @ b
    alone = (covariance @ b) ** 2 / variance  # R² of each factor without the other
    exact = [(alone[0] + 1 - alone[1]) / 2, (alone[1] + 1 - alone[0]) / 2]
    found = budget_of(values[:30], values[:30] @ b, correlation=covariance)
    assert shares_of(found) == pytest.approx(exact)
    assert sum(shares_of(found)) == pytest.approx(1)


def test_line_square_word_and_noise() -> None:
    rng = np.random.default_rng(0)
    x, noise = rng.standard_normal((2, 20_000))
    z = rng.uniform(-np.sqrt(3), np.sqrt(3), len(x))
    word = rng.choice(["matt", "shiny"], len(x))
    y = 3 * x + np.sqrt(5) * z**2 + 4 * (word == "shiny") + noise
    populations = (NORMAL, np.sqrt(12) * (MIDDLES - 0.5), np.array(["matt", "shiny"]))
    drawn = zip((x, z, word), populations, strict=True)
    found = variance_budget([Terms.of(values.tolist(), own) for values, own in drawn], y, 0.95, 0)
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


def covariance_of(rng: np.random.Generator, factors: int, products: list[tuple[int, ...]]) -> np.ndarray:
    values = rng.standard_normal((200, factors)) @ rng.standard_normal((factors, factors))
    return np.cov(np.column_stack([values, *(values[:, i] * values[:, j] for i, j in products)]).T)


def test_shares_of_all_subsets_are_the_mean_over_all_orders() -> None:
    products = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
    owners = [(0,), (1,), (2,), (3,), *products]
    rng = np.random.default_rng(3)
    covariance, coefficients = covariance_of(rng, 4, products), rng.standard_normal(10)

    def explained(subset: tuple[int, ...]) -> float:
        chosen = [c for c, terms in enumerate(owners) if set(terms) <= set(subset)]
        cross = covariance[chosen] @ coefficients
        return float(cross @ np.linalg.solve(covariance[np.ix_(chosen, chosen)], cross)) if chosen else 0.0

    expected = np.zeros(4)
    for order in permutations(range(4)):
        for position, factor in enumerate(order):
            expected[factor] += (explained(order[: position + 1]) - explained(order[:position])) / 24
    forms = ShapleyForms(covariance, owners, 4)
    assert forms.gradients(coefficients) @ coefficients == pytest.approx(expected)
    assert forms.expected(np.outer(coefficients, coefficients)) == pytest.approx(expected)


def test_sampled_orders_agree_with_all_subsets(monkeypatch) -> None:
    owners = [(j,) for j in range(8)] + [(0, 7)]
    rng = np.random.default_rng(4)
    covariance, coefficients = covariance_of(rng, 8, [(0, 7)]), rng.standard_normal(9)
    total = coefficients @ covariance @ coefficients

    def shares() -> np.ndarray:
        return ShapleyForms(covariance, owners, 8).gradients(coefficients) @ coefficients / total

    exact = shares()
    monkeypatch.setattr(budget, "MAX_EXACT_FACTORS", 7)
    sampled = shares()
    assert not np.array_equal(sampled, exact)
    assert sampled == pytest.approx(exact, abs=0.02)
    assert sampled.sum() == pytest.approx(1)
    assert exact.sum() == pytest.approx(1)


def test_covariance_of_terms_is_that_of_the_population() -> None:
    """Of two correlated normal factors, a skewed one and words: linear terms, squares and products."""
    rng = np.random.default_rng(11)
    count = 400_000
    correlation = np.eye(4)
    correlation[0, 1] = correlation[1, 0] = 0.6
    normal = rng.multivariate_normal([0, 0], correlation[:2, :2], count)
    skewed, words = rng.gamma(9.0, size=count), rng.choice(["a", "b", "c"], count, p=[0.5, 0.3, 0.2])
    columns = [normal[:, 0].tolist(), normal[:, 1].tolist(), skewed.tolist(), words.tolist()]
    (*_, widest) = regressions([Terms.of(values) for values in columns], correlation)
    assert widest.name == "quadratic with interactions"
    sampled = np.cov(widest.matrix.T)
    # The products of correlated factors scatter most; 0.03 is five times what this sample's size makes of them.
    assert sampled == pytest.approx(widest.covariance, abs=0.03)


def test_equal_factors_share_equally_and_a_constant_one_has_no_share() -> None:
    x = np.random.default_rng(5).standard_normal(50)
    equal = np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    found = budget_of(np.column_stack([x, x, np.full(50, 2.0)]), 3 * x, correlation=equal)
    assert shares_of(found) == pytest.approx([0.5, 0.5, 0], abs=1e-6)


def test_terms_that_fit_noise_are_left_out() -> None:
    rng = np.random.default_rng(6)
    values = rng.standard_normal((60, 5))
    found = budget_of(values, values[:, 0] + rng.standard_normal(60))
    assert found["regression"] == "linear"
    assert found["predicted"] < found["explained"]


def test_intervals_have_their_stated_coverage() -> None:
    """A small run of ``bench.study_intervals``: 95 % of about 900 intervals with a standard deviation below 1 %."""
    true, shares, uncertainties = coverage(200)
    assert 0.925 <= shares.mean() <= 0.975
    assert 0.925 <= uncertainties.mean() <= 0.975
    none = true == 0
    assert 0.92 <= shares[none].mean() <= 0.99


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
