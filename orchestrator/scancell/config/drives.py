"""Descriptions of the arm's mass properties and drives, and of the limits of straight lines and jogging."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from scancell.config.description import Description, Finite, Fraction, NonNegative, Positive

Vector = Annotated[tuple[Finite, ...], Field(min_length=3, max_length=3)]


class InertiaDescription(Description):
    """Mass properties of a rigid body, in the body's own frame."""

    mass_kg: Positive = Field(description="mass of the body, kg")
    centre_of_mass_mm: Vector = Field(description="centre of mass (x, y, z), body frame, mm")
    inertia_kg_m2: Vector = Field(
        description="moments of inertia (xx, yy, zz) about the centre of mass, along the axes of the body frame, kg m²"
    )
    products_kg_m2: Vector = Field(
        default=(0.0, 0.0, 0.0), description="elements (xy, xz, yz) of the same inertia tensor, kg m²"
    )


class DriveDescription(Description):
    """Motor and gear of one joint; all values refer to the output side of the gear."""

    motor_inertia_kg_m2: Positive = Field(description="rotor inertia, reflected to the joint, kg m²")
    max_torque_n_m: NonNegative = Field(description="torque limit of the motor, N m; 0: no power")
    gear_stiffness_n_m_rad: Positive = Field(description="torsional stiffness of the gear, N m/rad")
    gear_damping_n_m_s_rad: NonNegative = Field(description="torsional damping of the gear, N m s/rad")
    backlash_deg: NonNegative = Field(default=0.0, description="full width of the play between motor and link, deg")
    coulomb_friction_n_m: NonNegative = Field(default=0.0, description="Coulomb friction torque of the joint, N m")
    viscous_friction_n_m_s_rad: NonNegative = Field(default=0.0, description="viscous friction of the joint, N m s/rad")


class MotionDescription(Description):
    """Limits of the tool (the sensor's origin) in straight lines and when jogging."""

    line_speed_mm_s: Positive = Field(
        default=1000.0, description="speed of the tool in a straight line at command.speed = 1, mm/s"
    )
    line_acceleration_mm_s2: Positive = Field(
        default=5000.0, description="acceleration of the tool in a straight line, mm/s²"
    )
    turn_speed_deg_s: Positive = Field(
        default=180.0, description="angular speed of the tool in a straight line at command.speed = 1, deg/s"
    )
    turn_acceleration_deg_s2: Positive = Field(
        default=900.0, description="angular acceleration of the tool in a straight line, deg/s²"
    )
    jog_speed_mm_s: Annotated[float, Field(gt=0.0, le=250.0)] = Field(
        default=250.0, description="Cartesian jog speed of the tool at full deflection, mm/s; ISO 10218-1 allows 250"
    )
    jog_acceleration_mm_s2: Positive = Field(default=800.0, description="acceleration of the tool when jogging, mm/s²")
    jog_turn_speed_deg_s: Positive = Field(
        default=45.0, description="angular jog speed of the tool at full deflection, deg/s"
    )
    jog_turn_acceleration_deg_s2: Positive = Field(
        default=180.0, description="angular acceleration of the tool when jogging, deg/s²"
    )
    jog_joint_share: Fraction = Field(
        default=0.1, description="share of the joints' max_speed and max_acceleration that jogging uses, 0..1"
    )
