"""Fixtures: FMUs of the test cell, packed and unpacked once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from cell_fixture import Build, CellFmu, FmuFolders, Parameters, cell_description


@pytest.fixture(scope="session")
def folders(tmp_path_factory: pytest.TempPathFactory) -> FmuFolders:
    return FmuFolders(tmp_path_factory.mktemp("fmu"))


@pytest.fixture
def open_fmu() -> Iterator[Build]:
    """Start instances of unpacked FMUs and free them after the test."""
    with ExitStack() as running:

        def start(folder: Path, parameters: Parameters | None = None, **arguments: Any) -> CellFmu:
            cell = CellFmu(folder, parameters, **arguments)
            running.callback(cell.close)
            return cell

        yield start


@pytest.fixture
def build(folders: FmuFolders, open_fmu: Build) -> Build:
    """Start instances of a cell description and free them after the test; options are those of `instantiate`."""

    def start(
        version: int = 3,
        cell: dict[str, Any] | None = None,
        parameters: Parameters | None = None,
        variants: Sequence[str] = (),
        **options: Any,
    ) -> CellFmu:
        return open_fmu(folders.unpacked(version, cell or cell_description(), *variants), parameters, options=options)

    return start
