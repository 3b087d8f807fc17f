"""Sensitivities of functions with closed-form results."""

from __future__ import annotations

import numpy as np
import pytest

from scancell.config.study import DesignDescription
from scancell.studies.analysis import morris_effects, one_at_a_time_budget, sobol_indices
from scancell.studies.factors import design


def sobol_of(function, factors: int, base: int, seed: int = 3):
    cube = design(DesignDescription(kind="sobol", trials=base), [None] * factors, seed)
    return sobol_indices(function(cube), factors, 0.95, seed)[0]


def holds(row, name: str, value: float, slack: float = 1e-3) -> bool:
    low, high = row[f"{name}_interval"]
    return low - slack <= value <= high + slack


def test_sobol_of_a_linear_function_is_each_variance_over_their_sum() -> None:
    weights = np.array([4.0, 2.0, 1.0, 0.0])
    exact = weights**2 / (weights**2).sum()
    rows = sobol_of(lambda u: u @ weights, 4, 1024)
    for row, value in zip(rows, exact, strict=True):
        assert holds(row, "first", value)
        assert holds(row, "total", value)
        assert row["total"] == pytest.approx(value, abs=0.02)


def test_sobol_of_the_ishigami_function() -> None:
    a, b = 7.0, 0.1
    total = a**2 / 8 + b * np.pi**4 / 5 + b**2 * np.pi**8 / 18 + 0.5
    parts = 0.5 * (1 + b * np.pi**4 / 5) ** 2, a**2 / 8, 8 * b**2 * np.pi**8 / 225
    first = np.array([parts[0], parts[1], 0.0]) / total
    all_of = np.array([parts[0] + parts[2], parts[1], parts[2]]) / total

    def ishigami(u):
        x = np.pi * (2 * u - 1)
        return np.sin(x[:, 0]) + a * np.sin(x[:, 1]) ** 2 + b * x[:, 2] ** 4 * np.sin(x[:, 0])

    for row, s, t in zip(sobol_of(ishigami, 3, 2048), first, all_of, strict=True):
        assert holds(row, "first", s), (row, s)
        assert holds(row, "total", t), (row, t)
        assert row["first"] == pytest.approx(s, abs=0.03)
        assert row["total"] == pytest.approx(t, abs=0.03)


def test_failed_trial_excludes_its_base_sample() -> None:
    cube = design(DesignDescription(kind="sobol", trials=256), [None] * 2, 0)
    whole = cube @ [3.0, 1.0]
    broken = whole.copy()
    broken[5] = np.nan  # in the second base sample of four trials each
    without = np.delete(whole, [4, 5, 6, 7])
    assert sobol_indices(broken, 2, 0.95, 0)[0] == sobol_indices(without, 2, 0.95, 0)[0]


def test_morris_of_a_linear_function_is_its_slopes() -> None:
    description = DesignDescription(kind="morris", trials=8, levels=4)
    low, high = description.quantiles
    cube = (design(description, [None] * 3, 1) - low) / (high - low)
    rows = morris_effects(cube, cube @ [5.0, -2.0, 0.0], 4, 0.95, 1)
    assert [row["mean"] for row in rows] == pytest.approx([5, -2, 0])
    assert [row["mean_magnitude"] for row in rows] == pytest.approx([5, 2, 0])
    assert [row["spread"] for row in rows] == pytest.approx([0, 0, 0], abs=1e-9)


def test_one_at_a_time_combines_slopes_and_uncertainties() -> None:
    values = [np.array([0.5, 0.0, 1.0, 0.5, 0.5]), np.array([0.5, 0.5, 0.5, 0.0, 1.0])]
    outputs = 3 * values[0] - 2 * values[1]
    rows = one_at_a_time_budget(values, outputs, [2, 2], (1.0, 2.0), 0.95, 0)
    assert [row["slope"] for row in rows] == pytest.approx([3, -2])
    assert [row["uncertainty"] for row in rows] == pytest.approx([3, 4])
    assert [row["share"] for row in rows] == pytest.approx([0.36, 0.64])
    assert [row["share_interval"] for row in rows] == [None, None], "two levels leave no scatter to judge by"


def test_one_at_a_time_intervals_have_their_stated_coverage() -> None:
    levels, slopes, spreads = [4, 5, 4], np.array([3.0, -2.0, 0.0]), (1.0, 2.0, 1.5)
    values = [np.full(14, 0.5) for _ in levels]
    for j, count in enumerate(levels):
        start = 1 + sum(levels[:j])
        values[j][start : start + count] = np.linspace(0.0, 1.0, count)
    rng, inside = np.random.default_rng(0), []
    exact = np.square(slopes * spreads) / np.square(slopes * spreads).sum()
    for seed in range(200):
        outputs = slopes @ values + 0.5 * rng.standard_normal(14)
        rows = one_at_a_time_budget(values, outputs, levels, spreads, 0.95, seed)
        assert sum(row["share"] for row in rows) == pytest.approx(1)
        for row, share, uncertainty in zip(rows, exact, np.abs(slopes) * spreads, strict=True):
            for key, true in (("share_interval", share), ("uncertainty_interval", uncertainty)):
                inside.append(row[key][0] <= true <= row[key][1])
    assert 0.925 <= np.mean(inside) <= 0.985
