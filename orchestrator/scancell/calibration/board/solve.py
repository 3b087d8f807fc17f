"""Solution of the calibration by a board: start by OpenCV, one adjustment of all unknowns, sizes of the errors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from scancell.arrays import Array
from scancell.calibration.variance_components import (
    Estimate,
    LeftOut,
    Moments,
    equations_at,
    estimate,
    left_out,
    normal_equations,
)
from scancell.config.sensor import SensorDescription
from scancell.errors import CalibrationError, DescriptionError
from scancell.geometry import pose
from scancell.geometry.least_squares import NormalEquations, minimise, undetermined

INTRINSICS = ("focal_px", "cx_px", "cy_px", "k1", "k2", "p1", "p2")
_WRITTEN = ("x_mm", "y_mm", "z_mm", "rotvec_1_deg", "rotvec_2_deg", "rotvec_3_deg")
_POSE = ("x_mm", "y_mm", "z_mm", "rx_mrad", "ry_mrad", "rz_mrad")
SHEET = ("sheet_distance_mm", "sheet_turn_1_mrad", "sheet_turn_2_mrad")
VALUES = (
    *INTRINSICS,
    *(f"{frame}.{key}" for frame in ("flange_from_camera", "base_from_board") for key in _WRITTEN),
    *(f"sheet.{key}" for key in ("normal_x", "normal_y", "normal_z", "distance_mm")),
)
# The unknowns, as messages name them, and the errors of a view.
NAMES = (*INTRINSICS, *(f"camera_{key}" for key in _POSE), *(f"board_{key}" for key in _POSE), *SHEET)
COUNT, ERRORS = len(NAMES), 8
_STEP = 1e-3  # of an unknown in the solution: residuals are linear over about 1
_SCALES = np.array([10.0, 10.0, 10.0, 0.1, 0.5, 0.01, 0.01, *[1e-3] * 15])
_UNDISTORTION = (cv2.TERM_CRITERIA_COUNT, 6, 0.0)

_MARGIN = 0.2  # of the distances of the stripe, on both sides of the range

LEAST_VIEWS = 4
_OUTLIER = 4.0  # standard deviations, of stripe points
_FLOOR = 0.05  # px: least scale of stripe residuals
_START = np.array([0.3, 0.3, 0.3, 1.0, 1.0])  # px, px, mm, mrad, px
_ROUNDS = 5  # of linearisation, between estimates of the errors' sizes
_STEPS = 60
_SETTLED = 1e-4  # decrease of the sum of squares


@dataclass(frozen=True)
class BoardView:
    """An image of the board.

    Attributes
    ----------
    name
        Name of the image.
    flange
        (4, 4) measured pose of the flange in the robot's base.
    corners, corner_pixels
        (n, 3) in the board, m, and (n, 2) column and row in the image.
    stripe
        (m, 2) column and row of points of the stripe on the board's plane.
    across
        (m, 2) unit vectors across the stripe in the image.
    """

    name: str
    flange: Array
    corners: Array
    corner_pixels: Array
    stripe: Array
    across: Array

    @property
    def counts(self) -> tuple[int, int]:
        """Number of corners and of stripe points."""
        return len(self.corners), len(self.stripe)


@dataclass(frozen=True)
class Rig:
    """Camera, laser and board.

    Attributes
    ----------
    intrinsics
        (7,) see `INTRINSICS`.
    flange_from_camera, base_from_board
        (4, 4) poses, m.
    sheet
        (4, 4) pose of a frame in the camera whose x-y plane is the laser's sheet.
    """

    intrinsics: Array
    flange_from_camera: Array
    base_from_board: Array
    sheet: Array

    def moved(self, x: Array) -> Rig:
        """The rig after a step (22,) of the unknowns, in the units of the solution."""
        x = x * _SCALES
        turned = pose.from_rotation(pose.exp_rotation([x[20], x[21], 0.0]), [0.0, 0.0, x[19]])
        return Rig(
            self.intrinsics + x[:7],
            self.flange_from_camera @ displaced(x[7:13]),
            self.base_from_board @ displaced(x[13:19]),
            self.sheet @ turned,
        )

    def rays(self, pixels: Array) -> Array:
        """Directions (n, 3) of the rays through pixels (n, 2) in the camera frame, z = 1."""
        points = cv2.undistortPointsIter(
            np.ascontiguousarray(pixels), *self._opencv, np.eye(3), np.eye(3), _UNDISTORTION
        )
        return np.column_stack([points[:, 0], np.ones(len(points))])

    def project(self, points: Array) -> Array:
        """Pixels (n, 2) of points (n, 3) in the camera, m."""
        return np.asarray(cv2.projectPoints(points, np.zeros(3), np.zeros(3), *self._opencv)[0][:, 0])

    @property
    def _opencv(self) -> tuple[Array, Array]:
        """Camera matrix (3, 3) and distortion (4,)."""
        f, cx, cy, *distortion = self.intrinsics
        return np.array([[f, 0.0, cx], [0.0, f, cy], [0.0, 0.0, 1.0]]), np.array(distortion)

    def camera_from_board(self, flange: Array) -> Array:
        """Poses (..., 4, 4) of the board in the camera at poses of the flange (..., 4, 4)."""
        return np.asarray(pose.inverse(flange @ self.flange_from_camera) @ self.base_from_board)

    def on_sheet(self, pixels: Array) -> Array:
        """Points (n, 3) in the camera where the rays of pixels (n, 2) meet the laser's sheet."""
        return met(self.rays(pixels), self.sheet)

    @property
    def values(self) -> Array:
        """Values (23,) as `VALUES` names them: poses by position and rotation vector, the sheet by its plane."""
        poses = [
            np.r_[1e3 * one[:3, 3], np.degrees(pose.log_rotation(one[:3, :3]))]
            for one in (self.flange_from_camera, self.base_from_board)
        ]
        normal = self.sheet[:3, 2] * np.sign(self.sheet[:3, 2] @ self.sheet[:3, 3])
        return np.concatenate([self.intrinsics, *poses, normal, [1e3 * normal @ self.sheet[:3, 3]]])


def displaced(x: Array) -> Array:
    """Displacements (..., 4, 4) by translation (m) and rotation vector (rad), (..., 6)."""
    return pose.from_rotation(pose.exp_rotation(x[..., 3:]), x[..., :3])


def met(rays: Array, plane: Array) -> Array:
    """Points (n, 3) at which rays (n, 3) from the origin meet the x-y plane of frames (n, 4, 4) or (4, 4)."""
    normal, origin = plane[..., :3, 2], plane[..., :3, 3]
    return np.asarray(rays * (np.sum(normal * origin, -1) / np.sum(normal * rays, -1))[..., None])


def _along(view: BoardView) -> Array:
    """Position (m,) of each stripe point along the stripe, -1 to 1."""
    if not len(view.stripe):
        return np.zeros(0)
    away = view.stripe - (view.stripe.max(0) + view.stripe.min(0)) / 2
    position = away @ [view.across[0, 1], -view.across[0, 0]]
    return np.asarray(position / np.abs(position).max())


class BoardProblem:
    """Residuals of views as a function of the unknowns: a step of the rig (22,), and errors of every view (n, 8).

    Errors of a view are the displacement of the board in its frame (translation in mm, rotation vector in mrad), and
    the stripe's offset in the middle and at its ends (px).
    """

    def __init__(self, views: Sequence[BoardView]) -> None:
        self.views = list(views)
        self.flange = np.stack([view.flange for view in views])
        self._corner_view = np.concatenate([np.full(len(view.corners), i) for i, view in enumerate(views)])
        # View of each residual: of corners, two a corner, and of the stripe.
        self.corner_view = np.repeat(self._corner_view, 2)
        self.stripe_view = np.concatenate([np.full(len(view.stripe), i) for i, view in enumerate(views)])
        self._corners = np.concatenate([view.corners for view in views])
        self._corner_pixels = np.concatenate([view.corner_pixels for view in views])
        self._stripe = np.concatenate([view.stripe for view in views])
        self._across = np.concatenate([view.across for view in views])
        self._along = np.concatenate([_along(view) for view in views])

    def residuals(self, rig: Rig, errors: Array) -> tuple[Array, Array]:
        """Residuals of corners (2 c,) and of the stripe (s,), px, by a rig and the errors (n, 8) of the views."""
        boards = rig.camera_from_board(self.flange) @ displaced(1e-3 * errors[:, :6])
        in_camera = pose.transform_each(boards[self._corner_view], self._corners)
        corners = rig.project(in_camera) - self._corner_pixels
        own = errors[self.stripe_view, 6:]
        return corners.ravel(), self._stripe_residuals(rig, boards) - own[:, 0] - own[:, 1] * self._along

    def derivatives(self, rig: Rig, errors: Array) -> tuple[Array, Array]:
        """Derivatives of the residuals (c + s, 22) by the unknowns, and (c + s, 8) by the errors of their own view."""

        def at(x: Array, shift: Array) -> Array:
            return np.concatenate(self.residuals(rig.moved(x), errors + shift))

        none, still = np.zeros(COUNT), np.zeros(ERRORS)
        by_rig = [(at(_STEP * e, still) - at(-_STEP * e, still)) / (2 * _STEP) for e in np.eye(COUNT)]
        by_error = [(at(none, _STEP * e) - at(none, -_STEP * e)) / (2 * _STEP) for e in np.eye(ERRORS)]
        return np.stack(by_rig, 1), np.stack(by_error, 1)

    def _stripe_residuals(self, rig: Rig, boards: Array) -> Array:
        """Distances (s,) of the stripe in the image from where the sheet meets the board, px, to first order."""
        planes = boards[self.stripe_view]
        distance = self._from_sheet(rig, self._stripe, planes)
        beside = self._from_sheet(rig, self._stripe + self._across, planes)
        return np.asarray(distance / (beside - distance))

    @staticmethod
    def _from_sheet(rig: Rig, pixels: Array, planes: Array) -> Array:
        points = met(rig.rays(pixels), planes)
        return np.asarray((points - rig.sheet[:3, 3]) @ rig.sheet[:3, 2])


@dataclass(frozen=True)
class DescribedSensor:
    """A sensor's description, or why there is none, with the pose (4, 4) of its frame in the camera as recorded.

    `quarter_turns` counter-clockwise (``numpy.rot90``) turn recorded images into those of the described camera, whose
    rows grow with the range.
    """

    sensor: SensorDescription | None
    camera_from_sensor: Array
    quarter_turns: int
    problem: str = ""


def describe(rig: Rig, size: tuple[int, int], stripe: Array, start: SensorDescription) -> DescribedSensor:
    """The description of a rig.

    The sensor's origin is the foot of the camera's centre on the sheet; Z is the direction of the camera's axis in it.

    Parameters
    ----------
    size
        Width and height of recorded images, px.
    stripe
        (n, 3) points on the sheet in the camera, for the range.
    start
        Whose other values are kept.
    """
    normal = rig.sheet[:3, 2]
    foot = normal * (normal @ rig.sheet[:3, 3])
    z = np.array([0.0, 0.0, 1.0]) - normal * normal[2]
    z /= np.linalg.norm(z)
    x = -foot / np.linalg.norm(foot)  # the camera is at X = +baseline
    camera_from_sensor = pose.from_rotation(np.column_stack([x, np.cross(z, x), z]), foot)
    sensor_from_camera = pose.inverse(camera_from_sensor)
    # In the description the rows of the image are along (cos tilt, 0, sin tilt), its columns along -Y.
    tilt = float(np.arctan2(-sensor_from_camera[0, 2], sensor_from_camera[2, 2]))
    upright = np.array([[0.0, np.cos(tilt), -np.sin(tilt)], [-1.0, 0.0, 0.0], [0.0, np.sin(tilt), np.cos(tilt)]])
    turn = (upright.T @ sensor_from_camera[:3, :3])[:2, :2]
    angle = float(np.arctan2(turn[1, 0], turn[0, 0]))
    quarters = -round(angle / (np.pi / 2))
    distance = 1e3 * (sensor_from_camera @ np.c_[stripe, np.ones(len(stripe))].T)[2]
    low, high = np.quantile(distance, [0.0, 1.0])
    room = _MARGIN * (high - low)
    width, height = size
    cx, cy = rig.intrinsics[1:3]
    k1, k2, p1, p2 = rig.intrinsics[3:7]
    # A quarter turn counter-clockwise: column = y, row = width - 1 - x.
    for _ in range(quarters % 4):
        cx, cy, width, height, p1, p2 = cy, width - 1 - cx, height, width, -p2, p1
    camera = start.camera[0].model_dump() | {
        "side": 1,
        "baseline_mm": 1e3 * float(np.linalg.norm(foot)),
        "height_mm": 0.0,
        "offset_y_mm": 0.0,
        "tilt_deg": float(np.degrees(tilt)),
        "pan_deg": 0.0,
        "roll_deg": float(np.degrees(angle + quarters * np.pi / 2)),
        "half_angle_deg": float(np.degrees(np.arctan(height / (2 * rig.intrinsics[0])))),
        "width_px": width,
        "height_px": height,
        "cx_px": float(cx),
        "cy_px": float(cy),
        "region_columns_px": None,
        "region_rows_px": None,
        "distortion": [float(k1), float(k2), float(p1), float(p2), 0.0],
        "scheimpflug_x_deg": 0.0,
        "scheimpflug_y_deg": 0.0,
        "focus_mm": None,
    }
    data = start.model_dump()
    data["camera"] = [camera]
    data["range"] = {"near_mm": max(float(low - room), 1e-3), "far_mm": float(high + room)}
    data["laser"] |= {"straightness_mrad": [], "offset_x_mm": 0.0, "turn_y_deg": 0.0, "turn_z_deg": 0.0}
    data["detector"] |= {"bit_depth": 8, "binning": 1}
    try:
        return DescribedSensor(SensorDescription.model_validate(data), camera_from_sensor, quarters % 4)
    except (ValueError, DescriptionError) as error:
        reason = " ".join(str(error).split())
        return DescribedSensor(None, camera_from_sensor, quarters % 4, reason)


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
