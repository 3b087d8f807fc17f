"""Description of a part that yields where it is touched."""

from __future__ import annotations

from pydantic import Field

from orchestrator.config.description import Description, NonNegative, Positive


class SoftDescription(Description):
    """Springs between the points of a part's surface and its core.

    The surface is the part's convex hull, divided until no edge is longer than `longest_edge_mm`. Each of its points
    is pulled to its place by a spring and a damper of its own.
    """

    stiffness_n_mm: Positive = Field(
        description="N/mm: of each point's spring, alike in every direction. At most about 0.2 of the part's mass over "
        "number of points and squared time step; the cell tells the figure where it is exceeded"
    )
    damping_ratio: NonNegative = Field(default=1.0, description="of the points' own oscillation; 1: critical")
    longest_edge_mm: Positive = Field(default=15.0, description="between neighbouring points")


def check_soft(soft: SoftDescription | None, fixture: str) -> None:
    """Raise `ValueError` for a part that is soft and clamped."""
    if soft is not None and fixture == "clamped":
        raise ValueError('a soft part cannot be clamped: fixture = "free"')
