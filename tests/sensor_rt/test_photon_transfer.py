"""Photon-transfer curve of rendered flat fields compared with the detector parameters (EMVA 1288, linear model)."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from stripe_images import make_sensor

from scancell.sensor import Exposures, Scene, render

WIDTH, HEIGHT, PAIRS = 320, 256, 8
GAIN, READ, FULL, BLACK = 0.35, 5.0, 9_000.0, 100.0
DEEP = {"bit_depth": 12, "gain_dn_per_e": GAIN, "black_level_dn": BLACK, "full_well_e": FULL, "read_noise_e": READ}


def flat_fields(detector: dict[str, Any], irradiance: float, duration: float) -> np.ndarray:
    """Images (2 * PAIRS, height, width) of a large plane under uniform light, independent noise in each."""
    scene = Scene()
    plane = np.eye(4)
    plane[2, 3] = 0.13
    scene.add_plane("wall", np.eye(4), [2.0, 2.0], 0.5)
    sensor = make_sensor(WIDTH, HEIGHT, laser={"power": 0.0}, ambient={"irradiance": irradiance}, detector=detector)
    count = 2 * PAIRS
    poses = np.broadcast_to(np.eye(4), (count, 1, 4, 4)), np.broadcast_to(plane, (count, 1, 1, 4, 4))
    images = render(scene, sensor, Exposures(*poses, np.full(count, duration), np.arange(count)))[:, 0]
    return np.asarray(images, float)


def middle(images: np.ndarray) -> np.ndarray:
    """Central part of the images, where cos⁴ of the field angle varies little."""
    return images[:, HEIGHT // 2 - 40 : HEIGHT // 2 + 40, WIDTH // 2 - 60 : WIDTH // 2 + 60]


def mean_and_variance(images: np.ndarray) -> tuple[float, float]:
    """Mean, and temporal variance from pair differences, which cancel fixed patterns and vignetting."""
    inner = middle(images)
    return float(inner.mean()), float((inner[::2] - inner[1::2]).var() / 2)


@pytest.mark.parametrize("pattern", [{}, {"prnu": 0.01, "dsnu_e": 2.0}])
def test_photon_transfer_returns_gain_read_noise_and_full_well(pattern: dict[str, float]) -> None:
    detector = DEEP | pattern
    exposures = 5e-4 * np.array([0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7])
    one_e = mean_and_variance(flat_fields(detector, 5.0, 5e-4))[0] - BLACK
    irradiance = 5.0 * 0.9 * FULL * GAIN / one_e  # 0.9 of the full well at 0.5 ms
    curve = np.array([mean_and_variance(flat_fields(detector, irradiance, float(t))) for t in exposures])
    signal, variance = curve[:, 0] - BLACK, curve[:, 1] - 1 / 12  # quantisation
    gain, floor = np.polyfit(signal, variance, 1)
    assert gain == pytest.approx(GAIN, rel=0.02)
    dark = mean_and_variance(flat_fields(detector, 0.0, 5e-4))[1] - 1 / 12
    assert np.sqrt(dark) / GAIN == pytest.approx(READ, rel=0.02)
    assert floor == pytest.approx(dark, abs=0.05 * variance.mean())
    # Far above saturation the signal is the full well, and its noise is read noise only.
    over = middle(flat_fields(detector | {"prnu": 0.0}, 4 * irradiance, 5e-4))
    assert (over.mean() - BLACK) / GAIN == pytest.approx(FULL, rel=0.02)
    # Electrons are proportional to the exposure.
    np.testing.assert_allclose(signal / exposures, (signal / exposures).mean(), rtol=5e-3)
