"""Coverage intervals after JCGM 101."""

from __future__ import annotations

import numpy as np
import pytest

from scancell.studies.analysis import convergence, shortest_interval, summary, symmetric_interval


def test_example_of_the_guide_for_a_small_sample() -> None:
    # JCGM 101:2008, 7.7: M = 100, p = 0.95: q = 95, r = (100 - 95 + 1) / 2 = 3: the 3rd and 98th value.
    sample = np.arange(1.0, 101.0)[::-1]
    assert symmetric_interval(sample, 0.95) == (3.0, 98.0)


def test_a_normal_sample_has_the_known_interval_both_ways() -> None:
    sample = np.random.default_rng(1).standard_normal(200_000)
    for interval in (symmetric_interval, shortest_interval):
        assert interval(sample, 0.95) == pytest.approx((-1.96, 1.96), abs=0.06)


def test_the_shortest_interval_of_an_exponential_sample_begins_at_0() -> None:
    sample = np.random.default_rng(1).exponential(size=200_000)
    assert shortest_interval(sample, 0.95) == pytest.approx((0.0, -np.log(0.05)), abs=0.03)
    assert symmetric_interval(sample, 0.95) == pytest.approx((-np.log(0.975), -np.log(0.025)), abs=0.05)


def test_figures_of_a_sample_follow_from_its_values() -> None:
    said = summary(np.array([1.0, 2.0, 3.0, 4.0]), 0.95)
    assert (said["minimum"], said["mean"], said["maximum"]) == (1.0, 2.5, 4.0)
    assert said["standard_deviation"] == pytest.approx(np.sqrt(5 / 3))
    assert said["standard_error"] == pytest.approx(np.sqrt(5 / 3) / 2)


@pytest.mark.parametrize("count", [0, 1, 5, 9])
def test_a_small_sample_has_none(count) -> None:
    said = summary(np.arange(float(count)), 0.95)
    assert said["interval_symmetric"] is None
    assert said["interval_shortest"] is None
    assert said["trials"] == count


def test_convergence_ends_at_the_whole_sample() -> None:
    sample = np.random.default_rng(2).normal(3.0, 2.0, 4000)
    rows = convergence(sample)
    assert rows[-1]["mean"] == pytest.approx(sample.mean())
    assert rows[-1]["standard_error"] == pytest.approx(2 / np.sqrt(4000), rel=0.05)
    assert [row["trials"] for row in rows] == sorted({row["trials"] for row in rows})
