"""Rendered light compared with closed forms: radiometry, stripe position, shadows, motion."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import (
    Array,
    ball,
    cluttered,
    fast_and_paths,
    moving,
    one_plane,
    plane,
    pose,
    probe,
    still,
    stripe_centres,
)
from stripe_images import make_sensor

from scancell.sensor import Exposures, Material, Scene, expected_electrons

PLANCK_C = 6.62607015e-34 * 299792458.0


def column_electrons(z: float, reflectance: float, column: Array, side: int, angle: float = 0.28) -> Array:
    """Electrons per column from a frontal plane at range z.

    Laser power on the piece of line that the column sees, times the share of its Lambertian reflection (radiance
    per power = reflectance / pi) that the lens' aperture subtends.
    """
    a, tilt, focal, pitch, f_number = 0.06, np.radians(29.3), 1024 / (2 * np.tan(np.radians(9.34))), 5e-6, 11.0
    depth = a * np.sin(tilt) + z * np.cos(tilt)  # along the optical axis, constant along the line
    y = -side * (column - 639.5) * depth / focal
    fan_angle_per_column = depth / focal * z / (y**2 + z**2)
    power = 1e-3 / (2 * angle) * fan_angle_per_column
    distance2 = a**2 + y**2 + z**2
    aperture = np.pi / 4 * (focal * pitch / f_number) ** 2
    solid_angle = aperture * (depth / np.sqrt(distance2)) / distance2
    collected = power * reflectance / np.pi * (z / np.sqrt(distance2)) * solid_angle
    return collected * 0.8 * 0.55 * 5e-4 * 660e-9 / PLANCK_C


@pytest.mark.parametrize("z", [0.078, 0.1, 0.13, 0.16])
def test_light_of_frontal_plane_matches_closed_form(z: float) -> None:
    images = one_plane(probe(), pose((0, 0, z)), 0.5)
    for image, side in zip(images, (1, -1), strict=True):
        _, total = stripe_centres(image)
        column = np.arange(1280.0)
        lit = np.abs((column - 639.5) / 1280) < 0.45
        expected = column_electrons(z, 0.5, column, side)
        np.testing.assert_allclose(total[lit], expected[lit], rtol=1e-3)


@pytest.mark.parametrize("distortion", [[0.0] * 5, [-0.12, 0.05, 0.002, -0.001, 0.03]])
@pytest.mark.parametrize("z", [0.078, 0.12, 0.16])
def test_stripe_lies_on_intersection_of_sheet_and_plane(z: float, distortion: list[float]) -> None:
    sensor = probe(camera={"distortion": distortion})
    world_from_plane = pose((0, 0, z), (0.25, -0.2, 0.4))
    images = one_plane(sensor, world_from_plane)
    normal = world_from_plane[:3, 2]
    for camera, image in zip(sensor.cameras, images, strict=True):
        rows, total = stripe_centres(image)
        lit = (total > 0.5 * total.max()) & (np.abs(rows - 511.5) < 490)  # the stripe is not clipped by the image
        columns = np.flatnonzero(lit)
        rays = camera.view_rays(np.stack([columns, rows[lit]], axis=1))
        centre = camera.sensor_from_camera[:3, 3]
        seen = centre + ((world_from_plane[:3, 3] - centre) @ normal / (rays @ normal))[:, None] * rays
        on_sheet = np.cross(normal, [1.0, 0.0, 0.0])
        on_sheet /= on_sheet[1]
        landing = np.stack([0 * seen[:, 1], seen[:, 1], z + seen[:, 1] * on_sheet[2]], axis=1)
        expected = camera.project(landing)
        slope = np.gradient(expected[:, 1], expected[:, 0])
        # Equal y on the plane, up to the stripe's slope in the image.
        error = rows[lit] - expected[:, 1] - slope * (columns - expected[:, 0])
        assert len(columns) > 600
        assert np.abs(error[5:-5]).max() < 0.01


def test_stripe_width_matches_sheet_width() -> None:
    laser = {"sheet_sigma": 80e-6, "divergence": 0.0}
    image = one_plane(probe(laser=laser), pose((0, 0, 0.12)))[0]
    column = image[:, 640].astype(float)
    rows = np.arange(1024)
    mean = (column * rows).sum() / column.sum()
    variance = (column * (rows - mean) ** 2).sum() / column.sum()
    tilt, a, z = np.radians(29.3), 0.06, 0.12
    focal = 1024 / (2 * np.tan(np.radians(9.34)))
    depth = a * np.sin(tilt) + z * np.cos(tilt)
    height = z * np.sin(tilt) - a * np.cos(tilt)
    px_per_metre = focal * (np.cos(tilt) * depth + np.sin(tilt) * height) / depth**2  # d row / d x on the plane
    # The pixel width adds 1/12; the Gaussian is truncated at 4.5 sigma.
    assert variance == pytest.approx((80e-6 * px_per_metre) ** 2 + 1 / 12, rel=2e-3)


def test_light_is_proportional_to_cosine_reflectance_and_time() -> None:
    sensor = probe()
    base = stripe_centres(one_plane(sensor, pose((0, 0, 0.12)), 0.4)[0])[1]
    twice = stripe_centres(one_plane(sensor, pose((0, 0, 0.12)), 0.8)[0])[1]
    np.testing.assert_allclose(twice, 2 * base, rtol=1e-6)
    scene = plane(0.4)
    longer = expected_electrons(scene, sensor, still(pose((0, 0, 0.12)), duration=15e-4))[0, 0]
    np.testing.assert_allclose(stripe_centres(longer)[1], 3 * base, rtol=1e-6)


def test_images_do_not_depend_on_exposures_before() -> None:
    """A thread reuses memory: of masks, corners, reflected light and views of the scene."""
    scene, poses = cluttered()
    scene.add_plane("mirror", np.eye(4), [0.1, 0.05], Material(0.9, "mirror", 0.0, 1.0))
    scene.add_light("lamp", "point", np.eye(4), [0.0, 0.0], 0.01, in_band=1.0)
    poses += [pose((0.02, 0.0, 0.12), (0.0, 0.8, 0.0)), pose((0.1, 0.0, -0.3))]
    later = [pose((1e-4, -3e-4, 2e-4), (0.004, 0.002, -0.006)) @ p for p in poses]
    elsewhere = [pose((0.0, 0.01, 0.01), (0.1, 0.0, 0.2)) @ p for p in poses]
    bodies = np.array([[poses, later], [elsewhere, elsewhere], [poses, later]]).transpose(0, 2, 1, 3, 4)
    exposures = Exposures(np.broadcast_to(np.eye(4), (3, 2, 4, 4)), bodies, np.full(3, 5e-4), np.array([4, 5, 4]))
    sensor = make_sensor(160, 128, cameras=2, render={"noise": False, "bounces": 1, "photons": 1024})
    first, other, again = expected_electrons(scene, sensor, exposures, threads=1)
    assert (first != other).mean() > 0.1
    np.testing.assert_array_equal(first, again)


def boxes_mesh(*boxes: tuple[Array, Array]) -> tuple[Array, NDArray[np.uint32]]:
    """Closed boxes (centre, size) as one mesh."""
    sides = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    of_one = np.array([face for a, b, c, d in sides for face in ((a, b, c), (a, c, d))])
    corners = np.array([[i, j, k] for i in (-0.5, 0.5) for j in (-0.5, 0.5) for k in (-0.5, 0.5)])
    vertices = np.concatenate([centre + corners * size for centre, size in boxes])
    faces = np.concatenate([of_one + 8 * n for n in range(len(boxes))])
    return vertices, faces.astype(np.uint32)


@pytest.mark.parametrize("inside_out", [False, True])
def test_closed_mesh_casts_shadow_of_its_triangles(inside_out: bool) -> None:
    """On itself, on another body, and where only the camera is outside of both."""
    slab = (np.array([0.0, 0.0, 0.0]), np.array([0.02, 0.03, 0.004]))
    bars = [(np.array([0.0, y, -0.012]), np.array([0.004, 0.002, 0.001])) for y in (-0.008, 0.003)]
    vertices, faces = boxes_mesh(slab, *bars)
    scene = Scene()
    scene.add_mesh("comb", vertices, faces[:, ::-1].copy() if inside_out else faces, 0.6)
    scene.add_plane("plane", np.eye(4), [0.2, 0.2], 0.4)
    exposures = still(pose((0.0, 0.004, 0.13), (0.2, 0.1, 0.3)), pose((0.0, 0.0, 0.15)))
    fast, paths = fast_and_paths(scene, exposures, 64, columns=(240, 1040))
    assert (paths > 0).sum() > 5000
    assert fast.sum() == pytest.approx(paths.sum(), rel=1e-3)
    total, true_total = fast.sum(axis=0), paths.sum(axis=0)
    assert np.mean(np.abs(total - true_total) < 0.01 * true_total.max()) > 0.98


def test_body_in_sheet_casts_sharp_shadow() -> None:
    """A bar across the fan at half the range shadows twice its own width; the cameras see past it."""
    scene = plane()
    scene.add_box("bar", np.eye(4), [0.002, 0.004, 0.002], 0.0)
    sensor = probe()
    z, bar = 0.14, 0.07
    image = expected_electrons(scene, sensor, still(pose((0, 0, z)), pose((0, 0.003, bar))))[0]
    for camera, light in zip(sensor.cameras, image, strict=True):
        _, total = stripe_centres(light)
        # Light passes the bar's far edge on one side and its near edge on the other.
        edges = np.array([[0.0, 0.001 * z / (bar + 0.001), z], [0.0, 0.005 * z / (bar - 0.001), z]])
        first, last = np.sort(camera.project(edges)[:, 0])
        dark = total == 0.0
        dark[:100] = dark[-100:] = False
        columns = np.flatnonzero(dark)
        assert columns.min() == pytest.approx(first, abs=1.5)  # only fully dark columns
        assert columns.max() == pytest.approx(last, abs=1.5)
        assert dark[columns.min() : columns.max() + 1].all()


def test_occlusion_affects_only_one_camera() -> None:
    scene = plane()
    scene.add_box("screen", np.eye(4), [0.01, 0.05, 0.01], 0.5)
    sensor = probe()
    seen = one_plane(sensor, pose((0, 0, 0.13)))
    half_way = 0.5 * sensor.cameras[0].sensor_from_camera[:3, 3] + 0.5 * np.array([0.0, 0.03, 0.13])
    image = expected_electrons(scene, sensor, still(pose((0, 0, 0.13)), pose(half_way)))[0]
    # The borders of the shadow in one camera refine the mesh that both share.
    np.testing.assert_allclose(image[1], seen[1], atol=0.03 * seen[1].max())
    assert image[1].sum() == pytest.approx(seen[1].sum(), rel=1e-4)
    _, total = stripe_centres(image[0])
    # The screen ends at y = -0.01, half way to the stripe at y = -0.02.
    end = sensor.cameras[0].project([[0.0, -0.02, 0.13]])[0, 0]
    lit = np.flatnonzero(total > 0.5 * total.max())
    y_below = lit[lit > 639]
    assert len(y_below) > 0
    assert y_below.min() == pytest.approx(end, abs=40.0)
    assert total[: int(end) - 60].max(initial=0.0) == 0.0


def test_only_side_facing_laser_and_camera_is_lit() -> None:
    """Seen from behind, an open surface is dark although the laser hits its other side."""
    images = one_plane(probe(), pose((0, 0, 0.12), (0.0, np.radians(75.0), 0.0)))
    bright = images.reshape(2, -1).max(axis=1)
    assert (bright == 0).sum() == 1
    assert bright.max() > 0


def test_moving_exposure_is_average_of_static_ones() -> None:
    scene = ball(0.02, 0.6)
    sensor = probe()
    start, end = pose((0, 0.002, 0.13)), pose((0.0001, 0.0023, 0.1302), (0.01, 0.02, -0.01))
    blurred = expected_electrons(scene, sensor, moving([[start], [end]], [np.eye(4)] * 2))[0].astype(float)
    steps = (np.arange(256) + 0.5) / 256
    average = np.zeros_like(blurred)
    for s in steps:
        position = start[:3, 3] + s * (end[:3, 3] - start[:3, 3])
        average += expected_electrons(scene, sensor, still(pose(position)))[0] / len(steps)
    for camera in range(2):
        rows, total = stripe_centres(blurred[camera])
        expected_rows, expected_total = stripe_centres(average[camera])
        bright = expected_total > 0.2 * expected_total.max()
        np.testing.assert_allclose(total[bright], expected_total[bright], rtol=5e-3)
        assert np.abs(rows - expected_rows)[bright].max() < 0.01


def test_only_relative_motion_matters() -> None:
    scene, poses = cluttered()
    sensor = probe()
    step = pose((2e-4, 1e-4, -1e-4), (0.003, -0.002, 0.001))
    by_body = expected_electrons(scene, sensor, moving([poses, [step @ p for p in poses]], [np.eye(4)] * 2))
    by_sensor = expected_electrons(scene, sensor, moving([poses] * 2, [np.eye(4), np.linalg.inv(step)]))
    assert by_body.max() > 0
    # The two paths between the end poses differ in second order: 4e-3 rad squared on 0.15 m.
    np.testing.assert_allclose(by_body.sum(axis=(2, 3)), by_sensor.sum(axis=(2, 3)), rtol=1e-3)


def test_static_exposure_does_not_depend_on_pose_samples() -> None:
    scene, poses = cluttered()
    sensor = probe()
    once = expected_electrons(scene, sensor, still(*poses))
    often = expected_electrons(scene, sensor, moving([poses] * 5, [np.eye(4)] * 5))
    np.testing.assert_array_equal(once, often)


def test_ambient_light_of_plane_matches_closed_form() -> None:
    """Flat field: reflected irradiance with cos⁴ falloff."""
    sensor = probe(laser={"power": 0.0}, ambient={"irradiance": 3.0})
    images = one_plane(sensor, pose((0, 0, 0.13)), 0.5, size=2.0)
    focal = sensor.cameras[0].focal_px
    column, row = np.meshgrid(np.arange(1280) - 639.5, np.arange(1024) - 511.5)
    cosine = 1 / np.sqrt(1 + (column**2 + row**2) / focal**2)
    image_irradiance = 0.8 * 0.5 * 3.0 * cosine**4 / (4 * 11.0**2)
    expected = image_irradiance * 25e-12 * 0.55 * 5e-4 * 660e-9 / PLANCK_C
    np.testing.assert_allclose(images, np.broadcast_to(expected, images.shape), rtol=1e-5)


@pytest.mark.parametrize("samples", [1, 4, 16, 64])
def test_light_converges_with_samples(samples: int) -> None:
    """Path tracing converges to the stripe of the fast mode."""
    fast, paths = fast_and_paths(plane(), still(pose((0, 0, 0.12), (0.2, 0.1, 0.0))), samples)
    reference = stripe_centres(fast)
    rows, total = stripe_centres(paths)
    bright = reference[1] > 0.5 * reference[1].max()
    assert np.nanmax(np.abs(rows - reference[0])[bright]) < {1: 0.1, 4: 0.02}.get(samples, 0.003)
    np.testing.assert_allclose(total[bright], reference[1][bright], rtol={1: 0.1, 4: 0.02}.get(samples, 0.003))


def test_empty_view_gives_dark_images() -> None:
    sensor = probe()
    assert expected_electrons(Scene(), sensor, still()).max() == 0.0
    scene = ball(0.01)
    for place in ((0, 0, -0.1), (0.3, 0, 0.1), (0, 0, 3.0)):
        assert expected_electrons(scene, sensor, still(pose(place))).max() == 0.0
