"""Description of a scan: which views, how dense, how fast."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from orchestrator.config.description import Description, Finite, NonNegative, PoseDescription, Positive

Engine = Literal["ray-traced", "geometric"]
Mode = Literal["dynamic", "stop-and-look"]

_Elevation = Annotated[float, Field(ge=0.0, le=85.0)]


class SweepDescription(Description):
    """Turns of the table under a sensor that stands still."""

    enabled: bool = True
    elevations_deg: tuple[_Elevation, ...] = Field(
        default=(30.0, 60.0), description="angle of the viewing direction above the horizontal"
    )
    azimuth_deg: Finite = Field(default=105.0, description="where the sensor stands about the table; 0 = world +x")
    standoff_mm: Positive = Field(default=80.0, description="range at the part's bounding cylinder")
    height_step_mm: Positive = Field(default=30.0, description="step between neighbouring turns along the laser line")
    angle_step_deg: Annotated[float, Field(ge=0.01, le=30.0)] = Field(
        default=1.0, description="table angle between exposures; widened when max_profiles would be exceeded"
    )
    speed_deg_s: Positive = 40.0


class RasterDescription(Description):
    """Straight passes over the top, looking down."""

    enabled: bool = True
    pitch_mm: Positive = Field(
        default=0.5, description="distance between exposures; widened when max_profiles would be exceeded"
    )
    overlap_mm: NonNegative = Field(default=4.0, description="how much neighbouring passes share of the laser line")
    speed_mm_s: Positive = 50.0


class ScanDescription(Description):
    """What a program of scan motions looks like.

    With `pose` given, the sensor visits just those poses (part_from_sensor); otherwise sweeps and passes are laid
    around the part's bounding cylinder.
    """

    mode: Mode = "dynamic"
    max_profiles: Annotated[int, Field(ge=1, le=1_000_000)] = 1300
    settle_ms: NonNegative = Field(default=100.0, description="rest before each exposure of stop-and-look")
    clearance_mm: NonNegative = Field(default=5.0, description="smallest distance allowed between bodies")
    table_margin_mm: Finite = Field(
        default=0.5, description="points lower than this above the nominal table are removed as table"
    )
    sweep: SweepDescription = SweepDescription()
    raster: RasterDescription = RasterDescription()
    pose: tuple[PoseDescription, ...] = Field(default=(), description="part_from_sensor of single exposures")

    @model_validator(mode="after")
    def _has_views(self) -> Self:
        if not (self.sweep.enabled or self.raster.enabled or self.pose):
            raise ValueError("nothing to scan: enable sweep or raster, or give at least one pose")
        return self
