"""Description of the robot cell: tool, rotary table, part, simulation steps."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from scancell.config.description import (
    Angle,
    AngularAcceleration,
    AngularJerk,
    AngularSpeed,
    Coordinate,
    Description,
    FileDescription,
    Fraction,
    Friction,
    Length,
    Point,
    PoseDescription,
    Size,
)
from scancell.config.devices import (
    ArrivalDescription,
    CollisionDescription,
    ConveyorDescription,
    DistanceSensorDescription,
    FurtherPartDescription,
    GripperDescription,
    LightCurtainDescription,
    LightDescription,
    ObstacleDescription,
    PartDensity,
    PartFriction,
    PartMaterial,
    PartReflectance,
    PartSprings,
    PresenceSensorDescription,
    check_devices,
    check_soft,
)
from scancell.config.estimated import EstimatedDescription
from scancell.config.frames import (
    AxisDescription,
    FrameDescription,
    FurtherSensorDescription,
    TcpDescription,
    check_carriers,
    check_names,
)
from scancell.config.material import ContactDescription, MaterialDescription
from scancell.config.robot import EncoderLatency, EncoderNoise, EncoderResolution, InertiaDescription, RobotDescription


class FixtureDescription(Description):
    """The bracket between flange and sensor, by its dimensions.

    ``flange_from_sensor = Rz(rotation) T(offset, 0, plate + reach) Ry(tilt)``: a plate on the flange, an arm of
    length `reach` along the flange axis, displaced sideways by `offset`, the sensor tilted about its own Y axis.
    """

    plate_mm: Length = Field(description="thickness of the plate on the flange, along flange z, mm")
    reach_mm: Length = Field(description="distance from the plate to the sensor's origin along flange z, mm")
    offset_mm: Coordinate = Field(default=0.0, description="sideways offset of the sensor, along the rotated x, mm")
    tilt_deg: Angle = Field(default=0.0, description="tilt of the sensor about its own Y axis, deg")
    rotation_deg: Angle = Field(default=0.0, description="rotation of the whole fixture about flange z, deg")


class ToolDescription(Description):
    """Pose of the sensor on the flange: given directly, or by the dimensions of its fixture."""

    flange_from_sensor: PoseDescription | None = Field(
        default=None, description="pose of the sensor in the flange frame; excludes fixture"
    )
    fixture: FixtureDescription | None = Field(
        default=None, description="dimensions of the bracket that holds the sensor; excludes flange_from_sensor"
    )
    inertia: InertiaDescription | None = Field(
        default=None,
        description="mass properties of the sensor, sensor frame; default: from sensor_mesh and"
        " robot.link_density_kg_m3",
    )

    @model_validator(mode="after")
    def _exactly_one(self) -> Self:
        if (self.flange_from_sensor is None) == (self.fixture is None):
            raise ValueError("give exactly one of flange_from_sensor and fixture")
        return self


class TableDescription(Description):
    """Rotary table. The origin of its frame is where the axis meets the top face, z along the axis."""

    pose: PoseDescription = Field(description="world_from_table at table angle 0")
    radius_mm: Size = Field(description="radius of the platter, mm")
    thickness_mm: Size = Field(description="thickness of the platter below its top face, mm")
    max_speed_deg_s: AngularSpeed = Field(description="speed limit of the table, deg/s")
    max_acceleration_deg_s2: AngularAcceleration = Field(description="acceleration limit of the table, deg/s²")
    max_jerk_deg_s3: AngularJerk = Field(
        default=7200.0, description="jerk limit of programmed motion at monitor speed 1, deg/s³"
    )
    friction: Friction = Field(
        default=0.6, description="Coulomb friction coefficient of the platter; the smaller one of two bodies applies"
    )
    encoder_resolution_deg: EncoderResolution = 0.0
    encoder_noise_deg: EncoderNoise = 0.0
    encoder_latency_ms: EncoderLatency = 0.0
    reflectance: Fraction = Field(
        default=0.05, description="Lambertian reflectance of platter and base at the laser's wavelength, 0..1"
    )
    material: MaterialDescription | None = Field(
        default=None, description="material of platter and base; overrides reflectance"
    )
    platter_mesh: str | None = Field(
        default=None, description="file of the rotating platter's mesh, table frame, mm; default: its cylinder"
    )
    base_mesh: str | None = Field(
        default=None, description="file of the fixed base's mesh, table frame at angle 0, mm; default: none"
    )


class MaterialRegionDescription(Description):
    """A region of the part with a material of its own: faces with their centre in a box, or listed in a file."""

    material: MaterialDescription = Field(description="material of the faces in this region")
    min_mm: Point | None = Field(
        default=None, description="lower corner of the box, mesh coordinates, mm; default: unbounded below"
    )
    max_mm: Point | None = Field(
        default=None, description="upper corner of the box, mesh coordinates, mm; default: unbounded above"
    )


class PartDescription(Description):
    """Position and material of the part on the table.

    The part is placed with its bounding box centred on the table axis and its lowest point on the top face;
    `x_mm`, `y_mm`, `z_mm` and the angles move it from there.
    """

    fixture: Literal["clamped", "free"] = Field(
        default="clamped", description="clamped: rigid on the platter; free: held by gravity and friction"
    )
    moves_with: Literal["table", "flange"] = Field(
        default="table",
        description="what carries the part: the table, or the flange, whose frame replaces that of the table; a part on"
        " the flange is placed, but not scanned yet",
    )
    x_mm: Coordinate = Field(default=0.0, description="bounding-box centre along x of the table frame, mm")
    y_mm: Coordinate = Field(default=0.0, description="bounding-box centre along y of the table frame, mm")
    z_mm: Coordinate = Field(default=0.0, description="height of the lowest point above the table's top face, mm")
    rx_deg: Angle = Field(
        default=0.0, description="rotation of the mesh before it is placed: first angle of XYZ', about x, deg"
    )
    ry_deg: Angle = Field(default=0.0, description="second angle of XYZ', about the rotated y, deg")
    rz_deg: Angle = Field(default=0.0, description="third angle of XYZ', about the twice rotated z, deg")
    arrival: ArrivalDescription | None = Field(
        default=None, description="start position of a part that is brought to the table; default: on the table"
    )
    density_kg_m3: PartDensity = 2700.0
    friction: PartFriction = 0.6
    soft: PartSprings = None
    reflectance: PartReflectance = 0.5
    material: PartMaterial = None
    material_region: tuple[MaterialRegionDescription, ...] = Field(
        default=(), description="regions with other materials; where boxes overlap the last one applies"
    )
    face_materials: str | None = Field(
        default=None,
        description="text file or .npy with one integer per face: number of its material_region from 1, or 0 for none",
    )

    @model_validator(mode="after")
    def _soft_part_is_free(self) -> Self:
        check_soft(self.soft, self.fixture)
        return self

    @model_validator(mode="after")
    def _arriving_part_is_free(self) -> Self:
        if self.arrival is not None and self.fixture == "clamped":
            raise ValueError('fixture "clamped": a part that is brought to the table (arrival) must be "free"')
        return self


class WorldDescription(Description):
    """Time steps of the simulation, gravity and floor."""

    time_step_us: Annotated[int, Field(ge=10, le=10_000)] = Field(
        default=1000, description="step of the dynamics simulation, µs"
    )
    controller_cycle_us: Annotated[int, Field(ge=1000, le=100_000)] = Field(
        default=16_000, description="cycle of the robot controller's set-points, µs; a multiple of time_step_us"
    )
    gravity_m_s2: Annotated[float, Field(ge=0.0, le=1000.0)] = Field(
        default=9.80665, description="gravity along world -z, m/s²"
    )
    floor_z_mm: Coordinate = Field(
        default=0.0, description="height of the floor, on which falling parts come to rest, mm"
    )

    @property
    def controller_cycle(self) -> float:
        """Cycle of the robot controller, s."""
        return self.controller_cycle_us * 1e-6

    @model_validator(mode="after")
    def _whole_cycles(self) -> Self:
        if self.controller_cycle_us % self.time_step_us:
            cycle, step = self.controller_cycle_us, self.time_step_us
            raise ValueError(f"controller_cycle_us ({cycle}) must be a multiple of time_step_us ({step})")
        return self


class CellDescription(FileDescription):
    """The robot cell. In a file, `robot` may also be the path of a robot file.

    Paths of files are relative to the file that names them; what does not exist there is looked up in the folder
    of the shipped descriptions (cells, robots), so that a copied sample works in any folder.

    Examples
    --------
    >>> cell = scancell.load_setup().cell
    >>> moved = cell.replace({"part.x_mm": 20, "table.pose.z_mm": 320})
    >>> moved.part.x_mm, cell.part.x_mm
    (20.0, 0.0)
    """

    kind: ClassVar[str] = "cell"
    shipped: ClassVar[str] = "cells/default.toml"

    name: str = Field(description="name of the cell")
    world: WorldDescription = Field(default=WorldDescription(), description="time steps of the simulation, gravity")
    robot: RobotDescription = Field(description="the arm")
    robot_reflectance: Fraction = Field(
        default=0.3, description="Lambertian reflectance of arm and sensor housing at the laser's wavelength, 0..1"
    )
    robot_material: MaterialDescription | None = Field(
        default=None, description="material of arm and sensor housing; overrides robot_reflectance"
    )
    tool: ToolDescription = Field(description="pose of the sensor on the flange")
    sensor_mesh: str | None = Field(
        default=None, description="file of the sensor housing's mesh, sensor frame, mm; default: none"
    )
    table: TableDescription = Field(description="the rotary table")
    part: PartDescription = Field(
        default=PartDescription(), description="position and material of the part that is scanned"
    )
    further_part: tuple[FurtherPartDescription, ...] = Field(
        default=(), description="parts beside the one that is scanned, numbered from part[2]"
    )
    conveyor: tuple[ConveyorDescription, ...] = Field(default=(), description="conveyor belts")
    obstacle: tuple[ObstacleDescription, ...] = Field(
        default=(), description="rigid bodies fixed in the world or on the table"
    )
    gripper: GripperDescription | None = Field(default=None, description="gripper on the flange; default: none")
    axis: tuple[AxisDescription, ...] = Field(default=(), description="axes beside the joints and the table")
    further_sensor: tuple[FurtherSensorDescription, ...] = Field(
        default=(), description="sensors beside that of the tool, numbered from sensor[2]"
    )
    tcp: tuple[TcpDescription, ...] = Field(default=(), description="named tool centre points on the flange")
    frame: tuple[FrameDescription, ...] = Field(default=(), description="user frames: coordinate systems of programs")
    contact: ContactDescription = Field(
        default=ContactDescription(), description="contact solver and number of contact points"
    )
    light: Annotated[tuple[LightDescription, ...], Field(max_length=64)] = Field(
        default=(), description="external lamps that light the scene"
    )
    presence_sensor: tuple[PresenceSensorDescription, ...] = Field(
        default=(), description="presence sensors (light barriers)"
    )
    distance_sensor: tuple[DistanceSensorDescription, ...] = Field(
        default=(), description="triangulating distance sensors with a single ray"
    )
    light_curtain: tuple[LightCurtainDescription, ...] = Field(default=(), description="light curtains")
    collision: CollisionDescription = Field(
        default=CollisionDescription(), description="collision and clearance outputs of the FMU"
    )
    estimated: EstimatedDescription | None = Field(
        default=None, description="deviations that calibration found; reconstruction applies them"
    )

    @model_validator(mode="after")
    def _devices_fit(self) -> Self:
        check_devices(self.part.arrival, self.further_part, self.conveyor, self.obstacle)
        return self

    @model_validator(mode="after")
    def _names_are_unique(self) -> Self:
        check_names(self.tcp, self.frame)
        return self

    @model_validator(mode="after")
    def _carriers_exist(self) -> Self:
        others = {f"further_sensor[{i}].moves_with": one.moves_with for i, one in enumerate(self.further_sensor, 1)}
        check_carriers(self.axis, {"robot.moves_with": self.robot.moves_with, **others}, len(self.robot.joint))
        return self

    @model_validator(mode="after")
    def _joints_exist(self) -> Self:
        sensors = {
            "presence_sensor": self.presence_sensor,
            "distance_sensor": self.distance_sensor,
            "light_curtain": self.light_curtain,
        }
        frames = {f"light[{i}].frame": lamp.frame for i, lamp in enumerate(self.light, 1)}
        for key, devices in sensors.items():
            frames |= {f"{key}[{i}].moves_with": device.moves_with for i, device in enumerate(devices, 1)}
        joints = len(self.robot.joint)
        if self.estimated is not None and len(self.estimated.dh) not in (0, joints):
            raise ValueError(f"estimated.dh has {len(self.estimated.dh)} rows: expected {joints}, one for each joint")
        links = {f"link[{i}]" for i in range(1, joints + 1)}
        for key, frame in frames.items():
            if frame.startswith("link") and frame not in links:
                raise ValueError(f"{key} = '{frame}': expected link[1] to link[{len(links)}], one for each joint")
        return self
