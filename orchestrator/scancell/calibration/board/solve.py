"""Solution of the calibration by a board: start by OpenCV, one adjustment of all unknowns, sizes of the errors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from scancell.arrays import Array
from scancell.calibration.board.problem import COUNT, ERRORS, NAMES, BoardProblem, BoardView, Rig, met
from scancell.calibration.variance_components import (
    Estimate,
    LeftOut,
    Moments,
    equations_at,
    estimate,
    left_out,
    normal_equations,
)
from scancell.errors import CalibrationError
from scancell.geometry import pose
from scancell.geometry.least_squares import NormalEquations, minimise, undetermined

LEAST_VIEWS = 4
_OUTLIER = 4.0  # standard deviations, of stripe points
_FLOOR = 0.05  # px: least scale of stripe residuals
_START = np.array([0.3, 0.3, 0.3, 1.0, 1.0])  # px, px, mm, mrad, px
_ROUNDS = 5  # of linearisation, between estimates of the errors' sizes
_STEPS = 60
_SETTLED = 1e-4  # decrease of the sum of squares


@dataclass(frozen=True)
class BoardCalibration:
    """Result of `solve`.

    Attributes
    ----------
    rig
        Camera, laser, hand-eye and board.
    estimate
        Covariance (22, 22) of the unknowns in the units of the solution, and the variances of all errors.
    errors
        (n, 8) most likely errors of each view, see `BoardProblem`.
    corners, stripe
        Residuals, px, and the view of each.
    problem
        The views with the stripe points that were used.
    discarded
        Number of stripe points that were not.
    left_out
        Displacement (6,) of the board of each view from where the other views predict it, in the frame of the board:
        translation, mm, and rotation vector, mrad.
    """

    rig: Rig
    estimate: Estimate
    errors: Array
    corners: Array
    stripe: Array
    problem: BoardProblem
    discarded: int
    left_out: LeftOut

    @property
    def sizes(self) -> Array:
        """Standard deviations (5,) of all errors.

        Those of corners and single points of the stripe (px), of a view's displacement of the board (mm) and its
        rotation (mrad), and of offset and tilt of its stripe (px).
        """
        return np.asarray(np.exp(0.5 * self.estimate.log_variances))


@dataclass(frozen=True)
class _State:
    rig: Rig
    errors: Array


def calibrate_cameras(views: Sequence[BoardView], size: tuple[int, int]) -> tuple[Array, Array]:
    """Intrinsics (7,) and poses (n, 4, 4) of the board in the camera, by ``cv2.calibrateCamera`` (Zhang's method)."""
    points = [view.corners.astype(np.float32) for view in views]
    pixels = [view.corner_pixels.astype(np.float32) for view in views]
    flags = cv2.CALIB_FIX_ASPECT_RATIO | cv2.CALIB_FIX_K3 | cv2.CALIB_USE_INTRINSIC_GUESS
    guess = np.array(
        [[1.5 * max(size), 0.0, (size[0] - 1) / 2], [0.0, 1.5 * max(size), (size[1] - 1) / 2], [0.0, 0.0, 1.0]]
    )
    _, matrix, distortion, turns, offsets = cv2.calibrateCamera(points, pixels, size, guess, np.zeros(5), flags=flags)
    boards = [
        pose.from_rotation(pose.exp_rotation(np.ravel(turn)), np.ravel(offset))
        for turn, offset in zip(turns, offsets, strict=True)
    ]
    return np.r_[matrix[0, 0], matrix[0, 2], matrix[1, 2], np.ravel(distortion)[:4]], np.stack(boards)


@dataclass(frozen=True)
class HandEye:
    """Poses (4, 4) of camera and board, and the distance (n,) of each view's board from the common one, m."""

    flange_from_camera: Array
    base_from_board: Array
    away: Array


def hand_eye(flange: Array, camera_from_board: Array) -> HandEye:
    """Hand-eye calibration by ``cv2.calibrateHandEye`` (Park and Martin 1994), without the view that fits worst.

    Of the solutions without one view each, the one with the smallest median distance is taken.
    """
    count = len(flange)
    found: list[HandEye] = []
    for row in range(count):
        rows = np.arange(count) != row
        rotation, offset = cv2.calibrateHandEye(
            list(flange[rows, :3, :3]),
            list(flange[rows, :3, 3]),
            list(camera_from_board[rows, :3, :3]),
            list(camera_from_board[rows, :3, 3]),
            method=cv2.CALIB_HAND_EYE_PARK,
        )
        if not np.isfinite(rotation).all():
            continue
        camera = pose.from_rotation(rotation, np.ravel(offset))
        boards = flange @ camera @ camera_from_board
        mean = pose.nearest_rotation(boards[rows, :3, :3].mean(0))
        middle = pose.from_rotation(mean, np.median(boards[rows, :3, 3], axis=0))
        found.append(HandEye(camera, middle, np.linalg.norm(boards[:, :3, 3] - middle[:3, 3], axis=1)))
    if not found:
        raise CalibrationError("the flange's poses do not determine the pose of the camera: turn it about two axes")
    return min(found, key=lambda one: float(np.median(one.away)))


def plane_frame(points: Array) -> Array:
    """A frame (4, 4) whose x-y plane is the plane of least squares of points (n, 3), robustly."""
    kept = np.ones(len(points), bool)
    for _ in range(10):
        middle = points[kept].mean(0)
        axes = np.linalg.svd(points[kept] - middle, full_matrices=False)[2]
        distance = np.abs((points - middle) @ axes[2])
        kept = distance < max(3 * 1.4826 * float(np.median(distance[kept])), 1e-6)
    rotation = np.column_stack([axes[0], axes[1], np.cross(axes[0], axes[1])])
    return pose.from_rotation(rotation, middle)


def start_rig(views: Sequence[BoardView], size: tuple[int, int]) -> Rig:
    """OpenCV's intrinsics and hand-eye, and the plane through the stripes on the boards as OpenCV sees them."""
    intrinsics, boards = calibrate_cameras(views, size)
    found = hand_eye(np.stack([view.flange for view in views]), boards)
    rig = Rig(intrinsics, found.flange_from_camera, found.base_from_board, np.eye(4))
    return replace(rig, sheet=plane_frame(stripes_in_camera(rig, views, boards)))


def stripes_in_camera(rig: Rig, views: Sequence[BoardView], boards: Array) -> Array:
    """Points (n, 3) of all stripes in the camera, on the boards at poses (views, 4, 4) in it."""
    pairs = zip(views, boards, strict=True)
    return np.concatenate([met(rig.rays(view.stripe), board) for view, board in pairs if len(view.stripe)])


def solve(views: Sequence[BoardView], start: Rig) -> BoardCalibration:
    """Adjust all unknowns at once.

    The sizes of the errors of corners, stripe and views are variance components, by restricted maximum
    likelihood. Corners and stripe points that do not fit are left out: the stripe may lie on the board.

    Raises `CalibrationError` if there are too few views, or the views do not determine the unknowns.
    """
    if len(views) < LEAST_VIEWS:
        raise CalibrationError(f"{len(views)} images show the board", expected=f"{LEAST_VIEWS} or more")
    given = sum(len(view.stripe) for view in views)
    problem = BoardProblem(views)
    corners, stripe = problem.residuals(start, np.zeros((len(views), ERRORS)))
    for own in (problem.stripe_view == i for i in range(len(views))):
        stripe[own] -= np.median(stripe[own]) if own.any() else 0.0
    views = _without_outliers(problem, np.zeros_like(corners), stripe)
    log_variances, state = 2 * np.log(_START), _State(start, np.zeros((len(views), ERRORS)))
    for _ in range(_ROUNDS):
        problem = BoardProblem(views)
        state, is_settled = _adjusted(problem, state, log_variances)
        moments = _moments(problem, state)
        information = normal_equations(moments, log_variances).information
        for direction, _ in undetermined(information, np.zeros_like(information), np.inf):
            worst = np.argsort(-np.abs(direction) * np.sqrt(np.diag(information)))[:3]
            raise CalibrationError(
                "the images do not determine "
                + ", ".join(NAMES[i] for i in worst)
                + ": turn the camera about two axes, and take images from different distances"
            )
        last = estimate(moments)
        log_variances = last.log_variances
        corners, stripe = problem.residuals(state.rig, state.errors)
        before, views = views, _without_outliers(problem, corners, stripe)
        if is_settled and all(a.counts == b.counts for a, b in zip(before, views, strict=True)):
            break
    if not is_settled:
        raise CalibrationError(f"the calibration did not converge in {_STEPS} steps: check images and poses")
    by_displacement = np.concatenate(moments.modes, -1)
    displaced = left_out(moments, last, by_displacement, 6)
    return BoardCalibration(state.rig, last, state.errors, corners, stripe, problem, given - len(stripe), displaced)


def _adjusted(problem: BoardProblem, start: _State, log_variances: Array) -> tuple[_State, bool]:
    """The rig and errors of the views with the least sum of squares, and whether the steps ended there."""

    def equations(at: _State) -> tuple[NormalEquations, Callable[[Array], _State]]:
        squares = np.array([residual @ residual for residual in problem.residuals(at.rig, at.errors)])
        normal, errors_after = equations_at(_moments(problem, at), squares, at.errors, log_variances)
        return normal, lambda step: _State(at.rig.moved(step), errors_after(step))

    return minimise(equations, start, _STEPS, _SETTLED)


def _moments(problem: BoardProblem, at: _State) -> Moments:
    """Regressors are the unknowns and the errors of a view, and the groups of measurements corners and stripe."""
    by_rig, by_error = problem.derivatives(at.rig, at.errors)
    views, width = len(problem.views), COUNT + ERRORS
    residual = np.concatenate(problem.residuals(at.rig, at.errors))
    view = np.concatenate([problem.corner_view, problem.stripe_view])
    rows = np.column_stack([by_rig, by_error, residual - np.sum(by_error * at.errors[view], 1)])
    corners = len(problem.corner_view)
    groups = (slice(None, corners), slice(corners, None))
    second = np.stack([Moments.of_exposures(rows[own], view[own], views) for own in groups])
    design, modes = np.broadcast_to(np.eye(width), (views, width, width)), (slice(0, 3), slice(3, 6), slice(6, 8))
    of_views = -design[:, :, COUNT:]
    count = np.array([corners, len(view) - corners])
    return Moments(second, design[:, :, :COUNT], tuple(of_views[:, :, own] for own in modes), count)


def _without_outliers(problem: BoardProblem, corners: Array, stripe: Array) -> list[BoardView]:
    """The views with the corners and stripe points whose residuals (2 c,) and (s,) fit."""
    away = np.linalg.norm(corners.reshape(-1, 2), axis=1)
    good_corners = away < _OUTLIER * max(float(np.median(away)), _FLOOR)
    good_stripe = np.abs(stripe) < _OUTLIER * max(1.4826 * float(np.median(np.abs(stripe))), _FLOOR)
    views = []
    for i, view in enumerate(problem.views):
        seen, lit = good_corners[problem.corner_view[::2] == i], good_stripe[problem.stripe_view == i]
        views.append(
            replace(
                view,
                corners=view.corners[seen],
                corner_pixels=view.corner_pixels[seen],
                stripe=view.stripe[lit],
                across=view.across[lit],
            )
        )
    return views
