"""Description of what moves the arm: how fast programs and jogs may go."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from orchestrator.config.description import Description, Fraction, Positive


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
