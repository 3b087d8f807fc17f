"""Geometry of the ground truth: points on triangles, columns crossed by the stripe."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from scancell.cell.recording import Recording
from scancell.config.loading import load_setup
from scancell.errors import SensorError
from scancell.evaluation.ground_truth import (
    Stripe,
    Surface,
    TrueWorld,
    _crossings,
    _groups,
    _true_row,
    clamp_to_triangles,
)


def test_clamp_to_triangles_matches_trimesh() -> None:
    random = np.random.default_rng(1)
    corners = random.normal(size=(500, 3, 3))
    weights = random.uniform(-0.6, 1.2, size=(500, 3))
    weights /= weights.sum(1, keepdims=True)
    points = np.einsum("nc,ncj->nj", weights, corners)
    inside = (weights >= 0).all(1)
    assert 50 < inside.sum() < 450
    moved = clamp_to_triangles(points, corners)
    assert (moved[inside] == points[inside]).all()
    np.testing.assert_allclose(moved, trimesh.triangles.closest_point(corners, points), atol=1e-9)


@pytest.mark.parametrize("direction", [1, -1])
def test_crossings_of_all_columns(direction) -> None:
    """A straight stripe with a gap of two columns, in ascending or descending order of columns."""
    columns = np.concatenate([np.arange(2.1, 6.0, 0.3), np.arange(8.05, 11.0, 0.3)])[::direction]
    pixels = np.stack([columns, 100 + 0.5 * columns], -1)
    frame, camera = np.zeros(len(columns), np.int64), np.ones(len(columns), np.int64)
    _, seen_by, found, row = _crossings(frame, camera, pixels)
    assert sorted(found.tolist()) == [3, 4, 5, 9, 10]
    np.testing.assert_allclose(row, 100 + 0.5 * found, atol=1e-12)
    assert (seen_by == 1).all()


def test_depth_discontinuity_is_not_crossed() -> None:
    pixels = np.array([[1.9, 100.0], [2.05, 100.0], [2.2, 150.0], [3.1, 150.2]])
    _, _, found, row = _crossings(np.zeros(4, np.int64), np.zeros(4, np.int64), pixels)
    assert found.tolist() == [2, 3]
    assert row.max() < 151
    assert row[0] == pytest.approx(100.0)


def test_rolling_shutter_is_rejected() -> None:
    words = ['sensor.detector.shutter="rolling"', "sensor.detector.row_readout_us=10"]
    with pytest.raises(SensorError, match="ground truth needs a global shutter"):
        TrueWorld(Recording({}), [], load_setup(settings=words).sensor, 0, 1)


def test_the_true_row_between_columns_lies_between_theirs() -> None:
    """A slanted stripe with a step of 40 rows between columns 4 and 5, and nothing beyond column 8."""
    column = np.arange(9)
    row = 100 + 0.5 * column + 40 * (column > 4)
    none = np.full((9, 3), np.nan)
    surface = Surface(none, none, np.full(9, -1), np.full(9, -1))
    stripe = Stripe(np.zeros(9, np.int64), np.zeros(9, np.int64), column, row, surface)
    places = np.array([0.0, 2.0, 2.25, 4.4, 4.6, 8.0, 8.4, 8.6])
    n = np.zeros(len(places), np.int64)
    found = _true_row(stripe, n, n, places, 100 + 0.5 * places)
    np.testing.assert_allclose(found, [100.0, 101.0, 101.125, 102.0, 142.5, 104.0 + 40, 144.0, 144.0])


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_groups_hold_each_kept_entry_once_and_one_exposure_of_one_camera(share: float) -> None:
    rng = np.random.default_rng(3)
    exposure, camera = rng.integers(0, 4, 60), rng.integers(0, 2, 60)
    kept = rng.random(60) < share
    groups = _groups(exposure, camera, kept)
    assert sorted(index for group in groups for index in group) == np.flatnonzero(kept).tolist()
    keys = [{(int(exposure[index]), int(camera[index])) for index in group} for group in groups]
    assert all(len(key) == 1 for key in keys)
    assert len(set.union(set(), *keys)) == len(groups)
