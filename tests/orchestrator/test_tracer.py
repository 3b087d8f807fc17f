"""Occlusion tests against intersection with every triangle in double precision."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from cells import mesh_of
from numpy.typing import NDArray

from scancell.geometry import pose
from scancell.geometry.mesh import Mesh, box_mesh
from scancell.visibility import Tracer

Array = NDArray[np.float64]


RING = mesh_of(trimesh.creation.torus(0.03, 0.01, major_sections=40, minor_sections=20))
LID = box_mesh((0.05, 0.05, 0.002)).transformed(pose.translation((0.01, 0.0, 0.03)))


def first_hit(meshes: list[Mesh], start: Array, direction: Array) -> Array:
    """Distance (n,) to the first hit in multiples of `direction`, by barycentric coordinates; inf without hit."""
    a, b, c = np.moveaxis(np.concatenate([mesh.vertices[mesh.faces] for mesh in meshes]), 1, 0)
    distance = np.full(len(start), np.inf)
    for i, (origin, ray) in enumerate(zip(start, direction, strict=True)):
        columns = np.stack([b - a, c - a, np.broadcast_to(-ray, a.shape)], -1)
        u, v, t = np.linalg.solve(columns, (origin - a)[..., None])[..., 0].T
        distance[i] = np.where((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0), t, np.inf).min()
    return distance


def rays(count: int, seed: int) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    start = rng.uniform(-0.05, 0.05, (count, 3))
    return start, rng.uniform(-0.05, 0.05, (count, 3)) - start


@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.0), (40.0, -25.0, 10.0)])
def test_occlusion_matches_brute_force(offset: tuple[float, float, float]) -> None:
    start, ray = rays(1000, 2)
    meshes = [RING, LID]
    distance = first_hit(meshes, start, ray)
    tracer = Tracer([mesh.transformed(pose.translation(offset)) for mesh in meshes])
    np.testing.assert_array_equal(tracer.blocked(start + offset, start + offset + ray), distance < 1)
    assert 100 < (distance < 1).sum() < 900
    assert (first_hit([LID], start, ray) == distance)[distance < 1].sum() > 20


def test_results_are_independent_of_threads() -> None:
    start, ray = rays(20_000, 3)
    one, two = Tracer([RING, LID], threads=1), Tracer([RING, LID], threads=2)
    np.testing.assert_array_equal(one.blocked(start, start + ray), two.blocked(start, start + ray))


def test_occlusion_within_ten_micrometres_of_surface() -> None:
    start, _ = rays(500, 4)
    direction = start / np.linalg.norm(start, axis=1, keepdims=True)
    ball = mesh_of(trimesh.creation.icosphere(subdivisions=3, radius=0.03))
    tracer = Tracer([ball])
    surface = first_hit([ball], 0 * start, direction)[:, None] * direction
    assert np.isfinite(surface).all()
    assert not tracer.blocked(surface + 1e-5 * direction, surface + 0.2 * direction).any()
    assert tracer.blocked(surface - 1e-5 * direction, surface + 0.2 * direction).all()
    assert not tracer.blocked(surface + 0.2 * direction, surface + 1e-5 * direction).any()


def test_empty_scene_and_empty_query() -> None:
    start, ray = rays(5, 5)
    assert not Tracer([]).blocked(start, start + ray).any()
    assert Tracer([RING]).blocked(np.zeros((0, 3)), np.zeros((0, 3))).shape == (0,)


def test_degenerate_segment_is_rejected() -> None:
    start, ray = rays(100, 6)
    end = start + ray
    end[60] = start[60]
    end[70] = np.inf
    with pytest.raises(ValueError, match="ray 60 "):
        Tracer([RING]).blocked(start, end)
