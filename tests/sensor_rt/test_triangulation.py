"""Triangulation compared with independent ray-plane geometry, and the published form with its known error."""

from __future__ import annotations

import numpy as np
import pytest
from stripe_images import images_of, make_sensor, stripe

from scancell.sensor import PEAK_REJECTED, expose, extract, triangulate, triangulate_pixels

DISTORTION = [-0.12, 0.05, 1e-3, -5e-4, 0.01]
OFF_CENTRE = {"cx_px": 601.3, "cy_px": 533.7, "height": -0.004}


def pixels():
    """Sub-pixel grid over the entire image."""
    column, row = np.meshgrid(np.linspace(0.0, 1279.0, 23), np.linspace(0.0, 1023.0, 29))
    return np.stack([column.ravel(), row.ravel()], axis=1)


def camera_axes(side, tilt):
    """Camera axes (columns x, y, z) in the sensor frame as DESIGN defines them."""
    x = [0.0, -side, 0.0]
    y = [side * np.cos(tilt), 0.0, np.sin(tilt)]
    z = [-side * np.sin(tilt), 0.0, np.cos(tilt)]
    return np.array([x, y, z]).T


def rays_meet_sheet(pixel, side, focal, cx, cy, height):
    """Intersections of pinhole rays with the plane X = 0."""
    directions = np.stack([(pixel[:, 0] - cx) / focal, (pixel[:, 1] - cy) / focal, np.ones(len(pixel))])
    directions = (camera_axes(side, np.radians(29.3)) @ directions).T
    origin = np.array([side * 0.06, 0.0, height])
    return origin - (origin[0] / directions[:, :1]) * directions


def focal_of(height):
    return height / (2 * np.tan(np.radians(9.34)))


@pytest.mark.parametrize("camera", [0, 1])
@pytest.mark.parametrize("optics", [{}, OFF_CENTRE])
@pytest.mark.parametrize("form", ["exact", "ray"])
def test_points_lie_on_intersection_of_ray_and_sheet(camera, optics, form):
    sensor = make_sensor(cameras=2, camera=optics)
    expected = rays_meet_sheet(
        pixels(),
        1 - 2 * camera,
        focal_of(1024),
        optics.get("cx_px", 639.5),
        optics.get("cy_px", 511.5),
        optics.get("height", 0.0),
    )
    points = triangulate_pixels(pixels(), sensor, camera, form)
    np.testing.assert_allclose(points, expected, rtol=1e-12, atol=1e-16)


@pytest.mark.parametrize("camera", [0, 1])
def test_closed_form_and_ray_form_agree_with_distortion(camera):
    sensor = make_sensor(cameras=2, camera=OFF_CENTRE | {"distortion": DISTORTION})
    exact = triangulate_pixels(pixels(), sensor, camera, "exact")
    ray = triangulate_pixels(pixels(), sensor, camera, "ray")
    np.testing.assert_allclose(exact, ray, rtol=0, atol=1e-12)
    plain = triangulate_pixels(pixels(), make_sensor(cameras=2, camera=OFF_CENTRE), camera, "exact")
    assert np.abs(exact - plain).max() > 1e-4  # distortion is not a no-op here


SHEETS = {
    "shifted": {"offset_x": 3e-4},
    "turned": {"turn_y": 0.004, "turn_z": -0.02},
    "curved": {"straightness": [0.0, 0.0, 5e-4, -3e-4, 0.0, 1e-4]},
    "all, from a raised source": {
        "offset_x": -2e-4,
        "turn_y": -0.003,
        "turn_z": 0.01,
        "straightness": [1e-4, 2e-4, 5e-4, 3e-4, -2e-4, 1e-4],
        "source_z": 0.01,
    },
}


def points_on_sheet(laser):
    """Points (n, 3) that the centre of the described sheet passes through, by its definition in the laser's frame."""
    source = np.array([0.0, 0.0, laser.get("source_z", 0.0)])
    place, depth = (axis.ravel() for axis in np.meshgrid(np.linspace(-0.5, 0.5, 11), np.linspace(0.06, 0.15, 9)))
    bend = np.polynomial.polynomial.polyval(place, laser.get("straightness", [0.0]))
    in_laser = np.stack([depth * bend, depth * place * np.tan(0.28), depth], axis=1)
    turn_y, turn_z = laser.get("turn_y", 0.0), laser.get("turn_z", 0.0)
    about_y = np.array([[np.cos(turn_y), 0.0, np.sin(turn_y)], [0.0, 1.0, 0.0], [-np.sin(turn_y), 0.0, np.cos(turn_y)]])
    about_z = np.array([[np.cos(turn_z), -np.sin(turn_z), 0.0], [np.sin(turn_z), np.cos(turn_z), 0.0], [0.0, 0.0, 1.0]])
    return in_laser @ (about_z @ about_y).T + source + [laser.get("offset_x", 0.0), 0.0, 0.0]


@pytest.mark.parametrize("optics", [{}, {"distortion": DISTORTION, "offset_y": 1e-3, "pan": 0.01, "roll": -0.02}])
@pytest.mark.parametrize("laser", SHEETS.values(), ids=SHEETS)
def test_points_of_described_sheet_are_recovered_from_their_pixels(laser, optics):
    sensor = make_sensor(cameras=2, laser=laser, camera=optics)
    points = points_on_sheet(laser)
    for k, camera in enumerate(sensor.cameras):
        found = triangulate_pixels(np.asarray(camera.project(points)), sensor, k, "sheet")
        np.testing.assert_allclose(found, points, rtol=0, atol=1e-12)
        nominal = triangulate_pixels(np.asarray(camera.project(points)), sensor, k, "exact")
        assert np.abs(nominal - points).max() > 1e-5  # the shape of the sheet matters here


@pytest.mark.parametrize("camera", [0, 1])
@pytest.mark.parametrize("optics", [{}, {"distortion": DISTORTION}, {"pan": 0.01}])
def test_nominal_sheet_gives_exact_form(camera, optics):
    sensor = make_sensor(cameras=2, camera=optics)
    np.testing.assert_array_equal(
        triangulate_pixels(pixels(), sensor, camera, "sheet"), triangulate_pixels(pixels(), sensor, camera, "exact")
    )


def test_ray_that_misses_sheet_has_no_point():
    """A sheet turned parallel to a pixel's ray."""
    ray = np.asarray(make_sensor().cameras[0].view_rays(np.array([[639.5, 511.5]])))[0]
    sensor = make_sensor(laser={"turn_y": float(np.arctan2(ray[0], ray[2]))})
    assert not (np.abs(triangulate_pixels(np.array([[639.5, 511.5]]), sensor, 0, "sheet")) < 1e3).all()


@pytest.mark.parametrize("camera", [0, 1])
def test_printed_form_has_known_y_scale_error(camera):
    sensor = make_sensor(cameras=2)
    exact = triangulate_pixels(pixels(), sensor, camera, "exact")
    printed = triangulate_pixels(pixels(), sensor, camera, "eq4_as_printed")
    p_y = pixels()[:, 1] - 511.5
    factor = np.hypot(focal_of(1024), p_y) / focal_of(1024)
    np.testing.assert_allclose(printed[:, 1], exact[:, 1] * factor, rtol=1e-12)
    np.testing.assert_allclose(printed[:, 2], exact[:, 2], rtol=1e-12)
    assert factor.max() == pytest.approx(1 / np.cos(np.radians(9.34)), rel=1e-4)


def profile(sensor, frames, rows, peak=3000.0, **options):
    images = images_of(sensor, stripe(rows, 1.4, peak, 1024), frames)
    return triangulate(extract(images, sensor), sensor, **options)


@pytest.mark.parametrize("row", [60.2, 512.4, 960.7])
def test_covariance_matches_monte_carlo(row):
    """Scatter of points over many noisy images of one stripe, in all directions."""
    sensor = make_sensor(camera={"distortion": DISTORTION})
    profiles = profile(sensor, 24, np.full(1280, row))
    truth = triangulate_pixels(np.stack([profiles.column, np.full(len(profiles), row)], axis=1), sensor, 0, "exact")
    deviation = profiles.points_in_sensor - truth
    band = np.abs(profiles.column - 1100) < 60  # off the axis, so that y and z are correlated
    scatter = deviation[band].T @ deviation[band] / band.sum()
    mean = profiles.covariance[band].mean(axis=0)
    np.testing.assert_allclose(mean, scatter, rtol=0.1, atol=0.02 * scatter.max())
    largest = np.sqrt(np.linalg.eigvalsh(profiles.covariance).max(axis=1))
    np.testing.assert_allclose(profiles.sigma, largest, rtol=1e-5)


def two_views(sensor, frames, z, jitter=0.0):
    """Images of a plane at sensor height z in both cameras (independent jitter, px)."""
    light = []
    for k, camera in enumerate(sensor.cameras):
        row = np.asarray(camera.project(np.array([[0.0, 0.0, z]])))[0, 1] + (jitter if k else 0.0)
        light.append(stripe(np.full(1280, row), 1.4, 2000.0 if k else 6000.0, 1024))
    planes = np.broadcast_to(np.array(light, np.float32), (frames, 2, 1024, 1280))
    return expose(planes, sensor, np.full(frames, 5e-4), np.arange(frames))


@pytest.mark.parametrize("z", [0.09, 0.15])
def test_fusion_weights_by_inverse_variance(z):
    """Plane, three times dimmer in one camera: inverse variances of the cameras add up in the fused points."""
    plain, fused = make_sensor(cameras=2), make_sensor(cameras=2, extraction={"fusion": "weighted"})
    peaks = extract(two_views(plain, 6, z), plain)
    apart, together = triangulate(peaks, plain), triangulate(peaks, fused)
    assert len(together) < 0.52 * len(apart)
    variance = [apart.points_in_sensor[apart.camera == k, 2].var() for k in (0, 1)]
    assert variance[1] > 2.0 * variance[0]
    expected = 1.0 / (1.0 / variance[0] + 1.0 / (variance[1] * 2.0 / 3.0))  # two adjacent columns for interpolation
    best = 1.0 / sum(1.0 / v for v in variance)
    scatter = together.points_in_sensor[:, 2].var()
    assert 0.85 * expected < scatter < 1.1 * best
    assert np.mean(together.sigma**2) == pytest.approx(
        (together.points_in_sensor[:, 1:] - [0, z]).var(axis=0)[1], rel=0.15
    )
    assert abs(together.points_in_sensor[:, 2].mean() - z) < 2e-6
    np.testing.assert_allclose(together.sigma, np.sqrt(np.linalg.eigvalsh(together.covariance).max(axis=1)), rtol=1e-4)


def test_disagreeing_points_are_not_fused():
    fused = make_sensor(cameras=2, extraction={"fusion": "weighted"})
    peaks = extract(two_views(fused, 1, 0.12, jitter=3.0), fused)
    profiles = triangulate(peaks, fused)
    assert (profiles.camera == 0).sum() == (profiles.camera == 1).sum() > 1200


def test_points_of_single_camera_survive_fusion():
    fused = make_sensor(cameras=2, extraction={"fusion": "weighted"})
    images = two_views(fused, 1, 0.12)
    images[0, 0, :, :400] = 4
    images[0, 1, :, :200] = 4
    profiles = triangulate(extract(images, fused), fused)
    column, camera = profiles.column, profiles.camera
    assert set(column[camera == 0]) >= set(range(405, 1270))
    assert (camera == 1).sum() > 390  # the columns that correspond to the dark ones of camera 0
    assert len(profiles) == (camera == 0).sum() + (camera == 1).sum()


@pytest.mark.parametrize("camera", [0, 1])
@pytest.mark.parametrize("form", ["exact", "sheet"])
def test_covariance_with_distortion_matches_finite_differences(camera, form):
    optics, laser = OFF_CENTRE | {"distortion": DISTORTION}, SHEETS["all, from a raised source"]
    sensor = make_sensor(cameras=2, camera=optics, laser=laser, extraction={"triangulation": form})
    profiles = triangulate(extract(two_views(sensor, 1, 0.15), sensor), sensor)
    mine = profiles.camera == camera
    pixel = np.stack([profiles.column[mine], profiles.row[mine]], axis=1)
    step = np.array([0.0, 1e-3])
    slope = (
        triangulate_pixels(pixel + step, sensor, camera, form) - triangulate_pixels(pixel - step, sensor, camera, form)
    ) / 2e-3
    direction = np.einsum("ni,nij,nj->n", slope, profiles.covariance[mine], slope)
    np.testing.assert_allclose(direction, profiles.sigma[mine] ** 2 * (slope**2).sum(axis=1), rtol=1e-4)


def test_points_outside_range_are_discarded():
    rows = np.linspace(30.0, 990.0, 1280)
    everything = profile(make_sensor(), 1, rows)
    limited = profile(make_sensor(range={"near": 0.1, "far": 0.13}), 1, rows)
    z = everything.points_in_sensor[:, 2]
    inside = (z >= 0.1) & (z <= 0.13)
    assert 0 < inside.sum() < len(everything)
    np.testing.assert_array_equal(limited.points_in_sensor, everything.points_in_sensor[inside])


def test_rejected_peaks_are_skipped_unless_kept():
    sensor, rows = make_sensor(), np.full(1280, 300.2)
    rows[600:] += 40.0
    kept = profile(sensor, 1, rows)
    everything = profile(sensor, 1, rows, keep_rejected=True)
    assert len(everything) == 1280
    rejected = (everything.flags & PEAK_REJECTED) != 0
    assert rejected[[0, 599, 600, 1279]].all()
    np.testing.assert_array_equal(kept.column, everything.column[~rejected])
    assert np.abs(everything.points_in_sensor[:, 0]).max() == 0.0


def test_arrays_keep_profiles_alive():
    points = profile(make_sensor(), 1, np.full(1280, 300.2)).points_in_sensor
    assert np.isfinite(points).all()
    with pytest.raises(ValueError, match="read-only"):
        points[0] = 0.0


def test_unknown_form_and_camera_are_rejected():
    sensor = make_sensor()
    with pytest.raises(ValueError, match="eq4_as_printed"):
        triangulate_pixels(pixels(), sensor, 0, "magic")
    with pytest.raises(ValueError, match="camera 1"):
        triangulate_pixels(pixels(), sensor, 1, "exact")
