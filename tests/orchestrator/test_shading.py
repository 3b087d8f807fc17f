"""Light of the floor: its grid keeps its amount of darkness at every distance, and it fades by the distance alone."""

from __future__ import annotations

import numpy as np
import pytest

from scancell.views.renderer import FLOOR_END, GRID, backdrop, displayed, floor_light, linear

MIDDLE = np.array([0.7, -0.4, 0.0])
WIDE = 1e3  # m: pixels that average the whole grid


def floor_at(points: np.ndarray, size: float = WIDE, middle: np.ndarray = MIDDLE) -> np.ndarray:
    """Light (n,) of the green channel in the sun."""
    sizes = np.full(len(points), size)
    return floor_light(points, middle, (sizes, sizes), np.ones(len(points)))[:, 1]


@pytest.mark.parametrize("size", [1e-4, 1e-3, 0.02])
def test_darkness_of_grid_lines_does_not_depend_on_the_size_of_pixels(size: float) -> None:
    """Along a line between two parallel grid lines the mean over a period is the same at every distance."""
    along = (np.arange(20_000) + 0.5) / 20_000 * GRID
    points = np.column_stack([along, np.full_like(along, GRID / 2), np.zeros_like(along)])
    sizes = np.full(len(along), size), np.full(len(along), 1e-6)
    light = floor_light(points, np.zeros(3), sizes, np.ones(len(along)))[:, 1]
    line, between = (floor_at(np.array([[x, GRID / 2, 0.0]]), 1e-6, np.zeros(3))[0] for x in (0.0, GRID / 2))
    share = (between - light.mean()) / (between - line)
    assert share == pytest.approx(1.2e-3 / GRID, rel=1e-3)


def test_floor_fades_into_the_backdrop_by_the_distance_from_the_middle() -> None:
    angle = np.linspace(0.0, 2 * np.pi, 12, endpoint=False)
    around = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(12)])
    radii = np.linspace(0.0, 1.2 * FLOOR_END, 40)
    light = np.array([floor_at(MIDDLE + radius * around) for radius in radii])
    np.testing.assert_allclose(light, np.tile(light[:, :1], 12), atol=1e-12)  # the same in all directions
    assert (np.diff(light[:, 0]) >= -1e-12).all()
    np.testing.assert_allclose(light[radii < 1.0], light[0, 0], atol=1e-12)
    np.testing.assert_allclose(light[radii >= FLOOR_END], backdrop(1)[0, 1], atol=1e-12)
    # Half way through the fade the floor is half of each.
    half = floor_at(MIDDLE + (1.0 + FLOOR_END) / 2 * around)
    np.testing.assert_allclose(half, (light[0, 0] + backdrop(1)[0, 1]) / 2, atol=1e-12)


def test_colours_are_displayed_as_they_were_given() -> None:
    colours = [(0.0, 0.5, 1.0), (0.2, 0.7, 0.3)]
    shown = displayed(np.array([linear(colour) for colour in colours]))
    np.testing.assert_allclose(shown / 255, colours, atol=0.5 / 255 + 1e-9)
    assert displayed(np.array([-1.0, 2.0])).tolist() == [0, 255]
