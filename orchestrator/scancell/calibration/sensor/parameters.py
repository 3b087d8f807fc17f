"""Free parameters of a sensor: their names, values, scales, and the native sensor models that they give."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.config.files import plain_data
from scancell.config.keys import split_path
from scancell.config.sensor import SensorDescription, sensor_json
from scancell.errors import CalibrationError, DescriptionError

Array = NDArray[np.float64]

RADIUS_OFFSET = "target.radius_offset_mm"
"""Free parameter beside those of the sensor: what all spheres of the target exceed their stated radius by, mm."""

_BENDS = 6  # coefficients of the sheet's out-of-plane angle

# What a parameter may deviate by from the data sheet, in its unit: directions are compared in these units.
_TOLERANCES = {
    "baseline_mm": 1.0,
    "height_mm": 1.0,
    "offset_y_mm": 1.0,
    "tilt_deg": 1.0,
    "pan_deg": 1.0,
    "roll_deg": 1.0,
    "half_angle_deg": 0.2,
    "cx_px": 30.0,
    "cy_px": 30.0,
    "distortion[1]": 0.3,
    "distortion[2]": 1.0,
    "distortion[3]": 0.01,
    "distortion[4]": 0.01,
    "distortion[5]": 10.0,
    "scheimpflug_x_deg": 1.0,
    "scheimpflug_y_deg": 1.0,
    "offset_x_mm": 1.0,
    "turn_y_deg": 1.0,
    "turn_z_deg": 1.0,
    "straightness_mrad": 5.0,
    "radius_offset_mm": 0.1,
}
_POSE = ("baseline_mm", "height_mm", "offset_y_mm", "tilt_deg", "pan_deg", "roll_deg")
_SHEET = ("offset_x_mm", "turn_y_deg", "turn_z_deg")
FRAME = (
    *(f"sensor.laser.{key}" for key in _SHEET),
    *(f"sensor.camera[1].{key}" for key in ("offset_y_mm", "height_mm", "pan_deg")),
)
"""They place the sensor frame: its plane X = 0 on the sheet, its Y, Z and rotation about X by the first camera."""


def free_parameters(sensor: SensorDescription, poses_known: bool, checkered: bool) -> tuple[str, ...]:
    """Parameters that a complete set of measurements determines.

    Of every camera the pose, the field of view and the first radial distortion; of the sheet its plane and curvature.
    Points on the sheet alone do not distinguish the principal point from the camera's direction: it is free with a
    checkered target.

    Parameters
    ----------
    poses_known
        Whether the targets' poses in the sensor frame are known. Otherwise the pose of the sensor frame itself is
        undetermined, and the six parameters that place it are held: the sheet's plane is X = 0, and the first camera
        gives Y, Z and the rotation about X. The calibration of the tool transform absorbs their values.
    checkered
        Whether the cameras see a checkered target.
    """
    of_camera = (*_POSE, "half_angle_deg", "distortion[1]", *(("cx_px", "cy_px") if checkered else ()))
    names = [f"sensor.camera[{k + 1}].{key}" for k in range(len(sensor.camera)) for key in of_camera]
    # The first two coefficients of the curvature are turns of the sheet.
    names += [f"sensor.laser.{key}" for key in (*_SHEET, "straightness_mrad[3]", "straightness_mrad[4]")]
    return tuple(name for name in names if poses_known or name not in FRAME)


class SensorParameters:
    """Chosen keys of a sensor description as a vector, in the units of the keys.

    Raises `CalibrationError` if a name is unknown or given twice.

    Parameters
    ----------
    start
        The description whose other values are kept.
    names
        Keys such as ``sensor.camera[1].tilt_deg``, and `RADIUS_OFFSET`.
    """

    def __init__(self, start: SensorDescription, names: Sequence[str]) -> None:
        if len(set(names)) < len(names):
            raise CalibrationError("a name is given twice", key="also", value=tuple(names))
        self.names = tuple(names)
        self.start = _complete(start)
        self.scales = np.array([_tolerance(name) for name in names])

    @cached_property
    def start_values(self) -> Array:
        """Values (k,) of the start."""
        return np.array([0.0 if name == RADIUS_OFFSET else self._value(name) for name in self.names])

    def description(self, values: Array) -> SensorDescription:
        """The description with other values (k,), by which points are triangulated on the described sheet.

        Raises `CalibrationError` if a value is outside the bounds of its key.
        """
        pairs = zip(self.names, values.tolist(), strict=True)
        try:
            return self.start.replace({n.removeprefix("sensor."): v for n, v in pairs if n != RADIUS_OFFSET})
        except DescriptionError as error:
            raise CalibrationError(
                f"the calibration left the bounds of the sensor's description; check target, poses and start\n{error}"
            ) from error

    def sensor(self, values: Array) -> sensor_rt.Sensor:
        """Native model with these values (k,). `CalibrationError` as in `description`."""
        return sensor_rt.Sensor(json.dumps(sensor_json(self.description(values), 0)))

    def radius_offset(self, values: Array) -> float:
        """Radius offset of the spheres, m."""
        return 1e-3 * float(values[self.names.index(RADIUS_OFFSET)]) if RADIUS_OFFSET in self.names else 0.0

    def _value(self, name: str) -> float:
        node = {"sensor": plain_data(self.start)}
        for part in split_path(name):
            try:
                node = node[part]  # type: ignore[index]
            except (KeyError, IndexError, TypeError):
                raise CalibrationError("the sensor has no such key", key="also", value=name) from None
        return float(node)  # type: ignore[arg-type]


def _tolerance(name: str) -> float:
    key = name.rsplit(".", 1)[-1]
    found = _TOLERANCES.get(key) or _TOLERANCES.get(re.sub(r"\[\d+\]$", "", key))
    if found is None:
        raise CalibrationError(key="also", value=name, expected=f"one of the keys {', '.join(_TOLERANCES)}")
    return found


def _complete(sensor: SensorDescription) -> SensorDescription:
    """The same sensor with all values that may be free written out, and triangulation on its sheet."""
    bends = sensor.laser.straightness_mrad
    changes: dict[str, object] = {
        "extraction.triangulation": "sheet",
        "laser.straightness_mrad": [*bends, *[0.0] * (_BENDS - len(bends))],
    }
    for k, camera in enumerate(sensor.camera):
        for key, size in (("cx_px", camera.width_px), ("cy_px", camera.height_px)):
            if getattr(camera, key) is None:
                changes[f"camera[{k + 1}].{key}"] = (size - 1) / 2
    return sensor.replace(changes)
