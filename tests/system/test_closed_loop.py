"""From a known surface to an image and back: peaks lie where the surface truly is, over the whole range.

Planes at many ranges and tilts cut the laser sheet in lines that are known exactly. What each camera must see is
worked out here from the sensor's dimensions alone, by ray and plane, without the camera model of the library.

The claim for every single point is shown at a readout of 12 bits. The steps of 8 bits alone move one point in some
thousands by more than the limit; how many is asserted too.
"""

from __future__ import annotations

import json
from itertools import product

import numpy as np
import pytest

from scancell import sensor as sensor_rt
from scancell.config.loading import load_setup
from scancell.config.sensor import sensor_json
from scancell.geometry import pose

# Dimensions of the default probe.
BASELINE, TILT, GAMMA = 0.060, np.radians(29.3), np.radians(9.34)
WIDTH, HEIGHT = 1280, 1024
FOCAL = HEIGHT / (2 * np.tan(GAMMA))
NEAR, FAR = BASELINE / np.tan(TILT + GAMMA), BASELINE / np.tan(TILT - GAMMA)
LIMIT_PX = 0.02
# The same gain at 12 bits: a sixteenth of the digital step.
FINE = ("sensor.detector.bit_depth=12", "sensor.detector.gain_dn_per_e=0.36", "sensor.detector.black_level_dn=64")
RANGES = np.linspace(NEAR + 0.0015, FAR - 0.003, 13)
# (about the laser line's direction Y, about X), degrees
TILTS = [(0, 0), (0, 20), (0, -35), (20, 0), (-20, 15), (35, -10)]


def make_sensor(*overrides: str) -> sensor_rt.Sensor:
    setup = load_setup(settings=overrides, ideal=True)
    return sensor_rt.Sensor(json.dumps(sensor_json(setup.sensor, 0)))


def camera_axes(side: int) -> np.ndarray:
    """Rows: x (columns), y (rows) and z (forward) of a camera in the sensor frame."""
    s, c = np.sin(TILT), np.cos(TILT)
    return np.array([[0, -side, 0], [side * c, 0, s], [-side * s, 0, c]], float)


def project(points: np.ndarray, side: int) -> np.ndarray:
    """Pixels (n, 2) = (column, row) of points (n, 3) of the sensor frame: a pinhole at (side a, 0, 0)."""
    x, y, z = camera_axes(side) @ (points - [side * BASELINE, 0, 0]).T
    return np.stack([FOCAL * x / z + (WIDTH - 1) / 2, FOCAL * y / z + (HEIGHT - 1) / 2], -1)


def seen_on_line(columns: np.ndarray, side: int, anchor: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Points (n, 3) of a line (through `anchor`, along `direction`) that a camera sees in image columns (n,).

    An image column is a plane through the camera's centre, which the line meets once.
    """
    axes = camera_axes(side)
    slope = (columns - (WIDTH - 1) / 2) / FOCAL
    normal = axes[0] - slope[:, None] * axes[2]
    centre = np.array([side * BASELINE, 0, 0])
    along = normal @ (centre - anchor) / (normal @ direction)
    return np.asarray(anchor + along[:, None] * direction)


def plane_pose(z: float, about_y: float, about_x: float) -> np.ndarray:
    """A plane through (0, 0, z), facing the sensor."""
    turn = pose.rotation_about(1, np.radians(about_y)) @ pose.rotation_about(0, np.radians(about_x))
    return pose.from_rotation(turn, (0, 0, z))


def look(*overrides: str) -> tuple[list[np.ndarray], sensor_rt.Sensor, np.ndarray]:
    """Pose of each plane, the sensor, and the images (planes, cameras, height, width)."""
    scene = sensor_rt.Scene()
    scene.add_plane("target", np.eye(4), (0.4, 0.4), 0.5)
    planes = [plane_pose(z, *tilt) for z, tilt in product(RANGES, TILTS)]
    count = len(planes)
    exposures = sensor_rt.Exposures(
        np.tile(np.eye(4), (count, 1, 1, 1)),
        np.array(planes)[:, None, None],
        np.full(count, 5e-4),
        np.arange(count, dtype=np.int64),
    )
    sensor = make_sensor(*overrides)
    return planes, sensor, sensor_rt.render(scene, sensor, exposures)


@pytest.fixture(scope="module")
def looked_at():
    return look()


def expected(planes, frame: np.ndarray, camera: np.ndarray, column: np.ndarray) -> np.ndarray:
    """True points (n, 3) behind the peaks."""
    points = np.full((len(frame), 3), np.nan)
    for number, side in product(np.unique(frame), (1, -1)):
        mine = (frame == number) & (camera == (0 if side == 1 else 1))
        normal, anchor = planes[number][:3, 2], planes[number][:3, 3]
        direction = np.cross(normal, [1.0, 0.0, 0.0])
        points[mine] = seen_on_line(column[mine], side, anchor, direction)
    return points


def errors_px(planes, sensor, images) -> tuple[np.ndarray, sensor_rt.Profiles]:
    """Distance (n,) in the image between where each point was found and where it truly is, and the points."""
    found = sensor_rt.triangulate(sensor_rt.extract(images, sensor), sensor)
    frame, camera = np.asarray(found.frame), np.asarray(found.camera)
    truth = expected(planes, frame, camera, np.asarray(found.column))
    points = np.asarray(found.points_in_sensor)
    error = np.empty(len(points))
    for k, side in enumerate((1, -1)):
        mine = camera == k
        error[mine] = np.linalg.norm(project(points[mine], side) - project(truth[mine], side), axis=1)
    print(f"{len(points)} points, rms {np.sqrt(np.mean(error**2)):.4f} px, max {error.max():.4f} px")
    return error, found


def test_round_trip_within_fiftieth_of_pixel() -> None:
    planes, sensor, images = look(*FINE)
    error, found = errors_px(planes, sensor, images)
    frame, camera = np.asarray(found.frame), np.asarray(found.camera)
    assert np.abs(np.asarray(found.points_in_sensor)[:, 0]).max() < 1e-12
    # Both cameras, the whole range, the whole line.
    for k in range(2):
        rows, columns = np.asarray(found.row)[camera == k], np.asarray(found.column)[camera == k]
        assert rows.min() < 0.03 * HEIGHT
        assert rows.max() > 0.97 * HEIGHT
        assert columns.min() < 0.03 * WIDTH
        assert columns.max() > 0.97 * WIDTH
    assert len(np.unique(frame)) == len(planes)
    assert error.max() <= LIMIT_PX


def test_eight_bit_images_keep_accuracy(looked_at) -> None:
    error, _ = errors_px(*looked_at)
    assert np.sqrt(np.mean(error**2)) <= LIMIT_PX / 2
    assert (error > LIMIT_PX).mean() < 1e-3


def test_printed_equation_4_error_factor(looked_at) -> None:
    _, sensor, images = looked_at
    printed = make_sensor('sensor.extraction.triangulation="eq4_as_printed"')
    peaks = sensor_rt.extract(images, sensor)
    right, wrong = sensor_rt.triangulate(peaks, sensor), sensor_rt.triangulate(peaks, printed)
    assert np.array_equal(right.row, wrong.row)
    p_y = np.asarray(right.row) - (HEIGHT - 1) / 2
    factor = np.sqrt(FOCAL**2 + p_y**2) / FOCAL
    exact, as_printed = np.asarray(right.points_in_sensor), np.asarray(wrong.points_in_sensor)
    assert as_printed[:, 1] == pytest.approx(factor * exact[:, 1], rel=1e-12, abs=1e-15)
    assert as_printed[:, 2] == pytest.approx(exact[:, 2], rel=1e-12)
    # 1 / cos(gamma) at the ends of the range.
    assert factor.max() == pytest.approx(1 / np.cos(GAMMA), rel=1e-3)


def test_printed_equation_4_error_on_rendered_points(looked_at) -> None:
    planes, _, images = looked_at
    printed = make_sensor('sensor.extraction.triangulation="eq4_as_printed"')
    found = sensor_rt.triangulate(sensor_rt.extract(images, printed), printed)
    frame, camera, column = (np.asarray(values) for values in (found.frame, found.camera, found.column))
    truth = expected(planes, frame, camera, column)
    far_out = np.abs(truth[:, 1]) > 5e-3
    ratio = np.asarray(found.points_in_sensor)[far_out, 1] / truth[far_out, 1]
    p_y = np.asarray(found.row)[far_out] - (HEIGHT - 1) / 2
    assert ratio == pytest.approx(np.sqrt(FOCAL**2 + p_y**2) / FOCAL, abs=2e-4)
