"""`calibrate_from_images`: a camera with a laser line on a robot, from a folder of images of a board."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from scancell.calibration.board.report import BoardCalibrationReport
from scancell.calibration.board.solve import LEAST_VIEWS, calibrate_cameras, hand_eye, solve, start_rig
from scancell.calibration.board.views import Board, BoardViews, read_views
from scancell.config.loading import Setup
from scancell.errors import CalibrationError
from scancell.geometry.pose_conventions import better_reading
from scancell.progress import Progress

Array = NDArray[np.float64]

_AGREED = 8e-3  # m: median distance of the boards of all images up to which the poses are read rightly
_WRONG = 8e-3  # m: and eight times the median, from which a pose is wrong
_MOST_WRONG = 1 / 3  # of the images
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
        better = better_reading(found.stated, misfit)
        if better is not None:
            reading, fits, own = better
            raise CalibrationError(
                f"the flange poses do not fit the images as {found.stated.reading.text()}: the median distance of the"
                f" board is {1e3 * own:.3g} mm; they fit to {1e3 * fits:.3g} mm as {reading.text()}",
                file=found.poses_file,
            )
    away = hand_eye(flange, boards).away
    wrong = np.flatnonzero(away > max(_WRONG, 8.0 * float(np.median(away))))
    if len(wrong) and len(wrong) < _MOST_WRONG * len(away):
        named = ", ".join(f"{found.views[i].name} by {1e3 * away[i]:.1f} mm" for i in wrong)
        raise CalibrationError(
            f"{len(wrong)} of {len(away)} images disagree with the others, whose boards agree to"
            f" {1e3 * float(np.median(away)):.3f} mm (median): {named}; correct their flange poses, or leave them out",
            file=found.poses_file,
        )
