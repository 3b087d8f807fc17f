"""scancell without the limits of shape, which reject stripes that other light disturbs."""

from __future__ import annotations

from typing import Any

from benchmarks.entries.ours import stripe_rows

_OPEN = ("max_asymmetry", "max_residual", "max_row_jump_px", "max_amplitude_jump", "max_width_jump")


def stripe(case: dict[str, Any]) -> dict[str, Any]:
    """Default detector; single columns and ends of the stripe are kept, too."""
    limits = {"max_sigma_px": 8.0, "min_sigma_px": 0.1, "end_columns": 0, "min_run_columns": 1}
    return stripe_rows(case, {**limits, **dict.fromkeys(_OPEN, 9.0)})
