"""Statistics of readings of a plane target, against readings of known noise."""

from __future__ import annotations

import numpy as np
import pytest

from scancell.evaluation.plane_trial import PlaneReading, PlaneTarget

BIAS, NOISE, SHIFT = 3e-6, 2e-6, 5e-6  # m: of all points, of a point, and of the exposures


def reading(exposures: int = 400, columns: int = 200, outliers: int = 0) -> PlaneReading:
    """Of a camera whose points lie at equal distances on the line, half of them seen in each exposure."""
    rng = np.random.default_rng(1)
    y = np.linspace(-0.01, 0.01, columns)
    seen = rng.random((exposures, columns)) < 0.5
    frame, column = np.nonzero(seen)
    signed = BIAS + NOISE * rng.standard_normal(len(frame)) + SHIFT * rng.standard_normal(exposures)[frame]
    signed[:outliers] += 1e-3
    points = np.column_stack([np.zeros(len(frame)), y[column], 0.1 + signed])
    target = PlaneTarget(0.1)
    return PlaneReading(target, exposures, points, signed, frame, np.zeros_like(frame), column, (-0.01, 0.01))


def test_bias_and_spread_are_those_of_the_points() -> None:
    figures = reading().figures()
    assert figures.bias == pytest.approx(BIAS, abs=4 * SHIFT / 20)
    assert figures.std == pytest.approx(np.hypot(NOISE, SHIFT), rel=0.1)


def test_repeatability_of_a_point_holds_the_shift_of_the_exposures_and_its_noise() -> None:
    figures = reading().figures()
    assert figures.repeatability_of_point == pytest.approx(np.hypot(NOISE, SHIFT), rel=0.1)
    assert figures.repeatability_of_mean == pytest.approx(np.hypot(SHIFT, NOISE / 10), rel=0.1)


def test_noise_is_about_the_means_of_blocks() -> None:
    """A distance that depends on the place alone is form, no noise."""
    wavy = reading()
    even = PlaneReading(
        wavy.target,
        wavy.exposures,
        wavy.points_in_sensor,
        1e-3 * np.floor(wavy.column * 16 / 200),
        wavy.frame,
        wavy.camera,
        wavy.column,
        wavy.line,
    )
    assert even.figures().std > 1e-3
    assert even.figures().noise < 0.3 * even.figures().std
    assert wavy.figures().noise == pytest.approx(np.hypot(NOISE, SHIFT), rel=0.1)


def test_outliers_and_missing_points_are_counted() -> None:
    figures = reading(outliers=60).figures()
    assert figures.points == len(reading().signed)
    assert figures.outlier_rate == pytest.approx(60 / figures.points, rel=0.02)
    # Two columns in each bin: it stays empty in a quarter of the exposures.
    assert figures.missing_rate == pytest.approx(0.25, abs=0.02)


def test_reading_without_points_has_no_figures() -> None:
    whole = reading()
    none = PlaneReading(
        whole.target,
        whole.exposures,
        whole.points_in_sensor[:0],
        whole.signed[:0],
        whole.frame[:0],
        whole.camera[:0],
        whole.column[:0],
        whole.line,
    )
    figures = none.figures()
    assert (figures.points, figures.missing_rate) == (0, 1.0)
    assert np.isnan(figures.bias)
