"""Description of the arm: joints by Denavit-Hartenberg parameters, limits, drives, mass properties, links."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from scancell.config.description import (
    Acceleration,
    Angle,
    AngularAcceleration,
    AngularJerk,
    AngularSpeed,
    Coordinate,
    Density,
    Description,
    FileDescription,
    Fraction,
    Mass,
    Point,
    PoseDescription,
    Speed,
)

MAX_JOINTS = 8  # of an arm

_Deviation = Annotated[float, Field(ge=0.0, le=57.0)]  # deg
_Torque = Annotated[float, Field(ge=0.0, le=1e6)]  # N m
_Damping = Annotated[float, Field(ge=0.0, le=1e6)]  # N m s/rad
_Friction = Annotated[float, Field(ge=0.0, le=1e5)]  # N m s/rad; motions of a second take hours beyond
_InertiaVector = Annotated[tuple[Annotated[float, Field(ge=-1e6, le=1e6)], ...], Field(min_length=3, max_length=3)]

# Keys of every encoder, of the joints and of the table.
EncoderResolution = Annotated[
    _Deviation, Field(description="quantisation step of the measured angle, deg; 0: continuous")
]
EncoderNoise = Annotated[_Deviation, Field(description="standard deviation of the measured angle's noise, deg")]
EncoderLatency = Annotated[float, Field(ge=0.0, le=100.0, description="age of the measured angle when it is read, ms")]


class InertiaDescription(Description):
    """Mass properties of a rigid body, in the body's own frame."""

    mass_kg: Mass = Field(description="mass of the body, kg")
    centre_of_mass_mm: Point = Field(description="centre of mass (x, y, z), body frame, mm")
    inertia_kg_m2: _InertiaVector = Field(
        description="moments of inertia (xx, yy, zz) about the centre of mass, along the axes of the body frame, kg m²"
    )
    products_kg_m2: _InertiaVector = Field(
        default=(0.0, 0.0, 0.0), description="elements (xy, xz, yz) of the same inertia tensor, kg m²"
    )


class DriveDescription(Description):
    """Motor and gear of one joint; all values refer to the output side of the gear."""

    motor_inertia_kg_m2: Annotated[float, Field(ge=1e-9, le=1e6)] = Field(
        description="rotor inertia, reflected to the joint, kg m²"
    )
    max_torque_n_m: _Torque = Field(description="torque limit of the motor, N m; 0: no power")
    gear_stiffness_n_m_rad: Annotated[float, Field(ge=0.001, le=1e12)] = Field(
        description="torsional stiffness of the gear, N m/rad"
    )
    gear_damping_n_m_s_rad: _Damping = Field(description="torsional damping of the gear, N m s/rad")
    backlash_deg: _Deviation = Field(default=0.0, description="full width of the play between motor and link, deg")
    coulomb_friction_n_m: _Torque = Field(default=0.0, description="Coulomb friction torque of the joint, N m")
    viscous_friction_n_m_s_rad: _Friction = Field(default=0.0, description="viscous friction of the joint, N m s/rad")


class MotionDescription(Description):
    """Limits of the tool (the sensor's origin) in straight lines and when jogging."""

    line_speed_mm_s: Speed = Field(
        default=1000.0, description="speed of the tool in a straight line at command.speed = 1, mm/s"
    )
    line_acceleration_mm_s2: Acceleration = Field(
        default=5000.0, description="acceleration of the tool in a straight line, mm/s²"
    )
    turn_speed_deg_s: AngularSpeed = Field(
        default=180.0, description="angular speed of the tool in a straight line at command.speed = 1, deg/s"
    )
    turn_acceleration_deg_s2: AngularAcceleration = Field(
        default=900.0, description="angular acceleration of the tool in a straight line, deg/s²"
    )
    jog_speed_mm_s: Annotated[float, Field(ge=0.001, le=250.0)] = Field(
        default=250.0, description="Cartesian jog speed of the tool at full deflection, mm/s; ISO 10218-1 allows 250"
    )
    jog_acceleration_mm_s2: Acceleration = Field(
        default=800.0, description="acceleration of the tool when jogging, mm/s²"
    )
    jog_turn_speed_deg_s: AngularSpeed = Field(
        default=45.0, description="angular jog speed of the tool at full deflection, deg/s"
    )
    jog_turn_acceleration_deg_s2: AngularAcceleration = Field(
        default=180.0, description="angular acceleration of the tool when jogging, deg/s²"
    )
    jog_joint_share: Fraction = Field(
        default=0.1, description="share of the joints' max_speed and max_acceleration that jogging uses, 0..1"
    )


class JointDescription(Description):
    """One revolute joint and the link that it moves, standard Denavit-Hartenberg.

    ``T = Rz(q + theta) T(a, 0, d) Rx(alpha) Ry(beta)``; the frame of a link lies at its far end, with z along the next
    axis.
    """

    a_mm: Coordinate = Field(
        description="Denavit-Hartenberg a: distance from this joint's axis to the next along x, mm"
    )
    d_mm: Coordinate = Field(description="Denavit-Hartenberg d: offset along this joint's axis, mm")
    alpha_deg: Angle = Field(
        description="Denavit-Hartenberg alpha: angle from this joint's axis to the next about x, deg"
    )
    beta_deg: Angle = Field(
        default=0.0,
        description="angle from this joint's axis to the next about y, after alpha, deg: Hayati's parameter for "
        "nearly parallel axes, between which d is large or undetermined without it",
    )
    theta_deg: Angle = Field(default=0.0, description="offset added to the joint angle, deg")
    min_deg: Angle = Field(description="lower limit of the joint angle, deg")
    max_deg: Angle = Field(description="upper limit of the joint angle, deg")
    max_speed_deg_s: AngularSpeed = Field(description="speed limit of the joint, deg/s")
    max_acceleration_deg_s2: AngularAcceleration = Field(description="acceleration limit of the joint, deg/s²")
    max_jerk_deg_s3: AngularJerk = Field(
        default=20_000.0, description="jerk limit of programmed motion at monitor speed 1, deg/s³"
    )
    encoder_resolution_deg: EncoderResolution = 0.0
    encoder_noise_deg: EncoderNoise = 0.0
    encoder_latency_ms: EncoderLatency = 0.0
    drive: DriveDescription | None = Field(
        default=None, description='motor and gear of the joint; required where robot.drive = "dynamic"'
    )
    inertia: InertiaDescription | None = Field(
        default=None,
        description="mass properties of the link, link frame; default: from its mesh and robot.link_density_kg_m3",
    )
    mesh: str | None = Field(default=None, description="file of the link's mesh, link frame, mm; default: none")

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.min_deg >= self.max_deg:
            raise ValueError(f"min_deg ({self.min_deg:g}) must be below max_deg ({self.max_deg:g})")
        return self


class HeldJointDescription(Description):
    """A joint of an arm of more than six that inverse kinematics holds at given angles while it solves the others."""

    joint: Annotated[int, Field(ge=1, le=MAX_JOINTS)] = Field(description="number of the joint, from 1 at the base")
    values_deg: Annotated[tuple[Angle, ...], Field(max_length=32)] = Field(
        default=(), description="held joint angles, deg; each has its own branches; default: the home angle"
    )


class RobotDescription(FileDescription):
    """A serial arm of 4 to 8 revolute joints by its Denavit-Hartenberg parameters.

    `scancell robot from-urdf` writes such a file from a URDF.
    """

    kind: ClassVar[str] = "robot"
    shipped: ClassVar[str] = "robots/six_axis.toml"

    name: str = Field(description="name of the arm")
    base: PoseDescription = Field(
        default=PoseDescription(), description="pose of the arm's base in the frame of what carries it, the world"
    )
    base_mesh: str | None = Field(
        default=None, description="file of the fixed base's mesh, base frame, mm; default: none"
    )
    joint: Annotated[tuple[JointDescription, ...], Field(min_length=4, max_length=MAX_JOINTS)] = Field(
        description="the 4 to 8 joints with their links, from the base to the flange"
    )
    held: Annotated[tuple[HeldJointDescription, ...], Field(max_length=MAX_JOINTS - 6)] = Field(
        default=(), description="joints that inverse kinematics holds: one for each joint beyond six"
    )
    drive: Literal["kinematic", "dynamic"] = Field(
        default="kinematic",
        description="kinematic: joints follow their set-points exactly; dynamic: motors, gears and inertia act",
    )
    payload_kg: Mass | None = Field(
        default=None,
        description="rated payload: largest mass on the flange, of tool and part together, kg; default: not stated",
    )
    link_density_kg_m3: Density = Field(
        default=2000.0, description="mean density of the volume inside a link's mesh, motors and cavities included"
    )
    motion: MotionDescription = Field(default=MotionDescription(), description="limits of straight lines and jogging")
    home_deg: Annotated[tuple[Angle, ...], Field(min_length=4, max_length=MAX_JOINTS)] = Field(
        description="joint angles at the start and end of every program, one per joint, deg"
    )

    @model_validator(mode="after")
    def _dynamics_known(self) -> Self:
        for number, joint in enumerate(self.joint, start=1):
            if self.drive == "dynamic" and joint.drive is None:
                raise ValueError(f'joint[{number}].drive is missing: drive = "dynamic" needs the drive of every joint')
            if self.drive == "dynamic" and joint.inertia is None and joint.mesh is None:
                raise ValueError(f'joint[{number}]: drive = "dynamic" needs an inertia, or a mesh to compute it from')
        return self

    @model_validator(mode="after")
    def _home_within_limits(self) -> Self:
        if len(self.home_deg) != len(self.joint):
            raise ValueError(
                f"home_deg has {len(self.home_deg)} angles: expected one for each of the {len(self.joint)} joints"
            )
        for number, angle in enumerate(self.home_deg, start=1):
            self._check_angle(f"home_deg[{number}]", number, angle)
        return self

    @model_validator(mode="after")
    def _held_joints_exist(self) -> Self:
        count, redundant = len(self.joint), max(0, len(self.joint) - 6)
        numbers = [held.joint for held in self.held]
        if len(numbers) != redundant:
            raise ValueError(
                f"held names {len(numbers)} joints: expected {redundant} for an arm of {count}, one for each beyond six"
            )
        for k, held in enumerate(self.held, start=1):
            if held.joint > count or numbers.count(held.joint) > 1:
                raise ValueError(f"held[{k}].joint = {held.joint}: expected another joint, 1 to {count}")
            for i, angle in enumerate(held.values_deg, start=1):
                self._check_angle(f"held[{k}].values_deg[{i}]", held.joint, angle)
        return self

    def _check_angle(self, key: str, number: int, angle: float) -> None:
        joint = self.joint[number - 1]
        if not joint.min_deg <= angle <= joint.max_deg:
            limits = f"joint[{number}].min_deg ({joint.min_deg:g}) and max_deg ({joint.max_deg:g})"
            raise ValueError(f"{key} = {angle:g}: expected an angle between {limits}")
