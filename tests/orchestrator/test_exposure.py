"""Exposure times: windows of several exposures, automatic control, and the choice among points of several exposures."""

from __future__ import annotations

import numpy as np
import pytest

from scancell.config.loading import load_setup
from scancell.config.sensor import exposure_span, exposure_windows, profile_time
from scancell.errors import DescriptionError
from scancell.planning.options import scan_options
from scancell.reconstruction.reconstruct import ProfilePoints
from scancell.scanning.sense import surest
from scancell.scanning.world import AutomaticExposure, SameExposures
from scancell.sensor import PEAK_FLAGS

MULTIPLE = {"exposure.mode": "multiple", "exposure.further_ms": [0.1, 2.0]}
AUTOMATIC = {"exposure.mode": "automatic", "exposure.shortest_ms": 0.05, "exposure.longest_ms": 4.0}
REGION = {"camera[1].region_rows_px": [300, 400], "camera[2].region_rows_px": [200, 380]}


def sensor(**settings):
    return load_setup(settings={f"sensor.{key}": value for key, value in settings.items()}).sensor


def test_windows_of_several_exposures_follow_one_another_about_the_latch() -> None:
    description = sensor(**MULTIPLE)
    windows = exposure_windows(description)
    np.testing.assert_allclose(windows[:, 1], [0.5e-3, 0.1e-3, 2e-3])
    begin, end = windows[:, 0] - windows[:, 1] / 2, windows[:, 0] + windows[:, 1] / 2
    np.testing.assert_allclose(begin[1:], end[:-1], atol=1e-12)
    assert begin[0] == pytest.approx(-end[-1])
    assert exposure_span(description) == pytest.approx(2.6e-3)
    assert profile_time(description) == pytest.approx(2.6e-3)


def test_one_exposure_is_about_the_latch() -> None:
    np.testing.assert_allclose(exposure_windows(sensor()), [[0.0, 0.5e-3]], atol=1e-15)


@pytest.mark.parametrize(
    ("settings", "milliseconds"),
    [
        ({}, 0.5),
        ({"detector.row_readout_us": 0.2}, 0.5),  # read during the next exposure
        ({"detector.row_readout_us": 2.0}, 2.0 * 1.023),  # the exposure waits for the image before
        ({"detector.shutter": "rolling", "detector.row_readout_us": 2.0}, 0.5 + 2.0 * 1.023),
        ({"detector.row_readout_us": 2.0, **REGION}, 2.0 * 0.399),
        ({"detector.row_readout_us": 2.0, "detector.binning": 2}, 2.0 * 0.511),
        ({"detector.row_readout_us": 4.0, "detector.binning": 2, **REGION}, 4.0 * 0.199),
        ({"detector.shutter": "rolling", "detector.row_readout_us": 2.0, **REGION}, 0.5 + 2.0 * 0.399),
        ({"detector.laser_off_frame": True, "detector.row_readout_us": 2.0, **REGION}, 2 * 2.0 * 0.399),
        ({**MULTIPLE, "detector.row_readout_us": 2.0, **REGION}, 2.0 * 0.399 + 2.0 * 0.399 + 2.0),
        ({"detector.laser_off_frame": True}, 1.0),
        ({**MULTIPLE, "detector.laser_off_frame": True}, 2 * 2.6),
        (AUTOMATIC, 4.0),
    ],
)
def test_profiles_follow_one_another_after_exposure_and_read_out(settings, milliseconds) -> None:
    assert 1e3 * profile_time(sensor(**settings)) == pytest.approx(milliseconds)


@pytest.mark.parametrize("words", [{}, {"detector.laser_off_frame": True}, MULTIPLE, AUTOMATIC])
def test_spacing_by_the_sensor_is_the_way_from_profile_to_profile(words) -> None:
    settings = {"detector.row_readout_us": 2.0, **REGION, **words}
    path = {"speed_mm_s": 30, "pitch_mm": "sensor", "spiral": {}}
    spacing = {"scan.sweep.angle_step_deg": "sensor", "scan.raster.pitch_mm": "sensor", "scan.path": [path]}
    setup = load_setup(settings={**{f"sensor.{key}": value for key, value in settings.items()}, **spacing})
    period, options = profile_time(setup.sensor), scan_options(setup.scan, setup.sensor)
    assert options.spacing.angle == pytest.approx(np.radians(setup.scan.sweep.speed_deg_s) * period)
    assert options.spacing.pitch == pytest.approx(1e-3 * setup.scan.raster.speed_mm_s * period)
    assert options.scan.path[0].pitch_mm == pytest.approx(30.0 * period)
    assert options.spacing.is_least_angle
    assert options.spacing.is_least_pitch
    default = load_setup()
    assert not scan_options(default.scan, default.sensor).spacing.is_least_pitch


@pytest.mark.parametrize("key", ["sweep.angle_step_deg", "raster.pitch_mm", "path[1].pitch_mm"])
def test_scans_at_rest_have_no_rate(key) -> None:
    settings = {"scan.mode": "stop-and-look", "scan.path": [{"spiral": {}}], f"scan.{key}": "sensor"}
    with pytest.raises(DescriptionError, match=key.replace("[", r"\[")):
        load_setup(settings=settings)


@pytest.mark.parametrize(
    ("settings", "fragment"),
    [
        ({"exposure.mode": "multiple"}, "further_ms"),
        ({"exposure.further_ms": [1.0]}, "further_ms"),
        ({"exposure.mode": "automatic", "exposure.shortest_ms": 0.1}, "longest_ms"),
        ({**AUTOMATIC, "exposure.shortest_ms": 5.0}, "must not exceed"),
        ({**AUTOMATIC, "exposure.shortest_ms": 0.6}, "detector.exposure_ms"),
        ({"exposure.mode": "bracketed"}, "multiple"),
        ({"exposure.mode": "multiple", "exposure.further_ms": [0.0]}, "greater than or equal to"),
        ({"detector.shutter": "rolling"}, "row_readout_us"),
        ({**MULTIPLE, "extraction.fusion": "weighted"}, "fusion"),
    ],
)
def test_incomplete_descriptions_are_refused(settings, fragment) -> None:
    with pytest.raises(DescriptionError, match=fragment):
        sensor(**settings)


class Surface:
    """A camera in front of a surface: its brightest pixels are proportional to the exposure time, up to saturation."""

    def __init__(self, description) -> None:
        detector = description.detector
        self.black = detector.black_level_dn
        self.full = min(2.0**detector.bit_depth - 1, self.black + detector.gain_dn_per_e * detector.full_well_e)

    def signal(self, duration: float, light: float) -> np.ndarray:
        """`light`: signal over saturation after 1 ms."""
        level = self.black + (self.full - self.black) * light * 1e3 * duration
        return np.full(100, min(level, self.full))


def settled(light: float, profiles: int = 60, first_ms: float = 0.5, **options) -> float:
    """Exposure time of the last profile of a surface of even light, ms."""
    description = sensor(**{**AUTOMATIC, "detector.exposure_ms": first_ms, **options})
    control, surface = AutomaticExposure(description), Surface(description)
    last = 0.0
    for _ in range(profiles):
        last = float(control.next(1)[0, 0, 1])
        control.learn([surface.signal(last, light)])
    return 1e3 * last


@pytest.mark.parametrize("light", [0.2, 0.6, 3.0, 11.0])
@pytest.mark.parametrize("first_ms", [0.05, 0.5, 4.0])
def test_automatic_exposure_reaches_the_target(light, first_ms) -> None:
    assert settled(light, first_ms=first_ms) * light == pytest.approx(0.6, rel=0.06)
    assert settled(light, first_ms=first_ms, **{"exposure.target": 0.2}) * light == pytest.approx(
        np.clip(0.2, 0.05 * light, 4.0 * light), rel=0.06
    )


@pytest.mark.parametrize(("change", "kept"), [(0.96, True), (1.04, True), (0.94, False), (1.06, False)])
def test_automatic_exposure_ignores_changes_below_5_percent(change, kept) -> None:
    expected = 0.5 if kept else 0.5 / change
    assert settled(1.2 * change) == pytest.approx(expected, rel=2e-2 if not kept else 1e-12)


@pytest.mark.parametrize(("light", "limit"), [(0.001, 4.0), (0.0, 4.0), (1000.0, 0.05)])
def test_automatic_exposure_stays_within_its_limits(light, limit) -> None:
    assert settled(light) == pytest.approx(limit)


@pytest.mark.parametrize("delay", [1, 3])
def test_an_image_sets_the_profile_after_the_delay(delay) -> None:
    description = sensor(**{**AUTOMATIC, "exposure.delay": delay})
    control, surface = AutomaticExposure(description), Surface(description)
    durations: list[float] = []
    for _ in range(4 * delay):
        durations.append(float(control.next(1)[0, 0, 1]))
        control.learn([surface.signal(durations[-1], 0.3)])
    changes = [i for i in range(1, len(durations)) if durations[i] != durations[i - 1]]
    assert changes == [delay]  # light below saturation: one image tells all


@pytest.mark.parametrize("sizes", [(1,), (2, 1), (64,)])
def test_automatic_exposure_does_not_depend_on_how_profiles_are_grouped(sizes) -> None:
    description = sensor(**{**AUTOMATIC, "exposure.delay": 4})
    light = np.random.default_rng(1).uniform(0.1, 20.0, 40)

    def durations(groups) -> list[float]:
        control, surface, found = AutomaticExposure(description), Surface(description), []
        while len(found) < len(light):
            windows = control.next(min(groups[len(found) % len(groups)], len(light) - len(found)))
            first = len(found)
            found += windows[:, 0, 1].tolist()
            control.learn([surface.signal(found[i], light[i]) for i in range(first, len(found))])
        return found

    assert durations(sizes) == durations((4,))


def test_the_same_exposures_for_every_profile() -> None:
    windows = exposure_windows(sensor(**MULTIPLE))
    np.testing.assert_array_equal(SameExposures(windows).next(5), np.stack([windows] * 5))
    assert SameExposures(None).next(5) is None


SATURATED, STEP = PEAK_FLAGS["saturated"], PEAK_FLAGS["step"]


def points(rows: list[tuple[int, int, int, int, float, int]]) -> tuple[ProfilePoints, np.ndarray]:
    """Points from (frame, camera, column, number, sigma, flags)."""
    frame, camera, column, number, sigma, flags = (np.array(part) for part in zip(*rows, strict=True))
    n = len(rows)
    position = np.arange(3.0 * n).reshape(n, 3)
    return ProfilePoints(position, sigma, sigma, camera, column, frame, flags.astype(np.uint32), np.zeros(n)), number


def test_a_column_keeps_the_surest_unsaturated_exposure() -> None:
    found = points(
        [
            (0, 0, 5, 0, 3.0, 0),
            (0, 0, 5, 1, 1.0, 0),
            (0, 0, 6, 0, 3.0, 0),
            (0, 0, 6, 1, 1.0, SATURATED),
            (0, 0, 7, 1, 2.0, SATURATED),
            (0, 1, 5, 0, 3.0, 0),
            (1, 0, 5, 2, 3.0, SATURATED),
        ]
    )
    assert surest(*found).tolist() == [1, 2, 4, 5, 6]


def test_a_column_whose_surest_peak_is_rejected_keeps_none() -> None:
    found = points(
        [
            (0, 0, 5, 0, 3.0, 0),
            (0, 0, 5, 1, 1.0, STEP),
            (0, 0, 6, 0, 3.0, STEP),
            (0, 0, 6, 1, 1.0, 0),
            (0, 0, 7, 0, 3.0, 0),
            (0, 0, 7, 1, 1.0, SATURATED | STEP),
        ]
    )
    assert surest(*found).tolist() == [3, 4]


def test_all_points_of_the_chosen_exposure_in_a_column_are_kept() -> None:
    found = points([(0, 0, 5, 0, 2.0, 0), (0, 0, 5, 1, 1.0, 0), (0, 0, 5, 1, 3.0, 0)])
    assert surest(*found).tolist() == [1, 2]


def test_no_points_stay_none() -> None:
    some, number = points([(0, 0, 5, 0, 2.0, 0)])
    assert len(surest(some[np.zeros(1, bool)], number[:0])) == 0
