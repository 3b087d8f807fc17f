"""Make the sensor presets with real lenses, ``sensors/realistic``, from those with ideal ones beside that folder.

Run it without arguments, with scancell installed. Every camera gets a lens that is in focus on the whole laser sheet
and a point spread; its image sensor leans, which takes more rows for the same measuring range. A sensor that states no
speckle and no smile gets both.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np

from scancell.config.sensor import SensorDescription, focal_length_px, sensor_json
from scancell.sensor import Sensor

SENSORS = Path(__file__).resolve().parent / "sensors"
NAMES = (
    "short_range_8",
    "short_range_25",
    "medium_range_50",
    "medium_range_80",
    "long_range_400",
    "two_camera_probe",
)
ABERRATION = 0.4  # px: standard deviation of the spot of a well corrected lens, beside diffraction
SPECKLE = "\n[speckle]\ncontrast = 0.1\n"
SMILE = "straightness_mrad = [-0.026667, 0.0, 0.08]\n"


def with_lens(ideal: SensorDescription, height_px: int, cy_px: float) -> SensorDescription:
    """The sensor with images of another height, and lenses in focus on the sheet, see `CameraDescription`."""
    data: dict[str, Any] = ideal.model_dump(mode="json")
    for camera, described in zip(data["camera"], ideal.camera, strict=True):
        tilt, focal_px = np.radians(described.tilt_deg), focal_length_px(described)
        image_distance_mm = 1e-3 * described.pixel_pitch_um * focal_px
        lean = -np.degrees(np.arctan2(image_distance_mm * np.cos(tilt), described.baseline_mm))
        diffraction_px = 0.42e-3 * ideal.laser.wavelength_nm * described.f_number / described.pixel_pitch_um
        camera |= {
            "half_angle_deg": round(float(np.degrees(np.arctan2(height_px / 2, focal_px))), 4),
            "height_px": height_px,
            "cy_px": round(cy_px, 1),
            "scheimpflug_x_deg": round(float(lean), 3),
            "focus_mm": round(float(described.baseline_mm / np.sin(tilt)), 2),
            "psf_sigma_px": round(float(np.hypot(diffraction_px, ABERRATION)), 2),
        }
    return SensorDescription.model_validate(data)


def rows_of_range(sensor: SensorDescription) -> np.ndarray:
    """Image rows (2,) of the middle of the laser line at the ends of the measuring range."""
    points = np.array([[0.0, 0.0, 1e-3 * z] for z in (sensor.range.near_mm, sensor.range.far_mm)])
    return np.asarray(Sensor(json.dumps(sensor_json(sensor, 0))).cameras[0].project(points)[:, 1])


def realistic(ideal: SensorDescription) -> SensorDescription:
    """The sensor with real lenses of the same focal length, and as many more rows as the leaning image needs."""
    height, wanted = ideal.camera[0].height_px, rows_of_range(ideal)
    middle = (height - 1) / 2
    rows = rows_of_range(with_lens(ideal, height, middle))
    taller = height + 2 * int(np.ceil((np.ptp(rows) - np.ptp(wanted)) / 2))
    return with_lens(ideal, taller, middle + (taller - height) / 2 + float((wanted - rows).mean()))


def text_of(name: str) -> str:
    """The file of the realistic preset: that of the ideal one with the keys of its lenses."""
    text = (SENSORS / f"{name}.toml").read_text()
    made = realistic(SensorDescription.from_toml(SENSORS / f"{name}.toml"))
    lens = made.camera[0]
    keys = "".join(f"{key} = {getattr(lens, key)}\n" for key in ("scheimpflug_x_deg", "focus_mm", "psf_sigma_px"))
    text = re.sub(r"^#:schema \S+\n(# [^\n]*\n)*", "", text)
    text = re.sub(r'^name = ".*"', f'name = "{name}_realistic"', text)
    text = re.sub(r"(?m)^half_angle_deg = .*", f"half_angle_deg = {lens.half_angle_deg}", text)
    text = re.sub(r"height_px = .*\n", f"height_px = {lens.height_px}\ncy_px = {lens.cy_px}\n", text)
    text = re.sub(r"(pixel_pitch_um = .*\n)", rf"\1{keys}", text)
    if "[speckle]" not in text:
        text = text.rstrip("\n") + "\n" + SPECKLE
    if "straightness_mrad" not in text:
        text = re.sub(r"(divergence_mrad = .*\n)", rf"\1{SMILE}", text)
    written = "# Written by assets/realistic_sensors.py. See docs/sensor_presets.md."
    return f"#:schema ../../../docs/schemas/sensor.schema.json\n{written}\n{text}"


if __name__ == "__main__":
    for one in NAMES:
        (SENSORS / "realistic" / f"{one}.toml").write_text(text_of(one))
