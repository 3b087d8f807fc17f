"""Description of presence and distance sensors and of what the cell tells about collisions."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from orchestrator.config.description import Description, NonNegative, PoseDescription, Positive

Frame = Annotated[str, Field(pattern=r"^(world|sensor|table|link\[[1-6]\]|part\[[1-9][0-9]*\]|finger\[[12]\])$")]
FramedPose = Field(default=PoseDescription(), description="frame_from_sensor")
Period = Annotated[float, Field(gt=0.0, le=1000.0, allow_inf_nan=False)]


class PresenceSensorDescription(Description):
    """A box that tells whether any part reaches into it; it applies no force. Its frame lies in the box's centre."""

    name: str
    moves_with: Frame = "world"
    pose: PoseDescription = FramedPose
    x_size_mm: Positive
    y_size_mm: Positive
    z_size_mm: Positive
    period_ms: Period = 1.0


class DistanceSensorDescription(Description):
    """A ray from the sensor's origin along its z axis, and the way back from the spot to a lens beside the origin.

    Where anything stands in the way back, or the spot is out of range, the measurement is discarded.
    """

    name: str
    moves_with: Frame = "world"
    pose: PoseDescription = FramedPose
    nearest_mm: NonNegative = 0.0
    farthest_mm: Positive
    lens_x_mm: Positive = Field(default=20.0, description="the lens lies beside the origin, along the sensor's x axis")
    noise_mm: NonNegative = Field(default=0.0, description="standard deviation")
    resolution_mm: NonNegative = Field(default=0.0, description="step of the reading; 0 is continuous")
    period_ms: Period = 1.0

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.nearest_mm >= self.farthest_mm:
            raise ValueError(f"nearest_mm ({self.nearest_mm:g}) must be below farthest_mm ({self.farthest_mm:g})")
        return self


class CollisionDescription(Description):
    """What the FMU tells about collisions and smallest distances between the cell's bodies."""

    outputs: bool = Field(default=True, description="whether the FMU has the outputs truth.collision and clearance")
    range_mm: Positive = Field(default=20.0, description="distances are told up to here; farther costs time")
    max_faces: Annotated[int, Field(ge=4)] = Field(
        default=5000, description="a mesh with more triangles is simplified towards this number"
    )
