"""The commands of docs/fmu/tools.md: the same scan in FMPy, libcosim and an importer in C, rendered in the end."""

from __future__ import annotations

import csv
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import fmpy
import numpy as np
import pytest
from commands import PATIENCE_S, environment

from bench.peers.check import PeerMissingError
from bench.peers.importers import ImporterTools
from scancell import Recording, read_recording

ROOT = Path(__file__).parents[2]
BLOCKS = re.findall(r"```(sh|python)\n(.*?)```", (ROOT / "docs/fmu/tools.md").read_text(), re.S)
ABOVE_PART = (0.0, -1.0278, 3.5967, 0.0, 0.5727, 0.5236)  # rad
INTERVAL, TURN = 0.1, 6.2832  # rad


def run_block(word: str, folder: Path, python: Path = Path(sys.executable)) -> None:
    """Run the block of the page that contains `word`; `python` is what the block calls by this name."""
    ((language, text),) = [block for block in BLOCKS if word in block[1]]
    command = ["bash", "-e", "-c", text] if language == "sh" else [sys.executable, "-c", text]
    path = os.pathsep.join([str(python.parent), str(Path(sys.executable).parent), os.environ["PATH"]])
    done = subprocess.run(
        command, cwd=folder, env=environment(PATH=path), capture_output=True, text=True, check=False, timeout=PATIENCE_S
    )
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The FMU of the page beside the repository's folders."""
    folder = tmp_path_factory.mktemp("tools")
    for name in ("assets", "docs", "fmu"):
        (folder / name).symlink_to(ROOT / name)
    run_block("build --fmi 2 --integers", folder)
    return folder


@pytest.fixture(scope="module")
def by_c(folder: Path) -> Recording:
    run_block("scan_cell.c", folder)
    return read_recording((folder / "recording.csv").rename(folder / "by_c.csv"))


def test_importer_in_c_records_a_turn(by_c: Recording) -> None:
    """An exposure at the beginning, and at each whole interval, with the arm at rest above the part."""
    measured = by_c.measured
    angles = INTERVAL * np.arange(int(TURN / INTERVAL) + 1)
    assert list(measured.index) == list(range(1, len(angles) + 1))
    assert set(measured.segment) == {1}
    np.testing.assert_allclose(measured.exposure, 0.0005, rtol=1e-12)
    # An exposure begins at a whole microsecond, and half of it passes until the table is read.
    late = 0.5 * measured.exposure * measured.rates[:, 6] + 1e-6 * measured.rates[:, 6].max()
    np.testing.assert_array_less(np.abs(measured.table - angles), late + 1e-5)
    np.testing.assert_allclose(measured.q, np.tile(ABOVE_PART, (len(angles), 1)), atol=1e-5)  # of the encoders
    np.testing.assert_allclose(measured.rates[:, :6], 0.0, atol=1e-12)


def test_fmpy_records_the_same(folder: Path, by_c: Recording) -> None:
    """By times instead of conditions: the motions are the same, apart from exposures at whole microseconds."""
    run_block("fmpy simulate", folder)
    recording = read_recording(folder / "recording.csv")
    assert len(recording) == len(by_c)
    rate = by_c.measured.rates[:, 6].max()
    np.testing.assert_allclose(recording.measured.q, by_c.measured.q, rtol=0, atol=1e-12)
    np.testing.assert_allclose(recording.measured.table, by_c.measured.table, rtol=0, atol=1e-5)
    for frame in ("sensor", "part[1]"):
        poses = recording.truth_at_middle(frame), by_c.truth_at_middle(frame)
        np.testing.assert_allclose(*poses, rtol=0, atol=2e-6 * rate)


def test_fmpy_in_python_displaces_the_sensor(folder: Path, by_c: Recording) -> None:
    """The deviation on the page, 0.1 mm in the mount of the sensor, is in the true poses alone."""
    run_block("simulate_fmu", folder)
    recording = read_recording(folder / "recording.csv")
    np.testing.assert_allclose(recording.measured.q, by_c.measured.q, rtol=0, atol=1e-4)  # another seed
    moved = recording.truth_at_middle("sensor")[:, :3, 3] - by_c.truth_at_middle("sensor")[:, :3, 3]
    np.testing.assert_allclose(np.linalg.norm(moved, axis=1), 1e-4, rtol=1e-6)


def test_libcosim_records_the_same(folder: Path, by_c: Recording) -> None:
    """The same calls at the same times: the same rows."""
    tools = ImporterTools(Path(os.environ.get("SCANCELL_IMPORTERS", ROOT / "build/importers")))
    try:
        python = tools.python()
    except PeerMissingError as missing:
        if os.environ.get("CI"):
            raise
        pytest.skip(str(missing))
    run_block("scan_libcosim", folder, python)
    recording = read_recording(folder / "recording.csv")
    assert list(recording.columns) == list(by_c.columns)
    for name, values in by_c.columns.items():
        np.testing.assert_allclose(recording.columns[name], values, rtol=0, atol=1e-12, err_msg=name)


@pytest.mark.usefixtures("by_c")
def test_recording_becomes_images_and_cloud(folder: Path) -> None:
    """`scancell render` of every 32nd exposure: the points lie on the part."""
    with (folder / "by_c.csv").open(newline="") as file:
        header, *rows = csv.reader(file)
    with (folder / "recording.csv").open("w", newline="") as file:
        csv.writer(file).writerows([header, *rows[::32]])
    run_block("scancell render", folder)
    out = folder / "out/render"
    assert len(list((out / "images").glob("raw_*.png"))) >= len(rows[::32])
    deviation = json.loads((out / "deviation.json").read_text())["all"]
    assert deviation["count"] > 1000
    assert deviation["rms_um"] <= 10.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "arguments: expected the folder"),
        (("nowhere", "out.csv"), "nowhere: no such folder"),
        (("docs", "out.csv"), "modelDescription.xml: cannot be read"),
        (("cell", "nowhere/out.csv"), "nowhere/out.csv: cannot be written"),
    ],
)
@pytest.mark.usefixtures("by_c")  # made the program
def test_importer_in_c_states_error(folder: Path, arguments: tuple[str, ...], message: str) -> None:
    done = subprocess.run(["./scan_cell", *arguments], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert message in done.stderr


def test_start_value_starts_motion(folder: Path) -> None:
    """As in the window of FMPy: the arm stays where the page's FMU begins, and the table turns once."""
    run_block("build --fmi 2 --set", folder)
    text = (ROOT / "docs/fmu/tools.md").read_text()
    values = dict(
        re.findall(r"`(command\.[\w.]+)` ([\d.]+\d|\d)", text.split("In the column *Start*:")[1].split("\n3.")[0])
    )
    assert len(values) == 7
    fmu = folder / "fmus/above_part/RobotCell2.fmu"
    rows = fmpy.simulate_fmu(str(fmu), start_values=values, stop_time=10.0, output_interval=0.016)
    assert rows["trigger.index"][-1] == rows["trigger.count"][-1] == int(TURN / INTERVAL) + 1
    for joint, angle in enumerate(ABOVE_PART, start=1):
        np.testing.assert_allclose(rows[f"measured.q[{joint}]"], angle, rtol=0, atol=1e-4)
