"""The page of `python -m bench.studies`, made from a short run."""

from __future__ import annotations

from dataclasses import asdict

import pytest

from bench.scale_page import page
from bench.studies import run_nothing, run_scans
from scancell.studies.engine import ExecutionTarget

SHORT = ("scan.max_profiles=20", "scan.sweep.enabled=false")


@pytest.fixture(scope="module")
def runs():
    return {
        "nothing": run_nothing(2, 300),
        "cost": run_scans(ExecutionTarget(shard=(1, 1)), 3, 2, SHORT),
        "one": run_scans(ExecutionTarget(workers=1), 8, 4, SHORT),
        "two": run_scans(ExecutionTarget(workers=2), 8, 4, SHORT),
    }


def test_page_matches_measurements(runs) -> None:
    text = page({name: {"load": 0.0, "settings": list(SHORT), **asdict(run)} for name, run in runs.items()})
    assert "| 2 | 8 + 4 |" in text
    assert "at most 20 profiles" in text
