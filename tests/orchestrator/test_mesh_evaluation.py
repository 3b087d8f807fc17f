"""Clouds against meshes: alignment with known poses, distances against an independent computation, regions."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
import trimesh
from cells import mesh_of
from scipy.spatial.transform import Rotation

from scancell.config.loading import assets_dir
from scancell.errors import DescriptionError, FitError
from scancell.evaluation.alignment import DatumPlane, best_fit, datum_fit
from scancell.evaluation.mesh_evaluation import evaluate_against_mesh
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh, load_mesh, sample_surface, smooth_regions
from scancell.geometry.shapes import Cylinder, Sphere

BOX = mesh_of(trimesh.creation.box((0.08, 0.06, 0.04)))
MOVED = pose.from_rotation(Rotation.from_rotvec([0.02, -0.01, 0.03]).as_matrix(), [0.8e-3, -0.5e-3, 1.1e-3])


@pytest.fixture(scope="module")
def free_form() -> Mesh:
    return load_mesh(assets_dir() / "parts" / "free_form.stl")


def test_best_fit_recovers_the_pose_of_a_free_form(free_form: Mesh) -> None:
    points = pose.transform_points(MOVED, sample_surface(free_form, 20_000, 1)[0])
    found = evaluate_against_mesh(points, free_form, "best-fit")
    assert np.abs(found.part_from_cloud @ MOVED - np.eye(4)).max() < 1e-9
    assert found.statistics.max_abs < 1e-8


def test_best_fit_averages_noise_and_ignores_outliers(free_form: Mesh) -> None:
    rng = np.random.default_rng(2)
    points, face = sample_surface(free_form, 20_000, 1)
    points = points + 10e-6 * rng.standard_normal((len(points), 1)) * free_form.normals[face]
    points[:200] += 2e-3 * rng.standard_normal((200, 3))
    found = evaluate_against_mesh(pose.transform_points(MOVED, points), free_form, "best-fit")
    error = found.part_from_cloud @ MOVED
    assert np.linalg.norm(error[:3, 3]) < 2e-6
    assert np.linalg.norm(pose.log_rotation(error[:3, :3])) < 5e-5


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


@pytest.mark.parametrize("count", [1, 2, 3])
def test_datum_of_oblique_planes_brings_them_onto_the_nominal_ones(count: int) -> None:
    """Planes that are not perpendicular, turned by half a radian; one alone is turned the shortest way."""
    normals = np.array([[0.0, 0.0, 1.0], [0.0, 0.8, 0.6], [0.6, 0.0, 0.8]])[:count]
    moved = pose.from_rotation(pose.exp_rotation([0.4, -0.3, 0.2]), [0.02, -0.01, 0.03])
    inside = np.random.default_rng(10).uniform(-0.02, 0.02, (50, 2))
    in_planes = [0.01 * normal + inside @ np.linalg.svd(normal[None])[2][1:] for normal in normals]
    regions = [
        (DatumPlane(0.01 * normal, normal), pose.transform_points(moved, points))
        for normal, points in zip(normals, in_planes, strict=True)
    ]
    found = datum_fit(regions, least=count)
    np.testing.assert_allclose(found[:3, :3] @ found[:3, :3].T, np.eye(3), atol=1e-12)
    for plane, points in regions:
        np.testing.assert_allclose((pose.transform_points(found, points) - plane.point) @ plane.normal, 0, atol=1e-12)
    if count == 1:
        turn = np.linalg.norm(pose.log_rotation(found[:3, :3]))
        assert turn == pytest.approx(np.arccos(normals[0] @ moved[:3, :3] @ normals[0]))


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
    assert sum(figures.count for figures in found.by_region.values()) == len(found.distance)


def test_unknown_alignments_and_empty_clouds_are_refused() -> None:
    with pytest.raises(DescriptionError, match="align = 'bestfit': expected none, best-fit, datum"):
        evaluate_against_mesh(np.zeros((9, 3)), BOX, "bestfit")  # type: ignore[arg-type]
    with pytest.raises(DescriptionError, match="holds no points"):
        evaluate_against_mesh(np.zeros((0, 3)), BOX)


_CORNERS = [*product((0, 80), (0, 60), (0,)), (0, 0, 40), (80, 0, 25), (0, 60, 30), (80, 60, 15)]
WEDGE = mesh_of(trimesh.convex.convex_hull(1e-3 * np.array(_CORNERS)))  # a box with a sloping top: no symmetry


def seen_from_above(mesh: Mesh, count: int = 20_000) -> np.ndarray:
    """Points (n, 3) on all faces but those that look down."""
    points, face = sample_surface(mesh, count, 9)
    return points[mesh.normals[face][:, 2] > -0.5]


def test_default_datum_faces_were_measured() -> None:
    """The lower side is the largest of all, and no scan sees it."""
    found = evaluate_against_mesh(pose.transform_points(MOVED, seen_from_above(WEDGE)), WEDGE, "datum")
    assert np.abs(found.part_from_cloud @ MOVED - np.eye(4)).max() < 1e-9
    assert len(found.datum) == 3
    assert all(found.regions.normals[number][2] > -0.5 for number in found.datum)
    assert found.figures["alignment"]["datum"] == list(found.datum)
    lower = int(np.argmin(found.regions.normals[:, 2]))
    with pytest.raises(FitError, match=rf"region {lower} \(plane, .*, -1.00\).* not measured: .*; measured: region"):
        evaluate_against_mesh(seen_from_above(WEDGE), WEDGE, "datum", (lower, *found.datum[1:]))
    with pytest.raises(FitError, match="region 9"):
        evaluate_against_mesh(seen_from_above(WEDGE), WEDGE, "datum", (*found.datum[:2], 9))


def test_datum_of_two_measured_directions_leaves_the_third_to_the_best_fit() -> None:
    points, face = sample_surface(BOX, 20_000, 7)
    points = points[(BOX.normals[face][:, 2] > 0.9) | (BOX.normals[face][:, 1] > 0.9)]
    found = evaluate_against_mesh(pose.transform_points(MOVED, points), BOX, "datum")
    assert found.regions.normals[list(found.datum)] == pytest.approx(np.array([[0, 0, 1], [0, 1, 0]]))
    error = found.part_from_cloud @ MOVED
    assert np.abs(error[:3, :3] - np.eye(3)).max() < 1e-9
    assert np.abs(error[1:3, 3]).max() < 1e-12
    assert abs(error[0, 3]) < 2e-3
    (warning,) = found.warnings
    assert "2 of three directions" in warning
    sphere = Sphere(0.02).mesh()
    with pytest.raises(FitError, match="no plane face of sphere was measured"):
        evaluate_against_mesh(sample_surface(sphere, 5000, 1)[0], sphere, "datum")


def test_regions_state_normal_and_centre() -> None:
    moved = BOX.transformed(pose.translation((0.1, 0.0, 0.02)))
    rows = evaluate_against_mesh(sample_surface(moved, 20_000, 8)[0], moved).rows()
    assert len(rows) == 6
    for row in rows:
        normal = np.array([row[f"normal_{axis}"] for axis in "xyz"])
        centre = np.array([row[f"centre_{axis}_mm"] for axis in "xyz"])
        assert centre == pytest.approx(np.array([100, 0, 20]) + normal * [40, 30, 20])
    cylinder = Cylinder(0.02, 0.05).mesh()
    side = evaluate_against_mesh(sample_surface(cylinder, 5000, 8)[0], cylinder).rows()[0]
    assert side["normal_x"] is None
    assert side["centre_z_mm"] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("turn", [[0, 0, np.pi], [np.pi, 0, 0], [0.4, 1.9, -1.1], [2.2, -2.2, 0.3]])
def test_best_fit_finds_a_turned_cloud(turn: list[float]) -> None:
    moved = pose.from_rotation(Rotation.from_rotvec(turn).as_matrix(), [0.03, -0.02, 0.05])
    points = seen_from_above(WEDGE, 4000)
    found = evaluate_against_mesh(pose.transform_points(moved, points), WEDGE, "best-fit")
    assert found.statistics.rms < 1e-8
    if turn == [0, 0, np.pi]:
        (warning,) = found.warnings
        assert "from another start" in warning
        assert "turns the cloud by 180 deg" in warning


def test_best_fit_of_a_mirrored_cloud_asks_for_the_axis() -> None:
    found = evaluate_against_mesh(seen_from_above(WEDGE, 4000) * [1, -1, 1], WEDGE, "best-fit")
    assert found.statistics.rms > 0.5e-3
    assert any("mirror image of the cloud fits with" in warning for warning in found.warnings)


def test_best_fit_to_another_part_is_doubted() -> None:
    found = evaluate_against_mesh(seen_from_above(WEDGE, 4000), Cylinder(0.03, 0.05).mesh(1e-3), "best-fit")
    assert any("is this a cloud of the part" in warning for warning in found.warnings)


@pytest.mark.parametrize(
    ("scale", "units"), [(25.4, "inch and mm"), (1 / 25.4, "mm and inch"), (1e-3, "mm and m"), (39.37, "m and inch")]
)
def test_cloud_in_another_unit_than_the_mesh_is_warned_of(scale: float, units: str) -> None:
    (warning,) = evaluate_against_mesh(scale * sample_surface(BOX, 500, 1)[0], BOX).warnings
    assert f"differ as {units} do" in warning
    assert not evaluate_against_mesh(0.5 * sample_surface(BOX, 500, 1)[0], BOX).warnings
