"""Scans with automatic and with several exposures, of a part with black, white and metal regions."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import scancell
from bench.exposure_modes import AUTOMATIC, MATERIALS, MULTIPLE, PART, REGIONS, by_region
from scancell.config.loading import assets_dir
from scancell.config.sensor import profile_time
from scancell.errors import SensorError
from scancell.evaluation.ground_truth import TrueWorld

SETTINGS = {**REGIONS, "scan.max_profiles": 40}


def scan(engine: str = "ray-traced", **settings: Any) -> scancell.ScanResult:
    return scancell.scan(PART, engine=engine, settings={**SETTINGS, **settings})


@pytest.mark.parametrize("engine", ["geometric", "ray-traced"])
def test_several_exposures_measure_every_region_as_well_as_its_best_one(engine) -> None:
    best = (0.5, 5.0, 0.5)  # ms: the longest one without many saturated pixels
    merged = by_region(scan(engine, **MULTIPLE))
    for time in set(best):
        single = by_region(scan(engine, **{"sensor.detector.exposure_ms": time}))
        for region in (i for i in range(len(MATERIALS)) if best[i] == time):
            assert merged[region][0] > 0.98 * single[region][0]
            assert merged[region][1] < 1.2 * single[region][1]


def test_points_belong_to_the_time_of_their_exposure() -> None:
    """On a moving part, the profiles would be displaced against each other by its way between the exposures."""
    result = scan(**MULTIPLE)
    offsets = np.unique(result.profiles.time_offset)
    np.testing.assert_allclose(offsets, [-2.75e-3, -2.45e-3, 0.3e-3], atol=1e-9)
    assert by_region(result)[1][1] < 2.0  # um; 2.75 ms are a way of 50 um at the rim of the table


@pytest.mark.parametrize("engine", ["geometric", "ray-traced"])
def test_automatic_exposure_finds_what_a_wrong_first_one_misses(engine) -> None:
    wrong = {"sensor.detector.exposure_ms": 0.02}
    dark, adapted = scan(engine, **wrong), scan(engine, **wrong, **AUTOMATIC)
    assert len(adapted.cloud) > 1.5 * len(dark.cloud)
    assert adapted.deviation.figures.rms < 5e-6


@pytest.mark.parametrize("settings", [MULTIPLE, AUTOMATIC])
def test_result_does_not_depend_on_threads(settings) -> None:
    one, two = (
        scancell.scan(PART, settings={**SETTINGS, "scan.max_profiles": 12, **settings}, threads=threads).cloud
        for threads in (1, 2)
    )
    np.testing.assert_array_equal(one.points_in_part, two.points_in_part)
    np.testing.assert_array_equal(one.time, two.time)


@pytest.mark.parametrize("engine", ["geometric", "ray-traced"])
def test_deviation_of_the_exposure_time_acts_on_scans(engine) -> None:
    settings = {"scan.max_profiles": 30}
    as_built = {"sensor.detector.exposure_ms": 0.2}
    nominal, shorter = (
        scancell.scan(
            assets_dir() / "parts" / "step_block.stl", engine=engine, settings=settings, as_built=changed
        ).cloud
        for changed in ({}, as_built)
    )
    assert np.median(shorter.intensity) == pytest.approx(np.median(nominal.intensity) * 0.2 / 0.5, rel=0.02)


def test_a_shot_has_all_exposures() -> None:
    pose = scancell.location(0, 0, 0.15, rx=180 * scancell.deg)
    settings = {key: value for key, value in SETTINGS.items() if key != "scan.max_profiles"}
    dark = scancell.shot(PART, pose, settings={**settings, "sensor.detector.exposure_ms": 0.1})
    merged = scancell.shot(PART, pose, settings={**settings, **MULTIPLE})
    assert len(merged.points_in_part) > 1.2 * len(dark.points_in_part)
    assert len(merged.rows) == len(merged.points_in_part)


REGION = {f"sensor.camera[{k}].region_rows_px": [200, 700] for k in (1, 2)}


def test_profiles_follow_one_another_at_the_rate_of_the_sensor() -> None:
    settings = {
        **REGION,
        "sensor.detector.row_readout_us": 30.0,
        "scan.sweep.enabled": False,
        "scan.raster.pitch_mm": "sensor",
    }
    result = scan("geometric", **settings, **{"scan.max_profiles": 1000})
    period = 30e-6 * 699
    assert profile_time(result.setup.sensor) == pytest.approx(period)
    measured = result.recording.measured
    for segment in np.unique(measured.segment):
        gaps = np.diff(measured.time[measured.segment == segment])
        assert period - 2e-6 < gaps.min()  # times are whole microseconds
        assert gaps.max() < 1.1 * period


def test_choice_of_exposures_works_for_regions_and_binned_pixels() -> None:
    binned = {"sensor.detector.binning": 2, "sensor.detector.binning_mode": "charge"}
    part = {**REGION, **binned, "sensor.detector.exposure_ms": 0.05, "scan.max_profiles": 12}
    dark, merged, adapted = scan(**part), scan(**{**part, **MULTIPLE}), scan(**part, **AUTOMATIC)
    assert len(merged.cloud) > 1.5 * len(dark.cloud)
    assert len(adapted.cloud) > 1.2 * len(dark.cloud)
    for result in (merged, adapted):
        assert result.deviation.figures.rms < 5e-6


def test_ground_truth_needs_fixed_exposures() -> None:
    result = scan("geometric", **MULTIPLE)
    with pytest.raises(SensorError, match=r"exposure\.mode"):
        TrueWorld(result.recording, (), result.setup.sensor, 0, 1)
