"""Calibration of a misaligned sensor from ray-traced images, and use of the result."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic_stripes import board_corners, exact_exposure, native

from scancell import sensor as sensor_rt
from scancell.calibration.sensor import targets as sensor_targets
from scancell.calibration.sensor.problem import TargetExposure, free_parameters
from scancell.calibration.sensor.simulated import calibrate_from, measure, range_error
from scancell.calibration.sensor.targets import CheckeredBoard, board_poses, start_from_corners, step_block
from scancell.config.loading import as_built_sensor
from scancell.config.sensor import SensorDescription
from scancell.errors import CalibrationError
from scancell.geometry import pose

NOMINAL = SensorDescription.default()
AS_BUILT = (
    "sensor.camera[1].tilt_deg=29.4",
    "sensor.camera[1].roll_deg=0.15",
    "sensor.camera[2].baseline_mm=60.2",
    "sensor.camera[2].pan_deg=-0.1",
    "sensor.camera[1].distortion=[-0.05,0,0,0,0]",
    "sensor.camera[2].distortion=[0.03,0,0,0,0]",
    "sensor.laser.turn_y_deg=0.2",
    "sensor.laser.straightness_mrad=[0,0,0.5]",
)
BUILT = as_built_sensor(NOMINAL, AS_BUILT)
# A quarter of the pixels: rendering the board takes most of the time.
SMALL = NOMINAL.replace(
    {f"camera[{k}].{key}": size for k in (1, 2) for key, size in (("width_px", 640), ("height_px", 512))}
)
SMALL_BUILT = as_built_sensor(SMALL, AS_BUILT)
AWAY = pose.from_euler_xyz((4e-4, -3e-4, 5e-4), np.radians([0.3, -0.2, 0.4]))


@pytest.fixture(scope="module")
def by_ball():
    """Calibrated by a ball at known places."""
    return calibrate_from(NOMINAL, measure(NOMINAL, AS_BUILT, ("ball",), None, seed=1))


def test_ball_at_known_places_removes_range_error(by_ball) -> None:
    assert range_error(BUILT, NOMINAL, align=False) > 1e-3
    assert range_error(BUILT, by_ball.sensor, align=False) < 1e-6
    assert 1.0 <= by_ball.chi_square < 1.5
    assert by_ball.discarded < 1e-3 * by_ball.used


def test_step_block_on_stage_mounted_anywhere_removes_range_error() -> None:
    """The sensor frame is free then: what remains after a rigid motion counts."""
    result = calibrate_from(NOMINAL, measure(NOMINAL, AS_BUILT, ("step",), AWAY, seed=1))
    assert range_error(BUILT, NOMINAL, align=True) > 1e-3
    assert range_error(BUILT, result.sensor, align=True) < 1e-6
    assert result.sensor.laser.turn_y_deg == 0.0


@pytest.fixture(scope="module")
def board_views():
    """Views of the checkered board."""
    return measure(SMALL, AS_BUILT, ("checkered",), None, 1)


def test_checkered_board_alone_removes_range_error(board_views) -> None:
    assert len(board_views) == len(board_poses(SMALL))
    result = calibrate_from(SMALL, board_views)
    assert range_error(SMALL_BUILT, SMALL, align=True) > 1e-3
    assert range_error(SMALL_BUILT, result.sensor, align=True) < 5e-6
    for camera in result.sensor.camera:
        assert camera.cx_px == pytest.approx(319.5, abs=1.5)
        assert camera.cy_px == pytest.approx(255.5, abs=1.5)


@pytest.mark.parametrize(("engine", "tolerance"), [("geometric", 2e-6), ("ray-traced", 2e-6)])
def test_calibrated_file_gives_points_on_surface(by_ball, tmp_path, engine, tolerance) -> None:
    """A plane across the range, seen by the sensor as built, read by nominal and calibrated description."""
    by_ball.sensor.to_toml(tmp_path / "calibrated.toml")
    calibrated = SensorDescription.from_toml(tmp_path / "calibrated.toml")
    assert calibrated == by_ball.sensor
    scene = sensor_rt.Scene()
    scene.add_plane("plane", np.eye(4), [0.2, 0.2], 0.5)
    for z in (0.085, 0.12, 0.155):
        placed = pose.translation((0.0, 0.0, z))[None, None, None]
        exposure = sensor_rt.Exposures(np.eye(4)[None, None], placed, [5e-4], np.array([1]))
        error = []
        for used in (NOMINAL, calibrated):
            result = sensor_rt.scan(scene, native(used), exposure, engine, as_built=native(BUILT))
            error.append(result.profiles.points_in_sensor[:, 2] - z)
        assert np.sqrt(np.mean(error[0] ** 2)) > 3e-4
        assert np.abs(np.mean(error[1])) < tolerance
        assert np.sqrt(np.mean(error[1] ** 2)) < 4e-6  # noise included


def test_corners_of_board_are_found_in_rendered_images(monkeypatch) -> None:
    """One tilted view."""
    true_pose = board_poses(SMALL)[1]
    monkeypatch.setattr(sensor_targets, "board_poses", lambda sensor: true_pose[None])
    (view,) = measure(SMALL, AS_BUILT, ("checkered",), None, 1)
    in_sensor = pose.transform_points(true_pose, view.corners.points_in_target)
    for k, camera in enumerate(native(SMALL_BUILT).cameras):
        own = view.corners.camera == k
        error = view.corners.pixels[own] - np.asarray(camera.project(in_sensor[own]))
        assert own.sum() > 40
        assert np.sqrt(np.mean(error**2)) < 1.5 * view.corners.sigma


def exact_views(as_built):
    """Corners of a board that fills the images, without noise."""
    surface, sensor = CheckeredBoard().surface, native(as_built)
    return [TargetExposure(surface, np.eye(4), None, board_corners(sensor, one), 1) for one in board_poses(NOMINAL)]


@pytest.mark.parametrize(
    "read",
    [
        {},
        {"detector.binning": 2, "camera[1].region_rows_px": [101, 823], "camera[1].region_columns_px": [51, 1170]},
    ],
)
def test_opencv_gives_intrinsics_and_poses_as_start(read) -> None:
    nominal = NOMINAL.replace(read)
    words = ("sensor.camera[1].half_angle_deg=9.4", "sensor.camera[1].cx_px=650", "sensor.camera[1].cy_px=500")
    as_built = as_built_sensor(nominal, (*words, "sensor.camera[1].distortion=[-0.05,0,0,0,0]"))
    start, placed = start_from_corners(nominal, exact_views(as_built))
    camera = start.camera[0]
    assert camera.half_angle_deg == pytest.approx(9.4, abs=1e-3)
    assert (camera.cx_px, camera.cy_px) == pytest.approx((650.0, 500.0), abs=0.2)
    assert camera.distortion[0] == pytest.approx(-0.05, abs=1e-3)
    for one, expected in zip(placed, board_poses(NOMINAL), strict=True):
        np.testing.assert_allclose(one.sensor_from_target, expected, atol=2e-4)


def test_view_without_corners_has_no_start() -> None:
    view = exact_exposure(native(NOMINAL), step_block(1), board_poses(NOMINAL)[0], 0.1, 64)
    with pytest.raises(CalibrationError, match="no corners"):
        start_from_corners(NOMINAL, [view])


def test_free_parameters_follow_what_is_known() -> None:
    known, unknown = (free_parameters(NOMINAL, poses_known=one, checkered=False) for one in (True, False))
    assert len(known) == len(unknown) + 6
    assert set(unknown) < set(known)
    checkered = set(free_parameters(NOMINAL, poses_known=True, checkered=True)) - set(known)
    assert checkered == {f"sensor.camera[{k}].{axis}" for k in (1, 2) for axis in ("cx_px", "cy_px")}
