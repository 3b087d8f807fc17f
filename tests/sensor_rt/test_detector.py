"""Detector noise compared with the statistics of EMVA 1288."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from scenes import one_plane, plane, pose, still
from scipy import stats
from stripe_images import make_sensor

from scancell.sensor import expose, extract, render

QUIET = {"read_noise_e": 0.0, "black_level_dn": 0.0, "gain_dn_per_e": 1.0, "full_well_e": 1e5, "bit_depth": 12}


def flat(sensor, electrons, frames=1, index=0, duration=5e-4, threads=1):
    """Images of uniformly lit frames, (frames, cameras, height, width)."""
    camera = sensor.cameras[0]
    light = np.full((frames, len(sensor.cameras), camera.height_px, camera.width_px), electrons, np.float32)
    return expose(light, sensor, np.full(frames, duration), np.arange(index, index + frames), threads)


def chi_square_p(values, cdf, lowest, highest):
    """P-value of integer samples against a cumulative distribution; classes with few expected counts are pooled."""
    levels = np.arange(lowest, highest + 1)
    probability = np.diff(np.concatenate([[0.0], cdf(levels[:-1]), [1.0]]))
    counts = np.array([(values == level).sum() for level in levels])
    expected = probability * values.size
    order = np.argsort(expected)
    pooled = np.searchsorted(np.cumsum(expected[order]), 10.0)
    rare, common = order[: pooled + 1], order[pooled + 1 :]
    observed = np.append(counts[common], counts[rare].sum())
    wanted = np.append(expected[common], expected[rare].sum())
    return stats.chisquare(observed, wanted * observed.sum() / wanted.sum()).pvalue


def test_noise_free_image_equals_rounded_clipped_mean():
    sensor = make_sensor(64, 48, detector={"dark_current_e_per_s": 2e4}, render={"noise": False})
    light = np.random.default_rng(1).uniform(0.0, 15_000.0, (1, 1, 48, 64)).astype(np.float32)
    light[0, 0, :10] = 0.0
    expected = np.minimum(4.0 + 0.0225 * np.minimum(light.astype(float) + 2e4 * 5e-4, 11_000.0), 255.0)
    image = expose(light, sensor, np.array([5e-4]), np.array([0]))
    np.testing.assert_array_equal(image, np.floor(expected + 0.5))


@pytest.mark.parametrize("mean", [0.2, 1.0, 6.5, 15.9, 16.1, 40.0, 250.0, 3000.0])
def test_shot_noise_is_poisson(mean):
    sensor = make_sensor(640, 512, detector=QUIET)
    image = flat(sensor, mean)
    spread = 8 * np.sqrt(mean) + 8
    p = chi_square_p(image, stats.poisson(np.float32(mean)).cdf, max(0, int(mean - spread)), int(mean + spread))
    assert p > 1e-3
    deviation = (image - mean) / np.sqrt(mean)
    assert stats.skew(deviation.ravel()) == pytest.approx(1 / np.sqrt(mean), abs=5 * np.sqrt(6 / image.size))


@pytest.mark.parametrize(("dark", "read"), [(0.0, 5.0), (0.3, 5.0), (3.0, 1.0), (40.0, 2.5), (2.0, 0.0)])
def test_dark_pixels_follow_poisson_plus_normal(dark, read):
    black = 100.0
    detector = QUIET | {"read_noise_e": read, "black_level_dn": black, "dark_current_e_per_s": dark / 5e-4}
    image = flat(make_sensor(640, 512, detector=detector), 0.0)
    charge = np.arange(0, int(dark + 12 * np.sqrt(dark)) + 12)
    weight = stats.poisson(dark).pmf(charge)

    def cdf(level):
        return (weight * stats.norm.cdf((level[:, None] + 0.5 - black - charge) / max(read, 1e-9))).sum(axis=1)

    reach = 7 * np.sqrt(dark + read**2) + 8
    assert chi_square_p(image, cdf, int(black - reach), int(black + dark + reach)) > 1e-3


@pytest.mark.parametrize(("gain", "dsnu"), [(0.04, 0.0), (0.03, 0.0), (0.025, 1.0)])
def test_coarsely_quantised_dark_pixels_follow_the_same_distribution(gain, dsnu):
    """Only 1 %, 0.1 % and 0.01 % of the pixels have another digital number than the black level."""
    detector = QUIET | {"read_noise_e": 5.0, "black_level_dn": 10.0, "gain_dn_per_e": gain, "dsnu_e": dsnu}
    image = flat(make_sensor(640, 512, detector=detector), 0.0, frames=8)
    assert (
        chi_square_p(image, lambda level: stats.norm.cdf((level + 0.5 - 10.0) / (gain * np.hypot(5.0, dsnu))), 8, 12)
        > 1e-3
    )
    other = (image != 10).astype(float)
    columns, rows = other.sum((0, 1, 2)), other.sum((0, 1, 3))
    for counts in (columns, rows):  # spread evenly over the image
        assert stats.chisquare(counts.reshape(64, -1).sum(1)).pvalue > 1e-3


def test_lit_pixels_without_light_match_dark_pixels():
    """Dark and lit pixels use different code; in the limit of no light both have the same mean and variance."""
    sensor = make_sensor(640, 512, detector=QUIET | {"read_noise_e": 5.0, "black_level_dn": 100.0})
    dark, lit = flat(sensor, 0.0).astype(float), flat(sensor, 1e-6).astype(float)
    assert dark.mean() == pytest.approx(lit.mean(), abs=5 * 5.0 * np.sqrt(2 / dark.size))
    assert dark.var() == pytest.approx(lit.var(), rel=5 * np.sqrt(4 / dark.size))


def test_prnu_and_dsnu_have_given_size_and_are_fixed():
    sensor = make_sensor(
        128,
        128,
        cameras=2,
        detector=QUIET | {"black_level_dn": 100.0, "dsnu_e": 20.0, "prnu": 0.02, "read_noise_e": 2.0},
    )
    dark = flat(sensor, 0.0, frames=40).astype(float).mean(axis=0)
    light = flat(sensor, 3000.0, frames=40, index=100).astype(float).mean(axis=0)
    assert dark[0].std() == pytest.approx(20.0, rel=0.05)
    assert ((light - dark) / 3000.0)[0].std() == pytest.approx(np.hypot(0.02, 1 / np.sqrt(3000 * 40)), rel=0.05)
    assert np.corrcoef(dark[0].ravel(), light[0].ravel())[0, 1] > 0.2  # the offset is part of the lit image too
    assert abs(np.corrcoef(dark[0].ravel(), dark[1].ravel())[0, 1]) < 5 / 128


def test_output_depends_only_on_seed_and_frame_id():
    sensor = make_sensor(320, 256, cameras=2, detector={"dsnu_e": 2.0, "prnu": 0.01, "dark_current_e_per_s": 2e3})
    light = np.zeros((6, 2, 256, 320), np.float32)
    light[:, :, 100:110] = 4000.0
    duration, index = np.full(6, 5e-4), np.arange(6)
    images = expose(light, sensor, duration, index, 1)
    np.testing.assert_array_equal(images, expose(light, sensor, duration, index, 2))
    np.testing.assert_array_equal(images[::-1], expose(light, sensor, duration, index[::-1].copy(), 2))
    other = make_sensor(320, 256, cameras=2, render={"seed": 2}, detector={"dsnu_e": 2.0, "prnu": 0.01})
    assert (images != expose(light, other, duration, index)).any()


def test_noise_is_uncorrelated_between_pixels_frames_and_cameras():
    sensor = make_sensor(512, 512, cameras=2, detector=QUIET | {"read_noise_e": 10.0, "black_level_dn": 100.0})
    noise = flat(sensor, 0.0, frames=2).astype(float) - 100.0
    noise /= noise.std()
    limit = 4.5 / 512
    a = noise[0, 0]
    for shift in [(0, 1), (1, 0), (1, 1), (0, 16), (7, 3)]:
        assert abs((a * np.roll(a, shift, (0, 1))).mean()) < limit
    assert abs((a * noise[1, 0]).mean()) < limit
    assert abs((a * noise[0, 1]).mean()) < limit
    spectrum = np.abs(np.fft.fft2(a - a.mean())) ** 2 / a.size
    assert spectrum.max() < 25.0  # white: exponential with mean 1, P(any of 262144 above 25) = 4e-6


@pytest.mark.parametrize(
    ("light", "message"),
    [
        (np.zeros((1, 1, 48, 64)), "electrons: expected float32"),
        (np.zeros((48, 64), np.float32), "electrons: expected float32"),
        (np.zeros((1, 2, 48, 64), np.float32), "1 cameras"),
        (np.zeros((1, 1, 48, 65), np.float32), "48 rows and 64 columns"),
    ],
)
def test_invalid_electron_images_are_rejected(light, message):
    with pytest.raises(ValueError, match=message):
        expose(light, make_sensor(64, 48), np.zeros(1), np.zeros(1, np.int64))


def test_invalid_durations_are_rejected():
    sensor, light = make_sensor(64, 48), np.zeros((2, 1, 48, 64), np.float32)
    with pytest.raises(ValueError, match="duration"):
        expose(light, sensor, np.zeros(1), np.zeros(2, np.int64))
    with pytest.raises(ValueError, match="index"):
        expose(light, sensor, np.zeros(2), np.zeros(2))
    with pytest.raises(ValueError, match="exposure"):
        expose(light, sensor, np.array([0.0, -1.0]), np.zeros(2, np.int64))


def test_arrays_of_equal_type_are_accepted_and_other_byte_orders_refused():
    """A pickled array has a type object of its own."""
    sensor = make_sensor(64, 48, cameras=2)
    light, duration, index = np.full((2, 2, 48, 64), 50.0, np.float32), np.full(2, 1e-3), np.arange(2)
    images = expose(light, sensor, duration, index)
    copies = [pickle.loads(pickle.dumps(array)) for array in (light, duration, index)]
    np.testing.assert_array_equal(expose(copies[0], sensor, *copies[1:]), images)
    np.testing.assert_array_equal(expose(light, sensor, duration, index.astype(np.longlong)), images)
    sent = pickle.loads(pickle.dumps(images))
    assert len(extract(sent, sensor, background=pickle.loads(pickle.dumps(images)))) == 0
    for wrong in (images.astype(">u2"), images.astype(np.int16), images.astype(np.uint32)):
        with pytest.raises(ValueError, match="images: expected uint16"):
            extract(wrong, sensor)


def test_sparse_and_dense_input_give_same_bytes():
    """The renderer passes lit pixels only; ``expose`` takes full images of electrons."""
    sensor = make_sensor(cameras=2, detector={"prnu": 0.01, "dsnu_e": 2.0, "dark_current_e_per_s": 500.0})
    place = pose([0.0, 0.0, 0.12], [0.1, 0.2, 0.0])
    light = one_plane(sensor, place)
    scene = plane()
    assert 0 < (light > 0.0).mean() < 0.1
    images = render(scene, sensor, still(place, first=3))
    np.testing.assert_array_equal(images, expose(light[None], sensor, np.array([5e-4]), np.array([3])))


@pytest.mark.parametrize("electrons", [0.0, 100.0])
@pytest.mark.parametrize("dsnu", [0.0, 5.0])
def test_row_noise_is_common_to_a_row_and_new_in_every_image(electrons, dsnu):
    detector = QUIET | {"black_level_dn": 500.0, "read_noise_e": 3.0, "row_noise_e": 8.0, "dsnu_e": dsnu}
    images = flat(make_sensor(512, 480, detector=detector), electrons, frames=4)[:, 0].astype(float)
    within = electrons + 3.0**2 + dsnu**2 + 1 / 12
    rows = images.mean(axis=2)
    assert rows.std() == pytest.approx(np.sqrt(8.0**2 + within / 512), rel=0.07)
    assert np.abs(np.corrcoef(rows)[np.triu_indices(4, 1)]).max() < 0.2
    assert np.abs(np.corrcoef(rows[:, :-1].ravel(), rows[:, 1:].ravel())[0, 1]) < 0.1
    assert (images - rows[..., None]).std() == pytest.approx(np.sqrt(within), rel=0.02)


def test_coarsely_quantised_row_noise_has_its_size():
    """Most pixels have the digital number of the black level; the share of the others tells the noise."""
    detector = QUIET | {"read_noise_e": 4.0, "row_noise_e": 3.0, "black_level_dn": 10.0, "gain_dn_per_e": 0.04}
    image = flat(make_sensor(640, 512, detector=detector), 0.0, frames=16)
    expected = 2 * stats.norm.sf(0.5 / (0.04 * 5.0))
    assert np.mean(image != 10) == pytest.approx(expected, rel=0.1)


def test_hot_pixels_are_fixed_and_have_exponential_dark_current():
    detector = QUIET | {"bit_depth": 16, "hot_pixels": 0.002, "hot_pixel_e_per_s": 4e6}
    sensor = make_sensor(640, 512, cameras=2, detector=detector)
    short, long = (flat(sensor, 0.0, frames=2, duration=t).astype(float) for t in (2.5e-4, 5e-4))
    hot = long > 0
    assert (hot[0] != hot[1]).sum() < 0.01 * hot[0].sum()  # a small charge may be no electron
    for camera in range(2):
        assert hot[0, camera].mean() == pytest.approx(0.002, rel=0.15)
        current = long[0, camera][hot[0, camera]]
        assert current.mean() == pytest.approx(2000.0, rel=0.15)
        assert current.std() == pytest.approx(current.mean(), rel=0.15)
    assert (hot[0, 0] & hot[0, 1]).mean() < 1e-4
    assert np.median(short[hot] / long[hot]) == pytest.approx(0.5, rel=0.02)


def test_light_adds_to_hot_pixels():
    detector = QUIET | {"bit_depth": 16, "hot_pixels": 0.01, "hot_pixel_e_per_s": 4e6}
    sensor = make_sensor(320, 256, detector=detector)
    dark, lit = (flat(sensor, electrons).astype(float) for electrons in (0.0, 400.0))
    hot = dark > 200.0
    assert (lit - dark)[hot].mean() == pytest.approx(400.0, abs=10.0)


def test_no_noise_means_no_row_noise_and_no_hot_pixels():
    detector = QUIET | {"row_noise_e": 5.0, "hot_pixels": 0.1, "hot_pixel_e_per_s": 1e6}
    assert not flat(make_sensor(64, 48, detector=detector, render={"noise": False}), 0.0).any()


def test_share_of_hot_pixels_reaches_one():
    detector = QUIET | {"hot_pixels": 1.0, "hot_pixel_e_per_s": 1e8}
    assert (flat(make_sensor(64, 48, detector=detector), 0.0) > 0).mean() > 0.99
