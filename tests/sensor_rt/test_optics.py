"""Cameras, measuring field and parsing of the sensor description."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from scenes import Array, probe
from stripe_images import sensor_description

from json_changes import changed
from scancell.sensor import Sensor, triangulate_pixels


def lens(distortion: Array, **camera: Any) -> Sensor:
    """A camera with 60 degrees of view across its diagonal."""
    return probe(camera={"distortion": [float(k) for k in distortion], "focal_px": 1420.0} | camera)


@pytest.mark.parametrize(
    ("distortion", "radius"),
    [((-0.5, 0, 0, 0, 0), 773), ((-0.2, 0, 0, 0, 0), 1222), ((0.3, -2.0, 0, 0, 0), 723)],
    ids=["barrel", "weak barrel", "moustache"],
)
def test_lens_without_inverse_is_refused_with_its_radius(distortion: tuple[float, ...], radius: int) -> None:
    """The image of a ray at angle atan(r) turns back where d/dr (r + k1 r³ + k2 r⁵) = 0."""
    k1, k2 = distortion[:2]
    roots = np.roots([5 * k2, 0, 3 * k1, 0, 1] if k2 else [3 * k1, 0, 1])
    fold = min(r.real for r in roots if abs(r.imag) < 1e-12 and r.real > 0)
    assert round(1420 * (fold + k1 * fold**3 + k2 * fold**5)) == radius
    if radius > np.hypot(640, 512):
        lens(np.array(distortion))
    else:
        with pytest.raises(
            ValueError, match=rf"cameras\[0\]\.distortion: has no inverse from a radius of {radius} px .* 820 px"
        ):
            lens(np.array(distortion))
    with pytest.raises(ValueError, match=rf"from a radius of {radius} px"):  # blurred light comes from farther away
        lens(np.array(distortion), psf_sigma_px=100.0)


def test_accepted_lenses_have_an_inverse_in_every_pixel() -> None:
    rng = np.random.default_rng(3)
    rows, columns = np.mgrid[-0.5:1024:32, -0.5:1280:32]
    pixels = np.stack([columns.ravel(), rows.ravel()], axis=1)
    accepted = 0
    for _ in range(400):
        size = 10.0 ** rng.uniform(-2, 0.5)
        distortion = size * rng.normal(size=5) * (1, 3, 0.02, 0.02, 10)
        tilt = {"scheimpflug_x": float(rng.uniform(-0.3, 0.3))}
        try:
            cameras = lens(distortion, **tilt).cameras
        except ValueError as error:
            assert "has no inverse" in str(error)
            continue
        accepted += 1
        for camera in cameras:
            points = camera.sensor_from_camera[:3, 3] + 0.1 * camera.view_rays(pixels)
            np.testing.assert_allclose(camera.project(points), pixels, atol=1e-6, err_msg=str(distortion))
    print(f"{accepted} of 400 lenses are accepted")
    assert 100 < accepted < 350


def test_camera_frames_are_right_handed_and_mirrored() -> None:
    plus, minus = probe().cameras
    for camera in (plus, minus):
        rotation = camera.sensor_from_camera[:3, :3]
        np.testing.assert_allclose(rotation.T @ rotation, np.eye(3), atol=1e-15)
        assert np.linalg.det(rotation) == pytest.approx(1.0)
        # Rows increase with range, and the optical axis is tilted towards the sheet.
        assert rotation[2, 1] > 0
        assert rotation[0, 2] * camera.side < 0
    mirror = np.diag([-1.0, 1.0, 1.0])
    np.testing.assert_allclose(mirror @ plus.sensor_from_camera[:3, 3], minus.sensor_from_camera[:3, 3], atol=1e-15)
    points = np.random.default_rng(2).uniform([-0.01, -0.02, 0.08], [0.01, 0.02, 0.16], (50, 3))
    there, here = plus.project(points), minus.project(points @ mirror)
    np.testing.assert_allclose(there[:, 1], here[:, 1], atol=1e-9)
    np.testing.assert_allclose(there[:, 0] - 639.5, 639.5 - here[:, 0], atol=1e-9)


def test_paper_coordinates_align_with_y_and_range() -> None:
    for camera in probe().cameras:
        middle = camera.project([[0.0, 0.0, 0.12]])
        aside = camera.project([[0.0, 0.01, 0.12]])
        deeper = camera.project([[0.0, 0.0, 0.13]])
        p = camera.paper_coordinates(np.concatenate([middle, aside, deeper]))
        assert p[1, 0] > p[0, 0]
        assert p[2, 1] > p[0, 1]
        np.testing.assert_allclose(p[[0, 2], 0], 0.0, atol=1e-9)


@pytest.mark.parametrize("size", [(1280, 1024), (640, 900)])
def test_trapezoid_matches_image_corners(size: tuple[int, int]) -> None:
    """Corrected Eq. 5 compared with the intersection of corner rays with the sheet."""
    width, height = size
    sensor = Sensor(json.dumps(sensor_description(width, height, cameras=2)))
    for number, camera in enumerate(sensor.cameras):
        corners = np.array([[x, y] for y in (-0.5, height - 0.5) for x in (-0.5, width - 0.5)])
        rays = camera.view_rays(corners)
        centre = camera.sensor_from_camera[:3, 3]
        seen = centre - (centre[0] / rays[:, 0])[:, None] * rays
        np.testing.assert_allclose(seen[:, 0], 0.0, atol=1e-15)
        field = sensor.trapezoid(number)
        np.testing.assert_allclose(np.sort(np.abs(field[:, 0])), np.sort(np.abs(seen[:, 1])), rtol=1e-12)
        np.testing.assert_allclose(np.sort(field[:, 1]), np.sort(seen[:, 2]), rtol=1e-12)
        assert (np.sign(field[:, 0]) == [-1, 1, 1, -1]).all()


@pytest.mark.parametrize("size", [(1280, 1024), (900, 900)])
def test_printed_equation_5_has_known_error_of_width(size: tuple[int, int]) -> None:
    """Wider by 1 / cos gamma, and by H / W for its square image; ranges and points are those of the exact form."""
    width, height = size
    description = sensor_description(width, height, cameras=2)
    exact = Sensor(json.dumps(description))
    description["extraction"]["triangulation"] = "eq5_as_printed"
    printed = Sensor(json.dumps(description))
    pixels = np.array([[10.0, 20.0], [width / 3, height / 5], [width - 1.0, height - 1.0]])
    for number, camera in enumerate(exact.cameras):
        gamma = np.arctan(height / (2 * camera.focal_px))
        right, wrong = exact.trapezoid(number), printed.trapezoid(number)
        np.testing.assert_array_equal(wrong[:, 1], right[:, 1])
        np.testing.assert_allclose(wrong[:, 0], right[:, 0] * height / width / np.cos(gamma), rtol=1e-12)
        points = triangulate_pixels(pixels, exact, number, "exact")
        np.testing.assert_array_equal(triangulate_pixels(pixels, printed, number, "eq5_as_printed"), points)


def test_unbounded_field_of_view_is_rejected() -> None:
    with pytest.raises(ValueError, match="unbounded"):
        probe(camera={"tilt": 0.1}).trapezoid()
    with pytest.raises(ValueError, match="index 2 is out of range"):
        probe().trapezoid(2)


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("laser.power", "much", r"sensor\.laser\.power: expected a number"),
        ("laser.power", ..., r"sensor\.laser\.power: missing"),
        ("laser.colour", "red", r"sensor\.laser\.colour: unknown key"),
        ("laser.fan_half_angle", 2.0, r"sensor\.laser\.fan_half_angle"),
        ("laser.sheet_sigma", 0.0, r"sensor\.laser\.sheet_sigma: must be positive"),
        ("format", 2, r"sensor\.format"),
        ("cameras", [], r"sensor\.cameras: expected a list"),
        ("cameras.1.side", 0, r"sensor\.cameras\[1\]\.side"),
        ("cameras.0.width_px", 12.5, r"sensor\.cameras\[0\]\.width_px: expected an integer"),
        ("cameras.0.width_px", 10**9, r"sensor\.cameras\[0\]\.width_px: must lie in"),
        ("cameras.0.distortion", [0, 0], r"sensor\.cameras\[0\]\.distortion: expected 5 numbers"),
        ("cameras.0.transmission", 1.5, r"sensor\.cameras\[0\]\.transmission: must lie in 0\.\.1"),
        ("detector.bit_depth", 7, r"sensor\.detector\.bit_depth"),
        ("detector.full_well_e", 0.0, r"sensor\.detector\.full_well_e"),
        ("range.near", 20.0, r"sensor\.range\.near: must be below far"),
        ("render.noise", 1, r"sensor\.render\.noise: expected true or false"),
        ("render.seed", -1, r"sensor\.render\.seed"),
        ("extraction.detector", "guess", r"sensor\.extraction\.detector: expected one of gaussian"),
        ("geometric", 3, r"sensor\.geometric: expected an object"),
        ("extra", {}, r"sensor\.extra: unknown key"),
    ],
)
def test_invalid_description_is_rejected_by_key(path: str, value: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Sensor(json.dumps(changed(sensor_description(cameras=2), path, value)))


def test_invalid_json_is_rejected() -> None:
    with pytest.raises(ValueError, match="not valid JSON"):
        Sensor("{")
    with pytest.raises(ValueError, match="expected an object"):
        Sensor("[]")
