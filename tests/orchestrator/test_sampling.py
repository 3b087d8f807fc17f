"""Surface samples of a mesh: distribution over faces and within a face, seed."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from scancell.geometry.mesh import Mesh, box_mesh, sample_surface


def test_samples_are_proportional_to_face_area() -> None:
    box = box_mesh((0.08, 0.06, 0.04))
    count = 10_000
    points, face = sample_surface(box, count, seed=3)
    share = np.bincount(face, minlength=len(box.faces)) / count
    assert np.abs(share - box.areas / box.areas.sum()).max() <= 2 / count, (
        "stratified: at most one sample more or less at either end of a face's interval"
    )
    corner = box.vertices[box.faces[face, 0]]
    assert np.abs(((points - corner) * box.normals[face]).sum(1)).max() < 1e-15
    assert (np.abs(points) <= [0.04 + 1e-15, 0.03 + 1e-15, 0.02 + 1e-15]).all()


def test_samples_are_uniform_within_face() -> None:
    """First and second moments of barycentric coordinates of a uniform triangle: 1/3 and 1/18."""
    mesh = Mesh(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), np.array([[0, 1, 2]]))
    count = 40_000
    points, _ = sample_surface(mesh, count, seed=1)
    weights = np.stack([1 - points[:, 0] - points[:, 1], points[:, 0], points[:, 1]])
    assert (weights >= -1e-15).all()
    assert weights.mean(1) == pytest.approx([1 / 3] * 3, abs=5 * np.sqrt(1 / 18 / count))
    assert weights.var(1) == pytest.approx([1 / 18] * 3, rel=0.05)


def test_samples_depend_on_seed_and_skip_degenerate_faces() -> None:
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.02)
    faces = np.concatenate([[[5, 5, 7]], ball.faces, [[1, 2, 1]]])
    mesh = Mesh(np.asarray(ball.vertices, float), faces)
    points, face = sample_surface(mesh, 2000, seed=7)
    again, _ = sample_surface(mesh, 2000, seed=7)
    other, _ = sample_surface(mesh, 2000, seed=8)
    assert np.array_equal(points, again) and not np.array_equal(points, other)
    assert face.min() > 0 and face.max() < len(faces) - 1
