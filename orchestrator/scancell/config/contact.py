"""Contact solver and number of contact points between bodies."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from scancell.config.description import Description

Points = Annotated[int, Field(ge=1, le=100)]


class ContactPairDescription(Description):
    """Number of contact points for one pair of bodies."""

    bodies: tuple[str, str] = Field(
        description='names of the two bodies: "table", "gripper", or the name of a conveyor or a part'
    )
    points: Points = Field(description="largest number of contact points between the two")


class ContactDescription(Description):
    """Solver of contact forces, and the number of contact points of a pair of bodies."""

    solver: Literal["dantzig", "pgs"] = Field(
        default="dantzig",
        description="dantzig: exact, with Coulomb's friction cone; pgs: projected Gauss-Seidel, where a gripped part"
        " creeps and a stack of boxes collapses",
    )
    points: Points = Field(
        default=4,
        description="largest number of contact points of a pair of bodies: the deepest, then those farthest apart",
    )
    stick: bool = Field(
        default=True,
        description="stick constraints: a part that friction holds follows its support exactly; false: friction of the"
        " dynamics engine alone, with which a resting part creeps",
    )
    pair: tuple[ContactPairDescription, ...] = Field(default=(), description="pairs of bodies with another number")
