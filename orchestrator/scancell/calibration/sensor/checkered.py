"""Checkered target (ChArUco board): its pattern, its corners in images, and start values from them by OpenCV."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from scancell.calibration.sensor.parameters import SensorParameters
from scancell.calibration.sensor.problem import Corners, TargetExposure
from scancell.config.sensor import (
    CameraDescription,
    SensorDescription,
    focal_length_px,
    image_sensor_pixels,
    principal_point_px,
)
from scancell.errors import CalibrationError
from scancell.geometry import pose
from scancell.geometry.shapes import PlacedShape, Plane, ShapeGroup

Array = NDArray[np.float64]

_BITS_OF_SQUARE = 8  # 6 of a marker with its border, and the margin around it
_BITS_OF_MARKER = 6
_CORNER_SIGMA = 0.05  # px: scatter of sub-pixel corners in well exposed images
_FEWEST = 8  # corners of a usable view of a camera
_WINDOW = 0.95  # of a cell: half the window of corner refinement
_LARGEST_SQUARE = 200.0  # px, for that window
_VIEWS = 3  # of a camera, for its intrinsics


@dataclass(frozen=True)
class CheckeredBoard:
    """ChArUco board of the dictionary 4X4_250: squares of `square` (m), every second one with a marker.

    Frame: the middle of the board, x to the right, y up and z out of the printed side.
    """

    columns: int = 12
    rows: int = 10
    square: float = 0.004

    @property
    def size(self) -> tuple[float, float]:
        """Width and height, m."""
        return self.columns * self.square, self.rows * self.square

    @property
    def surface(self) -> ShapeGroup:
        """The board's plane."""
        return ShapeGroup((PlacedShape("board", Plane(*self.size), np.eye(4)),), "checkered board")

    @property
    def white(self) -> NDArray[np.bool_]:
        """Pattern (8 rows, 8 columns) in cells of an eighth of a square, from the top left."""
        size = (self.columns * _BITS_OF_SQUARE, self.rows * _BITS_OF_SQUARE)
        return np.asarray(self._board.generateImage(size, marginSize=0, borderBits=1)) > 127

    def detect(self, images: NDArray[np.uint16], bit_depth: int, camera: Sequence[int] | None = None) -> Corners | None:
        """Corners in the images (cameras, height, width) of one view; None if no camera sees enough of them.

        Parameters
        ----------
        camera
            Numbers of the images' cameras; None: 0, 1, …
        """
        found: list[tuple[int, Array, Array]] = []
        for number, image in zip(range(len(images)) if camera is None else camera, images, strict=True):
            grey = (image.astype(np.float64) * (255.0 / (2**bit_depth - 1))).round().astype(np.uint8)
            pixels, ids, *_ = self._detector.detectBoard(grey)
            if ids is not None and len(ids) >= _FEWEST:
                refined = self._refined(image.astype(np.float32), pixels, ids.ravel())
                found.append((number, refined, self._corners[ids.ravel()]))
        if not found:
            return None
        return Corners(
            np.concatenate([np.full(len(pixels), number, np.int32) for number, pixels, _ in found]),
            np.concatenate([pixels for _, pixels, _ in found]),
            np.concatenate([points for *_, points in found]),
            _CORNER_SIGMA,
        )

    def _refined(self, image: NDArray[np.float32], pixels: NDArray[np.float32], ids: NDArray[np.int32]) -> Array:
        """Corners (n, 2) refined in the largest window that holds no part of a marker: one cell to each side."""
        apart = np.linalg.norm(pixels.reshape(-1, 1, 2) - pixels.reshape(1, -1, 2), axis=2)
        spacing = np.linalg.norm(self._corners[ids][:, None] - self._corners[ids], axis=2)
        cell = float(np.min(apart[np.isclose(spacing, self.square)], initial=_LARGEST_SQUARE)) / _BITS_OF_SQUARE
        half = max(int(_WINDOW * cell), 2)
        stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)
        return cv2.cornerSubPix(image, pixels.copy(), (half, half), (-1, -1), stop).reshape(-1, 2).astype(float)

    @cached_property
    def _board(self) -> Any:
        dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_250)
        marker = self.square * _BITS_OF_MARKER / _BITS_OF_SQUARE
        return cv2.aruco.CharucoBoard((self.columns, self.rows), self.square, marker, dictionary)

    @cached_property
    def _detector(self) -> Any:
        return cv2.aruco.CharucoDetector(self._board)

    @cached_property
    def _corners(self) -> Array:
        """Inner corners (n, 3) by their id; OpenCV counts from the top left with y down."""
        corners = np.asarray(self._board.getChessboardCorners(), float)
        width, height = self.size
        return np.column_stack([corners[:, 0] - width / 2, height / 2 - corners[:, 1], np.zeros(len(corners))])


def start_from_corners(
    sensor: SensorDescription, views: Sequence[TargetExposure]
) -> tuple[SensorDescription, tuple[TargetExposure, ...]]:
    """Start for the joint solution: cameras' fields of view, principal points and distortion, and poses of the views.

    By ``cv2.calibrateCamera`` (Zhang's method) for every camera with three views or more and no tilted image sensor;
    others keep their description. A view's pose is that by the first camera that sees it.

    Raises `CalibrationError` if a view has no corners, or its pose cannot be found.
    """
    for camera in range(len(sensor.camera)):
        sensor = _with_intrinsics(sensor, camera, views)
    placed = tuple(replace(view, sensor_from_target=_pose(sensor, view)) for view in views)
    return sensor, placed


def _with_intrinsics(sensor: SensorDescription, camera: int, views: Sequence[TargetExposure]) -> SensorDescription:
    one = sensor.camera[camera]
    pairs = [_seen(sensor, view, camera) for view in views]
    usable = [(points, pixels) for points, pixels in pairs if len(points) >= _FEWEST]
    if len(usable) < _VIEWS or one.scheimpflug_x_deg or one.scheimpflug_y_deg:
        return sensor
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_ASPECT_RATIO | cv2.CALIB_ZERO_TANGENT_DIST
    flags |= cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3
    points, pixels = ([pair[k].astype(np.float32) for pair in usable] for k in (0, 1))
    found = cv2.calibrateCamera(points, pixels, (one.width_px, one.height_px), *_intrinsics(one), flags=flags)
    matrix, distortion = (np.asarray(values, float) for values in found[1:3])
    key = f"camera[{camera + 1}]"
    return sensor.replace(
        {
            f"{key}.half_angle_deg": float(np.degrees(np.arctan(one.height_px / (2.0 * matrix[1, 1])))),
            f"{key}.cx_px": float(matrix[0, 2]),
            f"{key}.cy_px": float(matrix[1, 2]),
            f"{key}.distortion": [float(k) for k in np.ravel(distortion)[:5]],
        }
    )


def _pose(sensor: SensorDescription, view: TargetExposure) -> Array:
    """``sensor_from_target`` by the first camera with corners."""
    if view.corners is None:
        raise CalibrationError("checkered target: a view has no corners")
    camera = int(view.corners.camera[0])
    points, pixels = _seen(sensor, view, camera)
    matrix, distortion = _intrinsics(sensor.camera[camera])
    found, turn, offset = cv2.solvePnP(points, pixels, matrix, distortion, flags=cv2.SOLVEPNP_IPPE)
    if not found:
        raise CalibrationError("checkered target: the pose of a view cannot be found from its corners")
    camera_from_target = pose.from_rotation(pose.exp_rotation(turn.ravel()), offset.ravel())
    native = SensorParameters(sensor, ()).sensor(np.zeros(0))
    return np.asarray(native.cameras[camera].sensor_from_camera @ camera_from_target)


def _seen(sensor: SensorDescription, view: TargetExposure, camera: int) -> tuple[Array, Array]:
    """Points (n, 3) of the corners that a camera sees, and their pixels (n, 2) of the image sensor."""
    corners = view.corners
    if corners is None:
        return np.zeros((0, 3)), np.zeros((0, 2))
    own = corners.camera == camera
    return corners.points_in_target[own], image_sensor_pixels(sensor, camera, corners.pixels[own])


def _intrinsics(camera: CameraDescription) -> tuple[Array, Array]:
    """Camera matrix (3, 3) and distortion (5,) of OpenCV."""
    focal = focal_length_px(camera)
    cx, cy = principal_point_px(camera)
    return np.array([[focal, 0.0, cx], [0.0, focal, cy], [0.0, 0.0, 1.0]]), np.array(camera.distortion)
