"""Recordings of a chessboard with the stripe on it by a camera on a robot, as the simulation makes them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.calibration.board.views import Board
from scancell.calibration.measured_table import write_measured_table
from scancell.calibration.pose_files import flange_columns
from scancell.config.loading import load_setup
from scancell.config.sensor import SensorDescription
from scancell.geometry import pose
from scancell.scanning.world import make_sensor

Array = NDArray[np.float64]

BOARD = Board(7, 6, 0.010)
FLANGE_FROM_SENSOR = pose.from_euler_xyz((0.09, 0.2, 0.1), (-0.4, 1.2, -1.6))
BASE_FROM_BOARD = pose.from_euler_xyz((1.6, 0.1, 0.94), (0.02, -0.01, 0.7))
_SUBPIXELS = 2
_DARK, _LIGHT = 20.0, 70.0  # DN
_STRIPE_HALF_WIDTH = 0.2  # m, of the plane on which the board lies


def recorded_sensor() -> SensorDescription:
    """A sensor with one camera 150 mm beside its sheet, about 250 mm from the board; the stripe is saturated."""
    shipped = load_setup().sensor
    sensor = shipped.model_copy(update={"camera": shipped.camera[:1]})
    return sensor.replace(
        {
            "camera[1].width_px": 512,
            "camera[1].height_px": 640,
            "camera[1].half_angle_deg": 15.0,
            "camera[1].tilt_deg": 35.0,
            "camera[1].roll_deg": 2.0,
            "camera[1].baseline_mm": 150.0,
            "camera[1].cx_px": 262.0,
            "camera[1].cy_px": 311.0,
            "camera[1].distortion": [-0.1, 0.2, 0.001, -0.002, 0.0],
            "camera[1].scheimpflug_x_deg": 0.0,
            "camera[1].scheimpflug_y_deg": 0.0,
            "camera[1].focus_mm": None,
            "range.near_mm": 120.0,
            "range.far_mm": 400.0,
            "laser.sheet_sigma_mm": 0.5,
            "laser.power_mw": 400.0,
            "laser.fan_half_angle_deg": 30.0,
            "detector.bit_depth": 8,
            "detector.gain_dn_per_e": 255.0 / shipped.detector.full_well_e,
            "detector.laser_off_frame": False,
        }
    )


@dataclass(frozen=True)
class Errors:
    """Standard deviations of the robot's errors from image to image, at the board: position (m), orientation (rad)."""

    position: float = 0.2e-3
    orientation: float = 1e-3


@dataclass
class BoardRecording:
    """Images (n, H, W) as the camera records them, a quarter turn from those of its description; flange poses."""

    images: NDArray[np.uint8]
    flange: Array

    def write(self, folder: Path, columns: dict[str, Array] | None = None) -> Path:
        """A folder of images with a table of poses, by default as matrices."""
        folder.mkdir(parents=True, exist_ok=True)
        names = [f"image{number:02d}.png" for number in range(len(self.images))]
        for name, image in zip(names, self.images, strict=True):
            cv2.imwrite(str(folder / name), image)
        write_measured_table(folder / "poses.csv", {"image": names, **(columns or flange_columns(self.flange))})
        return folder


def board_poses(rng: np.random.Generator, count: int) -> Array:
    """Poses (n, 4, 4) of the board in the sensor, beside the stripe, the printed side towards the camera."""
    turn = pose.rotation_about(2, rng.uniform(-np.pi, np.pi, count))
    tilt = pose.rotation_from_euler_xyz(np.column_stack([rng.uniform(-0.45, 0.45, (count, 2)), np.zeros(count)]))
    facing = pose.rotation_about(0, np.pi)
    x = rng.uniform(-0.065, -0.055, count)
    position = np.column_stack([x, rng.uniform(-0.008, 0.008, count), rng.uniform(0.21, 0.27, count)])
    return pose.from_rotation(tilt @ facing @ turn, position)


def record(
    seed: int, count: int = 8, errors: Errors | None = None, sensor: SensorDescription | None = None
) -> BoardRecording:
    """Images of the board at random poses."""
    rng, errors = np.random.default_rng(seed), errors or Errors()
    described = sensor or recorded_sensor()
    native = make_sensor(described, seed)
    poses = board_poses(rng, count)
    displaced = pose.from_rotation(
        pose.exp_rotation(errors.orientation * rng.normal(size=(count, 3))),
        errors.position * rng.normal(size=(count, 3)),
    )
    flange = BASE_FROM_BOARD @ pose.inverse(poses @ displaced) @ pose.inverse(FLANGE_FROM_SENSOR)
    scene = sensor_rt.Scene()
    scene.add_plane("plate", np.eye(4), [2 * _STRIPE_HALF_WIDTH] * 2, 0.6)
    still = np.broadcast_to(np.eye(4), (count, 1, 4, 4))
    exposures = sensor_rt.Exposures(
        still, poses[:, None, None], np.full(count, native.exposure), np.arange(1, count + 1, dtype=np.int64)
    )
    lit = sensor_rt.render(scene, native, exposures, 1)[:, 0].astype(float)
    images = [np.minimum(stripe + _drawn(native, one, rng), 255.0) for stripe, one in zip(lit, poses, strict=True)]
    return BoardRecording(np.array([np.rot90(image, -1) for image in images]).round().astype(np.uint8), flange)


def _drawn(native: sensor_rt.Sensor, sensor_from_board: Array, rng: np.random.Generator) -> Array:
    """The board under even light, as the camera sees it."""
    camera = native.cameras[0]
    offsets = (np.arange(_SUBPIXELS) + 0.5) / _SUBPIXELS - 0.5
    columns = (np.arange(camera.width_px)[:, None] + offsets).ravel()
    rows = (np.arange(camera.height_px)[:, None] + offsets).ravel()
    pixels = np.stack(np.meshgrid(columns, rows), -1).reshape(-1, 2)
    board_from_sensor = pose.inverse(sensor_from_board)
    rays = camera.view_rays(pixels) @ board_from_sensor[:3, :3].T
    origin = (board_from_sensor @ camera.sensor_from_camera)[:3, 3]
    points = origin[:2] - rays[:, :2] * (origin[2] / rays[:, 2])[:, None]
    cell = np.floor(points / BOARD.square + np.array([BOARD.columns + 1, BOARD.rows + 1]) / 2).astype(int)
    inside = ((cell >= 0) & (cell <= [BOARD.columns, BOARD.rows])).all(1)
    dark = inside & (cell.sum(1) % 2 == 0)
    grey = np.where(dark, _DARK, _LIGHT).reshape(camera.height_px, _SUBPIXELS, camera.width_px, _SUBPIXELS)
    return np.asarray(grey.mean((1, 3)) + rng.normal(size=(camera.height_px, camera.width_px)))
