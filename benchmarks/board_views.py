"""Views of a board with the laser stripe beside it by a camera on a robot, of known geometry; by OpenCV and NumPy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.track import Array

COLUMNS, ROWS, SQUARE = 9, 6, 0.008  # inner corners, and the side of a square, m
SIZE = (1024, 768)  # px
VIEWS = 12
CORNER_PX, STRIPE_PX = 0.08, 0.15  # standard deviations
ROBOT_M, ROBOT_RAD = 0.05e-3, 0.3e-3  # of the flange from view to view
_STRIPE_POINTS = 40
_RANGE = (0.22, 0.28)  # m, of the board from the laser along the sheet
POSE = tuple(f"r{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3))


@dataclass(frozen=True)
class Truth:
    """Camera matrix (3, 3), distortion (5,), and poses (4, 4): flange from camera, base from board, camera from sheet.

    The sheet is the plane X = 0 of its frame; the laser shines along Z.
    """

    matrix: Array
    distortion: Array
    flange_from_camera: Array
    base_from_board: Array
    camera_from_sheet: Array


def pose_of(rotation: Rotation, position: Any) -> Array:
    """Pose (4, 4)."""
    made = np.eye(4)
    made[:3, :3], made[:3, 3] = rotation.as_matrix(), position
    return made


def project(truth: Truth, points: Array) -> Array:
    """Pixels (n, 2) of points (n, 3) in the camera."""
    pixels, _ = cv2.projectPoints(points.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), truth.matrix, truth.distortion)
    return np.asarray(pixels.reshape(-1, 2))


def moved(frame: Array, points: Array) -> Array:
    """Points (n, 3) by a pose (4, 4)."""
    return points @ frame[:3, :3].T + frame[:3, 3]


def draw_truth(rng: np.random.Generator) -> Truth:
    """A camera about 150 mm beside the sheet that looks past it, and random poses on the robot and of the board."""
    focal = 2400.0 * rng.uniform(0.95, 1.05)
    middle = (np.array(SIZE) - 1) / 2 + rng.uniform(-15, 15, 2)
    position = np.array([0.15, 0.0, 0.0]) + rng.uniform(-0.01, 0.01, 3)
    forward = np.array([-0.03, 0.0, 0.25]) - position
    forward /= np.linalg.norm(forward)
    down = np.cross(forward, [forward[2], 0.0, -forward[0]])
    axes = Rotation.from_matrix(np.column_stack([np.cross(down, forward), down, forward]))
    sheet_from_camera = pose_of(axes * Rotation.from_rotvec(rng.normal(0.0, 0.01, 3)), position)
    return Truth(
        np.array([[focal, 0.0, middle[0]], [0.0, focal, middle[1]], [0.0, 0.0, 1.0]]),
        np.array([rng.uniform(-0.15, 0.15), rng.uniform(-0.1, 0.1), *rng.normal(0.0, 5e-4, 2), 0.0]),
        pose_of(Rotation.from_rotvec(rng.uniform(-1.0, 1.0, 3)), rng.uniform(-0.15, 0.15, 3)),
        pose_of(Rotation.from_rotvec(rng.uniform(-1.0, 1.0, 3)), rng.uniform([0.4, -0.2, 0.0], [0.8, 0.2, 0.4])),
        np.linalg.inv(sheet_from_camera),
    )


def board_points() -> Array:
    """Corners (COLUMNS * ROWS, 3) on the board, about its middle, m."""
    x, y = np.meshgrid(np.arange(COLUMNS) - (COLUMNS - 1) / 2, np.arange(ROWS) - (ROWS - 1) / 2)
    return SQUARE * np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])


def _board_pose(rng: np.random.Generator, truth: Truth) -> Array:
    """Pose of the board in the camera, such that the image holds all corners."""
    while True:
        facing = Rotation.from_euler("x", np.pi) * Rotation.from_euler("z", rng.uniform(-np.pi, np.pi))
        tilt = Rotation.from_rotvec(rng.uniform(-0.5, 0.5, 3) * [1, 1, 0])
        at = [rng.uniform(-0.065, -0.045), rng.uniform(-0.01, 0.01), rng.uniform(*_RANGE)]
        camera_from_board = truth.camera_from_sheet @ pose_of(tilt * facing, at)
        pixels = project(truth, moved(camera_from_board, board_points()))
        if (pixels > 5).all() and (pixels < np.array(SIZE) - 6).all():
            return camera_from_board


def _stripe(truth: Truth, camera_from_board: Array) -> tuple[Array, Array]:
    """Pixels (n, 2) of points where the sheet meets the plane of the board, and unit vectors (n, 2) across them."""
    sheet_from_board = np.linalg.inv(truth.camera_from_sheet) @ camera_from_board
    normal, origin = sheet_from_board[:3, 2], sheet_from_board[:3, 3]
    y = np.linspace(-0.035, 0.035, _STRIPE_POINTS)
    z = origin[2] + (normal[0] * origin[0] - normal[1] * (y - origin[1])) / normal[2]
    pixels = project(truth, moved(truth.camera_from_sheet, np.column_stack([np.zeros_like(y), y, z])))
    along = np.gradient(pixels, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    return pixels, np.column_stack([-along[:, 1], along[:, 0]])


def observe(rng: np.random.Generator, truth: Truth) -> dict[str, Any]:
    """Inputs: flange poses, corners and stripe points of all views, with noise."""
    flange, corners, stripe = [], [], []
    points = board_points()
    for view in range(VIEWS):
        camera_from_board = _board_pose(rng, truth)
        error = pose_of(Rotation.from_rotvec(ROBOT_RAD * rng.normal(size=3)), ROBOT_M * rng.normal(size=3))
        true_flange = truth.base_from_board @ np.linalg.inv(truth.flange_from_camera @ camera_from_board)
        measured = true_flange @ error
        flange.append([view, *measured[:3, :3].ravel(), *1e3 * measured[:3, 3]])
        pixels = project(truth, moved(camera_from_board, points)) + CORNER_PX * rng.normal(size=(len(points), 2))
        corners.append(np.column_stack([np.full(len(points), view), pixels, 1e3 * points[:, :2]]))
        line, across = _stripe(truth, camera_from_board)
        line = line + STRIPE_PX * rng.normal(size=(len(line), 1)) * across
        seen = ((line > 0) & (line < np.array(SIZE) - 1)).all(1)
        stripe.append(np.column_stack([np.full(seen.sum(), view), line[seen]]))
    pixel = ("view", "column_px", "row_px")
    return {
        "flange": _table(("view", *POSE, "x_mm", "y_mm", "z_mm"), np.array(flange)),
        "corners": _table((*pixel, "x_mm", "y_mm"), np.concatenate(corners)),
        "stripe": _table(pixel, np.concatenate(stripe)),
        "width_px": SIZE[0],
        "height_px": SIZE[1],
    }


def _table(names: tuple[str, ...], rows: Array) -> dict[str, Array]:
    return {name: np.asarray(rows[:, i], float) for i, name in enumerate(names)}


@dataclass(frozen=True)
class View:
    """Measured flange (4, 4), corners (n, 3) on the board, m, and (n, 2) in the image, stripe (m, 2), px."""

    flange: Array
    points: Array
    pixels: Array
    stripe: Array


def read_views(case: dict[str, Any]) -> list[View]:
    """The tables of a case as views, for entries in Python."""
    flange, corners, stripe = case["flange"], case["corners"], case["stripe"]
    views = []
    for row, view in enumerate(flange["view"]):
        measured = np.eye(4)
        measured[:3, :3] = np.reshape([flange[name][row] for name in POSE], (3, 3))
        measured[:3, 3] = [1e-3 * flange[name][row] for name in ("x_mm", "y_mm", "z_mm")]
        own, line = corners["view"] == view, stripe["view"] == view
        x, y = (1e-3 * corners[name][own] for name in ("x_mm", "y_mm"))
        views.append(
            View(
                measured,
                np.column_stack([x, y, np.zeros_like(x)]),
                np.column_stack([corners["column_px"][own], corners["row_px"][own]]),
                np.column_stack([stripe["column_px"][line], stripe["row_px"][line]]),
            )
        )
    return views
