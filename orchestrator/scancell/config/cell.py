"""Description of the robot cell: tool, rotary table, part, further axes, network, time steps, estimated deviations."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, StringConstraints, model_validator

from scancell.config.description import (
    Acceleration,
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
    LinearJerk,
    Point,
    PoseDescription,
    Size,
    Speed,
    split_unit,
    to_si,
    validate,
)
from scancell.config.devices import (
    RESERVED_NAMES,
    ArrivalDescription,
    CollisionDescription,
    ConveyorDescription,
    DistanceSensorDescription,
    FurtherPartDescription,
    GripperDescription,
    LightCurtainDescription,
    LightDescription,
    Name,
    ObstacleDescription,
    PartDensity,
    PartFriction,
    PartMaterial,
    PartReflectance,
    PartSprings,
    PresenceSensorDescription,
    check_soft,
)
from scancell.config.material import ContactDescription, MaterialDescription
from scancell.config.robot import (
    MAX_JOINTS,
    EncoderLatency,
    EncoderNoise,
    EncoderResolution,
    InertiaDescription,
    RobotDescription,
)
from scancell.config.sensor import SensorDescription
from scancell.errors import DescriptionError

_DIGITS = 9  # of numbers in mm, deg and ms

_Length = Field(default=0.0, description="estimated deviation, mm; as as_built of the same name")
_Angle = Field(default=0.0, description="estimated deviation, deg; as as_built of the same name")

# Names of the cell's own tools and frames.
RESERVED_TOOLS = frozenset({"sensor", "gripper"})
MAX_FURTHER_AXES = 3  # beside joints and table
MAX_FURTHER_SENSORS = 7  # beside that of the tool
RESERVED_FRAMES = frozenset({"world", "base", "table", "tool"})

# Names that would be those of columns of files: ``NAME_deg``, ``NAME_mm``.
_COLUMNS = ("part", "sensor", "flange", "x", "y", "z", "rx", "ry", "rz", "sigma", "diameter")

_Delay = Annotated[float, Field(ge=0.0, le=1e7)]  # ms


def sensor_frame(number: int) -> str:
    """Name of the frame of a sensor by its number, from 1: ``sensor``, then ``sensor[2]`` and so on."""
    return "sensor" if number == 1 else f"sensor[{number}]"


def is_reserved_axis(name: str) -> bool:
    """Whether an axis cannot have a name, because another frame or a column of files has it."""
    return name in {*RESERVED_FRAMES, *_COLUMNS} or re.fullmatch(r"qd{0,2}[0-9]+", name) is not None


class _EstimatedPoseDescription(Description):
    """Deviation of a pose: translation, then rotation XYZ'."""

    x_mm: Coordinate = _Length
    y_mm: Coordinate = _Length
    z_mm: Coordinate = _Length
    rx_deg: Angle = _Angle
    ry_deg: Angle = _Angle
    rz_deg: Angle = _Angle


class EstimatedToolDescription(_EstimatedPoseDescription):
    """Deviation of a sensor from its nominal pose on its carrier: translation, then rotation XYZ', nominal frame."""


class EstimatedGraspDescription(_EstimatedPoseDescription):
    """Deviation of a part on the flange from its nominal pose there: translation, then rotation XYZ', part frame."""


_Wobble = Field(
    default=0.0,
    description="wobble of the axis, deg: at table angle t it is tilted about the table's nominal x axis by"
    " rx_cos cos t + rx_sin sin t, and about y likewise",
)


class EstimatedTableDescription(Description):
    """Deviation of the table axis from its nominal pose, and its wobble."""

    x_mm: Coordinate = _Length
    y_mm: Coordinate = _Length
    z_mm: Coordinate = _Length
    rx_deg: Angle = _Angle
    ry_deg: Angle = _Angle
    wobble_rx_cos_deg: Angle = _Wobble
    wobble_rx_sin_deg: Angle = _Wobble
    wobble_ry_cos_deg: Angle = _Wobble
    wobble_ry_sin_deg: Angle = _Wobble


class EstimatedAxisDescription(_EstimatedPoseDescription):
    """Deviation of the frame that a further axis carries, at its position 0: translation, then rotation XYZ'."""


class EstimatedConveyorDescription(Description):
    """Deviation of the direction of a belt from x of its frame, and the scale error of its encoder."""

    ry_deg: Angle = _Angle
    rz_deg: Angle = _Angle
    encoder_scale: Annotated[float, Field(ge=-0.5, le=0.5)] = Field(
        default=0.0, description="estimated relative scale error: the encoder reads the travel times 1 + encoder_scale"
    )


class EstimatedPlatterDescription(Description):
    """Eccentricity: position of the platter's centre from the axis, in the rotating frame."""

    x_mm: Coordinate = _Length
    y_mm: Coordinate = _Length


class EstimatedTriggerDescription(Description):
    """Timing of exposures."""

    latency_ms: Annotated[float, Field(ge=-100.0, le=100.0)] = Field(
        default=0.0, description="estimated delay of the light after the latched joints and table angle, ms"
    )


class EstimatedJointDescription(Description):
    """Denavit-Hartenberg row of a joint; `beta_deg` is Hayati's rotation about y after alpha."""

    theta_deg: Angle = _Angle
    d_mm: Coordinate = _Length
    a_mm: Coordinate = _Length
    alpha_deg: Angle = _Angle
    beta_deg: Angle = _Angle


class EstimatedDescription(Description):
    """Deviations that `scancell calibrate` found, named like those of ``--as-built``.

    Reconstruction applies them. The simulated cell, which has true deviations of its own, does not.

    Examples
    --------
    >>> estimated = scancell.EstimatedDescription.of({"tool.x": 1e-3}, joints=6)
    >>> estimated.tool.x_mm
    1.0
    """

    tool: EstimatedToolDescription = Field(default=EstimatedToolDescription(), description="pose of the sensor")
    grasp: EstimatedGraspDescription = Field(
        default=EstimatedGraspDescription(), description="pose of a part on the flange"
    )
    table: EstimatedTableDescription = Field(default=EstimatedTableDescription(), description="axis of the table")
    platter: EstimatedPlatterDescription = Field(
        default=EstimatedPlatterDescription(), description="eccentricity of the platter"
    )
    trigger: EstimatedTriggerDescription = Field(
        default=EstimatedTriggerDescription(), description="timing of exposures"
    )
    dh: Annotated[tuple[EstimatedJointDescription, ...], Field(max_length=MAX_JOINTS)] = Field(
        default=(), description="geometry of the arm, a row per joint from the base; default: as described"
    )
    further_sensor: (
        Annotated[tuple[EstimatedToolDescription, ...], Field(min_length=1, max_length=MAX_FURTHER_SENSORS)] | None
    ) = Field(default=None, description="poses of the further sensors, a row per sensor; default: as described")
    axis: dict[str, EstimatedAxisDescription] = Field(
        default={}, description="poses of the further axes by their names; default: as described"
    )
    conveyor: tuple[EstimatedConveyorDescription, ...] = Field(
        default=(), description="directions and encoders of the belts, a row per belt; default: as described"
    )

    @classmethod
    def of(cls, deviations: Mapping[str, float], joints: int) -> Self:
        """From SI values by the names of as-built parameters, as `deviations` returns them."""
        left = dict(deviations)

        def group(model: Any, prefix: str) -> dict[str, float]:
            taken = {}
            for key in model.model_fields:
                name, scale = split_unit(key)
                taken[key] = round(left.pop(f"{prefix}.{name}", 0.0) / scale, _DIGITS)
            return taken

        apart = ("dh", "further_sensor", "axis", "conveyor")
        models = {name: field.annotation for name, field in cls.model_fields.items() if name not in apart}
        groups: dict[str, Any] = {name: group(model, name) for name, model in models.items()}
        rows = [group(EstimatedJointDescription, f"dh[{number}]") for number in range(1, joints + 1)]
        groups["dh"] = rows if any(any(row.values()) for row in rows) else []
        numbers = range(2, MAX_FURTHER_SENSORS + 2)
        rows = [group(EstimatedToolDescription, f"sensor[{number}]") for number in numbers]
        while rows and not any(rows[-1].values()):
            rows.pop()
        groups["further_sensor"] = rows or None
        belts = [int(key[9 : key.index("]")]) for key in left if re.fullmatch(r"conveyor\[[1-9][0-9]?\]\.\w+", key)]
        rows = [group(EstimatedConveyorDescription, f"conveyor[{i}]") for i in range(1, max(belts, default=0) + 1)]
        groups["conveyor"] = rows
        axes = dict.fromkeys(key.split(".")[1] for key in left if re.fullmatch(r"axis\.\w+\.\w+", key))
        groups["axis"] = {axis: group(EstimatedAxisDescription, f"axis.{axis}") for axis in axes}
        if left:
            raise DescriptionError(key="deviations", value=[*left], expected="names of as-built parameters")
        return validate(cls, groups, "estimated")

    def deviations(self) -> dict[str, float]:
        """SI values by the names of as-built parameters, such as ``tool.x``, ``dh[3].theta`` and ``sensor[2].rx``."""
        plain = self.model_dump()
        axes = {name: to_si(values) for name, values in plain.pop("axis").items()}  # a name may end like a unit
        plain = to_si(plain)
        rows, sensors, belts = plain.pop("dh"), plain.pop("further_sensor") or (), plain.pop("conveyor")
        groups = {**plain, **{f"dh[{number}]": row for number, row in enumerate(rows, 1)}}
        groups |= {f"conveyor[{number}]": row for number, row in enumerate(belts, 1)}
        groups |= {f"sensor[{number}]": row for number, row in enumerate(sensors, 2)}
        groups |= {f"axis.{name}": values for name, values in axes.items()}
        return {f"{group}.{key}": value for group, values in groups.items() for key, value in values.items()}


class TcpDescription(Description):
    """A named tool centre point on the flange, such as the tip of a nozzle or of a finger.

    Commands bring it to poses, move it on straight lines and jog it, as the sensor and the gripper.
    """

    name: Name = Field(description="unique name of the tool in commands; not sensor or gripper")
    flange_from_tcp: PoseDescription = Field(description="pose of the tool centre point in the flange frame")


class FrameDescription(Description):
    """A named coordinate system for poses of programs, such as that of a fixture."""

    name: Name = Field(description="unique name of the frame in commands; not world, base, table or tool")
    moves_with: Literal["world", "table"] = Field(
        default="world", description="world: does not move; table: turns with the table"
    )
    pose: PoseDescription = Field(
        default=PoseDescription(), description="pose of the frame in that of the world, or of the table at angle 0"
    )


class _AxisDescription(Description):
    """An axis beside the joints and the table, such as a track of the arm or the tilt of a positioner."""

    name: Annotated[str, StringConstraints(pattern=r"^[a-z][a-z0-9_]*$")] = Field(
        description="unique name of the axis in moves_with, variables and columns; not that of another frame or column"
    )
    moves_with: str = Field(default="world", description="what carries it: world, or another axis")
    pose: PoseDescription = Field(
        default=PoseDescription(), description="pose of the axis in the frame of its carrier, with all axes at 0"
    )
    along: Literal["x", "y", "z"] = Field(
        default="z", description="direction of its frame along which it slides, or about which it turns"
    )
    encoder_latency_ms: EncoderLatency = 0.0

    @model_validator(mode="after")
    def _start_is_allowed(self) -> Self:
        lower, start, upper = (getattr(self, f"{key}{self.unit}") for key in ("min", "start", "max"))
        if not lower < upper:
            raise ValueError(f"min{self.unit} ({lower:g}) must be below max{self.unit} ({upper:g})")
        if not lower <= start <= upper:
            raise ValueError(f"start{self.unit} = {start:g}: expected a position from {lower:g} to {upper:g}")
        return self

    @property
    def unit(self) -> str:
        """Suffix of the keys of its positions."""
        return "_deg" if self.kind == "revolute" else "_mm"

    kind: str


class RevoluteAxisDescription(_AxisDescription):
    """An axis that turns what it carries."""

    kind: Literal["revolute"] = Field(description="revolute: turns")
    min_deg: Angle = Field(description="lower limit of its position, deg")
    max_deg: Angle = Field(description="upper limit of its position, deg")
    start_deg: Angle = Field(default=0.0, description="position at the start, at which scans hold the axis, deg")
    max_speed_deg_s: AngularSpeed = Field(description="speed limit, deg/s")
    max_acceleration_deg_s2: AngularAcceleration = Field(description="acceleration limit, deg/s²")
    max_jerk_deg_s3: AngularJerk = Field(
        default=7200.0, description="jerk limit of programmed motion at monitor speed 1, deg/s³"
    )
    encoder_resolution_deg: EncoderResolution = 0.0
    encoder_noise_deg: EncoderNoise = 0.0


class PrismaticAxisDescription(_AxisDescription):
    """An axis that slides what it carries."""

    kind: Literal["prismatic"] = Field(description="prismatic: slides")
    min_mm: Coordinate = Field(description="lower limit of its position, mm")
    max_mm: Coordinate = Field(description="upper limit of its position, mm")
    start_mm: Coordinate = Field(default=0.0, description="position at the start, at which scans hold the axis, mm")
    max_speed_mm_s: Speed = Field(description="speed limit, mm/s")
    max_acceleration_mm_s2: Acceleration = Field(description="acceleration limit, mm/s²")
    max_jerk_mm_s3: LinearJerk = Field(
        default=20_000.0, description="jerk limit of programmed motion at monitor speed 1, mm/s³"
    )
    encoder_resolution_mm: Annotated[Length, Field(le=1000.0)] = Field(
        default=0.0, description="quantisation step of the measured position, mm; 0: continuous"
    )
    encoder_noise_mm: Annotated[Length, Field(le=1000.0)] = Field(
        default=0.0, description="standard deviation of the measured position's noise, mm"
    )


AxisDescription = Annotated[RevoluteAxisDescription | PrismaticAxisDescription, Field(discriminator="kind")]


class FurtherSensorDescription(Description):
    """A sensor beside that of the tool, which measures at its triggers; these are numbered from ``sensor[2]``."""

    name: Name = Field(description="unique name of the sensor in clouds, files and figures")
    sensor: SensorDescription | None = Field(
        default=None, description="laser, cameras and detector; default: those of the main sensor"
    )
    moves_with: str = Field(default="world", description="what carries it: world, table, link[i] or an axis")
    pose: PoseDescription = Field(
        default=PoseDescription(), description="pose of the sensor in the frame of its carrier, with all axes at 0"
    )
    delay_ms: Annotated[float, Field(ge=-100.0, le=100.0)] = Field(
        default=0.0, description="time from the middle of the main sensor's exposures to the middle of its own, ms"
    )
    every: Annotated[int, Field(ge=1, le=1000)] = Field(
        default=1, description="exposes at every n-th trigger of the main sensor, from the first one on"
    )
    mesh: str | None = Field(
        default=None, description="file of the mesh of its housing, sensor frame, mm; default: none"
    )
    inertia: InertiaDescription | None = Field(
        default=None,
        description="mass properties, sensor frame, which load the link that carries it; default: from mesh and"
        " robot.link_density_kg_m3",
    )
    reflectance: Fraction = Field(
        default=0.3, description="Lambertian reflectance of its housing at the lasers' wavelengths, 0..1"
    )
    material: MaterialDescription | None = Field(
        default=None, description="material of its housing; overrides reflectance"
    )


class ChannelDescription(Description):
    """One direction of a network; by default a perfect one.

    See the example of `faulty_link`.
    """

    delay_ms: _Delay = Field(default=0.0, description="minimum delay of a packet, ms")
    jitter_ms: _Delay = Field(
        default=0.0, description="mean of the exponentially distributed extra delay, ms; packets overtake each other"
    )
    loss: Fraction = Field(default=0.0, description="probability that a packet is lost outside bursts")
    burst: Fraction = Field(default=0.0, description="probability per packet that a burst of losses begins with it")
    burst_packets: float = Field(default=10.0, ge=1.0, le=1e6, description="mean length of a burst, in packets")
    burst_loss: Fraction = Field(default=1.0, description="probability that a packet is lost in a burst")
    duplication: Fraction = Field(
        default=0.0, description="probability that a packet is delivered twice, with independent delays"
    )
    replay: Fraction = Field(default=0.0, description="probability that a packet is delivered again after replay_ms")
    replay_ms: _Delay = Field(default=1000.0, description="time after which packets are delivered again, ms")
    dead_from_s: Annotated[float, Field(ge=0.0, le=1e9)] | None = Field(
        default=None, description="time from which on nothing is sent or delivered, s"
    )
    dead_until_s: Annotated[float, Field(ge=0.0, le=1e9)] | None = Field(
        default=None, description="time at which the link recovers, s"
    )


class LinkDescription(Description):
    """Faults of the connection between a cell and its guard; by default none.

    See the example of `faulty_link`.
    """

    to_guard: ChannelDescription = Field(default=ChannelDescription(), description="network from cell to guard")
    to_cell: ChannelDescription = Field(default=ChannelDescription(), description="network from guard to cell")
    clock_offset_ms: Annotated[float, Field(ge=-1e11, le=1e11)] = Field(
        default=0.0, description="time of the controller's clock at time 0, ms"
    )
    clock_drift_ppm: Annotated[float, Field(ge=-100_000.0, le=100_000.0)] = Field(
        default=0.0, description="relative error of the rate of the controller's clock, ppm"
    )
    stale: Fraction = Field(default=0.0, description="probability that an old state is sent instead of the new one")
    stale_polls: int = Field(default=1, ge=1, le=1000, description="age of an old state, in polls")


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
    """The sensor: what carries it, and its pose there, given directly or by the dimensions of its fixture."""

    moves_with: str = Field(
        default="flange", description="what carries the sensor: flange, world (a post), or the name of an axis"
    )
    flange_from_sensor: PoseDescription | None = Field(
        default=None, description="pose of the sensor in the flange frame; excludes fixture and pose"
    )
    fixture: FixtureDescription | None = Field(
        default=None,
        description="dimensions of the bracket on the flange that holds the sensor; excludes flange_from_sensor and"
        " pose",
    )
    pose: PoseDescription | None = Field(
        default=None,
        description="pose of the sensor in the frame of what carries it; excludes flange_from_sensor and fixture",
    )
    inertia: InertiaDescription | None = Field(
        default=None,
        description="mass properties of a sensor on the flange, sensor frame; default: from sensor_mesh and"
        " robot.link_density_kg_m3",
    )

    @model_validator(mode="after")
    def _exactly_one(self) -> Self:
        given = [name for name in ("flange_from_sensor", "fixture", "pose") if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError("give exactly one of flange_from_sensor, fixture and pose")
        if self.moves_with != "flange" and given != ["pose"]:
            raise ValueError(f'{given[0]} is a pose on the flange: expected pose with moves_with = "{self.moves_with}"')
        return self


class TableDescription(Description):
    """Rotary table, or one that does not turn: a bench, a pallet.

    The origin of its frame is where the axis meets the top face, z along the axis. The axis of a table that does not
    turn is the normal in the middle of its top face.
    """

    pose: PoseDescription = Field(description="pose of the table in the frame of its carrier at table angle 0")
    moves_with: str = Field(default="world", description="what carries it: world, or the axis that tilts or moves it")
    turns: bool = Field(
        default=True, description="false: it does not turn, as a bench or a pallet; its speeds need not be given"
    )
    radius_mm: Size = Field(description="radius of the platter, mm")
    thickness_mm: Size = Field(description="thickness of the platter below its top face, mm")
    max_speed_deg_s: AngularSpeed = Field(default=180.0, description="speed limit of the table, deg/s")
    max_acceleration_deg_s2: AngularAcceleration = Field(
        default=360.0, description="acceleration limit of the table, deg/s²"
    )
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
        description="what carries the part: the table, or the flange, whose frame replaces that of the table",
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
    def _held_part_is_clamped(self) -> Self:
        if self.moves_with == "flange" and (self.fixture == "free" or self.arrival is not None):
            raise ValueError('moves_with = "flange": the part is rigid on the flange: fixture "clamped", no arrival')
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
    robot_moves_with: str = Field(default="world", description="what carries the arm: world, or an axis")
    robot_reflectance: Fraction = Field(
        default=0.3, description="Lambertian reflectance of arm and sensor housing at the laser's wavelength, 0..1"
    )
    robot_material: MaterialDescription | None = Field(
        default=None, description="material of arm and sensor housing; overrides robot_reflectance"
    )
    tool: ToolDescription = Field(description="what carries the sensor, and its pose there")
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
        default=(), description="rigid bodies in the world, on the table, on an axis or on the flange"
    )
    gripper: GripperDescription | None = Field(default=None, description="gripper on the flange; default: none")
    axis: Annotated[tuple[AxisDescription, ...], Field(max_length=MAX_FURTHER_AXES)] = Field(
        default=(), description="axes beside the joints and the table"
    )
    further_sensor: Annotated[tuple[FurtherSensorDescription, ...], Field(max_length=MAX_FURTHER_SENSORS)] = Field(
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
        seen = set(RESERVED_NAMES)
        devices = (self.further_part, self.conveyor, self.obstacle, self.further_sensor)
        for name in [device.name for group in devices for device in group]:
            if name in seen:
                raise ValueError(
                    f"the name '{name}' is taken; names of parts, conveyors, obstacles and sensors must be unique"
                )
            seen.add(name)
        standing = {f"part '{part.name}'": part.stands_on for part in self.further_part}
        if self.part.arrival is not None:
            standing["part.arrival"] = self.part.arrival.stands_on
        conveyors = [f"conveyor[{number}]" for number in range(1, len(self.conveyor) + 1)]
        for key, support in standing.items():
            if support.startswith("conveyor") and support not in conveyors:
                raise ValueError(f"{key}: stands_on = '{support}', but there are {len(conveyors)} conveyors")
        return self

    @model_validator(mode="after")
    def _names_are_unique(self) -> Self:
        flange = set() if self.tool.moves_with == "flange" else {"flange"}  # a tool where it does not carry the sensor
        for key, kind, names, reserved in (
            ("tcp", "tool", [tcp.name for tcp in self.tcp], RESERVED_TOOLS | flange),
            ("frame", "frame", [frame.name for frame in self.frame], RESERVED_FRAMES),
        ):
            for number, name in enumerate(names):
                taken = {*reserved, *names[:number]}
                if name in taken:
                    raise ValueError(
                        f"{key}[{number + 1}].name = '{name}': expected a name that no other {kind} has;"
                        f" taken: {', '.join(sorted(taken))}"
                    )
        return self

    @model_validator(mode="after")
    def _carriers_exist(self) -> Self:
        links = [f"link[{i}]" for i in range(1, len(self.robot.joint) + 1)]
        carriers = ["world"]
        for number, axis in enumerate(self.axis, 1):
            if axis.moves_with not in carriers:
                expected = f"{', '.join(carriers)}: an axis is listed after what carries it"
                raise ValueError(f"axis[{number}].moves_with = '{axis.moves_with}': expected {expected}")
            if axis.name in carriers or is_reserved_axis(axis.name):
                raise ValueError(f"axis[{number}].name = '{axis.name}': expected a name of no other frame or column")
            carriers.append(axis.name)
        carried = {"robot_moves_with": self.robot_moves_with, "table.moves_with": self.table.moves_with}
        for key, carrier in carried.items():
            if carrier not in carriers:
                raise ValueError(f"{key} = '{carrier}': expected {', '.join(carriers)}")
        if self.tool.moves_with not in {*carriers, "flange"}:
            expected = ", ".join(["flange", *carriers])
            raise ValueError(f"tool.moves_with = '{self.tool.moves_with}': expected {expected}")
        for number, obstacle in enumerate(self.obstacle, 1):
            if obstacle.moves_with not in {*carriers, "table", "flange"}:
                expected = ", ".join([*carriers, "table", "flange"])
                raise ValueError(f"obstacle[{number}].moves_with = '{obstacle.moves_with}': expected {expected}")
        for number, sensor in enumerate(self.further_sensor, 1):
            if sensor.moves_with not in {*carriers, "table", *links}:
                expected = ", ".join([*carriers, "table", *links])
                raise ValueError(f"further_sensor[{number}].moves_with = '{sensor.moves_with}': expected {expected}")
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
        axes = [axis.name for axis in self.axis]
        unknown = [name for name in (self.estimated.axis if self.estimated is not None else ()) if name not in axes]
        if unknown:
            raise ValueError(f"estimated.axis.{unknown[0]}: expected an axis of the cell: {', '.join(axes) or 'none'}")
        if self.estimated is not None and len(self.estimated.dh) not in (0, joints):
            raise ValueError(f"estimated.dh has {len(self.estimated.dh)} rows: expected {joints}, one for each joint")
        rows = 0 if self.estimated is None else len(self.estimated.further_sensor or ())
        if rows > len(self.further_sensor):
            raise ValueError(
                f"estimated.further_sensor has {rows} rows: expected at most {len(self.further_sensor)}, one for each"
                " sensor"
            )
        rows = 0 if self.estimated is None else len(self.estimated.conveyor)
        if rows > len(self.conveyor):
            raise ValueError(f"estimated.conveyor has {rows} rows: expected at most {len(self.conveyor)}, one per belt")
        links = {f"link[{i}]" for i in range(1, joints + 1)}
        for key, frame in frames.items():
            if frame.startswith("link") and frame not in links:
                raise ValueError(f"{key} = '{frame}': expected link[1] to link[{len(links)}], one for each joint")
        return self
