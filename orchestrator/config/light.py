"""External lights of a cell."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from orchestrator.config.description import Description, Fraction, NonNegative, PoseDescription, Positive

Frame = Literal["world", "sensor", "table", "part", "link[1]", "link[2]", "link[3]", "link[4]", "link[5]", "link[6]"]


class LightDescription(Description):
    """A lamp; a point shines to all sides, an area like a Lambertian surface along +z of its pose."""

    kind: Literal["point", "rectangle", "disc"]
    frame: Frame = Field(default="world", description="what the lamp moves with")
    pose: PoseDescription = Field(default=PoseDescription(), description="in that frame")
    power_mw: NonNegative = Field(description="over the whole spectrum and all directions")
    width_mm: Positive | None = Field(default=None, description="of a rectangle, along x")
    height_mm: Positive | None = Field(default=None, description="of a rectangle, along y")
    diameter_mm: Positive | None = Field(default=None, description="of a disc")
    in_band: Fraction | None = Field(default=None, description="share of the power that passes the band-pass filter")
    wavelength_nm: Annotated[float, Field(ge=200.0, le=2000.0)] | None = Field(
        default=None, description="middle of a Gaussian spectrum, in place of in_band"
    )
    bandwidth_nm: Positive | None = Field(default=None, description="of the spectrum, full width at half maximum")

    @model_validator(mode="after")
    def _complete(self) -> Self:
        sizes = {"point": (), "rectangle": ("width_mm", "height_mm"), "disc": ("diameter_mm",)}[self.kind]
        for name in ("width_mm", "height_mm", "diameter_mm"):
            if (getattr(self, name) is not None) != (name in sizes):
                wanted = "give" if name in sizes else "leave out"
                raise ValueError(f"{wanted} {name} for a {self.kind}")
        spectrum = self.wavelength_nm is not None, self.bandwidth_nm is not None
        if spectrum not in ((False, False), (True, True)) or spectrum[0] == (self.in_band is not None):
            raise ValueError("give either in_band, or wavelength_nm and bandwidth_nm")
        return self
