"""OpenCV, where it has an algorithm for the track."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.board_views import View, pose_of, read_views
from benchmarks.track import Array
from benchmarks.tracks.hand_eye import NAMES, values_of

_BLUR = 1.5  # px
_TURN, _SHIFT = (slice(0, 3), slice(0, 3)), (slice(0, 3), 3)
_LEAST = 6.0  # standard deviations of the noise of dark pixels


def stripe(case: dict[str, Any]) -> dict[str, Any]:
    """``cv2.GaussianBlur`` along columns; zero of ``cv2.Sobel`` at the brightest pixel, linear between rows."""
    camera = case["camera"]
    dark = np.hypot(camera["gain_dn_per_e"] * camera["read_noise_e"], 12**-0.5)
    found: dict[str, list[float]] = {"frame": [], "column": [], "row": []}
    for frame, image in enumerate(case["images"]):
        smooth = cv2.GaussianBlur(image.astype(np.float32), (1, 13), sigmaX=0.1, sigmaY=_BLUR)
        slope = cv2.Sobel(smooth, cv2.CV_32F, 0, 1, ksize=1)
        for column in np.flatnonzero(image.max(0) - camera["black_level_dn"] > _LEAST * dark):
            top = int(smooth[:, column].argmax())
            # The zero lies beside the brightest pixel, on the side to which the light grows.
            first = top if slope[top, column] > 0 else top - 1
            if 0 <= first < len(smooth) - 1:
                a, b = slope[first, column], slope[first + 1, column]
                found["frame"].append(frame)
                found["column"].append(column)
                found["row"].append(first + a / (a - b) if a != b else first + 0.5)
    return found


@dataclass(frozen=True)
class Rig:
    """Camera matrix (3, 3), distortion, poses (n, 4, 4) of the board in the camera and of the flange in the base."""

    matrix: Array
    distortion: Array
    boards: Array
    flange: Array

    def rays(self, pixels: Array) -> Array:
        """Directions (n, 3), z = 1, of pixels (n, 2) in the camera."""
        points = cv2.undistortPoints(pixels.reshape(-1, 1, 2), self.matrix, self.distortion).reshape(-1, 2)
        return np.column_stack([points, np.ones(len(points))])


def camera_of(case: dict[str, Any], views: list[View]) -> Rig:
    """Zhang's method: ``cv2.calibrateCamera`` with one focal length, k1, k2, p1 and p2."""
    width, height = case["width_px"], case["height_px"]
    guess = np.array([[1.5 * width, 0, (width - 1) / 2], [0, 1.5 * width, (height - 1) / 2], [0, 0, 1.0]])
    flags = cv2.CALIB_FIX_ASPECT_RATIO | cv2.CALIB_FIX_K3 | cv2.CALIB_USE_INTRINSIC_GUESS
    points, pixels = ([getattr(view, name).astype(np.float32) for view in views] for name in ("points", "pixels"))
    _, matrix, distortion, turns, offsets = cv2.calibrateCamera(
        points, pixels, (width, height), guess, np.zeros(5), flags=flags
    )
    boards = [pose_of(Rotation.from_rotvec(turn.ravel()), at.ravel()) for turn, at in zip(turns, offsets, strict=True)]
    return Rig(matrix, distortion, np.stack(boards), np.stack([view.flange for view in views]))


def points_on_sheet(case: dict[str, Any], views: list[View], rig: Rig) -> dict[str, Any]:
    """Points at the pixels of the query on a plane of least squares through all stripes on the boards."""
    stripes = []
    for view, board in zip(views, rig.boards, strict=True):
        rays = rig.rays(view.stripe)
        stripes.append(rays * (board[:3, 2] @ board[:3, 3] / (rays @ board[:3, 2]))[:, None])
    points = np.concatenate(stripes)
    normal = np.linalg.svd(points - points.mean(0), full_matrices=False)[2][2]
    rays = rig.rays(np.column_stack([case["query"]["column_px"], case["query"]["row_px"]]))
    found = 1e3 * rays * (normal @ points.mean(0) / (rays @ normal))[:, None]
    return {"x_mm": found[:, 0], "y_mm": found[:, 1], "z_mm": found[:, 2]}


def hand_eye(case: dict[str, Any]) -> dict[str, Any]:
    """``cv2.calibrateHandEye`` by Park and Martin; the board is the mean over the views."""
    rig = camera_of(case, read_views(case))
    poses = [list(one[:, part, column]) for one in (rig.flange, rig.boards) for part, column in (_TURN, _SHIFT)]
    rotation, offset = cv2.calibrateHandEye(*poses, method=cv2.CALIB_HAND_EYE_PARK)
    camera = pose_of(Rotation.from_matrix(rotation), offset.ravel())
    boards = rig.flange @ camera @ rig.boards
    board = pose_of(Rotation.from_matrix(boards[:, :3, :3]).mean(), boards[:, :3, 3].mean(0))
    return {"name": NAMES, "value": values_of([camera, board])}


def sensor(case: dict[str, Any]) -> dict[str, Any]:
    """Camera by ``cv2.calibrateCamera``, sheet by a plane through the stripes."""
    views = read_views(case)
    return points_on_sheet(case, views, camera_of(case, views))
