"""Calibration by a board with the stripe on it: views, unknowns, and the residuals that they explain.

The camera is that of the image as recorded: x grows with the column, y with the row, z forwards. Unknown are its
intrinsics, the plane of the laser, the pose of the camera on the flange, the pose of the board in the robot's base; and
of every view the displacement of the board from where the flange's pose has it, and offset and tilt of the stripe in
the image. Displacements hold errors of the robot, and those that all corners share: a turn of a small board by 6 mrad
moves its corners in the image by a tenth of a pixel. Points of a stripe share errors of the surface on which it lies.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from scancell.arrays import Array
from scancell.config.sensor import SensorDescription
from scancell.errors import DescriptionError
from scancell.geometry import pose

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
    """Where rays (n, 3) from the origin meet the x-y plane of frames (n, 4, 4) or (4, 4)."""
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
