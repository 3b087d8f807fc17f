"""Contact solver, bodies with contact shapes, and contacts between pairs of bodies."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from scancell.config.description import Description, Friction

Points = Annotated[int, Field(ge=1, le=100)]


class ContactPairDescription(Description):
    """Contact of one pair of bodies."""

    bodies: tuple[str, str] = Field(
        description='names of the two bodies: "table", "gripper", the name of a conveyor or a part, and with'
        ' contact.cell_bodies "base", "link1" … "link6", "sensor", "table_base", "floor"'
    )
    points: Points | None = Field(
        default=None, description="largest number of contact points between the two; default: contact.points"
    )
    response: bool = Field(
        default=True,
        description="whether contact forces act between the two; false: they pass through each other, and only the"
        " collision outputs report it",
    )


class ContactDescription(Description):
    """Solver of contact forces, bodies with contact shapes, and the contact points of a pair of bodies."""

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
    cell_bodies: bool = Field(
        default=True,
        description="whether arm, sensor, gripper housing, table base and floor have contact shapes (convex hulls);"
        " they act on free parts, and on an arm with dynamic drives",
    )
    friction: Friction = Field(
        default=0.3, description="friction coefficient of these bodies; the smaller one of two bodies applies"
    )
    pair: tuple[ContactPairDescription, ...] = Field(default=(), description="pairs of bodies with other values")
