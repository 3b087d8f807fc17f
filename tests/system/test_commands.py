"""Every command does its work and tells it in one JSON object; a scan can be made again from its recording."""

from __future__ import annotations

import csv
import json
import zipfile

import cv2
import fmpy
import numpy as np
import pyarrow.csv
import pyarrow.parquet
import pytest
from commands import PARTS, QUICK, Finished, scancell, scancell_here

from scancell.config.loading import assets_dir
from scancell.reconstruction.cloud_files import read_ply

PART = PARTS / "free_form.stl"
SENSOR = assets_dir() / "sensors" / "two_camera_probe.toml"
FIELDS = {"command", "ok", "figures", "files", "warnings", "timings"}


def succeeded(done: Finished, command: str) -> dict:
    assert done.code == 0, done.err
    report = done.last_line
    assert set(report) == FIELDS
    assert report["command"] == command
    assert report["ok"] is True
    assert len(done.out.splitlines()) == 1
    return report


# --- robot programs --------------------------------------------------------------------------------------------------

OVER_PART = """
from scancell import Robot, deg, location, mm

def main(robot: Robot) -> None:
    robot.move_tool(location(450 * mm, 0, 215 * mm, rx=180 * deg))
    print("over the part:", len(robot.profile().points_in_part) > 100)
    robot.save(robot.scan_line(robot.world_from_tool() @ location(5 * mm, 0, 0), 1 * mm), "pass.ply")
"""


def test_run_reports_steps_and_files(tmp_path) -> None:
    (tmp_path / "over_part.py").write_text(OVER_PART)
    done = scancell_here("run", "over_part.py", "--part", PART, *QUICK, "--out", "made", "--json", cwd=tmp_path)
    report = succeeded(done, "run")
    steps = report["figures"]["steps"]
    assert [step["command"] for step in steps] == ["move_tool", "profile", "scan_line", "save"]
    assert [step["line"] for step in steps] == [5, 6, 7, 7]
    assert report["figures"]["contacts"] == []
    assert "over the part: True" in done.err
    assert report["files"][0] == "made/pass.ply"
    assert len(read_ply(tmp_path / "made" / "pass.ply")) > 1000


def test_failed_program_states_line_and_exits_1(tmp_path) -> None:
    (tmp_path / "down.py").write_text(OVER_PART.replace("215 * mm", "60 * mm"))
    done = scancell("run", "down.py", *QUICK, "--json", cwd=tmp_path)
    assert done.code == 1
    assert done.last_line["error"]["kind"] == "ProgramError"
    assert done.message.startswith("down.py:5: move_tool: held by the guard")
    assert done.message.endswith("sensor - table")


# --- scan and render ------------------------------------------------------------------------------------------------

NOISY = ("--set", "scan.max_profiles=40", "--seed", "7")


@pytest.fixture(scope="module")
def scanned(tmp_path_factory):
    """A ray-traced scan with noise."""
    folder = tmp_path_factory.mktemp("scan")
    return folder, succeeded(scancell("scan", PART, *NOISY, "--out", "run", "--json", cwd=folder), "scan")


def test_scan_reports_figures_and_timings(scanned) -> None:
    folder, report = scanned
    deviation = json.loads((folder / "run" / "deviation.json").read_text())
    assert deviation["all"] == report["figures"]["deviation"]
    assert deviation["all"]["count"] == report["figures"]["points"]
    assert set(report["figures"]["stations_s"]) == {"cast", "render", "detect", "extract", "triangulate"}
    assert {"load", "plan", "drive", "sense", "reconstruct", "evaluate", "write"} <= set(report["timings"])


@pytest.mark.parametrize("suffix", ["parquet", "csv"])
def test_render_reproduces_cloud(scanned, suffix, tmp_path) -> None:
    folder, _ = scanned
    table = pyarrow.parquet.read_table(folder / "run" / "recording.parquet")
    recording = tmp_path / f"recording.{suffix}"
    if suffix == "csv":
        pyarrow.csv.write_csv(table, recording)
    else:
        pyarrow.parquet.write_table(table, recording)
    done = scancell("render", recording.name, PART, *NOISY, "--out", "again", "--json", cwd=tmp_path)
    succeeded(done, "render")
    again = tmp_path / "again" / "cloud.ply"
    assert again.read_bytes() == (folder / "run" / "cloud.ply").read_bytes()


def test_render_accepts_fmpy_output(scanned, tmp_path) -> None:
    """A tool that logs every communication step repeats each record; rows before the first trigger hold zeros."""
    folder, _ = scanned
    table = pyarrow.parquet.read_table(folder / "run" / "recording.parquet").to_pydict()
    names = list(table)
    with (tmp_path / "log.csv").open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["time", *names, "measured.q[1]"])
        writer.writerow([0.0, *(0 for _ in names), 0.1])
        for i in range(len(table[names[0]])):
            row = [repr(table[name][i]) for name in names]
            writer.writerows([[0.016 * i, *row, 0.1], [0.016 * i + 0.004, *row, 0.1]])
    done = scancell("render", "log.csv", PART, *NOISY, "--out", "again", "--json", cwd=tmp_path)
    succeeded(done, "render")
    again = tmp_path / "again" / "cloud.ply"
    assert again.read_bytes() == (folder / "run" / "cloud.ply").read_bytes()


def test_stop_and_look_scan_with_images(tmp_path) -> None:
    words = ("--mode", "stop-and-look", "--ideal", "--set", "scan.max_profiles=40", "--images")
    report = succeeded(scancell("scan", PART, *words, "--out", "run", "--json", cwd=tmp_path), "scan")
    assert report["figures"]["deviation"]["rms_um"] <= 10.0
    pictures = sorted((tmp_path / "run" / "images").rglob("*.png"))
    assert pictures
    assert all(cv2.imread(str(path)) is not None for path in pictures)
    # The same folder, in which pictures of stripes lie as well, gives all points of the cloud again.
    words = ("--sensor", SENSOR, "--set", "sensor.render.noise=false", "--out", "again", "--json")
    extracted = succeeded(scancell("extract", "run/images", *words, cwd=tmp_path), "extract")
    assert extracted["figures"]["exposures"] == report["figures"]["profiles"]
    kept = list((tmp_path / "run" / "images").glob("profile_*.png"))
    assert len(extracted["figures"]["ignored_files"]) == len(kept) > 0
    cloud = read_ply(tmp_path / "run" / "cloud.ply")
    places = {place for place, _ in rows_by_place(tmp_path / "again" / "profiles.csv", "row_px")}
    assert len(places) == extracted["figures"]["points"] >= len(cloud) > 1000
    found = zip((f"raw_{trigger:05d}" for trigger in cloud.profile), cloud.camera, cloud.column, strict=True)
    assert {(name, int(camera), int(column)) for name, camera, column in found} <= places


def test_scan_of_given_poses(tmp_path) -> None:
    poses = [(0.0, 0.0, 130.0), (5.0, 0.0, 135.0), (10.0, 2.0, 140.0)]
    text = "".join(f"[[pose]]\nx_mm = {x}\ny_mm = {y}\nz_mm = {z}\nrx_deg = 180.0\n" for x, y, z in poses)
    (tmp_path / "poses.toml").write_text(text)
    done = scancell("scan", PART, "--scan", "poses.toml", "--ideal", "--out", "run", "--json", cwd=tmp_path)
    report = succeeded(done, "scan")
    assert report["figures"]["profiles"] == len(poses)
    assert report["figures"]["deviation"]["rms_um"] <= 10.0


def test_text_summary(tmp_path) -> None:
    done = scancell("scan", PART, *QUICK, "--out", "run", cwd=tmp_path)
    assert done.code == 0, done.err
    assert "profiles" in done.out
    assert "coverage" in done.out
    assert done.err == ""


# --- the others -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("engine", ["ray-traced", "geometric"])
def test_shot_writes_images_and_profile(tmp_path, engine) -> None:
    words = ("--pose", "0,0,130,180,0,0", "--engine", engine, "--ideal", "--out", "one", "--json")
    report = succeeded(scancell_here("shot", PART, *words, cwd=tmp_path), "shot")
    with (tmp_path / "one" / "profile.csv").open() as stream:
        table = [{key: float(value) for key, value in row.items()} for row in csv.DictReader(stream)]
    assert len(table) == report["figures"]["points"] > 500
    assert all(abs(row["x_sensor_mm"]) < 1e-6 for row in table)
    # Seen from straight above, 130 mm over the part's origin: z of the part and of the sensor add up.
    assert max(abs(row["z_part_mm"] + row["z_sensor_mm"] - 130.0) for row in table) < 1e-5
    images = sorted(path.name for path in (tmp_path / "one").glob("image_*.png"))
    assert images == (["image_minus.png", "image_plus.png"] if engine == "ray-traced" else [])
    for name in images:
        image = cv2.imread(str(tmp_path / "one" / name), cv2.IMREAD_UNCHANGED)
        assert image.shape == (1024, 1280)
        assert image.dtype == np.uint8


def test_extract_reproduces_shot_profile(tmp_path) -> None:
    """Laser-on and background images lie in one folder with others; the index keeps them apart."""
    changed = ("--set", "sensor.detector.laser_off_frame=true")
    words = ("--pose", "0,0,130,180,0,0", *changed, "--out", "one", "--json")
    succeeded(scancell_here("shot", PART, *words, cwd=tmp_path), "shot")
    words = ("--laser-off", tmp_path / "one", "--sensor", SENSOR, *changed, "--out", "again", "--json")
    report = succeeded(scancell_here("extract", tmp_path / "one", *words, cwd=tmp_path), "extract")
    aside = sorted(file.rpartition("/")[2] for file in report["figures"]["ignored_files"])
    assert aside == ["laser_off_minus.png", "laser_off_plus.png", "stripes.png"]
    shot = {place[1:]: row for place, row in rows_by_place(tmp_path / "one" / "profile.csv", "row_px")}
    again = {place[1:]: row for place, row in rows_by_place(tmp_path / "again" / "profiles.csv", "row_px")}
    assert shot == again
    assert len(shot) > 500


def rows_by_place(path, value: str) -> list[tuple[tuple[str, int, int], float]]:
    """A value of every row of a table of profiles, by exposure, camera and column."""
    with path.open() as stream:
        rows = list(csv.DictReader(stream))
    return [((row.get("name", ""), int(row["camera"]), int(row["column_px"])), float(row[value])) for row in rows]


def test_shot_with_sensor_perturbation(tmp_path) -> None:
    """A sheet 0.1 mm off its place: x z / baseline of error in range, of opposite sign in the two cameras."""
    words = ("--pose", "0,0,130,180,0,0", "--engine", "geometric", "--json")
    medians = {}
    for name, built in (("right", ()), ("off", ("--as-built", "sensor.laser.offset_x_mm=0.1"))):
        succeeded(scancell_here("shot", PART, *words, *built, "--out", name, cwd=tmp_path), "shot")
        with (tmp_path / name / "profile.csv").open() as stream:
            table = [(row["camera"], float(row["z_sensor_mm"])) for row in csv.DictReader(stream)]
        medians[name] = np.array([np.median([z for camera, z in table if camera == k]) for k in ("0", "1")])
    error = medians["off"] - medians["right"]
    assert error[0] > 0 > error[1]
    # What both have in common is the part, which the sheet now meets elsewhere.
    assert (error[0] - error[1]) / 2 == pytest.approx(0.1 * medians["right"].mean() / 60.0, rel=0.05)


@pytest.mark.parametrize("offset_mm", [0.0, 0.1, -0.05])
def test_extract_reports_sheet_offset(tmp_path, offset_mm) -> None:
    """A laser that was moved across the sheet: extraction by the nominal sensor finds by how far."""
    words = ("--pose", "0,0,130,180,0,0", "--ideal", "--out", "one", "--json")
    built = ("--as-built", f"sensor.laser.offset_x_mm={offset_mm}") if offset_mm else ()
    succeeded(scancell_here("shot", PART, *words, *built, cwd=tmp_path), "shot")
    words = ("--sensor", SENSOR, "--sheet-um", "20", "--out", "again", "--json")
    report = succeeded(scancell_here("extract", tmp_path / "one", *words, cwd=tmp_path), "extract")
    sheet = report["figures"]["sheet_deviation"]
    assert sheet["compared"] > 0.9 * report["figures"]["points"]
    assert sheet["median_um"] == pytest.approx(1e3 * offset_mm, abs=1.0)
    assert bool(report["warnings"]) == bool(offset_mm)
    with (tmp_path / "again" / "profiles.csv").open() as stream:
        rows = [row for row in csv.DictReader(stream) if row["sheet_deviation_mm"]]
    flagged = sum("sheet_deviation" in row["flags"] for row in rows)
    assert (len(rows), flagged) == (sheet["compared"], sheet["beyond"])
    assert flagged > 0.99 * len(rows) if offset_mm else flagged < 0.01 * len(rows)
    errors = np.array([float(row["sheet_deviation_mm"]) for row in rows]) - offset_mm
    assert np.quantile(np.abs(errors), 0.9) < 0.003 + 0.02 * abs(offset_mm)


def test_fmu_build_and_info(tmp_path) -> None:
    report = succeeded(scancell_here("fmu", "build", "--out", ".", "--json", cwd=tmp_path), "fmu build")
    assert [path.name for path in sorted(tmp_path.iterdir())] == ["RobotCell2.fmu", "RobotCell3.fmu"]
    assert len(report["files"]) == 2
    for version, folder in ((2, "linux64"), (3, "x86_64-linux")):
        name = f"RobotCell{version}.fmu"
        info = succeeded(scancell_here("fmu", "info", name, "--json", cwd=tmp_path), "fmu info")["figures"]
        assert info["fmi_version"].startswith(str(version))
        assert info["token"] == fmpy.read_model_description(str(tmp_path / name), validate=False).guid
        with zipfile.ZipFile(tmp_path / name) as archive:
            assert any(entry.startswith(f"binaries/{folder}/") for entry in archive.namelist())


def test_ssp_build(tmp_path) -> None:
    cell = assets_dir() / "cells/pick_and_place.toml"
    report = succeeded(scancell_here("ssp", "build", cell, "--out", "cell.ssp", "--json", cwd=tmp_path), "ssp build")
    assert [path.name for path in tmp_path.iterdir()] == report["files"] == ["cell.ssp"]
    with zipfile.ZipFile(tmp_path / "cell.ssp") as archive:
        assert archive.namelist()[0] == "SystemStructure.ssd"
    for words, expected in (
        (["--out", "cell.zip"], "--out cell.zip: expected a file name that ends in .ssp"),
        (["--stop-time", "nan"], "--stop-time nan: expected a positive number of seconds"),
        (["--set", "cell.gripper.stroke_mm=55"], "gripper.stroke_mm = 55.0: expected at least 60.0, to grip the part"),
    ):
        failed = scancell_here("ssp", "build", cell, *words, cwd=tmp_path)
        assert failed.code == 1
        assert expected in failed.err


def test_shipped_descriptions_validate(tmp_path) -> None:
    report = succeeded(scancell_here("schema", "--out", "schemas", "--json", cwd=tmp_path), "schema")
    kinds = {"cell", "robot", "sensor", "scan", "path", "artefact", "study", "batch", "format", "characteristics"}
    assert {f"schemas/{kind}.schema.json" for kind in kinds} == set(report["files"])
    for kind in kinds:
        schema = json.loads((tmp_path / "schemas" / f"{kind}.schema.json").read_text())
        assert schema["$schema"].startswith("https://json-schema.org/")
        assert schema["additionalProperties"] is False


def test_version(tmp_path) -> None:
    report = succeeded(scancell_here("version", "--json", cwd=tmp_path), "version")
    assert {"scancell", "python", "numpy", "fmpy"} <= set(report["figures"]["versions"])
