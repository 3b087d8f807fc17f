"""Exact shapes: signed distances against closed forms, gradients and dense samples; tessellations."""

import numpy as np
import pytest

from scancell.geometry import pose
from scancell.geometry.shapes import Box, Cone, Cylinder, PlacedShape, Plane, Ring, Shape, ShapeGroup, Sphere
from scancell.sensor import MeshSurface

SHAPES = [
    Sphere(0.0125),
    Plane(0.06, 0.03),
    Box(0.04, 0.02, 0.01),
    Cylinder(0.01, 0.03),
    Cone(0.02, 0.005, 0.03),
    Cone(0.004, 0.02, 0.01),
    Cone(0.015, 0.0, 0.02),
    Ring(0.01, 0.025, 0.012),
]
SOLIDS = [shape for shape in SHAPES if shape.is_solid]


def name(shape: Shape) -> str:
    return repr(shape)


@pytest.fixture
def points() -> np.ndarray:
    return np.random.default_rng(4).uniform(-0.04, 0.04, (4000, 3))


@pytest.mark.parametrize("shape", SHAPES, ids=name)
def test_normal_is_gradient_of_unit_length(shape, points):
    _, normal = shape.nearest(points)
    step = 1e-7
    gradient = [(shape.nearest(points + e)[0] - shape.nearest(points - e)[0]) / (2 * step) for e in step * np.eye(3)]
    error = np.linalg.norm(np.stack(gradient, 1) - normal, axis=1)
    # The gradient jumps on the medial axis and, for an open plane, behind its edge, which few points come near.
    assert np.quantile(error, 0.99) < 1e-5
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, atol=1e-14)


@pytest.mark.parametrize("shape", SHAPES, ids=name)
def test_step_along_normal_ends_on_surface(shape, points):
    signed, normal = shape.nearest(points)
    again, _ = shape.nearest(points - signed[:, None] * normal)
    assert np.abs(again).max() < 1e-16


@pytest.mark.parametrize("shape", SOLIDS, ids=name)
def test_distance_agrees_with_fine_tessellation(shape, points):
    """The signed distance to a mesh with vertices on the surface differs by its chord error at most."""
    chord = 0.5e-6
    mesh = shape.mesh(chord)
    assert mesh.is_closed
    assert mesh.orientation == "outward"
    expected, _ = MeshSurface(mesh.vertices, mesh.faces).signed_distances(points)
    assert np.abs(shape.nearest(points)[0] - expected).max() < 1.01 * chord


@pytest.mark.parametrize("shape", SHAPES, ids=name)
def test_tessellation_stays_within_chord_error(shape):
    mesh = shape.mesh()
    assert np.abs(shape.nearest(mesh.vertices)[0]).max() < 1e-17
    a, b, c = (mesh.vertices[corner] for corner in mesh.faces.T)
    for u, v in ((1 / 3, 1 / 3), (0.5, 0.0), (0.5, 0.5)):
        error = np.abs(shape.nearest(a + u * (b - a) + v * (c - a))[0]).max()
        assert error < 10e-6
    _, normal = shape.nearest(mesh.vertices[mesh.faces].mean(1))
    assert np.sum(normal * mesh.normals, 1).min() > 0.99


def test_volumes_and_areas_of_tessellations():
    def volume(mesh):
        a, b, c = (mesh.vertices[corner] for corner in mesh.faces.T)
        return np.sum(a * np.cross(b, c)) / 6

    fine = 0.1e-6
    assert volume(Sphere(0.01).mesh(fine)) == pytest.approx(4 / 3 * np.pi * 0.01**3, rel=1e-4)
    assert volume(Ring(0.01, 0.02, 0.03).mesh(fine)) == pytest.approx(np.pi * (0.02**2 - 0.01**2) * 0.03, rel=1e-4)
    frustum = np.pi * 0.03 / 3 * (0.02**2 + 0.02 * 0.01 + 0.01**2)
    assert volume(Cone(0.02, 0.01, 0.03).mesh(fine)) == pytest.approx(frustum, rel=1e-4)
    assert Plane(0.06, 0.03).mesh().areas.sum() == pytest.approx(0.06 * 0.03)


@pytest.mark.parametrize(
    ("shape", "point", "signed", "normal"),
    [
        (Sphere(0.5), (0, 0, 2), 1.5, (0, 0, 1)),
        (Sphere(0.5), (0, 0, 0), -0.5, (0, 0, 1)),
        (Plane(2, 2), (0.5, 0.5, 3), 3, (0, 0, 1)),
        (Plane(2, 2), (0.5, 0.5, -3), -3, (0, 0, 1)),
        (Plane(2, 2), (4, 0, 4), 5, (0.6, 0, 0.8)),
        (Plane(2, 2), (0.2, -0.3, 0), 0, (0, 0, 1)),
        (Box(2, 2, 2), (4, 5, 1), 5, (0.6, 0.8, 0)),  # beside an edge
        (Box(2, 2, 2), (2, 3, -3), 3, (1 / 3, 2 / 3, -2 / 3)),  # beyond a corner
        (Box(2, 2, 2), (0.9, 0, 0), -0.1, (1, 0, 0)),
        (Cylinder(1, 2), (4, 0, 5), 5, (0.6, 0, 0.8)),  # beyond the rim
        (Cylinder(1, 2), (0, -0.5, -3), 2, (0, 0, -1)),
        (Cylinder(1, 4), (0, 0, 0), -1, (1, 0, 0)),
        (Cone(3, 0, 4), (0, 0, 3), 1, (0, 0, 1)),  # above the apex
        (Cone(3, 0, 4), (0, 0, 2), 0, None),
        (Cone(3, 0, 4), (1.5 + 0.8, 0, 0.6), 1, (0.8, 0, 0.6)),  # beside the flank, which has slope 4:3
        (Cone(3, 0, 4), (3.6, 0, -2.8), 1, (0.6, 0, -0.8)),  # beyond the lower rim
        (Ring(1, 3, 2), (0, 0, 0), 1, None),  # in the bore
        (Ring(1, 3, 2), (0, 0.5, 0), 0.5, (0, -1, 0)),
        (Ring(1, 3, 2), (2, 0, 0.75), -0.25, (0, 0, 1)),
        (Ring(1, 3, 2), (0.4, 0, 1.8), 1, (-0.6, 0, 0.8)),  # beyond the inner rim
    ],
)
def test_closed_form_at_faces_edges_and_corners(shape, point, signed, normal):
    found, gradient = shape.nearest(np.array([point], float))
    assert found[0] == pytest.approx(signed, abs=1e-15)
    if normal is not None:
        np.testing.assert_allclose(gradient[0], normal, atol=1e-15)


def test_normals_are_exact_next_to_the_surface():
    """Rounding of the point must not turn the normal."""
    for shape in SOLIDS:
        mesh = shape.mesh()
        on = mesh.vertices[mesh.faces].mean(1)
        signed, normal = shape.nearest(on)
        on = on - signed[:, None] * normal
        for offset in (-1e-12, 0.0, 1e-12):
            _, near = shape.nearest(on + offset * normal)
            np.testing.assert_allclose(near, normal, atol=1e-9)


def test_group_is_union_in_its_own_frame(points):
    frame = pose.from_euler_xyz((0.01, -0.005, 0.003), (0.3, -0.2, 0.9))
    ball, stem = PlacedShape("ball", Sphere(0.0125), frame), PlacedShape("stem", Cylinder(0.004, 0.04), np.eye(4))
    group = ShapeGroup((ball, stem))
    signed, normal, index = group.nearest(points)
    to_ball = np.linalg.norm(points - frame[:3, 3], axis=1) - 0.0125
    to_stem, stem_normal = stem.nearest(points)
    np.testing.assert_allclose(signed, np.minimum(to_ball, to_stem), atol=1e-15)
    np.testing.assert_array_equal(index, to_stem < to_ball)
    np.testing.assert_allclose(normal[index == 1], stem_normal[index == 1], atol=1e-14)

    target_from_group = pose.from_euler_xyz((0.1, 0.2, 0.3), (-1.0, 0.5, 2.0))
    moved = group.transformed(target_from_group)
    again, turned, _ = moved.nearest(pose.transform_points(target_from_group, points))
    np.testing.assert_allclose(again, signed, atol=1e-15)
    np.testing.assert_allclose(turned, normal @ target_from_group[:3, :3].T, atol=1e-12)


def test_open_plane_beside_a_solid_has_no_inside():
    """A point below a plane is not inside it: a nearer solid wins."""
    group = ShapeGroup(
        (
            PlacedShape("plane", Plane(0.1, 0.1), np.eye(4)),
            PlacedShape("ball", Sphere(0.01), pose.translation((0, 0, -0.1))),
        )
    )
    signed, _, index = group.nearest([[0.0, 0.0, -0.085], [0.0, 0.0, -0.001], [0.0, 0.0, 0.002]])
    np.testing.assert_array_equal(index, [1, 0, 0])
    np.testing.assert_allclose(signed, [0.005, -0.001, 0.002], atol=1e-15)


def test_mesh_of_group_keeps_the_shapes_when_it_is_moved(points):
    group = ShapeGroup((PlacedShape("cone", Cone(0.02, 0.01, 0.03), pose.translation((0.0, 0.0, 0.02)), "support"),))
    mesh = group.mesh()
    assert group.measured == ()
    assert mesh.bounds[0, 2] == pytest.approx(0.005)
    target = pose.from_euler_xyz((0.1, 0.0, 0.0), (0.5, 0.0, 0.0))
    moved = mesh.transformed(target)
    np.testing.assert_allclose(moved.vertices, pose.transform_points(target, mesh.vertices), atol=1e-15)
    assert np.abs(moved.shapes.nearest(moved.vertices)[0]).max() < 1e-15


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Sphere(0.0), "radius"),
        (lambda: Box(0.1, -0.1, 0.1), "size_y"),
        (lambda: Cone(0.1, float("nan"), 0.1), "radius"),
        (lambda: Cone(0.1, -0.1, 0.1), "radius"),
        (lambda: Ring(0.02, 0.02, 0.1), "inner_radius"),
        (lambda: ShapeGroup(()), "no shapes"),
    ],
)
def test_invalid_dimensions_are_rejected(make, message):
    with pytest.raises(ValueError, match=message):
        make()
