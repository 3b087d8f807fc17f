"""The judgement of stripe extraction on recorded images, by stripes whose noise and position are known."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.polynomial import Polynomial
from scipy.special import ndtr

from bench import real_stripes
from bench.real_stripes import Stripe, judge, pixel_noise, stripe_of

WIDTH, HEIGHT = 600, 400
NOISE = Polynomial([0.5, 0.03])  # DN²


def image(rng, height=3000.0, sigma=3.2, background=20.0, halo=0.0):
    """A slanted, saturated stripe with camera noise, and its rows."""
    rows = 150.0 + 0.2 * np.arange(WIDTH) + 2e-5 * np.arange(WIDTH) ** 2
    y = np.arange(HEIGHT)[:, None] - rows
    light = height * sigma * np.sqrt(2 * np.pi) * (ndtr((y + 0.5) / sigma) - ndtr((y - 0.5) / sigma))
    light = light + background + halo * np.exp(-0.5 * (y / 25.0) ** 2)
    return np.clip(np.rint(light + rng.normal(size=light.shape) * np.sqrt(NOISE(light))), 0, 255).astype(np.uint8), rows


def points(rows):
    return np.column_stack([np.arange(WIDTH), rows])[::6]


def test_pixel_noise_is_recovered_beside_edges():
    rng = np.random.default_rng(3)
    levels = np.repeat(np.linspace(10.0, 70.0, 16), 64)[:, None] * np.ones(1024)
    levels[:, ::90] += 60.0
    images = [np.rint(levels + rng.normal(size=levels.shape) * np.sqrt(NOISE(levels))).astype(np.uint8) for _ in "1234"]
    found = pixel_noise(images)
    for grey in (15.0, 40.0, 65.0):
        assert found(grey) == pytest.approx(NOISE(grey) + 1 / 12, rel=0.2)  # the least tenth, and rounding


def test_bound_of_gaussian_is_closed_form():
    """With even noise v, a Gaussian of height A has the information A² √π / (2 σ v) on its row."""
    amplitude, sigma, variance = 200.0, 6.0, 2.0
    distance = np.arange(-40, 41)[:, None] * np.ones(50)
    aligned = amplitude * np.exp(-0.5 * (distance / sigma) ** 2)
    expected = np.sqrt(2 * sigma * variance / (amplitude**2 * np.sqrt(np.pi)))
    bound = real_stripes._bound(aligned, Polynomial([variance, 0.0]))
    np.testing.assert_allclose(bound, expected, rtol=0.05)


def test_curve_of_stripe_is_found_without_detector():
    made, rows = image(np.random.default_rng(1))
    for turned in (False, True):
        seen = np.ascontiguousarray(np.rot90(made, -1)) if turned else made
        pixels = points(rows)
        if turned:
            pixels = np.column_stack([HEIGHT - 1 - pixels[:, 1], pixels[:, 0]])
        stripe = stripe_of(seen, pixels, NOISE)
        assert len(stripe.columns) > 590
        assert np.abs(stripe.curve - rows[stripe.columns]).max() < 0.05
        assert (stripe.kind == 0).mean() > 0.98


def test_columns_are_classified_by_halo_other_light_and_steps():
    rng = np.random.default_rng(2)
    made, rows = image(rng, halo=80.0)
    made[20:40, 400:500] = 255
    narrow = slice(200, 206)
    made[:, narrow] = image(rng, height=300.0)[0][:, narrow]
    kind = stripe_of(made, points(rows), NOISE).kind
    assert (kind[:150] == 1).all() and (kind[400:500] == 2).all() and (kind[200:206] == 3).all()
    assert (kind[220:390] == 1).mean() > 0.95


def test_judged_shares_and_deviations_are_those_of_the_points():
    rng = np.random.default_rng(4)
    columns = np.arange(5000)
    curve = np.full(5000, 50.0)
    stripe = Stripe(np.zeros((100, 5000), np.uint8), columns, curve, np.zeros(5000, int), np.ones(5000))
    slow = 0.4 * np.sin(columns / 150.0)
    rows = curve + slow + rng.normal(scale=0.05, size=5000)
    rows[::10] = np.nan
    rows[5::50] += 20.0
    one = judge([stripe], [rows], 0)
    assert one.found == pytest.approx(0.9)
    assert one.wrong == pytest.approx(0.02 / 0.9)
    assert one.noise == pytest.approx(0.05, rel=0.1)
    assert 0.25 < one.deviation < 0.5  # by the median of a sine of RMS 0.28 px
    assert np.isnan(judge([stripe], [np.full(5000, np.nan)], 0).deviation)


def test_table_states_detectors_beside_the_bound(monkeypatch):
    rng = np.random.default_rng(5)
    made = []
    for halo in (0.0, 60.0):
        seen, rows = image(rng, halo=halo)
        seen[20:40, 500:] = 255
        seen[:, 100:104] = seen[:, 100:104] // 3
        made.append(stripe_of(seen, points(rows), NOISE))
    found = {line.split("|")[1].strip(): line.split("|")[2:6] for line in real_stripes.table(made)}
    shares, deviation, noise = found["`gaussian`"][0].split(";")
    assert float(shares.split("%")[0]) > 97 and float(deviation) < 0.1
    assert 0.8 < float(noise.split("(")[1].rstrip(") ")) < 1.5
    assert float(found["Cramér-Rao bound"][0]) < 0.05
