"""Tables of measurements (CSV, Parquet, YAML) whose errors name file, column and row."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
from numpy.typing import NDArray

from scancell.cell.recording import read_table
from scancell.errors import DescriptionError
from scancell.extras import require
from scancell.files import atomic_write, read_text, require_file
from scancell.text_table import MISSING, read_text_table

Array = NDArray[np.float64]

_YAML = (".yaml", ".yml")
_LARGEST = 1e12  # of any unit


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
        wrong = np.flatnonzero(np.where(np.isnan(values), needed, np.abs(values) > _LARGEST))
        if len(wrong):
            self.refuse(int(wrong[0]), name, f"a finite number from {-_LARGEST:g} to {_LARGEST:g}")
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
