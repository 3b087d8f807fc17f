"""Description of a sensor path over the part."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from scancell.config.description import Angle, Coordinate, Description, FileDescription, Length, Size, Speed

_Power = Annotated[float, Field(ge=0.001, le=1000.0)]
_Weight = Annotated[float, Field(ge=0.0, le=1e6)]
_Singularity = Annotated[float, Field(ge=0.0, le=100.0)]
_PathElevation = Annotated[float, Field(ge=0.0, le=90.0)]


class WaypointDescription(Description):
    """Pose of the sensor in the part frame: point where its laser line meets the surface, and viewing direction."""

    x_mm: Coordinate = Field(description="point that the sensor looks at, part frame, mm")
    y_mm: Coordinate = Field(description="point that the sensor looks at, part frame, mm")
    z_mm: Coordinate = Field(description="point that the sensor looks at, part frame, mm")
    azimuth_deg: Angle = Field(default=0.0, description="direction from the point to the sensor, from +x about z, deg")
    elevation_deg: _PathElevation = Field(default=90.0, description="that direction above the horizontal, deg")
    roll_deg: Angle = Field(
        default=0.0, description="rotation of the sensor about its Z axis; at 0 its laser line is vertical, deg"
    )


class SpiralDescription(Description):
    """Turns of the sensor around the part, which climb and rise at a constant rate; the laser line is vertical."""

    turns: Annotated[float, Field(ge=-100.0, le=100.0)] = Field(
        default=1.0, description="turns around z of the part, counterclockwise if positive"
    )
    start_deg: Angle = Field(default=0.0, description="azimuth at the start, from +x of the part about z, deg")
    elevation_deg: tuple[_PathElevation, _PathElevation] = Field(
        default=(30.0, 60.0), description="angle of the viewing direction above the horizontal, start and end, deg"
    )
    radius_mm: tuple[Length, Length] | None = Field(
        default=None,
        description="distance from z of the point that the sensor looks at, start and end, mm; default: that at which"
        " the sensor is at its stand-off from the part",
    )
    height_mm: tuple[Coordinate, Coordinate] | None = Field(
        default=None, description="height of that point in the part frame, start and end, mm; default: half the part's"
    )


class ContourDescription(Description):
    """Once around the part's outermost contour at one height; the laser line is upright."""

    height_mm: Coordinate = Field(description="height of the contour in the part frame, mm")
    elevation_deg: _PathElevation = Field(
        default=30.0,
        description="angle of the viewing direction above the horizontal, towards the contour's normal, deg",
    )
    turns: Literal[-1, 1] = Field(default=1, description="1: counterclockwise; -1: clockwise")
    start_deg: Angle = Field(default=0.0, description="azimuth of the normal at the start, from +x about z, deg")
    smoothing_mm: Size = Field(
        default=10.0, description="length along the contour on either side over which its direction is averaged, mm"
    )


class WeightsDescription(Description):
    """Weights of the cost of a motion, which is the mean over time of ``1 / f - 1`` and of these terms."""

    table_speed: _Weight = Field(default=0.1, description="k_ω, of the square of the table's speed over its limit")
    table_acceleration: _Weight = Field(
        default=0.1, description="k_a, of the square of the table's acceleration over its limit"
    )
    scanning_time: _Weight | None = Field(
        default=None,
        description="k_t, of the duration over that at the path's speed; half and a quarter of the speed are then"
        " tried, too, and the motion of the lowest cost is taken; default: the fastest motion that exists",
    )


class PairQualityDescription(Description):
    """Clearance factor of one pair of bodies, which overrides the values of all pairs; what is not given stays."""

    bodies: tuple[str, str] = Field(description="names of the bodies: sensor, link4, table, part, an obstacle's …")
    full_clearance_mm: Size | None = Field(
        default=None, description="distance d_high from which the factor is 1, at least twice the clearance, mm"
    )
    clearance_power: _Power | None = Field(default=None, description="exponent of the clearance, Eq. 8")

    @model_validator(mode="after")
    def _says_something(self) -> Self:
        if self.full_clearance_mm is None and self.clearance_power is None:
            raise ValueError("give full_clearance_mm, clearance_power or both")
        return self


class QualityDescription(Description):
    """Quality f of a configuration: the product of its constraints (Dumitrache & Borangiu, Eqs. 6 to 8)."""

    equations: Literal["corrected", "printed"] = Field(
        default="corrected",
        description="printed: Eq. 8 with π, with which the factor returns to 0 where the clearance is full",
    )
    joint_range_power: _Power | tuple[_Power, ...] = Field(
        default=1.0, description="exponent of the joint range, Eq. 7; one, or one for each joint"
    )
    clearance_power: _Power = Field(default=1.0, description="exponent of the clearance, Eq. 8")
    full_clearance_mm: Size = Field(
        default=50.0,
        description="distance d_high of Eq. 8 from which the factor of a pair of bodies is 1, mm; at least twice the"
        " clearance of the pair",
    )
    arm_full_clearance_mm: Size = Field(
        default=10.0, description="the same between links of the arm, which are close to each other by design, mm"
    )
    singularity: tuple[_Singularity, _Singularity] = Field(
        default=(0.01, 0.1),
        description="distances from a singular configuration up to which its factor is 0, and from which it is 1: of a"
        " lower bound of the Jacobian's smallest singular value, translations in units of 0.3 m",
    )
    pair: tuple[PairQualityDescription, ...] = Field(
        default=(), description="pairs of bodies with another clearance factor"
    )

    @model_validator(mode="after")
    def _rising(self) -> Self:
        low, high = self.singularity
        if not low < high:
            raise ValueError(f"singularity = [{low:g}, {high:g}]: expected the first value below the second")
        return self


class PathDescription(FileDescription):
    """A path of the sensor relative to the part; planning chooses the motion of the table."""

    kind: ClassVar[str] = "path"
    shipped: ClassVar[str] = "paths/spiral.toml"

    name: str = Field(default="path", description="name of the path")
    speed_mm_s: Speed = Field(default=50.0, description="speed of the sensor relative to the part, mm/s")
    pitch_mm: Size | Literal["sensor"] = Field(
        default=0.5,
        description="distance of the sensor between exposures, mm; sensor: the smallest at speed_mm_s, by the sensor's"
        " highest profile rate",
    )
    standoff_mm: Size | Literal["sensor"] = Field(
        default="sensor",
        description="distance along sensor Z to the point it looks at, mm;"
        " sensor: 80, or a twentieth of the measuring range beyond its start where 80 is not in its nearer half",
    )
    spiral: SpiralDescription | None = Field(default=None, description="a spiral around the part")
    contour: ContourDescription | None = Field(default=None, description="the contour of the part at one height")
    waypoint: tuple[WaypointDescription, ...] = Field(
        default=(), description="poses that the sensor passes through on straight lines, with constant rotation rate"
    )
    recorded: str | None = Field(
        default=None,
        description="CSV file with the columns x_mm, y_mm, z_mm, rx_deg, ry_deg, rz_deg: part_from_sensor pose by pose",
    )

    weights: WeightsDescription = Field(default=WeightsDescription(), description="weights of the cost of a motion")
    quality: QualityDescription = Field(default=QualityDescription(), description="quality of a configuration")

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        given = [self.spiral is not None, self.contour is not None, bool(self.waypoint), self.recorded is not None]
        if sum(given) != 1:
            raise ValueError("give exactly one of spiral, contour, waypoint and recorded")
        if len(self.waypoint) == 1:
            raise ValueError("waypoint: expected at least two")
        return self
