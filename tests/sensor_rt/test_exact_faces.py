"""Exact faces of CAD parts where rays graze them, and the stripe there, without the CAD kernel."""

from __future__ import annotations

import json

import numpy as np
import pytest
from numpy.typing import NDArray

from bench.exact_faces import displacements
from inspection_parts import cad_part
from scancell import sensor as sensor_rt
from scancell.config.loading import load_setup
from scancell.config.sensor import sensor_json
from scancell.geometry import pose
from scancell.geometry.cad import CAD_CHORD_ERROR, CadMesh
from scancell.geometry.shapes import Cylinder, PlacedShape, Ring, Sphere

Array = NDArray[np.float64]

RADIUS, HEIGHT = 5e-3, 30e-3
FLAT = [np.eye(4)]


def exact(part: CadMesh) -> sensor_rt.Scene:
    """The part with its exact faces."""
    scene = sensor_rt.Scene()
    scene.add_mesh("part", part.vertices, part.faces, 0.5, *part.curved_surfaces(np.arange(len(part.faces))))
    return scene


def rim(count: int, inwards: Array) -> tuple[Array, Array]:
    """Origins and directions of rays across the axis that pass it at 5 mm less distances (n,)."""
    random = np.random.default_rng(3)
    angle, height = random.uniform(0, 2 * np.pi, count), random.uniform(-0.4, 0.4, count) * HEIGHT
    aside = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(count)])
    along = np.column_stack([-np.sin(angle), np.cos(angle), np.zeros(count)])
    return (RADIUS - inwards)[:, None] * aside - 0.1 * along + height[:, None] * [0.0, 0.0, 1.0], along


@pytest.mark.parametrize("shape", [Cylinder(RADIUS, HEIGHT), Sphere(RADIUS)])
def test_rays_meet_the_contour_of_the_surface_not_of_its_triangles(shape: Cylinder | Sphere) -> None:
    """Triangles of a chord error of 5 um lie up to as far inside the contour."""
    scene, count = exact(cad_part([PlacedShape("one", shape, np.eye(4))])), 2000
    inwards = np.random.default_rng(1).uniform(-1.0, 1.0, count) * 2 * CAD_CHORD_ERROR
    origins, along = rim(count, inwards)
    origins[:, 2] *= isinstance(shape, Cylinder)
    distance = sensor_rt.cast_rays(scene, np.array(FLAT), origins, along)[0]
    hit = np.isfinite(distance)
    sure = np.abs(inwards) > 2e-8  # the search of triangles is in single precision
    np.testing.assert_array_equal(hit[sure], inwards[sure] > 0)
    expected = 0.1 - np.sqrt(RADIUS**2 - (RADIUS - inwards[hit]) ** 2)
    np.testing.assert_allclose(distance[hit], expected, atol=1e-9)


def test_rays_that_pass_a_contour_meet_what_lies_behind() -> None:
    behind = PlacedShape("behind", Cylinder(0.03, 2 * HEIGHT), pose.translation([0.0, 0.2, 0.0]))
    scene = exact(cad_part([PlacedShape("one", Cylinder(RADIUS, HEIGHT), np.eye(4)), behind]))
    inwards = -np.linspace(1e-7, CAD_CHORD_ERROR, 50)
    origins = np.column_stack([RADIUS - inwards, np.full(50, -0.1), np.zeros(50)])
    distance = sensor_rt.cast_rays(scene, np.array(FLAT), origins, np.tile([0.0, 1.0, 0.0], (50, 1)))[0]
    np.testing.assert_allclose(distance, 0.3 - np.sqrt(0.03**2 - origins[:, 0] ** 2), atol=1e-9)


@pytest.mark.parametrize("is_bore", [False, True])
def test_points_on_exact_faces_do_not_hide_from_grazing_views(is_bore: bool) -> None:
    """Triangles lie before the wall of a bore, and those that are searched before that of a cylinder."""
    shape = Ring(RADIUS, 2 * RADIUS, HEIGHT) if is_bore else Cylinder(RADIUS, HEIGHT)
    scene, random, count = exact(cad_part([PlacedShape("one", shape, np.eye(4))])), np.random.default_rng(2), 2000
    angle, lean = random.uniform(0, 2 * np.pi, count), random.uniform(0.01, 1.5, count)
    radial = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(count)])
    across = np.column_stack([-np.sin(angle), np.cos(angle), np.zeros(count)])
    ends = RADIUS * radial
    inwards = -1.0 if is_bore else 1.0
    length = 2 * RADIUS * np.sin(lean) * 0.99 if is_bore else np.full(count, 0.1)
    towards = inwards * np.sin(lean)[:, None] * radial + np.cos(lean)[:, None] * across
    starts = ends + length[:, None] * towards
    # Segments of images end a ten-thousandth before the point.
    assert not sensor_rt.occluded(scene, np.array(FLAT), starts, ends + 1e-4 * (starts - ends)).any()
    # From the other side they do.
    if not is_bore:
        steep = lean > 0.1
        assert sensor_rt.occluded(scene, np.array(FLAT), (ends - 0.1 * towards)[steep], ends[steep]).all()


def test_stripe_at_the_contour_is_that_of_the_exact_shape() -> None:
    sensor = sensor_rt.Sensor(json.dumps(sensor_json(load_setup(ideal=True).sensor, 0)))
    shape = PlacedShape("one", Cylinder(RADIUS, HEIGHT), np.eye(4))
    primitive = sensor_rt.Scene()
    primitive.add_cylinder("part", np.eye(4), RADIUS, HEIGHT, 0.5)
    # The axis lies along the laser line, and the sheet meets the wall close to its contour.
    at = pose.from_euler_xyz([0.98 * RADIUS, 0.0, 0.12], [np.pi / 2, 0.0, 0.0])
    still = sensor_rt.Exposures(np.eye(4)[None, None], at[None, None, None], np.array([5e-4]), np.array([0]))
    lit = [sensor_rt.expected_electrons(scene, sensor, still) for scene in (primitive, exact(cad_part([shape])))]
    assert lit[0].max() > 100.0
    inside = slice(300, 980)  # columns between the ends of the cylinder, whose edges are those of the triangles
    assert np.abs(lit[1] - lit[0])[..., inside].max() < 0.002 * lit[0].max()


def test_displacement_by_the_width_of_the_line_is_that_of_its_light() -> None:
    """Images that NumPy computes tell the displacement, which falls with the square of the width."""
    wide, narrow = displacements(1, np.radians(20)), displacements(2, np.radians(20))
    for traced, computed in (wide, narrow):
        assert np.sqrt(np.mean((traced - computed) ** 2)) < 0.2e-6
    of_wide, of_narrow = (np.sqrt(np.mean(computed**2)) for _, computed in (wide, narrow))
    assert of_wide > 3e-6
    assert of_wide / of_narrow == pytest.approx(4.0, rel=0.1)
