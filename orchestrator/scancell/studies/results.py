"""Tables: results and timings of a study by trial, and the index of a batch."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet

from scancell.files import atomic_write

KEYS = ("trial", "seed", "engine", "status", "message")
INDEX_KEYS = (
    *("scan", "part", "variant", "mesh", "mesh_sha256"),
    *("seed", "engine", "status", "message", "as_built", "scancell"),
)


def results_table(rows: Sequence[dict[str, Any]], labels: Sequence[str]) -> pa.Table:
    """All rows by trial number: number, seed, engine, status, message, drawn values by factor, figures by name."""
    ordered = sorted(rows, key=lambda row: int(row["number"]))
    return _table(_columns(ordered, KEYS, labels))


def index_table(rows: Sequence[dict[str, Any]], labels: Sequence[str], folder: str) -> pa.Table:
    """All scans of a batch: their rows, and under ``file.NAME`` each file's path, which begins with `folder`."""
    columns = _columns(rows, INDEX_KEYS, labels)
    for name in sorted({file for row in rows for file in row["files"]}):
        columns[f"file.{name}"] = [f"{folder}/{row['scan']}/{name}" if name in row["files"] else None for row in rows]
    table = _table(columns)
    as_built = pa.array(columns["as_built"], pa.list_(pa.string()))  # lists that are all empty have no type
    return table.set_column(table.column_names.index("as_built"), "as_built", as_built)


def _columns(rows: Sequence[dict[str, Any]], keys: Sequence[str], labels: Sequence[str]) -> dict[str, list[Any]]:
    """The keys of the rows, drawn values by factor, figures by name; ``trial`` and ``variant`` are the row's number."""
    named = {"trial": "number", "variant": "number"}
    columns: dict[str, list[Any]] = {key: [row[named.get(key, key)] for row in rows] for key in keys}
    for j, label in enumerate(labels):
        columns[label] = _one_type([row["values"][j] for row in rows])
    for name in dict.fromkeys(name for row in rows for name in row["figures"]):
        columns[name] = _one_type([row["figures"].get(name) for row in rows])
    return columns


def _table(columns: dict[str, list[Any]]) -> pa.Table:
    return pa.table({name: pa.array(values) for name, values in columns.items()})


def timings_table(timings: Sequence[dict[str, Any]]) -> pa.Table:
    """Seconds by station, worker and its memory, by trial."""
    flat = [
        {
            **{key: value for key, value in row.items() if key != "seconds"},
            **{f"{name}_s": value for name, value in row["seconds"].items()},
        }
        for row in sorted(timings, key=lambda row: int(row["trial"]))
    ]
    names = list(dict.fromkeys(name for row in flat for name in row))
    return _table({name: [row.get(name) for row in flat] for name in names})


def write_table(table: pa.Table, path: Path) -> None:
    """Write Parquet atomically.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    with atomic_write(path) as temporary:
        pyarrow.parquet.write_table(table, temporary)


def _one_type(values: list[Any]) -> list[Any]:
    """Values of a column in one type: numbers unchanged, mixtures with text as text."""
    kinds = {type(value) for value in values if value is not None}
    if len(kinds) <= 1:
        return values
    if kinds <= {int, float}:
        return [None if value is None else float(value) for value in values]
    return [None if value is None else str(value) for value in values]
