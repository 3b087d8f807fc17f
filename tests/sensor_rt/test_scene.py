"""Ray casting on meshes and primitives, and closest points, compared with closed forms and brute force."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
import trimesh
from scenes import Array, pose, random_pose

from scancell.geometry.shapes import Box, Cone, Cylinder, Plane, Ring, Shape
from scancell.sensor import MeshSurface, Scene, cast_rays, closest_points, occluded


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


def rays_towards(rng: np.random.Generator, count: int, distance: float, spread: float) -> tuple[Array, Array]:
    """Origins on a sphere with directions to points near the centre."""
    origins = rng.normal(size=(count, 3))
    origins *= distance / np.linalg.norm(origins, axis=1, keepdims=True)
    directions = rng.uniform(-spread, spread, (count, 3)) - origins
    return origins, directions / np.linalg.norm(directions, axis=1, keepdims=True)


def in_body(world_from_body: Array, origins: Array, directions: Array) -> tuple[Array, Array]:
    body_from_world = np.linalg.inv(world_from_body)
    return origins @ body_from_world[:3, :3].T + body_from_world[:3, 3], directions @ body_from_world[:3, :3].T


def test_sphere_hits_are_exact(rng: np.random.Generator) -> None:
    scene = Scene()
    centre = np.array([0.01, -0.02, 0.03])
    scene.add_sphere("ball", centre, 0.025, 0.5)
    world_from_ball = random_pose(rng, 0.01)
    origins, directions = rays_towards(rng, 5000, 0.3, 0.06)
    distance, body, face = cast_rays(scene, world_from_ball[None], origins, directions)
    o, d = in_body(world_from_ball, origins, directions)
    along = -((o - centre) * d).sum(axis=1)
    gap2 = ((o - centre + along[:, None] * d) ** 2).sum(axis=1)
    expected = np.where(gap2 < 0.025**2, along - np.sqrt(np.maximum(0.025**2 - gap2, 0.0)), np.inf)
    clear = np.abs(np.sqrt(gap2) - 0.025) > 1e-9
    assert (np.isfinite(expected)).sum() > 500
    np.testing.assert_array_equal(np.isfinite(distance)[clear], np.isfinite(expected)[clear])
    hit = clear & np.isfinite(expected)
    # The distance to a grazed sphere is sensitive to the ray; the hit's distance from the centre is not.
    points = o[hit] + distance[hit, None] * d[hit]
    np.testing.assert_allclose(np.linalg.norm(points - centre, axis=1), 0.025, rtol=1e-12)
    np.testing.assert_allclose(distance[hit], expected[hit], rtol=1e-9)
    np.testing.assert_array_equal(body, np.where(np.isfinite(distance), 0, -1))
    np.testing.assert_array_equal(face, np.where(np.isfinite(distance), 0, -1))


SHAPES = {
    "box": Box(0.03, 0.05, 0.02),
    "cylinder": Cylinder(0.02, 0.05),
    "plane": Plane(0.04, 0.06),
    "tapered cone": Cone(0.02, 0.008, 0.04),
    "widening cone": Cone(0.005, 0.025, 0.01),
    "pointed cone": Cone(0.02, 0.0, 0.05),
    "ring": Ring(0.012, 0.025, 0.02),
}


def add_shape(scene: Scene, name: str, body_from_shape: Array, shape: Shape) -> None:
    values = [float(getattr(shape, field.name)) for field in fields(shape)]
    if isinstance(shape, Box | Plane):
        add = scene.add_box if isinstance(shape, Box) else scene.add_plane
        add(name, body_from_shape, values, 0.5)
    else:
        getattr(scene, f"add_{type(shape).__name__.lower()}")(name, body_from_shape, *values, 0.5)


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("start", ["outside", "among"])
def test_primitive_hits_match_signed_distance(name: str, start: str, rng: np.random.Generator) -> None:
    """A hit lies on the surface, and the ray crosses it nowhere before; also from inside and from a bore."""
    shape, scene, body_from_shape = SHAPES[name], Scene(), random_pose(rng, 0.02)
    add_shape(scene, "body", body_from_shape, shape)
    world_from_body = random_pose(rng, 0.01)
    origins, directions = rays_towards(rng, 1500, 0.3, 0.04)
    if start == "among":
        target = world_from_body @ body_from_shape
        origins = rng.uniform(-0.03, 0.03, (1500, 3)) @ target[:3, :3].T + target[:3, 3]
    distance, _, _ = cast_rays(scene, world_from_body[None], origins, directions)
    o, d = in_body(world_from_body @ body_from_shape, origins, directions)
    hit = np.isfinite(distance)
    assert 100 < hit.sum() < 1450
    assert np.abs(shape.nearest(o[hit] + distance[hit, None] * d[hit])[0]).max() < 1e-15
    if name == "plane":
        t = -o[:, 2] / d[:, 2]
        across = np.abs(o + t[:, None] * d)[:, :2]
        np.testing.assert_array_equal(hit, (t > 0) & (across < [0.02, 0.03]).all(axis=1))
        return
    end = np.where(hit, distance - 1e-9, 1.0)
    steps = np.linspace(0.0, 1.0, 501)[:, None, None]
    path = (o + steps * end[:, None] * d).reshape(-1, 3)
    side = np.sign(shape.nearest(o)[0])
    assert (side * shape.nearest(path)[0].reshape(len(steps), -1)).min() > -1e-9


@pytest.mark.parametrize("name", SHAPES)
def test_occlusion_by_primitives_agrees_with_hits(name: str, rng: np.random.Generator) -> None:
    scene = Scene()
    add_shape(scene, "body", np.eye(4), SHAPES[name])
    starts, ends = rng.uniform(-0.05, 0.05, (2, 4000, 3))
    distance, _, _ = cast_rays(scene, np.eye(4)[None], starts, ends - starts)
    length = np.linalg.norm(ends - starts, axis=1)
    blocked = occluded(scene, np.eye(4)[None], starts, ends)
    clear = np.abs(distance - length) > 1e-9
    np.testing.assert_array_equal(blocked[clear], (distance < length)[clear])
    assert 200 < blocked.sum() < 3800


def test_ring_is_open_along_its_axis() -> None:
    scene = Scene()
    scene.add_ring("ring", np.eye(4), 0.01, 0.02, 0.03, 0.5)
    origins = [[0, 0, 1], [0.0099, 0, 1], [0.0101, 0, 1], [0.0201, 0, 1], [0, 0, 0], [0.015, 0, 0]]
    directions = [[0, 0, -1], [0, 0, -1], [0, 0, -1], [0, 0, -1], [1, 0, 0], [-1, 0, 0]]
    distance, _, _ = cast_rays(scene, np.eye(4)[None], origins, directions)
    np.testing.assert_allclose(distance, [np.inf, np.inf, 0.985, np.inf, 0.01, 0.005], rtol=1e-14)


def test_cone_is_hit_along_its_axis_its_flank_and_its_apex() -> None:
    scene = Scene()
    scene.add_cone("cone", np.eye(4), 0.03, 0.0, 0.04, 0.5)
    flank = np.array([-0.03, 0.0, 0.04])
    inside = [0.015 - 1e-6, 0.0, 0.0]  # on a ray that runs along the flank at a depth of 0.8 µm
    origins = [[0, 0, 1], [0, 0, -1], [0.015, 0, 1], [0.0, 0.0, 0.0], inside]
    directions = [[0, 0, -1], [0, 0, 1], [0, 0, -1], [1, 0, 0], flank / np.linalg.norm(flank)]
    distance, _, _ = cast_rays(scene, np.eye(4)[None], origins, directions)
    # The ray along the flank leaves through the opposite side, just below the apex.
    leaves = (0.02 - 1e-6 * 4 / 6) / 0.8
    np.testing.assert_allclose(distance[:4], [0.98, 0.98, 1.0, 0.015], rtol=1e-14)
    assert distance[4] == pytest.approx(leaves, abs=1e-12)


def test_axis_parallel_rays_hit_primitives() -> None:
    scene = Scene()
    scene.add_cylinder("pin", np.eye(4), 0.01, 0.04, 0.5)
    scene.add_box("box", np.eye(4), [0.02, 0.02, 0.02], 0.5)
    apart = np.stack([pose((0.0, 0.0, 0.0)), pose((0.1, 0.0, 0.0))])
    origins = [[0.003, 0.004, 1.0], [0.011, 0.0, 1.0], [0.105, 0.005, 1.0], [0.0, 0.0, 0.0], [0.1, 0.0, 0.0]]
    directions = [[0, 0, -1], [0, 0, -1], [0, 0, -2], [1, 0, 0], [0, -1, 0]]
    distance, body, _ = cast_rays(scene, apart, origins, directions)
    np.testing.assert_allclose(distance, [0.98, np.inf, 0.99, 0.01, 0.01], rtol=1e-14)
    np.testing.assert_array_equal(body, [0, -1, 1, 0, 1])


def test_mesh_hits_lie_on_their_faces_in_double_precision(rng: np.random.Generator) -> None:
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=0.03)
    offset = np.array([2.0, -1.0, 0.5])  # far from the body's origin
    scene = Scene()
    scene.add_mesh("ball", mesh.vertices + offset, mesh.faces, 0.5)
    world_from_body = pose((0.0, 0.0, 0.0), (0.3, -0.2, 1.0)) @ pose(-offset)
    origins, directions = rays_towards(rng, 4000, 0.2, 0.03)
    distance, _, face = cast_rays(scene, world_from_body[None], origins, directions)
    hit = face >= 0
    assert hit.sum() > 1000
    o, d = in_body(world_from_body, origins[hit], directions[hit])
    corners = (mesh.vertices + offset)[mesh.faces[face[hit]]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    expected = ((corners[:, 0] - o) * normals).sum(axis=1) / (d * normals).sum(axis=1)
    facing = np.abs((d * normals).sum(axis=1))
    # The inputs themselves are rounded: 2 m carry 4e-16 m.
    np.testing.assert_array_less(np.abs(distance[hit] - expected) * facing, 1e-12 * 0.2 + 2e-15)
    # The face is correct: the ray passes through the triangle.
    points = o + distance[hit, None] * d
    barycentric = trimesh.triangles.points_to_barycentric(corners, points)
    assert barycentric.min() > -1e-3


def test_closest_of_several_bodies_is_returned() -> None:
    scene = Scene()
    scene.add_plane("far", np.eye(4), [1, 1], 0.5)
    scene.add_sphere("near", [0, 0, 0], 0.01, 0.5)
    scene.add_mesh("middle", [[-1, -1, 0], [1, -1, 0], [0, 1, 0]], [[0, 1, 2]], 0.5)
    assert scene.bodies == ["far", "near", "middle"]
    poses = np.stack([pose((0, 0, 0.3)), pose((0, 0, 0.1)), pose((0, 0, 0.2))])
    distance, body, _ = cast_rays(scene, poses, [[0, 0, 0], [0.02, 0, 0], [0.02, 0, 0.25]], [[0, 0, 1]] * 3)
    np.testing.assert_allclose(distance, [0.09, 0.2, 0.05], rtol=1e-12)
    np.testing.assert_array_equal(body, [1, 2, 0])


def test_meshes_are_watertight_at_shared_edges(rng: np.random.Generator) -> None:
    mesh = trimesh.creation.box((0.1, 0.1, 0.1)).subdivide().subdivide().subdivide()
    scene = Scene()
    scene.add_mesh("box", mesh.vertices, mesh.faces, 0.5)
    edges = mesh.vertices[mesh.edges]
    on_edges = edges[:, 0] + rng.uniform(size=(len(edges), 1)) * (edges[:, 1] - edges[:, 0])
    origins = np.broadcast_to([0.31, 0.2, 0.27], on_edges.shape)
    inside = on_edges * (1.0 - 1e-6)
    distance, _, _ = cast_rays(scene, np.eye(4)[None], origins, inside - origins)
    assert np.isfinite(distance).all()


def test_closest_points_match_brute_force(rng: np.random.Generator) -> None:
    mesh = trimesh.creation.torus(0.03, 0.01, major_sections=24, minor_sections=16)
    points = rng.uniform(-0.05, 0.05, (400, 3))
    closest, face, signed = closest_points(mesh.vertices, mesh.faces, points)
    triangles = np.asarray(mesh.triangles)
    every = trimesh.triangles.closest_point(
        np.tile(triangles, (len(points), 1, 1)), np.repeat(points, len(triangles), axis=0)
    ).reshape(len(points), len(triangles), 3)
    distance = np.linalg.norm(every - points[:, None], axis=2).min(axis=1)
    np.testing.assert_allclose(np.abs(signed), distance, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(closest - points, axis=1), distance, rtol=1e-9, atol=1e-15)
    on_face = trimesh.triangles.closest_point(triangles[face], closest)
    np.testing.assert_allclose(on_face, closest, atol=1e-15)
    # Every point of this torus mesh lies within 1 mm inside the true torus.
    ring = np.hypot(np.hypot(points[:, 0], points[:, 1]) - 0.03, points[:, 2])
    sure = np.abs(ring - 0.0095) > 0.001
    np.testing.assert_array_equal(signed[sure] < 0, ring[sure] < 0.0095)


def test_sign_is_correct_at_edges_and_corners(rng: np.random.Generator) -> None:
    """Needle-shaped tetrahedron, where face normals give the wrong sign; vertices are not shared, as in STL."""
    corners = np.array([[0, 0, 0], [0.1, 0, 0], [0.0, 0.02, 0], [0, 0, 0.01]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    points = rng.uniform(-0.05, 0.15, (3000, 3))
    inside = (points > 0).all(axis=1) & (points @ [1 / 0.1, 1 / 0.02, 1 / 0.01] < 1)
    points = np.concatenate([points, rng.uniform(0, 1, (200, 3)) * [0.02, 0.004, 0.002]])
    inside = np.append(inside, np.ones(200, dtype=bool))
    _, _, signed = closest_points(corners[faces].reshape(-1, 3), np.arange(12).reshape(4, 3), points)
    np.testing.assert_array_equal(signed < 0, inside)


def test_closest_points_far_from_the_origin() -> None:
    """Double precision throughout: 1 µm is resolved 100 m from the origin."""
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=0.03)
    offset = np.array([100.0, -50.0, 20.0])
    directions = np.random.default_rng(1).normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    points = directions * 0.030001
    near = closest_points(mesh.vertices, mesh.faces, points)[2]
    far = closest_points(mesh.vertices + offset, mesh.faces, points + offset)[2]
    np.testing.assert_allclose(far, near, atol=1e-13)


def test_closest_points_do_not_depend_on_point_order(rng: np.random.Generator) -> None:
    """The search starts from the previous point's face; the lowest face index wins a tie."""
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=0.03)
    beside = mesh.vertices[mesh.faces].mean(1) + rng.normal(0, 1e-6, (len(mesh.faces), 3))
    points = np.concatenate(
        [beside, mesh.vertices, mesh.vertices[mesh.edges].mean(1), rng.uniform(-0.05, 0.05, (500, 3))]
    )
    surface = MeshSurface(mesh.vertices, mesh.faces)
    signed, face = surface.signed_distances(points)
    order = rng.permutation(len(points))
    again, other_face = surface.signed_distances(points[order], threads=1)
    np.testing.assert_array_equal(again, signed[order])
    np.testing.assert_array_equal(other_face, face[order])
    whole = closest_points(mesh.vertices, mesh.faces, points)
    np.testing.assert_array_equal(whole[1], face)
    np.testing.assert_array_equal(whole[2], signed)
    np.testing.assert_allclose(np.linalg.norm(whole[0] - points, axis=1), np.abs(signed), atol=1e-15)


def test_mesh_surface_copies_its_mesh() -> None:
    vertices = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    surface = MeshSurface(vertices, [[0, 1, 2]])
    vertices += 5.0
    signed, face = surface.signed_distances([[0.2, 0.2, 0.3]])
    np.testing.assert_allclose(signed, [0.3])
    assert face.tolist() == [0]


@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        (np.zeros((0, 3)), np.zeros((0, 3), int), "empty"),
        (np.eye(3), np.zeros((0, 3), int), "empty"),
        (np.eye(3), [[0, 1, 3]], "face 0 names vertex 3 of 3"),
        (np.eye(3), [[0, 1, -1]], "face 0 names vertex -1"),
        (np.eye(3), [[0.0, 1.0, 2.0]], "integers"),
        (np.full((3, 3), np.nan), [[0, 1, 2]], "vertex 0 is not finite"),
        (np.full((3, 3), np.inf), [[0, 1, 2]], "vertex 0 is not finite"),
        (np.eye(4), [[0, 1, 2]], "shape"),
        (np.eye(3), [0, 1, 2], "shape"),
    ],
)
def test_invalid_meshes_are_rejected(vertices: Array, faces: Array, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Scene().add_mesh("part", vertices, faces, 0.5)
    with pytest.raises(ValueError, match=message):
        closest_points(vertices, faces, np.zeros((1, 3)))


def test_invalid_shapes_and_rays_are_rejected() -> None:
    scene = Scene()
    with pytest.raises(ValueError, match="reflectance"):
        scene.add_sphere("ball", [0, 0, 0], 0.01, 1.5)
    with pytest.raises(ValueError, match="positive"):
        scene.add_sphere("ball", [0, 0, 0], -0.01, 0.5)
    with pytest.raises(ValueError, match="positive"):
        scene.add_box("box", np.eye(4), [0.1, np.nan, 0.1], 0.5)
    with pytest.raises(ValueError, match="rigid"):
        scene.add_cylinder("pin", 2 * np.eye(4), 0.1, 0.1, 0.5)
    for radii in ((-0.1, 0.1), (0.1, np.nan), (0.0, 0.0)):
        with pytest.raises(ValueError, match="positive"):
            scene.add_cone("cone", np.eye(4), *radii, 0.1, 0.5)
    with pytest.raises(ValueError, match="smaller than the ring"):
        scene.add_ring("ring", np.eye(4), 0.1, 0.1, 0.1, 0.5)
    with pytest.raises(ValueError, match="name"):
        scene.add_sphere("", [0, 0, 0], 0.01, 0.5)
    assert scene.bodies == []
    scene.add_sphere("ball", [0, 0, 0], 0.01, 0.5)
    with pytest.raises(ValueError, match="poses"):
        cast_rays(scene, np.zeros((0, 4, 4)), [[0, 0, 0]], [[0, 0, 1]])
    with pytest.raises(ValueError, match="ray 0"):
        cast_rays(scene, np.eye(4)[None], [[0, 0, 0]], [[0, 0, 0]])
    with pytest.raises(ValueError, match="ray 1"):
        cast_rays(scene, np.eye(4)[None], [[0, 0, 0]] * 2, [[0, 0, 1], [np.nan, 0, 1]])
    directions = np.tile([0.0, 0, 1], (5000, 1))
    directions[[4000, 3000]] = np.inf
    with pytest.raises(ValueError, match="ray 3000 "):
        cast_rays(scene, np.eye(4)[None], np.zeros((5000, 3)), directions, threads=3)
    with pytest.raises(ValueError, match="point 0"):
        closest_points(np.eye(3), [[0, 1, 2]], [[0, 0, np.inf]])


def test_degenerate_faces_are_ignored() -> None:
    vertices = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0]]
    faces = [[0, 1, 2], [0, 1, 3], [0, 0, 0], [1, 1, 2]]
    closest, _, signed = closest_points(vertices, faces, [[0.2, 0.2, 0.5], [1.5, -1.0, 0.0]])
    np.testing.assert_allclose(closest, [[0.2, 0.2, 0.0], [1.5, 0.0, 0.0]], atol=1e-15)
    np.testing.assert_allclose(np.abs(signed), [0.5, 1.0])
    scene = Scene()
    scene.add_mesh("part", vertices, faces, 0.5)
    distance, _, _ = cast_rays(scene, np.eye(4)[None], [[0.2, 0.2, 1.0]], [[0, 0, -1]])
    np.testing.assert_allclose(distance, [1.0])
