"""Description of a sensor path over the part."""

from __future__ import annotations

from typing import Annotated, ClassVar, Self

from pydantic import Field, model_validator

from scancell.config.description import Description, FileDescription, Finite, Positive

_Elevation = Annotated[float, Field(ge=0.0, le=90.0)]


class WaypointDescription(Description):
    """Pose of the sensor in the part frame: where its laser line meets the surface, and how it looks there."""

    x_mm: Finite = Field(description="point that the sensor looks at, part frame, mm")
    y_mm: Finite = Field(description="point that the sensor looks at, part frame, mm")
    z_mm: Finite = Field(description="point that the sensor looks at, part frame, mm")
    azimuth_deg: Finite = Field(default=0.0, description="direction from the point to the sensor, from +x about z, deg")
    elevation_deg: _Elevation = Field(default=90.0, description="that direction above the horizontal, deg")
    roll_deg: Finite = Field(
        default=0.0, description="rotation of the sensor about its Z axis; at 0 its laser line is vertical, deg"
    )


class SpiralDescription(Description):
    """Turns of the sensor around the part, which climb and rise at a constant rate; the laser line is vertical."""

    turns: Annotated[float, Field(ge=-100.0, le=100.0)] = Field(
        default=1.0, description="turns around z of the part, counterclockwise if positive"
    )
    start_deg: Finite = Field(default=0.0, description="azimuth at the start, from +x of the part about z, deg")
    elevation_deg: tuple[_Elevation, _Elevation] = Field(
        default=(30.0, 60.0), description="angle of the viewing direction above the horizontal, start and end, deg"
    )
    radius_mm: tuple[Annotated[float, Field(ge=0.0)], Annotated[float, Field(ge=0.0)]] | None = Field(
        default=None,
        description="distance from z of the point that the sensor looks at, start and end, mm; default: that at which"
        " the sensor is at its stand-off from the part",
    )
    height_mm: tuple[Finite, Finite] | None = Field(
        default=None, description="height of that point in the part frame, start and end, mm; default: half the part's"
    )


class PathDescription(FileDescription):
    """A path of the sensor relative to the part; the table turns the part as suits the arm."""

    kind: ClassVar[str] = "path"
    shipped: ClassVar[str] = "paths/spiral.toml"

    name: str = Field(default="path", description="name of the path")
    speed_mm_s: Positive = Field(default=50.0, description="speed of the sensor relative to the part, mm/s")
    pitch_mm: Positive = Field(default=0.5, description="distance of the sensor between exposures, mm")
    standoff_mm: Positive = Field(default=80.0, description="distance along sensor Z to the point it looks at, mm")
    spiral: SpiralDescription | None = Field(default=None, description="a spiral around the part")
    waypoint: tuple[WaypointDescription, ...] = Field(
        default=(), description="poses that the sensor passes through on straight lines, turning evenly"
    )
    recorded: str | None = Field(
        default=None,
        description="CSV file with the columns x_mm, y_mm, z_mm, rx_deg, ry_deg, rz_deg: part_from_sensor pose by pose",
    )

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        given = [self.spiral is not None, bool(self.waypoint), self.recorded is not None]
        if sum(given) != 1:
            raise ValueError("give exactly one of spiral, waypoint and recorded")
        if len(self.waypoint) == 1:
            raise ValueError("waypoint: expected at least two")
        return self
