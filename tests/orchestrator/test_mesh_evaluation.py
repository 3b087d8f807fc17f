"""Clouds against meshes: alignment with known poses, distances against an independent computation, regions."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from scancell.config.loading import assets_dir
from scancell.errors import FitError
from scancell.evaluation.alignment import DatumPlane, best_fit, datum_fit
from scancell.evaluation.mesh_evaluation import evaluate_against_mesh
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh, load_mesh
from scancell.geometry.regions import smooth_regions
from scancell.geometry.sampling import sample_surface
from scancell.geometry.shapes import Cylinder


def mesh_of(solid: trimesh.Trimesh) -> Mesh:
    return Mesh(np.asarray(solid.vertices, float), np.asarray(solid.faces, np.int64), "solid")


BOX = mesh_of(trimesh.creation.box((0.08, 0.06, 0.04)))
MOVED = pose.from_rotation(Rotation.from_rotvec([0.02, -0.01, 0.03]).as_matrix(), [0.8e-3, -0.5e-3, 1.1e-3])


@pytest.fixture(scope="module")
def free_form() -> Mesh:
    return load_mesh(assets_dir() / "parts" / "free_form.stl")


def test_best_fit_recovers_the_pose_of_a_free_form(free_form: Mesh) -> None:
    points = pose.transform_points(MOVED, sample_surface(free_form, 20_000, 1)[0])
    found = evaluate_against_mesh(points, free_form, "best-fit")
    assert np.abs(found.part_from_cloud @ MOVED - np.eye(4)).max() < 1e-9
    assert found.figures.max_abs < 1e-8


def test_best_fit_averages_noise_and_ignores_outliers(free_form: Mesh) -> None:
    rng = np.random.default_rng(2)
    points, face = sample_surface(free_form, 20_000, 1)
    points = points + 10e-6 * rng.standard_normal((len(points), 1)) * free_form.normals[face]
    points[:200] += 2e-3 * rng.standard_normal((200, 3))
    found = evaluate_against_mesh(pose.transform_points(MOVED, points), free_form, "best-fit")
    error = found.part_from_cloud @ MOVED
    assert np.linalg.norm(error[:3, 3]) < 2e-6
    assert np.linalg.norm(pose.log_rotation(error[:3, :3])) < 5e-5


def test_distances_agree_with_an_independent_computation(free_form: Mesh) -> None:
    rng = np.random.default_rng(3)
    points = sample_surface(free_form, 300, 4)[0] + 1e-3 * rng.standard_normal((300, 3))
    found = evaluate_against_mesh(points, free_form)
    solid = trimesh.Trimesh(1e3 * free_form.vertices, free_form.faces, process=False)
    _, distance, _ = trimesh.proximity.closest_point_naive(solid, 1e3 * points)
    assert np.abs(np.abs(found.signed) - 1e-3 * distance).max() < 1e-8


def test_motions_that_a_surface_leaves_free_stay_zero() -> None:
    cylinder = Cylinder(0.02, 0.2)
    turn, height = np.random.default_rng(5).uniform(-1, 1, (2, 500)) * [[np.pi], [0.03]]
    points = np.stack([0.02 * np.cos(turn), 0.02 * np.sin(turn), height], 1)
    moved = pose.from_rotation(pose.exp_rotation([0.01, 0.0, 0.0]), [0.3e-3, 0.2e-3, 0.0])
    found = best_fit(pose.transform_points(moved, points), cylinder.nearest)
    assert np.abs(cylinder.nearest(pose.transform_points(found @ moved, points))[0]).max() < 1e-10
    # Much smaller than the corrections of 0.01 rad and 0.36 mm.
    assert abs(pose.log_rotation((found @ moved)[:3, :3])[2]) < 1e-3
    assert abs((found @ moved)[2, 3]) < 1e-5


def test_datum_takes_planes_in_order_of_precedence() -> None:
    """A box whose end face is not square: the primary and secondary planes fit, the third only by its offset."""
    points, face = sample_surface(BOX, 6000, 6)
    tilted = BOX.normals[face][:, 0] > 0.9
    points[tilted, 0] += 0.01 * points[tilted, 2]
    sides = [BOX.normals[face] @ np.eye(3)[axis] > 0.9 for axis in (2, 1, 0)]
    planes = [
        (DatumPlane(size * axis, axis), pose.transform_points(MOVED, points[side]))
        for size, axis, side in zip((0.02, 0.03, 0.04), np.eye(3)[::-1], sides, strict=True)
    ]
    found = datum_fit(planes) @ MOVED
    assert np.abs(found[:3, :3] - np.eye(3)).max() < 1e-9
    assert np.abs(found[1:3, 3]).max() < 1e-12
    assert abs(found[0, 3] + 0.01 * points[tilted, 2].mean()) < 1e-9
    with pytest.raises(FitError, match="three directions"):
        datum_fit([planes[0], planes[0], planes[1]])


def test_datum_of_a_mesh_finds_its_largest_planes() -> None:
    points = sample_surface(BOX, 20_000, 7)[0]
    found = evaluate_against_mesh(pose.transform_points(MOVED, points), BOX, "datum")
    assert np.abs(found.part_from_cloud @ MOVED - np.eye(4)).max() < 1e-9
    with pytest.raises(FitError, match="region 9"):
        evaluate_against_mesh(points, BOX, "datum", (0, 1, 9))


def test_regions_of_a_box_and_a_cylinder() -> None:
    regions = smooth_regions(BOX)
    assert regions.areas == pytest.approx([48e-4, 48e-4, 32e-4, 32e-4, 24e-4, 24e-4])
    assert regions.is_plane.all()
    cylinder = smooth_regions(Cylinder(0.02, 0.05).mesh())
    assert cylinder.is_plane.tolist() == [False, True, True]
    assert cylinder.areas[0] == pytest.approx(2 * np.pi * 0.02 * 0.05, rel=1e-3)


def test_figures_and_coverage_by_region() -> None:
    points, face = sample_surface(BOX, 20_000, 8)
    up = BOX.normals[face][:, 2] > 0.9
    found = evaluate_against_mesh(points[up] + np.array([0, 0, 7e-6]), BOX, tolerance=2e-3)
    (region,) = (number for number, figures in found.by_region.items() if figures.count > 100)
    assert found.regions.normals[region] == pytest.approx([0, 0, 1])
    assert found.by_region[region].mean == pytest.approx(7e-6, abs=1e-8)
    assert found.region_coverage[region] > 0.99
    assert 48 / 208 <= found.coverage <= (48 + 0.2 * 28 * 1.1) / 208  # and 2 mm of the sides below the edges
    assert sum(figures.count for figures in found.by_region.values()) == len(found.signed)
