"""Peak quality flags: clipped, split, merged or ending stripes are rejected; valid ones are kept."""

from __future__ import annotations

import numpy as np
import pytest
from stripe_images import accepted, images_of, make_sensor, stripe

from scancell.sensor import PEAK_FLAGS, extract

WIDTH, HEIGHT, FINE = 1280, 128, 32
TOLERABLE_PX = 0.37  # 60 µm at the far end of the range


def peaks_of(light, noise=True, frames=1, **extraction):
    sensor = make_sensor(WIDTH, HEIGHT, render={"noise": noise}, extraction=extraction)
    return extract(images_of(sensor, light, frames), sensor)


def flagged(peaks, name):
    return (peaks.flags & PEAK_FLAGS[name]) != 0


def masked_stripe(rows, sigma, peak, visible):
    """Electrons of a stripe that is visible only where ``visible(row, column)``, by supersampling."""
    fine = ((np.arange(HEIGHT * FINE) + 0.5) / FINE - 0.5)[:, None]
    light = peak * np.exp(-0.5 * ((fine - rows) / sigma) ** 2) * visible(fine, np.arange(WIDTH)[None])
    return light.reshape(HEIGHT, FINE, WIDTH).mean(axis=1)


@pytest.mark.parametrize("noise", [False, True])
@pytest.mark.parametrize("sigma", [0.8, 1.3, 2.5])
@pytest.mark.parametrize("peak", [1500.0, 9000.0])
def test_valid_stripes_are_kept(noise, sigma, peak):
    columns = np.arange(WIDTH)
    arc = 20.0 + 90.0 * (columns / WIDTH - 0.5) ** 2 * 4.0  # cylinder: slopes up to 0.28, constant curvature
    peaks = peaks_of(stripe(arc, sigma, peak, HEIGHT), noise, frames=3)
    assert accepted(peaks).mean() > 0.98
    assert len(peaks) == 3 * WIDTH


@pytest.mark.parametrize("noise", [False, True])
@pytest.mark.parametrize("sigma", [0.9, 1.3, 2.0])
@pytest.mark.parametrize("slope", [-0.2, 0.4, 2.0])
def test_stripe_cut_by_oblique_edge_is_rejected(noise, sigma, slope):
    """An oblique edge cuts the stripe: over several columns only part of its width is visible."""
    rows = 60.0 + 0.021 * np.arange(WIDTH)
    light = masked_stripe(rows, sigma, 8000.0, lambda y, x: y < rows + slope * (x - 640.0))
    peaks = peaks_of(light, noise)
    error = np.abs(peaks.row - rows[peaks.column])
    keep = accepted(peaks)
    assert np.isfinite(error).all()
    assert error.max() > TOLERABLE_PX  # without flags the error is large ...
    assert error[keep].max() < TOLERABLE_PX / 2  # ... with them it is small
    far_inside = np.abs(slope * (peaks.column - 640.0)) > 4 * sigma + 2
    assert keep[far_inside & (peaks.column > 3) & (peaks.column < WIDTH - 4)].mean() > 0.97


@pytest.mark.parametrize("noise", [False, True])
@pytest.mark.parametrize("shift", [0.7, 2.5, 9.0])
def test_stripe_split_over_two_levels_is_rejected(noise, shift):
    """An oblique step: the stripe beyond the edge is displaced by ``shift`` rows."""
    rows = np.full(WIDTH, 60.0) + 0.013 * np.arange(WIDTH)
    edge = 0.2 * (np.arange(WIDTH) - 640.0)
    light = masked_stripe(rows, 1.3, 8000.0, lambda y, x: y < rows + edge)
    light += masked_stripe(rows + shift, 1.3, 8000.0, lambda y, x: y > rows + shift + edge)
    peaks = peaks_of(light, noise)
    keep = accepted(peaks)
    level = np.minimum(np.abs(peaks.row - rows[peaks.column]), np.abs(peaks.row - rows[peaks.column] - shift))
    assert level[keep].max() < TOLERABLE_PX
    assert keep.mean() > 0.95


@pytest.mark.parametrize("jump", [1.0, 4.0, 30.0])
def test_run_ends_at_jump_between_columns_are_rejected(jump):
    rows = np.where(np.arange(WIDTH) < 640, 50.0, 50.0 + jump)
    light = stripe(rows, 1.3, 8000.0, HEIGHT)
    light[:, 640] = 0.5 * (light[:, 639] + light[:, 641])  # mixed column
    peaks = peaks_of(light)
    error = np.minimum(np.abs(peaks.row - 50.0), np.abs(peaks.row - 50.0 - jump))
    assert not accepted(peaks)[[639, 640, 641]].any()
    assert error[accepted(peaks)].max() < 0.1
    assert accepted(peaks).mean() > 0.98


def test_run_ends_and_short_runs_are_flagged():
    light = stripe(np.full(WIDTH, 64.2), 1.3, 8000.0, HEIGHT)
    light[:, 300:400] = 0.0
    light[:, 404:500] = 0.0  # leaves a run of four columns
    peaks = peaks_of(light, end_columns=2, min_run_columns=5)
    ends = [0, 1, 298, 299, 400, 401, 402, 403, 500, 501, WIDTH - 2, WIDTH - 1]
    np.testing.assert_array_equal(peaks.column[flagged(peaks, "end")], ends)


def test_reflectance_step_between_columns_is_flagged():
    reflectance = np.where(np.arange(WIDTH) < 640, 1.0, 0.4)
    peaks = peaks_of(stripe(np.full(WIDTH, 64.2), 1.3, 8000.0 * reflectance, HEIGHT))
    np.testing.assert_array_equal(peaks.column[flagged(peaks, "step")], [639, 640])
    np.testing.assert_array_equal(peaks.column[~accepted(peaks)], [0, 638, 639, 640, 641, WIDTH - 1])


@pytest.mark.parametrize(
    ("sigma", "peak", "option", "flag"),
    [
        (0.5, 8000.0, {"min_sigma_px": 0.7}, "narrow"),
        (4.0, 8000.0, {"max_sigma_px": 3.5}, "wide"),
        (1.3, 700.0, {"min_amplitude_dn": 20.0}, "weak"),
    ],
)
def test_shape_limits_set_flags(sigma, peak, option, flag):
    light = stripe(np.full(WIDTH, 64.2), sigma, peak, HEIGHT)
    assert flagged(peaks_of(light, **option), flag).mean() > 0.99
    assert not flagged(peaks_of(light), flag).any()


def test_two_touching_stripes_are_flagged():
    light = stripe(np.full(WIDTH, 60.0), 1.3, 8000.0, HEIGHT) + stripe(np.full(WIDTH, 64.0), 1.3, 5000.0, HEIGHT)
    assert not accepted(peaks_of(light)).any()
