"""Geometry of the ground truth: places on triangles, columns crossed by the stripe."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from orchestrator.cell.recording import Recording
from orchestrator.config import load_setup
from orchestrator.errors import SensorError
from orchestrator.evaluation.ground_truth import TrueWorld, _crossings, onto_triangles


def test_points_outside_their_triangle_move_to_its_nearest_place() -> None:
    random = np.random.default_rng(1)
    corners = random.normal(size=(500, 3, 3))
    weights = random.uniform(-0.6, 1.2, size=(500, 3))
    weights /= weights.sum(1, keepdims=True)
    points = np.einsum("nc,ncj->nj", weights, corners)
    inside = (weights >= 0).all(1)
    assert 50 < inside.sum() < 450
    moved = onto_triangles(points, corners)
    assert (moved[inside] == points[inside]).all()
    np.testing.assert_allclose(moved, trimesh.triangles.closest_point(corners, points), atol=1e-9)


@pytest.mark.parametrize("direction", [1, -1])
def test_a_stripe_is_found_in_every_column_that_it_crosses(direction) -> None:
    """A straight stripe with a gap of two columns, seen by rays that land in rising or falling order."""
    columns = np.concatenate([np.arange(2.1, 6.0, 0.3), np.arange(8.05, 11.0, 0.3)])[::direction]
    pixels = np.stack([columns, 100 + 0.5 * columns], -1)
    frame, camera = np.zeros(len(columns), np.int64), np.ones(len(columns), np.int64)
    _, seen_by, found, row = _crossings(frame, camera, pixels)
    assert sorted(found.tolist()) == [3, 4, 5, 9, 10]
    np.testing.assert_allclose(row, 100 + 0.5 * found, atol=1e-12)
    assert (seen_by == 1).all()


def test_a_jump_between_surfaces_is_no_stripe() -> None:
    pixels = np.array([[1.9, 100.0], [2.05, 100.0], [2.2, 150.0], [3.1, 150.2]])
    _, _, found, row = _crossings(np.zeros(4, np.int64), np.zeros(4, np.int64), pixels)
    assert found.tolist() == [2, 3]
    assert row.max() < 151
    assert row[0] == pytest.approx(100.0)


def test_a_rolling_shutter_is_refused() -> None:
    words = ['sensor.detector.shutter="rolling"', "sensor.detector.row_readout_us=10"]
    with pytest.raises(SensorError, match="ground truth needs a global shutter"):
        TrueWorld(Recording({}), [], load_setup(overrides=words).sensor, 0, 1)
