"""Fixtures: FMUs of the test cell, packed and unpacked once."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from cell_fixture import Build, CellFmu, FmuFolders, Parameters, cell_description


@pytest.fixture(scope="session")
def folders(tmp_path_factory: pytest.TempPathFactory) -> FmuFolders:
    return FmuFolders(tmp_path_factory.mktemp("fmu"))


@pytest.fixture
def build(folders: FmuFolders) -> Iterator[Build]:
    """Start instances and free them after the test."""
    running: list[CellFmu] = []

    def start(
        version: int = 3, cell: dict[str, Any] | None = None, parameters: Parameters | None = None, **options: Any
    ) -> CellFmu:
        folder = folders.unpacked(version, cell or cell_description())
        running.append(CellFmu(folder, parameters, options=options))
        return running[-1]

    yield start
    for instance in running:
        instance.close()
