"""Conversion of the sensor description for the native library."""

from __future__ import annotations

import json
from collections.abc import Sequence

import numpy as np
import pytest

from scancell.config.loading import as_built_sensor, load_setup
from scancell.config.sensor import sensor_json
from scancell.errors import DescriptionError
from scancell.sensor import Sensor


def sensor(*words: str) -> Sensor:
    return Sensor(json.dumps(sensor_json(load_setup(settings=words).sensor, seed=1)))


def irradiance(made: Sensor, angles: Sequence[float], radius: float = 0.12, x: float = 0.0) -> np.ndarray:
    """Irradiance at angles (rad) in the centre of the nominal sheet, `radius` (m) from the source."""
    at = np.asarray(angles)
    return made.laser_irradiance(np.stack([0 * at + x, radius * np.sin(at), radius * np.cos(at)], axis=1))[:, 0]


def test_gaussian_line_width_and_power() -> None:
    words = ['sensor.laser.profile="gaussian"', "sensor.laser.profile_half_width_deg=10"]
    even, uneven = (sensor("sensor.laser.divergence_mrad=0", *extra) for extra in ([], words))
    angles = np.radians(np.linspace(-15.999, 15.999, 641))
    ratio = irradiance(uneven, angles) / irradiance(even, angles)
    expected = np.exp(-2 * (angles / np.radians(10)) ** 2)
    np.testing.assert_allclose(ratio / ratio.max(), expected, rtol=3e-4)
    assert np.trapezoid(ratio, angles) / (angles[-1] - angles[0]) == pytest.approx(1.0, rel=1e-3)


def test_straightness_displaces_line_ends() -> None:
    """0.5 mrad at the end of the line displaces the irradiance peak there by 60 um at 120 mm."""
    bent = sensor("sensor.laser.straightness_mrad=[0, 0, 0.5]", "sensor.laser.divergence_mrad=0")
    x = np.linspace(-1e-4, 1e-4, 401)
    end = np.radians(15.9999)
    across = [irradiance(bent, [end], radius=0.12 / np.cos(end), x=float(v))[0] for v in x]
    assert x[int(np.argmax(across))] == pytest.approx(0.5e-3 * 0.12, abs=1e-6)


@pytest.mark.parametrize(
    ("words", "fragment"),
    [
        (['laser.profile="gaussian"'], "profile_half_width_deg"),
        (["laser.profile_half_width_deg=3"], "given together"),
        (['laser.profile="table"'], "given together"),
        (
            ['laser.profile="table"', "laser.profile_angle_deg=[1]", "laser.profile_power=[1]"],
            "equal length, at least two",
        ),
        (['laser.profile="table"', "laser.profile_angle_deg=[1, 0]", "laser.profile_power=[1, 1]"], "ascending order"),
        (["laser.straightness_mrad=[0, 0, 500]"], "straightness_mrad"),
        (["laser.straightness_mrad=[0, 0, 0, 0, 0, 0, 1]"], "straightness_mrad"),
        (["laser.source_length_mm=-1"], "source_length_mm"),
        (["range.far_mm=10001"], "far_mm"),
        (["camera[2].distortion=[0, 0, 2000, 0, 0]"], "distortion"),
        (["camera[2].distortion=[0, 0, 0, 0, nan]"], "distortion"),
        (["camera[2].distortion=[-10, 0, 0, 0, 0]"], r"camera\[2\]\.distortion: has no inverse from a radius of"),
        (["laser.turn_y_deg=90"], "turn_y_deg"),
        (["camera[1].focus_mm=0.1"], "focus_mm"),
        (["camera[1].psf_sigma_px=-1"], "psf_sigma_px"),
        (['camera[1].psf_sigma_px="airy"'], "psf_sigma_px"),
        (["camera[1].scheimpflug_x_deg=60"], "scheimpflug_x_deg"),
        (['camera[2].name="plus"'], "2 cameras have the name 'plus'"),
        (['detector.shutter="rolling"'], "needs row_readout_us"),
        (["detector.hot_pixels_ppm=12.5"], "must be given together"),
        (['detector.shutter="rolling"', "detector.row_readout_us=0"], "greater than or equal to"),
        (['detector.shutter="rolling"', "detector.row_readout_us=12.5", "render.bounces=1"], "bounces must be 0"),
    ],
)
def test_invalid_sensor_values_are_rejected(words: list[str], fragment: str) -> None:
    with pytest.raises(DescriptionError, match=fragment):
        load_setup(settings=[f"sensor.{word}" for word in words])


def test_diffraction_width() -> None:
    resolved = sensor_json(load_setup(settings=['sensor.camera[2].psf_sigma_px="diffraction"']).sensor, seed=1)
    assert [camera["psf_sigma_px"] for camera in resolved["cameras"]] == [0.0, pytest.approx(0.42 * 0.66 * 11 / 5)]
    assert [camera["focus"] for camera in resolved["cameras"]] == [0.0, 0.0]


def test_scheimpflug_camera_description() -> None:
    """Angle and focus distance by the formulas in the schema."""
    image_distance = 512 / np.tan(np.radians(9.34)) * 5e-3
    angle = -np.degrees(np.arctan(image_distance * np.cos(np.radians(29.3)) / 60))
    words = [
        f"sensor.camera[1].scheimpflug_x_deg={angle}",
        f"sensor.camera[1].focus_mm={60 / np.sin(np.radians(29.3))}",
    ]
    made = sensor(*words)
    assert len(made.cameras) == 2
    assert angle == pytest.approx(-12.75, abs=0.01)


def test_as_built_changes_sensor_copy() -> None:
    nominal = load_setup().sensor
    words = ["sensor.camera[2].baseline_mm=60.05", "tool.x_mm=1", "sensor.laser.straightness_mrad=[0, 0, 0.2]"]
    built = as_built_sensor(nominal, words)
    assert [camera.baseline_mm for camera in built.camera] == [60.0, 60.05]
    assert built.laser.straightness_mrad == (0.0, 0.0, 0.2)
    assert built.camera[0] == nominal.camera[0]
    assert nominal == load_setup().sensor
    assert as_built_sensor(nominal, ["tool.x_mm=1"]) == nominal


@pytest.mark.parametrize(
    ("word", "fragment"),
    [
        ("sensor.camera[3].baseline_mm=60", "`as_built` .*there are 2"),
        ("sensor.camera[1].base_mm=60", "base_mm: unknown key"),
        ("sensor.laser.power_mw=-1", "`as_built` sensor.laser.power_mw=-1: laser.power_mw = -1"),
        ('sensor.extraction.peak="first"', "sensor.laser, sensor.camera"),
        ("sensor.name=3", "sensor.laser, sensor.camera"),
    ],
)
def test_invalid_as_built_words_are_rejected(word: str, fragment: str) -> None:
    with pytest.raises(DescriptionError, match=fragment):
        as_built_sensor(load_setup().sensor, [word])


ROLLING = ('sensor.detector.shutter="rolling"', "sensor.detector.row_readout_us=12.5")


def test_row_readout_time_is_in_seconds() -> None:
    assert sensor().row_readout == 0.0
    assert sensor(*ROLLING).row_readout == pytest.approx(12.5e-6)
    nominal = load_setup().sensor
    assert as_built_sensor(nominal, ROLLING).detector.row_readout_us == 12.5
