"""Files of earlier versions are read by this one, and hold what they held."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pyarrow.csv
import pyarrow.parquet
import pytest
from commands import scancell_here

import scancell
from compatibility import SETS, copy_of
from scancell.cell.recording import read_any_recording
from scancell.config.files import split_path
from scancell.errors import DescriptionError
from scancell.evaluation.deviation import deviation_from_mesh
from scancell.geometry import pose
from scancell.nominal.cell import nominal_cell
from scancell.studies.engine import close_workers
from scancell.studies.guard.run import RowFile
from scancell.views.recorded_run import open_run

SIMULATED = ("scan_geometric", "scan_ray_traced", "scan_sweep")
RUNS = (*SIMULATED, "program_run", "reconstruction")
ENCODER = np.radians(0.0002)


@pytest.fixture(scope="module", params=SETS, ids=lambda path: path.name)
def files(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return copy_of(request.param, tmp_path_factory.mktemp("compatibility") / "set")


@pytest.fixture(autouse=True, scope="module")
def _no_worker_left():
    yield
    close_workers()


def read_json(path: Path):
    return json.loads(path.read_text())


def cell_of(files: Path):
    return nominal_cell(scancell.load_setup(files / "cell.toml").cell, scancell.load_part(files / "part.stl"))


@pytest.mark.parametrize("name", RUNS)
def test_run_folders_open_with_their_motion_and_cloud(files: Path, name: str) -> None:
    run = open_run(files / name)
    header = (files / name / "cloud.ply").read_bytes().partition(b"end_header")[0].decode()
    assert f"element vertex {run.cloud_points}\n" in header
    assert run.part is not None and len(run.cloud) == run.cloud_points
    table = pyarrow.parquet.read_table(files / name / "recording.parquet")
    assert run.motion.exposures == pytest.approx(table.column("trigger.time").to_numpy(), abs=1e-12)
    for time in run.motion.exposures:
        frames = run.motion.frames(float(time))
        assert np.isfinite(np.stack(list(frames.values()))).all()
        # The middle of the part is below the sensor, within its range.
        seen = pose.transform_points(pose.inverse(frames["sensor"]) @ frames["part"], run.part.vertices.mean(0)[None])
        assert 0.06 < seen[0, 2] < 0.17
    # The points lie on the part: the largest error of the true cell is 0.1 mm.
    assert np.abs(deviation_from_mesh(run.cloud, run.part).distance).max() < 0.5e-3


@pytest.mark.parametrize("name", SIMULATED)
def test_recordings_agree_with_the_kinematics_of_their_cell(files: Path, name: str) -> None:
    """Measured joints and table angles lead to the true poses but for the encoders."""
    recording = scancell.read_recording(files / name / "recording.parquet")
    measured, nominal = recording.measured, open_run(files / name).cell
    frames = nominal.frame_poses(measured.axes)
    for frame, own in (("link[6]", "link[6]"), ("table", "table")):
        true = recording.truth_at_middle(frame)
        assert np.abs(np.asarray(frames[own]) - true).max() < 10 * ENCODER
    assert (np.diff(measured.time) > 0).all()


def test_recording_as_text_is_that_of_its_run(files: Path) -> None:
    text = scancell.read_recording(files / "recording.csv")
    table = scancell.read_recording(files / "scan_geometric" / "recording.parquet")
    assert set(text.columns) == set(table.columns)
    for name, values in table.columns.items():
        assert text.columns[name] == pytest.approx(values, rel=1e-12, abs=1e-15), name


def test_recording_of_a_real_cell_has_no_truth(files: Path) -> None:
    recording = read_any_recording(files / "reconstruction" / "recording.parquet")
    assert not recording.has_truth and recording.measured.q.shape[1] == 6


@pytest.mark.parametrize("name", [".", *SIMULATED, "calibration"])
def test_plans_are_loaded_and_lead_from_home_to_home(files: Path, name: str) -> None:
    stored = read_json(files / name / "plan.json")
    plan = scancell.Plan.load(files / name / "plan.json")
    assert [item.id for item in plan.program.segments] == [item["id"] for item in stored["segments"]]
    assert plan.program.duration == pytest.approx(sum(item["time"][-1] for item in stored["segments"]), abs=1e-12)
    assert plan.q == pytest.approx(np.array(stored["exposures"]["q"]), abs=0)
    home = scancell.load_setup(files / "cell.toml").cell.robot.home_deg
    for segment, row in ((plan.program.segments[0], 0), (plan.program.segments[-1], -1)):
        assert segment.axes[row, :-1] == pytest.approx(np.radians(home), abs=1e-9)
    for before, after in zip(plan.program.segments[:-1], plan.program.segments[1:], strict=True):
        assert after.axes[0] == pytest.approx(before.axes[-1], abs=1e-9)


def test_scan_with_a_stored_plan_has_its_exposures_and_figures(files: Path) -> None:
    described = {"cell": files / "cell.toml", "sensor": files / "sensor.toml", "scan": files / "scan.toml"}
    with scancell.Scanner(**described) as scanner:
        found = scanner.scan(
            files / "part.stl",
            plan=files / "plan.json",
            engine="geometric",
            as_built={"tool.x_mm": 0.1},
            seed=3,
        )
    recording = scancell.read_recording(files / "scan_geometric" / "recording.parquet")
    assert len(found.recording) == len(recording)
    for frame in ("sensor", "part[1]"):
        assert found.recording.truth_at_middle(frame) == pytest.approx(recording.truth_at_middle(frame), abs=2e-6)
    stored = read_json(files / "scan_geometric" / "deviation.json")["all"]
    assert len(found.cloud) == pytest.approx(stored["count"], rel=0.02)
    assert found.deviation.figures.as_um()["rms_um"] == pytest.approx(stored["rms_um"], rel=0.05)
    assert found.deviation.figures.as_um()["mean_um"] == pytest.approx(stored["mean_um"], rel=0.05)


@pytest.mark.parametrize("name", SIMULATED)
def test_runs_are_repeated(files: Path, name: str, tmp_path: Path) -> None:
    """Plan and noise may be those of the present version; what was measured is the same part from the same views."""
    done = scancell_here("rerun", files / name, "--out", "again", "--json", cwd=tmp_path)
    assert done.code == 0, done.err
    before, now = (read_json(folder / "deviation.json")["all"] for folder in (files / name, tmp_path / "again"))
    assert now["count"] == pytest.approx(before["count"], rel=0.2)
    assert now["rms_um"] == pytest.approx(before["rms_um"], rel=0.3)


def test_images_of_a_run_give_its_profiles(files: Path, tmp_path: Path) -> None:
    report = scancell.extract([files / "scan_ray_traced" / "images"], tmp_path / "out", sensor=files / "sensor.toml")
    stored = pyarrow.parquet.read_table(files / "scan_ray_traced" / "profiles.parquet")
    assert report.figures["exposures"] == len(list((files / "scan_ray_traced" / "images").glob("raw_*_plus.png")))
    found = pyarrow.csv.read_csv(tmp_path / "out" / "profiles.csv")
    assert len(found) == pytest.approx(len(stored), rel=0.1)
    assert np.median(found.column("z_mm").to_numpy()) == pytest.approx(
        np.median(stored.column("z_mm").to_numpy()), abs=0.1
    )


def test_clouds_of_both_formats_are_equal(files: Path) -> None:
    text, full = (scancell.Cloud.load(files / "scan_geometric" / f"cloud.{suffix}") for suffix in ("ply", "npz"))
    stored = read_json(files / "scan_geometric" / "deviation.json")["all"]
    assert len(text) == len(full) == stored["count"]
    assert text.points_in_part == pytest.approx(full.points_in_part, abs=1e-12)
    assert text.time == pytest.approx(full.time, abs=1e-12)
    found = deviation_from_mesh(full, scancell.load_part(files / "part.stl")).figures.as_um()
    assert found["rms_um"] == pytest.approx(stored["rms_um"], rel=1e-3)


def test_calibrated_cell_is_used_by_scans(files: Path) -> None:
    setup = scancell.load_setup(files / "calibration" / "calibrated.toml", files / "sensor.toml", files / "scan.toml")
    assert setup.cell.estimated is not None
    deviations = setup.cell.estimated.deviations()
    rows = {row["name"]: row for row in read_json(files / "calibration" / "calibration.json")["deviations"]}
    assert rows
    unit = {"mm": 1e-3, "deg": np.pi / 180, "ms": 1e-3}
    for name, row in rows.items():
        assert deviations[name] == pytest.approx(row["value"] * unit[row["unit"]], abs=1e-10), name
    # It has the deviations that the calibrated cell truly had: 0.3 mm and 0.1 deg.
    assert deviations["tool.x"] == pytest.approx(0.3e-3, abs=10e-6)
    assert deviations["tool.rz"] == pytest.approx(np.radians(0.1), abs=2e-4)
    built = {"tool.x_mm": 0.3, "tool.rz_deg": 0.1}
    with scancell.Scanner(setup=setup) as scanner:
        rms = scanner.scan(files / "part.stl", engine="geometric", as_built=built).deviation.figures.rms
    with scancell.Scanner(files / "cell.toml", files / "sensor.toml", files / "scan.toml") as scanner:
        nominal = scanner.scan(files / "part.stl", engine="geometric", as_built=built).deviation.figures.rms
    assert rms < 0.3 * nominal


def test_calibrations_are_repeated_from_their_points(files: Path) -> None:
    stored = read_json(files / "calibration" / "calibration.json")["deviations"]
    points = files / "calibration" / "points.parquet"
    described = {"cell": files / "cell.toml", "sensor": files / "sensor.toml"}
    again = scancell.calibrate("tool", files / "balls.toml", from_points=points, **described)
    for row, before in zip(again.rows, stored, strict=True):
        assert row.name == before["name"]
        assert row.value == pytest.approx(before["value"], abs=0.5 * before["half_width"] + 1e-9)


def test_calibrated_sensor_is_a_sensor(files: Path) -> None:
    sensor = scancell.SensorDescription.from_toml(files / "sensor_calibration" / "calibrated_sensor.toml")
    rows = read_json(files / "sensor_calibration" / "calibration.json")["parameters"]
    for row in rows:
        value = sensor.model_dump()
        for part in split_path(row["name"])[1:]:
            value = value[part]
        assert np.isfinite(value)


def test_measurements_give_the_cloud_that_they_gave(files: Path) -> None:
    described = {"cell": files / "cell.toml", "sensor": files / "sensor.toml", "part": files / "part.stl"}
    found = scancell.reconstruct(files / "points.csv", **described)
    stored = scancell.Cloud.load(files / "reconstruction" / "cloud.ply")
    assert found.cloud.points_in_part == pytest.approx(stored.points_in_part, abs=1e-9)
    again = scancell.reconstruct(files / "reconstruction" / "points.parquet", **described)
    assert again.cloud.points_in_part == pytest.approx(stored.points_in_part, abs=1e-9)


def test_study_is_resumed_and_its_table_is_the_former_one(files: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(files / "study", tmp_path / "study")
    stored = pyarrow.parquet.read_table(folder / "results.parquet").to_pylist()
    done = {path: (path.read_bytes(), path.stat().st_ino) for path in folder.glob("tasks/*/rows.json")}
    words = ("--out", folder, "--shard", "1/1", "--json")
    finished = scancell_here("study", "resume", files / "study.toml", *words, cwd=tmp_path)
    assert finished.code == 0, finished.err
    assert {path: (path.read_bytes(), path.stat().st_ino) for path in done} == done
    rows = pyarrow.parquet.read_table(folder / "results.parquet").to_pylist()
    assert [row["status"] for row in rows] == ["ok"] * len(stored)
    assert rows[: len(done)] == [{**row, **before} for row, before in zip(rows, stored[: len(done)], strict=False)]
    # The last trial, which only the table held, is made anew from the same seed.
    for name in ("as_built.tool.x_mm", "cell.part.reflectance"):
        assert rows[-1][name] == pytest.approx(stored[-1][name], rel=1e-9)
    assert rows[-1]["rms_um"] == pytest.approx(stored[-1]["rms_um"], rel=0.2)


def test_batch_is_complete_and_its_index_the_former_one(files: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(files / "batch", tmp_path / "batch")
    stored = pyarrow.parquet.read_table(folder / "index.parquet").to_pylist()
    scans = {path: path.read_bytes() for path in folder.glob("scans/*/*")}
    words = ("--config", files / "batch.toml", "--out", folder, "--shard", "1/1", "--json")
    finished = scancell_here("batch", files / "parts", *words, cwd=tmp_path)
    assert finished.code == 0, finished.err
    assert {path: path.read_bytes() for path in scans} == scans
    rows = pyarrow.parquet.read_table(folder / "index.parquet").to_pylist()
    for row, before in zip(rows, stored, strict=True):
        assert {**row, "mesh": ""} == {**before, "mesh": ""}
        cloud = scancell.Cloud.load(folder / row["file.cloud.npz"])
        assert len(cloud) == row["points"]


def test_rows_of_a_campaign_are_read_or_refused_by_their_columns(files: Path) -> None:
    with (files / "guard" / "rows.csv").open() as stream:
        lines = stream.read().splitlines()
    try:
        rows = RowFile(files / "guard" / "rows.csv").rows
    except DescriptionError as error:
        assert "rows.csv" in str(error) and "expected" in str(error)
        return
    assert [row.number for row in rows] == [int(line.partition(",")[0]) for line in lines[1:]]
    assert not any(row.collided for row in rows)
