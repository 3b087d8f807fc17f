"""Columns of points in temporary files."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import pytest

from scancell.errors import OutputError
from scancell.scanning.sense import StoredColumns


@dataclass
class Points:
    xyz: np.ndarray
    camera: np.ndarray
    bright: np.ndarray


def points(n: int, seed: int = 0) -> Points:
    rng = np.random.default_rng(seed)
    return Points(rng.normal(size=(n, 3)), rng.integers(0, 2, n, dtype=np.int32), rng.uniform(size=n) > 0.5)


def test_joined_columns_are_the_parts_in_order_with_their_types() -> None:
    stored, parts = StoredColumns(Points), [points(n, n) for n in (3, 0, 500)]
    for part in parts:
        stored.append(part)
    joined = stored.joined()
    for field in fields(Points):
        wanted = np.concatenate([getattr(part, field.name) for part in parts])
        found = getattr(joined, field.name)
        np.testing.assert_array_equal(found, wanted)
        assert found.dtype == wanted.dtype


def test_rows_of_another_memory_order_are_stored() -> None:
    stored, part = StoredColumns(Points), points(40)
    stored.append(Points(np.asfortranarray(part.xyz), part.camera, part.bright))
    np.testing.assert_array_equal(stored.joined().xyz, part.xyz)


def test_arrays_outlive_the_store_and_its_files_are_gone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    stored = StoredColumns(Points)
    stored.append(points(10))
    xyz = stored.joined().xyz
    del stored
    np.testing.assert_array_equal(xyz, points(10).xyz)
    assert list(tmp_path.iterdir()) == []


def test_no_rows_give_empty_columns() -> None:
    stored = StoredColumns(Points)
    stored.append(points(0))
    assert stored.joined().xyz.shape == (0, 3)


def test_folder_that_cannot_be_written_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "missing"))
    with pytest.raises(OutputError, match="missing"):
        StoredColumns(Points).append(points(1))
