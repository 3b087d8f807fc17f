"""Random views of an artefact for calibration: where they look, from which distance, and how obliquely."""

from __future__ import annotations

import numpy as np
import pytest
from cells import planning_cell
from numpy.typing import NDArray

from scancell.calibration.cell.views import candidates
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh

Array = NDArray[np.float64]


def plate() -> Mesh:
    """A square of 40 mm at z = 20 mm that faces upwards."""
    corners = 0.02 * np.array([[-1.0, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]])
    return Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]]), "plate")


@pytest.mark.parametrize("turn_table", [False, True])
def test_views_look_at_the_surface_within_range_and_tilt(turn_table: bool) -> None:
    cell = planning_cell(plate())
    found = candidates(cell, 300, np.random.default_rng(1), 0.005, turn_table)
    views = cell.nominal.part_from_sensor(found)
    rotation = views[:, :3, :3]
    np.testing.assert_allclose(
        rotation @ np.swapaxes(rotation, 1, 2), np.tile(np.eye(3), (len(views), 1, 1)), atol=1e-9
    )
    tilt = np.arccos(-rotation[:, 2, 2])
    assert tilt.max() <= np.radians(50.0) + 1e-6
    assert np.median(tilt) > np.radians(20.0)
    # The middle part of the laser line, in the middle of the range, meets the plate where it looks.
    near, far = cell.range.near, cell.range.far
    share = np.linspace(0.15, 0.85, 200)
    along = np.linspace(-0.5, 0.5, 101)
    z = near + share * (far - near)
    seen = np.stack([0 * z[:, None] * along, along * cell.range.half_line(z)[:, None], z[:, None] + 0 * along], -1)
    for view in views[::10]:
        points = pose.transform_points(view, seen.reshape(-1, 3))
        assert np.abs(points - np.clip(points, [-0.02, -0.02, 0.02], [0.02, 0.02, 0.02])).max(1).min() < 1e-3
    assert (np.ptp(found[:, -1]) > 3.0) == turn_table
