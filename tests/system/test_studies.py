"""Studies end to end: equal rows however they are run, failures reported, errors as theory predicts."""

from __future__ import annotations

import json
import shutil
from contextlib import closing
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest
from commands import scancell_here
from test_perturbations import geometry, smooth_points, surface_normals, thinned

from scancell.errors import DescriptionError
from scancell.evaluation.deviation import deviation_from_mesh
from scancell.output.run_folder import build_version
from scancell.progress import NullProgress, Stopwatch
from scancell.studies import run_record
from scancell.studies.engine import ExecutionTarget, Trial, close_workers
from scancell.studies.report import write_report
from scancell.studies.study import TrialWorker, open_study, replay
from studies_files import DESIGN, GLOSS, HEAD, OFFSET, write_study

LATENCY = '[[factor]]\npath = "as_built.trigger.latency_ms"\ndistribution = { kind = "uniform", low = 0, high = 1 }\n'
# A reflectance above 1 is refused: with a wide distribution some trials fail, others do not.
WIDE = GLOSS.replace('kind = "uniform", low = -0.2, high = 0.2', 'kind = "normal", std = 2')


@pytest.fixture(autouse=True, scope="module")
def _no_worker_left():
    yield
    close_workers()


@pytest.fixture(scope="module")
def small(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("small")
    return write_study(folder, HEAD, "ray_traced_trials = 1", DESIGN, OFFSET, LATENCY, GLOSS)


@pytest.fixture(scope="module")
def made(small, tmp_path_factory):
    """The small study with one worker and with two."""
    study, folders = open_study(small), []
    for workers in (1, 2):
        out = tmp_path_factory.mktemp(f"workers{workers}") / "out"
        study.begin(out)
        study.run(out, ExecutionTarget(workers=workers), NullProgress())
        write_report(study, out)
        folders.append(out)
    return study, *folders


def test_results_are_independent_of_workers(made) -> None:
    _, one, two = made
    assert (one / "results.parquet").read_bytes() == (two / "results.parquet").read_bytes()
    table = pyarrow.parquet.read_table(one / "results.parquet").to_pydict()
    assert table["status"] == ["ok"] * 5
    assert table["engine"] == ["geometric"] * 4 + ["ray-traced"]
    assert len(set(table["rms_um"])) == 5, "the trials differ"


@pytest.mark.parametrize("number", [3, 5])
def test_single_trial_reproduces_row(made, number) -> None:
    study, one, _ = made
    row, _ = replay(study, number)
    rows = json.loads((one / "tasks" / f"trial-{number:07d}" / "rows.json").read_text())
    assert json.dumps(rows, indent=1) == json.dumps([row], indent=1)


def test_folder_with_fewer_keys_is_resumed(made, small, tmp_path) -> None:
    study, one, _ = made
    out = tmp_path / "out"
    study.begin(out)
    record = out / "description.json"
    older = json.loads(record.read_text())
    del older["setup"]["sensor"]["render"]["bounces"]
    record.write_text(json.dumps(older))
    study.run(out, ExecutionTarget(shard=(1, 2)), NullProgress())
    done = scancell_here("study", "resume", small, "--out", out, "--shard", "1/1", "--json", cwd=tmp_path)
    assert done.code == 0, done.err
    assert "setup.sensor.render.bounces: their defaults are assumed" in done.err
    marks = [json.loads(file.read_text())["digest"] for file in sorted(out.glob("tasks/*/done.json"))]
    assert len(marks) == 5
    assert (out / "results.parquet").read_bytes() == (one / "results.parquet").read_bytes()
    made_twice = study.run(out, ExecutionTarget(shard=(1, 1)), NullProgress())
    assert (len(made_twice.present), made_twice.done) == (5, [])


def test_shards_give_equal_results(made, small, tmp_path) -> None:
    _, one, _ = made
    for shard in ("1/2", "2/2"):
        done = scancell_here("study", "run", small, "--shard", shard, "--out", tmp_path / "out", cwd=tmp_path)
        assert done.code == 0, done.err
    assert scancell_here("study", "report", small, "--out", tmp_path / "out", cwd=tmp_path).code == 0
    assert (tmp_path / "out" / "results.parquet").read_bytes() == (one / "results.parquet").read_bytes()


def test_moved_study_resumes(made, small, tmp_path) -> None:
    _, one, _ = made
    here, there = tmp_path / "here", tmp_path / "there"
    here.mkdir()
    part = open_study(small).part
    shutil.copy(part, here / part.name)
    (here / small.name).write_text(small.read_text().replace(str(part), part.name))
    words = ("study", "run", small.name, "--out", "out", "--shard", "1/2")
    assert scancell_here(*words, cwd=here).code == 0
    here.rename(there)
    done = scancell_here("study", "resume", small.name, "--out", "out", "--shard", "1/1", "--json", cwd=there)
    assert done.code == 0, done.err
    assert all("too few for reliable shares" in warning for warning in done.last_line["warnings"])
    assert (there / "out" / "results.parquet").read_bytes() == (one / "results.parquet").read_bytes()


def test_resume_runs_missing_trials(made, small, tmp_path) -> None:
    _, one, _ = made
    out = tmp_path / "out"
    shutil.copytree(one, out)
    shutil.rmtree(out / "tasks" / "trial-0000002")
    (out / "results.parquet").unlink()
    done = scancell_here("study", "resume", small, "--shard", "1/1", "--out", out, "--json", cwd=tmp_path)
    assert done.code == 0, done.err
    assert (out / "results.parquet").read_bytes() == (one / "results.parquet").read_bytes()


def test_extended_study_keeps_finished_trials(tmp_path) -> None:
    path = write_study(tmp_path, HEAD, "trials_per_task = 2", DESIGN, OFFSET)
    alone = ("--shard", "1/1", "--out", "out", "--json")
    assert scancell_here("study", "run", path, "--set", "design.trials=2", *alone, cwd=tmp_path).code == 0
    before = (tmp_path / "out" / "tasks" / "trial-0000001" / "rows.json").stat()
    shown = scancell_here("study", "show", path, "--out", "out", "--json", cwd=tmp_path)
    assert (shown.last_line["figures"]["finished"], shown.last_line["figures"]["trials"]) == (2, 4)
    done = scancell_here("study", "resume", path, *alone, cwd=tmp_path)
    assert done.code == 0, done.err
    assert (tmp_path / "out" / "tasks" / "trial-0000001" / "rows.json").stat() == before
    row, _ = replay(open_study(path), 4)
    table = pyarrow.parquet.read_table(tmp_path / "out" / "results.parquet").to_pydict()
    assert table["trial"] == [1, 2, 3, 4]
    assert table["rms_um"][3] == row["figures"]["rms_um"]


def test_factor_without_effect_is_reported(tmp_path) -> None:
    """Samples per pixel concern rendered images only."""
    values = 'kind = "discrete", values = [4, 16, 64]'
    inert = f'[[factor]]\npath = "sensor.render.samples_per_pixel"\nmode = "absolute"\ndistribution = {{ {values} }}\n'
    heights = OFFSET.replace("tool.x", "table.z")
    head = HEAD.replace("max_profiles=20", "max_profiles=16").replace('"small"', '"two heights"')
    path = write_study(tmp_path, head, DESIGN.replace("4", "20"), heights, inert)
    done = scancell_here("study", "run", path, "--shard", "1/1", "--json", cwd=tmp_path)
    assert done.code == 0, done.err
    assert done.last_line["warnings"] == ["no effect on any result (geometric engine): sensor.render.samples_per_pixel"]
    found = json.loads((tmp_path / "out" / "two-heights" / "study.json").read_text())
    assert found["without_effect"] == ["sensor.render.samples_per_pixel"]
    assert "no effect on any result" in (tmp_path / "out" / "two-heights" / "report.html").read_text()


def test_mixed_build_warning(made, small, tmp_path, monkeypatch) -> None:
    shutil.copytree(made[1], tmp_path / "out")
    monkeypatch.setattr(run_record, "build_version", lambda: "0.1.0+another")
    done = scancell_here("study", "report", small, "--out", tmp_path / "out", "--json", cwd=tmp_path)
    mixed, *few = done.last_line["warnings"]
    assert all("too few for reliable shares" in warning for warning in few)
    assert mixed.endswith(f"than this one (0.1.0+another): 5 by {build_version()}")


def test_report_is_self_contained(made) -> None:
    _, one, _ = made
    page = (one / "report.html").read_text()
    outside = [word for word in ("src=", 'href="http', "@import", "url(http", "<script", "<link") if word in page]
    assert not outside
    assert page.count("<svg") >= 4
    said = json.loads((one / "study.json").read_text())
    assert said["engines"]["geometric"]["figures"]["rms_um"]["trials"] == 4


def test_failed_trial_row_has_seed_and_message(tmp_path) -> None:
    study = open_study(write_study(tmp_path, HEAD, DESIGN, WIDE))
    out = tmp_path / "out"
    study.begin(out)
    study.run(out, ExecutionTarget(shard=(1, 1)), NullProgress())
    write_report(study, out)
    table = pyarrow.parquet.read_table(out / "results.parquet").to_pydict()
    values = np.array(table["cell.part.reflectance"])
    wrong = np.abs(0.5 * (1 + values) - 0.5) > 0.5
    assert 0 < wrong.sum() < 4, "the seed has trials of both kinds"
    assert [status == "failed" for status in table["status"]] == wrong.tolist()
    assert all("reflectance" in message for message, bad in zip(table["message"], wrong, strict=True) if bad)
    failed = json.loads((out / "study.json").read_text())["failed"]
    assert [row["seed"] for row in failed] == np.array(table["seed"])[wrong].tolist()


def test_tool_offset_error_matches_first_order_theory(tmp_path) -> None:
    """The slope of measured on predicted distances is 1 within 1 % in every trial."""
    offsets = "\n".join(OFFSET.replace("tool.x", f"tool.{axis}") for axis in "xyz")
    head = HEAD.replace('"scan.max_profiles=20", "scan.raster.enabled=false"', '"scan.max_profiles=150"')
    study = open_study(write_study(tmp_path, head, "ideal = true", 'unit = "mm"', DESIGN, offsets))
    worker = TrialWorker(study.description, study.setup, study.part)
    try:
        slopes = [_slope(worker.scan(trial), np.array(trial.values) * 1e-3) for trial in study.trials]
    finally:
        worker.close()
    print("slopes", slopes)
    assert slopes == pytest.approx([1.0] * 4, abs=0.01)


def _slope(scan, offset: np.ndarray) -> float:
    """The sensor is farther along its own axes by `offset` (3,) m than nominal: points shift the other way."""
    cloud, measured = scan.cloud, scan.recording.measured
    signed = deviation_from_mesh(cloud, scan.nominal.part).distance
    chosen = thinned(cloud)
    chosen = chosen[smooth_points(scan, cloud.points_in_part[chosen])]
    points, row = cloud.points_in_part[chosen], np.searchsorted(measured.index, cloud.profile[chosen])
    found = geometry(scan, measured)
    normal = found.normals(surface_normals(scan, points), row)
    shift = -np.einsum("nij,j->ni", found.world_from_sensor[row][:, :3, :3], offset)
    predicted = np.einsum("ni,ni->n", normal, shift)
    assert predicted.std() > 5e-6
    return float(np.polyfit(predicted, signed[chosen], 1)[0])


BALL = '[[sphere]]\nname = "ball"\ncentre_mm = [0, 0, 45]\nradius_mm = 25\nabove_mm = 25\n'


def figures_one_by_one(folder: Path, head: str, changes: dict[str, float]) -> list[dict[str, float]]:
    """Figures of an ideal scan of the nominal cell, and with each of the changes alone."""
    unit = 'distribution = { kind = "uniform", low = 0, high = 1 }'
    factors = "\n".join(f'[[factor]]\npath = "{path}"\n{unit}\n' for path in changes)
    study = open_study(write_study(folder, head, "ideal = true", DESIGN, factors, BALL))
    worker = TrialWorker(study.description, study.setup, study.part)
    values = [np.zeros(len(changes)), *np.diag(list(changes.values()))]
    try:
        study.factors.check(worker.units())
        trials = [Trial(n, 1, "geometric", tuple(row.tolist())) for n, row in enumerate(values, 1)]
        rows = [worker.row(trial, Stopwatch()) for trial in trials]
    finally:
        worker.close()
    assert [row["message"] for row in rows] == [""] * len(rows)
    return [row["figures"] for row in rows]


def test_calibration_in_every_trial_removes_what_it_finds(tmp_path) -> None:
    wide = OFFSET.replace("0.05", "0.5").replace("x_mm", "z_mm")
    figures = {}
    for name, calibrate in {"before": "", "after": '[calibrate]\nwhat = "tool"\nposes = 8\n'}.items():
        folder = tmp_path / name
        folder.mkdir()
        study = open_study(write_study(folder, HEAD, DESIGN.replace("4", "2"), wide, calibrate))
        with closing(study.worker()) as worker:
            rows = [worker.row(trial, Stopwatch()) for trial in study.trials]
        assert [row["message"] for row in rows] == ["", ""]
        figures[name] = [row["figures"] for row in rows]
    for before, after in zip(figures["before"], figures["after"], strict=True):
        assert after["rms_um"] < 0.1 * before["rms_um"]
        assert abs(after["calibration.tool.z_error_mm"]) < 3 * after["calibration.tool.z_half_width_mm"] < 0.1


def test_missing_artefact_of_a_study_is_named(tmp_path) -> None:
    path = write_study(tmp_path, HEAD, DESIGN, OFFSET, '[calibrate]\nartefact = "no.toml"\n')
    with pytest.raises(DescriptionError, match=r"small\.toml: calibrate\.artefact = 'no\.toml': no such file"):
        open_study(path)


def test_encoder_latency_shifts_part_by_table_travel(tmp_path) -> None:
    """A ball 20 mm off the axis of a table at 40 degrees per second: 14 um for a millisecond."""
    head = HEAD.replace('"scan.max_profiles=20"', '"scan.max_profiles=60", "cell.part.x_mm=20"')
    right, late = figures_one_by_one(tmp_path, head, {"cell.table.encoder_latency_ms": 1.0})
    shift = np.array([late[f"ball.{axis}_um"] - right[f"ball.{axis}_um"] for axis in "xyz"])
    print(shift)
    assert abs(shift[1]) == pytest.approx(1e6 * 0.020 * np.radians(40) * 1e-3, rel=0.03)
    assert np.abs(shift[[0, 2]]).max() < 0.5


def test_vibration_trigger_and_drive_perturbations_affect_scan(tmp_path) -> None:
    band = '"vibration.table.random_low_hz=5", "vibration.table.random_width_hz=45"'
    fast = f'as_built = ["vibration.flange.frequency_hz=20", {band}]'
    words = '"scan.max_profiles=20", "cell.part.x_mm=20", "cell.robot.drive=dynamic"'
    soft = HEAD.replace('"scan.max_profiles=20"', words)
    alone = {
        "as_built.vibration.flange.z_mm": 0.05,
        "as_built.vibration.table.random_rms_mm": 0.05,
        "as_built.trigger.jitter_ms": 1.0,
        "cell.robot.joint[2].drive.gear_stiffness_n_m_rad": 1e5,
    }
    right, *others = figures_one_by_one(tmp_path, f"{soft}\n{fast}", alone)
    changes = [abs(figures["rms_um"] - right["rms_um"]) for figures in others]
    print(right["rms_um"], changes)
    assert min(changes) > 0.01


HEIGHTS = """
[[factor]]
path = "as_built.table.z_mm"
distribution = { kind = "normal", std = 0.03 }
[[factor]]
path = "as_built.tool.z_mm"
distribution = { kind = "normal", std = 0.04 }
[[sphere]]
name = "ball"
centre_mm = [0, 0, 45]
radius_mm = 25
above_mm = 25
"""


def test_sobol_indices_match_linear_model(tmp_path) -> None:
    """Seen from above, the height of a ball is raised by the table and lowered by the sensor: 9 and 16 parts of 25."""
    # Clearances, which every step of the cell would work out, do not matter.
    fewer = 'scan.max_profiles=12", "cell.collision.outputs=false'
    head = HEAD.replace("scan.max_profiles=20", fewer).replace("raster", "sweep")
    design = '[design]\nkind = "sobol"\ntrials = 32\n'
    study = open_study(write_study(tmp_path, head, "ideal = true", "trials_per_task = 16", design, HEIGHTS))
    study.begin(tmp_path / "out")
    study.run(tmp_path / "out", ExecutionTarget(shard=(1, 1)), NullProgress())
    report = write_report(study, tmp_path / "out")
    said = report.analysis["engines"]["geometric"]
    for row, exact in zip(said["sensitivity"]["ball.z_um"]["sobol"], (0.36, 0.64), strict=True):
        print(row)
        for name in ("first", "total"):
            low, high = row[f"{name}_interval"]
            assert low <= exact <= high
        assert row["total"] == pytest.approx(exact, abs=0.05)
    assert said["figures"]["ball.z_um"]["standard_deviation"] == pytest.approx(50, rel=0.1)
