"""Descriptions of presence and distance sensors, and of the collision outputs."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from scancell.config.description import Description, Length, PoseDescription, Size

DeviceFrame = Annotated[str, Field(pattern=r"^(world|sensor|table|link\[[1-8]\]|part\[[1-9][0-9]*\]|finger\[[12]\])$")]
FramedPose = Field(
    default=PoseDescription(), description="frame_from_sensor: pose of the sensor in the frame that it moves with"
)
MovesWith = Field(default="world", description="frame that the sensor moves with")
Period = Annotated[float, Field(ge=0.001, le=1000.0)]


class CellSensorDescription(Description):
    """What all sensors have in common. The FMU reads the further keys of a sensor in SI units, by the same names."""

    name: str = Field(description="name of the sensor")
    moves_with: DeviceFrame = MovesWith
    pose: PoseDescription = FramedPose
    period_ms: Period = Field(default=1.0, description="time between two readings, ms")


class PresenceSensorDescription(CellSensorDescription):
    """A box that detects whether any body intersects it. The origin of its frame is the box's centre."""

    x_size_mm: Size = Field(description="size of the box along its x, mm")
    y_size_mm: Size = Field(description="size of the box along its y, mm")
    z_size_mm: Size = Field(description="size of the box along its z, mm")


class DistanceSensorDescription(CellSensorDescription):
    """Triangulating distance sensor: a ray along its z axis, and a lens beside the origin that sees the spot.

    A reading is invalid when the path from spot to lens is occluded or the spot is out of range.
    """

    nearest_mm: Length = Field(default=0.0, description="start of the measuring range along z, mm")
    farthest_mm: Size = Field(description="end of the measuring range along z, mm")
    lens_x_mm: Size = Field(default=20.0, description="position of the lens on the sensor's x axis, mm")
    noise_mm: Length = Field(default=0.0, description="standard deviation of a reading's noise, mm")
    resolution_mm: Length = Field(default=0.0, description="quantisation step of a reading, mm; 0: continuous")

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.nearest_mm >= self.farthest_mm:
            raise ValueError(f"nearest_mm ({self.nearest_mm:g}) must be below farthest_mm ({self.farthest_mm:g})")
        return self


class LightCurtainDescription(CellSensorDescription):
    """Parallel beams between two posts. The first beam runs along z from the origin, the others beside it along x."""

    width_mm: Size = Field(description="distance between the posts along z, mm")
    height_mm: Size = Field(description="extent of the beams along x from the first beam, mm")
    beam_spacing_mm: Size = Field(description="distance between two beams, mm; at most 1000 beams")

    @model_validator(mode="after")
    def _number_of_beams(self) -> Self:
        if self.height_mm / self.beam_spacing_mm >= 1000:
            raise ValueError(
                f"beam_spacing_mm ({self.beam_spacing_mm:g}) must give at most 1000 beams over"
                f" height_mm ({self.height_mm:g})"
            )
        return self


class CollisionDescription(Description):
    """Outputs of the FMU for collisions and clearances between the cell's bodies."""

    outputs: bool = Field(default=True, description="whether the FMU has outputs for collision and clearance")
    stops_arm: bool = Field(
        default=False,
        description="whether the controller makes an emergency stop when a collision begins or becomes deeper",
    )
    swept: bool = Field(
        default=True,
        description="whether collisions between two controller cycles are found, too; false: poses are sampled once "
        "per cycle, which costs less",
    )
    range_mm: Size = Field(default=20.0, description="largest clearance that is computed, mm; larger values cost time")
    max_faces: Annotated[int, Field(ge=4, le=10_000_000)] = Field(
        default=5000, description="meshes with more triangles are decimated to about this number"
    )
