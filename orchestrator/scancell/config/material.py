"""Materials: named presets, and single values that override them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from scancell.config.description import Description, Fraction

Model = Literal["lambert", "oren_nayar", "rough_dielectric", "rough_conductor", "mirror", "retro_reflective"]
# Models with a GGX lobe.
_WITH_LOBE: tuple[Model, ...] = ("rough_dielectric", "rough_conductor", "retro_reflective")
Preset = Literal["matt_white", "machined_aluminium", "polished_steel", "black_rubber", "painted_plastic"]

_SMOOTHEST_GGX = 0.01


@dataclass(frozen=True)
class Material:
    """Complete optical description of a surface at the laser's wavelength; see `scancell.sensor.Material`."""

    reflectance: float
    model: Model = "lambert"
    roughness: float = 1.0
    refractive_index: float = 1.5


# Typical reflectance and roughness in red light; measured values override them.
PRESETS: dict[Preset, Material] = {
    "matt_white": Material(0.85, "oren_nayar", roughness=0.3),
    "machined_aluminium": Material(0.9, "rough_conductor", roughness=0.35),
    "polished_steel": Material(0.58, "rough_conductor", roughness=0.08),
    "black_rubber": Material(0.03, "rough_dielectric", roughness=0.6, refractive_index=1.52),
    "painted_plastic": Material(0.5, "rough_dielectric", roughness=0.2, refractive_index=1.5),
}


class MaterialDescription(Description):
    """A preset, a model with its values, or a preset with some values overridden."""

    preset: Preset | None = Field(default=None, description="named material whose values apply unless given here")
    model: Model | None = Field(
        default=None,
        description="BRDF: lambert, oren_nayar (rough diffuse), rough_dielectric (GGX coat on a diffuse base),"
        " rough_conductor (GGX metal), mirror, retro_reflective (foil with a GGX lobe back to the source)",
    )
    reflectance: Fraction | None = Field(
        default=None,
        description="0..1: of the diffuse base, of metal at normal incidence, or of mirror and foil at every angle",
    )
    roughness: Annotated[float, Field(ge=0.0, le=1.0)] | None = Field(
        default=None,
        description="oren_nayar: standard deviation of the slope angle over 90 deg, 0..1; models with a lobe: GGX"
        " alpha, 0.01..1",
    )
    refractive_index: Annotated[float, Field(ge=1.0, le=3.0)] | None = Field(
        default=None, description="refractive index of the coat of rough_dielectric"
    )

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if self.preset is None and (self.model is None or self.reflectance is None):
            raise ValueError(f"give a preset ({', '.join(PRESETS)}), or at least model and reflectance")
        material = self.resolved()
        if material.model in _WITH_LOBE and material.roughness < _SMOOTHEST_GGX:
            raise ValueError(
                f"roughness ({material.roughness:g}) of {material.model} must be at least 0.01; or use mirror"
            )
        return self

    def resolved(self) -> Material:
        """Values of the preset, overridden by those given here."""
        base = Material(0.0) if self.preset is None else PRESETS[self.preset]
        given = self.model_dump(exclude={"preset"}, exclude_none=True)
        return replace(base, **given)
