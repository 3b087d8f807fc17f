"""Complete SI data of a sensor as JSON for the native library."""

from __future__ import annotations

from typing import Any

import numpy as np

from scancell.config.sensor import CameraDescription, DetectorDescription, LaserDescription, SensorDescription
from scancell.config.units import si_value, to_si

_FORMAT = 1
_STRAIGHTNESS = 6  # number of coefficients that the library expects
_GAUSSIAN_NODES = 513  # linear interpolation errs by less than 1e-4 of the peak


def sensor_json(sensor: SensorDescription, seed: int) -> dict[str, Any]:
    """SI description of the sensor as the native library reads it; `seed` is the random seed of the images."""
    data: dict[str, Any] = to_si(sensor.model_dump(exclude={"camera", "detector", "laser"}))
    data["detector"] = _detector_json(sensor.detector)
    data["laser"] = _laser_json(sensor.laser)
    data["cameras"] = [_camera_json(camera, sensor.laser.wavelength_nm) for camera in sensor.camera]
    data["render"]["seed"] = seed
    if sensor.band_pass.centre_nm is None:
        data["band_pass"]["centre"] = data["laser"]["wavelength"]
    return {"format": _FORMAT, **data}


def _detector_json(detector: DetectorDescription) -> dict[str, Any]:
    data: dict[str, Any] = to_si(detector.model_dump(exclude={"shutter", "row_readout_us"}))
    data["row_readout"] = 1e-6 * (detector.row_readout_us or 0.0)  # 0: global
    return data


def _laser_json(laser: LaserDescription) -> dict[str, Any]:
    data: dict[str, Any] = to_si(laser.model_dump(exclude={"profile", "profile_half_width_deg"}))
    if laser.profile_half_width_deg is not None:
        half, width = (to_si({"a_deg": a})["a"] for a in (laser.fan_half_angle_deg, laser.profile_half_width_deg))
        angles = np.linspace(-half, half, _GAUSSIAN_NODES)
        data["profile_angle"] = angles.tolist()
        data["profile_power"] = np.exp(-2.0 * (angles / width) ** 2).tolist()
    shape = data["straightness"]
    data["straightness"] = [*shape, *[0.0] * (_STRAIGHTNESS - len(shape))]
    return data


def _camera_json(camera: CameraDescription, wavelength_nm: float) -> dict[str, Any]:
    data: dict[str, Any] = to_si(camera.model_dump(exclude={"half_angle_deg", "cx_px", "cy_px"}))
    data["focal_px"] = focal_length_px(camera)
    data["cx_px"] = (camera.width_px - 1) / 2 if camera.cx_px is None else camera.cx_px
    data["cy_px"] = (camera.height_px - 1) / 2 if camera.cy_px is None else camera.cy_px
    data["focus"] = data["focus"] or 0.0  # 0: no defocus
    if camera.psf_sigma_px == "diffraction":
        # Gaussian approximation of the Airy disc (Zhang, Zerubia, Olivo-Marin, Applied Optics 46 (2007) 1819).
        spot, pitch = to_si(
            {"spot_nm": 0.42 * wavelength_nm * camera.f_number, "pitch_um": camera.pixel_pitch_um}
        ).values()
        data["psf_sigma_px"] = spot / pitch
    return data


def focal_length_px(camera: CameraDescription) -> float:
    """Focal length from image height and half angle: ``f = H / (2 tan gamma)``."""
    gamma = si_value(camera, "half_angle_deg")
    return float(camera.height_px / (2.0 * np.tan(gamma)))
