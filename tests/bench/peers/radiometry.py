"""What the sensor's electrons mean in watts, written down a second time from the description alone."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

PLANCK = 6.62607015e-34
LIGHT_SPEED = 299792458.0


def camera_axes(camera: dict[str, Any]) -> NDArray[np.float64]:
    """Camera axes as columns (right, down, forward) in the sensor frame."""
    side, tilt = camera["side"], camera["tilt"]
    right = [0.0, -side, 0.0]
    down = [side * np.cos(tilt), 0.0, np.sin(tilt)]
    forward = [-side * np.sin(tilt), 0.0, np.cos(tilt)]
    return np.array([right, down, forward]).T


def electrons_per_radiance(description: dict[str, Any], camera: dict[str, Any]) -> NDArray[np.float64]:
    """Electrons of each pixel (height, width) per W/m²/sr that it sees over the default exposure.

    A thin lens of working f-number N makes ``pi L cos⁴ / (4 N²)`` of irradiance from radiance L.
    """
    detector, focal = description["detector"], camera["focal_px"]
    x = (np.arange(camera["width_px"]) - camera["cx_px"]) / focal
    y = (np.arange(camera["height_px"]) - camera["cy_px"]) / focal
    cos4 = 1.0 / (1.0 + x[None, :] ** 2 + y[:, None] ** 2) ** 2
    joules = cos4 * np.pi / (4 * camera["f_number"] ** 2) * camera["transmission"] * camera["pixel_pitch"] ** 2
    photons_per_joule = description["laser"]["wavelength"] / (PLANCK * LIGHT_SPEED)
    constant = photons_per_joule * detector["quantum_efficiency"] * detector["exposure"]
    return np.asarray(joules * constant)
