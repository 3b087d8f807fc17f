"""Cones and rings in all engines, compared with fine tessellations and closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import Array, pose, probe, still, stripe_centres

from scancell.geometry.shapes import Cone, Ring, Shape
from scancell.sensor import Scene, expected_electrons, scan

CONE, RING = Cone(0.02, 0.008, 0.03), Ring(0.008, 0.016, 0.012)
PLACES = [
    (CONE, pose((0.0, 0.002, 0.13), (np.radians(70), 0.1, 0.0))),
    (CONE, pose((0.0, 0.0, 0.13), (np.radians(165), 0.1, 0.0))),
    (RING, pose((0.0, 0.0, 0.13), (np.radians(25), 0.1, 0.0))),
]


def exact(shape: Shape) -> Scene:
    scene = Scene()
    if isinstance(shape, Cone):
        scene.add_cone("part", np.eye(4), shape.bottom_radius, shape.top_radius, shape.height, 0.6)
    elif isinstance(shape, Ring):
        scene.add_ring("part", np.eye(4), shape.inner_radius, shape.outer_radius, shape.height, 0.6)
    return scene


def tessellated(shape: Shape) -> Scene:
    scene, mesh = Scene(), shape.mesh(0.2e-6)
    scene.add_mesh("part", mesh.vertices, mesh.faces, 0.6)
    return scene


def points_in_shape(scene: Scene, place: Array, engine: str) -> Array:
    points = scan(scene, probe(), still(place), engine=engine).profiles.points_in_sensor
    return (points - place[:3, 3]) @ place[:3, :3]


@pytest.mark.parametrize(("shape", "place"), PLACES)
def test_geometric_profile_lies_on_the_shape(shape: Shape, place: Array) -> None:
    points = points_in_shape(exact(shape), place, "geometric")
    assert len(points) > 300
    assert np.abs(shape.nearest(points)[0]).max() < 1e-15
    facets = points_in_shape(tessellated(shape), place, "geometric")
    assert abs(len(facets) - len(points)) <= 0.01 * len(points)


@pytest.mark.parametrize(("shape", "place"), PLACES)
def test_rendered_stripe_agrees_with_fine_tessellation(shape: Shape, place: Array) -> None:
    """The normals of the shape decide how bright it is, its surface where."""
    both = [expected_electrons(scene, probe(), still(place))[0] for scene in (exact(shape), tessellated(shape))]
    lit = 0
    for image, expected in zip(*both, strict=True):
        (rows, total), (expected_rows, expected_total) = stripe_centres(image), stripe_centres(expected)
        bright = (expected_total > 0.3 * np.median(expected_total[expected_total > 0])) & (total > 0)
        lit += bright.sum()
        assert np.quantile(np.abs(rows - expected_rows)[bright], 0.98) < 0.02  # px
        assert np.quantile(np.abs(total[bright] / expected_total[bright] - 1), 0.98) < 0.02
        assert total.sum() == pytest.approx(expected_total.sum(), rel=2e-3)
    assert lit > 300
