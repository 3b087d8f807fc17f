"""Descriptions of the devices of a cell: further parts, obstacles, conveyors, gripper, sensors, lamps."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, StringConstraints, model_validator

from scancell.config.description import (
    Acceleration,
    Bandwidth,
    Density,
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

NAME_PATTERN = r"^[A-Za-z][A-Za-z0-9_ -]*$"
Name = Annotated[str, StringConstraints(min_length=1, pattern=NAME_PATTERN)]


class SoftDescription(Description):
    """Springs between the surface points of a part and its rigid core.

    The surface is the part's convex hull, subdivided until no edge is longer than `longest_edge_mm`. A spring and a
    damper connect each of its points to its rest position.
    """

    stiffness_n_mm: Stiffness = Field(
        description="isotropic stiffness of each point's spring, N/mm; stable up to about 0.2 mass / (number of points"
        " * time step²), the cell reports this limit when it is exceeded"
    )
    damping_ratio: Annotated[float, Field(ge=0.0, le=1000.0)] = Field(
        default=1.0, description="damping ratio of the points' oscillation; 1: critical"
    )
    longest_edge_mm: Size = Field(default=15.0, description="largest distance between neighbouring points, mm")


def check_soft(soft: SoftDescription | None, fixture: str) -> None:
    """Raise `ValueError` for a part that is soft and clamped."""
    if soft is not None and fixture == "clamped":
        raise ValueError('a soft part cannot be clamped: fixture = "free"')


# Keys of every part, the scanned one and further ones.
PartDensity = Annotated[Density, Field(description="density of the part, for mass and inertia")]
PartFriction = Annotated[
    Friction, Field(description="Coulomb friction coefficient of the part; the smaller one of two bodies applies")
]
PartSprings = Annotated[SoftDescription | None, Field(description="springs of a soft part; default: rigid")]
PartReflectance = Annotated[
    Fraction, Field(description="Lambertian reflectance of the part at the laser's wavelength, 0..1")
]
PartMaterial = Annotated[MaterialDescription | None, Field(description="material of the part; overrides reflectance")]


class FurtherPartDescription(Description):
    """A part beside the scanned one, which is ``part[1]``; these are numbered from 2 in the order of the file."""

    name: Name = Field(description="unique name of the part")
    mesh: str = Field(description="file of the part's mesh, or of an artefact, part frame")
    unit: Literal["mm", "m", "inch"] = Field(default="mm", description="length unit of the mesh file")
    stands_on: str = Field(
        default="table",
        pattern=r"^(table|world|conveyor\[[1-9][0-9]*\])$",
        description="support of the part: table, world or conveyor[i]",
    )
    pose: PoseDescription = Field(
        default=PoseDescription(),
        description="support_from_part at the start; frame of the table at angle 0, of the world, or of the belt",
    )
    fixture: Literal["clamped", "free"] = Field(
        default="free", description="clamped: rigid on its support; free: held by gravity and friction"
    )
    density_kg_m3: PartDensity = 2700.0
    friction: PartFriction = 0.6
    soft: PartSprings = None
    reflectance: PartReflectance = 0.5
    material: PartMaterial = None

    @model_validator(mode="after")
    def _part_on_belt_is_free(self) -> Self:
        if self.fixture == "clamped" and self.stands_on.startswith("conveyor"):
            raise ValueError(f'fixture "clamped": a part on {self.stands_on} cannot be clamped; expected "free"')
        return self

    @model_validator(mode="after")
    def _soft_part_is_free(self) -> Self:
        check_soft(self.soft, self.fixture)
        return self

    @property
    def conveyor(self) -> int | None:
        """Number, from 1, of the conveyor that supports the part."""
        return _conveyor(self.stands_on)


class ConveyorDescription(Description):
    """A conveyor belt. Its frame has the origin in the centre of the top face, x along the travel and z up."""

    name: Name = Field(description="unique name of the conveyor")
    pose: PoseDescription = Field(description="world_from_belt: pose of the belt frame")
    length_mm: Size = Field(description="length of the belt along its travel, mm")
    width_mm: Size = Field(description="width of the belt, mm")
    thickness_mm: Size = Field(default=50.0, description="thickness of the belt below its top face, mm")
    max_speed_mm_s: Speed = Field(default=500.0, description="speed limit of the belt, mm/s")
    max_acceleration_mm_s2: Acceleration = Field(default=1000.0, description="acceleration limit of the belt, mm/s²")
    friction: Friction = Field(
        default=0.6, description="Coulomb friction coefficient of the belt; the smaller one of two bodies applies"
    )
    encoder_resolution_mm: Annotated[float, Field(ge=0.0, le=1000.0)] = Field(
        default=0.0, description="resolution of the encoder of the belt's travel, mm; 0: exact"
    )
    reflectance: Fraction = Field(
        default=0.05, description="Lambertian reflectance of the belt at the laser's wavelength, 0..1"
    )
    material: MaterialDescription | None = Field(
        default=None, description="material of the belt; overrides reflectance"
    )


class ObstacleDescription(Description):
    """A rigid body in the world, on the table, an axis or the flange: a post, a clamp, a fence, a carriage, a holder.

    It blocks light and is a body of the planner and of the FMU, whose contact shape of it is its convex hull.
    """

    name: Name = Field(description="unique name of the obstacle")
    mesh: str = Field(description="file of the obstacle's mesh, or of an artefact, its own frame")
    unit: Literal["mm", "m", "inch"] = Field(default="mm", description="length unit of the mesh file")
    moves_with: str = Field(default="world", description="what carries it: world, table, an axis or flange")
    pose: PoseDescription = Field(
        default=PoseDescription(),
        description="pose of the mesh in the frame of what carries it, with all axes at 0",
    )
    known: bool = Field(
        default=True,
        description="false: only in the simulated cell, unknown to planning and reconstruction",
    )
    clearance_mm: Length | None = Field(
        default=None, description="smallest distance of arm and sensor from it, mm; default: scan.clearance_mm"
    )
    reflectance: Fraction = Field(
        default=0.3, description="Lambertian reflectance of the obstacle at the laser's wavelength, 0..1"
    )
    material: MaterialDescription | None = Field(
        default=None, description="material of the obstacle; overrides reflectance"
    )


# Names of the cell's own bodies.
RESERVED_NAMES = frozenset(
    {
        "base",
        *(f"link{i}" for i in range(1, 9)),
        "sensor",
        "table",
        "table_base",
        "part",
        "gripper",
        "finger1",
        "finger2",
    }
)


class ArrivalDescription(Description):
    """Start position of a scanned part that is brought to the table."""

    stands_on: str = Field(
        pattern=r"^(world|conveyor\[[1-9][0-9]*\])$", description="support of the part: world or conveyor[i]"
    )
    pose: PoseDescription = Field(
        default=PoseDescription(),
        description="support_from_part at the start: in the frame of the world, or of the belt",
    )

    @property
    def conveyor(self) -> int | None:
        """Number, from 1, of the conveyor that supports the part."""
        return _conveyor(self.stands_on)


def _conveyor(stands_on: str) -> int | None:
    return int(stands_on[9:-1]) if stands_on.startswith("conveyor") else None


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


class CellSensorDescription(Description):
    """Keys that all sensors have. The FMU reads the further keys of a sensor in SI units, by the same names."""

    name: str = Field(description="name of the sensor")
    moves_with: str = Field(
        default="world",
        pattern=r"^(world|sensor|table|link\[[1-8]\]|part\[[1-9][0-9]*\]|finger\[[12]\])$",
        description="frame that the sensor moves with",
    )
    pose: PoseDescription = Field(
        default=PoseDescription(), description="frame_from_sensor: pose of the sensor in the frame that it moves with"
    )
    period_ms: Annotated[float, Field(ge=0.001, le=1000.0)] = Field(
        default=1.0, description="time between two readings, ms"
    )


class PresenceSensorDescription(CellSensorDescription):
    """A box that detects whether any body intersects it. The origin of its frame is the box's centre."""

    x_size_mm: Size = Field(description="size of the box along its x, mm")
    y_size_mm: Size = Field(description="size of the box along its y, mm")
    z_size_mm: Size = Field(description="size of the box along its z, mm")


class DistanceSensorDescription(CellSensorDescription):
    """Triangulating distance sensor: a ray along its z axis, and a lens beside the origin that sees the spot.

    A reading is invalid when the path from spot to lens is occluded or the spot is out of range.
    """

    nearest_mm: Length = Field(default=0.0, description="start of the measuring range along z, mm")
    farthest_mm: Size = Field(description="end of the measuring range along z, mm")
    lens_x_mm: Size = Field(default=20.0, description="position of the lens on the sensor's x axis, mm")
    noise_mm: Length = Field(default=0.0, description="standard deviation of a reading's noise, mm")
    resolution_mm: Length = Field(default=0.0, description="quantisation step of a reading, mm; 0: continuous")

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.nearest_mm >= self.farthest_mm:
            raise ValueError(f"nearest_mm ({self.nearest_mm:g}) must be below farthest_mm ({self.farthest_mm:g})")
        return self


class LightCurtainDescription(CellSensorDescription):
    """Parallel beams between two posts. The first beam runs along z from the origin, the others beside it along x."""

    width_mm: Size = Field(description="distance between the posts along z, mm")
    height_mm: Size = Field(description="extent of the beams along x from the first beam, mm")
    beam_spacing_mm: Size = Field(description="distance between two beams, mm; at most 1000 beams")

    @model_validator(mode="after")
    def _number_of_beams(self) -> Self:
        if self.height_mm / self.beam_spacing_mm >= 1000:
            raise ValueError(
                f"beam_spacing_mm ({self.beam_spacing_mm:g}) must give at most 1000 beams over"
                f" height_mm ({self.height_mm:g})"
            )
        return self


class CollisionDescription(Description):
    """Outputs of the FMU for collisions and clearances between the cell's bodies."""

    outputs: bool = Field(default=True, description="whether the FMU has outputs for collision and clearance")
    stops_arm: bool = Field(
        default=False,
        description="whether the controller makes an emergency stop when a collision begins or becomes deeper",
    )
    swept: bool = Field(
        default=True,
        description="whether collisions between two controller cycles are found, too; false: poses are sampled once "
        "per cycle, which costs less",
    )
    range_mm: Size = Field(default=20.0, description="largest clearance that is computed, mm; larger values cost time")
    max_faces: Annotated[int, Field(ge=4, le=10_000_000)] = Field(
        default=5000, description="meshes with more triangles are decimated to about this number"
    )


class LightDescription(Description):
    """A lamp: a point radiates uniformly in all directions, an area like a Lambertian surface along +z of its pose."""

    kind: Literal["point", "rectangle", "disc"] = Field(description="shape of the lamp")
    frame: str = Field(
        default="world",
        pattern=r"^(world|sensor|table|part|link\[[1-8]\])$",
        description="frame that the lamp moves with",
    )
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
