"""Deviation figures against their definitions, distances against displacements that are known."""

from __future__ import annotations

import json

import numpy as np
import pytest
import trimesh

from orchestrator.evaluation.coverage import sample_surface
from orchestrator.evaluation.deviation import DeviationFigures, deviation_from_mesh
from orchestrator.geometry.mesh import Mesh
from orchestrator.reconstruction import Cloud


def mesh_of(solid: trimesh.Trimesh) -> Mesh:
    return Mesh(np.asarray(solid.vertices, float), np.asarray(solid.faces, np.int64), "test")


BOX = mesh_of(trimesh.creation.box((0.08, 0.06, 0.04)))
BALL = mesh_of(trimesh.creation.icosphere(subdivisions=4, radius=0.025))


def cloud_of(points: np.ndarray, camera: np.ndarray | None = None, segment: np.ndarray | None = None) -> Cloud:
    n = len(points)
    ones = np.ones(n)
    return Cloud(
        points_in_part=points,
        normals=np.zeros((n, 3)),
        sigma=ones,
        intensity=ones,
        quality=ones,
        camera=np.zeros(n, np.int32) if camera is None else camera,
        column=np.zeros(n, np.int32),
        profile=np.zeros(n, np.int64),
        segment=np.ones(n, np.int32) if segment is None else segment,
        time=ones,
    )


def closest_by_brute_force(vertices, faces, points):  # type: ignore[no-untyped-def]
    """Closest points by trying every triangle, signed by the winding number (solid angle) of the closed mesh."""
    vertices, points = 1e6 * vertices, 1e6 * points  # micrometres: trimesh's tolerances are absolute and coarse
    best = np.full(len(points), np.inf)
    where = np.zeros((len(points), 3))
    which = np.zeros(len(points), int)
    solid_angle = np.zeros(len(points))
    for number, face in enumerate(faces):
        triangle = np.broadcast_to(vertices[face], (len(points), 3, 3))
        near = trimesh.triangles.closest_point(triangle, points)
        distance = np.linalg.norm(near - points, axis=1)
        closer = distance < best
        best[closer], where[closer], which[closer] = distance[closer], near[closer], number
        a, b, c = np.moveaxis(triangle - points[:, None], 1, 0)
        la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
        top = np.einsum("ni,ni->n", a, np.cross(b, c))
        bottom = la * lb * lc + (a * b).sum(1) * lc + (b * c).sum(1) * la + (c * a).sum(1) * lb
        solid_angle += 2 * np.arctan2(top, bottom)
    return 1e-6 * where, which, 1e-6 * np.where(solid_angle > 2 * np.pi, -best, best)


def search(name: str):  # type: ignore[no-untyped-def]
    if name == "brute force":
        return closest_by_brute_force
    return pytest.importorskip("sensor_rt._core").closest_points


SEARCHES = ["brute force", "sensor_rt"]


@pytest.mark.parametrize("name", SEARCHES)
@pytest.mark.parametrize("offset", [37e-6, -37e-6])
def test_points_moved_along_the_normal_deviate_by_just_that(name: str, offset: float) -> None:
    points, normals = sample_surface(BOX, 300, seed=1)
    corner = np.array([0.04, 0.03, 0.02])
    inner = ((corner - np.abs(points)) > 1e-4).sum(1) == 2  # away from the edges, where inside another face is nearer
    moved = points[inner] + offset * normals[inner]
    deviation = deviation_from_mesh(cloud_of(moved), BOX, search(name))
    assert inner.sum() > 250
    assert np.abs(deviation.signed - offset).max() < 1e-12
    assert deviation.figures.mean == pytest.approx(offset, abs=1e-12)
    assert deviation.figures.standard_deviation < 1e-12


@pytest.mark.parametrize("name", SEARCHES)
def test_beyond_edges_and_corners_the_distance_is_to_them_and_positive(name: str) -> None:
    corner = np.array([0.04, 0.03, 0.02])
    away = np.array([[3.0, 4.0, 0.0], [2.0, 3.0, 6.0]]) * 1e-5  # over an edge, over a corner
    deviation = deviation_from_mesh(cloud_of(corner + away), BOX, search(name))
    assert deviation.signed == pytest.approx([5e-5, 7e-5], abs=1e-12)


@pytest.mark.parametrize("name", SEARCHES)
def test_inside_is_negative_outside_positive(name: str) -> None:
    rng = np.random.default_rng(4)
    direction = rng.normal(size=(60, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    radius = rng.choice([0.024, 0.026], 60)
    signed = deviation_from_mesh(cloud_of(radius[:, None] * direction), BALL, search(name)).signed
    assert (np.sign(signed) == np.sign(radius - 0.025)).all()
    assert np.abs(signed - (radius - 0.025)).max() < 60e-6  # facets of 1.7 mm lie up to 60 µm inside the sphere


def test_two_searches_agree() -> None:
    points = np.random.default_rng(5).uniform(-0.04, 0.04, (200, 3))
    brute = deviation_from_mesh(cloud_of(points), BALL, closest_by_brute_force)
    native = deviation_from_mesh(cloud_of(points), BALL, search("sensor_rt"))
    assert np.abs(brute.signed - native.signed).max() < 1e-12


def test_figures_are_what_their_names_say() -> None:
    signed = np.random.default_rng(6).normal(3e-6, 8e-6, 4001)
    figures = DeviationFigures.of(signed)
    magnitude = np.sort(np.abs(signed))
    assert figures.count == 4001
    assert figures.rms**2 == pytest.approx(figures.mean**2 + figures.standard_deviation**2)
    assert figures.d95 == pytest.approx(magnitude[3800])  # 0.95 · 4000: exactly this point of the sorted ones
    assert figures.d99_9 == pytest.approx(magnitude[3996])
    assert figures.max_abs == max(figures.maximum, -figures.minimum)
    assert figures.d95 < figures.d99_9 < figures.max_abs


def test_every_point_counts_in_its_camera_and_segment() -> None:
    points, _ = sample_surface(BOX, 100, seed=2)
    camera = (np.arange(100) % 2).astype(np.int32)
    segment = (np.arange(100) // 40 + 1).astype(np.int32)
    cloud = cloud_of(points, camera, segment)
    deviation = deviation_from_mesh(cloud, BOX, lambda v, f, p: (p, np.zeros(len(p), int), camera * 1e-5))
    assert {key: figures.count for key, figures in deviation.by_camera.items()} == {0: 50, 1: 50}
    assert {key: figures.count for key, figures in deviation.by_segment.items()} == {1: 40, 2: 40, 3: 20}
    assert deviation.by_camera[1].mean == pytest.approx(1e-5)
    plain = json.loads(json.dumps(deviation.as_json(), allow_nan=False))
    assert plain["by_camera"]["1"]["rms_um"] == pytest.approx(10.0)
    assert plain["all"]["count"] == 100


def test_an_empty_cloud_has_no_figures() -> None:
    deviation = deviation_from_mesh(cloud_of(np.zeros((0, 3))), BOX, closest_by_brute_force)
    assert deviation.as_json()["all"] == {"count": 0} | {
        f"{name}_um": None for name in DeviationFigures.__dataclass_fields__ if name != "count"
    }
