"""External lights of a cell."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from scancell.config.description import Bandwidth, Description, Fraction, PoseDescription, Size

LampFrame = Annotated[str, Field(pattern=r"^(world|sensor|table|part|link\[[1-8]\])$")]


class LightDescription(Description):
    """A lamp: a point radiates uniformly in all directions, an area like a Lambertian surface along +z of its pose."""

    kind: Literal["point", "rectangle", "disc"] = Field(description="shape of the lamp")
    frame: LampFrame = Field(default="world", description="frame that the lamp moves with")
    pose: PoseDescription = Field(default=PoseDescription(), description="frame_from_lamp: pose in that frame")
    power_mw: Annotated[float, Field(ge=0.0, le=1e9)] = Field(
        description="radiant power over the whole spectrum and all directions, mW"
    )
    width_mm: Size | None = Field(default=None, description="size of a rectangle along x, mm")
    height_mm: Size | None = Field(default=None, description="size of a rectangle along y, mm")
    diameter_mm: Size | None = Field(default=None, description="diameter of a disc, mm")
    in_band: Fraction | None = Field(
        default=None, description="share of the power that passes the band-pass filter, 0..1"
    )
    wavelength_nm: Annotated[float, Field(ge=200.0, le=2000.0)] | None = Field(
        default=None, description="centre of a Gaussian spectrum, nm; with bandwidth_nm instead of in_band"
    )
    bandwidth_nm: Bandwidth | None = Field(default=None, description="full width at half maximum of the spectrum, nm")

    @model_validator(mode="after")
    def _complete(self) -> Self:
        sizes = {"point": (), "rectangle": ("width_mm", "height_mm"), "disc": ("diameter_mm",)}[self.kind]
        for name in ("width_mm", "height_mm", "diameter_mm"):
            if (getattr(self, name) is not None) != (name in sizes):
                raise ValueError(f'kind = "{self.kind}": {name} is {"missing" if name in sizes else "not used"}')
        spectrum = self.wavelength_nm is not None, self.bandwidth_nm is not None
        if spectrum not in ((False, False), (True, True)) or spectrum[0] == (self.in_band is not None):
            raise ValueError("give either in_band, or wavelength_nm and bandwidth_nm")
        return self
