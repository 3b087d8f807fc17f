"""Solution of the calibration by a board: start by OpenCV, one adjustment of all unknowns, sizes of the errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.special import stdtrit

from scancell.calibration.board.problem import COUNT, ERRORS, NAMES, BoardProblem, BoardView, Rig, met
from scancell.errors import CalibrationError
from scancell.geometry import pose

Array = NDArray[np.float64]

LEAST_VIEWS = 4
_OUTLIER = 4.0  # standard deviations, of stripe points
_FLOOR = 0.05  # px: least scale of stripe residuals
_START = np.array([0.3, 0.3, 0.3, 1.0, 1.0])  # px, px, mm, mrad, px
_LEAST = np.array([0.01, 0.01, 1e-3, 1e-3, 1e-3])
_ROUNDS = 5  # of linearisation, between estimates of the errors' sizes
_ESTIMATES = 300
_SETTLED = 3e-4
_STEPS, _EVALUATIONS = 3, 15
_MOVED = 1e-2  # of unknowns in their scales
_LEAST_EIGENVALUE = 1e-12  # of the scaled information, over the largest one


@dataclass(frozen=True)
class BoardCalibration:
    """Result of `solve`.

    Attributes
    ----------
    rig
        Camera, laser, hand-eye and board.
    covariance
        (22, 22) of the unknowns, in the units of the solution.
    sizes
        (5,) standard deviations of corners and single points of the stripe (px), of a view's displacement of the board
        (mm) and its rotation (mrad), and of offset and tilt of its stripe (px).
    errors
        (n, 8) most likely errors of each view, see `BoardProblem`.
    corners, stripe
        Residuals, px, and the view of each.
    problem
        The views with the stripe points that were used.
    discarded
        Number of stripe points that were not.
    """

    rig: Rig
    covariance: Array
    sizes: Array
    errors: Array
    corners: Array
    stripe: Array
    problem: BoardProblem
    discarded: int

    @property
    def degrees_of_freedom(self) -> float:
        """Of the variances of the views' errors, which govern the covariance: three of each view but the unknowns'."""
        return float(max(3 * len(self.problem.views) - 6, 1))

    def factor(self, probability: float = 0.95) -> float:
        """Half width of an interval, in standard deviations."""
        return float(stdtrit(self.degrees_of_freedom, 0.5 + probability / 2))


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
    for left_out in range(count):
        rows = np.arange(count) != left_out
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
        middle = _mean_pose(boards[rows])
        found.append(HandEye(camera, middle, np.linalg.norm(boards[:, :3, 3] - middle[:3, 3], axis=1)))
    if not found:
        raise CalibrationError("the flange's poses do not determine the pose of the camera: turn it about two axes")
    return min(found, key=lambda one: float(np.median(one.away)))


def _mean_pose(poses: Array) -> Array:
    u, _, vt = np.linalg.svd(poses[:, :3, :3].mean(0))
    return pose.from_rotation(u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt, np.median(poses[:, :3, 3], axis=0))


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
    return np.concatenate([met(rig.rays(view.stripe), board) for view, board in zip(views, boards, strict=True)])


def solve(views: Sequence[BoardView], start: Rig) -> BoardCalibration:
    """Adjust all unknowns at once.

    The sizes of the errors of corners, stripe and views are variance components, by restricted maximum
    likelihood. Corners and stripe points that do not fit are left out: the stripe may lie on the board.

    Raises `CalibrationError` if there are too few views, or the views do not determine the unknowns.
    """
    if len(views) < LEAST_VIEWS:
        raise CalibrationError(f"{len(views)} images show the board", expected=f"{LEAST_VIEWS} or more")
    given = sum(len(view.stripe) for view in views)
    views = _without_outliers(views, start)
    sizes, rig, errors = _START.copy(), start, np.zeros((len(views), ERRORS))
    covariance, corners, stripe, problem = np.eye(COUNT), np.zeros(0), np.zeros(0), BoardProblem(views)
    for _ in range(_ROUNDS):
        problem = BoardProblem(views)
        rig, errors = _adjusted(problem, rig, errors, sizes)
        sizes, covariance = _variance_components(problem, rig, errors, sizes)
        corners, stripe = problem.residuals(rig, errors)
        before, views = views, _kept(_with_good_corners(problem, corners), stripe, problem.stripe_view)
        if all(a.counts == b.counts for a, b in zip(before, views, strict=True)):
            break
    return BoardCalibration(rig, covariance, sizes, errors, corners, stripe, problem, given - len(stripe))


def _adjusted(problem: BoardProblem, rig: Rig, errors: Array, sizes: Array) -> tuple[Rig, Array]:
    """The rig and errors of the views with the least sum of squares."""
    weight, prior = _weights(problem, sizes)

    def split(x: Array) -> tuple[Rig, Array]:
        return rig.moved(x[:COUNT]), x[COUNT:].reshape(-1, ERRORS)

    def function(x: Array) -> Array:
        return np.concatenate([np.concatenate(problem.residuals(*split(x))) * weight, x[COUNT:] * prior])

    def jacobian(x: Array) -> Array:
        # About the rig of x, a step of which is to first order one of the start.
        own = problem.jacobian(*split(x)) * weight[:, None]
        return np.vstack([own, np.hstack([np.zeros((len(prior), COUNT)), np.diag(prior)])])

    for _ in range(_STEPS):
        start = np.r_[np.zeros(COUNT), errors.ravel()]
        # MINPACK: its own factorization waits for no other threads.
        found = least_squares(function, start, jacobian, method="lm", x_scale="jac", max_nfev=_EVALUATIONS, ftol=1e-9)
        rig, errors = split(found.x)
        if np.abs(found.x - start).max() < _MOVED:
            break
    return rig, errors


def _weights(problem: BoardProblem, sizes: Array) -> tuple[Array, Array]:
    """Of the residuals, and of the errors of all views."""
    corners, stripe = (
        np.full(len(of), 1.0 / size)
        for of, size in zip((problem.corner_view, problem.stripe_view), sizes, strict=False)
    )
    per_view = 1.0 / np.repeat(sizes[2:], (3, 3, 2))
    return np.r_[corners, stripe], np.tile(per_view, len(problem.views))


def _variance_components(problem: BoardProblem, rig: Rig, errors: Array, sizes: Array) -> tuple[Array, Array]:
    """Standard deviations of the errors by REML, and the covariance of the rig's unknowns; linearised at a solution."""
    base, jacobian = np.concatenate(problem.residuals(rig, errors)), problem.jacobian(rig, errors)
    x = np.r_[np.zeros(COUNT), errors.ravel()]
    constant = base - jacobian @ x
    corners = len(problem.corner_view)
    groups = [slice(0, corners), slice(corners, len(base))]
    squares = [jacobian[group].T @ jacobian[group] for group in groups]
    gradients = [jacobian[group].T @ constant[group] for group in groups]
    kinds = np.tile(np.repeat([0, 1, 2], (3, 3, 2)), len(errors))
    # A view without a stripe tells nothing of its errors.
    told = np.diag(squares[0] + squares[1])[COUNT:] > 0
    covariance = np.eye(len(x))
    for _ in range(_ESTIMATES):
        prior = np.r_[np.zeros(COUNT), sizes[2:][kinds] ** -2.0]
        information = squares[0] / sizes[0] ** 2 + squares[1] / sizes[1] ** 2 + np.diag(prior)
        _require_determined(information)
        covariance = np.linalg.inv(information)
        x = -covariance @ (gradients[0] / sizes[0] ** 2 + gradients[1] / sizes[1] ** 2)
        new = []
        for group, square, gradient, size in zip(groups, squares, gradients, sizes, strict=False):
            rest = constant[group] @ constant[group] + 2 * gradient @ x + x @ square @ x
            spent = float(np.sum(square * covariance)) / size**2
            new.append(np.sqrt(max(rest, 0.0) / max(group.stop - group.start - spent, 1.0)))
        spread = x[COUNT:] ** 2 + np.diag(covariance)[COUNT:]
        new += [np.sqrt(spread[told & (kinds == kind)].mean()) for kind in range(3)]
        before, sizes = sizes, np.maximum(new, _LEAST)
        if np.abs(np.log(sizes / before)).max() < _SETTLED:
            break
    return sizes, covariance[:COUNT, :COUNT]


def _require_determined(information: Array) -> None:
    scale = np.sqrt(np.diag(information))
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    if values[0] < _LEAST_EIGENVALUE * values[-1]:
        worst = np.argsort(-np.abs(vectors[:COUNT, 0]))[:3]
        raise CalibrationError(
            "the images do not determine "
            + ", ".join(NAMES[i] for i in worst)
            + ": turn the camera about two axes, and"
            " take images from different distances"
        )


def _with_good_corners(problem: BoardProblem, residual: Array) -> list[BoardView]:
    """The views with the corners that fit."""
    away = np.linalg.norm(residual.reshape(-1, 2), axis=1)
    good = away < _OUTLIER * max(float(np.median(away)), _FLOOR)
    found = []
    for i, view in enumerate(problem.views):
        rows = good[problem.corner_view[::2] == i]
        found.append(replace(view, corners=view.corners[rows], corner_pixels=view.corner_pixels[rows]))
    return found


def _kept(views: Sequence[BoardView], residual: Array, view_of: NDArray[np.intp]) -> list[BoardView]:
    """The views with the stripe points that fit."""
    good = np.abs(residual) < _OUTLIER * max(1.4826 * float(np.median(np.abs(residual))), _FLOOR)
    found = []
    for i, view in enumerate(views):
        rows = good[view_of == i]
        found.append(replace(view, stripe=view.stripe[rows], across=view.across[rows]))
    return found


def _without_outliers(views: Sequence[BoardView], rig: Rig) -> list[BoardView]:
    """The views with the stripe points that fit the median of their view."""
    problem = BoardProblem(views)
    residual = problem.residuals(rig, np.zeros((len(views), ERRORS)))[1]
    for i in range(len(views)):
        own = problem.stripe_view == i
        residual[own] -= np.median(residual[own]) if own.any() else 0.0
    return _kept(views, residual, problem.stripe_view)
