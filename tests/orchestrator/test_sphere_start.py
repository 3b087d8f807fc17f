"""Circles in profiles of a sphere."""

from __future__ import annotations

import numpy as np
import pytest

from scancell.calibration.cell.solve import circle_in

CENTRE, RADIUS = np.array([0.004, 0.12]), 0.01


def arc(count: int, noise: float = 0.0) -> np.ndarray:
    """Points (count, 2) on the side of the circle that faces the sensor."""
    rng = np.random.default_rng(2)
    angle = np.linspace(-2.6, -0.5, count)
    radius = RADIUS + noise * rng.standard_normal(count)
    return CENTRE + radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])


@pytest.mark.parametrize(("count", "is_found"), [(19, False), (20, True), (200, True)])
def test_circle_needs_twenty_points(count: int, is_found: bool) -> None:
    found = circle_in(arc(count), 0.0, 1.01 * RADIUS, np.random.default_rng(1))
    assert (found is not None) == is_found
    if found is not None:
        np.testing.assert_allclose(found[0], CENTRE, atol=1e-9)
        assert found[1] == pytest.approx(RADIUS)


def test_points_off_the_circle_are_left_out() -> None:
    """The table below the sphere is straight: no circle of that size lies in it."""
    table = np.column_stack([np.linspace(-0.03, 0.03, 150), np.full(150, 0.14)])
    found = circle_in(np.concatenate([arc(200, 5e-6), table]), 5e-6, 1.01 * RADIUS, np.random.default_rng(1))
    assert found is not None
    np.testing.assert_allclose(found[0], CENTRE, atol=5e-6)
    assert found[1] == pytest.approx(RADIUS, abs=5e-6)
    assert circle_in(table, 5e-6, 1.01 * RADIUS, np.random.default_rng(1)) is None


def test_larger_circles_are_not_found() -> None:
    assert circle_in(arc(200), 0.0, 0.9 * RADIUS, np.random.default_rng(1)) is None
