"""What distributing a study costs, in processor time; `python -m bench.studies` measures it at length."""

from __future__ import annotations

from dataclasses import asdict

import pytest
from bench.scale_page import page
from bench.studies import run_nothing, run_scans

from orchestrator.studies.task import Where

SHORT = ("scan.max_profiles=20", "scan.sweep.enabled=false")


@pytest.fixture(scope="module")
def runs():
    return {
        "nothing": run_nothing(2, 300),
        "cost": run_scans(Where(shard=(1, 1)), 3, 2, SHORT),
        "one": run_scans(Where(workers=1), 8, 4, SHORT),
        "two": run_scans(Where(workers=2), 8, 4, SHORT),
    }


def test_a_task_costs_the_scheduler_little_beside_a_scan(runs) -> None:
    per_task = runs["nothing"].own_s / runs["nothing"].tasks
    scan = runs["cost"].by_engine["geometric"]["processor"]
    print(f"{1e3 * per_task:.1f} ms per task, {1e3 * scan:.0f} ms per scan")
    assert per_task < 0.05 * scan


def test_the_page_is_made_of_what_was_measured(runs) -> None:
    text = page({name: {"load": 0.0, "settings": list(SHORT), **asdict(run)} for name, run in runs.items()})
    assert "| 2 | 8 + 4 |" in text
    assert "at most 20 profiles" in text
