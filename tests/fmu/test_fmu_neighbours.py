"""Several FMUs in one process: of one build in two folders, and of two builds."""

from __future__ import annotations

import re
import shutil
import threading
from pathlib import Path

import numpy as np
import pytest
from cell_fixture import FREE, Array, CellFmu, FmuFolders, all_reals, continue_motion

ROUNDS = 5


def run_fmu(folder: Path) -> Array:
    """Rotate the table with a free part on it; return all values at the end."""
    cell = CellFmu(folder)
    cell.command(table=0.0)
    continue_motion(cell)
    end = all_reals(cell)
    cell.close()
    return end


def loaded_libraries(name: str) -> set[str]:
    """Paths of the loaded libraries whose name starts with `name`; the files may have been deleted."""
    lines = [line for line in Path("/proc/self/maps").read_text().splitlines() if "r-xp" in line]
    paths = {line[line.index("/") :].removesuffix(" (deleted)") for line in lines if "/" in line}
    return {path for path in paths if Path(path).name.startswith(name)}


def bundled_libraries(folder: Path, name: str) -> set[str]:
    """Names of the libraries in an unpacked FMU that start with `name`."""
    return {path.name for path in (folder / "binaries").glob("*/*") if path.name.startswith(name)}


def loaded_fmu_folders() -> set[Path]:
    """Folders of FMUs whose own binary is loaded; its libraries may come from another folder of the same build."""
    return {Path(path).parents[2] for path in loaded_libraries("RobotCell.so")}


@pytest.fixture(scope="module")
def two_folders(folders: FmuFolders) -> tuple[Path, Path]:
    """One build, packed for both FMI versions."""
    return folders.unpacked(2, FREE), folders.unpacked(3, FREE)


@pytest.fixture(scope="module")
def two_builds(folders: FmuFolders, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """An FMU, and a copy whose libraries are named as those of another build."""
    first = folders.unpacked(3, FREE)
    second = tmp_path_factory.mktemp("other") / "build"
    shutil.copytree(first, second)
    for library in list((second / "binaries/x86_64-linux").iterdir()):
        content = re.sub(rb"-[0-9a-f]{8}\.so", b"-00000000.so", library.read_bytes())
        library.unlink()
        (library.parent / re.sub(r"-[0-9a-f]{8}\.so", "-00000000.so", library.name)).write_bytes(content)
    return first, second


@pytest.mark.parametrize("neighbours", ["two_folders", "two_builds"])
def test_parallel_instances_are_bit_identical_to_serial_ones(neighbours: str, request: pytest.FixtureRequest) -> None:
    """ODE's process-wide state must be protected, whichever binaries share it."""
    pair: tuple[Path, Path] = request.getfixturevalue(neighbours)
    alone = run_fmu(pair[0])
    results: list[Array] = []

    def work(folder: Path) -> None:
        results.extend(run_fmu(folder) for _ in range(ROUNDS))

    threads = [threading.Thread(target=work, args=(folder,)) for folder in pair]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(results) == 2 * ROUNDS
    for result in results:
        np.testing.assert_array_equal(result, alone)


def test_two_builds_step_alternately_without_interference(two_builds: tuple[Path, Path]) -> None:
    alone = run_fmu(two_builds[0])
    cells = [CellFmu(folder) for folder in two_builds]
    assert set(two_builds) <= loaded_fmu_folders()
    for library in ("libdart-", "libode-", "librobotcell_locks-"):
        first, second = (bundled_libraries(folder, library) for folder in two_builds)
        assert first.isdisjoint(second)
        assert first | second <= {Path(path).name for path in loaded_libraries(library)}  # each build has its own
    for cell in cells:
        cell.command(table=0.0)
    for k in range(40):
        for cell in cells:
            cell.command(np.radians([35, -25, 195, -68, 79, -10]) + 0.1 * np.sin(0.1 * k), 3.0 + 0.02 * k)
            cell.step(8000)
    for cell in cells:
        cell.step(330)
        np.testing.assert_array_equal(all_reals(cell), alone)
        cell.close()
    # After one is freed, the other still works.
    np.testing.assert_array_equal(run_fmu(two_builds[1]), alone)


def test_one_build_in_two_folders_shares_engine_and_locks(two_folders: tuple[Path, Path]) -> None:
    """Libraries are shared together with the locks that protect them."""
    cells = [CellFmu(folder) for folder in two_folders]
    assert set(two_folders) <= loaded_fmu_folders()
    for library in ("libode-", "librobotcell_locks-"):
        (name,) = bundled_libraries(two_folders[0], library)
        assert bundled_libraries(two_folders[1], library) == {name}
        assert sum(Path(path).name == name for path in loaded_libraries(library)) == 1
    for cell in cells:
        cell.close()
