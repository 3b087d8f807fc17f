"""Targets for the calibration of a sensor, and the poses at which it measures them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any, get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from scancell.arrays import Array
from scancell.calibration.measured_table import MeasuredTable, write_measured_table
from scancell.calibration.sensor.problem import PEAK_SPACING, Corners, SensorParameters, StripePeaks, TargetExposure
from scancell.config.choices import SensorTarget
from scancell.config.material import PRESETS, Material
from scancell.config.sensor import (
    CameraDescription,
    SensorDescription,
    focal_length_px,
    image_sensor_pixels,
    principal_point_px,
    read_out,
)
from scancell.errors import CalibrationError, DescriptionError
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh
from scancell.geometry.shapes import PlacedShape, Plane, ShapeGroup, Sphere
from scancell.nominal.parts import Body, Patch, load_artefact
from scancell.sensor import PEAK_FLAGS, PEAK_REJECTED

_BITS_OF_SQUARE = 8  # 6 of a marker with its border, and the margin around it
_BITS_OF_MARKER = 6
_CORNER_SIGMA = 0.05  # px: scatter of sub-pixel corners in well exposed images
_FEWEST = 8  # corners of a usable view of a camera
_WINDOW = 0.95  # of a cell: half the window of corner refinement
_LARGEST_SQUARE = 200.0  # px, for that window
_VIEWS = 3  # of a camera, for its intrinsics

_BALL_DIAMETER = 0.025  # m
_HEIGHTS = 5  # of a target over the measuring range
_MARGIN = 0.06  # share of the measuring range that is left out at both of its ends
_PRINT = Material(0.05)
_FACING_SENSOR = pose.from_euler_xyz((0.0, 0.0, 0.0), (np.pi, 0.0, 0.0))  # the target's z towards the sensor


@dataclass(frozen=True)
class CheckeredBoard:
    """ChArUco board of the dictionary 4X4_250: squares of `square` (m), every second one with a marker.

    Frame: the middle of the board, x to the right, y up and z out of the printed side.
    """

    columns: int = 12
    rows: int = 10
    square: float = 0.004

    @property
    def size(self) -> tuple[float, float]:
        """Width and height, m."""
        return self.columns * self.square, self.rows * self.square

    @property
    def surface(self) -> ShapeGroup:
        """The board's plane."""
        return ShapeGroup((PlacedShape("board", Plane(*self.size), np.eye(4)),), "checkered board")

    @property
    def white(self) -> NDArray[np.bool_]:
        """Pattern (8 rows, 8 columns) in cells of an eighth of a square, from the top left."""
        size = (self.columns * _BITS_OF_SQUARE, self.rows * _BITS_OF_SQUARE)
        return np.asarray(self._board.generateImage(size, marginSize=0, borderBits=1)) > 127

    def detect(self, images: NDArray[np.uint16], bit_depth: int, camera: Sequence[int] | None = None) -> Corners | None:
        """Corners in the images (cameras, height, width) of one view; None if no camera sees enough of them.

        Parameters
        ----------
        camera
            Numbers of the images' cameras; None: 0, 1, …
        """
        found: list[tuple[int, Array, Array]] = []
        for number, image in zip(range(len(images)) if camera is None else camera, images, strict=True):
            grey = (image.astype(np.float64) * (255.0 / (2**bit_depth - 1))).round().astype(np.uint8)
            pixels, ids, *_ = self._detector.detectBoard(grey)
            if ids is not None and len(ids) >= _FEWEST:
                refined = self._refined(image.astype(np.float32), pixels, ids.ravel())
                found.append((number, refined, self._corners[ids.ravel()]))
        if not found:
            return None
        return Corners(
            np.concatenate([np.full(len(pixels), number, np.int32) for number, pixels, _ in found]),
            np.concatenate([pixels for _, pixels, _ in found]),
            np.concatenate([points for *_, points in found]),
            _CORNER_SIGMA,
        )

    def _refined(self, image: NDArray[np.float32], pixels: NDArray[np.float32], ids: NDArray[np.int32]) -> Array:
        """Corners (n, 2) refined in the largest window that holds no part of a marker: one cell to each side."""
        apart = np.linalg.norm(pixels.reshape(-1, 1, 2) - pixels.reshape(1, -1, 2), axis=2)
        spacing = np.linalg.norm(self._corners[ids][:, None] - self._corners[ids], axis=2)
        cell = float(np.min(apart[np.isclose(spacing, self.square)], initial=_LARGEST_SQUARE)) / _BITS_OF_SQUARE
        half = max(int(_WINDOW * cell), 2)
        stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)
        return cv2.cornerSubPix(image, pixels.copy(), (half, half), (-1, -1), stop).reshape(-1, 2).astype(float)

    @cached_property
    def _board(self) -> Any:
        dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_250)
        marker = self.square * _BITS_OF_MARKER / _BITS_OF_SQUARE
        return cv2.aruco.CharucoBoard((self.columns, self.rows), self.square, marker, dictionary)

    @cached_property
    def _detector(self) -> Any:
        return cv2.aruco.CharucoDetector(self._board)

    @cached_property
    def _corners(self) -> Array:
        """Inner corners (n, 3) by their id; OpenCV counts from the top left with y down."""
        corners = np.asarray(self._board.getChessboardCorners(), float)
        width, height = self.size
        return np.column_stack([corners[:, 0] - width / 2, height / 2 - corners[:, 1], np.zeros(len(corners))])


def start_from_corners(
    sensor: SensorDescription, views: Sequence[TargetExposure]
) -> tuple[SensorDescription, tuple[TargetExposure, ...]]:
    """Start for the joint solution: cameras' fields of view, principal points and distortion, and poses of the views.

    By ``cv2.calibrateCamera`` (Zhang's method) for every camera with three views or more and no tilted image sensor;
    others keep their description. A view's pose is that by the first camera that sees it.

    Raises `CalibrationError` if a view has no corners, or its pose cannot be found.
    """
    for camera in range(len(sensor.camera)):
        sensor = _with_intrinsics(sensor, camera, views)
    placed = tuple(replace(view, sensor_from_target=_pose(sensor, view)) for view in views)
    return sensor, placed


def _with_intrinsics(sensor: SensorDescription, camera: int, views: Sequence[TargetExposure]) -> SensorDescription:
    one = sensor.camera[camera]
    pairs = [_seen(sensor, view, camera) for view in views]
    usable = [(points, pixels) for points, pixels in pairs if len(points) >= _FEWEST]
    if len(usable) < _VIEWS or one.scheimpflug_x_deg or one.scheimpflug_y_deg:
        return sensor
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_ASPECT_RATIO | cv2.CALIB_ZERO_TANGENT_DIST
    flags |= cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3
    points, pixels = ([pair[k].astype(np.float32) for pair in usable] for k in (0, 1))
    found = cv2.calibrateCamera(points, pixels, (one.width_px, one.height_px), *_intrinsics(one), flags=flags)
    matrix, distortion = (np.asarray(values, float) for values in found[1:3])
    key = f"camera[{camera + 1}]"
    return sensor.replace(
        {
            f"{key}.half_angle_deg": float(np.degrees(np.arctan(one.height_px / (2.0 * matrix[1, 1])))),
            f"{key}.cx_px": float(matrix[0, 2]),
            f"{key}.cy_px": float(matrix[1, 2]),
            f"{key}.distortion": [float(k) for k in np.ravel(distortion)[:5]],
        }
    )


def _pose(sensor: SensorDescription, view: TargetExposure) -> Array:
    """``sensor_from_target`` by the first camera with corners."""
    if view.corners is None:
        raise CalibrationError("checkered target: a view has no corners")
    camera = int(view.corners.camera[0])
    points, pixels = _seen(sensor, view, camera)
    matrix, distortion = _intrinsics(sensor.camera[camera])
    found, turn, offset = cv2.solvePnP(points, pixels, matrix, distortion, flags=cv2.SOLVEPNP_IPPE)
    if not found:
        raise CalibrationError("checkered target: the pose of a view cannot be found from its corners")
    camera_from_target = pose.from_rotation(pose.exp_rotation(turn.ravel()), offset.ravel())
    native = SensorParameters(sensor, ()).sensor(np.zeros(0))
    return np.asarray(native.cameras[camera].sensor_from_camera @ camera_from_target)


def _seen(sensor: SensorDescription, view: TargetExposure, camera: int) -> tuple[Array, Array]:
    """Points (n, 3) of the corners that a camera sees, and their pixels (n, 2) of the image sensor."""
    corners = view.corners
    if corners is None:
        return np.zeros((0, 3)), np.zeros((0, 2))
    own = corners.camera == camera
    return corners.points_in_target[own], image_sensor_pixels(sensor, camera, corners.pixels[own])


def _intrinsics(camera: CameraDescription) -> tuple[Array, Array]:
    """Camera matrix (3, 3) and distortion (5,) of OpenCV."""
    focal = focal_length_px(camera)
    cx, cy = principal_point_px(camera)
    return np.array([[focal, 0.0, cx], [0.0, focal, cy], [0.0, 0.0, 1.0]]), np.array(camera.distortion)


def surface_of(target: SensorTarget) -> ShapeGroup:
    """Shapes of a target by its name."""
    match target:
        case "ball":
            return ball()
        case "step":
            return step_block()
        case "checkered":
            return CheckeredBoard().surface


def ball(diameter: float = _BALL_DIAMETER) -> ShapeGroup:
    """A ball, m."""
    return ShapeGroup((PlacedShape("ball", Sphere(diameter / 2), np.eye(4)),), "ball")


def step_block(treads: int = 3, width: float = 0.008, rise: float = 0.004, length: float = 0.04) -> ShapeGroup:
    """Level treads one beside the other along y, each higher by `rise`, m; the middle one at the origin."""
    places = np.arange(treads) - (treads - 1) / 2
    return ShapeGroup(
        tuple(
            PlacedShape(f"tread {k + 1}", Plane(length, width), pose.translation((0.0, width * place, rise * place)))
            for k, place in enumerate(places)
        ),
        "step block",
    )


def ball_poses(sensor: SensorDescription) -> Array:
    """Poses (45, 4, 4) of a ball over range and line, its centre on and beside the laser sheet."""
    radius = _BALL_DIAMETER / 2
    found = []
    for z in _heights(sensor, _HEIGHTS, _MARGIN):
        side = max(_half_width(sensor, z) - radius, 0.0)
        for y, x in product((-side, 0.0, side), (-0.35 * radius, 0.0, 0.35 * radius)):
            found.append(pose.translation((x, y, z + radius)))
    return np.array(found)


def step_poses(
    sensor: SensorDescription, heights: int = _HEIGHTS, tilt: float = np.radians(20.0), margin: float = _MARGIN
) -> Array:
    """Poses (5 heights, 4, 4) of a level target over the range: upright, and tilted to four sides.

    `margin` is the share of the measuring range that is left out at both of its ends.
    """
    tilts = [(0.0, 0.0), (tilt, 0.0), (-tilt, 0.0), (0.0, tilt), (0.0, -tilt)]
    found = []
    for z in _heights(sensor, heights, margin):
        for about_x, about_y in tilts:
            tilted = pose.from_euler_xyz((0.0, 0.0, z), (about_x, about_y, 0.0))
            found.append(tilted @ _FACING_SENSOR)
    return np.array(found)


def board_poses(sensor: SensorDescription) -> Array:
    """Poses (10, 4, 4) of a checkered board: those of `step_poses`, turned about its own normal in between."""
    # Nearer the ends it leaves the cameras' field of view.
    poses = step_poses(sensor, heights=2, tilt=np.radians(25.0), margin=0.25)
    turns = [pose.from_euler_xyz((0.0, 0.0, 0.0), (0.0, 0.0, 0.4 * k)) for k in range(len(poses))]
    return np.array([one @ turn for one, turn in zip(poses, turns, strict=True)])


def board_body(board: CheckeredBoard) -> Body:
    """The board as a mesh of square cells, white or printed."""
    rows, columns = board.white.shape
    width, height = board.size
    x, y = np.linspace(-width / 2, width / 2, columns + 1), np.linspace(height / 2, -height / 2, rows + 1)
    vertices = np.stack([*np.meshgrid(x, y), np.zeros((rows + 1, columns + 1))], -1).reshape(-1, 3)
    top_left = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    below = top_left + columns + 1
    faces = np.stack([top_left, below, below + 1, top_left, below + 1, top_left + 1], 1).reshape(-1, 3)
    printed = np.flatnonzero(np.repeat(~board.white.ravel(), 2))
    mesh = Mesh(vertices, faces, "checkered board")
    return Body("target", "part", mesh, PRESETS["matt_white"], (Patch(printed, _PRINT),))


def _heights(sensor: SensorDescription, count: int, margin: float) -> Array:
    near, far = 1e-3 * sensor.range.near_mm, 1e-3 * sensor.range.far_mm
    left_out = margin * (far - near)
    return np.linspace(near + left_out, far - left_out, count)


def _half_width(sensor: SensorDescription, z: float) -> float:
    """Half the length of the line that laser and cameras cover at a height."""
    laser = sensor.laser
    of_fan = (z - 1e-3 * laser.source_z_mm) * np.tan(np.radians(laser.fan_half_angle_deg))
    of_cameras = [
        np.hypot(1e-3 * one.baseline_mm, z - 1e-3 * one.height_mm) * one.width_px / (2 * focal_length_px(one))
        for one in read_out(sensor).camera
    ]
    return float(min(of_fan, *of_cameras))


Rows = NDArray[np.intp]

_SURFACES = {name: surface_of(name) for name in get_args(SensorTarget)}
_NAMES = {surface.source: name for name, surface in _SURFACES.items()}
_POSE = ("x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg")
_CORNER = ("corner_x_mm", "corner_y_mm")


@dataclass(frozen=True)
class MeasuredExposures:
    """Exposures of targets, and the files that they were read from."""

    exposures: tuple[TargetExposure, ...]
    files: tuple[Path, ...]


def write_exposures(exposures: Sequence[TargetExposure], path: Path) -> None:
    """Write CSV or Parquet (by suffix), a row per stripe peak or corner.

    Raises `OutputError` if the file cannot be written.
    """
    blocks = [columns for number, one in enumerate(exposures, 1) for columns in _written(number, one)]
    write_measured_table(path, {name: np.concatenate([one[name] for one in blocks]) for name in blocks[0]})


def _written(number: int, one: TargetExposure) -> Iterator[dict[str, Any]]:
    """Columns of the stripe, and of the corners, of an exposure."""
    placed, name = one.sensor_from_target, _NAMES.get(one.target.source, one.target.source)
    state = [*(1e3 * placed[:3, 3]), *np.degrees(pose.euler_xyz_from_rotation(placed[:3, :3]))]
    if one.corners is not None:
        state = [np.nan] * len(_POSE)  # the corners tell it
    mounting = np.nan if one.mounting is None else float(one.mounting)

    def columns(camera: NDArray[np.int32], pixels: Array, sigma: Array | float, corner: Array) -> dict[str, Any]:
        whole = {"row_sigma_px": sigma, **dict(zip(_POSE, state, strict=True)), "mounting": mounting}
        return {
            "exposure": np.full(len(camera), number),
            "camera": camera,
            "target": np.full(len(camera), name),
            **dict(zip(("column_px", "row_px"), pixels, strict=True)),
            **{key: np.broadcast_to(value, len(camera)) for key, value in whole.items()},
            **dict(zip(_CORNER, corner, strict=True)),
        }

    if one.stripe is not None:
        peaks = one.stripe
        pixels = np.stack([peaks.column, peaks.row])
        yield columns(peaks.camera, pixels, peaks.sigma, np.full_like(pixels, np.nan))
    if one.corners is not None:
        seen = one.corners
        yield columns(seen.camera, seen.pixels.T, seen.sigma, 1e3 * seen.points_in_target[:, :2].T)


def read_exposures(path: Path, sensor: SensorDescription) -> MeasuredExposures:
    """Exposures from CSV or Parquet.

    Raises `DescriptionError` if the file is missing or no table, a column is missing, a value is no finite number or
    out of bounds, or the rows of an exposure state different targets or poses.
    """
    table = MeasuredTable(path)
    # Notes such as ``multiple`` reject no peak; saturation shifts the centre.
    rejected = PEAK_REJECTED | PEAK_FLAGS["saturated"]
    used = {word for word, flag in PEAK_FLAGS.items() if not flag & rejected}
    accepted = np.array([used.issuperset(flags.split()) for flags in table.words("flags", "")], bool)
    number, peaks, corner = table.numbers("exposure"), _peaks(table, sensor), _corner_points(table)
    groups = [np.flatnonzero((number == one) & accepted) for one in np.unique(number[accepted])]
    is_view = np.isfinite(corner[:, 0])
    of_view = np.isin(number, number[is_view & accepted])
    state = np.column_stack([table.numbers(name, where=accepted & ~of_view) for name in _POSE])
    mounting = table.numbers("mounting", np.nan, where=np.zeros(len(table), bool))
    names = table.words("target")
    for rows in groups:
        _require_equal(table, rows, [*zip(_POSE, state.T, strict=True), ("mounting", mounting)], names)
    targets, files = _targets(table, names, accepted)
    views = 1 + int(np.nanmax(np.append(mounting, 0.0)))
    found: list[TargetExposure] = []
    for rows in groups:
        first = rows[0]
        stripe, corners = _stripe(peaks, rows[~is_view[rows]]), _corners(peaks, corner, rows[is_view[rows]])
        placed = pose.from_euler_xyz(1e-3 * state[first, :3], np.radians(state[first, 3:]))
        mount = None if np.isnan(mounting[first]) else int(mounting[first])
        if corners is not None:  # they tell the pose of their view
            placed, mount = np.eye(4), views + len(found)
        found.append(TargetExposure(targets[names[first]], placed, stripe, corners, mount))
    return MeasuredExposures(tuple(found), (path, *files))


def _corner_points(table: MeasuredTable) -> Array:
    """Corners (n, 2) on their target, mm; NaN of stripe peaks."""
    corner = np.column_stack([table.numbers(name, np.nan, where=np.zeros(len(table), bool)) for name in _CORNER])
    half = np.flatnonzero(np.isfinite(corner).any(1) & ~np.isfinite(corner).all(1))
    if len(half):
        missing = _CORNER[int(np.flatnonzero(~np.isfinite(corner[half[0]]))[0])]
        table.refuse(int(half[0]), missing, "both coordinates of the corner, or none")
    return corner


def _peaks(table: MeasuredTable, sensor: SensorDescription) -> StripePeaks:
    """The measured pixels of all rows, within the images."""
    camera, sigma = table.numbers("camera"), table.numbers("row_sigma_px")
    count = len(sensor.camera)
    table.require(np.isin(camera, np.arange(count)), "camera", f"a number from 0 to {count - 1}")
    table.require(sigma > 0.0, "row_sigma_px", "a positive standard deviation, px")
    index = camera.astype(np.int32)
    pixels = []
    for name, size in (("column_px", "width_px"), ("row_px", "height_px")):
        values = table.numbers(name)
        limit = np.array([getattr(one, size) for one in read_out(sensor).camera], float)[index] - 0.5
        if (wrong := np.flatnonzero((values < -0.5) | (values > limit))).size:
            table.refuse(int(wrong[0]), name, f"a pixel of the image, 0 to {limit[wrong[0]] - 0.5:g}")
        pixels.append(values)
    return StripePeaks(index, pixels[0], pixels[1], sigma)


def _require_equal(table: MeasuredTable, rows: Rows, columns: Sequence[tuple[str, Array]], names: list[str]) -> None:
    """Refuse an exposure whose rows differ in what belongs to the exposure."""
    expected = f"the value of row {rows[0] + 1}, which is of the same exposure"
    for name, values in columns:
        own = values[rows]
        other = np.flatnonzero(~((own == own[0]) | (np.isnan(own) & np.isnan(own[0]))))
        if len(other):
            table.refuse(int(rows[other[0]]), name, expected)
    for row in rows.tolist():
        if names[row] != names[int(rows[0])]:
            table.refuse(row, "target", expected)


def _targets(
    table: MeasuredTable, names: list[str], accepted: NDArray[np.bool_]
) -> tuple[dict[str, ShapeGroup], list[Path]]:
    """Shapes by the words of the column `target`, and files of artefacts."""
    found: dict[str, ShapeGroup] = {}
    files = []
    for row in np.flatnonzero(accepted).tolist():
        name = names[row]
        if name in found:
            continue
        if name in _NAMES.values():
            found[name] = _SURFACES[name]
            continue
        file = table.path.parent / name
        if not name or not file.is_file():
            words = ", ".join(_SURFACES)
            table.refuse(row, "target", f"{words}, or the file of an artefact beside the table")
        found[name] = load_artefact(file)
        files.append(file)
        if not found[name].measured:
            raise DescriptionError("has no shape with role measured", file=file)
    return found, files


def _stripe(peaks: StripePeaks, rows: Rows) -> StripePeaks | None:
    """Peaks of an exposure, `PEAK_SPACING` or more columns apart; None without any."""
    kept: list[int] = []
    for row in rows[np.lexsort((peaks.column[rows], peaks.camera[rows]))].tolist():
        last = kept[-1] if kept else None
        if (
            last is None
            or peaks.camera[last] != peaks.camera[row]
            or peaks.column[row] - peaks.column[last] >= PEAK_SPACING
        ):
            kept.append(row)
    if not kept:
        return None
    return StripePeaks(peaks.camera[kept], peaks.column[kept], peaks.row[kept], peaks.sigma[kept])


def _corners(peaks: StripePeaks, corner: Array, rows: Rows) -> Corners | None:
    if not len(rows):
        return None
    points = np.column_stack([1e-3 * corner[rows], np.zeros(len(rows))])
    pixels = np.column_stack([peaks.column[rows], peaks.row[rows]])
    order = np.argsort(peaks.camera[rows], kind="stable")
    sigma = float(np.sqrt(np.mean(peaks.sigma[rows] ** 2)))
    return Corners(peaks.camera[rows][order], pixels[order], points[order], sigma)
