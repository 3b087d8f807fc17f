"""Complete SI data for the native libraries: the only place where descriptions become their JSON."""

from __future__ import annotations

from typing import Any

import numpy as np

from orchestrator.config.sensor import CameraDescription, SensorDescription
from orchestrator.config.units import to_si

_FORMAT = 1


def sensor_json(sensor: SensorDescription, seed: int) -> dict[str, Any]:
    """SI description of the sensor as `sensor_rt` reads it; `seed` keys every random number of the images."""
    data: dict[str, Any] = to_si(sensor.model_dump(exclude={"camera"}))
    data["cameras"] = [_camera_json(camera) for camera in sensor.camera]
    data["render"]["seed"] = seed
    return {"format": _FORMAT, **data}


def _camera_json(camera: CameraDescription) -> dict[str, Any]:
    data: dict[str, Any] = to_si(camera.model_dump(exclude={"half_angle_deg", "cx_px", "cy_px"}))
    data["focal_px"] = focal_length_px(camera)
    data["cx_px"] = (camera.width_px - 1) / 2 if camera.cx_px is None else camera.cx_px
    data["cy_px"] = (camera.height_px - 1) / 2 if camera.cy_px is None else camera.cy_px
    return data


def focal_length_px(camera: CameraDescription) -> float:
    """Focal length from image height and half angle: ``f = H / (2 tan gamma)``."""
    gamma = to_si({"half_angle_deg": camera.half_angle_deg})["half_angle"]
    return float(camera.height_px / (2.0 * np.tan(gamma)))
