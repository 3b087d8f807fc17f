"""Geometric engine compared with closed forms."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scenes import Array, ball, moving, plane, pose, probe, still

from scancell.sensor import Material, Profiles, Scene, closest_points, scan, triangulate_pixels


def geometric(scene: Scene, *bodies: Array, **overrides: object) -> Profiles:
    return scan(scene, probe(**overrides), still(*bodies), engine="geometric").profiles


def test_sphere_points_are_exact_and_complete() -> None:
    scene = Scene()
    scene.add_sphere("ball", [0.001, 0.002, -0.001], 0.02, 0.7)
    world_from_ball = pose((0.0, 0.004, 0.13), (0.3, 0.2, 0.1))
    profiles = geometric(scene, world_from_ball)
    centre = (world_from_ball @ [0.001, 0.002, -0.001, 1.0])[:3]
    points = profiles.points_in_sensor
    np.testing.assert_allclose(np.linalg.norm(points - centre, axis=1), 0.02, atol=1e-15)
    np.testing.assert_array_equal(points[:, 0], 0.0)
    # The visible lit cap: rays at equal angles that hit the sphere on the camera's side.
    angles = 0.28 * (2 * (np.arange(1280) + 0.5) / 1280 - 1)
    rays = np.stack([0 * angles, np.sin(angles), np.cos(angles)], axis=1)
    along = rays @ centre
    rest = 0.02**2 - (centre @ centre - along**2)
    landing = (along - np.sqrt(np.maximum(rest, 0)))[:, None] * rays
    for number, camera in enumerate(probe().cameras):
        viewpoint = camera.sensor_from_camera[:3, 3]
        faces = ((landing - centre) * (viewpoint - landing)).sum(axis=1) > 0
        pixels = camera.project(landing)
        inside = (np.abs(pixels - [639.5, 511.5]) < [640, 512]).all(axis=1)
        expected = landing[(rest > 0) & faces & inside]
        found = points[profiles.camera == number]
        order = np.argsort(found[:, 1])
        assert len(found) > 300
        np.testing.assert_allclose(found[order], expected, atol=1e-12)


def test_pixels_are_projections_sorted_by_column() -> None:
    scene = plane()
    profiles = geometric(scene, pose((0, 0, 0.13), (0.3, 0.2, 0.0)), camera={"distortion": [-0.1, 0.05, 1e-3, 1e-3, 0]})
    sensor = probe(camera={"distortion": [-0.1, 0.05, 1e-3, 1e-3, 0]})
    for number, camera in enumerate(sensor.cameras):
        mine = profiles.camera == number
        pixels = camera.project(profiles.points_in_sensor[mine])
        np.testing.assert_allclose(profiles.row[mine], pixels[:, 1], atol=1e-9)
        np.testing.assert_allclose(profiles.column[mine], pixels[:, 0], atol=0.5 + 1e-9)
        assert (np.diff(profiles.column[mine]) >= 0).all()


def test_intensity_equals_reflectance_times_cosine() -> None:
    scene = plane(0.4)
    profiles = geometric(scene, pose((0, 0, 0.13), (0.0, 0.3, 0.0)))
    points = profiles.points_in_sensor
    normal = pose(angles=(0.0, 0.3, 0.0))[:3, 2]
    cosine = np.abs(points @ normal) / np.linalg.norm(points, axis=1)
    np.testing.assert_allclose(profiles.intensity, 0.4 * cosine, rtol=1e-6)


def test_shadow_occlusion_and_range_limits() -> None:
    scene = plane()
    scene.add_box("bar", np.eye(4), [0.002, 0.004, 0.002], 0.5)
    profiles = geometric(scene, pose((0, 0, 0.14)), pose((0, 0.003, 0.07)))
    y, z = profiles.points_in_sensor[:, 1:].T
    on_plane = np.isclose(z, 0.14)
    # Light passes the bar's far edge on one side and its near edge on the other.
    shadow = (y > 0.001 * 0.14 / 0.071) & (y < 0.005 * 0.14 / 0.069)
    assert not (on_plane & shadow).any()
    assert (on_plane & ~shadow).sum() > 500
    scene = plane()
    scene.add_box("screen", np.eye(4), [0.01, 0.2, 0.01], 0.5)
    hidden = geometric(scene, pose((0, 0, 0.13)), pose((0.03, 0.0, 0.065)))
    assert set(hidden.camera) == {1}
    near = geometric(scene, pose((0, 0, 0.13)), pose((1, 0, 0)), range={"near": 0.14, "far": 0.2})
    assert len(near) == 0


def test_mesh_hits_match_double_precision_triangles() -> None:
    mesh = trimesh.creation.icosphere(subdivisions=6, radius=0.02)
    scene = Scene()
    scene.add_mesh("ball", mesh.vertices, mesh.faces, 0.5)
    world_from_body = pose((0.0, 0.004, 0.13), (0.3, 0.2, 0.1))
    points = geometric(scene, world_from_body).points_in_sensor
    body_from_world = np.linalg.inv(world_from_body)
    in_body = points @ body_from_world[:3, :3].T + body_from_world[:3, 3]
    _, face, distance = closest_points(mesh.vertices, mesh.faces, in_body)
    corners = mesh.triangles[face]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    assert len(face) > 600
    assert np.abs(((in_body - corners[:, 0]) * normals).sum(axis=1)).max() < 1e-9
    assert np.abs(distance).max() < 1e-9


def fine_rubble(seed: int) -> tuple[Array, Array]:
    """Height field with a slot and, in front of it, sparse splinters of all sizes, some degenerate; in random order."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.linspace(-0.01, 0.01, 251), np.linspace(-0.04, 0.04, 501), indexing="ij")
    ground = np.stack([x, y, 2e-4 * np.sin(900 * x) * np.cos(700 * y)], -1).reshape(-1, 3)
    first = (np.arange(250)[:, None] * 501 + np.arange(500)).ravel()
    faces = np.concatenate([first[:, None] + [0, 501, 1], first[:, None] + [1, 501, 502]])
    faces = faces[(np.abs(ground[faces, 1] - 0.01) > 5e-4).any(axis=1)]
    middle = rng.uniform([-0.01, -0.04, -0.03], [0.01, 0.04, -0.002], (3000, 1, 3))
    splinters = middle + rng.normal(size=(3000, 3, 3)) * 10 ** rng.uniform(-6, -3, (3000, 1, 1))
    splinters[::7, 2] = splinters[::7, 1]
    corners = np.arange(9000).reshape(-1, 3) + len(ground)
    return np.concatenate([ground, splinters.reshape(-1, 3)]), rng.permutation(np.concatenate([faces, corners]))


def first_met(vertices: Array, faces: Array, across: Array) -> Array:
    """Depth of the closest hits of rays from the origin in the plane x = 0 at these y / z; NaN: no hit."""
    corners = vertices[faces]
    above = corners[..., 0] >= 0
    corners = corners[above.any(axis=1) & ~above.all(axis=1)]
    ends = []
    for a, b in ((0, 1), (1, 2), (2, 0)):
        p, q = corners[:, a], corners[:, b]
        is_cut = (p[:, 0] >= 0) != (q[:, 0] >= 0)
        share = np.divide(p[:, 0], p[:, 0] - q[:, 0], out=np.full(len(p), np.nan), where=is_cut)
        ends.append((p + share[:, None] * (q - p))[:, 1:])
    end = np.stack(ends, 1)
    (y0, z0), (y1, z1) = np.moveaxis(end[np.isfinite(end[..., 0])].reshape(-1, 2, 2), (1, 2), (0, 1))
    depth = np.full(len(across), np.inf)
    for low, high, y, z, dy, dz in zip(
        np.minimum(y0 / z0, y1 / z1), np.maximum(y0 / z0, y1 / z1), y0, z0, y1 - y0, z1 - z0, strict=True
    ):
        here = slice(np.searchsorted(across, low), np.searchsorted(across, high, side="right"))
        # y + s dy = across (z + s dz)
        share = (across[here] * z - y) / (dy - across[here] * dz)
        depth[here] = np.minimum(depth[here], z + share * dz)
    return depth


@pytest.mark.parametrize(("seed", "rays", "half_angle"), [(1, 1280, 0.28), (3, 5000, 0.6), (5, 40, 1.2), (7, 1, 0.28)])
def test_fine_mesh_matches_brute_force(seed: int, rays: int, half_angle: float) -> None:
    vertices, faces = fine_rubble(seed)
    assert len(faces) > 240_000
    scene = Scene()
    scene.add_mesh("rubble", vertices, faces, 0.5)
    world_from_body = pose((0.0, 0.001, 0.13), (0.2, 0.1, 0.3))
    profiles = geometric(scene, world_from_body, laser={"fan_half_angle": half_angle}, geometric={"rays": rays})
    across = np.tan(half_angle * (2 * (np.arange(rays) + 0.5) / rays - 1))
    depth = first_met(vertices @ world_from_body[:3, :3].T + world_from_body[:3, 3], faces, across)
    points = profiles.points_in_sensor
    ray = np.argmin(np.abs(points[:, 1:2] / points[:, 2:] - across), axis=1)
    np.testing.assert_allclose(points[:, 1] / points[:, 2], across[ray], atol=1e-12)
    error = np.abs(points[:, 2] - depth[ray])
    # Rounding moves the edge of a splinter, and with it the ray that just hits it, by some 10 nm.
    on_ground = (np.abs(across) < 0.2).sum()
    assert len(np.unique(ray)) > 0.85 * on_ground
    assert (error > 2e-9).sum() <= 2


def test_enclosing_room_causes_no_occlusion() -> None:
    ball, room = trimesh.creation.icosphere(subdivisions=4, radius=0.02), trimesh.creation.box([1, 1, 1])
    alone, inside = Scene(), Scene()
    alone.add_mesh("ball", ball.vertices, ball.faces, 0.5)
    inside.add_mesh("ball", ball.vertices, ball.faces, 0.5)
    inside.add_mesh("room", room.vertices, room.faces, 0.5)
    expected = geometric(alone, pose((0, 0, 0.13)))
    found = geometric(inside, pose((0, 0, 0.13)), pose((0.1, 0.1, 0.1)))
    assert len(expected) > 600
    np.testing.assert_array_equal(found.points_in_sensor, expected.points_in_sensor)


def test_moving_profile_is_sampled_at_mid_exposure() -> None:
    scene = ball(0.02, 0.7)
    sensor = probe()
    start, end = pose((0, 0.0, 0.13)), pose((0.0, 0.001, 0.132))
    moved = scan(scene, sensor, moving([[start], [end]], [np.eye(4)] * 2), engine="geometric").profiles
    middle = scan(scene, sensor, still(pose((0, 0.0005, 0.131))), engine="geometric").profiles
    np.testing.assert_allclose(moved.points_in_sensor, middle.points_in_sensor, atol=1e-15)


@pytest.mark.parametrize("rays", [1, 15, 16, 17, 1000])
def test_number_of_rays_need_not_fill_packets(rays: int) -> None:
    scene = plane()
    profiles = geometric(scene, pose((0, 0, 0.16)), geometric={"rays": rays}, laser={"fan_half_angle": 0.1})
    assert len(profiles) == 2 * rays


def test_ideal_mirrors_show_no_stripe_but_occlude() -> None:
    scene = plane()
    scene.add_plane("mirror", np.eye(4), [0.1, 0.01], Material(0.9, "mirror", 0.0, 1.5))
    poses = (pose((0, 0, 0.14)), pose((0, 0, 0.12)))
    points = geometric(scene, *poses).points_in_sensor
    assert len(points) > 500
    np.testing.assert_allclose(points[:, 2], 0.14, atol=1e-12)
    lit = points[:, 1] * 0.12 / 0.14
    assert (np.abs(lit) > 0.005 - 1e-9).all()


def test_eq4_and_range_apply_to_measured_points() -> None:
    scene = plane()
    at = pose((0, 0, 0.13), (0.3, 0.2, 0.0))
    exact, printed = (geometric(scene, at, extraction={"triangulation": form}) for form in ("exact", "eq4_as_printed"))
    sensor = probe()
    for camera in (0, 1):
        mine = exact.camera == camera
        pixels = sensor.cameras[camera].project(exact.points_in_sensor[mine])
        expected = triangulate_pixels(pixels, sensor, camera, "eq4_as_printed")
        np.testing.assert_allclose(printed.points_in_sensor[printed.camera == camera], expected, atol=1e-12)
    assert np.abs(printed.points_in_sensor - exact.points_in_sensor).max() > 1e-5
    # The true baseline exceeds the nominal one: all measured ranges are too small by the same ratio.
    limits = {"near": 0.12, "far": 0.14}
    measured = scan(scene, probe(range=limits), still(at), "geometric", as_built=probe(camera={"baseline": 0.0612}))
    z = measured.profiles.points_in_sensor[:, 2]
    assert z.min() == pytest.approx(0.12, abs=1e-4)
    assert 0.12 <= z.min() < z.max() <= 0.14
