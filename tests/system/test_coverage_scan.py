"""A coverage-driven scan in the cell; `python -m bench.coverage` does the same for all sample parts."""

from __future__ import annotations

import numpy as np

from bench.coverage import chosen_and_passes, table_of
from scancell.config.files import assets_dir


def test_coverage_driven_scan_covers_more_than_passes_in_the_same_time() -> None:
    chosen, passes = rows = chosen_and_passes(assets_dir() / "parts/free_form.stl")
    assert chosen.foreseen >= 0.99
    assert chosen.coverage >= 0.99
    assert passes.duration <= 1.2 * chosen.duration
    assert chosen.coverage > passes.coverage + 0.1
    assert np.median(chosen.spacing) < 1.0
    assert len(list(table_of([*rows]))) == 2 + len(rows)
