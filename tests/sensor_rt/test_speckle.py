"""Speckle: contrast and grain size compared with theory, motion, repeatability, centroid noise."""

from __future__ import annotations

import json
from copy import deepcopy
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike
from scenes import Array, moving, one_plane, pose, still, stripe_centres
from scipy.special import j1
from stripe_images import make_sensor

from scancell.sensor import PEAK_REJECTED, Exposures, Scene, Sensor, expected_electrons, extract, render, scan

WAVELENGTH, PITCH = 660e-9, 5e-6
Z = 0.12
EVEN = {"sheet_sigma": 8e-3, "divergence": 0.0}  # a sheet so thick that neighbouring pixels receive the same light


def covariance(grains: ArrayLike) -> Array:
    """Autocovariance of fully developed speckle for a circular aperture; distances in wavelength times f-number."""
    v = np.pi * np.abs(np.asarray(grains, float)) + 1e-9
    return np.asarray((2 * j1(v) / v) ** 2)


def pixel_covariance(grain_px: float, shift: float = 0.0, travel: float = 0.0) -> float:
    """Covariance of two pixels `shift` rows apart, for a pattern that moves along the rows."""
    step = np.linspace(-1, 1, 161)
    box = np.maximum(0, 1 - np.abs(step))  # distribution of distances within a pixel
    box /= box.sum()
    way, share = travel * step, box if travel > 0.0 else np.full(step.size, 1 / step.size)
    along = step[:, None] + shift
    total = 0.0
    for offset, weight in zip(way, share, strict=True):
        distance = np.hypot(along + offset, step[None, :])
        total += weight * float((np.outer(box, box) * covariance(distance / grain_px)).sum())
    return total


def sensor(contrast: float, f_number: float = 22.0, seed: int = 1, samples: int = 16, **overrides: Any) -> Sensor:
    render = {"noise": False, "seed": seed, "samples_per_pixel": samples} | overrides.pop("render", {})
    camera = {"f_number": f_number} | overrides.pop("camera", {})
    size = overrides.pop("size", (320, 256))
    laser = EVEN | overrides.pop("laser", {})
    speckle = {"contrast": contrast}
    return make_sensor(*size, cameras=2, camera=camera, render=render, laser=laser, speckle=speckle, **overrides)


def plane() -> Scene:
    scene = Scene()
    scene.add_plane("plane", np.eye(4), [0.5, 0.5], 0.5)
    return scene


@cache
def without_speckle(options: str) -> Array:
    """Electrons (cameras, h, w); constant for planes that lie and move in one plane."""
    images = expected_electrons(plane(), sensor(0.0, **json.loads(options)), still(pose((0, 0, Z))))
    return images[0].astype(float)


def speckle(exposures: Exposures, contrast: float = 1.0, **options: Any) -> Array:
    """Speckle factor (frames, cameras, h, w), NaN in dark pixels; the plane is at z = Z."""
    without = without_speckle(json.dumps(options))
    with_speckle = expected_electrons(plane(), sensor(contrast, **options), exposures).astype(float)
    return np.where(without > 0.02 * without.max(), with_speckle / np.maximum(without, 1e-9), np.nan)


def grain_px(f_number: float) -> float:
    return WAVELENGTH * f_number / PITCH


def places(count: int, seed: int = 0) -> list[Array]:
    """Poses of a flat surface that each show different parts of it."""
    rng = np.random.default_rng(seed)
    return [pose((*rng.uniform(-0.1, 0.1, 2), Z), (0, 0, rng.uniform(-3, 3))) for _ in range(count)]


def test_grain_size_is_wavelength_times_f_number() -> None:
    """Autocorrelation along and across the stripe, and its width at half maximum."""
    grain = grain_px(44.0)
    fields = np.concatenate([speckle(still(place), f_number=44.0) for place in places(6, 1)]).reshape(-1, 256, 320) - 1
    shifts = np.arange(9)
    expected = np.array([pixel_covariance(grain, shift) for shift in shifts])
    along = np.array([np.nanmean(fields[:, :, : 320 - s] * fields[:, :, s:]) for s in shifts])
    across = np.array([np.nanmean(fields[:, : 256 - s] * fields[:, s:]) for s in shifts])
    for measured in (along, across):
        np.testing.assert_allclose(measured / measured[0], expected / expected[0], atol=0.05)
        half = np.interp(-0.5, -measured / measured[0], shifts)
        assert half == pytest.approx(np.interp(-0.5, -expected / expected[0], shifts), rel=0.03)


@pytest.mark.parametrize(("travel_px", "samples"), [(3.0, 64), (12.0, 64), (40.0, 256)])
def test_motion_averages_speckle(travel_px: float, samples: int) -> None:
    """Contrast of the average over the travel; in the limit 1 over the root of the number of grains passed."""
    grain = grain_px(22.0)
    metres_per_px = np.hypot(0.06, Z) / (256 / (2 * np.tan(np.radians(9.34))))
    length = 2 * np.trapezoid(covariance(np.linspace(0, 50, 5001)), np.linspace(0, 50, 5001))  # grains per grain
    strip = {"size": (320, 48), "camera": {"focal_px": 256 / (2 * np.tan(np.radians(9.34)))}}
    way = np.array([0, travel_px * metres_per_px, 0])
    fields = []
    for place in places(3, 2):
        ends = [pose(s * way) @ place for s in (-0.5, 0.5)]
        exposures = moving([[end] for end in ends], [np.eye(4)] * 2)
        fields.append(speckle(exposures, samples=samples, **deepcopy(strip)))
    measured = np.nanstd(fields)
    assert measured == pytest.approx(np.sqrt(pixel_covariance(grain, travel=travel_px)), rel=0.05)
    if travel_px > 10 * grain:
        assert measured == pytest.approx((travel_px / (length * grain)) ** -0.5, rel=0.08)


def test_pattern_is_fixed_to_surface() -> None:
    base = places(1, 3)[0]
    metres_per_px = Z / np.cos(np.radians(29.3)) / (256 / (2 * np.tan(np.radians(9.34))))
    other = speckle(still(pose((0, -7 * metres_per_px, 0)) @ base))[0, 0] - 1
    first = speckle(still(base, count=3))[:, 0] - 1
    np.testing.assert_array_equal(first[0], first[2])
    rows = slice(118, 138)
    reach = [
        np.nanmean(first[0][rows, 20:300] * other[rows, 20 + s : 300 + s]) / np.nanvar(first[0][rows])
        for s in range(-10, 11)
    ]
    assert np.argmax(reach) == 17
    assert reach[17] > 0.6
    assert abs(np.delete(reach, np.arange(14, 21))).max() < 0.15
    elsewhere = speckle(still(places(1, 4)[0]))[0, 0] - 1
    assert abs(np.nanmean(first[0] * elsewhere)) < 0.05
    assert abs(np.nanmean(np.multiply(*(speckle(still(base))[0] - 1)))) < 0.05  # independent between the cameras


def test_speckle_does_not_depend_on_threads_and_is_off_by_default() -> None:
    ends = [[place] for place in (pose((0, 0, Z)), pose((0, 3e-5, Z)))]
    exposures = moving(ends, [np.eye(4)] * 2, count=4)
    one, many = (expected_electrons(plane(), sensor(0.7), exposures, threads=t) for t in (1, 3))
    np.testing.assert_array_equal(one, many)
    assert np.any(one != expected_electrons(plane(), sensor(0.7, seed=2), exposures))


@pytest.mark.parametrize("lens", [{}, {"psf_sigma_px": 0.6}, {"focus": 0.18}], ids=str)
def test_path_tracing_shows_same_speckle(lens: dict[str, float]) -> None:
    """Blur by the lens spreads the light, not the grains."""
    images = []
    for mode in ("fast", "path"):
        render = {"noise": False, "mode": mode, "samples_per_pixel": 256 if lens else 16}
        options = {"camera": {"f_number": 44.0} | lens, "laser": {"sheet_sigma": 1.5e-3} if lens else {}}
        tracing = make_sensor(160, 128, cameras=2, render=render, speckle={"contrast": 1.0}, **options)
        images.append(one_plane(tracing, pose((0, 0, Z))))
    np.testing.assert_allclose(images[0], images[1], rtol=1e-2, atol=3e-2 * images[0].max())


def summed_patterns(contrast: float, rng: np.random.Generator, per_grain: int = 8, size: int = 1024) -> Array:
    """Intensity (size, size) of the mean of 1 / contrast² independent speckle patterns, by Fourier optics."""
    frequency = np.fft.fftfreq(size) * per_grain  # per grain; the aperture has diameter 1
    aperture = frequency[:, None] ** 2 + frequency**2 <= 0.25
    phases = rng.random((round(1 / contrast**2), size, size))
    passing = np.flatnonzero(aperture.any(axis=1))  # the transforms of the other rows are zero
    waves = np.zeros(phases.shape, complex)
    waves[:, passing] = np.fft.ifft(aperture[passing] * np.exp(2j * np.pi * phases[:, passing]), axis=-1)
    intensity = (np.abs(np.fft.ifft(waves, axis=-2)) ** 2).mean(axis=0)
    return np.asarray(intensity / intensity.mean())


def centre_noise(width: float, contrast: float, per_grain: int = 8) -> float:
    """Simulated standard deviation, in grains, of the centre of gravity of stripes of sigma `width` grains."""
    rng = np.random.default_rng(5)
    across = (np.arange(12 * per_grain * width) - 6 * per_grain * width + 0.5) / per_grain
    profile = np.exp(-0.5 * (across / width) ** 2)[:, None]
    centres = []
    for _ in range(12):
        pattern = summed_patterns(contrast, rng, per_grain)
        for first in range(0, len(pattern) - len(across), len(across) // 2):
            light = pattern[first : first + len(across)] * profile
            centres.append((light * across[:, None]).sum(axis=0) / light.sum(axis=0))
    return float(np.std(centres))


@pytest.mark.parametrize("contrast", [1.0, 0.7, 0.5, 0.3])
def test_lower_contrast_is_mean_of_more_patterns(contrast: float) -> None:
    """The mean of n fully developed patterns is gamma distributed: contrast 1 / sqrt(n), skewness 2 / sqrt(n)."""
    fields = np.concatenate([speckle(still(place), contrast, f_number=44.0) for place in places(12, 5)])
    deviation = (fields - np.nanmean(fields)) / np.nanstd(fields)
    resolved = np.sqrt(pixel_covariance(grain_px(44.0)))
    assert np.nanstd(fields) == pytest.approx(contrast * resolved, rel=0.03)
    assert np.nanmean(fields) == pytest.approx(1.0, abs=0.01)
    print(contrast, np.nanmean(deviation**3) / (2 * contrast))
    assert np.nanmean(deviation**3) == pytest.approx(2 * contrast, rel=0.15)


def test_stripe_centre_noise_matches_theory() -> None:
    """C lambda / (2 pi sin u), of a stripe whose sigma is one grain.

    Dorsch, Häusler & Herrmann ("Laser triangulation: fundamental uncertainty in distance measurement", Appl. Opt. 33,
    1994). lambda = 660 nm, sin u = 0.02: 5.3 um for C = 1. It is proportional to the root of the stripe width:
    the variance of the first moment is the double integral of the stripe profile and the covariance. The centre
    of gravity divides it by the total light, which fluctuates as well; a simulation gives this effect.
    """
    z = 0.06 / np.tan(np.radians(29.3))  # intersection of the camera axes with the sheet
    distance, sine, grain = np.hypot(0.06, z), 0.02, 4.0
    f_number = grain * PITCH / WAVELENGTH
    focal_px = 2 * distance * np.tan(np.arcsin(sine)) * f_number / PITCH
    metres_per_px = distance / focal_px
    dorsch = WAVELENGTH / (2 * np.pi * sine)
    for width, contrast in ((1.0, 1.0), (1.0, 0.5), (0.8, 1.0), (0.8, 0.5), (2.0, 1.0)):
        sigma = width * grain * metres_per_px / np.cos(np.radians(29.3))
        centres, moments = [], []
        for seed in range(6):
            noisy = sensor(
                contrast,
                f_number,
                seed,
                size=(1280, 96),
                camera={"focal_px": focal_px, "cy_px": 47.5},
                laser={"sheet_sigma": sigma, "waist_z": z},
                render={"rays_across_fan": 10_240},
            )
            images = one_plane(noisy, pose((0, 0, z)))
            for image in images:
                centre, light = stripe_centres(image)
                centres.append(centre)
                moments.append((centre - np.average(centre, weights=light)) * light / light.mean())
        x = np.linspace(-6, 6, 601) * width
        profile = np.exp(-0.5 * (x / width) ** 2)
        profile /= profile.sum()
        integral = (np.outer(x * profile, x * profile) * covariance(x[:, None] - x)).sum()
        assert np.std(moments) == pytest.approx(contrast * np.sqrt(integral) * grain, rel=0.06)
        simulated = centre_noise(width, contrast)
        print(
            width, contrast, np.std(centres) * metres_per_px / (contrast * dorsch), np.std(centres) / grain / simulated
        )
        assert np.std(centres) == pytest.approx(simulated * grain, rel=0.06)
        if width <= 1.0:
            assert np.std(centres) * metres_per_px == pytest.approx(contrast * dorsch, rel=0.15)


@pytest.mark.parametrize("z", [0.08, 0.12, 0.16])
def test_speckled_stripe_is_measured_with_stated_sigma(z: float) -> None:
    """Nearly all points are kept; their row noise is that of a centre of gravity and matches the stated sigma.

    The first moment of a stripe s has the variance sum s_i s_j x_i x_j cov(i - j) over the square of the sum of s.
    """
    cameras: dict[str, Any] = {
        "detector": {"dsnu_e": 1.0, "prnu": 0.005},
        "cameras": 2,
        "laser": {"power": 2e-3, "fan_half_angle": np.radians(16.0)},
    }
    places = still(pose((0.013, -0.021, z)))
    grainy = make_sensor(speckle={"contrast": 1.0}, **deepcopy(cameras))
    clean = make_sensor(**deepcopy(cameras))
    expected_points = len(scan(plane(), clean, places).profiles)
    result = scan(plane(), grainy, places, keep_images=True)
    points = result.profiles
    assert len(points) >= 0.95 * expected_points
    error = points.points_in_sensor[:, 2] - z
    assert error.std() == pytest.approx(np.sqrt(np.mean(points.sigma.astype(float) ** 2)), rel=0.1)
    assert abs(error.mean()) < 4 * error.std() / np.sqrt(len(error) / 3)  # a grain covers three columns

    width = float(np.median(extract(render(plane(), clean, places), clean).width))
    rows = np.arange(-8, 9)
    light = np.exp(-0.5 * (rows / width) ** 2)
    grain = grain_px(11.0)
    by_lag = np.array([pixel_covariance(grain, lag) for lag in range(17)])
    moment = rows * light / light.sum()
    theory = np.sqrt((np.outer(moment, moment) * by_lag[abs(rows[:, None] - rows)]).sum())
    assert result.images is not None
    peaks = extract(result.images, grainy)
    sound = (np.asarray(peaks.flags) & PEAK_REJECTED) == 0
    row = np.asarray(peaks.row)[sound]
    for camera in range(2):
        of_camera = row[np.asarray(peaks.camera)[sound] == camera]
        assert (of_camera - of_camera.mean()).std() == pytest.approx(theory, rel=0.15)
