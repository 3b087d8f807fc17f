"""How a calibration by images of a board predicts the board in images that were left out of it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from scancell.calibration.board.solve import COUNT, BoardCalibration, BoardView, Rig, displaced
from scancell.calibration.variance_components import half_widths
from scancell.geometry import pose

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PredictionError:
    """How far the board of a view is from where a calibration by other views predicts it.

    Attributes
    ----------
    displacement
        (6,) from the predicted to the seen pose in the frame of the board: translation, mm, and rotation vector, mrad.
    standard_deviation
        (6,) that is expected of it, by the calibration, a view and corners. Errors of the calibration move both poses:
        what a wrong focal length adds to the seen distance, the hand-eye pose has taken into account.
    half_width
        (6,) of its interval of 95 %.
    """

    displacement: Array
    standard_deviation: Array
    half_width: Array


def prediction_error(found: BoardCalibration, view: BoardView) -> PredictionError:
    """The error of the predicted pose of the board in a view that was left out of a calibration."""
    rig, step = found.rig, 1e-3
    predicted, seen = rig.camera_from_board(view.flange), seen_pose(rig, view)
    moved = [rig.moved(step * e) for e in np.eye(COUNT)]
    by_rig = np.stack([displacement(predicted, one.camera_from_board(view.flange)) / step for one in moved], 1)

    def pixels(seen_by: Rig, x: Array) -> Array:
        return seen_by.project(pose.transform_points(seen @ displaced(1e-3 * x), view.corners)).ravel()

    by_pose = np.stack([(pixels(rig, e) - pixels(rig, -e)) / 2e-2 for e in 1e-2 * np.eye(6)], 1)
    pixels_by_rig = np.stack([(pixels(one, np.zeros(6)) - pixels(rig, np.zeros(6))) / step for one in moved], 1)
    seen_by_rig = -np.linalg.lstsq(by_pose, pixels_by_rig, rcond=None)[0]
    difference = seen_by_rig - by_rig
    estimate, squares = found.estimate, found.sizes**2
    noise = np.zeros((len(squares), 6))  # variances by corners, translations and rotations of a view
    noise[0] = squares[0] * np.diag(np.linalg.inv(by_pose.T @ by_pose))
    noise[2, :3], noise[3, 3:] = squares[2], squares[3]
    variance = np.einsum("ap,pq,aq->a", difference, estimate.covariance, difference) + noise.sum(0)
    slopes = np.einsum("ap,kpq,aq->ka", difference, estimate.slopes, difference) + noise
    deviation, degrees = np.sqrt(variance), estimate.degrees_of_freedom(variance, slopes)
    return PredictionError(displacement(predicted, seen), deviation, half_widths(deviation, degrees, 0.95))


def seen_pose(rig: Rig, view: BoardView) -> Array:
    """Pose (4, 4) of the board in the camera by the corners of a view."""
    matrix = np.array(
        [[rig.intrinsics[0], 0, rig.intrinsics[1]], [0, rig.intrinsics[0], rig.intrinsics[2]], [0, 0, 1.0]]
    )
    distortion = np.r_[rig.intrinsics[3:7], 0.0]
    _, turn, offset = cv2.solvePnP(view.corners, view.corner_pixels, matrix, distortion)
    return pose.from_rotation(pose.exp_rotation(np.ravel(turn)), np.ravel(offset))


def displacement(base: Array, moved: Array) -> Array:
    """Displacement (6,) from one pose of the board to another, in its frame: mm, then rotation vector in mrad."""
    away = pose.inverse(base) @ moved
    return np.asarray(1e3 * np.r_[away[:3, 3], pose.log_rotation(away[:3, :3])])
