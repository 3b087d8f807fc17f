"""Report of a calibration by a board: values with intervals, errors by image, the described sensor, files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from scancell.arguments import Threads, checked_arguments
from scancell.arrays import Array
from scancell.calibration.board.solve import (
    COUNT,
    LEAST_VIEWS,
    VALUES,
    BoardCalibration,
    DescribedSensor,
    calibrate_cameras,
    describe,
    hand_eye,
    solve,
    start_rig,
)
from scancell.calibration.board.views import Board, BoardViews, read_views
from scancell.calibration.pose_files import refuse_misread, refuse_wrong
from scancell.calibration.report import SavedCalibration
from scancell.config.choices import FlangeConvention
from scancell.config.files import Assignments, assignments
from scancell.config.loading import Setup, load_setup
from scancell.config.sensor import SensorDescription
from scancell.errors import CalibrationError
from scancell.geometry import pose
from scancell.output.run_folder import RunFolder
from scancell.progress import Progress, ProgressCallback, as_progress

_STEP = 1e-4

_AGREED = 8e-3  # m: median distance of the boards of all images up to which the poses are read rightly
_WRONG = 8e-3  # m: and eight times the median, from which a pose is wrong
_LEAST_WITH_STRIPE = 3


@dataclass(frozen=True)
class BoardRow:
    """A calibrated value, in the unit that its name states, and the half width of its interval."""

    name: str
    value: float
    half_width: float


@dataclass(frozen=True, eq=False, repr=False)
class BoardCalibrationReport(SavedCalibration):
    """A camera and its laser on a robot, calibrated by images of a board with the stripe on it.

    `save` writes ``calibration.json`` and, where the description of a sensor can state it, ``calibrated_sensor.toml``.

    Attributes
    ----------
    result
        The solution.
    size
        Width and height of the images, px.
    setup
        With the sensor's description whose other values are kept.
    inputs, run
        Files and settings for the manifest.
    found_warnings
        What was left out of the images.
    probability
        Probability of the intervals.

    Examples
    --------
    >>> try:
    ...     report = scancell.calibrate_from_images("recorded", "7x6x10")
    ...     print(report.flange_from_sensor)
    ... except scancell.DescriptionError as error:
    ...     print(error)
    recorded: no such folder
    """

    result: BoardCalibration
    size: tuple[int, int]
    setup: Setup
    inputs: Sequence[Path]
    run: Mapping[str, Any]
    found_warnings: tuple[str, ...] = ()
    probability: float = 0.95

    @cached_property
    def _described(self) -> DescribedSensor:
        rig, views = self.result.rig, self.result.problem.views
        stripe = rig.on_sheet(np.concatenate([view.stripe for view in views]))
        return describe(rig, self.size, stripe, self.setup.sensor)

    @property
    def sensor(self) -> SensorDescription | None:
        """The described sensor; None if a description cannot state it, see `warnings`."""
        return self._described.sensor

    @property
    def quarter_turns(self) -> int:
        """Quarter turns (``numpy.rot90``) from a recorded image to one of the described camera."""
        return self._described.quarter_turns

    @property
    def flange_from_camera(self) -> Array:
        """Pose (4, 4) of the camera on the flange, m: x along the columns of recorded images, y along their rows."""
        return self.result.rig.flange_from_camera

    @property
    def flange_from_sensor(self) -> Array:
        """Pose (4, 4) of the described sensor on the flange, m."""
        return np.asarray(self.flange_from_camera @ self._described.camera_from_sensor)

    @property
    def base_from_board(self) -> Array:
        """Pose (4, 4) of the board in the robot's base, m."""
        return self.result.rig.base_from_board

    @cached_property
    def _by_unknown(self) -> Array:
        rig = self.result.rig
        steps = [(rig.moved(_STEP * e).values - rig.moved(-_STEP * e).values) / (2 * _STEP) for e in np.eye(COUNT)]
        return np.stack(steps, 1)

    @cached_property
    def covariance(self) -> Array:
        """(23, 23) of the values, in the order of `rows`."""
        derivative = self._by_unknown
        return np.asarray(derivative @ self.result.estimate.covariance @ derivative.T)

    @property
    def rows(self) -> list[BoardRow]:
        """The calibrated values."""
        half = self.result.estimate.half_widths(self._by_unknown, self.probability)
        return [
            BoardRow(name, float(value), float(width))
            for name, value, width in zip(VALUES, self.result.rig.values, half, strict=True)
        ]

    @property
    def warnings(self) -> list[str]:
        """Warnings about the result."""
        found = list(self.found_warnings)
        if self._described.sensor is None:
            found.append(f"the description of a sensor cannot state this one: {self._described.problem}")
        return found

    @property
    def figures(self) -> dict[str, Any]:
        """Plain figures, in the units that their names state."""
        result = self.result
        corner, stripe, position, orientation, offset = result.sizes.tolist()
        return {
            "values": [asdict(row) for row in self.rows],
            "probability": self.probability,
            "covariance": self.covariance.tolist(),
            "degrees_of_freedom": result.estimate.of_values(self._by_unknown)[1].tolist(),
            "images": len(result.problem.views),
            "stripe_points": len(result.stripe),
            "stripe_points_discarded": result.discarded,
            "standard_deviation_of_corners_px": corner,
            "standard_deviation_of_stripe_points_px": stripe,
            "standard_deviation_of_stripes_px": offset,
            "standard_deviation_of_positions_mm": position,
            "standard_deviation_of_orientations_deg": float(np.degrees(1e-3 * orientation)),
            "rms_of_stripe_to_board_mm": 1e3 * float(np.sqrt(np.mean(self._distances[0] ** 2))),
            "errors_of_images": [
                {
                    "image": view.name,
                    "position_mm": float(np.linalg.norm(error[:3])),
                    "orientation_deg": float(np.degrees(1e-3 * np.linalg.norm(error[3:6]))),
                }
                for view, error in zip(result.problem.views, result.errors, strict=True)
            ],
            "left_out": [
                {
                    "image": result.problem.views[i].name,
                    "displacement_mm": moved[:3].tolist(),
                    "half_width_mm": half[:3].tolist(),
                    "rotation_mrad": moved[3:].tolist(),
                    "half_width_mrad": half[3:].tolist(),
                }
                for i, moved, half in result.left_out.rows(self.probability)
            ],
            "flange_from_camera_m": self.flange_from_camera.tolist(),
            "flange_from_sensor_m": self.flange_from_sensor.tolist(),
            "base_from_board_m": self.base_from_board.tolist(),
            "quarter_turns": self.quarter_turns,
        }

    def summary(self) -> str:
        """The figures as lines of text."""
        figures = self.figures
        lines = [
            f"{figures['images']} images: corners {figures['standard_deviation_of_corners_px']:.3f} px,"
            f" board {figures['standard_deviation_of_positions_mm']:.3f} mm and"
            f" {figures['standard_deviation_of_orientations_deg']:.3f} deg from image to image,"
            f" stripe {figures['rms_of_stripe_to_board_mm']:.3f} mm RMS from the board",
            f"  {'value':26} {'estimate':>12}    {100 * self.probability:g} % interval",
        ]
        return "\n".join([*lines, *(f"  {row.name:26} {row.value:12.5f} +- {row.half_width:.5f}" for row in self.rows)])

    @property
    def _distances(self) -> tuple[Array, NDArray[np.intp]]:
        rig, problem = self.result.rig, self.result.problem
        stripe = rig.on_sheet(np.concatenate([view.stripe for view in problem.views]))
        boards = rig.camera_from_board(problem.flange)[problem.stripe_view]
        return pose.transform_each(pose.inverse(boards), stripe)[:, 2], problem.stripe_view

    def _write(self, folder: RunFolder, command_line: list[str]) -> None:
        super()._write(folder, command_line)
        if self.sensor is not None:
            self.sensor.to_toml(folder.path("calibrated_sensor.toml"))


@checked_arguments
def calibrate_from_images(
    folder: str | Path,
    board: str,
    *,
    sensor: str | Path | SensorDescription | None = None,
    settings: Assignments = (),
    convention: FlangeConvention | None = None,
    threads: Threads = 0,
    progress: Progress | ProgressCallback | None = None,
) -> BoardCalibrationReport:
    """Calibrate a camera with a laser line on a robot, from images of a chessboard with the stripe on it.

    Intrinsics, laser sheet, pose of the camera on the flange and pose of the board are found together. The other
    parameters are those of `Scanner` and `Scanner.scan`.

    Parameters
    ----------
    folder
        Images, and a table of the flange's poses with a row for each (docs/calibration_sensor.md).
    board
        Inner corners in a row and in a column of the chessboard, and the side of a square in mm: ``7x6x10``.
    sensor
        Description whose detector, laser and extraction are kept; the first camera is the one to calibrate.
    convention
        Convention of orientations whose columns do not state it.

    Raises
    ------
    ScancellError
        Naming what is wrong and what was expected; `CalibrationError` where the images do not determine the unknowns,
        or flange poses disagree with them.

    Examples
    --------
    >>> try:
    ...     scancell.calibrate_from_images("recorded", "7x7x10")
    ... except scancell.DescriptionError as error:
    ...     print(error.expected)
    an odd and an even number of corners
    """
    setup = load_setup(None, sensor, None, assignments(settings))
    folder, described, reporter = Path(folder), Board.parse(board), as_progress(progress)
    found = read_views(folder, described, setup.sensor, convention, threads, reporter)
    if len(found.views) < LEAST_VIEWS:
        raise CalibrationError(
            f"{len(found.views)} images show the board", file=folder, expected=f"{LEAST_VIEWS} or more"
        )
    with_stripe = sum(len(view.stripe) > 0 for view in found.views)
    if with_stripe < _LEAST_WITH_STRIPE:
        raise CalibrationError(
            f"{with_stripe} images show the stripe on the board's plane", file=folder, expected="3 or more"
        )
    reporter.stage("solving", 1, "solution")
    _check_flange(found)
    result = solve(found.views, start_rig(found.views, found.size))
    reporter.advance(1)
    run = {
        "what": "sensor",
        "folder": str(folder),
        "board": f"{described.columns}x{described.rows}x{1e3 * described.square:g}",
        "convention": found.stated.reading.convention,
    }
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
