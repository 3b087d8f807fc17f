"""FMUs of the test cell, packed and unpacked once."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import fmpy
import pytest
from cell_fixture import CellFmu, Parameters, cell_description, pack

Build = Callable[..., CellFmu]


class FmuFolders:
    """Unpacked FMUs by version and cell; the same cell is packed once."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self._known: list[tuple[int, dict[str, Any], Path, Path]] = []

    def packed(self, version: int, cell: dict[str, Any]) -> tuple[Path, Path]:
        for known_version, known_cell, file, folder in self._known:
            if known_version == version and known_cell == cell:
                return file, folder
        file = pack(cell, version, self._root / f"RobotCell{version}-{len(self._known)}.fmu")
        folder = Path(fmpy.extract(str(file), str(file.with_suffix(""))))
        self._known.append((version, cell, file, folder))
        return file, folder


@pytest.fixture(scope="session")
def folders(tmp_path_factory: pytest.TempPathFactory) -> FmuFolders:
    return FmuFolders(tmp_path_factory.mktemp("fmu"))


@pytest.fixture
def build(folders: FmuFolders) -> Iterator[Build]:
    """Starts instances, and frees them after the test."""
    running: list[CellFmu] = []

    def start(
        version: int = 3,
        cell: dict[str, Any] | None = None,
        parameters: Parameters | None = None,
        **options: Any,
    ) -> CellFmu:
        _, folder = folders.packed(version, cell or cell_description())
        running.append(CellFmu(folder, parameters, options=options))
        return running[-1]

    yield start
    for instance in running:
        instance.close()
