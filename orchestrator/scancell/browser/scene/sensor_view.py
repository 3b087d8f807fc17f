"""The sensor's measuring range, its laser and its stripe in a scene."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from scancell.config.sensor import SensorDescription

if TYPE_CHECKING:
    import viser

Array = NDArray[np.float64]

_LASER, _RANGE, _STRIPE = (255, 40, 40), (60, 130, 220), (255, 20, 20)
_GAP = 5.0  # times the median distance of neighbours, beyond which the stripe is broken


class SensorView:
    """Trapezoid of the measuring range, sheet of the laser, and the stripe on what it meets.

    Parameters
    ----------
    scene
        Of viser; the frame of the sensor is a node of it.
    sensor
        Range and laser.
    """

    def __init__(self, scene: viser.SceneApi, sensor: SensorDescription) -> None:
        self._shown, self._laser = True, True
        self._range = scene.add_line_segments(
            "/frames/sensor/field_of_view", _outline(sensor), _RANGE, thickness=2.0, thickness_units="screen"
        )
        self._sheet = scene.add_mesh_simple(
            "/frames/sensor/laser",
            *_fan(sensor),
            color=_LASER,
            opacity=0.18,
            side="double",
            cast_shadow=False,
            receive_shadow=False,
        )
        self._stripe = scene.add_line_segments(
            "/stripe", np.zeros((1, 2, 3)), _STRIPE, thickness=3.0, thickness_units="screen", visible=False
        )

    def show(self, shown: bool) -> None:
        """Show the measuring range and, while it is on, the laser's sheet."""
        self._shown = shown
        self._range.visible, self._sheet.visible = shown, shown and self._laser

    def show_laser(self, on: bool) -> None:
        """Switch the laser on or off."""
        self._laser = on
        self._sheet.visible = self._shown and on

    def show_stripe(self, points: Array | None) -> None:
        """Draw the stripe through points (n, 3), world, m, in the order along the line; None or fewer than 2: none."""
        segments = np.zeros((0, 2, 3)) if points is None else stripe_segments(points)
        if len(segments):
            self._stripe.points = segments
        self._stripe.visible = len(segments) > 0


def stripe_segments(points: Array) -> Array:
    """Ends (k, 2, 3) of lines between neighbours of points (n, 3), except across gaps."""
    segments = np.stack([points[:-1], points[1:]], 1)
    length = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=-1)
    return segments if len(length) == 0 else segments[length <= _GAP * np.median(length)]


def field_corners(sensor: SensorDescription) -> Array:
    """Corners (4, 3) of the field of view in the sensor frame, m: near, near, far, far."""
    slope = np.tan(np.radians(sensor.laser.fan_half_angle_deg))
    z = 1e-3 * np.array([sensor.range.near_mm, sensor.range.near_mm, sensor.range.far_mm, sensor.range.far_mm])
    y = slope * (z - 1e-3 * sensor.laser.source_z_mm) * np.array([-1, 1, 1, -1])
    return np.stack([np.zeros(4), y, z], 1)


def _outline(sensor: SensorDescription) -> Array:
    corners = field_corners(sensor)
    return np.stack([corners, np.roll(corners, -1, 0)], 1)


def _fan(sensor: SensorDescription) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
    source = np.array([[0.0, 0.0, 1e-3 * sensor.laser.source_z_mm]])
    corners = np.concatenate([source, field_corners(sensor)[2:]])
    return np.asarray(corners, np.float32), np.array([[0, 1, 2]], np.uint32)
