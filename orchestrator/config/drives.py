"""Description of what moves the arm: masses, drives, and how fast programs and jogs may go."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from orchestrator.config.description import Description, Finite, Fraction, NonNegative, Positive

Vector = Annotated[tuple[Finite, ...], Field(min_length=3, max_length=3)]


class InertiaDescription(Description):
    """Mass properties of a rigid body, in the body's own frame."""

    mass_kg: Positive
    centre_of_mass_mm: Vector = Field(description="in the body's frame")
    inertia_kg_m2: Vector = Field(description="about the centre of mass and the body's x, y and z")


class DriveDescription(Description):
    """One drive, all numbers as seen from the joint, behind the gear."""

    motor_inertia_kg_m2: Positive
    max_torque_n_m: NonNegative = Field(description="of the motor; 0 is a drive without power")
    gear_stiffness_n_m_rad: Positive
    gear_damping_n_m_s_rad: NonNegative
    backlash_deg: NonNegative = Field(default=0.0, description="whole width of the play between motor and link")
    coulomb_friction_n_m: NonNegative = Field(default=0.0, description="of the joint, behind the gear")
    viscous_friction_n_m_s_rad: NonNegative = Field(default=0.0, description="of the joint, behind the gear")


class MotionDescription(Description):
    """How fast the tool goes: in straight lines at full speed, and by hand.

    The tool is what the cell's description mounts on the flange: the sensor.
    """

    line_speed_mm_s: Positive = Field(default=1000.0, description="of a straight line at command.speed = 1")
    line_acceleration_mm_s2: Positive = 5000.0
    turn_speed_deg_s: Positive = Field(default=180.0, description="of the tool in a straight line at command.speed = 1")
    turn_acceleration_deg_s2: Positive = 900.0
    jog_speed_mm_s: Annotated[float, Field(gt=0.0, le=250.0)] = Field(
        default=250.0, description="greatest speed of the tool by hand; ISO 10218-1 allows 250 mm/s"
    )
    jog_acceleration_mm_s2: Positive = 800.0
    jog_turn_speed_deg_s: Positive = 45.0
    jog_turn_acceleration_deg_s2: Positive = 180.0
    jog_joint_share: Fraction = Field(default=0.1, description="of each joint's greatest speed, at full deflection")
