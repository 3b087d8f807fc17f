"""Evidence of free and occupied space from profiles made by hand."""

from __future__ import annotations

import numpy as np
import pytest
from cells import RANGE

from scancell.geometry.mesh import Mesh, box_mesh
from scancell.geometry.pose import translation
from scancell.planning.space_map import Profiles, SpaceMap

VOXEL = 0.005
HEIGHT = 0.2
FAR_AWAY = box_mesh((0.01, 0.01, 0.01)).transformed(translation((1.0, 0.0, 0.0)))
RASTER = np.arange(-0.0775, 0.08, VOXEL)  # wide enough for the lines to the cameras
DOWN = np.diag([1.0, -1.0, -1.0, 1.0])


def looking_down(height: float, xs=(0.0,), points=()) -> Profiles:
    """Exposures from heights above the table at places on x; points (exposure, y, depth) in the sensor frame."""
    poses = np.array([translation((x, 0.0, height)) @ DOWN for x in xs])
    rows = np.array(points, float).reshape(-1, 3)
    return Profiles(poses, np.column_stack([np.zeros(len(rows)), rows[:, 1:]]), rows[:, 0].astype(np.int64))


def space(known: Mesh = FAR_AWAY) -> SpaceMap:
    return SpaceMap(0.1, HEIGHT, VOXEL, known, 1e-3)


def depths_freed(map_: SpaceMap, height: float) -> np.ndarray:
    """Depths below the sensor of the free voxels on its axis."""
    i, j, _ = map_.grid.index([1e-4, 1e-4, 0.1])
    return height - map_.grid.centres[i, j, map_.free[i, j], 2]


def test_region_leaves_out_the_voxels_that_a_known_body_may_reach() -> None:
    """Those whose centre is nearer to it than half the diagonal of a voxel, and no others of the cylinder."""
    size, middle = np.array([0.04, 0.03, 0.02]), np.array([0.021, -0.013, 0.052])
    map_ = space(box_mesh((0.04, 0.03, 0.02)).transformed(translation(middle)))
    centres = map_.grid.centres
    distance = np.linalg.norm(np.maximum(np.abs(centres - middle) - size / 2, 0.0), axis=-1)
    inside = np.hypot(centres[..., 0], centres[..., 1]) <= 0.1
    reach = np.sqrt(3) / 2 * VOXEL
    assert not (map_.region & (distance < reach - 1e-6)).any()
    assert map_.region[inside & (distance > reach + 1e-6)].all()
    assert not map_.region[~inside].any()


def test_empty_ray_frees_the_measuring_range_and_no_more() -> None:
    map_, height = space(), HEIGHT + RANGE.near
    map_.add(looking_down(height, RASTER), RANGE)
    freed = depths_freed(map_, height)
    assert len(freed) == pytest.approx((RANGE.far - RANGE.near) / VOXEL, abs=2)
    assert freed.min() >= RANGE.near - VOXEL
    assert freed.max() <= RANGE.far + VOXEL
    across = map_.grid.centres[map_.free]
    assert np.abs(across[:, 1]).max() <= RANGE.half_far + VOXEL
    assert np.abs(across[:, 0]).max() <= RASTER.max() + VOXEL


def test_single_exposure_sees_only_what_lies_on_free_lines_to_its_cameras() -> None:
    """The cameras look past the sheet: what they look through has to be free, too."""
    map_, height = space(), HEIGHT + RANGE.near
    map_.add(looking_down(height), RANGE)
    freed = depths_freed(map_, height)
    assert len(freed) <= 2
    assert (freed <= RANGE.near + 2 * VOXEL).all()


def test_empty_ray_proves_nothing_where_the_way_to_the_range_is_unseen() -> None:
    """Something in front of the measuring range would block the laser without a point."""
    map_ = space()
    map_.add(looking_down(HEIGHT + RANGE.near - 4 * VOXEL), RANGE)
    assert not map_.free.any()


def test_layers_lead_down_to_the_table() -> None:
    map_, height = space(), HEIGHT + RANGE.near
    while height > RANGE.near:
        map_.add(looking_down(height, RASTER), RANGE)
        height -= RANGE.far - RANGE.near - 2 * VOXEL
    i, j, _ = map_.grid.index([1e-4, 1e-4, 0.1])
    assert map_.free[i, j].all()


def test_point_is_occupied_and_hides_what_is_behind() -> None:
    map_, height, depth = space(), HEIGHT + RANGE.near, 0.1
    points = [(0, y, depth) for y in np.linspace(-0.02, 0.02, 200)]
    map_.add(looking_down(height, points=points), RANGE)
    freed = depths_freed(map_, height)
    assert freed.max() <= depth + VOXEL
    assert freed.min() <= RANGE.near + VOXEL
    z = map_.grid.centres[map_.occupied][:, 2]
    assert len(z) >= 0.04 / VOXEL
    np.testing.assert_allclose(z, height - depth, atol=VOXEL)
    assert not (map_.blocked(0.0).occupied & map_.free & ~map_.occupied).any()


def test_point_on_a_known_body_is_not_occupied() -> None:
    plate = box_mesh((0.2, 0.2, 0.02)).transformed(translation((0.0, 0.0, 0.09)))
    map_, height = space(plate), HEIGHT + RANGE.near
    points = [(0, y, height - 0.1) for y in np.linspace(-0.02, 0.02, 200)]
    map_.add(looking_down(height, points=points), RANGE)
    assert not map_.occupied.any()
    assert map_.free.any()


@pytest.mark.parametrize(("gap", "deep"), [(0.015, False), (0.075, True)])
def test_space_that_no_camera_would_see_stays_unseen(gap, deep) -> None:
    """The laser shines between two plates, which are in the way of the cameras if they are near enough."""
    plates = [
        box_mesh((0.07, 0.1, 0.004)).transformed(translation((side * (gap + 0.035), 0.0, 0.165))) for side in (-1, 1)
    ]
    vertices = np.concatenate([plate.vertices for plate in plates])
    both = Mesh(vertices, np.concatenate([plates[0].faces, plates[1].faces + len(plates[0].vertices)]))
    map_, height = space(both), HEIGHT + RANGE.near
    map_.take_as_free(box_mesh((0.3, 0.3, 0.15)).transformed(translation((0.0, 0.0, 0.225))), 0.0)
    xs = np.arange(-gap + 2 * VOXEL, gap - VOXEL, VOXEL)
    map_.add(looking_down(height, xs), RANGE)
    assert (depths_freed(map_, height).max() > height - 0.13) == deep


def test_inflated_points_are_blocked_even_where_rays_passed() -> None:
    map_, height = space(), HEIGHT + RANGE.near
    map_.add(looking_down(height, RASTER), RANGE)
    before = map_.blocked(0.01).occupied
    map_.add(looking_down(height, points=[(0, 0.0, 0.05 + RANGE.near)]), RANGE)
    new = map_.grid.centres[map_.blocked(0.01).occupied & ~before]
    assert len(new) > 50
    assert np.linalg.norm(new[:, :2], axis=1).max() <= 0.01 + 2 * np.sqrt(3) * VOXEL
    assert new[:, 2].max() <= 0.15 + 0.01 + 2 * VOXEL


def test_nothing_below_a_measured_point_counts_as_free() -> None:
    """Rays beside a thin rod look empty, because its sides return no light."""
    map_, height = space(), HEIGHT + RANGE.near
    map_.add(looking_down(height, RASTER), RANGE)
    i, j, _ = map_.grid.index([1e-4, 1e-4, 0.1])
    assert map_.free[i, j].any()
    map_.add(looking_down(height, points=[(0, 0.0, 0.02 + RANGE.near)]), RANGE)
    blocked = map_.blocked(0.0).occupied[i, j]
    top = map_.grid.index([0.0, 0.0, height - 0.02 - RANGE.near])[2]
    assert blocked[: top + 1].all()
    assert not blocked[top + 1 :].any()


def test_inflation_blocks_the_neighbours_of_unseen_voxels() -> None:
    map_, height = space(), HEIGHT + RANGE.near
    map_.add(looking_down(height, RASTER), RANGE)
    strict, wide = (map_.blocked(inflation).occupied for inflation in (0.0, 0.001))
    np.testing.assert_array_equal(strict, map_.unseen)
    beside = np.zeros_like(strict)
    beside[:, :, 1:] = strict[:, :, :-1]
    assert wide[beside & map_.region].all()
