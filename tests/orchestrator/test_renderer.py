"""Pictures of bodies against closed forms: silhouettes, depths, shadows, poses, and the laser's stripe."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from cells import ball, block, mesh_of

from scancell.config.loading import load_setup
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh
from scancell.nominal.cell import nominal_cell
from scancell.views.camera import LaserSheet, PinholeCamera, framing, laser_sheet, looking_at
from scancell.views.renderer import FLOOR, NOTHING, SUN, PaintedBody, Renderer

SIZE = (320, 200)
GREY = (0.7, 0.7, 0.7)
ABOVE = (0.3, -0.9, 0.8)


def renderer(*meshes: Mesh, floor_z: float = 0.0, lets_laser_pass: tuple[int, ...] = ()) -> Renderer:
    bodies = [PaintedBody(str(i), mesh, GREY, i in lets_laser_pass) for i, mesh in enumerate(meshes)]
    return Renderer(bodies, floor_z, np.zeros(3))


def at(*positions: tuple[float, float, float]) -> np.ndarray:
    return pose.translation(np.array(positions))


def world_points(camera: PinholeCamera, depth: np.ndarray) -> np.ndarray:
    """(h, w, 3) where the pixels look at."""
    column, row = np.meshgrid(np.arange(camera.width_px), np.arange(camera.height_px))
    directions = camera.directions(np.stack([column.ravel(), row.ravel()], -1).astype(float))
    return camera.centre + depth[..., None] * directions.reshape(*depth.shape, 3)


def test_directions_and_project_are_inverse() -> None:
    camera = looking_at((1.0, -2.0, 0.7), (0.1, 0.2, 0.3), SIZE)
    pixels = np.random.default_rng(1).uniform((-20, -20), (340, 220), (50, 2))
    depth = np.linspace(0.1, 5, 50)
    back, seen_depth = camera.project(camera.centre + depth[:, None] * camera.directions(pixels))
    np.testing.assert_allclose(back, pixels, atol=1e-9)
    np.testing.assert_allclose(seen_depth, depth, rtol=1e-12)


def test_camera_stands_upright_and_centred() -> None:
    camera = looking_at((1.0, -2.0, 0.7), (0.1, 0.2, 0.3), SIZE)
    pixels, _ = camera.project(np.array([(0.1, 0.2, 0.3), (0.1, 0.2, 0.4)]))
    np.testing.assert_allclose(pixels[0], [(SIZE[0] - 1) / 2, (SIZE[1] - 1) / 2], atol=1e-9)
    assert pixels[1, 0] == pytest.approx(pixels[0, 0])
    assert pixels[1, 1] < pixels[0, 1]  # higher in the world, higher in the picture


def test_points_behind_the_camera_have_no_pixel() -> None:
    pixels, depth = looking_at((1.0, 0.0, 0.0), (0.0, 0.0, 0.0), SIZE).project([(2.0, 0.0, 0.0)])
    assert depth[0] == pytest.approx(-1.0)
    assert np.isnan(pixels).all()


@pytest.mark.parametrize("azimuth", [-52.0, 80.0, 200.0])
@pytest.mark.parametrize("spread", [(1.0, 0.2, 0.3), (0.2, 0.3, 1.5)])
def test_framing_fills_the_picture_and_no_point_is_outside(azimuth: float, spread: tuple[float, ...]) -> None:
    points = np.random.default_rng(2).normal(size=(500, 3)) * spread
    pixels, depth = framing(points, azimuth, 25.0, SIZE).project(points)
    assert (depth > 0).all()
    rim = 0.05 * np.array(SIZE)
    middle = (np.array(SIZE) - 1) / 2
    off = np.abs(pixels - middle) / (np.array(SIZE) / 2 - rim)
    assert off.max() == pytest.approx(1.0, abs=1e-9)


def test_silhouette_of_a_sphere_has_the_size_of_the_pinhole_formula() -> None:
    """Its limb is seen at the angle asin(r / d) from the axis: f tan(asin(r / d)) px."""
    radius, away = 0.1, 0.9
    sphere = mesh_of(trimesh.creation.icosphere(5, radius))
    camera = looking_at((0.0, -away, 0.5), (0.0, 0.0, 0.5), SIZE)
    body = renderer(sphere).render(camera, at((0.0, 0.0, 0.5))).body
    expected = camera.focal_px * radius / np.sqrt(away**2 - radius**2)
    assert np.sqrt((body == 0).sum() / np.pi) == pytest.approx(expected, rel=3e-3)
    column, row = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    off = np.hypot(column - camera.principal_point[0], row - camera.principal_point[1])
    assert (body[off < expected - 0.5] == 0).all()
    assert (body[off > expected + 0.5] != 0).all()


def test_smoothed_outline_covers_the_area_of_the_silhouette() -> None:
    """Brightness of the pixels between a body and what is behind it says how much of each it covers."""
    radius, away = 0.1, 0.9
    camera = looking_at((0.0, -away, 5.0), (0.0, 0.0, 5.0), SIZE)
    disc = trimesh.creation.cylinder(radius, 1e-4, sections=720)
    disc.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, (1, 0, 0)))
    rendered = renderer(mesh_of(disc), floor_z=-50.0).render(camera, at((0.0, 0.0, 5.0)))
    light = rendered.light[..., 1]
    row, column = np.argwhere(rendered.body == 0)[len(np.argwhere(rendered.body == 0)) // 2]
    inside, outside = light[row, column], light[0, 0]
    covered = ((light - outside) / (inside - outside)).clip(0, 1).sum()
    assert covered == pytest.approx(np.pi * (camera.focal_px * radius / away) ** 2, rel=5e-3)


def test_the_nearer_body_hides_the_farther_one_and_depths_are_theirs() -> None:
    camera = looking_at((0.0, -1.0, 0.5), (0.0, 0.0, 0.5), SIZE)
    wall, plate = block(0.6, 0.02, 0.4), block(0.2, 0.02, 0.2)
    for first, second in (((0, 0, 0.3), (0, -0.3, 0.4)), ((0, -0.3, 0.3), (0, 0, 0.4))):
        rendered = renderer(wall, plate).render(camera, at(first, second))
        middle = rendered.body[SIZE[1] // 2, SIZE[0] // 2]
        assert middle == (1 if second[1] < first[1] else 0)
        front = min(first[1], second[1])
        assert rendered.depth[SIZE[1] // 2, SIZE[0] // 2] == pytest.approx(1.0 + front - 0.01, abs=1e-6)


def test_depth_of_the_floor_and_nothing_above_the_horizon() -> None:
    camera = looking_at((0.0, -2.0, 0.5), (0.0, 0.0, 0.5), SIZE)
    rendered = renderer(ball(0.01), floor_z=0.1).render(camera, at((0.0, 5.0, 0.5)))
    horizon = SIZE[1] // 2
    assert set(np.unique(rendered.body[horizon + 1 :])) == {FLOOR}
    assert (rendered.body[: horizon - 8] == NOTHING).all()
    assert np.isinf(rendered.depth[: horizon - 8]).all()
    points = world_points(camera, rendered.depth)[horizon + 1 :]
    np.testing.assert_allclose(points[..., 2], 0.1, atol=1e-9)


def test_shadow_of_a_sphere_lies_where_the_light_says() -> None:
    """A point is in shadow where its line towards the sun passes the centre by less than the radius."""
    radius, centre = 0.08, np.array([0.1, 0.05, 0.3])
    sphere = mesh_of(trimesh.creation.icosphere(5, radius))
    camera = looking_at((0.3, -1.2, 1.0), (0.2, 0.2, 0.0), SIZE)
    tool = renderer(sphere)
    rendered = tool.render(camera, at(tuple(centre)))
    bare = tool.render(camera, at((0.0, 0.0, -10.0)))  # under the floor
    points = world_points(camera, rendered.depth)
    off = centre - points
    past = np.linalg.norm(off - (off @ SUN)[..., None] * SUN, axis=-1)
    floor = rendered.body == FLOOR
    dark = rendered.light[..., 1] < 0.85 * bare.light[..., 1]
    inside, outside = floor & (past < radius - 0.006), floor & (past > radius + 0.006)
    assert inside.sum() > 300
    assert dark[inside].all()
    # Next to the sphere its smoothed outline is mixed in.
    near_sphere = np.zeros_like(floor)
    rows, columns = np.nonzero(rendered.body == 0)
    near_sphere[rows.min() - 1 : rows.max() + 2, columns.min() - 1 : columns.max() + 2] = True
    assert not dark[outside & ~near_sphere].any()


def test_a_body_casts_its_shadow_on_another_one() -> None:
    """The shadow of a plate on a table: its middle lies below the plate, shifted along the light."""
    table, plate = block(1.0, 1.0, 0.1), block(0.1, 0.1, 0.01)
    camera = looking_at((0.2, -0.8, 1.4), (0.1, 0.1, 0.1), SIZE)
    tool = renderer(table, plate)
    with_plate = tool.render(camera, at((0, 0, 0), (0.0, 0.0, 0.3)))
    without = tool.render(camera, at((0, 0, 0), (0.0, 0.0, -10.0)))
    dark = (with_plate.body == 0) & (with_plate.light[..., 1] < 0.7 * without.light[..., 1])
    middle = world_points(camera, with_plate.depth)[dark].mean(0)
    height = 0.305 - 0.1  # from the table to the middle of the plate
    np.testing.assert_allclose(middle[:2], -height * SUN[:2] / SUN[2], atol=0.005)


def test_bodies_of_the_arm_stand_where_forward_kinematics_puts_them() -> None:
    """The outline of each body alone is that of its projected vertices."""
    setup = load_setup()
    cell = nominal_cell(setup.cell, block(0.05, 0.05, 0.03))
    q = cell.home + np.array([0.4, -0.3, 0.2, 0.7, -0.5, 1.1])
    poses = cell.body_poses([*q, 0.6])
    everything = np.concatenate(
        [pose.transform_points(p, b.mesh.vertices) for p, b in zip(poses, cell.bodies, strict=True)]
    )
    camera = framing(everything, -52.0, 24.0, (640, 360))
    for body, world_from_body in zip(cell.bodies, poses, strict=True):
        mask = renderer(body.mesh, floor_z=-5.0).render(camera, world_from_body[None]).body == 0
        rows, columns = np.nonzero(mask)
        pixels, _ = camera.project(pose.transform_points(world_from_body, body.mesh.vertices))
        low, high = pixels.min(0), pixels.max(0)
        seen = np.array([[columns.min(), rows.min()], [columns.max(), rows.max()]])
        np.testing.assert_allclose(seen, [low, high], atol=1.0, err_msg=body.name)


# --- the laser ------------------------------------------------------------------------------------------------------

HEIGHT = 0.2  # of the source above the table's top
SLOPE = 0.4


def sheet(x: float = 0.02) -> LaserSheet:
    """A sensor that looks down from above the table's top at z = 0.1."""
    down = pose.from_rotation(pose.rotation_about(0, np.pi), (x, 0.0, 0.1 + HEIGHT))
    return LaserSheet(down, 0.0, SLOPE, 1e-4, 0.2)


def stripe_points(*blocker: tuple[float, float, float], lets_pass: bool = False) -> np.ndarray:
    """World points (n, 3) of the stripe on a table, with a cube of 20 mm at a place."""
    meshes = [block(0.6, 0.6, 0.1), block(0.02, 0.02, 0.02)]
    tool = renderer(*meshes, lets_laser_pass=(1,) if lets_pass else ())
    camera = looking_at((0.6, -0.2, 0.8), (0.0, 0.0, 0.1), (640, 400))
    rendered = tool.render(camera, at((0, 0, 0), *(blocker or ((0.0, 0.0, -10.0),))), sheet())
    on_table = (rendered.stripe > 0.5) & (rendered.body == 0)
    return world_points(camera, rendered.depth)[on_table]


def test_stripe_lies_in_the_sheet_and_is_as_long_as_the_fan_is_wide() -> None:
    points = stripe_points()
    assert len(points) > 50
    np.testing.assert_allclose(points[:, 0], 0.02, atol=4e-3)  # drawn three pixels wide
    np.testing.assert_allclose([points[:, 1].min(), points[:, 1].max()], [-SLOPE * HEIGHT, SLOPE * HEIGHT], atol=3e-3)


def test_sheet_is_seen_where_rays_cross_it_before_surfaces() -> None:
    """Points on the rays, in the plane of the laser, between the ends of its fan and below its source."""
    eye, rng = np.array([0.5, -0.2, 0.3]), np.random.default_rng(9)
    directions = np.array([0.02, 0.0, 0.2]) + rng.normal(0.0, 0.08, (500, 3)) - eye
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    to_sheet = (0.02 - eye[0]) / directions[:, 0]
    depth = to_sheet + np.where(rng.random(500) < 0.5, 0.01, -0.01)
    rows, points, left = sheet().veil(eye, directions, depth)
    np.testing.assert_allclose(points, eye + to_sheet[rows, None] * directions[rows], atol=1e-12)
    below = 0.1 + HEIGHT - points[:, 2]
    assert (np.abs(points[:, 1]) <= SLOPE * below + 1e-9).all()
    all_points = eye + to_sheet[:, None] * directions
    inside = np.abs(all_points[:, 1]) < SLOPE * (0.1 + HEIGHT - all_points[:, 2]) - 1e-9
    assert rows.tolist() == np.flatnonzero(inside & (depth > to_sheet)).tolist()
    assert 50 < len(rows) < 400
    assert ((left > 0) & (left <= 1)).all()


def test_a_body_in_the_sheet_shadows_the_stripe_behind_it() -> None:
    """A cube whose top is half way down, from y = 0.01 to 0.03, shadows twice that on the table."""
    y = stripe_points((0.02, 0.02, 0.1 + HEIGHT / 2 - 0.02))[:, 1]
    bottom = HEIGHT / (HEIGHT / 2 + 0.02)  # the lower edge casts the inner limit, the upper one the outer limit
    assert not ((y > 0.01 * bottom + 0.003) & (y < 0.03 * 2 - 0.003)).any()
    assert ((y > 0) & (y < 0.01 * bottom - 0.003)).any()
    assert ((y > 0.03 * 2 + 0.003) & (y < SLOPE * HEIGHT)).any()


def test_the_housing_of_the_sensor_does_not_shadow_its_laser() -> None:
    blocked, passed = stripe_points((0.02, 0.0, 0.25)), stripe_points((0.02, 0.0, 0.25), lets_pass=True)
    assert len(blocked) < 0.5 * len(passed)


def test_no_stripe_without_a_laser() -> None:
    rendered = renderer(block(0.6, 0.6, 0.1)).render(looking_at(ABOVE, (0, 0, 0), SIZE), at((0, 0, 0)))
    assert rendered.stripe.max() == 0


def test_sheet_of_a_described_sensor() -> None:
    sensor = load_setup().sensor
    world_from_sensor = pose.from_euler_xyz((0.3, 0.1, 0.5), (2.0, 0.3, 0.4))
    made = laser_sheet(sensor, world_from_sensor)
    z = 1e-3 * sensor.laser.source_z_mm
    np.testing.assert_allclose(made.source, pose.transform_points(world_from_sensor, np.array([[0.0, 0.0, z]]))[0])
    assert np.degrees(np.arctan(made.slope)) == pytest.approx(sensor.laser.fan_half_angle_deg)
