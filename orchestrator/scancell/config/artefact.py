"""Description of an artefact: a part of exact shape."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from scancell.config.description import Description, FileDescription, PoseDescription
from scancell.config.devices import Name

_MOST_MM = 2000.0  # like the largest meshes that are accepted without a remark
_Size = Annotated[float, Field(ge=0.001, le=_MOST_MM)]


class _PlacedDescription(Description):
    name: Name = Field(description="unique name of the shape")
    pose: PoseDescription = Field(default=PoseDescription(), description="part_from_shape: pose in the part frame")
    role: Literal["measured", "support"] = Field(
        default="measured", description="measured: calibrated surface; support: stem, base or other holder"
    )


class SphereDescription(_PlacedDescription):
    """A sphere around the origin of its frame."""

    kind: Literal["sphere"] = Field(description="kind of shape")
    diameter_mm: _Size = Field(description="diameter, mm")


class PlaneDescription(_PlacedDescription):
    """A rectangle in z = 0 of its frame, centred, with the free side at +z."""

    kind: Literal["plane"] = Field(description="kind of shape")
    size_mm: tuple[_Size, _Size] = Field(description="edges along x and y, mm")


class BoxDescription(_PlacedDescription):
    """A cuboid centred on the origin of its frame."""

    kind: Literal["box"] = Field(description="kind of shape")
    size_mm: tuple[_Size, _Size, _Size] = Field(description="edges along x, y and z, mm")


class CylinderDescription(_PlacedDescription):
    """A cylinder along z of its frame with end faces, centred."""

    kind: Literal["cylinder"] = Field(description="kind of shape")
    diameter_mm: _Size = Field(description="diameter, mm")
    height_mm: _Size = Field(description="height, mm")


class ConeDescription(_PlacedDescription):
    """A cone frustum along z of its frame with end faces, centred."""

    kind: Literal["cone"] = Field(description="kind of shape")
    bottom_diameter_mm: _Size = Field(description="diameter at z = -height/2, mm")
    top_diameter_mm: Annotated[float, Field(ge=0.0, le=_MOST_MM)] = Field(
        description="diameter at z = height/2, mm; 0: pointed"
    )
    height_mm: _Size = Field(description="height, mm")


class RingDescription(_PlacedDescription):
    """A cylinder along z of its frame with a concentric bore, centred."""

    kind: Literal["ring"] = Field(description="kind of shape")
    inner_diameter_mm: _Size = Field(description="diameter of the bore, mm")
    outer_diameter_mm: _Size = Field(description="outer diameter, mm")
    height_mm: _Size = Field(description="height, mm")

    @model_validator(mode="after")
    def _bore_inside(self) -> Self:
        if not self.inner_diameter_mm < self.outer_diameter_mm:
            raise ValueError(
                f"inner_diameter_mm = {self.inner_diameter_mm:g}: "
                f"must be less than outer_diameter_mm = {self.outer_diameter_mm:g}"
            )
        return self


ShapeDescription = Annotated[
    SphereDescription | PlaneDescription | BoxDescription | CylinderDescription | ConeDescription | RingDescription,
    Field(discriminator="kind"),
]


class ArtefactDescription(FileDescription):
    """A part of exact shape, which is traced and measured without facets."""

    kind: ClassVar[str] = "artefact"
    shipped: ClassVar[str] = "artefacts/sphere.toml"

    name: str = Field(default="artefact", description="name of the artefact")
    shape: tuple[ShapeDescription, ...] = Field(description="the shapes; solids may overlap and form their union")

    @model_validator(mode="after")
    def _named_and_measured(self) -> Self:
        names = [shape.name for shape in self.shape]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"shape: two shapes have the name '{twice[0]}'; names must be unique")
        if all(shape.role == "support" for shape in self.shape):
            raise ValueError('shape: none has the role "measured"; expected at least one')
        return self
