"""All detectors on straight stripes: scatter, bias and stated uncertainty compared with theory."""

from __future__ import annotations

import numpy as np
import pytest
from stripe_images import OPEN, PEAK_E, accepted, images_of, make_sensor, mean_bound, stripe

from benchmarks.tracks.stripe import FLOOR_E2
from scancell.sensor import extract

WIDTH, HEIGHT = 1280, 128
DETECTORS = [
    *("gaussian", "centre_of_gravity", "parabola", "log_parabola"),
    *("blais_rioux_4", "blais_rioux_8", "derivative_of_gaussian", "steger"),
]


def rows(frame=0):
    return 60.0 + 0.0137 * np.arange(WIDTH) + 0.29 * frame


def measure(detector, sigma, peak=PEAK_E, noise=True, frames=3, slope=0.0):
    sensor = make_sensor(WIDTH, HEIGHT, render={"noise": noise}, extraction={"detector": detector} | OPEN)
    truth = np.stack([rows(f) + slope * (np.arange(WIDTH) - 640) for f in range(frames)])
    light = np.stack([stripe(r, sigma, peak, HEIGHT) for r in truth])
    peaks = extract(images_of(sensor, light, frames), sensor)
    keep = accepted(peaks)
    assert keep.mean() > 0.97
    return (peaks.row - truth[peaks.frame, peaks.column])[keep], peaks.row_sigma[keep]


def bound(sigma, peak=PEAK_E):
    return mean_bound(sigma, peak, FLOOR_E2)


@pytest.mark.parametrize("detector", DETECTORS)
def test_mean_bias_is_zero(detector):
    error, _ = measure(detector, 1.5)
    assert abs(error.mean()) < 4 * error.std() / np.sqrt(error.size) + 0.001


def in_room_light(detector, background, sigma=1.5, peak=4000.0, frames=4):
    """Errors of row (px) on `background` (electrons, (height, width)), and the share of columns with a peak."""
    height = len(background)
    sensor = make_sensor(WIDTH, height, extraction={"detector": detector} | OPEN)
    truth = np.stack([0.5 * height + 0.0137 * np.arange(WIDTH) + 0.29 * f for f in range(frames)])
    light = np.stack([stripe(r, sigma, peak, height) + background for r in truth])
    peaks = extract(images_of(sensor, light, frames), sensor)
    keep = accepted(peaks)
    return (peaks.row - truth[peaks.frame, peaks.column])[keep], keep.sum() / (frames * WIDTH)


@pytest.mark.parametrize("detector", DETECTORS)
@pytest.mark.parametrize("slope_dn", [-0.4, 0.05])
def test_room_light_with_a_slope_shifts_nothing(detector, slope_dn):
    rows, columns = np.mgrid[:320, :WIDTH]
    per_dn = 1 / 0.0225
    background = per_dn * (75.0 + slope_dn * (rows - 160.0) + 0.01 * (columns - 640.0))
    error, share = in_room_light(detector, background)
    assert share > 0.97
    assert abs(error.mean()) < 0.005
    assert abs(np.median(error)) < 0.005


@pytest.mark.parametrize("detector", DETECTORS)
def test_curved_room_light_shifts_nothing(detector):
    """The brightness varies by a quarter of full scale over 100 rows and over 400 columns."""
    rows, columns = np.mgrid[:400, :WIDTH]
    background = 1.0 / 0.0225 * (70.0 + 32.0 * np.sin(rows / 64.0) + 16.0 * np.cos(columns / 250.0))
    error, share = in_room_light(detector, background)
    assert share > 0.97
    assert abs(error.mean()) < 0.005


@pytest.mark.parametrize(
    ("detector", "factor"),
    [
        ("gaussian", 1.1),
        ("centre_of_gravity", 1.2),
        ("log_parabola", 1.1),
        ("derivative_of_gaussian", 1.25),
        ("blais_rioux_8", 1.35),
        ("blais_rioux_4", 1.8),
        ("parabola", 4.0),
    ],
)
def test_scatter_relative_to_cramer_rao_bound(detector, factor):
    error, _ = measure(detector, 1.5)
    assert 0.9 * bound(1.5) < error.std() < factor * bound(1.5)


def test_steger_averages_over_adjacent_columns():
    error, row_sigma = measure("steger", 1.5)
    assert error.std() < 0.6 * bound(1.5)
    assert row_sigma.mean() == pytest.approx(error.std(), rel=0.1)
    neighbours = np.corrcoef(error[:-1], error[1:])[0, 1]
    assert neighbours > 0.7


@pytest.mark.parametrize(
    "detector", ["gaussian", "log_parabola", "derivative_of_gaussian", "centre_of_gravity", "steger"]
)
@pytest.mark.parametrize("sigma", [1.5, 3.0])
def test_stated_sigma_matches_scatter(detector, sigma):
    error, row_sigma = measure(detector, sigma)
    assert np.sqrt(np.mean(row_sigma**2)) == pytest.approx(error.std(), rel=0.1)


@pytest.mark.parametrize("detector", DETECTORS)
@pytest.mark.parametrize(
    ("sigma", "peak", "light"), [(0.65, 2000, 0), (0.8, 9000, 0), (1.3, 4000, 1800), (2.0, 8000, 0), (3.5, 2500, 4000)]
)
def test_stated_sigma_holds_for_all_widths(detector, sigma, peak, light):
    """Noise, rounding, and the error between pixels of detectors that do not fit the pixel-integrated shape.

    The three highest rows of a wide stripe are chosen by their noise, which bounds the error of the parabola.
    """
    sensor = make_sensor(WIDTH, HEIGHT, extraction={"detector": detector, "min_sigma_px": 0.1} | OPEN)
    truth = np.stack([rows(f) for f in range(2)])
    peaks = extract(images_of(sensor, np.stack([stripe(r, sigma, peak, HEIGHT) for r in truth]) + light, 2), sensor)
    keep = accepted(peaks)
    error, stated = (peaks.row - truth[peaks.frame, peaks.column])[keep], peaks.row_sigma[keep].astype(float)
    ratio = error.std() / np.sqrt(np.mean(stated**2))
    assert (0.7 if (detector, sigma) == ("parabola", 3.5) else 0.9) < ratio < 1.1


@pytest.mark.parametrize("detector", ["gaussian", "log_parabola", "derivative_of_gaussian", "steger"])
@pytest.mark.parametrize("sigma", [1.0, 2.0])
@pytest.mark.parametrize("slope", [0.0, 0.03])
def test_bias_without_noise(detector, sigma, slope):
    """Only quantisation remains."""
    error, _ = measure(detector, sigma, noise=False, frames=1, slope=slope)
    assert np.sqrt(np.mean(error**2)) < 0.004


@pytest.mark.parametrize("detector", DETECTORS)
def test_random_images_give_finite_values(detector):
    rng = np.random.default_rng(5)
    images = rng.integers(0, 256, (3, 1, 48, 64)).astype(np.uint16)
    images[1] *= rng.integers(0, 2, (1, 48, 64)).astype(np.uint16)
    images[2] = 255
    peaks = extract(images, make_sensor(64, 48, extraction={"detector": detector}))
    for name in ("row", "amplitude", "width", "row_sigma", "asymmetry", "residual"):
        assert np.isfinite(getattr(peaks, name)).all(), name
    assert ((peaks.row > -2) & (peaks.row < 50)).all()


@pytest.mark.parametrize("detector", DETECTORS)
def test_stripes_at_image_border_and_in_small_images(detector):
    sensor = make_sensor(40, 12, extraction={"detector": detector})
    for row in (0.3, 1.4, 6.0, 10.6, 11.0):
        peaks = extract(images_of(sensor, stripe(np.full(40, row), 1.2, 6000.0, 12)), sensor)
        assert np.isfinite(peaks.row).all()
        assert np.abs(peaks.row[accepted(peaks)] - row).max(initial=0.0) < 0.3
