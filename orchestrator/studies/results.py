"""The table of a study: one row per trial, and how long each took in a table of its own."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet

from orchestrator.files import atomic_write

KEYS = ("trial", "seed", "engine", "status", "message")


def results_table(rows: Sequence[dict[str, Any]], labels: Sequence[str]) -> pa.Table:
    """All rows by trial number: number, seed, engine, status, message, drawn values by factor, figures by name."""
    ordered = sorted(rows, key=lambda row: int(row["number"]))
    named = {"trial": "number"}
    columns: dict[str, list[Any]] = {key: [row[named.get(key, key)] for row in ordered] for key in KEYS}
    for j, label in enumerate(labels):
        columns[label] = _alike([row["values"][j] for row in ordered])
    figures = list(dict.fromkeys(name for row in ordered for name in row["figures"]))
    for name in figures:
        columns[name] = _alike([row["figures"].get(name) for row in ordered])
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
    return pa.table({name: pa.array([row.get(name) for row in flat]) for name in names})


def write_table(table: pa.Table, path: Path) -> None:
    """Write Parquet; the file appears whole or not at all.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    with atomic_write(path) as temporary:
        pyarrow.parquet.write_table(table, temporary)


def _alike(values: list[Any]) -> list[Any]:
    """Values of one column in one type: numbers as they are, mixtures with text as text."""
    kinds = {type(value) for value in values if value is not None}
    if len(kinds) <= 1:
        return values
    if kinds <= {int, float}:
        return [None if value is None else float(value) for value in values]
    return [None if value is None else str(value) for value in values]
