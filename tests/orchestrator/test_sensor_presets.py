"""Sensor presets: geometry, noise and linearity land in the figures of their classes."""

from __future__ import annotations

import numpy as np
import pytest

from bench.sensor_presets import CLASSES, FOLDERS, preset_file, simulate
from scancell.config.loading import assets_dir, load_setup
from scancell.config.sensor import SensorDescription
from scancell.evaluation.plane_trial import PlaneTarget, linearity, measure_plane
from scancell.scanning.world import make_sensor


@pytest.mark.parametrize("folder", FOLDERS)
@pytest.mark.parametrize("name", CLASSES)
def test_preset_is_in_its_class(name: str, folder: str) -> None:
    """Noise in the middle: half to all of the class figure; linearity: a fifth to all; repeatability: at most."""
    wanted, found = CLASSES[name], simulate(f"{folder}{name}", "ray-traced", exposures=4)
    assert found.line == pytest.approx(wanted.line, rel=0.02)
    assert 0.9 * wanted.points <= found.points <= wanted.points
    assert 0.5 * wanted.noise <= found.noise[1] <= wanted.noise
    assert found.repeatability <= wanted.repeatability
    assert 0.2 * wanted.linearity <= found.linearity <= wanted.linearity
    assert found.linearity_of_mean <= wanted.linearity


@pytest.mark.parametrize("folder", FOLDERS)
@pytest.mark.parametrize("name", CLASSES)
def test_measuring_range_is_that_of_the_description(name: str, folder: str) -> None:
    """Every camera sees the whole described range, and points beyond it are discarded."""
    wanted, name = CLASSES[name], f"{folder}{name}"
    described = load_setup(sensor=preset_file(name)).sensor
    made = make_sensor(described, 0)
    assert (described.range.near_mm, described.range.far_mm) == (wanted.near, wanted.far)
    for camera in range(len(described.camera)):
        z = made.trapezoid(camera)[:, 1]
        assert z.min() < made.range[0] < made.range[1] < z.max()
    for beyond in (0.99 * made.range[0], 1.01 * made.range[1]):
        reading = measure_plane(described, PlaneTarget(beyond), 1, "geometric")
        assert len(reading.signed) == 0


IDEAL = load_setup(ideal=True).sensor  # the default one without noise
REALISTIC = sorted(file.stem for file in (assets_dir() / "sensors" / "realistic").glob("*.toml"))


@pytest.mark.parametrize("name", REALISTIC)
def test_realistic_lens_is_in_focus_on_the_sheet_and_blurs_at_all_else(name: str) -> None:
    """The circle of confusion of a thin lens, by its plane of sharp focus, vanishes on the sheet alone."""
    camera = load_setup(sensor=preset_file(f"realistic/{name}")).sensor.camera[0]
    tilt, lean = np.radians(camera.tilt_deg), np.radians(camera.scheimpflug_x_deg)
    focal_px = camera.height_px / (2 * np.tan(np.radians(camera.half_angle_deg)))
    image_distance, focus = 1e-3 * camera.pixel_pitch_um * focal_px, camera.focus_mm
    focal_length = 1 / (1 / image_distance + 1 / focus)

    def spot_px(x_mm: float, z_mm: float) -> float:
        # In the plane of the axis: along it (depth) and across, towards larger rows.
        dx, dz = camera.baseline_mm - x_mm, z_mm
        depth = dz * np.cos(tilt) + dx * np.sin(tilt)
        across = dz * np.sin(tilt) - dx * np.cos(tilt)
        sharp = 1 / (1 / focal_length - 1 / depth)  # distance of the image of the point
        # The image sensor leans about the column axis through the end of the axis.
        slope = across / depth
        hit = image_distance / (1 + slope * np.tan(-lean))
        aperture = image_distance / camera.f_number
        return float(abs(hit - sharp) / sharp * aperture / (1e-3 * camera.pixel_pitch_um))

    description = load_setup(sensor=preset_file(f"realistic/{name}")).sensor.range
    on_sheet = [spot_px(0.0, z) for z in np.linspace(description.near_mm, description.far_mm, 5)]
    assert max(on_sheet) < 0.25
    middle = (description.near_mm + description.far_mm) / 2
    assert spot_px(0.05 * middle, middle) > 4 * max(0.1, *on_sheet)


@pytest.mark.parametrize("name", REALISTIC)
def test_realistic_preset_differs_from_the_ideal_one_by_its_lens_alone(name: str) -> None:
    ideal, real = (
        SensorDescription.from_toml(preset_file(one)).model_dump(mode="json") for one in (name, f"realistic/{name}")
    )
    lens = {"half_angle_deg", "height_px", "cy_px", "scheimpflug_x_deg", "focus_mm", "psf_sigma_px"}
    for one in (ideal, real):
        one["camera"] = [{key: value for key, value in camera.items() if key not in lens} for camera in one["camera"]]
        del one["name"]
        if name == "two_camera_probe":  # states no speckle and no smile
            del one["speckle"], one["laser"]["straightness_mrad"]
    assert ideal == real


def test_plane_trial_finds_a_displaced_sheet() -> None:
    """A sheet displaced by d along X moves measured heights by d z / baseline: bias and, over the range, a slope."""
    offset, baseline, z = 0.1e-3, 60e-3, 0.12
    moved = ("sensor.laser.offset_x_mm=0.1",)
    by_camera = []
    for distance in (0.09, z, 0.15):
        reading = measure_plane(IDEAL, PlaneTarget(distance), 1, "geometric", as_built=moved)
        assert reading.figures().missing_rate == 0.0
        by_camera.append([reading.signed[reading.camera == k].mean() for k in (0, 1)])
    plus, minus = by_camera[1]
    assert abs(plus) == pytest.approx(offset * z / baseline, rel=0.01)
    assert plus == pytest.approx(-minus, rel=0.01)
    assert np.ptp([plus for plus, _ in by_camera]) == pytest.approx(offset * 0.06 / baseline, rel=0.01)


def test_tilted_plane_has_no_bias_and_linear_sensor_no_linearity_error() -> None:
    """Signed distances are from the tilted target; a sensor without errors measures it exactly."""
    targets = [
        PlaneTarget(0.12, in_plane=0.4),
        PlaneTarget(0.12, out_of_plane=-0.5),
        PlaneTarget(0.1),
        PlaneTarget(0.14),
    ]
    readings = [measure_plane(IDEAL, target, 1, "geometric") for target in targets]
    assert max(np.abs(one.signed).max() for one in readings) < 1e-9
    assert linearity(readings[2:]).of_field < 1e-9


def test_missing_points_and_outliers_are_counted() -> None:
    """A black target is not seen; a brighter one is, without outliers beyond those of a normal distribution."""
    noisy = load_setup().sensor
    dark = measure_plane(noisy, PlaneTarget(0.12, reflectance=1e-4), 3, "geometric").figures()
    assert dark.missing_rate > 0.99
    bright = measure_plane(noisy, PlaneTarget(0.12), 3, "geometric").figures()
    assert bright.missing_rate < 0.01
    assert bright.outlier_rate < 1e-3


def test_speed_makes_no_bias_on_a_slope() -> None:
    """The target is in its place at the middle of the exposure."""
    noisy = load_setup().sensor
    slope = {"out_of_plane": np.radians(30.0)}
    still, moving = (
        measure_plane(noisy, PlaneTarget(0.12, **slope, speed=speed), 10, "ray-traced").figures()
        for speed in (0.0, 0.4)
    )
    travel = 0.4 * 0.5e-3 * np.sin(np.radians(30.0))
    assert abs(moving.bias - still.bias) < 0.02 * travel
