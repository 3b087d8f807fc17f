"""Tables of measurements (CSV, Parquet) whose errors name file, column and row."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
from numpy.typing import NDArray

from scancell.cell.recording import read_table
from scancell.errors import DescriptionError
from scancell.files import atomic_write

Array = NDArray[np.float64]


class MeasuredTable:
    """A table by its columns; rows count from 1 in messages, after the header.

    Raises `DescriptionError` if the file is missing, no table, or has no rows.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        # Only an empty field is none: ``nan`` is a value, which messages show.
        self._table = read_table(path, pyarrow.csv.ConvertOptions(null_values=[""], strings_can_be_null=False))
        if not len(self):
            raise DescriptionError("holds no rows below its header", file=path, expected="at least one")

    def __len__(self) -> int:
        return int(self._table.num_rows)

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
        wrong = np.flatnonzero(~np.isfinite(values) & (needed | np.isinf(values)))
        if len(wrong):
            self.refuse(int(wrong[0]), name, "a finite number")
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
        key = f"column '{name}', row {row + 1}"
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
