"""The sensor's description of a camera and a laser that were calibrated by a board."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scancell.calibration.board.problem import Rig
from scancell.config.sensor import SensorDescription
from scancell.errors import DescriptionError
from scancell.geometry import pose

Array = NDArray[np.float64]

_MARGIN = 0.2  # of the distances of the stripe, on both sides of the range


@dataclass(frozen=True)
class DescribedSensor:
    """A sensor's description, or why there is none, with the pose (4, 4) of its frame in the camera as recorded.

    `quarter_turns` counter-clockwise (``numpy.rot90``) turn recorded images into those of the described camera, whose
    rows grow with the range.
    """

    sensor: SensorDescription | None
    camera_from_sensor: Array
    quarter_turns: int
    problem: str = ""


def describe(rig: Rig, size: tuple[int, int], stripe: Array, start: SensorDescription) -> DescribedSensor:
    """The description of a rig.

    The sensor's origin is the foot of the camera's centre on the sheet; Z is the direction of the camera's axis in it.

    Parameters
    ----------
    size
        Width and height of recorded images, px.
    stripe
        (n, 3) points on the sheet in the camera, for the range.
    start
        Whose other values are kept.
    """
    normal = rig.sheet[:3, 2]
    foot = normal * (normal @ rig.sheet[:3, 3])
    z = np.array([0.0, 0.0, 1.0]) - normal * normal[2]
    z /= np.linalg.norm(z)
    x = -foot / np.linalg.norm(foot)  # the camera is at X = +baseline
    camera_from_sensor = pose.from_rotation(np.column_stack([x, np.cross(z, x), z]), foot)
    sensor_from_camera = pose.inverse(camera_from_sensor)
    # In the description the rows of the image are along (cos tilt, 0, sin tilt), its columns along -Y.
    tilt = float(np.arctan2(-sensor_from_camera[0, 2], sensor_from_camera[2, 2]))
    upright = np.array([[0.0, np.cos(tilt), -np.sin(tilt)], [-1.0, 0.0, 0.0], [0.0, np.sin(tilt), np.cos(tilt)]])
    turn = (upright.T @ sensor_from_camera[:3, :3])[:2, :2]
    angle = float(np.arctan2(turn[1, 0], turn[0, 0]))
    quarters = -round(angle / (np.pi / 2))
    distance = 1e3 * (sensor_from_camera @ np.c_[stripe, np.ones(len(stripe))].T)[2]
    low, high = np.quantile(distance, [0.0, 1.0])
    room = _MARGIN * (high - low)
    width, height = size
    cx, cy = rig.intrinsics[1:3]
    k1, k2, p1, p2 = rig.intrinsics[3:7]
    # A quarter turn counter-clockwise: column = y, row = width - 1 - x.
    for _ in range(quarters % 4):
        cx, cy, width, height, p1, p2 = cy, width - 1 - cx, height, width, -p2, p1
    camera = start.camera[0].model_dump() | {
        "side": 1,
        "baseline_mm": 1e3 * float(np.linalg.norm(foot)),
        "height_mm": 0.0,
        "offset_y_mm": 0.0,
        "tilt_deg": float(np.degrees(tilt)),
        "pan_deg": 0.0,
        "roll_deg": float(np.degrees(angle + quarters * np.pi / 2)),
        "half_angle_deg": float(np.degrees(np.arctan(height / (2 * rig.intrinsics[0])))),
        "width_px": width,
        "height_px": height,
        "cx_px": float(cx),
        "cy_px": float(cy),
        "region_columns_px": None,
        "region_rows_px": None,
        "distortion": [float(k1), float(k2), float(p1), float(p2), 0.0],
        "scheimpflug_x_deg": 0.0,
        "scheimpflug_y_deg": 0.0,
        "focus_mm": None,
    }
    data = start.model_dump()
    data["camera"] = [camera]
    data["range"] = {"near_mm": max(float(low - room), 1e-3), "far_mm": float(high + room)}
    data["laser"] |= {"straightness_mrad": [], "offset_x_mm": 0.0, "turn_y_deg": 0.0, "turn_z_deg": 0.0}
    data["detector"] |= {"bit_depth": 8, "binning": 1}
    try:
        return DescribedSensor(SensorDescription.model_validate(data), camera_from_sensor, quarters % 4)
    except (ValueError, DescriptionError) as error:
        reason = " ".join(str(error).split())
        return DescribedSensor(None, camera_from_sensor, quarters % 4, reason)
