"""Views of a chessboard with the stripe beside it, from image files and a table of flange poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.arrays import Array
from scancell.calibration.board.solve import BoardView
from scancell.calibration.measured_table import MeasuredTable
from scancell.calibration.pose_files import read_flange
from scancell.config.sensor import SensorDescription
from scancell.errors import CalibrationError, DescriptionError, ImageError
from scancell.files import require_file
from scancell.geometry.orientation import StatedPoses
from scancell.output.image_files import SUFFIXES
from scancell.progress import Progress
from scancell.scanning.world import make_sensor

Grey = NDArray[np.uint8]

TABLES = ("poses.csv", "poses.parquet", "poses.yaml", "poses.yml")
_BINNINGS = (1, 2, 4)
_MARGIN = 6  # squares beyond the corners that are still the board's plane
_MOST_STRIPE = 120  # points of a view
_LEAST_STRIPE = 20
_OFF_LINE = 5.0  # px, or five times the scatter
_AMPLITUDE = 0.4  # of the full scale
_LARGEST_WINDOW = 15  # px
# Saturated, wide stripes with a halo: what is no stripe shows in the fit of a line, and in the adjustment.
_EXTRACTION = {
    "extraction.peak": "brightest",
    "extraction.detector": "gaussian",
    "extraction.max_sigma_px": 8.0,
    "extraction.max_asymmetry": 0.5,
    "extraction.max_residual": 1.0,
    "extraction.max_row_jump_px": 3.0,
    "extraction.max_amplitude_jump": 1.0,
    "extraction.max_width_jump": 1.0,
}


@dataclass(frozen=True)
class Board:
    """A chessboard: inner corners in a row and in a column, and the side of a square, m."""

    columns: int
    rows: int
    square: float

    @classmethod
    def parse(cls, text: str) -> Board:
        """A board from ``7x6x10``: inner corners in a row and in a column, and the side of a square in mm.

        Raises `DescriptionError` if the text is no such board.
        """
        expected = "columns x rows of inner corners x side of a square in mm, for example 7x6x10"
        try:
            columns, rows, square = text.lower().replace(" ", "").split("x")
            board = cls(int(columns), int(rows), 1e-3 * float(square))
        except ValueError:
            raise DescriptionError(key="board", value=text, expected=expected) from None
        if min(board.columns, board.rows) < 3 or not 0 < board.square < 10:
            raise DescriptionError(key="board", value=text, expected=expected)
        if (board.columns + board.rows) % 2 == 0:
            raise DescriptionError(
                "looks the same upside down", key="board", value=text, expected="an odd and an even number of corners"
            )
        return board

    @property
    def corners(self) -> Array:
        """Corners (n, 3) in the board's frame, whose origin is their middle, row by row, m."""
        row, column = np.divmod(np.arange(self.columns * self.rows), self.columns)
        middle = [(self.columns - 1) / 2, (self.rows - 1) / 2, 0.0]
        return self.square * (np.column_stack([column, row, np.zeros(len(row))]) - middle)

    def find(self, image: Grey) -> Array | None:
        """Pixels (n, 2) of the corners; None if they are not all found.

        The square between the first four corners is dark, which distinguishes the two ends of the board.
        """
        flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
        found, pixels = cv2.findChessboardCorners(image, (self.columns, self.rows), flags=flags)
        if not found:
            return None
        spacing = np.linalg.norm(np.diff(pixels.reshape(self.rows, self.columns, 2), axis=1), axis=2).min()
        half = int(np.clip(0.2 * spacing, 3, _LARGEST_WINDOW))
        stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)
        refined = cv2.cornerSubPix(image, pixels, (half, half), (-1, -1), stop).reshape(-1, 2).astype(float)
        return refined if self._starts_dark(image, refined) else refined[::-1]

    def _starts_dark(self, image: Grey, pixels: Array) -> bool:
        grid = pixels.reshape(self.rows, self.columns, 2)
        middles = (grid[1:, 1:] + grid[:-1, :-1]) / 2
        column, row = np.rint(middles).astype(int).reshape(-1, 2).T
        grey = image[row, column].reshape(self.rows - 1, self.columns - 1).astype(float)
        dark = (np.add.outer(np.arange(self.rows - 1), np.arange(self.columns - 1)) % 2) == 0
        return bool(grey[dark].mean() < grey[~dark].mean())


@dataclass(frozen=True)
class BoardViews:
    """Views of a folder, the flange poses as stated, and what was left out, as sentences."""

    views: tuple[BoardView, ...]
    stated: StatedPoses
    size: tuple[int, int]
    poses_file: Path
    files: tuple[Path, ...]
    warnings: tuple[str, ...] = ()


def read_views(
    folder: Path, board: Board, sensor: SensorDescription, convention: str | None, threads: int, progress: Progress
) -> BoardViews:
    """The images of a folder that its table of poses lists (docs/calibration.md).

    Raises `DescriptionError` or `ImageError` naming file, key, value and what was expected.
    """
    table = pose_table(folder)
    stated, names = read_flange(table, convention), table.words("image")
    flange = stated.matrices()
    files = [folder / name for name in names]
    table.require(np.array([file.is_file() for file in files]), "image", f"an image in {folder}")
    _require_all(folder, files, table)
    progress.stage("finding the board and the stripe", len(files), "images")
    views, rows, warnings = [], [], []
    size: tuple[int, int] | None = None
    for row, file in enumerate(files):
        image = _read(file, size)
        size = (image.shape[1], image.shape[0])
        progress.advance(1)
        pixels = board.find(image)
        if pixels is None:
            warnings.append(f"{file.name}: the {board.columns} x {board.rows} corners of the board were not found")
            continue
        stripe, across = find_stripe(image, board, pixels, sensor, threads)
        if not len(stripe):
            warnings.append(f"{file.name}: no stripe was found on the plane of the board")
        views.append(BoardView(file.name, flange[row], board.corners, pixels, stripe, across))
        rows.append(row)
    if size is None or not views:
        raise CalibrationError(
            f"no image shows all {board.columns} x {board.rows} inner corners of the board", file=folder
        )
    chosen = np.array(rows, np.intp)
    return BoardViews(tuple(views), stated.rows(chosen), size, table.path, tuple(files), tuple(warnings))


def pose_table(folder: Path) -> MeasuredTable:
    """The table of poses of a folder of images.

    Raises `DescriptionError` if there is no such folder, or no table in it.
    """
    if not folder.is_dir():
        raise DescriptionError("no such folder", file=folder)
    for name in TABLES:
        if (folder / name).is_file():
            return MeasuredTable(folder / name)
    raise DescriptionError(
        "holds no table of flange poses", file=folder, expected=f"{TABLES[0]} with the columns image, flange_x_mm, …"
    )


def _require_all(folder: Path, files: Sequence[Path], table: MeasuredTable) -> None:
    listed = {file.name for file in files}
    if len(listed) < len(files):
        raise DescriptionError("an image is listed twice", file=table.path, key="column 'image'")
    others = sorted(file.name for file in folder.iterdir() if file.suffix.lower() in SUFFIXES)
    missing = [name for name in others if name not in listed]
    if missing:
        raise DescriptionError(
            f"holds no flange pose of {len(missing)} of the {len(others)} images of its folder",
            file=table.path,
            key="column 'image'",
            expected=f"a row with {missing[0]}, or no such image",
        )


def _read(file: Path, size: tuple[int, int] | None) -> Grey:
    require_file(file, ImageError)
    image = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise ImageError("cannot be read as an image", file=file)
    found = (image.shape[1], image.shape[0])
    if size is not None and found != size:
        raise ImageError(
            f"is {found[0]} x {found[1]} pixels", file=file, expected=f"{size[0]} x {size[1]}, as the images before"
        )
    return np.asarray(image, np.uint8)


def find_stripe(
    image: Grey, board: Board, pixels: Array, sensor: SensorDescription, threads: int = 1
) -> tuple[Array, Array]:
    """Points (m, 2) of the stripe on the plane of the board, and unit vectors (m, 2) across it.

    The stripe may run along the rows or the columns of the image; wide ones are found in an image of fewer pixels.
    """
    found = [_peaks(image, turned, binning, sensor, threads) for turned in (False, True) for binning in _BINNINGS]
    on_board = [_on_line(_on_board(points, board, pixels)) for points in found]
    weights = [len(points) * binning for points, binning in zip(on_board, 2 * _BINNINGS, strict=True)]
    best = on_board[int(np.argmax(weights))]
    if len(best) < _LEAST_STRIPE:
        return np.zeros((0, 2)), np.zeros((0, 2))
    best = best[:: -(-len(best) // _MOST_STRIPE)]
    direction = np.linalg.svd(best - best.mean(0), full_matrices=False)[2][0]
    across = np.array([-direction[1], direction[0]])
    return best, np.broadcast_to(across, best.shape).copy()


def _peaks(image: Grey, turned: bool, binning: int, sensor: SensorDescription, threads: int) -> Array:
    """Pixels (n, 2) of the stripe in the image, one in each column, or with `turned` in each row."""
    seen = np.rot90(image) if turned else image
    height, width = (side // binning * binning for side in seen.shape)
    small = cv2.resize(
        np.ascontiguousarray(seen[:height, :width]), None, fx=1 / binning, fy=1 / binning, interpolation=cv2.INTER_AREA
    )
    size = {"width_px": small.shape[1], "height_px": small.shape[0], "cx_px": None, "cy_px": None}
    camera = sensor.camera[0].model_copy(update={**size, "region_columns_px": None, "region_rows_px": None})
    changes = {
        **_EXTRACTION,
        "extraction.min_amplitude_dn": _AMPLITUDE * 255,
        "detector.bit_depth": 8,
        "detector.binning": 1,
    }
    extracting = sensor.replace(changes).model_copy(update={"camera": (camera,)})
    peaks = sensor_rt.extract(small[None, None].astype(np.uint16), make_sensor(extracting, 0), threads)
    good = (np.asarray(peaks.flags) & sensor_rt.PEAK_REJECTED) == 0
    column, row = (
        np.asarray(values, float)[good] * binning + (binning - 1) / 2 for values in (peaks.column, peaks.row)
    )
    return np.column_stack([image.shape[1] - 1 - row, column] if turned else [column, row])


def _on_board(points: Array, board: Board, pixels: Array) -> Array:
    """Points near the corners on the plane of the board, by its homography."""
    if not len(points):
        return points
    plane_from_image, _ = cv2.findHomography(pixels, board.corners[:, :2] / board.square)
    plane = cv2.perspectiveTransform(points[:, None], plane_from_image)[:, 0]
    limit = np.array([board.columns - 1, board.rows - 1]) / 2 + _MARGIN
    return np.asarray(points[(np.abs(plane) < limit).all(1)])


def _on_line(points: Array) -> Array:
    """Points near the line that most of them lie on."""
    if len(points) < _LEAST_STRIPE:
        return points[:0]
    from scipy.stats import siegelslopes  # noqa: PLC0415  (half a second)

    # Repeated medians: the stripe may go on beside the board's plane, in a line of its own.
    along, across = ((points - points.mean(0)) @ np.linalg.svd(points - points.mean(0), full_matrices=False)[2].T).T
    line = siegelslopes(across, along)
    away = np.abs(across - (line.slope * along + line.intercept))
    kept = away < max(_OFF_LINE, 5.0 * float(np.median(away)))
    return np.asarray(points[kept] if kept.sum() >= _LEAST_STRIPE else points[:0])
