"""FMUs beside each other in one process: of one build in two folders, and of two builds."""

from __future__ import annotations

import re
import shutil
import threading
from pathlib import Path

import numpy as np
import pytest
from cell_fixture import Array, CellFmu, FmuFolders, all_reals, cell_description, continue_motion, pose

FREE = cell_description(fixture="free", support_from_part=pose([0.06, 0.02, 0]))
ROUNDS = 5


def run(folder: Path) -> Array:
    """A part rides on the turning table; all values at the end."""
    cell = CellFmu(folder)
    cell.command(table=0.0)
    continue_motion(cell)
    end = all_reals(cell)
    cell.close()
    return end


def loaded(name: str) -> set[str]:
    """Paths of the libraries in this process whose name begins so; their files may be gone since."""
    lines = [line for line in Path("/proc/self/maps").read_text().splitlines() if "r-xp" in line]
    paths = {line[line.index("/") :].removesuffix(" (deleted)") for line in lines if "/" in line}
    return {path for path in paths if Path(path).name.startswith(name)}


def packed(folder: Path, name: str) -> set[str]:
    """Names of the libraries in an unpacked FMU that begin so."""
    return {path.name for path in (folder / "binaries").glob("*/*") if path.name.startswith(name)}


def homes() -> set[Path]:
    """Unpacked FMUs whose own binary is loaded; the libraries that it needs may come from another of its build."""
    return {Path(path).parents[2] for path in loaded("RobotCell.so")}


@pytest.fixture(scope="module")
def two_folders(folders: FmuFolders) -> tuple[Path, Path]:
    """One build, packed for either version."""
    return folders.unpacked(2, FREE), folders.unpacked(3, FREE)


@pytest.fixture(scope="module")
def two_builds(folders: FmuFolders, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The FMU, and it with the libraries named as those of another build are."""
    first = folders.unpacked(3, FREE)
    second = tmp_path_factory.mktemp("other") / "build"
    shutil.copytree(first, second)
    for library in list((second / "binaries/x86_64-linux").iterdir()):
        content = re.sub(rb"-[0-9a-f]{8}\.so", b"-00000000.so", library.read_bytes())
        library.unlink()
        (library.parent / re.sub(r"-[0-9a-f]{8}\.so", "-00000000.so", library.name)).write_bytes(content)
    return first, second


@pytest.mark.parametrize("neighbours", ["two_folders", "two_builds"])
def test_in_parallel_threads_each_gives_the_bits_it_gives_alone(
    neighbours: str, request: pytest.FixtureRequest
) -> None:
    """ODE's state for the whole process must be kept apart, whichever binaries share it."""
    pair: tuple[Path, Path] = request.getfixturevalue(neighbours)
    alone = run(pair[0])
    results: list[Array] = []

    def work(folder: Path) -> None:
        results.extend(run(folder) for _ in range(ROUNDS))

    threads = [threading.Thread(target=work, args=(folder,)) for folder in pair]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(results) == 2 * ROUNDS
    for result in results:
        np.testing.assert_array_equal(result, alone)


def test_two_builds_step_in_turn_without_disturbing_each_other(two_builds: tuple[Path, Path]) -> None:
    alone = run(two_builds[0])
    cells = [CellFmu(folder) for folder in two_builds]
    assert set(two_builds) <= homes()
    for library in ("libdart-", "libode-", "librobotcell_locks-"):
        first, second = (packed(folder, library) for folder in two_builds)
        assert first.isdisjoint(second)
        assert first | second <= {Path(path).name for path in loaded(library)}  # each has its own
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
    # When one has gone, the other still works.
    np.testing.assert_array_equal(run(two_builds[1]), alone)


def test_one_build_in_two_folders_shares_the_engine_and_its_locks(two_folders: tuple[Path, Path]) -> None:
    """Sharing all or nothing: the locks guard what is shared."""
    cells = [CellFmu(folder) for folder in two_folders]
    assert set(two_folders) <= homes()
    for library in ("libode-", "librobotcell_locks-"):
        (name,) = packed(two_folders[0], library)
        assert packed(two_folders[1], library) == {name}
        assert sum(Path(path).name == name for path in loaded(library)) == 1
    for cell in cells:
        cell.close()
