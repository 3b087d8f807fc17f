"""Description of the robot cell: arm, tool, rotary table, part fixture, simulation steps."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from orchestrator.config.contact import ContactDescription
from orchestrator.config.description import Description, Finite, Fraction, NonNegative, PoseDescription, Positive
from orchestrator.config.devices import ArrivalDescription, ConveyorDescription, FurtherPartDescription, check_devices
from orchestrator.config.drives import DriveDescription, InertiaDescription, MotionDescription
from orchestrator.config.gripper import GripperDescription
from orchestrator.config.light import LightDescription
from orchestrator.config.material import MaterialDescription
from orchestrator.config.sensing import CollisionDescription, DistanceSensorDescription, PresenceSensorDescription
from orchestrator.config.soft import SoftDescription, check_soft

Latency = Annotated[float, Field(ge=0.0, le=100.0)]


class JointDescription(Description):
    """One revolute joint and the link that it moves, standard Denavit-Hartenberg."""

    a_mm: Finite
    d_mm: Finite
    alpha_deg: Finite
    theta_deg: Finite = Field(default=0.0, description="offset added to the joint angle")
    min_deg: Finite
    max_deg: Finite
    max_speed_deg_s: Positive
    max_acceleration_deg_s2: Positive
    max_jerk_deg_s3: Positive = Field(default=20_000.0, description="of programmed motion at full monitor speed")
    encoder_resolution_deg: NonNegative = Field(default=0.0, description="step of the encoder; 0 is continuous")
    encoder_noise_deg: NonNegative = Field(default=0.0, description="standard deviation of the encoder's noise")
    encoder_latency_ms: Latency = Field(default=0.0, description="by which the encoder's reading is old")
    drive: DriveDescription | None = Field(default=None, description="needed where robot.drive is dynamic")
    inertia: InertiaDescription | None = Field(
        default=None, description="of the link in its own frame; else that of its mesh with robot.link_density_kg_m3"
    )
    mesh: str | None = Field(default=None, description="mesh of the link in its own frame, mm")

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.min_deg >= self.max_deg:
            raise ValueError(f"min_deg ({self.min_deg:g}) must be below max_deg ({self.max_deg:g})")
        return self


class RobotDescription(Description):
    """A six-axis arm with a spherical wrist."""

    name: str
    base: PoseDescription = Field(default=PoseDescription(), description="world_from_base")
    base_mesh: str | None = Field(default=None, description="mesh of the standing part, base frame, mm")
    joint: Annotated[tuple[JointDescription, ...], Field(min_length=6, max_length=6)]
    drive: Literal["kinematic", "dynamic"] = Field(
        default="kinematic",
        description="kinematic: joints are where the controller wants them; dynamic: masses and drives",
    )
    link_density_kg_m3: Positive = Field(default=2000.0, description="mean of a link with its motors, hollows included")
    motion: MotionDescription = MotionDescription()
    home_deg: Annotated[tuple[float, ...], Field(min_length=6, max_length=6)] = Field(
        description="joint angles at start and end of every program"
    )

    @model_validator(mode="after")
    def _dynamics_known(self) -> Self:
        for number, joint in enumerate(self.joint, start=1):
            if self.drive == "dynamic" and joint.drive is None:
                raise ValueError(f'joint[{number}].drive is missing: drive = "dynamic" needs the drive of every joint')
            if self.drive == "dynamic" and joint.inertia is None and joint.mesh is None:
                raise ValueError(f"joint[{number}] needs an inertia, or a mesh from which it follows")
        return self

    @model_validator(mode="after")
    def _home_within_limits(self) -> Self:
        for number, (angle, joint) in enumerate(zip(self.home_deg, self.joint, strict=True), start=1):
            if not joint.min_deg <= angle <= joint.max_deg:
                limits = f"{joint.min_deg:g}..{joint.max_deg:g}"
                raise ValueError(f"home_deg[{number}] = {angle:g} is outside joint {number}'s limits {limits}")
        return self


class FixtureDescription(Description):
    """The bracket between flange and sensor, by its dimensions.

    ``flange_from_sensor = Rz(rotation) T(offset, 0, plate + reach) Ry(tilt)``: a plate on the flange, an arm of
    length `reach` along the flange axis, displaced sideways by `offset`, the sensor tilted about its own Y axis.
    """

    plate_mm: NonNegative
    reach_mm: NonNegative
    offset_mm: Finite = 0.0
    tilt_deg: Finite = 0.0
    rotation_deg: Finite = 0.0


class ToolDescription(Description):
    """Where the sensor sits on the flange: a pose, or the dimensions of its fixture."""

    flange_from_sensor: PoseDescription | None = None
    fixture: FixtureDescription | None = None
    inertia: InertiaDescription | None = Field(
        default=None, description="of the sensor in its own frame; else that of its mesh with robot.link_density_kg_m3"
    )

    @model_validator(mode="after")
    def _exactly_one(self) -> Self:
        if (self.flange_from_sensor is None) == (self.fixture is None):
            raise ValueError("give exactly one of flange_from_sensor and fixture")
        return self


class TableDescription(Description):
    """Rotary table; its pose is where the axis meets the top face, z along the axis."""

    pose: PoseDescription = Field(description="world_from_table at angle 0")
    radius_mm: Positive
    thickness_mm: Positive
    max_speed_deg_s: Positive
    max_acceleration_deg_s2: Positive
    max_jerk_deg_s3: Positive = Field(default=7200.0, description="of programmed motion at full monitor speed")
    friction: NonNegative = 0.6
    encoder_resolution_deg: NonNegative = 0.0
    encoder_noise_deg: NonNegative = 0.0
    encoder_latency_ms: Latency = Field(default=0.0, description="by which the encoder's reading is old")
    reflectance: Fraction = 0.05
    material: MaterialDescription | None = Field(default=None, description="takes the place of reflectance")
    platter_mesh: str | None = Field(default=None, description="what turns, table frame, mm")
    base_mesh: str | None = Field(default=None, description="what stands still, table frame, mm")


_Corner = Annotated[tuple[Finite, ...], Field(min_length=3, max_length=3)]


class MaterialRegionDescription(Description):
    """A piece of the part with a material of its own: faces whose middle lies in a box, or that a file numbers."""

    material: MaterialDescription
    min_mm: _Corner | None = Field(default=None, description="lower corner of the box, in the mesh's coordinates")
    max_mm: _Corner | None = Field(default=None, description="upper corner; without one the box is open upwards")


class PartDescription(Description):
    """How the part sits on the table.

    The part is laid with its bounding box centred on the axis and its lowest point on the top face;
    `x_mm`, `y_mm`, `z_mm` and the angles move it from there.
    """

    fixture: Literal["clamped", "free"] = Field(
        default="clamped", description="clamped: rigid on the platter; free: stands by gravity and friction"
    )
    x_mm: Finite = 0.0
    y_mm: Finite = 0.0
    z_mm: Finite = Field(default=0.0, description="height of the lowest point above the table")
    rx_deg: Finite = Field(default=0.0, description="XYZ' rotation of the mesh before it is laid down")
    ry_deg: Finite = 0.0
    rz_deg: Finite = 0.0
    arrival: ArrivalDescription | None = Field(
        default=None, description="where it stands until it is brought to the table; on the table if not given"
    )
    density_kg_m3: Positive = 2700.0
    friction: NonNegative = 0.6
    soft: SoftDescription | None = Field(default=None, description="springs of a soft part; rigid if not given")
    reflectance: Fraction = Field(default=0.5, description="Lambertian reflectance at the laser's wavelength")
    material: MaterialDescription | None = Field(default=None, description="takes the place of reflectance")
    material_region: tuple[MaterialRegionDescription, ...] = Field(
        default=(), description="pieces with other materials; where boxes overlap the last one counts"
    )
    face_materials: str | None = Field(
        default=None, description="text file or .npy: per face 0, or the number of its material_region from 1"
    )

    @model_validator(mode="after")
    def _nothing_soft_is_clamped(self) -> Self:
        check_soft(self.soft, self.fixture)
        return self

    @model_validator(mode="after")
    def _a_clamped_part_stays(self) -> Self:
        if self.arrival is not None and self.fixture == "clamped":
            raise ValueError('fixture "clamped": a part that is brought to the table (arrival) must be "free"')
        return self


class WorldDescription(Description):
    """Steps of the simulation and what acts everywhere."""

    time_step_us: Annotated[int, Field(ge=10, le=10_000)] = 1000
    controller_cycle_us: Annotated[int, Field(ge=1000, le=100_000)] = 16_000
    gravity_m_s2: NonNegative = 9.80665

    @model_validator(mode="after")
    def _whole_cycles(self) -> Self:
        if self.controller_cycle_us % self.time_step_us:
            cycle, step = self.controller_cycle_us, self.time_step_us
            raise ValueError(f"controller_cycle_us ({cycle}) must be a multiple of time_step_us ({step})")
        return self


class CellDescription(Description):
    """The robot cell. `robot` may be a path to a robot file, relative to the cell file."""

    name: str
    world: WorldDescription = WorldDescription()
    robot: RobotDescription
    robot_reflectance: Fraction = 0.3
    robot_material: MaterialDescription | None = Field(default=None, description="takes the place of robot_reflectance")
    tool: ToolDescription
    sensor_mesh: str | None = Field(default=None, description="housing of the sensor in its own frame, mm")
    table: TableDescription
    part: PartDescription = PartDescription()
    further_part: tuple[FurtherPartDescription, ...] = ()
    conveyor: tuple[ConveyorDescription, ...] = ()
    gripper: GripperDescription | None = Field(default=None, description="none if not given")
    contact: ContactDescription = ContactDescription()
    light: Annotated[tuple[LightDescription, ...], Field(max_length=64)] = ()
    presence_sensor: tuple[PresenceSensorDescription, ...] = ()
    distance_sensor: tuple[DistanceSensorDescription, ...] = ()
    collision: CollisionDescription = CollisionDescription()

    @model_validator(mode="after")
    def _devices_fit(self) -> Self:
        check_devices(self.part.arrival, self.further_part, self.conveyor)
        return self
