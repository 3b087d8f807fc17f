"""Materials by presets and single values, and the contact of bodies."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from scancell.config.description import Description, Fraction, Friction, Point

Model = Literal[
    "lambert", "oren_nayar", "rough_dielectric", "rough_conductor", "grooved_conductor", "mirror", "retro_reflective"
]
# Models with a GGX lobe.
_WITH_LOBE: tuple[Model, ...] = ("rough_dielectric", "rough_conductor", "grooved_conductor", "retro_reflective")
Preset = Literal["matt_white", "machined_aluminium", "polished_steel", "black_rubber", "painted_plastic", "marble"]

_Direction = Annotated[tuple[Annotated[float, Field(ge=-1e6, le=1e6)], ...], Field(min_length=3, max_length=3)]

_SMOOTHEST_GGX = 0.01
_MOST_TRANSLUCENT = 0.9
_SHORTEST_AXIS = 1e-6

Points = Annotated[int, Field(ge=1, le=100)]


@dataclass(frozen=True)
class Material:
    """Complete optical description of a surface at the laser's wavelength; see `scancell.sensor.Material`."""

    reflectance: float
    model: Model = "lambert"
    roughness: float = 1.0
    refractive_index: float = 1.5
    roughness_along: float | None = None
    groove_axis: _Direction | None = None
    groove_centre_mm: Point | None = None
    scattering_per_mm: float | None = None


# Typical reflectance and roughness in red light; measured values override them.
PRESETS: dict[Preset, Material] = {
    "matt_white": Material(0.85, "oren_nayar", roughness=0.3),
    "machined_aluminium": Material(0.9, "rough_conductor", roughness=0.35),
    "polished_steel": Material(0.58, "rough_conductor", roughness=0.08),
    "black_rubber": Material(0.03, "rough_dielectric", roughness=0.6, refractive_index=1.52),
    "painted_plastic": Material(0.5, "rough_dielectric", roughness=0.2, refractive_index=1.5),
    # Jensen, Marschner, Levoy & Hanrahan, SIGGRAPH 2001: red light.
    "marble": Material(0.83, "rough_dielectric", roughness=0.5, refractive_index=1.5, scattering_per_mm=2.19),
}


class MaterialDescription(Description):
    """A preset, a model with its values, or a preset with some values overridden."""

    preset: Preset | None = Field(default=None, description="named material whose values apply unless given here")
    model: Model | None = Field(
        default=None,
        description="BRDF: lambert, oren_nayar (rough diffuse), rough_dielectric (GGX coat on a diffuse base),"
        " rough_conductor (GGX metal), grooved_conductor (brushed, milled or turned metal: GGX with two widths),"
        " mirror, retro_reflective (foil with a GGX lobe back to the source)",
    )
    reflectance: Fraction | None = Field(
        default=None,
        description="0..1: of the diffuse base, of metal at normal incidence, or of mirror and foil at every angle",
    )
    roughness: Annotated[float, Field(ge=0.0, le=1.0)] | None = Field(
        default=None,
        description="oren_nayar: standard deviation of the slope angle over 90 deg, 0..1; models with a lobe: GGX"
        " alpha, 0.01..1; grooved_conductor: that across the grooves",
    )
    refractive_index: Annotated[float, Field(ge=1.0, le=3.0)] | None = Field(
        default=None, description="refractive index of the coat of rough_dielectric"
    )
    roughness_along: Annotated[float, Field(ge=_SMOOTHEST_GGX, le=1.0)] | None = Field(
        default=None, description="grooved_conductor: GGX alpha along the grooves, 0.01..1"
    )
    groove_axis: _Direction | None = Field(
        default=None,
        description="grooved_conductor: direction of the grooves in the frame of the body (of a part: of its mesh), as"
        " far as it lies in the surface; with groove_centre_mm the axis around which they run",
    )
    groove_centre_mm: Point | None = Field(
        default=None,
        description="grooved_conductor: the grooves are circles around groove_axis through this point of the body's"
        " frame, as turning leaves them, mm; default: straight grooves",
    )

    scattering_per_mm: Annotated[float, Field(ge=0.05, le=1000.0)] | None = Field(
        default=None,
        description="rough_dielectric: reduced scattering coefficient of the medium below its surface, whose light"
        " leaves beside the point where it enters; reflectance, 0.01..0.9, is the share of it that leaves again;"
        " default: an opaque base",
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
        if material.model == "grooved_conductor":
            if material.roughness_along is None or material.groove_axis is None:
                raise ValueError("grooved_conductor needs roughness_along and groove_axis")
            if max(map(abs, material.groove_axis)) < _SHORTEST_AXIS:
                raise ValueError(f"groove_axis must not be zero: {list(material.groove_axis)}")
        elif material.roughness_along is not None or material.groove_axis or material.groove_centre_mm:
            raise ValueError(
                f"roughness_along, groove_axis and groove_centre_mm belong to grooved_conductor, not {material.model}"
            )
        if material.scattering_per_mm is not None:
            if material.model != "rough_dielectric":
                raise ValueError(f"scattering_per_mm belongs to rough_dielectric, not {material.model}")
            if not 0.01 <= material.reflectance <= _MOST_TRANSLUCENT:
                raise ValueError(
                    f"reflectance ({material.reflectance:g}) must lie in 0.01..{_MOST_TRANSLUCENT} with"
                    " scattering_per_mm"
                )
        return self

    def resolved(self) -> Material:
        """Values of the preset, overridden by those given here."""
        base = Material(0.0) if self.preset is None else PRESETS[self.preset]
        given = self.model_dump(exclude={"preset"}, exclude_none=True)
        return replace(base, **given)


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
