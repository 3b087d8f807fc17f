"""What a track is: cases with inputs and truth, the columns of a result, and its score."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Table = dict[str, NDArray[Any]]

_LARGEST = 1e9


class ResultError(ValueError):
    """A result that cannot be scored."""


@dataclass(frozen=True)
class Case:
    """A problem of a track.

    Attributes
    ----------
    name
        Name of its folder and of its result.
    inputs
        What an entry gets: images (n, height, width) of unsigned integers, tables (columns of equal length), and values
        that JSON can hold.
    truth
        What only the score knows.
    """

    name: str
    inputs: Mapping[str, Any]
    truth: Mapping[str, Any]


Outcome = tuple[Case, Table | None]


@dataclass(frozen=True)
class Track:
    """A track.

    Attributes
    ----------
    name
        Of the track, and of the function of an entry.
    columns, optional
        Columns that a result has, and those that it may have. A column `name` holds text, all others finite numbers.
    cases
        Cases of a seed; the second argument is their number.
    check
        Raises `ResultError` if a result is not one of its case.
    summary
        Figures of an entry, from cases with their results, None where there is none. The first one ranks, least first.
    default_cases, limit
        Number of cases, and seconds that an entry may take for one.
    """

    name: str
    columns: tuple[str, ...]
    optional: tuple[str, ...]
    cases: Callable[[int, int], list[Case]]
    check: Callable[[Case, Table], None]
    summary: Callable[[Sequence[Outcome]], dict[str, float]]
    default_cases: int
    limit: float = 60.0


def table_of(track: Track, given: Any) -> Table:
    """The columns of a result as arrays; raises `ResultError` where something is missing, ragged or not finite."""
    if not isinstance(given, Mapping):
        raise ResultError(f"returned {type(given).__name__}, expected a dict of columns {', '.join(track.columns)}")
    allowed = (*track.columns, *track.optional)
    missing = [name for name in track.columns if name not in given]
    unknown = [str(name) for name in given if name not in allowed]
    if missing or unknown:
        raise ResultError(f"columns {', '.join(map(str, given))}: expected {', '.join(allowed)}")
    table: Table = {name: _column(name, given[name]) for name in allowed if name in given}
    lengths = {name: len(column) for name, column in table.items()}
    if len(set(lengths.values())) > 1:
        raise ResultError(f"columns of different lengths: {lengths}")
    return table


def _column(name: str, values: Any) -> NDArray[Any]:
    if name == "name":
        return np.array([str(value) for value in values], dtype=str)
    try:
        column = np.asarray(values, float)
    except (TypeError, ValueError) as error:
        raise ResultError(f"{name}: {error}") from None
    if column.ndim != 1:
        raise ResultError(f"{name} has shape {column.shape}, expected one dimension")
    usable = np.isfinite(column) & (np.abs(column) <= _LARGEST)
    if not usable.all():
        raise ResultError(f"{name} has {int((~usable).sum())} values that are not finite, or beyond {_LARGEST:g}")
    return column


def named_values(table: Table, names: Sequence[str], column: str) -> Array:
    """Values of a column in the order of `names`, which are those of the column `name`."""
    rows = {str(name): row for row, name in enumerate(table["name"])}
    if len(rows) != len(table["name"]) or set(rows) != set(names):
        raise ResultError(f"names {', '.join(map(str, table['name']))}: expected {', '.join(names)}")
    return np.asarray(table[column], float)[[rows[name] for name in names]]


def median_error(errors: Sequence[float]) -> float:
    """Median of errors, of which some may be infinite; of an even number the larger one in the middle."""
    return float(np.sort(errors)[len(errors) // 2])


def coverage(inside: Sequence[NDArray[np.bool_]]) -> float:
    """Share of intervals that contain the truth, per cent; NaN if none is stated."""
    return 100 * float(np.concatenate(inside).mean()) if inside else np.nan
