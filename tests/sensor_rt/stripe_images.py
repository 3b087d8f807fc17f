"""Stripe images computed in NumPy, and a matching sensor description. Independent of the ray tracer."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.stripe_images import cramer_rao, mean_bound, stripe
from scancell.sensor import PEAK_REJECTED, Peaks, Sensor, expose

__all__ = [
    "OPEN",
    "PEAK_E",
    "accepted",
    "cramer_rao",
    "images_of",
    "make_sensor",
    "mean_bound",
    "sensor_description",
    "stripe",
]

Array = NDArray[np.float64]

PEAK_E = 10_000.0  # height of the standard stripe, electrons
# Detectors without a model have noisy shape measures: comparisons of rows leave the limits of shapes open.
OPEN = {
    "max_asymmetry": 9.0, "max_residual": 9.0, "max_width_jump": 9.0, "max_amplitude_jump": 9.0,
    "max_row_jump_px": 9.0,
}  # fmt: skip


def sensor_description(width: int = 1280, height: int = 1024, cameras: int = 1, **overrides: Any) -> dict[str, Any]:
    """Description of an 8-bit sensor; ``section={"key": value}`` overrides single keys (``camera=`` of all cameras)."""
    focal_px = float(height / (2.0 * np.tan(np.radians(9.34))))
    camera = {
        "baseline": 0.06, "height": 0.0, "tilt": float(np.radians(29.3)), "pan": 0.0, "roll": 0.0, "offset_y": 0.0,
        "width_px": width, "height_px": height, "focal_px": focal_px,
        "cx_px": (width - 1) / 2.0, "cy_px": (height - 1) / 2.0, "pixel_pitch": 5e-6, "distortion": [0.0] * 5,
        "f_number": 11.0, "transmission": 0.8, "focus": 0.0, "psf_sigma_px": 0.0,
        "scheimpflug_x": 0.0, "scheimpflug_y": 0.0,
    } | overrides.pop("camera", {})  # fmt: skip
    description: dict[str, Any] = {
        "format": 1, "name": "test",
        "laser": {
            "wavelength": 660e-9, "power": 1e-3, "fan_half_angle": 0.28, "sheet_sigma": 55e-6, "waist_z": 0.12,
            "divergence": 4e-4, "source_z": 0.0, "source_length": 0.0, "profile_angle": [], "profile_power": [],
            "straightness": [0.0] * 6, "offset_x": 0.0, "turn_y": 0.0, "turn_z": 0.0,
        },
        "range": {"near": 0.0, "far": 10.0},
        "cameras": [camera | {"name": f"camera {k}", "side": 1 - 2 * (k % 2)} for k in range(cameras)],
        "detector": {
            "exposure": 5e-4, "quantum_efficiency": 0.55, "full_well_e": 11_000.0, "read_noise_e": 5.0,
            "dark_current_e_per_s": 0.0, "gain_dn_per_e": 0.0225, "bit_depth": 8, "black_level_dn": 4.0,
            "prnu": 0.0, "dsnu_e": 0.0, "row_noise_e": 0.0, "hot_pixels": 0.0, "hot_pixel_e_per_s": 0.0,
            "row_readout": 0.0, "laser_off_frame": False,
        },
        "ambient": {"irradiance": 0.0},
        "band_pass": {"centre": 660e-9, "width": 20e-9},
        "speckle": {"contrast": 0.0},
        "render": {
            "samples_per_pixel": 16, "noise": True, "seed": 1, "rays_across_fan": 1440, "mode": "fast",
            "bounces": 0, "photons": 65_536,
        },
        "extraction": {
            "detector": "gaussian", "peak": "brightest", "continuity_px": 4.0, "agreement_px": 0.5,
            "triangulation": "exact", "fusion": "none", "threshold_sigma": 6.0, "min_amplitude_dn": 4.0,
            "min_sigma_px": 0.4, "max_sigma_px": 6.0, "max_asymmetry": 0.05, "max_residual": 0.05,
            "max_row_jump_px": 0.1, "max_amplitude_jump": 0.3, "max_width_jump": 0.15,
            "end_columns": 1, "min_run_columns": 8,
        },
        "geometric": {"rays": 1280},
    }  # fmt: skip
    for section, values in overrides.items():
        description[section] |= values
    return description


def make_sensor(width: int = 1280, height: int = 1024, cameras: int = 1, **overrides: Any) -> Sensor:
    """Sensor from :func:`sensor_description`."""
    return Sensor(json.dumps(sensor_description(width, height, cameras, **overrides)))


def images_of(sensor: Sensor, electrons: Array, frames: int = 1, first: int = 0) -> NDArray[np.uint16]:
    """Images (frames, 1, height, width) of electrons (height, width), or (frames, height, width)."""
    light = np.broadcast_to(electrons, (frames, *electrons.shape[-2:]))[:, None].astype(np.float32)
    return expose(light, sensor, np.full(frames, 5e-4), np.arange(first, first + frames))


def width2(image: Array, column: int = 640) -> float:
    """Variance over the rows of the light in a column, px²."""
    light = image[:, column].astype(float)
    rows = np.arange(len(light))
    mean = (light * rows).sum() / light.sum()
    return float((light * (rows - mean) ** 2).sum() / light.sum())


def accepted(peaks: Peaks) -> NDArray[np.bool_]:
    """Mask (n,) of the peaks that are triangulated."""
    return np.asarray((peaks.flags & PEAK_REJECTED) == 0)
