"""Deviation figures against their definitions, signed distances against known displacements."""

from __future__ import annotations

import json

import numpy as np
import pytest
import trimesh
from cells import cloud_of, mesh_of

from scancell.evaluation.deviation import Deviation, DeviationFigures, deviation_from_mesh
from scancell.geometry.mesh import Mesh, sample_surface
from scancell.geometry.shapes import PartSurface

BOX = mesh_of(trimesh.creation.box((0.08, 0.06, 0.04)))
BALL = mesh_of(trimesh.creation.icosphere(subdivisions=4, radius=0.025))


@pytest.mark.parametrize("offset", [37e-6, -37e-6])
def test_offset_points_have_that_deviation(offset: float) -> None:
    points, face = sample_surface(BOX, 300, seed=1)
    corner = np.array([0.04, 0.03, 0.02])
    inner = ((corner - np.abs(points)) > 1e-4).sum(1) == 2  # near an edge another face may be nearer
    moved = points[inner] + offset * BOX.normals[face[inner]]
    deviation = deviation_from_mesh(cloud_of(moved), BOX)
    assert inner.sum() > 250
    assert np.abs(deviation.distance - offset).max() < 1e-12
    assert deviation.figures.mean == pytest.approx(offset, abs=1e-12)
    assert deviation.figures.standard_deviation < 1e-12


def test_distance_from_edges_and_corners() -> None:
    corner = np.array([0.04, 0.03, 0.02])
    away = np.array([[3.0, 4.0, 0.0], [2.0, 3.0, 6.0]]) * 1e-5  # over an edge, over a corner
    deviation = deviation_from_mesh(cloud_of(corner + away), BOX)
    assert deviation.distance == pytest.approx([5e-5, 7e-5], abs=1e-12)


def test_distances_from_open_mesh_are_absolute() -> None:
    points, face = sample_surface(BOX, 100, seed=1)
    inside = cloud_of(points - 1e-5 * BOX.normals[face])
    is_side = np.abs(BOX.normals[:, 2]) < 0.5
    sides = Mesh(BOX.vertices, BOX.faces[is_side], "without top and bottom")
    rows = np.flatnonzero(is_side[face])
    closed, opened = (deviation_from_mesh(inside[rows], mesh) for mesh in (BOX, sides))
    assert closed.is_signed and not opened.is_signed
    assert (closed.distance < 0).all() and (opened.distance > 0).all()


def test_sign_of_deviation() -> None:
    rng = np.random.default_rng(4)
    direction = rng.normal(size=(60, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    radius = rng.choice([0.024, 0.026], 60)
    signed = deviation_from_mesh(cloud_of(radius[:, None] * direction), BALL).distance
    assert (np.sign(signed) == np.sign(radius - 0.025)).all()
    assert np.abs(signed - (radius - 0.025)).max() < 60e-6  # facets of 1.7 mm lie up to 60 µm inside the sphere


def test_prepared_surface_gives_the_same_deviation() -> None:
    cloud = cloud_of(np.random.default_rng(5).uniform(-0.04, 0.04, (200, 3)))
    once, prepared = deviation_from_mesh(cloud, BALL), deviation_from_mesh(cloud, PartSurface(BALL), threads=1)
    assert np.array_equal(once.distance, prepared.distance) and np.array_equal(once.face, prepared.face)


@pytest.mark.parametrize("count", [1, 2, 20, 4001, 5000])
def test_figures_match_definitions(count: int) -> None:
    signed = np.random.default_rng(6).normal(3e-6, 8e-6, count)
    given = signed.copy()
    figures = DeviationFigures.of(signed)
    assert np.array_equal(signed, given)
    magnitude = np.abs(signed)
    assert figures.count == count
    assert figures.mean == pytest.approx(sum(signed) / count)
    assert figures.standard_deviation == pytest.approx(np.std(signed), abs=1e-18)
    assert figures.rms**2 == pytest.approx(sum(signed**2) / count)
    assert figures.d95 == pytest.approx(np.quantile(magnitude, 0.95))
    assert figures.d99_9 == pytest.approx(np.quantile(magnitude, 0.999))
    assert (figures.minimum, figures.maximum) == (signed.min(), signed.max())
    assert figures.max_abs == magnitude.max()


def test_standard_deviation_with_large_mean() -> None:
    scatter = np.random.default_rng(7).normal(0, 1e-9, 1000)
    assert DeviationFigures.of(0.1 + scatter).standard_deviation == pytest.approx(scatter.std(), rel=1e-6)


CAMERAS = ("right", "left")
SEGMENTS = {1: "turn", 2: "pass"}


def test_figures_by_camera_and_segment() -> None:
    points, _ = sample_surface(BOX, 100, seed=2)
    camera = (np.arange(100) % 2).astype(np.int32)
    segment = (np.arange(100) // 40 + 1).astype(np.int32)
    cloud = cloud_of(points, camera=camera, segment=segment)
    deviation = Deviation.of(cloud, camera * 1e-5, np.zeros(100, int))
    assert {key: figures.count for key, figures in deviation.by_camera.items()} == {0: 50, 1: 50}
    assert {key: figures.count for key, figures in deviation.by_segment.items()} == {1: 40, 2: 40, 3: 20}
    assert deviation.by_camera[1].mean == pytest.approx(1e-5)
    plain = json.loads(json.dumps(deviation.as_json(CAMERAS, SEGMENTS), allow_nan=False))
    assert plain["by_camera"]["left"]["rms_um"] == pytest.approx(10.0)
    assert plain["all"]["count"] == 100
    assert [(item["id"], item["name"], item["count"]) for item in plain["by_segment"]] == [
        (1, "turn", 40),
        (2, "pass", 40),
        (3, "3", 20),
    ]


def test_empty_cloud_has_no_figures() -> None:
    deviation = deviation_from_mesh(cloud_of(np.zeros((0, 3))), BOX)
    assert deviation.as_json(CAMERAS, SEGMENTS)["all"] == {"count": 0} | {
        f"{name}_um": None for name in DeviationFigures.__dataclass_fields__ if name != "count"
    }
