"""Description of a gripper with two parallel fingers."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from scancell.config.description import (
    Description,
    Fraction,
    Friction,
    Length,
    Mass,
    PoseDescription,
    Size,
    Speed,
    Stiffness,
)
from scancell.config.material import MaterialDescription


class GripperDescription(Description):
    """Two fingers that slide on the flange, beside the sensor or instead of it.

    The origin of the gripper frame lies between the roots of the fingers, x along the closing direction, z towards the
    tips. The frame of finger 1 is that frame moved to its pad (the plane x = 0, the finger on the side of +x); that of
    finger 2 is rotated about z by 180 deg.
    """

    pose: PoseDescription = Field(description="flange_from_gripper: pose of the gripper frame on the flange")
    stroke_mm: Size = Field(description="largest distance between the pads, mm")
    start_mm: Length | None = Field(
        default=None, description="distance between the pads at the start, mm; default: stroke_mm"
    )
    finger_length_mm: Size = Field(description="length of a finger along gripper z, mm")
    finger_width_mm: Size = Field(description="width of a finger along gripper y, mm")
    finger_thickness_mm: Size = Field(default=10.0, description="thickness of a finger along gripper x, mm")
    finger_mass_kg: Mass = Field(default=0.1, description="moving mass of each finger, kg")
    max_force_n: Annotated[float, Field(ge=0.001, le=1e6)] = Field(
        default=60.0, description="force limit of each finger, N"
    )
    max_speed_mm_s: Speed = Field(default=100.0, description="speed limit of each finger, mm/s")
    friction: Friction = Field(
        default=0.8, description="Coulomb friction coefficient of the pads; the smaller one of two bodies applies"
    )
    centring_stiffness_n_mm: Stiffness = Field(
        default=20.0, description="stiffness of the coupling that keeps both fingers symmetric to the centre, N/mm"
    )
    housing_mm: Annotated[tuple[Size, ...], Field(min_length=3, max_length=3)] | None = Field(
        default=None,
        description="size (x, y, z) of the housing's box from the gripper's origin towards the flange, mm;"
        " default: none",
    )
    housing_mesh: str | None = Field(
        default=None, description="file of the housing's mesh instead of the box, gripper frame, mm"
    )
    finger_mesh: str | None = Field(
        default=None,
        description="file of the finger's mesh for images and clearance, finger frame, mm; contact uses the box",
    )
    reflectance: Fraction = Field(
        default=0.3, description="Lambertian reflectance of the gripper at the laser's wavelength, 0..1"
    )
    material: MaterialDescription | None = Field(
        default=None, description="material of the gripper; overrides reflectance"
    )

    @model_validator(mode="after")
    def _start_within_stroke(self) -> Self:
        if self.start_mm is not None and self.start_mm > self.stroke_mm:
            raise ValueError(f"start_mm ({self.start_mm:g}) must not exceed stroke_mm ({self.stroke_mm:g})")
        return self
