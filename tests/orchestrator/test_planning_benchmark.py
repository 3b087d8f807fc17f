"""A few cases of the public benchmark of path planning: solved, near the optimum, and checked by other means."""

from __future__ import annotations

import numpy as np
import pytest

from bench.planning import Row, run_case
from benchmarks.planning_cases import WANTED, read_cases

CASES = read_cases()


def of_kind(kind: str, count: int) -> list[dict]:
    found = [case for case in CASES if case["kind"] == kind]
    return found[:: len(found) // count][:count]


def test_the_benchmark_has_all_its_cases() -> None:
    assert {kind: sum(case["kind"] == kind for case in CASES) for kind in WANTED} == WANTED
    assert len({case["name"] for case in CASES}) == len(CASES) >= 200


@pytest.mark.parametrize("case", [of_kind("ordinary", 2)[1], *of_kind("moving", 1)], ids=lambda case: case["name"])
def test_a_case_with_a_motion_is_planned_and_the_plan_holds(case: dict) -> None:
    row: Row = run_case(case)
    assert row.optimum_solves
    assert row.rays_solve
    assert row.planned
    assert -1e-6 <= row.gap < 0.3
    assert row.evaluated < 0.3
    assert row.contact == ""
    assert row.poses > row.segments > 50
    assert row.used <= 1.0
    assert row.used_torque <= 1.0


@pytest.mark.parametrize("case", of_kind("blocked", 2), ids=lambda case: case["name"])
def test_a_blocked_case_is_refused_with_its_cause(case: dict) -> None:
    row = run_case(case)
    assert not row.optimum_solves
    assert not row.planned
    assert case["cause"] in row.cause
    assert np.isnan(row.gap)
