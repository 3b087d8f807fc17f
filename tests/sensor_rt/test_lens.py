"""Tilted sensor, depth of field and point spread function compared with thin-lens geometry."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from scenes import (
    ball,
    fast_and_paths,
    one_plane,
    plane,
    pose,
    probe,
    still,
    stripe_centres,
)
from stripe_images import make_sensor, width2

from scancell.sensor import Scene, expected_electrons, scan, triangulate_pixels

A, TILT, F_NUMBER, PITCH = 0.06, np.radians(29.3), 11.0, 5e-6
FOCAL_PX = 1024 / (2 * np.tan(np.radians(9.34)))
IMAGE_DISTANCE = FOCAL_PX * PITCH
RADIUS = IMAGE_DISTANCE / F_NUMBER / 2  # of the aperture
# The sheet, the lens plane and the sensor plane intersect in one line.
ON_SHEET = {"scheimpflug_x": float(-np.arctan(IMAGE_DISTANCE * np.cos(TILT) / A)), "focus": float(A / np.sin(TILT))}
TILTED = {"scheimpflug_x": -0.2, "scheimpflug_y": 0.08}
DISTORTED = {"distortion": [-0.12, 0.05, 0.002, -0.001, 0.03]}
MISPLACED = {"offset_y": 2e-4, "pan": 0.01, "roll": -0.02}
SHARP = {"noise": False, "samples_per_pixel": 64}


def depth_of(z: float) -> float:
    """Distance of the sheet centre along the optical axis."""
    return float(A * np.sin(TILT) + z * np.cos(TILT))


@pytest.mark.parametrize("camera", [{}, DISTORTED, TILTED, TILTED | DISTORTED, TILTED | DISTORTED | MISPLACED])
def test_projection_inverts_view_rays(camera: dict[str, Any]) -> None:
    for made in probe(camera=camera).cameras:
        u, v = np.meshgrid(np.linspace(-0.5, 1279.5, 13), np.linspace(-0.5, 1023.5, 11))
        pixels = np.stack([u.ravel(), v.ravel()], axis=1)
        points = made.sensor_from_camera[:3, 3] + np.linspace(0.05, 0.3, len(pixels))[:, None] * made.view_rays(pixels)
        np.testing.assert_allclose(made.project(points), pixels, atol=1e-9)


@pytest.mark.parametrize("tilt", [{}, TILTED])
def test_projection_matches_opencv(tilt: dict[str, float]) -> None:
    camera = probe(camera=tilt | DISTORTED).cameras[0]
    in_camera = np.random.default_rng(5).uniform([-0.03, -0.02, 0.1], [0.03, 0.02, 0.2], (200, 3))
    matrix = np.array([[camera.focal_px, 0, 639.5], [0, camera.focal_px, 511.5], [0, 0, 1]])
    tilts = [tilt.get(key, 0.0) for key in ("scheimpflug_x", "scheimpflug_y")]
    lens = np.array([*DISTORTED["distortion"], *[0.0] * 7, *tilts])
    expected, _ = cv2.projectPoints(in_camera, np.zeros(3), np.zeros(3), matrix, lens)
    at = camera.sensor_from_camera
    np.testing.assert_allclose(camera.project(in_camera @ at[:3, :3].T + at[:3, 3]), expected[:, 0], atol=1e-9)


@pytest.mark.parametrize("camera", [DISTORTED, TILTED, TILTED | DISTORTED, MISPLACED, TILTED | DISTORTED | MISPLACED])
@pytest.mark.parametrize("number", [0, 1])
def test_triangulation_is_exact_for_all_cameras(camera: dict[str, Any], number: int) -> None:
    sensor = probe(camera=camera)
    y, z = np.meshgrid(np.linspace(-0.015, 0.015, 7), np.linspace(0.08, 0.16, 9))
    points = np.stack([0 * y.ravel(), y.ravel(), z.ravel()], axis=1)
    seen = sensor.cameras[number].project(points)
    np.testing.assert_allclose(triangulate_pixels(seen, sensor, number, "exact"), points, atol=1e-12)
    np.testing.assert_allclose(triangulate_pixels(seen, sensor, number, "ray"), points, atol=1e-12)


@pytest.mark.parametrize("camera", [TILTED | DISTORTED, MISPLACED])
def test_both_engines_measure_plane_with_all_cameras(camera: dict[str, Any]) -> None:
    """Vectorised projection, pixel rays, triangulation and its uncertainty are consistent."""
    scene = plane()
    world_from_plane = pose((0, 0, 0.12), (0.2, 0.1, 0.0))
    sensor = probe(camera=camera)
    exposures = still(world_from_plane)
    for engine, tolerance in (("geometric", 1e-9), ("ray-traced", 2e-6)):
        profiles = scan(scene, sensor, exposures, engine).profiles  # type: ignore[arg-type]
        off = (profiles.points_in_sensor - world_from_plane[:3, 3]) @ world_from_plane[:3, 2]
        assert len(profiles) > 1500
        assert np.sqrt(np.mean(off**2)) < tolerance
    pixel = np.stack([profiles.column, profiles.row], axis=1)
    for number in (0, 1):
        mine = profiles.camera == number
        step = np.array([0.0, 1e-3])
        ends = [triangulate_pixels(pixel[mine] + s * step, sensor, number, "exact") for s in (1, -1)]
        slope = (ends[0] - ends[1]) / 2e-3
        along = slope / np.linalg.norm(slope, axis=1, keepdims=True)
        variance = np.einsum("ni,nij,nj->n", along, profiles.covariance[mine], along)
        np.testing.assert_allclose(variance, profiles.sigma[mine] ** 2, rtol=1e-4)


@pytest.mark.parametrize("focus", [0.1, 0.135, 0.18])
@pytest.mark.parametrize("z", [0.09, 0.12, 0.15])
def test_defocus_adds_the_variance_of_the_blur_disc(focus: float, z: float) -> None:
    """A uniform disc of radius r has the variance r²/4 along a row; r by similar triangles behind a thin lens."""
    sharp, blurred = (one_plane(probe(camera=c, render=SHARP), pose((0, 0, z)))[0] for c in ({}, {"focus": focus}))
    depth = depth_of(z)
    radius_px = RADIUS * abs(1 / focus - 1 / depth) * FOCAL_PX
    assert width2(blurred) == pytest.approx(width2(sharp) + radius_px**2 / 4, rel=0.02)


@pytest.mark.parametrize("z", [0.08, 0.1, 0.13, 0.16])
def test_scheimpflug_focuses_entire_sheet(z: float) -> None:
    leaning = {"scheimpflug_x": ON_SHEET["scheimpflug_x"]}
    sharp, focused = (one_plane(probe(camera=c, render=SHARP), pose((0, 0, z))) for c in (leaning, ON_SHEET))
    for a, b in zip(sharp, focused, strict=True):
        for column in (200, 640, 1100):
            assert width2(b, column) == pytest.approx(width2(a, column), rel=0.01)
    upright = one_plane(probe(camera={"focus": ON_SHEET["focus"]}, render=SHARP), pose((0, 0, z)))[0]
    beside = abs(depth_of(z) - ON_SHEET["focus"])
    if beside > 0.02:
        assert width2(upright) > 2 * width2(sharp[0])


@pytest.mark.parametrize("sigma", [0.3, 0.8, 2.0])
def test_psf_adds_variance_in_rows_and_columns(sigma: float) -> None:
    sharp, spread = (
        one_plane(probe(camera={"psf_sigma_px": s}, render=SHARP), pose((0, 0, 0.12)))[0] for s in (0, sigma)
    )
    assert width2(spread) == pytest.approx(width2(sharp) + sigma**2, rel=0.02)
    # The end of the stripe is blurred along the stripe.
    scene = Scene()
    scene.add_plane("plane", np.eye(4), [1, 0.02], 0.5)
    sensor = probe(camera={"psf_sigma_px": sigma}, render=SHARP)
    _, total = stripe_centres(expected_electrons(scene, sensor, still(pose((0, 0.0, 0.12))))[0, 0])
    end = sensor.cameras[0].project(np.array([[0.0, -0.01, 0.12]]))[0, 0]
    columns = np.arange(int(end) - 12, int(end) + 13)
    share = total / np.maximum(stripe_centres(spread)[1], 1e-12)  # relative to an infinite stripe
    drop, between = -np.diff(share[columns]), columns[:-1] + 0.5
    mean = (between * drop).sum() / drop.sum()
    assert mean == pytest.approx(end, abs=0.02)
    variance = ((between - mean) ** 2 * drop).sum() / drop.sum()
    assert variance == pytest.approx(sigma**2 + 2 / 12, rel=0.05)  # a pixel's width, and that of the difference


@pytest.mark.parametrize("sigma", [0.5, 0.505, 0.54, 0.5773, 0.6, 0.7, 0.799, 0.8, 0.83, 1.1, 1.7, 3.3, 7.1])
def test_point_spread_keeps_the_light_and_adds_its_variance(sigma: float) -> None:
    """Kernels of convolution: no negative weight, sum one, variance sigma²."""
    lens = {"width_px": 64, "cx_px": 31.5, "height_px": 192, "cy_px": 95.5}
    thin = {"power": 1.0, "sheet_sigma": 5e-6, "divergence": 0.0}  # its flanks do not hide those of the kernel
    sharp, spread = (
        one_plane(probe(camera=lens | {"psf_sigma_px": s}, render=SHARP, laser=thin), pose((0, 0, 0.107)))[0]
        for s in (0.0, sigma)
    )
    light, blurred = (float(image[:, 32].astype(float).sum()) for image in (sharp, spread))
    assert blurred == pytest.approx(light, rel=1e-4)
    assert width2(spread, 32) - width2(sharp, 32) == pytest.approx(sigma**2, rel=2e-3)


LENSES = {
    "tilted": TILTED,
    "defocus": {"focus": 0.11},
    "spread": {"psf_sigma_px": 0.9},
    "on sheet": ON_SHEET | {"psf_sigma_px": 0.6},
    "all": TILTED | DISTORTED | MISPLACED | {"focus": 0.14, "psf_sigma_px": 0.6},
}


BLURS = {
    "spread of half a pixel": {"psf_sigma_px": 0.5},
    "spread of a pixel": {"psf_sigma_px": 1.0},
    "focus near": {"focus": 0.08},
    "focus far": {"focus": 0.16},
    "wide aperture": {"focus": 0.12, "f_number": 4.0},
    "on sheet": ON_SHEET | {"psf_sigma_px": 0.6},
}


SAMPLED = {
    "narrow spread": {"psf_sigma_px": 0.3},
    "tilted out of focus": TILTED | {"focus": 0.14},
    "all": LENSES["all"],
}


@pytest.mark.parametrize("lens", BLURS | SAMPLED)
@pytest.mark.parametrize("z", [0.09, 0.15])
def test_blurred_stripe_matches_path_tracing(lens: str, z: float) -> None:
    """Centres within 0.02 px, whether a sharp image is blurred or the lens is sampled."""
    camera = (BLURS | SAMPLED)[lens]
    exposures = still(pose((0, 0, z), (0.15, -0.2, 0.3)))
    samples = 256 if lens in SAMPLED else 64
    fast, paths = fast_and_paths(
        plane(size=0.1), exposures, samples, (600, 680), camera, {"samples_per_pixel": samples}
    )
    (centre, total), (true_centre, true_total) = stripe_centres(fast), stripe_centres(paths)
    assert np.abs(centre - true_centre).max() < 0.02
    np.testing.assert_allclose(total, true_total, rtol=5e-3)
    middle = fast.shape[1] // 2
    assert width2(fast, middle) == pytest.approx(width2(paths, middle), rel=0.03)


@pytest.mark.parametrize("lens", ["defocus", "spread", "on sheet"])
def test_blur_conserves_light(lens: str) -> None:
    camera = LENSES[lens]
    bare = {"scheimpflug_x": camera.get("scheimpflug_x", 0.0)}
    sharp, blurred = (one_plane(probe(camera=c), pose((0, 0, 0.12))) for c in (bare, camera))
    np.testing.assert_allclose(blurred.sum(axis=(1, 2)), sharp.sum(axis=(1, 2)), rtol=2e-3)


def test_tilted_sensor_conserves_light() -> None:
    """Pixels of a tilted sensor cover other areas of the part, but the total stripe light is the same."""
    upright, leaning = (one_plane(probe(camera=c, render=SHARP), pose((0, 0, 0.12))) for c in ({}, TILTED))
    sensor = probe(camera=TILTED)
    for number, (a, b) in enumerate(zip(upright, leaning, strict=True)):
        # Compare between the same two points of the line.
        y = np.array([[0.0, -0.012, 0.12], [0.0, 0.012, 0.12]])
        sums = []
        for light, camera in ((a, probe().cameras[number]), (b, sensor.cameras[number])):
            first, last = np.sort(camera.project(y)[:, 0])
            total = np.concatenate([[0.0], np.cumsum(stripe_centres(light)[1])])
            sums.append(float(np.diff(np.interp([first, last], np.arange(len(total)) - 0.5, total))[0]))
        assert sums[1] == pytest.approx(sums[0], rel=2e-3)


@pytest.mark.parametrize("lens", ["on sheet", "all"])
def test_blurred_ball_matches_path_tracing(lens: str) -> None:
    scene, exposures = ball(0.02, 0.6), still(pose((0, 0.003, 0.135)))
    fast, paths = fast_and_paths(scene, exposures, 256, camera=LENSES[lens], render={"samples_per_pixel": 64})
    assert fast.sum() == pytest.approx(paths.sum(), rel=1e-3)
    np.testing.assert_allclose(fast, paths, atol=0.02 * paths.max())


@pytest.mark.parametrize("lens", ["tilted", "defocus", "on sheet"])
def test_reflected_light_matches_path_tracing_for_all_lenses(lens: str) -> None:
    """Light tracing compared with path tracing in a V-groove: same total diffuse light within the noise."""
    scene = Scene()
    scene.add_plane("left", pose((0, 0.0, 0), (0.7, 0, 0)), [0.05, 0.05], 0.8)
    scene.add_plane("right", pose((0, 0.0, 0), (-0.7, 0, 0)), [0.05, 0.05], 0.8)
    small = {"baseline": 0.06, "focal_px": 780.0, "pixel_pitch": 2e-5}
    camera = small | LENSES[lens]
    exposures = still(pose((0, 0, 0.13)), pose((0, 0, 0.13)))
    render = {"noise": False, "samples_per_pixel": 64, "bounces": 1, "photons": 262_144}
    fast, path = (
        expected_electrons(scene, make_sensor(320, 256, 2, camera=camera, render=render | {"mode": mode}), exposures)
        for mode in ("fast", "path")
    )
    direct = expected_electrons(
        scene, make_sensor(320, 256, 2, camera=camera, render=render | {"bounces": 0}), exposures
    )
    haze = [image.sum() - direct.sum() for image in (fast, path)]
    assert haze[1] > 0.02 * direct.sum()
    assert haze[0] == pytest.approx(haze[1], rel=0.03)
