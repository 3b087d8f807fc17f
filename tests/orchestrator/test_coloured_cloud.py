"""Colours of a measured cloud in pictures: each point has the colour of its value on the scale."""

from __future__ import annotations

import numpy as np
import pytest
from cells import block, cloud_of

from scancell.output.deviation_report import deviation_colours
from scancell.views.renderer import ColouredCloud, coloured_by, displayed


def above_top(deviation: np.ndarray, **columns: np.ndarray) -> ColouredCloud:
    """Points at distances, m, from the top of a block of 20 mm."""
    x, y = np.random.default_rng(6).uniform(-0.02, 0.02, (2, len(deviation)))
    cloud = cloud_of(np.column_stack([x, y, 0.02 + deviation]), **columns)
    what = "intensity" if columns else "deviation"
    return coloured_by(cloud, 3 * len(cloud), block(0.06, 0.06, 0.02), what, threads=1)


def test_deviations_have_the_colours_of_their_scale() -> None:
    deviation = np.random.default_rng(7).normal(0.0, 20e-6, 400)
    found = above_top(deviation)
    low, high = found.limits
    assert low == -high < -20.0
    np.testing.assert_allclose(displayed(found.colours), deviation_colours(1e6 * deviation, high), atol=3)
    np.testing.assert_allclose(found.scale, deviation_colours(np.linspace(low, high, 256), high), atol=3)
    assert found.total == 1200
    # As many points as cover the block at this distance from each other.
    assert found.spacing == pytest.approx(np.sqrt((2 * 0.06**2 + 4 * 0.06 * 0.02) / 400))


def test_intensities_become_brighter_up_to_the_limit() -> None:
    found = above_top(np.zeros(200), intensity=np.arange(200.0))
    assert found.limits == pytest.approx((0.0, 0.99 * 199))
    brightness = displayed(found.colours).astype(int).sum(1)
    assert (np.diff(brightness) >= -2).all()
    assert brightness[-1] == pytest.approx(found.scale[-1].sum(), abs=2)
    assert (np.diff(found.scale.sum(1)) > 0).all()
