"""FMUs with a binary for Windows: their contents, and the same calls on Linux and under Wine."""

from __future__ import annotations

import json
import re
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest
from cell_fixture import CYCLE_US, cell_description, runtime_folder
from played_calls import (
    SCENARIOS,
    Calls,
    Player,
    continued,
    differences,
    make_player,
    missing_for_wine,
    normal_forces,
)

from scancell.cell.fmu_file import FmiVersion, description_text, make_temporary_fmu
from scancell.cell.fmu_package import FmuOptions, fmu_contents, sequencer_contents, write_archive

VERSIONS: tuple[FmiVersion, ...] = (2, 3)
WINDOWS_FOLDER = {2: "win64", 3: "x86_64-windows"}

needs_wine = pytest.mark.skipif(missing_for_wine() is not None, reason=str(missing_for_wine()))
needs_sequencer = pytest.mark.skipif(
    missing_for_wine("CellSequencer") is not None, reason=str(missing_for_wine("CellSequencer"))
)


@pytest.fixture(scope="module")
def runtime(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Copy of the runtime with binaries for Windows that are not programs."""
    folder = tmp_path_factory.mktemp("runtime") / "runtime"
    shutil.copytree(runtime_folder(), folder, ignore=shutil.ignore_patterns("windows"))
    windows = folder / "windows"
    (windows / "licenses").mkdir(parents=True)
    parts = [{"source": name, "license": "Zlib", "text": f"{name}.txt"} for name in ("own", "engine")]
    (windows / "components.json").write_text(json.dumps({"RobotCell.dll": parts, "CellSequencer.dll": parts[:1]}))
    for name in ("RobotCell", "CellSequencer"):
        (windows / f"{name}.dll").write_bytes(b"MZ" + name.encode())
    for part in parts:
        (windows / "licenses" / part["text"]).write_text(f"Copyright of {part['source']}")
    return folder


@pytest.fixture(scope="module", params=VERSIONS)
def version(request: pytest.FixtureRequest) -> FmiVersion:
    return 2 if request.param == 2 else 3


def contents_of(runtime: Path, version: FmiVersion) -> dict[str, bytes]:
    return fmu_contents(runtime, description_text(cell_description()), version, FmuOptions())


@pytest.fixture(scope="module")
def contents(runtime: Path, version: FmiVersion) -> dict[str, bytes]:
    return contents_of(runtime, version)


def test_binary_for_windows_is_added_at_standard_location(
    contents: dict[str, bytes], tmp_path: Path, version: FmiVersion
) -> None:
    write_archive(tmp_path / "RobotCell.fmu", contents)
    with zipfile.ZipFile(tmp_path / "RobotCell.fmu") as archive:
        assert archive.read(f"binaries/{WINDOWS_FOLDER[version]}/RobotCell.dll") == b"MZRobotCell"
        windows = [name for name in archive.namelist() if name.endswith(".dll")]
    assert len(windows) == 1
    licenses = contents["documentation/licenses/license.txt"].decode().splitlines()
    assert [line for line in licenses if line.startswith("RobotCell.dll: ")] == [
        "RobotCell.dll: own; Zlib; own.txt", "RobotCell.dll: engine; Zlib; engine.txt",
    ]  # fmt: skip
    assert contents["documentation/licenses/engine.txt"] == b"Copyright of engine"
    for text in ("modelDescription.xml", "documentation/index.html", "documentation/externalDependencies.txt"):
        assert "64-bit x86 Windows" in contents[text].decode()


def test_only_texts_change_with_binary_for_windows(
    runtime: Path, contents: dict[str, bytes], tmp_path: Path, version: FmiVersion
) -> None:
    without = tmp_path / "runtime"
    shutil.copytree(runtime, without, ignore=shutil.ignore_patterns("windows"))
    linux = contents_of(without, version)
    changed = {name for name, content in linux.items() if contents[name] != content}
    assert changed == {
        "modelDescription.xml", "documentation/index.html", "documentation/externalDependencies.txt",
        "documentation/licenses/license.txt",
    }  # fmt: skip
    assert not any(b"Windows" in linux[name] for name in changed)
    assert [name for name in contents if name in linux] == list(linux)


def test_sequencer_lists_its_own_components(runtime: Path) -> None:
    contents = sequencer_contents(runtime, description_text(cell_description()))
    assert contents["binaries/win64/CellSequencer.dll"] == b"MZCellSequencer"
    lines = contents["documentation/licenses/license.txt"].decode().splitlines()
    assert [line for line in lines if ".dll" in line] == ["CellSequencer.dll: own; Zlib; own.txt"]
    assert "documentation/licenses/engine.txt" not in contents


@pytest.fixture(scope="module")
def linux(tmp_path_factory: pytest.TempPathFactory) -> Player:
    return make_player(tmp_path_factory.mktemp("linux"), wine=False)


@pytest.fixture(scope="module")
def wine(tmp_path_factory: pytest.TempPathFactory) -> Player:
    """With a new Wine prefix."""
    return make_player(tmp_path_factory.mktemp("wine"), wine=True)


@needs_wine
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_outputs_under_wine_equal_those_on_linux(
    tmp_path: Path, linux: Player, wine: Player, version: FmiVersion, scenario: str
) -> None:
    chosen = SCENARIOS[scenario]
    calls = chosen.calls(make_temporary_fmu(chosen.cell(), tmp_path / "fmu", version))
    (expected, _), (found, _) = linux.play(calls), wine.play(calls)
    assert np.ptp(expected, axis=0).max() > 0.1
    apart, other_events = differences(calls, expected, found)
    assert apart.max() <= chosen.tolerance
    assert other_events.size == 0
    np.testing.assert_allclose(normal_forces(calls, found), normal_forces(calls, expected), rtol=0, atol=1e-3)


@needs_wine
@pytest.mark.parametrize("towards_windows", [False, True])
def test_states_continue_on_other_system(
    tmp_path: Path, linux: Player, wine: Player, version: FmiVersion, towards_windows: bool
) -> None:
    players = (linux, wine) if towards_windows else (wine, linux)
    chosen = SCENARIOS["part slides"]
    calls = chosen.calls(make_temporary_fmu(chosen.cell(), tmp_path / "fmu", version))
    apart, other_events = differences(calls, *continued(calls, *players, row=50))
    assert apart.max() <= chosen.tolerance
    assert other_events.size == 0


def write_sequencer(folder: Path) -> Path:
    """Model description and resources of the unpacked FMU of the sequencer."""
    contents = sequencer_contents(runtime_folder(), description_text(cell_description()))
    (folder / "resources").mkdir(parents=True)
    for name in ("modelDescription.xml", "resources/cell.json"):
        (folder / name).write_bytes(contents[name])
    return folder


@needs_sequencer
def test_wrong_token_is_rejected_with_message_under_wine(tmp_path: Path, wine: Player) -> None:
    calls = Calls(write_sequencer(tmp_path / "fmu"))
    calls.token = "{else}"
    with pytest.raises(RuntimeError, match=f"wrong GUID, expected {re.escape(calls.description.guid)}"):
        wine.play(calls)


@needs_sequencer
def test_sequencer_under_wine_commands_the_same_as_on_linux(tmp_path: Path, linux: Player, wine: Player) -> None:
    """In a folder whose name is outside the code page."""
    steps = {"steps": 2, "step[1].duration": 0.1, "step[1].q[2]": -0.3, "step[2].duration": 0.2, "step[2].table": 1 / 3}
    calls = Calls(write_sequencer(tmp_path / "cell \N{GREEK SMALL LETTER LAMDA} \N{CJK UNIFIED IDEOGRAPH-4E2D}"), steps)
    calls.step(CYCLE_US, 15)
    calls.set("controller.at_destination", True)
    calls.step(CYCLE_US, 25)
    (expected, _), (found, _) = linux.play(calls), wine.play(calls)
    assert np.ptp(expected[:, 1 + calls.names.index("command.table")]) > 0.3
    np.testing.assert_array_equal(found, expected)
