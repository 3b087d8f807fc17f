"""Description of the arm: joints by Denavit-Hartenberg parameters, limits, drives, links."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from scancell.config.description import Description, FileDescription, Finite, NonNegative, PoseDescription, Positive
from scancell.config.drives import DriveDescription, InertiaDescription, MotionDescription

MAX_JOINTS = 8  # of an arm

# Keys of every encoder, of the joints and of the table.
EncoderResolution = Annotated[
    NonNegative, Field(description="quantisation step of the measured angle, deg; 0: continuous")
]
EncoderNoise = Annotated[NonNegative, Field(description="standard deviation of the measured angle's noise, deg")]
EncoderLatency = Annotated[float, Field(ge=0.0, le=100.0, description="age of the measured angle when it is read, ms")]


class JointDescription(Description):
    """One revolute joint and the link that it moves, standard Denavit-Hartenberg.

    ``T = Rz(q + theta) T(a, 0, d) Rx(alpha)``; the frame of a link lies at its far end, with z along the next axis.
    """

    a_mm: Finite = Field(description="Denavit-Hartenberg a: distance from this joint's axis to the next along x, mm")
    d_mm: Finite = Field(description="Denavit-Hartenberg d: offset along this joint's axis, mm")
    alpha_deg: Finite = Field(
        description="Denavit-Hartenberg alpha: angle from this joint's axis to the next about x, deg"
    )
    theta_deg: Finite = Field(default=0.0, description="offset added to the joint angle, deg")
    min_deg: Finite = Field(description="lower limit of the joint angle, deg")
    max_deg: Finite = Field(description="upper limit of the joint angle, deg")
    max_speed_deg_s: Positive = Field(description="speed limit of the joint, deg/s")
    max_acceleration_deg_s2: Positive = Field(description="acceleration limit of the joint, deg/s²")
    max_jerk_deg_s3: Positive = Field(
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
    values_deg: Annotated[tuple[Finite, ...], Field(max_length=32)] = Field(
        default=(), description="joint angles to hold it at, deg; each has branches of its own; default: the home angle"
    )


class RobotDescription(FileDescription):
    """A serial arm of 4 to 8 revolute joints by its Denavit-Hartenberg parameters.

    `scancell robot from-urdf` writes such a file from a URDF.
    """

    kind: ClassVar[str] = "robot"
    shipped: ClassVar[str] = "robots/six_axis.toml"

    name: str = Field(description="name of the arm")
    base: PoseDescription = Field(default=PoseDescription(), description="world_from_base: pose of the arm's base")
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
    link_density_kg_m3: Positive = Field(
        default=2000.0, description="mean density of the volume inside a link's mesh, motors and cavities included"
    )
    motion: MotionDescription = Field(default=MotionDescription(), description="limits of straight lines and jogging")
    home_deg: Annotated[tuple[Finite, ...], Field(min_length=4, max_length=MAX_JOINTS)] = Field(
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
