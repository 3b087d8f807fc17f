"""Region of interest and binning: images, noise and points of the sensor as it is read out."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.config.loading import assets_dir, load_setup
from scancell.config.sensor import SensorDescription, image_sensor_pixels, read_out
from scancell.errors import DescriptionError
from scancell.geometry import pose
from scancell.scanning.sense import row_time_offset
from scancell.scanning.world import make_sensor

Array = NDArray[np.float64]

FIRST_COLUMN, COLUMNS = 101, 1003
PRESETS = sorted(str(file.relative_to(assets_dir())) for file in (assets_dir() / "sensors").rglob("*.toml"))
REALISTIC = [name for name in PRESETS if "realistic" in name]
DEFAULT = "sensors/two_camera_probe.toml"
BENT = {"distortion": [-0.2, 0.05, 1e-3, -1e-3, 0.0], "cx_px": 630.2, "roll_deg": 0.4}


def rows_of(height: int) -> tuple[int, int]:
    """First row and number of rows, both odd, of a region around the middle of the range."""
    return 2 * height // 5 | 1, 2 * height // 5 | 1


FIRST_ROW, ROWS = rows_of(1024)


def region_of(sensor: SensorDescription) -> dict[str, Any]:
    rows = list(rows_of(sensor.camera[0].height_px))
    return {"region_columns_px": [FIRST_COLUMN, COLUMNS], "region_rows_px": rows}


def cut(images: Array) -> Array:
    """The region of images (..., height, width) of the whole sensor."""
    first, count = rows_of(images.shape[-2])
    return images[..., first : first + count, FIRST_COLUMN : FIRST_COLUMN + COLUMNS]


def described(name: str = DEFAULT, region: bool = False, camera: dict[str, Any] | None = None, **settings: Any):
    """A preset with keys of the sensor (`detector__binning`) and of all its cameras."""
    file = assets_dir() / name
    sensor = SensorDescription.from_toml(file)
    keys, count = {**(camera or {}), **(region_of(sensor) if region else {})}, len(sensor.camera)
    changes = {f"sensor.camera[{k + 1}].{key}": value for k in range(count) for key, value in keys.items()}
    changes |= {f"sensor.{key.replace('__', '.')}": value for key, value in settings.items()}
    return load_setup(sensor=file, settings=changes).sensor


def tilted_plane(sensor: SensorDescription, count: int = 1, velocity: Array | None = None):
    """A plane in the middle of the range, its exposures, and its pose at their middle."""
    middle = 0.5e-3 * (sensor.range.near_mm + sensor.range.far_mm)
    placed = pose.from_euler_xyz((0.0, 0.0, middle), (0.2, 0.13, 0.0))
    scene = sensor_rt.Scene()
    scene.add_plane("plane", np.eye(4), [1.0, 1.0], 0.7)
    native, duration = make_sensor(sensor, 0), 1e-3 * sensor.detector.exposure_ms
    samples = np.repeat(placed[None, None, None], count, 0)
    if velocity is not None:
        rows = max(camera.height_px for camera in native.cameras)
        path = velocity * (duration + native.row_readout * (rows - 1))
        ends = [pose.translation(share * path) @ placed for share in (-0.5, 0.5)]
        samples = np.repeat(np.array(ends)[None, None], count, 0)
    still = np.broadcast_to(np.eye(4), (count, samples.shape[2], 4, 4))
    return scene, sensor_rt.Exposures(still, samples, np.full(count, duration), np.arange(1, count + 1)), placed


def electrons(sensor: SensorDescription) -> Array:
    """Expected electrons (cameras, height, width) of the tilted plane."""
    scene, exposures, _ = tilted_plane(sensor)
    return np.asarray(sensor_rt.expected_electrons(scene, make_sensor(sensor, 0), exposures)[0], float)


def summed(values: Array, side: int) -> Array:
    """Sums (..., height // side, width // side) over squares of pixels; the rest at the ends is left out."""
    height, width = (size // side for size in values.shape[-2:])
    kept = values[..., : height * side, : width * side]
    return kept.reshape(*values.shape[:-2], height, side, width, side).sum((-3, -1))


@pytest.mark.parametrize("binning", [1, 2, 4])
@pytest.mark.parametrize("camera", [{}, BENT, {**BENT, "scheimpflug_x_deg": -8.0, "scheimpflug_y_deg": 3.0}])
def test_pixels_are_those_of_the_image_sensor(camera, binning) -> None:
    whole, part = described(camera=camera), described(camera=camera, region=True, detector__binning=binning)
    rng = np.random.default_rng(0)
    points = np.column_stack([np.zeros(200), rng.uniform(-0.02, 0.02, 200), rng.uniform(0.09, 0.15, 200)])
    for number, (one, read) in enumerate(zip(make_sensor(whole, 0).cameras, make_sensor(part, 0).cameras, strict=True)):
        assert (read.width_px, read.height_px) == (COLUMNS // binning, ROWS // binning)
        expected, found = one.project(points), read.project(points)
        np.testing.assert_allclose(image_sensor_pixels(part, number, found), expected, atol=1e-8)
        # The centre of a binned pixel is that of its square.
        np.testing.assert_allclose(
            found, (expected - [FIRST_COLUMN, FIRST_ROW] - (binning - 1) / 2) / binning, atol=1e-8
        )


def test_whole_image_without_binning_is_the_sensor_itself() -> None:
    sensor = described(camera=BENT)
    assert read_out(sensor) is sensor
    whole = described(camera={**BENT, "region_columns_px": [0, 1280], "region_rows_px": [0, 1024]})
    assert read_out(whole).camera[0].half_angle_deg == pytest.approx(sensor.camera[0].half_angle_deg, rel=1e-14)
    once = read_out(described(region=True, detector__binning=2))
    assert read_out(once) is once


@pytest.mark.parametrize("name", [DEFAULT, *REALISTIC])
def test_region_has_the_light_of_the_whole_image(name) -> None:
    """Without speckle, whose pattern is another one."""
    expected = cut(electrons(described(name, speckle__contrast=0.0)))
    part = electrons(described(name, region=True, speckle__contrast=0.0))
    assert part.shape == expected.shape
    assert (part > 0.1 * part.max()).any(1).mean() > 0.9
    np.testing.assert_allclose(part, expected, atol=2e-4 * expected.max())  # rows in single precision


def test_noise_free_images_of_a_region_are_cut_from_the_whole_image() -> None:
    images = []
    for region in (False, True):
        sensor = described(region=region, render__noise=False)
        scene, exposures, _ = tilted_plane(sensor)
        images.append(np.asarray(sensor_rt.render(scene, make_sensor(sensor, 0), exposures)[0], int))
    expected, part = cut(images[0]), images[1]
    assert expected.max() > 100
    assert np.abs(part - expected).max() <= 1  # where a half is rounded


@pytest.mark.parametrize("binning", [2, 4])
@pytest.mark.parametrize("name", [DEFAULT, *REALISTIC])
def test_binned_pixels_have_the_light_of_their_squares(name, binning) -> None:
    """Light, defocus and point spread are those of the same lens and image sensor; not at the ends of the line."""
    dull = {"speckle__contrast": 0.0}
    whole, part = electrons(described(name, **dull)), electrons(described(name, detector__binning=binning, **dull))
    expected = summed(whole, binning)
    assert part.shape == expected.shape
    middle = np.s_[..., part.shape[-1] // 8 : -part.shape[-1] // 8]
    np.testing.assert_allclose(part.sum(1)[middle], expected.sum(1)[middle], rtol=1e-3)
    np.testing.assert_allclose(part[middle], expected[middle], atol=0.015 * expected.max())


NOISY = {
    "detector__bit_depth": 16,
    "detector__gain_dn_per_e": 4.0,  # quantisation is negligible
    "detector__black_level_dn": 1000.0,
    "detector__full_well_e": 15_000.0,
    "detector__read_noise_e": 6.0,
    "detector__dark_current_e_per_s": 5000.0,
}
FLAT_E, COUNT = 300.0, 40


def flat_images(sensor: SensorDescription, light: float, camera: int = 0) -> Array:
    """Images (count, height, width) of even light, electrons per pixel of the image."""
    native = make_sensor(sensor, 3)
    read = read_out(sensor).camera[0]
    plane = np.full((COUNT, 2, read.height_px, read.width_px), light, np.float32)
    return np.asarray(sensor_rt.expose(plane, native, np.full(COUNT, 5e-4), np.arange(COUNT))[:, camera], float)


def noise(images: Array) -> tuple[float, float, float, float]:
    """Mean, temporal variance, spatial variance of the means over time, temporal variance of the means of rows."""
    temporal = images.var(0, ddof=1).mean()
    spatial = images.mean(0).var(ddof=1) - temporal / len(images)
    return images.mean(), temporal, spatial, images.mean(2).var(0, ddof=1).mean()


SMALL = {"region_columns_px": [560, 192], "region_rows_px": [400, 192]}


@pytest.mark.parametrize("binning", [2, 4])
@pytest.mark.parametrize("light", [0.0, FLAT_E])
def test_average_binning_has_the_noise_of_averaged_pixels(light, binning) -> None:
    """The images of the whole sensor, averaged by squares, have mean and variances of the binned images."""
    options = {**NOISY, "detector__prnu": 0.02, "detector__dsnu_e": 8.0, "detector__row_noise_e": 3.0}
    whole = flat_images(described(camera=SMALL, **options), light)
    expected = noise(summed(whole, binning) / binning**2)
    found = noise(flat_images(described(camera=SMALL, detector__binning=binning, **options), light * binning**2))
    assert found[0] == pytest.approx(expected[0], abs=0.5)
    np.testing.assert_allclose(found[1:], expected[1:], rtol=0.1)


@pytest.mark.parametrize("binning", [2, 4])
def test_charge_binning_reads_the_sum_once(binning) -> None:
    """EMVA 1288: variance K² (N (light + dark) + read² + row²); PRNU and DSNU of N pixels add independently."""
    read, row, prnu, dsnu, gain, count = 6.0, 3.0, 0.02, 8.0, 4.0, binning**2
    options = {**NOISY, "detector__prnu": prnu, "detector__dsnu_e": dsnu, "detector__row_noise_e": row}
    sensor = described(camera=SMALL, detector__binning=binning, detector__binning_mode="charge", **options)
    light, dark = 60.0 * count, 2.5 * count
    mean, temporal, spatial, of_rows = noise(flat_images(sensor, light))
    assert mean == pytest.approx(1000.0 + gain * (light + dark), rel=2e-3)
    expected = gain**2 * (light + dark + read**2 + row**2)
    assert temporal == pytest.approx(expected, rel=0.03)
    assert spatial == pytest.approx(gain**2 * (count * dsnu**2 + (light * prnu) ** 2 / count), rel=0.05)
    width = 192 // binning
    assert of_rows == pytest.approx(gain**2 * row**2 + (expected - gain**2 * row**2) / width, rel=0.1)


@pytest.mark.parametrize(("mode", "saturation"), [("average", 4 * 2000.0), ("charge", 2000.0)])
def test_saturation_of_binned_pixels(mode, saturation) -> None:
    options = {**NOISY, "detector__full_well_e": 2000.0, "detector__read_noise_e": 0.0, "detector__binning": 2}
    sensor = described(camera=SMALL, detector__binning_mode=mode, render__noise=False, **options)
    full = 1000.0 + 4.0 * 2000.0
    assert flat_images(sensor, 1.5 * saturation).min() == full
    assert flat_images(sensor, 0.9 * saturation).max() < full


def test_hot_pixels_of_binned_images() -> None:
    """Nearly every hot pixel makes one of the image hot; their mean current adds to the sum of the signals."""
    hot = {"detector__hot_pixels_ppm": 2000.0, "detector__hot_pixel_e_per_s": 4e5}
    dark = {**NOISY, "detector__dark_current_e_per_s": 0.0}
    for binning, gain in ((1, 4.0), (2, 1.0)):
        image = flat_images(described(camera=SMALL, detector__binning=binning, **dark, **hot), 0.0).mean(0)
        bright = image - 1000.0 > 4.0 * gain * 6.0 * binning / np.sqrt(COUNT) * 4
        expected = 2e-3 * 192**2
        assert 0.7 * expected < bright.sum() < 1.1 * expected
        assert (image - 1000.0).sum() / gain == pytest.approx(expected * 200.0, rel=0.4)


CASES = [
    {"region": True},
    {"detector__binning": 2},
    {"detector__binning": 2, "detector__binning_mode": "charge", "detector__exposure_ms": 0.125},
    {"region": True, "detector__binning": 2},
    {"region": True, "detector__binning": 4, "laser__sheet_sigma_mm": 0.2},
]


@pytest.mark.parametrize("engine", ["ray-traced", "geometric"])
@pytest.mark.parametrize("case", CASES)
def test_points_are_unbiased_with_the_stated_noise(case, engine) -> None:
    sensor, count = described(detector__prnu=0.0, detector__dsnu_e=0.0, **case), 60
    native = make_sensor(sensor, 0)
    scene, exposures, placed = tilted_plane(sensor, count)
    profiles = sensor_rt.scan(scene, native, exposures, engine, 2).profiles
    points, camera = np.asarray(profiles.points_in_sensor), np.asarray(profiles.camera)
    assert len(points) > 300 * count
    distance = (points - placed[:3, 3]) @ placed[:3, 2]
    ratio, bias, half_row = [], [], np.array([0.0, 0.5])
    for number, optics in enumerate(native.cameras):
        own = camera == number
        # In the direction in which a row moves the point.
        pixels = optics.project(points[own])
        step = sensor_rt.triangulate_pixels(pixels + half_row, native, number, "exact")
        step -= sensor_rt.triangulate_pixels(pixels - half_row, native, number, "exact")
        rows = distance[own] / (step @ placed[:3, 2])
        bias.append(rows.mean())
        ratio.append(rows / (np.asarray(profiles.sigma)[own] / np.linalg.norm(step, axis=1)))
    assert np.abs(bias).max() < 0.01  # px of the image
    assert 0.9 < np.sqrt(np.mean(np.concatenate(ratio) ** 2)) < 1.1


@pytest.mark.parametrize("name", REALISTIC)
def test_points_of_realistic_sensors_stay_where_they_are(name) -> None:
    """Without noise, speckle and smile, a binned sensor measures the plane as the whole one."""
    exact = {"speckle__contrast": 0.0, "laser__straightness_mrad": [], "render__noise": False}
    deep = {"detector__bit_depth": 16, "detector__gain_dn_per_e": 5.0}
    found = []
    for case in ({}, {"detector__binning": 2}, {"region": True, "detector__binning": 2}):
        sensor = described(name, **exact, **deep, **case)
        scene, exposures, placed = tilted_plane(sensor)
        points = np.asarray(sensor_rt.scan(scene, make_sensor(sensor, 0), exposures).profiles.points_in_sensor)
        assert len(points) > 450
        pixel = 1e-3 * (sensor.range.far_mm - sensor.range.near_mm) / sensor.camera[0].height_px
        found.append(np.sqrt(np.mean(((points - placed[:3, 3]) @ placed[:3, 2]) ** 2)) / pixel)
    assert max(found) < 0.03  # pixels of the image sensor


def test_rolling_shutter_begins_with_the_first_row_of_the_region() -> None:
    """A plane that moves along its normal is displaced by its speed times the time of each row from the middle one."""
    rolling = {"detector__shutter": "rolling", "detector__row_readout_us": 20.0, "render__noise": False}
    deep = {"detector__bit_depth": 16, "detector__gain_dn_per_e": 5.0}
    sensor = described(region=True, detector__binning=2, **rolling, **deep)
    native, velocity = make_sensor(sensor, 0), np.array([0.0, 0.0, 0.05])
    scene, exposures, placed = tilted_plane(sensor, velocity=velocity)
    profiles = sensor_rt.scan(scene, native, exposures).profiles
    row, camera = np.asarray(profiles.row), np.asarray(profiles.camera)
    late = np.asarray(row_time_offset(native, row, camera), float)
    np.testing.assert_allclose(late, 20e-6 * (row - (ROWS // 2 - 1) / 2), atol=1e-9)
    assert np.ptp(row) > 40
    off = (np.asarray(profiles.points_in_sensor) - placed[:3, 3]) @ placed[:3, 2]
    expected = velocity @ placed[:3, 2] * late
    assert np.abs(expected).max() > 20e-6
    assert np.sqrt(np.mean((off - expected) ** 2)) < 2e-6


def test_measuring_field_ends_at_the_edges_of_the_region() -> None:
    native = make_sensor(described(region=True), 0)
    for number, camera in enumerate(native.cameras):
        field = native.trapezoid(number)  # (4, 2) y and z
        pixels = camera.project(np.column_stack([np.zeros(4), field]))
        rows = np.sort(pixels[:, 1])
        np.testing.assert_allclose(rows, [-0.5, -0.5, ROWS - 0.5, ROWS - 0.5], atol=1e-6)
        assert (pixels[:, 0] > -0.5 - 1e-6).all()
        assert (pixels[:, 0] < COLUMNS - 0.5 + 1e-6).all()


@pytest.mark.parametrize(
    ("settings", "fragment"),
    [
        ({"camera[1].region_rows_px": [800, 400]}, r"camera\[1\].*region_rows_px = \[800, 400\].*1024 px"),
        ({"camera[2].region_columns_px": [0, 1281]}, r"region_columns_px.*1280 px"),
        ({"camera[1].region_columns_px": [700, 400]}, r"column 639\.5"),
        ({"camera[1].region_columns_px": [600, 100], "camera[1].cx_px": 500}, "column 500"),
        ({"camera[1].region_rows_px": [-1, 400]}, "greater than or equal to 0"),
        ({"camera[1].region_rows_px": [0, 8]}, "greater than or equal to 16"),
        ({"camera[1].region_rows_px": [0.5, 100]}, "integer"),
        ({"camera[2].region_rows_px": [0, 60], "detector.binning": 4}, r"camera\[2\].*1280|camera\[2\].*320 x 15"),
        ({"detector.binning": 3}, "1, 2 or 4"),
        ({"detector.binning_mode": "sum"}, "average"),
    ],
)
def test_wrong_regions_and_binning_are_refused(settings, fragment) -> None:
    with pytest.raises(DescriptionError, match=fragment):
        load_setup(settings={f"sensor.{key}": value for key, value in settings.items()})
