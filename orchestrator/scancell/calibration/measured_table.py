"""Tables of measurements (CSV, Parquet, YAML) whose errors name file, column and row."""

from __future__ import annotations

import fnmatch
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NoReturn

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
from numpy.typing import NDArray

from scancell.arrays import Array
from scancell.cell.recording import read_table
from scancell.config.table_format import AxisDescription, Column, FormatDescription, head_of
from scancell.errors import DescriptionError, require
from scancell.files import atomic_write, read_file, read_text, require_file
from scancell.text_table import (
    MISSING,
    SEPARATORS,
    column_name,
    decoded,
    dialect_of,
    lines_of,
    numbers_of_lines,
    read_text_table,
    split_line,
    text_table,
)

_YAML = (".yaml", ".yml")
_LARGEST = 1e12  # of any unit

_FAR_MM = 1e9
_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|[+-]?\.?(?:nan|inf)"
_DECIMALS = {"point": ".", "comma": ","}


class MeasuredTable:
    """A table by its columns; rows count from 1 in messages, after the header.

    Raises `DescriptionError` if the file is missing, no table, or has no rows.

    Parameters
    ----------
    columns
        Values (n,) by name that were read from the file already.
    """

    def __init__(self, path: Path, columns: Mapping[str, NDArray[np.generic]] | None = None) -> None:
        self.path = path
        if columns is not None:
            self._table = pa.table({name: pa.array(values) for name, values in columns.items()})
        elif path.suffix.lower() in _YAML:
            self._table = _read_yaml(path)
        else:
            require_file(path)
            with path.open("rb") as stream:
                is_parquet = stream.read(4) == b"PAR1" or path.suffix.lower() == ".parquet"
            self._table = read_table(path) if is_parquet else _read_csv(path)
        self._row_numbers = np.arange(1, len(self) + 1)
        if not len(self):
            raise DescriptionError("holds no rows below its header", file=path, expected="at least one")

    def __len__(self) -> int:
        return int(self._table.num_rows)

    @property
    def names(self) -> list[str]:
        """Names of the columns."""
        return list(self._table.column_names)

    def row_number(self, row: int) -> int:
        """Number of a row in the file, from 1 below the header; `row` counts from 0."""
        return int(self._row_numbers[row])

    def leave_out_missing(self, name: str) -> int:
        """Leave out the rows without a value in a column: empty, NaN or a mark such as ``---``; their number.

        Raises `DescriptionError` if no row is left.
        """
        if name not in self._table.column_names:
            return 0
        values = [value is None or str(value).strip().lower() in MISSING for value in self._list(name)]
        missing = np.array(values, bool)
        if missing.all():
            raise DescriptionError("holds no value", file=self.path, key=f"column '{name}'")
        self._table = self._table.filter(pa.array(~missing))
        self._row_numbers = self._row_numbers[~missing]
        return int(missing.sum())

    def numbers(self, name: str, default: float | None = None, where: NDArray[np.bool_] | None = None) -> Array:
        """A column (n,) of numbers, NaN where empty; those of the rows `where` (n,), by default all, must be finite.

        Raises `DescriptionError` if the column is missing and has no default, or a value is no finite number.
        """
        if name not in self._table.column_names:
            if default is None and (where is None or where.any()):
                raise DescriptionError("is missing", file=self.path, key=f"column '{name}'")
            return np.full(len(self), np.nan if default is None else default)
        column = self._table.column(name)
        if pa.types.is_floating(column.type) or pa.types.is_integer(column.type):
            values = np.asarray(column.cast(pa.float64()).to_numpy(), float)
        else:
            values = np.array([self._number(name, row, value) for row, value in enumerate(column.to_pylist())], float)
        needed = np.ones(len(self), bool) if where is None else where
        is_valid = np.where(np.isnan(values), ~needed, np.abs(values) <= _LARGEST)
        self.require(is_valid, name, f"a finite number from {-_LARGEST:g} to {_LARGEST:g}")
        return values

    def words(self, name: str, default: str | None = None) -> list[str]:
        """A column of words, empty ones where the table has none.

        Raises `DescriptionError` if the column is missing and has no default.
        """
        if name not in self._table.column_names:
            if default is None:
                raise DescriptionError("is missing", file=self.path, key=f"column '{name}'")
            return [default] * len(self)
        return ["" if value is None else str(value) for value in self._list(name)]

    def require(self, is_valid: NDArray[np.bool_], name: str, expected: str) -> None:
        """Raise a `DescriptionError` on the first value of a column that is not valid (n,)."""
        if not is_valid.all():
            self.refuse(int(np.argmin(is_valid)), name, expected)

    def refuse(self, row: int, name: str, expected: str) -> NoReturn:
        """Raise a `DescriptionError` on a value; `row` counts from 0."""
        found = self._list(name)[row] if name in self._table.column_names else None
        key = f"column '{name}', row {self.row_number(row)}"
        if found is None or found == "":
            raise DescriptionError("is empty", file=self.path, key=key, expected=expected)
        raise DescriptionError(file=self.path, key=key, value=found, expected=expected)

    def _list(self, name: str) -> list[Any]:
        found: list[Any] = self._table.column(name).to_pylist()
        return found

    def _number(self, name: str, row: int, value: Any) -> float:
        if value is None or value == "":
            return float("nan")
        try:
            return float(value)
        except (ValueError, TypeError):
            self.refuse(row, name, "a number")


def _read_csv(path: Path) -> pa.Table:
    """Table of a text with any separator, decimal mark and encoding, whose header names the columns."""
    text = read_text_table(path)
    if not text.names:
        raise DescriptionError("has no header", file=path, expected="names of the columns in the first line")
    separator = "\t" if text.separator == " " else text.separator
    rows = (["\t".join(row.split()) for row in text.rows]) if text.separator == " " else text.rows
    # Only an empty field is none: ``nan`` is a value, which messages show.
    options = pyarrow.csv.ConvertOptions(null_values=[""], strings_can_be_null=False, decimal_point=text.decimal)
    header = separator.join(f'"{name}"' for name in text.names)
    try:
        return pyarrow.csv.read_csv(
            pa.BufferReader("\n".join([header, *rows, ""]).encode()),
            parse_options=pyarrow.csv.ParseOptions(delimiter=separator),
            convert_options=options,
        )
    except pa.ArrowException as error:
        raise DescriptionError(str(error), file=path, expected="a table of numbers and words") from None


def _read_yaml(path: Path) -> pa.Table:
    """Table of a YAML list of mappings from columns to values; a list of values makes as many rows of its entry."""
    yaml = require("yaml", "studies")
    text = read_text(path)
    try:
        entries = yaml.load(text, getattr(yaml, "CSafeLoader", yaml.SafeLoader))
    except (yaml.YAMLError, ValueError) as error:
        raise DescriptionError(" ".join(str(error).split()), file=path, expected="YAML") from None
    except (RecursionError, MemoryError):
        raise DescriptionError("is nested too deeply, or too large", file=path, expected="YAML") from None
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise DescriptionError(
            "is not a list of entries", file=path, expected="a list of mappings from columns to values"
        )
    rows: list[dict[str, Any]] = []
    for number, entry in enumerate(entries, 1):
        counts = {str(name): len(values) for name, values in entry.items() if isinstance(values, list)}
        if len(set(counts.values())) > 1:
            raise DescriptionError(
                key=f"entry {number}", file=path, value=counts, expected="lists of equal length in an entry"
            )
        for row in range(next(iter(counts.values()), 1)):
            rows.append({str(k): v[row] if isinstance(v, list) else v for k, v in entry.items()})
    names = list(dict.fromkeys(name for row in rows for name in row))
    return pa.table({name: _column([row.get(name) for row in rows]) for name in names})


def _column(values: list[Any]) -> pa.Array:
    """A column of numbers, or of words if any entry is not a number."""
    if all(value is None or (isinstance(value, int | float) and not isinstance(value, bool)) for value in values):
        return pa.array([None if value is None else float(value) for value in values], pa.float64())
    return pa.array([None if value is None else str(value) for value in values])


def write_measured_table(path: Path, columns: dict[str, Any]) -> None:
    """Write columns as CSV or Parquet (by suffix); NaN becomes an empty field.

    Raises `OutputError` if the file cannot be written.
    """
    table = pa.table({name: pa.array(values, from_pandas=True) for name, values in columns.items()})
    with atomic_write(path) as temporary:
        if path.suffix.lower() == ".csv":
            pyarrow.csv.write_csv(table, temporary)
        else:
            pyarrow.parquet.write_table(table, temporary)


@dataclass(frozen=True)
class ProfileTable:
    """Points (m) of the profiles of files, in their order.

    Attributes
    ----------
    kind
        What the files were taken for.
    files
        The files that were read.
    profile, column
        (m,) numbers of the profile, from 1, and of the point in it, from 0.
    points
        (m, 3) x along the profile, y of the travel, z, mm; NaN where the file holds none.
    time, intensity
        (m,) s and digital numbers; None where the format has none.
    has_travel
        Whether y is stated.
    readings
        Further columns (m,) by name: readings of the robot, and numbers of sensors, where the file holds them.
    """

    kind: str
    files: tuple[Path, ...]
    profile: NDArray[np.int64]
    column: NDArray[np.int64]
    points: Array
    time: Array | None
    intensity: Array | None
    has_travel: bool
    readings: Mapping[str, Array] = field(default_factory=dict)

    @property
    def has_height(self) -> NDArray[np.bool_]:
        """Whether points (m,) were measured."""
        return np.asarray(np.isfinite(self.points).all(1))

    @property
    def text(self) -> str:
        """Sentence about the recognised format, and the numbers of profiles and points."""
        missing, count = int((~self.has_height).sum()), len(np.unique(self.profile))
        files = f"{len(self.files)} files, " if len(self.files) > 1 else ""
        profiles = f"{count} profile{'s' * (count > 1)}"
        return (
            f"taken for {self.kind}: {files}{profiles}, {len(self.profile)} points, {missing} of them without a height"
        )

    def columns(self, travel: str | None = None) -> dict[str, NDArray[np.generic]]:
        """Columns of a table of the points that were measured, with readings, or whose poses another table holds.

        Where y is stated, it is the column `travel`, the same for all points of a profile.
        """
        kept = self.has_height
        found: dict[str, NDArray[np.generic]] = {"exposure": self.profile, "column_px": self.column}
        if self.time is not None:
            found["time_s"] = self.time
        if self.intensity is not None:
            found["intensity_dn"] = self.intensity
        if travel is not None and self.has_travel:
            found[travel] = self.points[:, 1]
        # With readings, coordinates are those of the sensor frame, whose y is along the line.
        found |= {"y_mm" if self.readings else "x_mm": self.points[:, 0], "z_mm": self.points[:, 2], **self.readings}
        return {name: values[kept] for name, values in found.items()}


def read_profiles(path: Path, form: FormatDescription) -> ProfileTable:
    """The profiles of a file, or of the files of a folder in the order of their numbers.

    Raises `DescriptionError` naming file, line, value and what was expected.
    """
    if form.layout == "ros_bag":
        from scancell.calibration.ros_bag import read_bag  # noqa: PLC0415  (which makes such a table)

        return read_bag(path, form)
    files = [path] if not path.is_dir() else _files(path, form)
    parts, last = [], 0
    for file in files:
        require_file(file)
        part = _READERS[form.layout](file, form)
        parts.append(replace(part, profile=part.profile + last))
        last = int(parts[-1].profile.max(initial=last))
    if not any(part.has_height.any() for part in parts):
        raise DescriptionError(f"holds no point with a height, {parts[0].text}", file=path)

    def joined(arrays: Sequence[Array | None]) -> Array | None:
        known = [array for array in arrays if array is not None]
        return np.concatenate(known) if len(known) == len(arrays) else None

    return ProfileTable(
        form.name,
        tuple(files),
        np.concatenate([part.profile for part in parts]),
        np.concatenate([part.column for part in parts]),
        np.concatenate([part.points for part in parts]),
        joined([part.time for part in parts]),
        joined([part.intensity for part in parts]),
        all(part.has_travel for part in parts) and (len(parts) == 1 or form.y is None or form.y.pitch_mm is None),
    )


def _files(folder: Path, form: FormatDescription) -> list[Path]:
    """Files of a folder that the format describes: p2 before p10."""

    def order(file: Path) -> list[tuple[int, str]]:
        return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", file.name)]

    found = [file for file in folder.iterdir() if file.is_file() and fnmatch.fnmatch(file.name, form.files)]
    if form.content is not None:
        found = [file for file in found if form.recognises(head_of(file))]
    if not found:
        raise DescriptionError("holds no file of the format", file=folder, expected=f"{form.files}: {form.name}")
    return sorted(found, key=order)


def profile_table(path: Path, form: FormatDescription, points: Sequence[Array], profile: Array, time: Array | None,
          intensity: Array | None, has_travel: bool) -> ProfileTable:  # fmt: skip
    """Table of numbers (m) of the file: scaled, invalid ones as NaN."""
    x, y, z = points
    invalid = np.isin(z, form.invalid) if form.invalid else np.zeros(len(z), bool)
    with np.errstate(invalid="ignore", over="ignore"):
        made = np.stack([_scaled(form.x, x), y, _scaled(form.z, np.where(invalid, np.nan, z))], -1)
        far = np.flatnonzero(np.abs(made).max(1) > _FAR_MM)
    if len(far):
        raise DescriptionError(
            file=path, key=f"point {far[0] + 1}", value=made[far[0]].tolist(),
            expected="less than 1000 km: is its scale right?",
        )  # fmt: skip
    _, first, number = np.unique(profile, return_index=True, return_inverse=True)
    order = np.argsort(np.argsort(first))  # profiles count from 1 in the order of the file
    place = order[number.reshape(-1)]
    column = np.arange(len(place)) - np.sort(first)[place]
    return ProfileTable(form.name, (path,), place.astype(np.int64) + 1, column.astype(np.int64), made, time, intensity,
                        has_travel)  # fmt: skip


def _scaled(axis: AxisDescription, numbers: Array) -> Array:
    return np.asarray(axis.offset_mm + axis.scale_mm * numbers)


def _of_grid(path: Path, form: FormatDescription, z: Array, x: Array | None, y: Array | None, time: Array | None,
             intensity: Array | None = None) -> ProfileTable:  # fmt: skip
    """Table of heights (profiles, points); `x` (points,) or (profiles, points), `y` and `time` (profiles,)."""
    count, width = z.shape
    if form.x.pitch_mm is not None:
        x = np.asarray(form.x.pitch_mm / form.x.scale_mm * np.arange(width))
    if x is None:
        raise DescriptionError(
            f"taken for {form.name}, states no positions along the profile", file=path, key="format.x",
            expected="x.pitch_mm in a file of the format with this preset",
        )  # fmt: skip
    if form.y is not None and form.y.pitch_mm is not None:
        y = np.asarray(form.y.offset_mm + form.y.pitch_mm * np.arange(count))
    elif form.y is not None and y is not None:
        y = _scaled(form.y, y)

    def spread(values: Array) -> Array:
        return np.repeat(values, width)

    return profile_table(
        path, form,
        [np.broadcast_to(x, z.shape).reshape(-1), spread(np.zeros(count) if y is None else y), z.reshape(-1)],
        spread(np.arange(1.0, count + 1)), None if time is None else form.time_unit_s * spread(time),
        None if intensity is None else intensity.reshape(-1), y is not None or count == 1,
    )  # fmt: skip


@dataclass(frozen=True)
class _Lines:
    """Lines (n) of a table in a text, their numbers, and how they are split; `names` of the columns or numbers of x."""

    path: Path
    lines: Sequence[str]
    numbers: Sequence[int]
    dialect: tuple[str, str]
    names: Sequence[str]

    def place(self, column: Column) -> int:
        """Index of a column, by its number or name."""
        if isinstance(column, int):
            return column - 1
        names = [column_name(name) for name in self.names]
        if column_name(column) not in names:
            raise DescriptionError(
                "is missing", file=self.path, key=f"column '{column}'", expected=f"among {', '.join(names[:12])}"
            )
        return names.index(column_name(column))

    def values(self, columns: Sequence[int]) -> Array:
        """Numbers (n, k) of columns."""
        return numbers_of_lines(self.lines, columns, *self.dialect, self.path, self.numbers)

    def one(self, column: Column | None) -> Array | None:
        """Numbers (n,) of a column."""
        return None if column is None else self.values([self.place(column)])[:, 0]


def _lines(path: Path, form: FormatDescription) -> tuple[str, list[tuple[int, str]]]:
    """Encoding, and numbered lines of the table that are not blank."""
    text, encoding = decoded(read_file(path), path)
    numbered = list(enumerate(lines_of(text), 1))
    if form.begin is not None:
        starts = [i for i, (_, line) in enumerate(numbered) if re.match(form.begin, line)]
        if not starts:
            raise DescriptionError(f"taken for {form.name}, has no line '{form.begin}'", file=path)
        numbered = numbered[starts[0] + 1 :]
    numbered = numbered[form.skip_lines :]
    if form.end is not None:
        ends = (i for i, (_, line) in enumerate(numbered) if re.match(form.end, line))
        numbered = numbered[: next(ends, len(numbered))]
    return encoding, [(number, line) for number, line in numbered if line.strip()]


def _dialect(path: Path, form: FormatDescription, lines: Sequence[str]) -> tuple[str, str]:
    if form.delimiter is None or form.decimal is None:
        separator, decimal = dialect_of(lines, path)
        separator = separator if form.delimiter is None else SEPARATORS[form.delimiter]
        return separator, decimal if form.decimal is None else _DECIMALS[form.decimal]
    return SEPARATORS[form.delimiter], _DECIMALS[form.decimal]


def _grid_lines(path: Path, form: FormatDescription) -> _Lines:
    """Lines of a matrix, all of the same number of values."""
    _, numbered = _lines(path, form)
    if len(numbered) <= form.has_header:
        raise DescriptionError(f"taken for {form.name}, holds no rows", file=path)
    dialect = _dialect(path, form, [line for _, line in numbered[form.has_header :]])
    separator = dialect[0]
    fields = [split_line(line, separator) for _, line in numbered]
    width = len(fields[0]) - (len(fields[0]) > 1 and fields[0][-1] == "" and all(f[-1:] == [""] for f in fields))
    for (number, line), found in zip(numbered, fields, strict=True):
        if len(found) != width and not (len(found) == width + 1 and found[-1] == ""):
            raise DescriptionError(
                file=path,
                key=f"line {number}",
                value=line.strip()[:40],
                expected=f"{width} values as in the first line",
            )
    names = fields[0][:width] if form.has_header else [""] * width
    rows = numbered[form.has_header :]
    return _Lines(path, [line for _, line in rows], [number for number, _ in rows], dialect, names)


def _rows(path: Path, form: FormatDescription) -> ProfileTable:
    table = _grid_lines(path, form)
    columns = range(table.place(form.first_height), len(table.names))
    header = None
    if form.has_header and form.x.pitch_mm is None:
        separator = table.dialect[0]
        header = numbers_of_lines([separator.join(table.names)], columns, *table.dialect, path, [0])[0]
    y = table.one(form.y.column if form.y is not None else None)
    time, z = table.one(form.time_column), table.values(columns)
    if form.kind_column is None:
        return _of_grid(path, form, z, header, y, time)
    place = table.place(form.kind_column)
    kinds = np.array([split_line(line, table.dialect[0])[place].strip('"').upper() for line in table.lines])
    is_height = kinds == "Z"
    groups = {kind: z[kinds == kind] for kind in ("X", "I") if (kinds == kind).any()}
    if not is_height.any() or any(len(group) != is_height.sum() for group in groups.values()):
        raise DescriptionError(
            f"taken for {form.name}, holds {', '.join(f'{(kinds == k).sum()} rows {k}' for k in sorted(set(kinds)))}",
            file=path, expected="rows Z, and as many rows X and I or none",
        )  # fmt: skip
    return _of_grid(path, form, z[is_height], groups.get("X", header), None if y is None else y[is_height],
                    None if time is None else time[is_height], groups.get("I"))  # fmt: skip


def _columns(path: Path, form: FormatDescription) -> ProfileTable:
    table = _grid_lines(path, form)
    columns = range(table.place(form.first_height), len(table.names))
    return _of_grid(path, form, table.values(columns).T, table.one(form.x.column), None, None)


def _points(path: Path, form: FormatDescription) -> ProfileTable:
    encoding, numbered = _lines(path, form)
    if not numbered:
        raise DescriptionError(f"taken for {form.name}, holds no rows", file=path)
    text = [""] * numbered[-1][0]  # keeps the numbers of the lines
    for number, line in numbered:
        text[number - 1] = line
    dialect = None
    if form.delimiter is not None or form.decimal is not None:
        dialect = _dialect(path, form, [line for _, line in numbered])
    found = text_table("\n".join(text), encoding, path, dialect)
    table = _Lines(path, found.rows, found.numbers, (found.separator, found.decimal), found.names)
    x, z = table.one(form.x.column), table.one(form.z.column)
    assert x is not None and z is not None  # the description requires them
    profile = table.one(form.profile_column)
    profile = np.ones(len(z)) if profile is None else profile
    y = None if form.y is None else table.one(form.y.column)
    if form.y is not None and form.y.pitch_mm is not None:
        steps = np.unique(profile, return_inverse=True)[1].reshape(-1)
        y = np.asarray(form.y.pitch_mm / form.y.scale_mm * steps)
    y = None if y is None or form.y is None else _scaled(form.y, y)
    time = table.one(form.time_column)
    return profile_table(path, form, [x, np.zeros(len(z)) if y is None else y, z], profile,
                 None if time is None else form.time_unit_s * time, table.one(form.intensity_column),
                 y is not None or len(np.unique(profile)) == 1)  # fmt: skip


def _sequence(path: Path, form: FormatDescription) -> ProfileTable:
    """A profile as one list of numbers in brackets."""
    text, _ = decoded(read_file(path), path)
    lists = re.findall(r'(?:\b(\w++)"?\s*+:\s*+)?\[([^\[\]]*)\]', text)
    chosen = [found for name, found in lists if form.list_name is None or re.fullmatch(form.list_name, name)]
    if len(chosen) != 1 or not text.count("[") == text.count("]") == len(lists):
        raise DescriptionError(
            f"taken for {form.name}, holds {len(chosen)} lists, or one without its end", file=path,
            key=form.list_name and f"list '{form.list_name}'", expected="one list",
        )  # fmt: skip
    words = [word.strip() for word in chosen[0].split(",")] if chosen[0].strip() else []
    for number, word in enumerate(words, 1):
        if not re.fullmatch(_NUMBER, word, re.IGNORECASE):
            raise DescriptionError(file=path, key=f"number {number} of the list", value=word[:40], expected="a number")
    size = form.values_per_point
    if len(words) % size:
        raise DescriptionError(f"{len(words)} numbers are no whole number of points of {size}", file=path)
    values = np.array([float(word.lower().replace(".nan", "nan").replace(".inf", "inf")) for word in words])
    values = np.where(np.isfinite(values), values, np.nan).reshape(-1, size)
    table = {axis: values[:, int(c) - 1] for axis, c in (("x", form.x.column), ("z", form.z.column)) if c is not None}
    points = [table["x"], np.zeros(len(values)), table["z"]]
    return profile_table(path, form, points, np.ones(len(values)), None, None, True)


def _image(path: Path, form: FormatDescription) -> ProfileTable:
    """A range image: rows are profiles, values are heights."""
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if image is None or image.ndim != 2 or image.dtype != np.uint16:
        found = "no image that can be read" if image is None else f"{image.dtype} of shape {image.shape}"
        raise DescriptionError(file=path, value=found, expected="one channel of 16 bits")
    return _of_grid(path, form, image.astype(float), None, None, None)


_READERS: Mapping[str, Callable[[Path, FormatDescription], ProfileTable]] = {
    "points": _points,
    "profiles_in_rows": _rows,
    "profiles_in_columns": _columns,
    "sequence": _sequence,
    "image": _image,
}
