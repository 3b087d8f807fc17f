"""No key of a sensor is silently without effect in the geometric engine: it counts, is refused or is listed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pytest
from pydantic import BaseModel

from scancell import sensor as sensor_rt
from scancell.config.loading import load_setup
from scancell.config.sensor import IMAGE_ONLY_KEYS, SensorDescription, ignored_by_geometric_engine
from scancell.scanning.world import make_sensor

# A change of every key, with what it needs beside it.
CHANGES: dict[str, tuple[str, ...]] = {
    "laser.wavelength_nm": ("650",),
    "laser.power_mw": ("3",),
    "laser.fan_half_angle_deg": ("15",),
    "laser.source_z_mm": ("1",),
    "laser.sheet_sigma_mm": ("0.06",),
    "laser.waist_z_mm": ("100",),
    "laser.divergence_mrad": ("0.6",),
    "laser.source_length_mm": ("1",),
    "laser.profile": ('"gaussian"', "laser.profile_half_width_deg=20"),
    "laser.profile_half_width_deg": ("12", 'laser.profile="gaussian"'),
    "laser.profile_angle_deg": ("[-20, 0, 20]", "laser.profile_power=[1, 2, 1]", 'laser.profile="table"'),
    "laser.profile_power": ("[1, 3, 1]", "laser.profile_angle_deg=[-20, 0, 20]", 'laser.profile="table"'),
    "laser.straightness_mrad": ("[0, 0, 0.5]",),
    "laser.offset_x_mm": ("0.1",),
    "laser.turn_y_deg": ("0.1",),
    "laser.turn_z_deg": ("0.1",),
    "range.near_mm": ("108",),
    "range.far_mm": ("112",),
    "camera.side": ("-1",),
    "camera.baseline_mm": ("60.1",),
    "camera.height_mm": ("0.1",),
    "camera.tilt_deg": ("29.4",),
    "camera.half_angle_deg": ("9.4",),
    "camera.width_px": ("640",),
    "camera.height_px": ("512",),
    "camera.cx_px": ("640",),
    "camera.cy_px": ("511.7",),
    "camera.region_columns_px": ("[600, 200]",),
    "camera.region_rows_px": ("[400, 300]",),
    "camera.distortion": ("[-0.1, 0, 0, 0, 0]",),
    "camera.f_number": ("8",),
    "camera.pixel_pitch_um": ("4.8",),
    "camera.transmission": ("0.7",),
    "camera.scheimpflug_x_deg": ("-5",),
    "camera.scheimpflug_y_deg": ("2",),
    "camera.focus_mm": ("125",),
    "camera.psf_sigma_px": ("1",),
    "camera.offset_y_mm": ("0.1",),
    "camera.pan_deg": ("0.1",),
    "camera.roll_deg": ("0.1",),
    "detector.exposure_ms": ("900",),  # by the dark current; light counts by the duration of each exposure
    "detector.quantum_efficiency": ("0.5",),
    "detector.full_well_e": ("4000",),
    "detector.read_noise_e": ("30",),
    "detector.dark_current_e_per_s": ("1e6",),
    "detector.gain_dn_per_e": ("0.03",),
    "detector.bit_depth": ("10",),
    "detector.black_level_dn": ("60",),
    "detector.prnu": ("0.01",),
    "detector.dsnu_e": ("20",),
    "detector.row_noise_e": ("20",),
    "detector.hot_pixels_ppm": ("100", "detector.hot_pixel_e_per_s=1000"),
    "detector.hot_pixel_e_per_s": ("1000", "detector.hot_pixels_ppm=100"),
    "detector.shutter": ('"rolling"', "detector.row_readout_us=10"),
    "detector.row_readout_us": ("20", 'detector.shutter="rolling"'),
    "detector.binning": ("2",),
    "detector.binning_mode": ('"charge"', "detector.binning=2"),
    "detector.laser_off_frame": ("true",),
    "ambient.irradiance_w_m2": ("20",),
    "band_pass.centre_nm": ("640",),
    "band_pass.width_nm": ("60",),
    "speckle.contrast": ("0.3",),
    "render.mode": ('"path"',),
    "render.samples_per_pixel": ("64",),
    "render.noise": ("false",),
    "render.rays_across_fan": ("4000",),
    "render.bounces": ("1",),
    "render.photons": ("1000",),
    "extraction.detector": ('"parabola"',),
    "extraction.peak": ('"continuity"',),
    "extraction.continuity_px": ("9",),
    "extraction.agreement_px": ("3", 'extraction.fusion="weighted"'),
    "extraction.triangulation": ('"eq4_as_printed"',),
    "extraction.fusion": ('"weighted"',),
    "extraction.threshold_sigma": ("40",),
    "extraction.min_amplitude_dn": ("20",),
    "extraction.min_sigma_px": ("1.5",),
    "extraction.max_sigma_px": ("1.2",),
    "extraction.max_asymmetry": ("0.2",),
    "extraction.max_residual": ("0.2",),
    "extraction.max_row_jump_px": ("0.2",),
    "extraction.max_amplitude_jump": ("0.2",),
    "extraction.max_width_jump": ("0.2",),
    "extraction.end_columns": ("3",),
    "extraction.min_run_columns": ("60",),
    "geometric.rays": ("1000",),
}


def keys(model: type[BaseModel], prefix: str = "") -> Iterator[str]:
    """All keys of a description; the keys of one camera represent those of all cameras."""
    for name, field in model.model_fields.items():
        inner = [t for t in (field.annotation, *getattr(field.annotation, "__args__", ())) if isinstance(t, type)]
        section = next((t for t in inner if issubclass(t, BaseModel)), None)
        if section is not None:
            yield from keys(section, f"{prefix}{name}.")
        elif name != "name":
            yield f"{prefix}{name}"


def cell() -> tuple[sensor_rt.Scene, sensor_rt.Exposures]:
    """Bright, dim, narrow and moving surfaces under a lamp."""
    scene = sensor_rt.Scene()
    angles = np.radians(20.0)
    world_from_body = np.eye(4)
    world_from_body[1:3, 1:3] = [[np.cos(angles), -np.sin(angles)], [np.sin(angles), np.cos(angles)]]
    world_from_body[2, 3] = 0.11
    for y, width, reflectance in ((-0.006, 0.012, 0.7), (0.007, 0.012, 0.1), (0.0155, 0.002, 0.5)):
        body_from_plane = np.eye(4)
        body_from_plane[1, 3] = y
        scene.add_plane("part", body_from_plane, [0.1, width], reflectance)
    lamp = np.eye(4)
    lamp[2, 3] = -0.3
    scene.add_light("part", "point", lamp, [0, 0], 100.0, None, (600e-9, 100e-9))
    poses = np.broadcast_to(world_from_body, (2, 1, 1, 4, 4))
    sensors = np.broadcast_to(np.eye(4), (2, 1, 4, 4))
    return scene, sensor_rt.Exposures(sensors, poses, np.full(2, 5e-4), np.arange(2))


def sensor_with(words: Sequence[str]) -> sensor_rt.Sensor:
    overrides = [f"sensor.{word}".replace("camera.", "camera[1].") for word in words]
    return make_sensor(load_setup(settings=overrides).sensor, 1)


def scanned(words: Sequence[str], as_built: Sequence[str] = ()) -> bytes:
    """Everything about the points, by a sensor to whose true state the words `as_built` apply as well."""
    scene, exposures = cell()
    sensor = sensor_with(words)
    built = sensor_with([*words, *as_built]) if as_built else None
    profiles = sensor_rt.scan(scene, sensor, exposures, engine="geometric", as_built=built).profiles
    arrays = (profiles.points_in_sensor, profiles.sigma, profiles.intensity, profiles.flags)
    return b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)


def test_the_changes_cover_every_key() -> None:
    """Section [exposure] chooses the exposure times that both engines are given: see test_exposures.py."""
    assert set(CHANGES) == {key for key in keys(SensorDescription) if not key.startswith("exposure.")}
    assert set(IMAGE_ONLY_KEYS) <= set(CHANGES)


# The cameras disagree by more than two pixels.
AS_BUILT = {"extraction.agreement_px": ("laser.offset_x_mm=0.03",)}
REFUSED = {"detector.shutter", "detector.row_readout_us", "render.mode", "render.bounces"}


@pytest.mark.parametrize("key", CHANGES)
def test_every_key_counts_or_is_refused_or_is_listed(key: str) -> None:
    value, *beside = CHANGES[key]
    words = (f"{key}={value}", *beside)
    if key in REFUSED:
        with pytest.raises(ValueError, match=rf"sensor\.{key.replace('row_readout_us', 'shutter')}"):
            scanned(words)
        return
    before = [word for word in beside if not word.startswith(("laser.profile", "detector.hot"))]
    as_built = AS_BUILT.get(key, ())
    unchanged = scanned(before, as_built)
    assert len(unchanged) > 10_000
    assert (scanned(words, as_built) != unchanged) == (key not in IMAGE_ONLY_KEYS)


def test_keys_without_effect_are_named_where_they_are_not_at_their_defaults() -> None:
    assert ignored_by_geometric_engine(load_setup().sensor) == []
    words = ["sensor.extraction.max_residual=0.2", "sensor.laser.source_length_mm=1", "sensor.extraction.end_columns=2"]
    found = ignored_by_geometric_engine(load_setup(settings=words).sensor)
    assert found == ["sensor.laser.source_length_mm", "sensor.extraction.max_residual"]
