"""Descriptions of what stands in the cell beside the part that is scanned: further parts and conveyors."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, StringConstraints, model_validator

from orchestrator.config.description import Description, Fraction, NonNegative, PoseDescription, Positive
from orchestrator.config.material import MaterialDescription
from orchestrator.config.soft import SoftDescription, check_soft

Name = Annotated[str, StringConstraints(min_length=1, pattern=r"^[A-Za-z][A-Za-z0-9_ -]*$")]


class FurtherPartDescription(Description):
    """Another part. The one that is scanned is ``part[1]``; these count from 2 in the order of the file."""

    name: Name
    mesh: str = Field(description="mesh of the part, in its own frame")
    unit: Literal["mm", "m", "inch"] = Field(default="mm", description="unit of the mesh")
    stands_on: str = Field(
        default="table", pattern=r"^(table|world|conveyor\[[1-9][0-9]*\])$", description="table, world or conveyor[i]"
    )
    pose: PoseDescription = Field(
        default=PoseDescription(),
        description="support_from_part: in the frame of the table at angle 0, of the world, or of the belt",
    )
    fixture: Literal["clamped", "free"] = Field(
        default="free", description="clamped: rigid on its support; free: stands by gravity and friction"
    )
    density_kg_m3: Positive = 2700.0
    friction: NonNegative = 0.6
    soft: SoftDescription | None = Field(default=None, description="springs of a soft part; rigid if not given")
    reflectance: Fraction = Field(default=0.5, description="Lambertian reflectance at the laser's wavelength")
    material: MaterialDescription | None = Field(default=None, description="takes the place of reflectance")

    @model_validator(mode="after")
    def _nothing_is_clamped_to_a_belt(self) -> Self:
        if self.fixture == "clamped" and self.stands_on.startswith("conveyor"):
            raise ValueError(f'fixture "clamped": nothing can be clamped to {self.stands_on}, make it "free"')
        return self

    @model_validator(mode="after")
    def _nothing_soft_is_clamped(self) -> Self:
        check_soft(self.soft, self.fixture)
        return self

    @property
    def conveyor(self) -> int | None:
        """Number, from 1, of the conveyor that the part stands on."""
        return _conveyor(self.stands_on)


class ConveyorDescription(Description):
    """A belt. Its frame has the origin in the centre of the top face, x along the travel and z up."""

    name: Name
    pose: PoseDescription = Field(description="world_from_belt")
    length_mm: Positive
    width_mm: Positive
    thickness_mm: Positive = 50.0
    max_speed_mm_s: Positive = 500.0
    max_acceleration_mm_s2: Positive = 1000.0
    friction: NonNegative = 0.6
    reflectance: Fraction = 0.05
    material: MaterialDescription | None = Field(default=None, description="takes the place of reflectance")


# Names that bodies of the cell have already.
RESERVED_NAMES = frozenset(
    {
        "base",
        *(f"link{i}" for i in range(1, 7)),
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
    """Where the part that is scanned stands at first, when something has to bring it to the table."""

    stands_on: str = Field(pattern=r"^(world|conveyor\[[1-9][0-9]*\])$", description="world or conveyor[i]")
    pose: PoseDescription = Field(
        default=PoseDescription(), description="support_from_part: in the frame of the world, or of the belt"
    )

    @property
    def conveyor(self) -> int | None:
        """Number, from 1, of the conveyor that the part stands on."""
        return _conveyor(self.stands_on)


def _conveyor(stands_on: str) -> int | None:
    return int(stands_on[9:-1]) if stands_on.startswith("conveyor") else None


def check_devices(
    arrival: ArrivalDescription | None,
    parts: tuple[FurtherPartDescription, ...],
    conveyors: tuple[ConveyorDescription, ...],
) -> None:
    """Raise `ValueError` when a name is taken, or when a part stands on a conveyor that is not there."""
    seen = set(RESERVED_NAMES)
    for name in [*(part.name for part in parts), *(conveyor.name for conveyor in conveyors)]:
        if name in seen:
            raise ValueError(f"the name '{name}' is taken: every part and conveyor needs one of its own")
        seen.add(name)
    standing: list[tuple[str, ArrivalDescription | FurtherPartDescription]]
    standing = [(f"part '{part.name}'", part) for part in parts]
    if arrival is not None:
        standing.append(("part.arrival", arrival))
    for who, part in standing:
        if part.conveyor is not None and part.conveyor > len(conveyors):
            raise ValueError(f"{who}: stands_on = '{part.stands_on}', there are {len(conveyors)} conveyors")
