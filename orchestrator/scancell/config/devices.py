"""Descriptions of further parts, rigid or soft, of conveyors and obstacles, and of where the scanned part arrives."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, StringConstraints, model_validator

from scancell.config.description import (
    Acceleration,
    Density,
    Description,
    Fraction,
    Friction,
    Length,
    PoseDescription,
    Size,
    Speed,
    Stiffness,
)
from scancell.config.material import MaterialDescription

NAME_PATTERN = r"^[A-Za-z][A-Za-z0-9_ -]*$"
Name = Annotated[str, StringConstraints(min_length=1, pattern=NAME_PATTERN)]


class SoftDescription(Description):
    """Springs between the surface points of a part and its rigid core.

    The surface is the part's convex hull, subdivided until no edge is longer than `longest_edge_mm`. A spring and a
    damper connect each of its points to its rest position.
    """

    stiffness_n_mm: Stiffness = Field(
        description="isotropic stiffness of each point's spring, N/mm; stable up to about 0.2 mass / (number of points"
        " * time step²), the cell reports this limit when it is exceeded"
    )
    damping_ratio: Annotated[float, Field(ge=0.0, le=1000.0)] = Field(
        default=1.0, description="damping ratio of the points' oscillation; 1: critical"
    )
    longest_edge_mm: Size = Field(default=15.0, description="largest distance between neighbouring points, mm")


def check_soft(soft: SoftDescription | None, fixture: str) -> None:
    """Raise `ValueError` for a part that is soft and clamped."""
    if soft is not None and fixture == "clamped":
        raise ValueError('a soft part cannot be clamped: fixture = "free"')


# Keys of every part, the scanned one and further ones.
PartDensity = Annotated[Density, Field(description="density of the part, for mass and inertia")]
PartFriction = Annotated[
    Friction, Field(description="Coulomb friction coefficient of the part; the smaller one of two bodies applies")
]
PartSprings = Annotated[SoftDescription | None, Field(description="springs of a soft part; default: rigid")]
PartReflectance = Annotated[
    Fraction, Field(description="Lambertian reflectance of the part at the laser's wavelength, 0..1")
]
PartMaterial = Annotated[MaterialDescription | None, Field(description="material of the part; overrides reflectance")]


class FurtherPartDescription(Description):
    """A part beside the scanned one, which is ``part[1]``; these are numbered from 2 in the order of the file."""

    name: Name = Field(description="unique name of the part")
    mesh: str = Field(description="file of the part's mesh, or of an artefact, part frame")
    unit: Literal["mm", "m", "inch"] = Field(default="mm", description="length unit of the mesh file")
    stands_on: str = Field(
        default="table",
        pattern=r"^(table|world|conveyor\[[1-9][0-9]*\])$",
        description="support of the part: table, world or conveyor[i]",
    )
    pose: PoseDescription = Field(
        default=PoseDescription(),
        description="support_from_part at the start; frame of the table at angle 0, of the world, or of the belt",
    )
    fixture: Literal["clamped", "free"] = Field(
        default="free", description="clamped: rigid on its support; free: held by gravity and friction"
    )
    density_kg_m3: PartDensity = 2700.0
    friction: PartFriction = 0.6
    soft: PartSprings = None
    reflectance: PartReflectance = 0.5
    material: PartMaterial = None

    @model_validator(mode="after")
    def _part_on_belt_is_free(self) -> Self:
        if self.fixture == "clamped" and self.stands_on.startswith("conveyor"):
            raise ValueError(f'fixture "clamped": a part on {self.stands_on} cannot be clamped; expected "free"')
        return self

    @model_validator(mode="after")
    def _soft_part_is_free(self) -> Self:
        check_soft(self.soft, self.fixture)
        return self

    @property
    def conveyor(self) -> int | None:
        """Number, from 1, of the conveyor that supports the part."""
        return _conveyor(self.stands_on)


class ConveyorDescription(Description):
    """A conveyor belt. Its frame has the origin in the centre of the top face, x along the travel and z up."""

    name: Name = Field(description="unique name of the conveyor")
    pose: PoseDescription = Field(description="world_from_belt: pose of the belt frame")
    length_mm: Size = Field(description="length of the belt along its travel, mm")
    width_mm: Size = Field(description="width of the belt, mm")
    thickness_mm: Size = Field(default=50.0, description="thickness of the belt below its top face, mm")
    max_speed_mm_s: Speed = Field(default=500.0, description="speed limit of the belt, mm/s")
    max_acceleration_mm_s2: Acceleration = Field(default=1000.0, description="acceleration limit of the belt, mm/s²")
    friction: Friction = Field(
        default=0.6, description="Coulomb friction coefficient of the belt; the smaller one of two bodies applies"
    )
    encoder_resolution_mm: Annotated[float, Field(ge=0.0, le=1000.0)] = Field(
        default=0.0, description="resolution of the encoder of the belt's travel, mm; 0: exact"
    )
    reflectance: Fraction = Field(
        default=0.05, description="Lambertian reflectance of the belt at the laser's wavelength, 0..1"
    )
    material: MaterialDescription | None = Field(
        default=None, description="material of the belt; overrides reflectance"
    )


class ObstacleDescription(Description):
    """A rigid body that stands in the world or on the table: a post, a clamp, a fence.

    It blocks light and is a body of the planner and of the FMU, whose contact shape of it is its convex hull.
    """

    name: Name = Field(description="unique name of the obstacle")
    mesh: str = Field(description="file of the obstacle's mesh, or of an artefact, its own frame")
    unit: Literal["mm", "m", "inch"] = Field(default="mm", description="length unit of the mesh file")
    moves_with: Literal["world", "table"] = Field(
        default="world", description="world: does not move; table: turns with the table"
    )
    pose: PoseDescription = Field(
        default=PoseDescription(),
        description="pose of the mesh in the frame of the world, or of the table at angle 0",
    )
    known: bool = Field(
        default=True,
        description="false: only in the simulated cell, unknown to planning and reconstruction",
    )
    clearance_mm: Length | None = Field(
        default=None, description="smallest distance of arm and sensor from it, mm; default: scan.clearance_mm"
    )
    reflectance: Fraction = Field(
        default=0.3, description="Lambertian reflectance of the obstacle at the laser's wavelength, 0..1"
    )
    material: MaterialDescription | None = Field(
        default=None, description="material of the obstacle; overrides reflectance"
    )


# Names of the cell's own bodies.
RESERVED_NAMES = frozenset(
    {
        "base",
        *(f"link{i}" for i in range(1, 9)),
        "sensor",
        "table",
        "table_base",
        "part",
        "gripper",
        "finger1",
        "finger2",
    }
)


class ArrivalDescription(Description):
    """Start position of a scanned part that is brought to the table."""

    stands_on: str = Field(
        pattern=r"^(world|conveyor\[[1-9][0-9]*\])$", description="support of the part: world or conveyor[i]"
    )
    pose: PoseDescription = Field(
        default=PoseDescription(),
        description="support_from_part at the start: in the frame of the world, or of the belt",
    )

    @property
    def conveyor(self) -> int | None:
        """Number, from 1, of the conveyor that supports the part."""
        return _conveyor(self.stands_on)


def _conveyor(stands_on: str) -> int | None:
    return int(stands_on[9:-1]) if stands_on.startswith("conveyor") else None


def check_devices(
    arrival: ArrivalDescription | None,
    parts: tuple[FurtherPartDescription, ...],
    conveyors: tuple[ConveyorDescription, ...],
    obstacles: tuple[ObstacleDescription, ...],
) -> None:
    """Raise `ValueError` for a name that is used twice, or a part on a conveyor that does not exist."""
    seen = set(RESERVED_NAMES)
    names = [*(x.name for x in parts), *(x.name for x in conveyors), *(x.name for x in obstacles)]
    for name in names:
        if name in seen:
            raise ValueError(f"the name '{name}' is taken; names of parts, conveyors and obstacles must be unique")
        seen.add(name)
    standing: list[tuple[str, ArrivalDescription | FurtherPartDescription]]
    standing = [(f"part '{part.name}'", part) for part in parts]
    if arrival is not None:
        standing.append(("part.arrival", arrival))
    for who, part in standing:
        if part.conveyor is not None and part.conveyor > len(conveyors):
            raise ValueError(f"{who}: stands_on = '{part.stands_on}', but there are {len(conveyors)} conveyors")
