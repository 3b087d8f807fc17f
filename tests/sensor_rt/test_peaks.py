"""Stripe centres compared with closed forms and the Cramér-Rao bound, on images computed in NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm
from stripe_images import PEAK_E, accepted, cramer_rao, images_of, make_sensor, mean_bound, stripe

from benchmarks.tracks.stripe import FLOOR_E2, GAIN, READ_E
from scancell.sensor import PEAK_FLAGS, extract

WIDTH, HEIGHT = 1280, 128
MEASURED = ("row", "amplitude", "width", "row_sigma", "asymmetry", "residual")


def slanted_rows(frame=0):
    """Centres that cover all sub-pixel positions."""
    return 60.0 + 0.0137 * np.arange(WIDTH) + 0.29 * frame


def errors(sensor, sigma, peak, frames=4):
    """Row errors of all usable peaks, and their number per column."""
    light = np.stack([stripe(slanted_rows(f), sigma, peak, HEIGHT) for f in range(frames)])
    peaks = extract(images_of(sensor, light, frames), sensor)
    truth = np.stack([slanted_rows(f) for f in range(frames)])[peaks.frame, peaks.column]
    keep = accepted(peaks)
    return (peaks.row - truth)[keep], peaks.row_sigma[keep], keep.sum() / (frames * WIDTH)


@pytest.mark.parametrize("sigma", [0.8, 1.5, 3.0])
def test_noise_free_bias(sigma):
    error, _, share = errors(make_sensor(WIDTH, HEIGHT, render={"noise": False}), sigma, PEAK_E)
    assert np.sqrt(np.mean(error**2)) < 0.003
    assert share > 0.99


@pytest.mark.parametrize("sigma", [0.8, 1.0, 1.5, 2.2, 3.0])
@pytest.mark.parametrize("peak", [PEAK_E, 2500.0])
def test_scatter_approaches_cramer_rao_bound(sigma, peak):
    error, row_sigma, share = errors(make_sensor(WIDTH, HEIGHT), sigma, peak)
    bound = mean_bound(sigma, peak, FLOOR_E2)
    scatter = error.std()
    assert scatter < 1.2 * bound
    assert scatter > 0.95 * bound  # less would indicate an error of the simulation
    assert abs(error.mean()) < 4 * scatter / np.sqrt(error.size) + 0.001
    assert np.sqrt(np.mean(row_sigma**2)) == pytest.approx(scatter, rel=0.06)
    assert share > 0.98


@pytest.mark.parametrize("bits", [10, 12, 16])
def test_bit_depths_above_eight(bits):
    detector = {"bit_depth": bits, "gain_dn_per_e": 0.0225 * 2 ** (bits - 8)}
    sensor = make_sensor(WIDTH, HEIGHT, detector=detector)
    error, row_sigma, share = errors(sensor, 1.5, PEAK_E)
    assert error.std() < 1.2 * cramer_rao(1.5, PEAK_E, 0.0, READ_E**2)
    assert row_sigma.mean() == pytest.approx(error.std(), rel=0.06)
    assert share > 0.98


@pytest.mark.parametrize("sigma", [0.8, 1.5, 2.2, 3.0])
def test_saturated_stripe_is_located(sigma):
    sensor = make_sensor(WIDTH, HEIGHT, detector={"full_well_e": PEAK_E})
    error, _, share = errors(sensor, sigma, 2.7 * PEAK_E)
    assert np.sqrt(np.mean(error**2)) < 0.01
    assert share > 0.97


@pytest.mark.parametrize("sigma", [0.2, 0.25, 0.3, 0.35])
def test_stated_sigma_holds_for_narrow_stripes(sigma):
    sensor = make_sensor(WIDTH, HEIGHT, extraction={"min_sigma_px": 0.1})
    error, row_sigma, share = errors(sensor, sigma, 8000.0)
    assert share > 0.6
    assert np.sqrt(np.mean(error**2)) < 1.1 * np.sqrt(np.mean(row_sigma**2))
    assert np.sqrt(np.mean(error**2)) < 0.06


def test_amplitude_and_width_are_measured():
    sensor = make_sensor(WIDTH, HEIGHT)
    peaks = extract(images_of(sensor, stripe(slanted_rows(), 1.7, 6000.0, HEIGHT)), sensor)
    assert np.median(peaks.width) == pytest.approx(1.7, rel=0.005)
    assert np.median(peaks.amplitude) == pytest.approx(6000.0 * GAIN, rel=0.005)
    assert abs(np.mean(peaks.asymmetry)) < 0.002
    assert len(peaks) == WIDTH
    np.testing.assert_array_equal(peaks.column, np.arange(WIDTH))


@pytest.mark.parametrize("coefficient", [-0.03, 0.03])
def test_asymmetry_matches_skewness(coefficient):
    """Gram-Charlier stripe: Gaussian times (1 + c He3), tail at larger rows for c > 0. Skewness is 6 c.

    The fitted Gaussian absorbs the part of He3 that shifts and widens it. In continuous least squares with even weights
    He3 = z³ - 3z loses its projection on z, and what remains is fitted with coefficient c exactly.
    """
    sigma, centre = 2.0, slanted_rows()
    fine = (np.arange(HEIGHT * 32) + 0.5) / 32 - 0.5
    z = (fine[:, None] - centre) / sigma
    light = PEAK_E * 0.9 * np.exp(-0.5 * z**2) * (1 + coefficient * (z**3 - 3 * z))
    light = np.maximum(light, 0).reshape(HEIGHT, 32, WIDTH).mean(axis=1)
    for detector in ("gaussian", "centre_of_gravity"):
        sensor = make_sensor(
            WIDTH, HEIGHT, render={"noise": False}, extraction={"max_asymmetry": 0.5, "detector": detector}
        )
        peaks = extract(images_of(sensor, light), sensor)
        assert np.mean(peaks.asymmetry) == pytest.approx(coefficient, rel=0.15)


@pytest.mark.parametrize("ratio", [0.3, 0.6])
@pytest.mark.parametrize("edge", [-2.0, 0.0, 1.5])
def test_reflectance_step_shifts_centre_of_gravity(ratio, edge):
    """A step 1:r at distance e from the centre shifts the mean by -σ(1-r)φ(e/σ) / [Φ(e/σ) + r(1-Φ(e/σ))]."""
    sigma, centre = 2.0, 64.0 + np.linspace(-0.5, 0.5, WIDTH)
    fine = (np.arange(HEIGHT * 64) + 0.5) / 64 - 0.5
    z = fine[:, None] - centre
    light = 8000.0 * np.exp(-0.5 * (z / sigma) ** 2) * np.where(z > edge, ratio, 1.0)
    light = light.reshape(HEIGHT, 64, WIDTH).mean(axis=1)
    sensor = make_sensor(
        WIDTH,
        HEIGHT,
        render={"noise": False},
        detector={"bit_depth": 16, "gain_dn_per_e": 5.0},
        extraction={"detector": "centre_of_gravity", "max_asymmetry": 10.0},
    )
    peaks = extract(images_of(sensor, light), sensor)
    e = edge / sigma
    predicted = -sigma * (1 - ratio) * norm.pdf(e) / (norm.cdf(e) + ratio * norm.sf(e))
    assert np.mean(peaks.row - centre) == pytest.approx(predicted, rel=0.02)


@pytest.mark.parametrize(("choice", "expected"), [("brightest", 80.0), ("first", 40.0), ("last", 110.0)])
def test_choice_among_several_peaks(choice, expected):
    sensor = make_sensor(WIDTH, HEIGHT, extraction={"peak": choice})
    light = sum(
        stripe(np.full(WIDTH, row), 1.3, peak, HEIGHT)
        for row, peak in [(40.0, 3000.0), (80.0, 8000.0), (110.0, 2000.0)]
    )
    peaks = extract(images_of(sensor, light), sensor)
    assert np.median(peaks.row) == pytest.approx(expected, abs=0.01)
    assert (peaks.flags & PEAK_FLAGS["multiple"]).all()
    assert accepted(peaks).mean() > 0.98


def test_dark_image_with_hot_pixels_gives_no_peaks():
    detector = {"dsnu_e": 20.0, "bit_depth": 12, "gain_dn_per_e": 0.36, "black_level_dn": 60.0}
    sensor = make_sensor(1280, 1024, detector=detector)
    hot = np.zeros((1024, 1280))
    where = np.random.default_rng(3).integers(0, [[1024], [1280]], (2, 400))
    hot[tuple(where)] = 5000.0
    peaks = extract(images_of(sensor, hot), sensor)
    assert not accepted(peaks).any()
    assert len(extract(images_of(sensor, np.zeros((1024, 1280))), sensor)) == 0


def test_hot_pixels_do_not_affect_stripe():
    sensor = make_sensor(1280, 1024, detector={"bit_depth": 12, "gain_dn_per_e": 0.36})
    rows = np.full(1280, 700.3)
    light = stripe(rows, 1.3, 3000.0, 1024)
    light[np.random.default_rng(3).integers(0, 600, 300), np.random.default_rng(4).integers(0, 1280, 300)] = 5000.0
    peaks = extract(images_of(sensor, light), sensor)
    assert abs(np.median(peaks.row) - 700.3) < 0.01
    assert np.abs(peaks.row[accepted(peaks)] - 700.3).max() < 0.15


def test_stripe_at_image_border_is_flagged():
    sensor = make_sensor(WIDTH, HEIGHT)
    for row in (0.5, HEIGHT - 1.2):
        peaks = extract(images_of(sensor, stripe(np.full(WIDTH, row), 1.5, 8000.0, HEIGHT)), sensor)
        assert (peaks.flags & PEAK_FLAGS["border"]).all()


def test_uniform_ambient_light_is_removed():
    for detector in ("gaussian", "centre_of_gravity"):
        sensor = make_sensor(WIDTH, HEIGHT, extraction={"detector": detector})
        peaks = extract(images_of(sensor, 1500.0 + stripe(slanted_rows(), 1.5, 6000.0, HEIGHT)), sensor)
        error = (peaks.row - slanted_rows()[peaks.column])[accepted(peaks)]
        assert accepted(peaks).mean() > 0.97
        assert abs(error.mean()) < 0.005
        assert error.std() < 0.05


def test_result_does_not_depend_on_threads():
    sensor = make_sensor(WIDTH, HEIGHT)
    light = np.stack([stripe(slanted_rows(f), 1.5, 5000.0, HEIGHT) for f in range(6)])
    images = images_of(sensor, light, 6)
    one, two = extract(images, sensor, 1), extract(images, sensor, 2)
    for name in ("frame", "camera", "column", "flags", *MEASURED):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
    assert list(np.unique(one.frame)) == list(range(6))


@pytest.mark.parametrize(
    ("images", "message"),
    [
        (np.zeros((1, 1, 48, 64)), "images: expected uint16"),
        (np.zeros((1, 48, 64), np.uint16), "images: expected uint16"),
        (np.zeros((1, 3, 48, 64), np.uint16), "2 cameras"),
        (np.zeros((1, 2, 40, 64), np.uint16), "48 rows"),
    ],
)
def test_invalid_images_are_rejected(images, message):
    with pytest.raises(ValueError, match=message):
        extract(images, make_sensor(64, 48, cameras=2))


def test_empty_stack_gives_no_peaks():
    assert len(extract(np.zeros((0, 2, 48, 64), np.uint16), make_sensor(64, 48, cameras=2))) == 0


@pytest.mark.parametrize(("key", "value"), [("max_sigma_px", 9.0), ("max_sigma_px", 0.3)])
def test_options_out_of_range_are_rejected_by_key(key, value):
    sensor = make_sensor(64, 48, extraction={key: value})
    with pytest.raises(ValueError, match=key):
        extract(np.zeros((1, 1, 48, 64), np.uint16), sensor)


@pytest.mark.parametrize("value", [0, 255])
def test_uniform_images_give_finite_values(value):
    peaks = extract(np.full((1, 1, 48, 64), value, np.uint16), make_sensor(64, 48))
    assert not accepted(peaks).any()
    for name in MEASURED:
        assert np.isfinite(getattr(peaks, name)).all()
