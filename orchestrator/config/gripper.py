"""Description of a gripper with two parallel fingers."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from orchestrator.config.description import Description, Fraction, NonNegative, PoseDescription, Positive
from orchestrator.config.material import MaterialDescription


class GripperDescription(Description):
    """Two fingers that slide on the flange, beside the sensor or in its place.

    The gripper's frame lies between the fingers where they begin: x along the closing, z towards their tips. The frame
    of the first finger is that frame at its pad (the plane x = 0, the finger on the side of +x); that of the second
    is turned about z by half a turn.
    """

    pose: PoseDescription = Field(description="flange_from_gripper")
    stroke_mm: Positive = Field(description="greatest distance between the pads")
    start_mm: NonNegative | None = Field(default=None, description="distance at the start; the stroke if not given")
    finger_length_mm: Positive
    finger_width_mm: Positive
    finger_thickness_mm: Positive = Field(default=10.0, description="along the closing")
    finger_mass_kg: Positive = 0.1
    max_force_n: Positive = Field(default=60.0, description="of each finger")
    max_speed_mm_s: Positive = Field(default=100.0, description="of each finger")
    friction: NonNegative = Field(default=0.8, description="of the pads; with a part the smaller of the two counts")
    centring_stiffness_n_mm: Positive = Field(
        default=20.0, description="N/mm: force that brings both fingers to the same distance from the middle"
    )
    housing_mm: Annotated[tuple[Positive, ...], Field(min_length=3, max_length=3)] | None = Field(
        default=None, description="size of the box from the gripper's origin towards the flange; none if not given"
    )
    housing_mesh: str | None = Field(default=None, description="takes the place of the box, gripper frame, mm")
    finger_mesh: str | None = Field(
        default=None,
        description="drawn and kept clear instead of the finger's box, finger frame, mm; contact is the box's",
    )
    reflectance: Fraction = 0.3
    material: MaterialDescription | None = Field(default=None, description="takes the place of reflectance")

    @model_validator(mode="after")
    def _opens_no_further_than_its_stroke(self) -> Self:
        if self.start_mm is not None and self.start_mm > self.stroke_mm:
            raise ValueError(f"start_mm ({self.start_mm:g}) must not be above stroke_mm ({self.stroke_mm:g})")
        return self
