"""The run folder of a robot program: what it holds, and that pictures, animations, pages and exports take it."""

from __future__ import annotations

import base64
import io
import json
import re
import shutil
import tomllib
import zipfile
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest
from commands import PARTS, QUICK, scancell_here
from PIL import Image

from scancell.geometry import pose
from scancell.reconstruction.cloud_files import read_ply
from scancell.views.recorded_run import RecordedRun, open_archive, open_run

PART = PARTS / "free_form.stl"
EXERCISES = Path(__file__).parents[2] / "docs" / "examples" / "exercises"
CELLS = PARTS.parent / "exercises"
PROGRAM = """
from scancell import Robot, deg, location, mm

def main(robot: Robot) -> None:
    over = location(450 * mm, 0, 215 * mm, rx=180 * deg)
    robot.move_tool(over)
    robot.profile()
    robot.save(robot.scan_line(over @ location(5 * mm, 0, 0), 1 * mm), "first.ply")
    robot.turn_table(90 * deg)
    robot.save(robot.scan_line(over, 1 * mm), "second.ply")
    robot.wait(0.3)
"""
INTO_TABLE = """
from scancell import deg, location, mm

def main(robot):
    robot.move_tool(location(450 * mm, 0, 60 * mm, rx=180 * deg))
"""


def ran(folder: Path, text: str, *words: object, code: int = 0) -> dict:
    """Report of a program."""
    (folder / "program.py").write_text(text)
    done = scancell_here("run", "program.py", *words, *QUICK, "--out", "run", "--json", cwd=folder)
    assert done.code == code, done.err
    return done.last_line


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    place = tmp_path_factory.mktemp("program")
    report = ran(place, PROGRAM, "--part", PART)
    files = ("cloud.ply", "manifest.json", "motion.parquet", "recording.parquet", "resolved.toml")
    assert report["files"] == [f"run/{name}" for name in ("first.ply", "second.ply", *files)]
    (place / "steps.json").write_text(json.dumps(report["figures"]["steps"]))
    return place


@pytest.fixture(scope="module")
def steps(folder) -> list[dict]:
    return json.loads((folder / "steps.json").read_text())


@pytest.fixture(scope="module")
def run(folder) -> RecordedRun:
    return open_run(folder / "run", 10_000_000)


def test_run_lasts_as_long_as_the_program(run, steps) -> None:
    assert run.motion.start == 0.0
    assert run.motion.duration == pytest.approx(steps[-1]["end_s"], abs=1e-9)
    assert run.name == PART.name


def test_robot_and_table_are_where_the_program_brought_them(run, steps) -> None:
    """At the end of every command, in the ideal cell; in between they move without gaps and jumps."""
    over = pose.from_euler_xyz((0.45, 0.0, 0.215), (np.pi, 0.0, 0.0))
    end = {step["command"]: run.motion.frames(step["end_s"]) for step in steps}
    for command, world_from_sensor in (("move_tool", over), ("wait", over)):
        np.testing.assert_allclose(end[command]["sensor"], world_from_sensor, atol=1e-4)
    turned = pose.inverse(run.motion.frames(0.0)["table"]) @ end["turn_table"]["table"]
    np.testing.assert_allclose(turned, pose.from_euler_xyz((0, 0, 0), (0, 0, np.pi / 2)), atol=1e-4)
    assert np.diff(run.motion.times).max() < 0.05
    path = np.array([run.motion.frames(t)["sensor"][:3, 3] for t in np.arange(0, run.motion.duration, 0.005)])
    assert np.linalg.norm(np.diff(path, axis=0), axis=1).max() < 0.02


def test_laser_is_on_at_profiles_and_scans_only(run, steps) -> None:
    assert len(run.motion.exposures) == 1 + 6 + 6
    for step in steps:
        if step["command"] in ("profile", "scan_line"):
            assert run.motion.laser_on((step["begin_s"] + step["end_s"]) / 2)
    turn = next(step for step in steps if step["command"] == "turn_table")
    assert not run.motion.laser_on((turn["begin_s"] + turn["end_s"]) / 2)
    assert not run.motion.laser_on(run.motion.duration)


def test_cloud_is_that_of_all_scans(run, folder) -> None:
    saved = [read_ply(folder / "run" / name) for name in ("first.ply", "second.ply")]
    assert len(run.cloud) == run.cloud_points == sum(map(len, saved))
    points = np.concatenate([cloud.points_in_part for cloud in saved])
    np.testing.assert_allclose(run.cloud.points_in_part.sum(0), points.sum(0), rtol=1e-9)
    assert set(np.round(run.cloud.time, 6)) <= set(np.round(run.motion.exposures, 6))


def test_inputs_are_recorded(folder) -> None:
    made = tomllib.loads((folder / "run" / "resolved.toml").read_text())["run"]
    assert (made["program"], made["part"]) == (str(folder / "program.py"), str(PART))
    manifest = json.loads((folder / "run" / "manifest.json").read_text())
    assert {str(folder / "program.py"), str(PART)} <= set(manifest["inputs"])


def test_all_four_commands_take_the_folder(folder) -> None:
    done = scancell_here("picture", "run", "--size", "320x180", "--out", "a.png", "--json", cwd=folder)
    assert done.code == 0, done.err
    assert Image.open(folder / "a.png").size == (320, 180)
    exposures = pyarrow.parquet.read_table(folder / "run" / "recording.parquet").column("trigger.time").to_numpy()
    assert done.last_line["figures"]["time_s"] == exposures[-1]
    animation = ("--size", "160x120", "--seconds", "0.2", "--fps", "10", "--out", "a.webp")
    done = scancell_here("animate", "run", *animation, "--json", cwd=folder)
    assert done.code == 0, done.err
    assert done.last_line["figures"]["frames"] == 2
    done = scancell_here("page", "run", "--out", "a.html", "--json", cwd=folder)
    assert done.code == 0, done.err
    text = (folder / "a.html").read_text(encoding="utf-8")
    held = json.loads(re.search(r'<script type="application/json" id="run">(.*?)</script>', text, re.DOTALL)[1])
    np.testing.assert_allclose(np.frombuffer(base64.b64decode(held["exposures"]), "<f4"), exposures, rtol=1e-6)
    done = scancell_here("export", "run", "--out", "a.mcap", "--json", cwd=folder)
    assert done.code == 0, done.err
    assert done.last_line["figures"]["points"] == len(read_ply(folder / "run" / "cloud.ply"))


def test_zip_file_of_the_folder_is_the_same_run(run, folder) -> None:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in (folder / "run").iterdir():
            archive.write(file, f"run/{file.name}")
    again = open_archive(content.getvalue(), "run.zip")
    np.testing.assert_array_equal(again.motion.times, run.motion.times)
    np.testing.assert_array_equal(again.motion.exposures, run.motion.exposures)


def test_program_that_measures_nothing_replaces_the_run(tmp_path, folder) -> None:
    """Neither the cloud nor the plan of an earlier run in the folder is shown."""
    shutil.copytree(folder / "run", tmp_path / "run")
    (tmp_path / "run" / "plan.json").write_text("{}")
    ran(tmp_path, "def main(robot):\n    robot.turn_table(0.5)\n")
    run = open_run(tmp_path / "run")
    assert (run.part, run.cloud, len(run.motion.exposures)) == (None, None, 0)
    assert not run.motion.laser_on(0.0)
    for command, file in (("picture", "a.png"), ("page", "a.html"), ("export", "a.mcap")):
        done = scancell_here(command, "run", "--out", file, "--json", cwd=tmp_path)
        assert done.code == 0, done.err
        assert any("no cloud is shown" in warning for warning in done.last_line["warnings"])
        if command == "picture":
            assert done.last_line["figures"]["time_s"] == run.motion.duration


def test_run_of_a_failed_program_shows_where_it_failed(tmp_path) -> None:
    report = ran(tmp_path, INTO_TABLE, code=1)
    assert "held by the guard" in report["error"]["message"]
    run = open_run(tmp_path / "run")
    height = run.motion.frames(run.motion.duration)["sensor"][2, 3]
    assert 0.06 < height < run.motion.frames(0.0)["sensor"][2, 3]


def test_program_without_time_leaves_no_run(tmp_path) -> None:
    assert ran(tmp_path, "def main(robot):\n    pass\n")["files"] == []
    ran(tmp_path, "def main(robot)\n", code=1)
    assert not (tmp_path / "run").exists()


def test_own_cloud_of_a_program_stays(tmp_path) -> None:
    text = PROGRAM.replace("first.ply", "cloud.ply")
    report = ran(tmp_path, text, "--part", PART)
    assert sorted(report["files"]).count("run/cloud.ply") == 1
    run = open_run(tmp_path / "run", 10_000_000)
    assert len(run.cloud) > 100
    assert run.cloud.time.max() < read_ply(tmp_path / "run" / "second.ply").time.min()


@pytest.mark.parametrize(
    ("file", "message"),
    [
        ("motion.parquet", r"run/motion\.parquet: no such file"),
        ("recording.parquet", r"run/recording\.parquet: no such file"),
        ("resolved.toml", r"run: expected a run folder with resolved\.toml and recording\.parquet"),
    ],
)
def test_missing_files_are_named(folder, tmp_path, file: str, message: str) -> None:
    shutil.copytree(folder / "run", tmp_path / "run")
    (tmp_path / "run" / file).unlink()
    for command in ("picture", "animate", "page", "export"):
        done = scancell_here(command, "run", "--json", cwd=tmp_path)
        assert done.code == 1
        assert re.search(message, done.message), done.message


@pytest.mark.parametrize(("line", "shown"), [('part = "', "None"), ('unit = "', "None"), ("part", "3")])
def test_wrong_entries_are_named(folder, tmp_path, line: str, shown: str) -> None:
    shutil.copytree(folder / "run", tmp_path / "run")
    file = tmp_path / "run" / "resolved.toml"
    lines = file.read_text().splitlines()
    start = lines.index("[run]")
    at = next(i for i, text in enumerate(lines) if i > start and text.startswith(line))
    lines[at] = "part = 3" if shown == "3" else ""
    file.write_text("\n".join(lines))
    done = scancell_here("picture", "run", "--json", cwd=tmp_path)
    assert done.code == 1
    key = line.split(maxsplit=1)[0]
    assert done.message == f"run/resolved.toml: run.{key} = {shown}: expected a text, as of a scan or program"


def test_columns_that_are_missing_are_named(folder, tmp_path) -> None:
    shutil.copytree(folder / "run", tmp_path / "run")
    for name in ("recording", "motion"):
        file = tmp_path / "run" / f"{name}.parquet"
        whole = pyarrow.parquet.read_table(file)
        pyarrow.parquet.write_table(whole.drop_columns(["trigger.time"]), file)
        done = scancell_here("picture", "run", "--json", cwd=tmp_path)
        assert done.code == 1
        assert re.search(rf"run/{name}\.parquet: .*trigger\.time", done.message), done.message
        pyarrow.parquet.write_table(whole, file)


def test_run_of_a_program_is_no_scan_to_repeat(folder) -> None:
    done = scancell_here("rerun", "run", "--json", cwd=folder)
    assert done.code == 1
    assert re.search(r"run/resolved\.toml: run\.program = .*program\.py.*: expected the run of a scan", done.message)


def test_gripped_part_and_fingers_move(tmp_path) -> None:
    """The part rises with the gripper while the fingers hold it, in true poses."""
    cell = ("--cell", CELLS / "gripper.toml", "--part", PARTS / "step_block.stl", "--engine", "geometric")
    done = scancell_here("run", EXERCISES / "grasping.py", *cell, "--out", "run", "--json", cwd=tmp_path)
    assert done.code == 0, done.err
    motion = open_run(tmp_path / "run").motion
    frames = [motion.frames(time) for time in motion.times.tolist()]
    part, first, second = (np.array([at[name][:3, 3] for at in frames]) for name in ("part", "finger[1]", "finger[2]"))
    assert np.ptp(part[:, 2]) > 0.02
    width = np.linalg.norm(second - first, axis=1)
    assert np.ptp(width) > 0.005
    held = part[:, 2] > part[:, 2].min() + 0.01
    assert np.ptp(width[held]) < 1e-3
    assert np.ptp((part - first)[held, 2]) < 2e-3
