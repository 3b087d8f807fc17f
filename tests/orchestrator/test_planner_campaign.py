"""A small run of the planner's campaign: concave parts among hooks and posts, each kind of part once."""

from __future__ import annotations

import pytest

from bench.planner_campaign import KINDS, run_cell


@pytest.mark.parametrize("seed", range(len(KINDS)))
def test_plans_of_concave_parts_among_obstacles_have_no_contact(seed: int) -> None:
    row = run_cell(seed + 8, step=2e-3, plain_seconds=0.0, profiles=40)  # clearance 5 mm, obstacles off by 2 mm
    assert row.contact == ""
    assert row.outcome == "planned" or "hook" in row.reason or "post" in row.reason
