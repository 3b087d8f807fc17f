"""Triangulation against independent ray-plane geometry, and the published form against its known error."""

from __future__ import annotations

import numpy as np
import pytest
from stripe_images import make_sensor, stripe

from sensor_rt import PEAK_REJECTED, expose, extract, triangulate, triangulate_pixels

DISTORTION = [-0.12, 0.05, 1e-3, -5e-4, 0.01]
OFF_CENTRE = {"cx_px": 601.3, "cy_px": 533.7, "height": -0.004}


def pixels():
    """A grid over the whole image, sub-pixel."""
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
def test_points_are_where_the_rays_meet_the_sheet(camera, optics, form):
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


@pytest.mark.parametrize("camera", [0, 1])
def test_projection_is_undone(camera):
    sensor = make_sensor(cameras=2, camera={"distortion": DISTORTION})
    points = np.array([[0.0, y, z] for y in np.linspace(-0.015, 0.015, 7) for z in np.linspace(0.08, 0.16, 9)])
    seen = np.asarray(sensor.cameras[camera].project(points))
    np.testing.assert_allclose(triangulate_pixels(seen, sensor, camera, "exact"), points, atol=1e-12)


@pytest.mark.parametrize("camera", [0, 1])
def test_printed_form_stretches_y_by_its_known_factor(camera):
    sensor = make_sensor(cameras=2)
    exact = triangulate_pixels(pixels(), sensor, camera, "exact")
    printed = triangulate_pixels(pixels(), sensor, camera, "eq4_as_printed")
    p_y = pixels()[:, 1] - 511.5
    factor = np.hypot(focal_of(1024), p_y) / focal_of(1024)
    np.testing.assert_allclose(printed[:, 1], exact[:, 1] * factor, rtol=1e-12)
    np.testing.assert_allclose(printed[:, 2], exact[:, 2], rtol=1e-12)
    assert factor.max() == pytest.approx(1 / np.cos(np.radians(9.34)), rel=1e-4)


def test_mirrored_cameras_see_a_point_in_mirrored_columns():
    sensor = make_sensor(cameras=2)
    point = np.array([[0.0, 0.004, 0.12]])
    plus, minus = (np.asarray(camera.project(point))[0] for camera in sensor.cameras)
    assert plus[0] < 639.5 < minus[0]  # columns of the camera at X = +a run along -Y
    assert plus[1] == pytest.approx(minus[1], abs=1e-9)
    further = np.asarray(sensor.cameras[0].project(np.array([[0.0, 0.004, 0.14]])))[0]
    assert further[1] > plus[1]  # rows grow with range


def profile(sensor, frames, rows, peak=3000.0, **options):
    light = np.broadcast_to(stripe(rows, 1.4, peak, 1024), (frames, 1, 1024, 1280)).astype(np.float32)
    images = expose(light, sensor, np.full(frames, 5e-4), np.arange(frames))
    return triangulate(extract(images, sensor), sensor, **options)


@pytest.mark.parametrize("row", [60.2, 512.4, 960.7])
def test_covariance_matches_monte_carlo(row):
    """Scatter of points over many noisy images of one stripe, in every direction."""
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


def test_points_outside_the_range_are_left_out():
    rows = np.linspace(30.0, 990.0, 1280)
    everything = profile(make_sensor(), 1, rows)
    limited = profile(make_sensor(range={"near": 0.1, "far": 0.13}), 1, rows)
    z = everything.points_in_sensor[:, 2]
    inside = (z >= 0.1) & (z <= 0.13)
    assert 0 < inside.sum() < len(everything)
    np.testing.assert_array_equal(limited.points_in_sensor, everything.points_in_sensor[inside])


def test_rejected_peaks_are_left_out_unless_wanted():
    sensor, rows = make_sensor(), np.full(1280, 300.2)
    rows[600:] += 40.0
    kept = profile(sensor, 1, rows)
    everything = profile(sensor, 1, rows, keep_rejected=True)
    assert len(everything) == 1280
    rejected = (everything.flags & PEAK_REJECTED) != 0
    assert rejected[[0, 599, 600, 1279]].all()
    np.testing.assert_array_equal(kept.column, everything.column[~rejected])
    assert np.abs(everything.points_in_sensor[:, 0]).max() == 0.0


def test_profiles_outlive_their_arrays_owner():
    points = profile(make_sensor(), 1, np.full(1280, 300.2)).points_in_sensor
    assert np.isfinite(points).all()
    with pytest.raises(ValueError, match="read-only"):
        points[0] = 0.0


def test_unknown_form_and_camera_are_refused():
    sensor = make_sensor()
    with pytest.raises(ValueError, match="eq4_as_printed"):
        triangulate_pixels(pixels(), sensor, 0, "magic")
    with pytest.raises(ValueError, match="camera 1"):
        triangulate_pixels(pixels(), sensor, 1, "exact")
