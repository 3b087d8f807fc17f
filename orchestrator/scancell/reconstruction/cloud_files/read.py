"""The one reader of points from files of any program.

The content tells the format: PLY, PCD, LAS and LAZ, E57, NPZ of scancell, and text: columns, or a surface as a matrix
of heights. Every record of a file becomes a point, or is counted with the reason why it does not, or the file is
refused.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from scancell.arrays import Array
from scancell.errors import DescriptionError, MeshError, require
from scancell.files import MAX_FILE_BYTES, read_file, require_file
from scancell.geometry.mesh import METRES_PER_UNIT
from scancell.geometry.mesh_files import read_ply_points
from scancell.reconstruction.cloud_files.formats import read_pcd
from scancell.text_table import TextTable, column_name, decoded, lines_of, numbers_of_lines, text_table

SUFFIXES = (".ply", ".pcd", ".las", ".laz", ".e57", ".npz", ".xyz", ".txt", ".asc", ".csv", ".pts")
FARTHEST = 1e6  # m from the origin, beyond which no point is accepted
_HEAD = 1 << 12
_MATRIX = 16  # columns of numbers without a header from which on they may be a matrix of heights
_LEAST_OTHERS = 8  # values that tell how far values of points lie apart
_LEAST_ZEROS = 2  # points at exactly 0, 0, 0 from which on they mark missing points
_PCD_BEGIN = re.compile(rb"\s*(#[^\n]*\n\s*)*(VERSION|FIELDS|COLUMNS)\b")
_MATRIX_BEGIN = re.compile(r'\s*"?y\s*[\\/]\s*x"?\s*([,;\t])', re.IGNORECASE)
# Columns of x, y and z by their names; the last ones of ParaView and of maps.
_AXES: tuple[tuple[str, str, str], ...] = (
    *((f"{p}x{s}", f"{p}y{s}", f"{p}z{s}") for p in ("", "pos_", "position_", "point_", "coord_") for s in
      ("", "_mm", "_m", "_um", "_inch", "_in", "_coordinate")),
    ("cartesianx", "cartesiany", "cartesianz"),
    ("points:0", "points:1", "points:2"),
    ("points_0", "points_1", "points_2"),
    ("easting", "northing", "height"),
    ("easting", "northing", "elevation"),
)  # fmt: skip
_NAMED_UNITS = {"_mm": 1e-3, "_m": 1.0, "_um": 1e-6, "_inch": 0.0254, "_in": 0.0254}


@dataclass(frozen=True)
class CloudFile:
    """Points of a file, and what became of its records.

    Attributes
    ----------
    points
        (n, 3), m.
    kind
        Format that was recognised.
    records
        Number of points that the file holds.
    dropped
        Number of records without a usable point, by reason.
    warnings
        What is doubtful.
    """

    points: Array
    kind: str
    records: int
    dropped: Mapping[str, int] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    @property
    def figures(self) -> dict[str, Any]:
        """Counts for JSON."""
        return {"format": self.kind, "records": self.records, "points": len(self.points), "dropped": dict(self.dropped)}


@dataclass(frozen=True)
class _Found:
    """Positions (n, 3) of all records in units of `metres`; rows of NaN hold none, some for reasons in `dropped`."""

    positions: Array
    kind: str
    metres: float | None = None
    dropped: dict[str, int] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()


def read_cloud_file(path: Path, unit: str | None = None) -> CloudFile:
    """Points of a file of any of the formats, by its content.

    Raises `DescriptionError` if the file is missing, of another kind, broken, without points, or a point is more than
    1000 km from the origin; `MissingExtraError` if the package that reads the format is not installed.

    Parameters
    ----------
    unit
        Unit of the coordinates: mm, m or inch. By default what the file states (E57 by its standard in m, columns such
        as ``x_mm``), or else mm.
    """
    if unit is not None and unit not in METRES_PER_UNIT:
        raise DescriptionError(key="cloud_unit", value=unit, expected=f"one of {', '.join(METRES_PER_UNIT)}")
    require_file(path)
    reader = _reader(path)
    try:
        found = reader(path)
    except (OSError, ValueError, KeyError, IndexError, RuntimeError, EOFError, MemoryError, BadZipFile) as error:
        if isinstance(error, DescriptionError):
            raise
        if isinstance(error, MeshError):
            raise DescriptionError(str(error).removeprefix(f"{path}: "), file=path) from None
        raise DescriptionError(f"not a point cloud that can be read: {error}", file=path) from None
    except Exception as error:  # of a library that reads a broken file
        if not type(error).__module__.startswith(("laspy", "lazrs", "pye57")):
            raise
        raise DescriptionError(f"not a point cloud that can be read: {error}", file=path) from None
    return _cloud_of(path, found, unit)


def cloud_of_profiles(path: Path, positions: Array, kind: str) -> CloudFile:
    """Cloud of the points (n, 3) of profiles, mm, NaN without a height."""
    missing = int(np.isnan(positions).any(1).sum())
    return _cloud_of(path, _Found(positions, kind, dropped={"without a height": missing} if missing else {}), None)


def holds_cloud(path: Path) -> bool:
    """Whether a file holds a cloud by its content: all formats but text with columns, which may hold other tables."""
    with path.open("rb") as stream:
        head = stream.read(_HEAD)
    if any(matches for matches, _, _ in _kinds(head)):
        return True
    with suppress(DescriptionError):
        return any(_MATRIX_BEGIN.match(line) for line in lines_of(decoded(head[: len(head) // 2 * 2], path)[0]))
    return False


def _cloud_of(path: Path, found: _Found, unit: str | None) -> CloudFile:
    positions = np.asarray(found.positions, float)
    if not len(positions):
        raise DescriptionError("holds no points", file=path)
    metres, notes = found.metres, list(found.warnings)
    if unit is not None:
        if metres is not None and not np.isclose(metres, METRES_PER_UNIT[unit]) and not found.kind.startswith("E57"):
            raise DescriptionError(
                "the names of the columns state another unit", file=path, key="cloud_unit", value=unit
            )
        metres = METRES_PER_UNIT[unit]
    dropped = dict(found.dropped)
    finite = np.isfinite(positions).all(1)
    unknown = int((~finite).sum()) - sum(dropped.values())
    if unknown:
        dropped["not finite"] = unknown
    at_origin = finite & (positions == 0.0).all(1)
    zeros = int(at_origin.sum())
    if zeros >= _LEAST_ZEROS:
        dropped["at exactly 0, 0, 0"] = zeros
        finite &= ~at_origin
    marked, value = missing_value(positions[finite, 2])
    if marked.any():
        others = positions[finite][~marked]
        count = int(marked.sum())
        # A plane of repeated heights can stand apart from the rest of a part, but not by more than the part's size.
        if np.abs(others[:, 2] - value).min() > np.ptp(others, axis=0).max():
            dropped[f"with z = {value:.10g}, far from all others"] = count
            finite[np.flatnonzero(finite)[marked]] = False
        else:
            notes.append(f"{path}: {count} points have z = {value:.10g}, apart from all others: were they measured?")
    if not finite.any():
        reasons = ", ".join(f"{count} {reason}" for reason, count in dropped.items())
        raise DescriptionError(f"holds no usable point: of {len(positions)}, {reasons}", file=path)
    points = positions[finite] * (1e-3 if metres is None else metres)
    distance = np.abs(points).max(1)
    if distance.max() > FARTHEST:
        row = int(distance.argmax())
        raise DescriptionError(
            f"lies {distance[row] / 1e3:.6g} km from the origin along an axis", file=path,
            key=f"point {int(np.flatnonzero(finite)[row]) + 1}", value=positions[finite][row].tolist(),
            expected="at most 1000 km: is the unit of the cloud (`cloud_unit`) right? Subtract a constant offset from "
            "georeferenced coordinates",
        )  # fmt: skip
    if dropped:
        reasons = ", ".join(f"{count} {reason}" for reason, count in dropped.items())
        notes.append(f"{path}: {len(positions) - len(points)} of {len(positions)} records are no points: {reasons}")
    return CloudFile(points, found.kind, len(positions), dropped, tuple(notes))


def missing_value(values: Array, gap: float = 1.0) -> tuple[NDArray[np.bool_], float]:
    """Whether each of the values (n,) is the one that marks missing points, and this value.

    Devices write the same number, such as -32768 steps, -99999.99 or 0, where they found nothing: the smallest or
    largest value, which repeats more often than others do, and farther from all others than `gap` times their range.
    """
    none = np.zeros(len(values), bool)
    if len(values) < _LEAST_OTHERS:
        return none, np.nan
    for extreme in (values.min(), values.max()):
        marked = values == extreme
        others = values[~marked]
        count = int(marked.sum())
        if count < 2 or len(others) < _LEAST_OTHERS:
            continue
        apart = np.abs(others - extreme).min()
        if apart <= max(gap * float(np.ptp(others)), 1e-9 * abs(extreme)):
            continue
        if np.unique(others, return_counts=True)[1].max() < max(count, 2):  # planes repeat a height, too
            return marked, float(extreme)
    return none, np.nan


def _reader(path: Path) -> Callable[[Path], _Found]:
    """Reader of the format that the content has; a name that states another one is refused."""
    with path.open("rb") as stream:
        head = stream.read(_HEAD)
    suffix, kinds = path.suffix.lower(), _kinds(head)
    for matches, _, reader in kinds:
        if matches:
            return reader
    named = [suffixes for _, suffixes, _ in kinds if suffix in suffixes]
    if named:
        raise DescriptionError(f"does not begin as a {suffix[1:].upper()} file does", file=path)
    if suffix not in SUFFIXES:
        raise DescriptionError(file=path, expected=f"a point cloud: {', '.join(SUFFIXES)}")
    return _text


def _kinds(head: bytes) -> list[tuple[bool, tuple[str, ...], Callable[[Path], _Found]]]:
    """Whether the beginning of a file is that of each binary format, the suffixes of the format, and its reader."""
    return [
        (re.match(rb"\s*ply\s", head) is not None, (".ply",), _ply),
        (head[:4] == b"LASF", (".las", ".laz"), _las),
        (head[:8] == b"ASTM-E57", (".e57",), _e57),
        (head[:4] in (b"PK\3\4", b"PK\5\6"), (".npz",), _npz),
        (_PCD_BEGIN.match(head) is not None, (".pcd",), _pcd),
    ]


def _ply(path: Path) -> _Found:
    points, remarks = read_ply_points(path)
    return _Found(np.asarray(points, float), "PLY", warnings=tuple(remarks))


def _pcd(path: Path) -> _Found:
    positions, header = read_pcd(path, read_file(path, most_bytes=MAX_FILE_BYTES))
    warnings = (f"{path}: its VIEWPOINT is not applied to the points",) if header.moved_viewpoint else ()
    return _Found(positions, f"PCD, {header.encoding}", warnings=warnings)


def _npz(path: Path) -> _Found:
    with np.load(path) as arrays:
        if "points_in_part_mm" not in arrays:
            raise ValueError(f"expected an array points_in_part_mm; found {', '.join(arrays)}")
        positions = np.asarray(arrays["points_in_part_mm"], float)
    if positions.ndim != 2 or positions.shape[1] != 3:
        raise ValueError(f"points_in_part_mm has the shape {positions.shape}; expected (n, 3)")
    return _Found(positions, "NPZ", 1e-3)


def _las(path: Path) -> _Found:
    laspy = require("laspy", "formats")
    with laspy.open(path) as stream:
        stated, compressed = int(stream.header.point_count), bool(stream.header.are_points_compressed)
        las = stream.read()
    positions = np.asarray(las.xyz, float)
    if len(positions) != stated:
        raise ValueError(f"{len(positions)} of {stated} points")
    dropped = {}
    withheld = np.asarray(getattr(las, "withheld", np.zeros(len(positions))), bool)
    if withheld.any():
        positions[withheld] = np.nan
        dropped["withheld"] = int(withheld.sum())
    return _Found(positions, "LAZ" if compressed else "LAS", dropped=dropped)


def _e57(path: Path) -> _Found:
    scans = require("pye57", "formats").E57(str(path))
    blocks, dropped = [], 0
    try:
        for i in range(scans.scan_count):
            scan = scans.read_scan(i, ignore_missing_fields=True)
            found = np.stack([scan[f"cartesian{axis}"] for axis in "XYZ"], -1)
            missing = scans.get_header(i).point_count - len(found)  # those that their scan marks as invalid
            dropped += missing
            blocks += [found, np.full((missing, 3), np.nan)]
        count = scans.scan_count
    finally:
        scans.close()
    positions = np.concatenate(blocks) if blocks else np.zeros((0, 3))
    kind = "E57" if count == 1 else f"E57, {count} scans"
    return _Found(positions, kind, 1.0, {"marked as invalid": dropped} if dropped else {})


def _text(path: Path) -> _Found:
    text, encoding = decoded(read_file(path), path)
    surfaces = _surfaces(path, text)
    return surfaces if surfaces is not None else _of_columns(text_table(text, encoding, path))


def _of_columns(table: TextTable) -> _Found:
    """Positions of the columns x, y, z; the first three where no line names columns."""
    names, path = table.names, table.path
    if not names:
        width = len(table.rows[0].split(None if table.separator == " " else table.separator)) if table.rows else 0
        for comment in table.comments:
            said = tuple(column_name(word) for word in re.split(r"[\s,;]+", comment) if word)
            if len(said) >= width and set("xyz") <= set(said[:width]):
                names = said[:width]
                break
    if not names:
        if width < 3:
            raise DescriptionError(f"has {width} values a line", file=path, expected="x, y and z")
        if width > _MATRIX:
            raise DescriptionError(
                f"has {width} values a line and no names of columns: is it a matrix of heights without coordinates?",
                file=path, expected="columns x, y, z, or a matrix whose first line holds Y\\X and the values of x",
            )  # fmt: skip
        return _Found(table.columns([0, 1, 2]), table.kind)
    for axes in _AXES:
        if set(axes) <= set(names):
            metres = next(
                (value for suffix, value in _NAMED_UNITS.items() if all(a.endswith(suffix) for a in axes)), None
            )
            return _Found(table.columns([names.index(axis) for axis in axes]), table.kind, metres)
    raise DescriptionError(
        "lacks a column of positions", file=path, key="columns", value=", ".join(names), expected="x, y and z"
    )


def _surfaces(path: Path, text: str) -> _Found | None:
    r"""Positions of surfaces as matrices of heights: a line ``Y\X`` with the values of x, and a line for each y.

    None if the text holds none.
    """
    lines = lines_of(text)
    starts = [(index, found[1]) for index, line in enumerate(lines) if (found := _MATRIX_BEGIN.match(line))]
    if not starts:
        return None
    blocks, empty = [], 0
    for start, separator in starts:
        rows, numbers = [], []
        for index in range(start + 1, len(lines)):
            stripped = lines[index].strip()
            if not stripped.strip(separator) or not re.match(r'"?[+-]?[\d.]', stripped):
                break
            rows.append(lines[index])
            numbers.append(index + 1)
        decimal = "," if separator != "," and any("," in row for row in rows) else "."
        width = len(lines[start].rstrip().rstrip(separator).split(separator))
        for row, number in zip(rows, numbers, strict=True):
            if row.strip().count(separator) + 1 not in (width, width + 1):
                raise DescriptionError(
                    file=path, key=f"line {number}", value=row.strip()[:40], expected=f"{width - 1} heights behind y"
                )
        _require_stated(path, lines, start, len(rows), width - 1)
        x = numbers_of_lines([lines[start]], range(1, width), separator, decimal, path, [start + 1])[0]
        values = numbers_of_lines(rows, range(width), separator, decimal, path, numbers)
        y, z = values[:, 0], values[:, 1:]
        grid = np.stack([np.broadcast_to(x, z.shape), np.broadcast_to(y[:, None], z.shape), z], -1).reshape(-1, 3)
        empty += int(np.isnan(grid).any(1).sum())
        blocks.append(grid)
    count = f", {len(blocks)} surfaces" if len(blocks) > 1 else ""
    dropped = {"without a height": empty} if empty else {}
    return _Found(np.concatenate(blocks), f"surface as a matrix of heights{count}", dropped=dropped)


def _require_stated(path: Path, lines: list[str], start: int, rows: int, columns: int) -> None:
    """Refuse a surface with other numbers of rows and columns than the lines above it state."""
    for above in range(max(0, start - 3), start - 1):
        names = [column_name(word) for word in re.split(r"[,;\t]", lines[above])]
        values = re.split(r"[,;\t]", lines[above + 1])
        for name, found in (("row_count", rows), ("column_count", columns)):
            if name in names and len(values) > names.index(name):
                stated = values[names.index(name)].strip()
                if stated != str(found):
                    raise DescriptionError(
                        file=path,
                        key=f"line {above + 2}: {name}",
                        value=stated,
                        expected=f"{found}, as the surface has",
                    )
