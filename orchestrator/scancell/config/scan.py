"""Description of a scan: views, spacing, speed, and the space to keep clear of."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from scancell.config.choices import LengthUnit, OccupiedFrame, ScanMode
from scancell.config.description import (
    Angle,
    AngularSpeed,
    Coordinate,
    Description,
    FileDescription,
    Fraction,
    Length,
    PoseDescription,
    Size,
    Speed,
)

_Power = Annotated[float, Field(ge=0.001, le=1000.0)]
_Weight = Annotated[float, Field(ge=0.0, le=1e6)]
_Singularity = Annotated[float, Field(ge=0.0, le=100.0)]
_PathElevation = Annotated[float, Field(ge=0.0, le=90.0)]

_Elevation = Annotated[float, Field(ge=0.0, le=85.0)]


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
    """A path of the sensor relative to the part; planning chooses the motion of the table, or of another axis."""

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
    axis: Annotated[tuple[str, ...], Field(min_length=1, max_length=2)] = Field(
        default=("table",),
        description="axes that move along the path: table, the name of another axis, or the table and another one",
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
        if len(self.axis) > 1 and (len(set(self.axis)) < 2 or "table" not in self.axis):
            raise ValueError(f"axis = {list(self.axis)}: expected the table and another axis where there are two")
        return self


class OccupiedDescription(Description):
    """Space that planning keeps clear of, from a file: voxels of `scancell survey`, or a point cloud."""

    file: str = Field(
        description="voxels (NPZ) of `scancell survey`, or a point cloud (ply, pcd, las, laz, e57, npz, text)"
    )
    frame: OccupiedFrame = Field(
        default="part",
        description="frame of the points of a cloud, as --frame of the scan that made it; points in the frames of part"
        " and table turn with the table",
    )
    unit: LengthUnit | None = Field(
        default=None,
        description="unit of the coordinates of a cloud; by default what the file states, or else mm",
    )
    voxel_mm: Size = Field(default=5.0, description="edge length of the voxels of a cloud, mm")
    inflate_mm: Length = Field(
        default=0.0, description="space within this distance of points or voxels counts as occupied, mm"
    )


class SweepDescription(Description):
    """Full turns of the table under a fixed sensor."""

    enabled: bool = Field(default=True, description="whether the scan contains sweeps")
    elevations_deg: tuple[_Elevation, ...] = Field(
        default=(30.0, 60.0), description="angles of the viewing direction above the horizontal, deg; sweeps at each"
    )
    azimuth_deg: Angle = Field(
        default=105.0, description="direction from the table axis to the sensor, from world +x about z, deg"
    )
    standoff_mm: Size | Literal["sensor"] = Field(
        default="sensor",
        description="distance along sensor Z to the nearest surface of the part, also in passes, mm;"
        " sensor: 80, or a twentieth of the measuring range beyond its start where 80 is not in its nearer half",
    )
    height_step_mm: Size = Field(
        default=30.0, description="distance between neighbouring sweeps along the laser line, mm"
    )
    angle_step_deg: Annotated[float, Field(ge=0.01, le=30.0)] | Literal["sensor"] = Field(
        default=1.0,
        description="table angle between exposures, deg; sensor: the smallest at speed_deg_s, by the sensor's highest"
        " profile rate; increased to stay within max_profiles",
    )
    speed_deg_s: AngularSpeed = Field(default=40.0, description="table speed during exposures, deg/s")


class RasterDescription(Description):
    """Straight passes over the top of the part, sensor pointing down."""

    enabled: bool = Field(default=True, description="whether the scan contains passes")
    pitch_mm: Size | Literal["sensor"] = Field(
        default=0.5,
        description="distance between exposures along the pass, mm; sensor: the smallest at speed_mm_s, by the sensor's"
        " highest profile rate; increased to stay within max_profiles",
    )
    overlap_mm: Length = Field(default=4.0, description="overlap of neighbouring passes along the laser line, mm")
    speed_mm_s: Speed = Field(default=50.0, description="speed of the sensor along the pass, mm/s")


class BeltDescription(Description):
    """A part that its conveyor (`cell.part.arrival`) carries below the sensor, which is at rest.

    Exposures follow the encoder of the belt, so that they are equally far apart on the part at any speed of the belt.
    """

    pose: PoseDescription | None = Field(
        default=None,
        description="belt_from_sensor: where the arm holds the sensor while the part passes, frame of the belt at rest;"
        " not of a sensor that the arm does not carry, which stands where the cell places it",
    )
    pitch_mm: Size = Field(
        default=0.5,
        description="travel of the belt between exposures by its encoder, mm; increased to stay within max_profiles",
    )
    speed_mm_s: Annotated[float, Field(ge=-100_000.0, le=100_000.0)] = Field(
        default=100.0, description="speed of the belt, mm/s; positive along x of its frame, not 0"
    )

    @model_validator(mode="after")
    def _moves(self) -> Self:
        if self.speed_mm_s == 0.0:
            raise ValueError("speed_mm_s = 0: the part never passes; expected a speed other than 0")
        return self


class PairClearanceDescription(Description):
    """Clearance of one pair of bodies, which overrides all other values for it."""

    bodies: tuple[str, str] = Field(description="names of the bodies: sensor, link4, table, part, an obstacle's …")
    clearance_mm: Length = Field(description="minimum distance between the two bodies, mm")


FaceName = Annotated[int, Field(ge=0, le=10_000_000)] | Annotated[str, Field(min_length=1)]


class FeatureGoalDescription(Description):
    """Goal of the views for a feature of a CAD part: uncertainty of its place or size, share of its faces, or both."""

    faces: Annotated[tuple[FaceName, ...], Field(min_length=1)] = Field(
        description="faces of the feature by number, from 0, or by label"
    )
    deviation_um: Annotated[float, Field(gt=0.0, le=1e6)] | None = Field(
        default=None, description="largest predicted standard deviation of its least-squares surface, um"
    )
    of: Literal["place", "size"] = Field(
        default="place", description="what deviates: the place of the surface anywhere on the feature, or its radius"
    )
    share: Annotated[float, Field(ge=0.0, le=1.0)] = Field(
        default=0.0, description="share of the measurable surface of its faces to see, 0..1"
    )


class CoverageDescription(Description):
    """Choice of views by coverage of the measurable surface, instead of the fixed sweeps and passes.

    Sweeps at any elevation and short passes in any direction take part as far as `sweep` and `raster` are enabled;
    speeds, spacing and stand-off are theirs.
    """

    enabled: bool = Field(default=False, description="whether views are chosen by coverage")
    share: Annotated[float, Field(gt=0.0, le=1.0)] = Field(
        default=0.99, description="share of the measurable surface to see, 0..1"
    )
    feature: tuple[FeatureGoalDescription, ...] = Field(
        default=(), description="features of a CAD part and what to tell of them; they take the place of share"
    )
    max_views: Annotated[int, Field(ge=1, le=1000)] = Field(default=100, description="largest number of views")
    max_time_s: Annotated[float, Field(ge=0.001, le=1e7)] = Field(
        default=600.0, description="largest estimated duration of all views, s"
    )


class ScanAxisDescription(Description):
    """An axis beside joints and table whose position the planner chooses for each view: from its start in steps."""

    name: str = Field(description="name of the axis in the cell")
    step_mm: Size | None = Field(default=None, description="distance between its candidates if it slides, mm")
    step_deg: Annotated[float, Field(ge=0.01, le=360.0)] | None = Field(
        default=None, description="angle between its candidates if it turns, deg"
    )

    @model_validator(mode="after")
    def _has_a_step(self) -> Self:
        if (self.step_mm is None) == (self.step_deg is None):
            raise ValueError("give exactly one of step_mm and step_deg")
        return self


class ScanDescription(FileDescription):
    """Views of a scan: with `pose` these poses only, otherwise planned sweeps and passes around the part.

    Examples
    --------
    >>> scancell.scan("part.stl", scan=scancell.ScanDescription(max_profiles=40), engine="geometric")
    ScanResult('part.stl', engine='geometric', seed=0: 34 profiles, ... points)
    """

    kind: ClassVar[str] = "scan"
    shipped: ClassVar[str] = "scans/default.toml"

    mode: ScanMode = Field(
        default="dynamic",
        description="dynamic: exposures while moving; stop-and-look: the cell is at rest during every exposure",
    )
    max_profiles: Annotated[int, Field(ge=1, le=1_000_000)] = Field(
        default=1300, description="largest number of exposures; spacing is increased to stay within it"
    )
    settle_ms: Annotated[float, Field(ge=0.0, le=1e6)] = Field(
        default=100.0, description="waiting time at rest before each exposure in stop-and-look mode, ms"
    )
    clearance_mm: Length = Field(default=5.0, description="minimum distance between bodies, mm")
    pair_clearance: tuple[PairClearanceDescription, ...] = Field(
        default=(), description="pairs of bodies with another clearance"
    )
    max_planning_work: Annotated[float, Field(ge=0.001, le=1e6)] = Field(
        default=300.0,
        description="limit of the work of planning, counted and not timed: a unit is about a second of one core",
    )
    max_lost_share: Fraction = Field(
        default=0.2,
        description="share of the surface seen by the requested sweeps and passes that may be lost to infeasible ones",
    )
    verify: bool = Field(
        default=True,
        description="whether python-fcl, an independent library, checks the finished plan for collisions",
    )
    occupied: tuple[OccupiedDescription, ...] = Field(
        default=(), description="measured space that planning avoids in addition to the bodies of the cell"
    )
    table_margin_mm: Coordinate = Field(
        default=0.5,
        description="points less than this above the nominal top face of the table are removed as table points, except "
        "where a low upper side of the nominal part covers the table, mm; in a scan on a belt, above the belt",
    )
    sweep: SweepDescription = Field(default=SweepDescription(), description="turns of the table under a fixed sensor")
    raster: RasterDescription = Field(default=RasterDescription(), description="straight passes over the part's top")
    coverage: CoverageDescription = Field(
        default=CoverageDescription(), description="choice of views by coverage of the measurable surface"
    )
    pose: tuple[PoseDescription, ...] = Field(
        default=(), description="part_from_sensor of single exposures; replaces sweeps and passes"
    )

    belt: BeltDescription | None = Field(
        default=None, description="scan of a part on a moving belt; replaces sweeps and passes"
    )
    path: tuple[PathDescription, ...] = Field(
        default=(), description="sensor paths over the part, scanned after sweeps and passes"
    )
    axis: tuple[ScanAxisDescription, ...] = Field(
        default=(),
        description="axes beside joints and table whose positions are chosen for each view, which rest during it;"
        " the others stay where they start",
    )

    @model_validator(mode="after")
    def _takes_its_rate_in_motion(self) -> Self:
        if self.mode == "dynamic":
            return self
        spacings = [("sweep.angle_step_deg", self.sweep.angle_step_deg), ("raster.pitch_mm", self.raster.pitch_mm)]
        spacings += [(f"path[{number}].pitch_mm", path.pitch_mm) for number, path in enumerate(self.path, start=1)]
        for key, spacing in spacings:
            if spacing == "sensor":
                raise ValueError(
                    f'{key} = "sensor" needs mode = "dynamic", not "{self.mode}": the rate is that in motion'
                )
        return self

    @model_validator(mode="after")
    def _belt_is_alone(self) -> Self:
        if self.belt is None:
            return self
        if self.mode != "dynamic":
            raise ValueError(f'belt: needs mode = "dynamic", not "{self.mode}": the belt moves during exposures')
        others = {"pose": self.pose, "path": self.path, "coverage.enabled": self.coverage.enabled}
        given = [key for key, value in others.items() if value]
        if given:
            raise ValueError(f"give either belt or {' and '.join(given)}")
        return self

    @model_validator(mode="after")
    def _has_views(self) -> Self:
        if self.belt is not None:
            return self
        if not (self.sweep.enabled or self.raster.enabled or self.pose or self.path):
            raise ValueError("nothing to scan: enable sweep or raster, or give at least one path or pose")
        if self.coverage.enabled and not (self.sweep.enabled or self.raster.enabled):
            raise ValueError("coverage.enabled: enable sweep or raster, whose views it chooses from")
        if self.pose and self.path:
            raise ValueError("give either pose or path, not both")
        return self
