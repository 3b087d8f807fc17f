"""Description of an elastically deformable part."""

from __future__ import annotations

from pydantic import Field

from scancell.config.description import Description, NonNegative, Positive


class SoftDescription(Description):
    """Springs between the surface points of a part and its rigid core.

    The surface is the part's convex hull, subdivided until no edge is longer than `longest_edge_mm`. A spring and a
    damper connect each of its points to its rest position.
    """

    stiffness_n_mm: Positive = Field(
        description="isotropic stiffness of each point's spring, N/mm; stable up to about 0.2 mass / (number of points"
        " * time step²), the cell reports this limit when it is exceeded"
    )
    damping_ratio: NonNegative = Field(default=1.0, description="damping ratio of the points' oscillation; 1: critical")
    longest_edge_mm: Positive = Field(default=15.0, description="largest distance between neighbouring points, mm")


def check_soft(soft: SoftDescription | None, fixture: str) -> None:
    """Raise `ValueError` for a part that is soft and clamped."""
    if soft is not None and fixture == "clamped":
        raise ValueError('a soft part cannot be clamped: fixture = "free"')
