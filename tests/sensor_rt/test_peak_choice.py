"""Selection among several peaks, and extraction of all peaks."""

from __future__ import annotations

import numpy as np
import pytest
from stripe_images import accepted, images_of, make_sensor, stripe

from scancell.sensor import PEAK_FLAGS, extract

WIDTH, HEIGHT = 1280, 160
COLUMNS = np.arange(WIDTH)
ARC = 30.0 + 60.0 * (COLUMNS / WIDTH) ** 2
FLAT = np.full(WIDTH, 120.0)


def peaks_of(light, all_peaks=False, noise=True, **extraction):
    sensor = make_sensor(WIDTH, HEIGHT, extraction=extraction, render={"noise": noise})
    return extract(images_of(sensor, light, first=7), sensor, all_peaks=all_peaks)


def test_continuity_follows_stripe_past_brighter_blobs():
    """Reflections twice as bright as the stripe over about twenty columns in several places."""
    light = stripe(ARC, 1.3, 4000.0, HEIGHT)
    for start in (100, 430, 800, 1100):
        light += stripe(FLAT, 1.3, np.where((start < COLUMNS) & (start + 20 > COLUMNS), 8000.0, 0.0), HEIGHT)
    brightest = peaks_of(light)
    assert (np.abs(brightest.row - FLAT[brightest.column]) < 1.0).sum() > 70
    peaks = peaks_of(light, peak="continuity")
    assert len(peaks) == WIDTH
    assert np.abs(peaks.row - ARC[peaks.column]).max() < 0.2
    assert accepted(peaks).mean() > 0.98


def test_continuity_selects_brighter_stripe_and_follows_jumps():
    rows = np.where(COLUMNS < 500, 40.0, 90.0)
    light = stripe(rows, 1.3, 6000.0, HEIGHT) + stripe(FLAT, 1.3, 2000.0, HEIGHT)
    peaks = peaks_of(light, peak="continuity")
    assert np.abs(peaks.row - rows[peaks.column]).max() < 0.2


def test_continuity_bridges_dark_columns():
    """Directly after the gap the other stripe is the brighter one for several columns."""
    gap = (COLUMNS > 300) & (COLUMNS < 420)
    behind = (COLUMNS >= 420) & (COLUMNS < 450)
    other = np.where(gap, 0.0, np.where(behind, 8000.0, 2000.0))
    light = stripe(ARC, 1.3, np.where(gap, 0.0, 4000.0), HEIGHT) + stripe(FLAT, 1.3, other, HEIGHT)
    peaks = peaks_of(light, peak="continuity")
    np.testing.assert_array_equal(peaks.column, COLUMNS[~gap])
    assert np.abs(peaks.row - ARC[peaks.column]).max() < 0.2


@pytest.mark.parametrize("peak", ["brightest", "first", "last", "continuity"])
def test_all_peaks_leaves_chosen_peaks_unchanged(peak):
    light = stripe(ARC, 1.3, 4000.0, HEIGHT) + stripe(FLAT, 1.7, 2500.0, HEIGHT)
    every, chosen = peaks_of(light, True, peak=peak), peaks_of(light, peak=peak)
    assert len(every) == 2 * WIDTH
    assert (np.diff(every.column * 1000.0 + every.row) > 0).all()
    taken = (every.flags & PEAK_FLAGS["passed_over"]) == 0
    for name in ("column", "row", "amplitude", "width", "row_sigma", "asymmetry", "flags"):
        # Fits are iterated in batches until all of a batch have converged.
        np.testing.assert_allclose(getattr(every, name)[taken], getattr(chosen, name), rtol=1e-3, atol=1e-3)
    low = every.row > 100
    assert np.median(every.width[low]) == pytest.approx(1.7, rel=0.01)
    assert np.median(every.width[~low]) == pytest.approx(1.3, rel=0.01)
    assert np.median(every.amplitude[low]) == pytest.approx(2500 * 0.0225, rel=0.01)


def test_saturation_is_flagged_per_peak():
    light = stripe(ARC, 1.3, 4000.0, HEIGHT) + stripe(FLAT, 1.7, 30_000.0, HEIGHT)
    every = peaks_of(light, True)
    saturated = (every.flags & PEAK_FLAGS["saturated"]) != 0
    np.testing.assert_array_equal(saturated, every.row > 100)
