"""Stripe peaks and corners of a sensor as a table, so that images of a real sensor can calibrate it.

The columns are in docs/calibration_sensor.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from scancell.calibration.measured_table import MeasuredTable, write_measured_table
from scancell.calibration.sensor.problem import PEAK_SPACING, Corners, StripePeaks, TargetExposure
from scancell.calibration.sensor.targets import surface_of
from scancell.config.choices import SensorTarget
from scancell.config.sensor import SensorDescription, read_out
from scancell.errors import DescriptionError
from scancell.geometry import pose
from scancell.geometry.shapes import ShapeGroup
from scancell.nominal.parts import load_artefact
from scancell.sensor import PEAK_FLAGS, PEAK_REJECTED

Array = NDArray[np.float64]
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
    accepted = np.array([_is_accepted(words) for words in table.words("flags", "")], bool)
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


def _is_accepted(flags: str) -> bool:
    """Whether a peak with these words is used: notes such as ``multiple`` reject none; saturation shifts the centre."""
    rejected = PEAK_REJECTED | PEAK_FLAGS["saturated"]
    return all(word in PEAK_FLAGS and not PEAK_FLAGS[word] & rejected for word in flags.split())


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
    if (wrong := np.flatnonzero(~np.isin(camera, np.arange(count)))).size:
        table.refuse(int(wrong[0]), "camera", f"a number from 0 to {count - 1}")
    if (wrong := np.flatnonzero(sigma <= 0.0)).size:
        table.refuse(int(wrong[0]), "row_sigma_px", "a positive standard deviation, px")
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
