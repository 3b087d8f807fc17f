"""Stripes far above saturation with a halo: flat tops of many rows, as recorded images show them."""

from __future__ import annotations

import numpy as np
import pytest
from stripe_images import OPEN, PEAK_E, accepted, images_of, make_sensor, stripe

from scancell.sensor import extract

WIDTH, HEIGHT, FRAMES = 640, 160, 2
HALO_SIGMA = 14.0  # px
ROWS = 80.0 + 0.0137 * np.arange(WIDTH)
DETECTORS = ("gaussian", "centre_of_gravity", "log_parabola", "derivative_of_gaussian", "steger")


def light(height, sigma, halo=0.0, shift=0.0, contrast=0.0):
    """Electrons of a Gaussian core `height` times as high as saturation on a wide Gaussian halo.

    The halo is `halo` times as high as saturation, `shift` rows below the core, with speckle of independent pixels.
    """
    grains = 1.0
    if contrast > 0:
        grains = np.random.default_rng(2).gamma(contrast**-2, contrast**2, (HEIGHT, WIDTH))
    wide = stripe(ROWS + shift, HALO_SIGMA, halo * PEAK_E, HEIGHT)
    return stripe(ROWS, sigma, height * PEAK_E, HEIGHT) + grains * wide


def measure(electrons, detector="gaussian", **extraction):
    """Errors of row (px), stated deviations, widths of the accepted peaks, and their number per column."""
    options = OPEN | {"detector": detector, "max_sigma_px": 8.0} | extraction
    sensor = make_sensor(WIDTH, HEIGHT, detector={"full_well_e": PEAK_E}, extraction=options)
    peaks = extract(images_of(sensor, electrons, FRAMES), sensor)
    keep = accepted(peaks)
    share = keep.sum() / (FRAMES * WIDTH)
    return (peaks.row - ROWS[peaks.column])[keep], peaks.row_sigma[keep], peaks.width[keep], share


@pytest.mark.parametrize("height", [3.0, 10.0, 50.0])
@pytest.mark.parametrize("sigma", [1.5, 3.2, 5.0])
def test_light_beyond_saturation_is_measured_from_the_flanks(height, sigma):
    error, stated, width, share = measure(light(height, sigma))
    assert share > 0.97
    assert np.sqrt(np.mean(error**2)) == pytest.approx(np.sqrt(np.mean(stated**2)), rel=0.1)
    assert np.sqrt(np.mean(error**2)) < 0.015
    assert np.median(width) == pytest.approx(sigma, rel=0.02)


@pytest.mark.parametrize("height", [3.0, 10.0, 30.0])
def test_symmetric_halo_shifts_nothing(height):
    error, _, width, share = measure(light(height, 3.2, halo=0.15))
    assert share > 0.97
    assert abs(error.mean()) < 4 * error.std() / np.sqrt(error.size) + 0.001
    assert np.sqrt(np.mean(error**2)) < 0.015
    assert np.median(width) == pytest.approx(3.2, rel=0.06)


@pytest.mark.parametrize("halo", [0.15, 0.3])
@pytest.mark.parametrize("height", [3.0, 10.0])
def test_uneven_halo_shifts_less_than_its_difference_at_the_foot(halo, height):
    """A difference d of the halo between the flanks moves the middle between them by d over twice their slope.

    Slopes are smaller towards the foot; the fit weighs rows of all levels.
    """
    sigma, shift, level = 3.2, 4.0, 0.125
    error, _, _, share = measure(light(height, sigma, halo, shift))
    foot = sigma * np.sqrt(2.0 * np.log(height / level))
    slope = level * foot / sigma**2
    at = halo * np.exp(-0.5 * ((np.array([foot, -foot]) - shift) / HALO_SIGMA) ** 2)
    assert share > 0.97
    assert 0.0 < error.mean() < (at[0] - at[1]) / (2.0 * slope)


@pytest.mark.parametrize("detector", DETECTORS)
@pytest.mark.parametrize("halo", [0.15, 0.3])
def test_stripe_with_speckled_halo_is_found(detector, halo):
    error, _, width, share = measure(light(10.0, 3.2, halo, 4.0, contrast=0.2), detector)
    assert share > 0.95
    assert np.abs(error).max() < 3.2
    assert width.max() < 8.0


def test_saturated_ambient_light_is_no_flat_top():
    sensor = make_sensor(64, 48, extraction=OPEN)
    images = np.full((1, 1, 48, 64), 254, np.uint16)
    images[0, 0, 20:32] = 255
    peaks = extract(images, sensor)
    assert np.isfinite(peaks.row).all() and not accepted(peaks).any()


def test_shapes_with_default_limits_are_accepted():
    limits = {"max_asymmetry": 0.05, "max_residual": 0.05, "max_width_jump": 0.15, "max_row_jump_px": 0.1}
    _, _, _, share = measure(light(10.0, 3.2, halo=0.1), **limits)
    assert share > 0.9
