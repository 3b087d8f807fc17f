"""How contacts between bodies are found and solved."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from orchestrator.config.description import Description

Points = Annotated[int, Field(ge=1, le=100)]


class ContactPairDescription(Description):
    """Another number of contact points for one pair of bodies."""

    bodies: tuple[str, str] = Field(description='names of the two: "table", "gripper", a conveyor\'s or a part\'s')
    points: Points = Field(description="most contact points between them")


class ContactDescription(Description):
    """Solver of the contact forces, and how many points each pair of bodies may touch in."""

    solver: Literal["dantzig", "pgs"] = Field(
        default="dantzig",
        description="dantzig: exact, with Coulomb's friction cone; pgs: projected Gauss-Seidel, which lets a "
        "gripped part creep and a stack of boxes fall",
    )
    points: Points = Field(
        default=4, description="most contact points of a pair of bodies: the deepest, and those farthest apart"
    )
    pair: tuple[ContactPairDescription, ...] = ()
