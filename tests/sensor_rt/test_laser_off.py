"""Background subtraction: ambient light is removed; its noise remains and is included in the stated uncertainty."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import Array, cluttered, moving, plane, pose, still
from stripe_images import accepted, make_sensor

from scancell.sensor import (
    PEAK_FLAGS,
    Exposures,
    Peaks,
    Scene,
    Sensor,
    extract,
    render,
    scan,
    triangulate,
)

Images = NDArray[np.uint16]
DEEP = {"bit_depth": 12, "gain_dn_per_e": 0.36, "black_level_dn": 64.0}
Z = 0.12


def sensor(noise: bool = True, off: bool = True, **overrides: Any) -> Sensor:
    detector = {"laser_off_frame": off} | overrides.pop("detector", {})
    options = {"laser": {"power": 1e-3}, "range": {"near": 0.06, "far": 0.2}, "render": {"noise": noise}}
    return make_sensor(cameras=2, detector=detector, **(options | overrides))


def beside_a_rod(lamp_power: float) -> tuple[Scene, Exposures]:
    """Plane under a lamp (power in W); the penumbra of a rod crosses the stripe at an angle."""
    scene = plane()
    scene.add_cylinder("rod", pose(angles=(0, np.pi / 2, 0)), 0.0005, 0.2, 0.3)
    places = [pose((0.0, 0.0, Z), (0.1, 0.0, 0.0)), pose((0.02, 0.01, Z - 0.03), (0.0, 0.0, 0.5))]
    if lamp_power > 0.0:
        scene.add_light("lamp", "disc", np.eye(4), [0.004, 0.004], lamp_power, in_band=1.0)
        places.append(pose((0.06, 0.03, Z - 0.06), (0.0, -0.6, 0.4)))
    return scene, still(*places)


def with_background(scene: Scene, sensor: Sensor, places: Exposures) -> tuple[Images, Images]:
    """Images with the laser on, and the frames with the laser off to subtract."""
    return render(scene, sensor, places), render(scene, sensor, places, laser_on=False)


def row_errors(peaks: Peaks, truth: Peaks) -> tuple[Array, Array]:
    """Rows (n,) of accepted peaks minus those of accepted peaks of one other exposure, and their stated sigma."""
    true_rows = np.full((2, 1280), np.nan)
    sound = accepted(truth)
    true_rows[truth.camera[sound], truth.column[sound]] = truth.row[sound]
    error = peaks.row - true_rows[peaks.camera, peaks.column]
    compared = accepted(peaks) & np.isfinite(error)
    return error[compared], peaks.row_sigma[compared]


def test_background_subtraction_removes_lamp_gradient() -> None:
    quiet = sensor(noise=False, detector=DEEP)
    scene, places = beside_a_rod(2.0)
    lit, background = with_background(scene, quiet, places)
    assert 500 < background.max() < 3000  # DN: as strong as the stripe
    dark_scene, dark_places = beside_a_rod(0.0)
    in_the_dark = extract(render(dark_scene, quiet, dark_places), quiet)
    off, kept = {}, {}
    for name, peaks in (("with", extract(lit, quiet, background=background)), ("without", extract(lit, quiet))):
        off[name] = np.abs(row_errors(peaks, in_the_dark)[0])
        kept[name] = len(off[name]) / accepted(in_the_dark).sum()
    print({name: (kept[name], np.sqrt(np.mean(off[name] ** 2)), off[name].max()) for name in off})
    assert kept["with"] > 0.99
    assert np.sqrt(np.mean(off["with"] ** 2)) < 0.003
    assert np.sqrt(np.mean(off["without"] ** 2)) > 3 * np.sqrt(np.mean(off["with"] ** 2))


@pytest.mark.parametrize("irradiance", [0.0, 2.0, 50.0])
@pytest.mark.parametrize("detector", ["gaussian", "centre_of_gravity", "steger"])
def test_row_sigma_includes_noise_of_both_images(irradiance: float, detector: str) -> None:
    real = sensor(
        ambient={"irradiance": irradiance}, extraction={"detector": detector}, detector=DEEP | {"dsnu_e": 20.0}
    )
    tilted = pose((0.0, 0.0, Z), (0.1, 0.0, 0.0))
    places = still(tilted, count=6)
    exact = sensor(noise=False, off=False, extraction={"detector": detector}, detector=DEEP)
    lit, background = with_background(plane(), real, places)
    error, sigma = row_errors(
        extract(lit, real, background=background), extract(render(plane(), exact, still(tilted)), exact)
    )
    z = error / sigma
    assert len(z) > 5000
    assert abs(z.mean()) < 0.1
    assert z.std() == pytest.approx(1.0, abs=0.12)


def test_background_light_adds_shot_noise_twice() -> None:
    """Row noise of a stripe under uniform light relative to that in the dark, propagated over the stripe's pixels."""
    sigmas = {}
    for irradiance in (0.0, 100.0):
        real = sensor(ambient={"irradiance": irradiance}, detector=DEEP)
        places = still(pose((0.0, 0.0, Z)))
        lit, background = with_background(plane(), real, places)
        peaks = extract(lit, real, background=background)
        sigmas[irradiance] = float(np.median(peaks.row_sigma[accepted(peaks) & (peaks.camera == 0)]))
        light_e = float(np.median(background) - DEEP["black_level_dn"]) / DEEP["gain_dn_per_e"]
    rows = np.arange(-12, 13)
    amplitude_e, width = float(np.median(peaks.amplitude)) / DEEP["gain_dn_per_e"], float(np.median(peaks.width))
    stripe = amplitude_e * np.exp(-0.5 * (rows / width) ** 2)
    slope = stripe * rows / width**2

    def bound(extra: float) -> float:
        return float(np.sqrt(1 / np.sum(slope**2 / (stripe + 2 * 25.0 + extra))))

    assert light_e > 1000
    assert sigmas[100.0] / sigmas[0.0] == pytest.approx(bound(2 * light_e) / bound(0.0), rel=0.1)


def test_background_frame_follows_laser_frame() -> None:
    """Motion continues: the background frame equals that of a dark laser with the subsequent poses."""
    scene, first = cluttered()
    scene.add_light("lamp", "rectangle", pose((0, 0, -0.1)), [0.05, 0.05], 5.0, in_band=1.0)
    step = pose((2e-4, -6e-4, 3e-4))
    steps = [[*(np.linalg.matrix_power(step, k) @ p for p in first), pose()] for k in range(3)]
    narrow = {"width_px": 320, "cx_px": 159.5}
    quiet, dark = sensor(noise=False, camera=narrow), sensor(noise=False, camera=narrow, laser={"power": 0.0})
    after = render(scene, quiet, moving(steps[:2], [np.eye(4)] * 2), laser_on=False)
    expected = render(scene, dark, moving(steps[1:], [np.eye(4)] * 2))
    assert after.max() > 20
    assert (np.abs(after.astype(int) - expected.astype(int)) > 1).mean() < 1e-3
    before = render(scene, dark, moving(steps[:2], [np.eye(4)] * 2))
    assert (np.abs(after.astype(int) - before.astype(int)) > 1).mean() > 1e-3


def test_background_frame_has_same_fixed_pattern_and_new_noise() -> None:
    noisy = sensor(detector=DEEP | {"dsnu_e": 50.0}, laser={"power": 0.0}, ambient={"irradiance": 5.0})
    places = still(pose((0.0, 0.0, Z)))
    a, b = (render(plane(), noisy, places, laser_on=on)[0].astype(float) for on in (True, False))
    light_e = (a.mean() - DEEP["black_level_dn"]) / DEEP["gain_dn_per_e"]
    expected = DEEP["gain_dn_per_e"] * np.sqrt(2 * (light_e + 25.0))
    assert (a - b).std() == pytest.approx(expected, rel=0.05)
    assert a.std() > DEEP["gain_dn_per_e"] * 45.0


def test_subtraction_without_ambient_light_only_adds_noise() -> None:
    places = still(pose((0.0, 0.0, Z), (0.2, 0.1, 0.0)))
    with_off, alone = (scan(plane(), sensor(False, off, detector=DEEP), places).profiles for off in (True, False))
    assert len(with_off) == len(alone) > 2000
    np.testing.assert_allclose(with_off.points_in_sensor, alone.points_in_sensor, atol=1e-7)


@pytest.mark.parametrize("bits", [8, 16])
def test_scan_equals_extraction_from_both_images(bits: int) -> None:
    depth = {"bit_depth": bits, "gain_dn_per_e": 0.0225 * 2.0 ** (bits - 8)}
    real = sensor(ambient={"irradiance": 3.0}, detector=depth, laser={"power": 3e-3})
    result = scan(plane(), real, still(pose((0.0, 0.0, Z), (0.2, 0.1, 0.0)), count=2), keep_images=True)
    assert result.images is not None and result.background is not None
    apart = triangulate(extract(result.images, real, background=result.background), real)
    assert len(apart) > 3000
    np.testing.assert_array_equal(apart.points_in_sensor, result.profiles.points_in_sensor)
    np.testing.assert_array_equal(apart.sigma, result.profiles.sigma)


def test_saturated_pixels_are_detected_after_subtraction() -> None:
    """Stripe far above the full well: measured by its flanks only, as without background subtraction."""
    quiet = sensor(noise=False, detector=DEEP | {"full_well_e": 6000.0}, laser={"power": 4e-3})
    places = still(pose((0.0, 0.0, Z), (0.1, 0.0, 0.0)))
    lit, background = with_background(plane(), quiet, places)
    alone, both = extract(lit, quiet), extract(lit, quiet, background=background)
    np.testing.assert_array_equal(alone.flags & 1, both.flags & 1)
    assert (both.flags & 1).mean() > 0.9
    np.testing.assert_allclose(both.row, alone.row, atol=0.01)


@pytest.mark.parametrize("bits", [8, 12, 15, 16])
@pytest.mark.parametrize("black", [0.0, 0.016])
def test_whole_range_of_digital_numbers_is_measured(bits: int, black: float) -> None:
    """A stripe just below saturation, in front of nothing: the difference is as good as the image."""
    detector = {"bit_depth": bits, "gain_dn_per_e": 2.0**bits / 12_000, "black_level_dn": round(black * 2**bits)}
    quiet = sensor(noise=False, detector=detector, laser={"power": 5.4e-3})
    places = still(pose((0.0, 0.0, Z), (0.1, 0.0, 0.0)))
    lit, background = with_background(plane(), quiet, places)
    assert 0.88 < lit.max() / 2**bits < 0.95
    alone, both = extract(lit, quiet), extract(lit, quiet, background=background)
    assert len(both) == len(alone) > 2000
    assert not ((alone.flags | both.flags) & PEAK_FLAGS["saturated"]).any()
    np.testing.assert_allclose(both.row, alone.row, atol=2e-4)
    np.testing.assert_allclose(both.amplitude, alone.amplitude, rtol=1e-4)


@pytest.mark.parametrize("irradiance", [0.0, 30.0])
def test_sigma_of_differences_does_not_depend_on_bit_depth(irradiance: float) -> None:
    stated, scores = [], []
    for bits in (14, 16):
        detector = {"bit_depth": bits, "gain_dn_per_e": 2.0**bits / 12_000, "black_level_dn": 0.016 * 2**bits}
        options = {"detector": detector, "ambient": {"irradiance": irradiance}, "laser": {"power": 1.5e-3}}
        where = pose((0.0, 0.0, Z), (0.1, 0.0, 0.0))
        found = scan(plane(), sensor(**options), still(where, count=4)).profiles
        stated.append(float(found.sigma.mean()))
        normal = where[:3, 2]
        along = np.sqrt(np.einsum("i,nij,j->n", normal, found.covariance, normal))
        scores.append(float((((found.points_in_sensor - where[:3, 3]) @ normal) / along).std()))
    assert stated[1] == pytest.approx(stated[0], rel=0.01)
    assert scores == pytest.approx([1.0, 1.0], abs=0.05)


def test_mismatched_background_is_rejected() -> None:
    lit = np.zeros((2, 2, 1024, 1280), np.uint16)
    with pytest.raises(ValueError, match="background: expected 2 frames"):
        extract(lit, sensor(), background=lit[:1])
    with pytest.raises(ValueError, match="background: expected images of 2 cameras"):
        extract(lit, sensor(), background=lit[:, :1])
