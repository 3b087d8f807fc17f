"""Reduced meshes and the bound on what they leave out."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from cells import ball, mesh_of, planning_cell

from scancell.config.loading import assets_dir
from scancell.geometry.mesh import Mesh, box_mesh, decimated, load_mesh, protrusion_bound, reduced, sample_surface
from scancell.proximity.scene import ProximityScene
from scancell.sensor import MeshSurface

PART = assets_dir() / "parts" / "free_form.stl"
TOLERANCE = 0.1e-3  # m: what the bound may exceed the largest distance by


def sampled(mesh: Mesh, solid: Mesh, count: int = 200_000) -> float:
    """Largest distance by which random points of a mesh lie outside a closed solid, m."""
    points, _ = sample_surface(mesh, count, 0)
    signed, _ = MeshSurface(solid.vertices, solid.faces).signed_distances(points)
    return max(float(np.max(signed)), 0.0)


@pytest.mark.parametrize("thickness", [1e-4, 3e-3])
def test_box_reaches_outside_a_smaller_one_by_its_corners(thickness) -> None:
    outer, inner = box_mesh((0.1, 0.08, 0.06)), box_mesh(tuple(np.array([0.1, 0.08, 0.06]) - 2 * thickness))
    exact = np.sqrt(3) * thickness
    assert exact <= protrusion_bound(outer, inner) <= exact + TOLERANCE + 1e-9


def test_body_inside_the_solid_does_not_reach_outside() -> None:
    assert protrusion_bound(box_mesh((0.02, 0.02, 0.02)), box_mesh((0.1, 0.1, 0.1))) <= TOLERANCE


def test_groove_under_the_middle_of_a_face_is_found() -> None:
    """Corners and centres of the original's faces lie on the solid; the groove is between them."""
    plate = box_mesh((0.2, 0.1, 0.02))
    cut = trimesh.creation.box((0.003, 0.2, 0.004))
    cut.apply_translation((0.0437, 0.0, 0.01))
    solid = trimesh.boolean.difference([trimesh.Trimesh(plate.vertices, plate.faces), cut], engine="manifold")
    grooved = mesh_of(solid)
    signed, _ = MeshSurface(grooved.vertices, grooved.faces).signed_distances(
        np.concatenate([plate.vertices, plate.vertices[plate.faces].mean(1)])
    )
    assert np.abs(signed).max() < 1e-8
    # The middle of the groove is nearer to its rims than to its floor.
    assert 0.0015 <= protrusion_bound(plate, grooved) <= 0.0015 + TOLERANCE + 1e-6


@pytest.mark.parametrize("faces", [200, 1000, 5000])
def test_bound_exceeds_dense_samples_by_little(faces) -> None:
    part = load_mesh(PART)
    light = decimated(part, faces)
    largest = sampled(part, light)
    bound = protrusion_bound(part, light)
    assert largest <= bound <= largest + TOLERANCE + 0.05e-3  # the samples are 0.2 mm apart


def test_open_mesh_has_the_distance_on_both_sides() -> None:
    square = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]) * 0.05, np.array([[0, 1, 2], [0, 2, 3]]))
    for side in (-1, 1):
        shifted = Mesh(square.vertices + np.array([0, 0, side * 1e-3]), square.faces)
        assert 1e-3 <= protrusion_bound(shifted, square) <= 1e-3 + TOLERANCE + 1e-9


def test_mesh_with_few_faces_is_kept() -> None:
    mesh = ball()
    found = reduced(mesh, len(mesh.faces), 1e-3)
    assert found.mesh is mesh
    assert found.error == 0.0


def test_more_faces_are_kept_where_the_error_would_be_too_large() -> None:
    part = load_mesh(PART)
    coarse, fine = reduced(part, 100, 1.0), reduced(part, 100, 0.3e-3)
    assert coarse.error > 0.3e-3 >= fine.error
    assert len(coarse.mesh.faces) <= 100 < len(fine.mesh.faces) < len(part.faces)


def test_distances_in_planning_are_lower_bounds() -> None:
    cell = planning_cell(load_mesh(PART))
    nominal, scene = cell.nominal, cell.proximity
    part = cell.reduced_meshes["part"]
    assert len(part.mesh.faces) <= 5000 < part.original_faces
    assert 0 < part.error < 0.5e-3
    pairs = [pair for pair in scene.pairs if "part" in pair]
    exact = ProximityScene({body.name: body.mesh for body in nominal.bodies}, pairs)
    rng = np.random.default_rng(3)
    q = nominal.home + rng.uniform(-1.0, 1.0, (120, 6)) * [0.6, 0.7, 0.7, 1, 1, 1]
    poses = nominal.body_poses(np.column_stack([q, rng.uniform(-np.pi, np.pi, 120)]))
    taken = scene.distances(poses, 0.3)[:, ["part" in pair for pair in scene.pairs]]
    true = exact.distances(poses, 0.3)
    near = taken < 0.29
    assert near.sum() > 60
    assert (true[near] >= taken[near] - part.error).all()
    assert np.abs(true[near] - taken[near]).max() > 0  # the meshes differ


def test_clearances_of_planning_grow_by_the_error() -> None:
    cell = planning_cell(load_mesh(PART))
    error = cell.reduced_meshes["part"].error
    required = dict(zip(map(frozenset, cell.proximity.pairs), cell.clearance_ranges(0.005, 0.05, 0.01), strict=True))
    assert required[frozenset(("sensor", "part"))][0] == pytest.approx(0.005 + error)
    assert required[frozenset(("sensor", "table"))][0] == pytest.approx(0.005)
