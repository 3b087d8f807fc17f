"""`calibrate_from_images`: a camera with a laser line on a robot, from a folder of images of a board."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from scancell.calibration.board.report import BoardCalibrationReport
from scancell.calibration.board.solve import LEAST_VIEWS, calibrate_cameras, hand_eye, solve, start_rig
from scancell.calibration.board.views import Board, BoardViews, read_views
from scancell.calibration.flange_poses import refuse_misread, refuse_wrong
from scancell.config.loading import Setup
from scancell.errors import CalibrationError
from scancell.progress import Progress

Array = NDArray[np.float64]

_AGREED = 8e-3  # m: median distance of the boards of all images up to which the poses are read rightly
_WRONG = 8e-3  # m: and eight times the median, from which a pose is wrong
_LEAST_WITH_STRIPE = 3


def calibrate_board(
    setup: Setup, folder: Path, board: Board, convention: str | None, threads: int, progress: Progress
) -> BoardCalibrationReport:
    """Calibrate from the images of a folder.

    Raises `ScancellError` naming what is wrong and what was expected; `CalibrationError` where the images do not
    determine the unknowns, or their flange poses disagree with them.
    """
    found = read_views(folder, board, setup.sensor, convention, threads, progress)
    if len(found.views) < LEAST_VIEWS:
        raise CalibrationError(
            f"{len(found.views)} images show the board", file=folder, expected=f"{LEAST_VIEWS} or more"
        )
    with_stripe = sum(len(view.stripe) > 0 for view in found.views)
    if with_stripe < _LEAST_WITH_STRIPE:
        raise CalibrationError(
            f"{with_stripe} images show the stripe on the board's plane", file=folder, expected="3 or more"
        )
    progress.stage("solving", 1, "solution")
    _check_flange(found)
    result = solve(found.views, start_rig(found.views, found.size))
    progress.advance(1)
    run = {"what": "sensor", "folder": str(folder), "board": f"{board.columns}x{board.rows}x{1e3 * board.square:g}"}
    run["convention"] = found.stated.reading.convention
    return BoardCalibrationReport(
        result, found.size, setup, (found.poses_file, *found.files), run, found_warnings=found.warnings
    )


def _check_flange(found: BoardViews) -> None:
    """Raise `CalibrationError` if flange poses disagree with the images, naming the convention that fits, or images."""
    boards = calibrate_cameras(found.views, found.size)[1]

    def misfit(flange: Array) -> float:
        try:
            return float(np.median(hand_eye(flange, boards).away))
        except (CalibrationError, cv2.error, np.linalg.LinAlgError):
            return float("inf")

    flange = np.stack([view.flange for view in found.views])
    if misfit(flange) > _AGREED:
        refuse_misread(found.stated, misfit, "the images", "the board", found.poses_file)
    away = hand_eye(flange, boards).away
    limit = max(_WRONG, 8.0 * float(np.median(away)))
    refuse_wrong(away, limit, lambda i: found.views[i].name, ("images", "boards"), found.poses_file)
