"""Calibration of a sensor by the command and the library: its files, peaks of a real sensor, what scans gain."""

from __future__ import annotations

import json

import numpy as np
import pyarrow.csv
import pyarrow.parquet
import pytest
from commands import scancell_here

import scancell
from scancell.calibration.sensor.problem import PEAK_SPACING, Corners, StripePeaks, TargetExposure
from scancell.calibration.sensor.report import SensorCalibrationRequest
from scancell.calibration.sensor.targets import read_exposures, surface_of, write_exposures
from scancell.config.loading import assets_dir
from scancell.config.sensor import SensorDescription
from scancell.errors import CalibrationError, DescriptionError

PART = assets_dir() / "parts" / "sphere_on_foot.stl"
MISALIGNED = ("sensor.camera[1].tilt_deg=29.35", "sensor.camera[2].roll_deg=0.1", "sensor.laser.turn_y_deg=0.1")
FILES = {"calibrated_sensor.toml", "calibration.json", "distances.png", "manifest.json", "peaks.parquet"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Where the command has left a calibration."""
    here = tmp_path_factory.mktemp("sensor")
    words = [word for one in MISALIGNED for word in ("--as-built", one)]
    done = scancell_here("calibrate", "sensor", *words, "--seed", "1", "--out", "out", "--json", cwd=here)
    assert done.code == 0, done.err
    assert done.last_line["figures"]["range_error_um"]["after"] < 1.0
    return here


@pytest.fixture(scope="module")
def peaks(folder):
    return pyarrow.parquet.read_table(folder / "out/peaks.parquet")


def test_command_finds_the_sensor_as_built(folder) -> None:
    assert {item.name for item in (folder / "out").iterdir()} == FILES
    figures = json.loads((folder / "out/calibration.json").read_text())
    rows = {row["name"]: row for row in figures["parameters"]}
    assert len(rows) == 21
    assert max(abs(row["error"]) / row["half_width"] for row in rows.values()) < 2.0
    assert rows["sensor.camera[1].tilt_deg"]["deviation"] == pytest.approx(0.05, abs=2e-3)
    assert np.array(figures["covariance"]).shape == (21, 21)
    assert figures["range_error_um"]["before"] > 300
    assert not figures["range_error_um"]["aligned"]
    written = SensorDescription.from_toml(folder / "out/calibrated_sensor.toml")
    assert written.extraction.triangulation == "sheet"
    assert written.laser.turn_y_deg == pytest.approx(0.1, abs=2e-3)


def test_scan_with_the_calibrated_sensor_is_nearly_the_ideal_one(folder) -> None:
    common = ["--engine", "ray-traced", "--set", "scan.max_profiles=30", "--seed", "2", "--json"]
    built = [word for one in MISALIGNED for word in ("--as-built", one)]
    calibrated = ["--estimated-sensor", "out/calibrated_sensor.toml"]
    rms = {}
    for name, words in {"before": built, "after": [*built, *calibrated], "ideal": []}.items():
        done = scancell_here("scan", PART, *common, *words, "--out", name, cwd=folder)
        assert done.code == 0, done.err
        rms[name] = done.last_line["figures"]["deviation"]["rms_um"]
    assert rms["before"] > 5 * rms["ideal"]
    assert rms["after"] == pytest.approx(rms["ideal"], rel=0.1)
    again = scancell_here("rerun", "after", "--out", "again", "--json", cwd=folder)
    assert again.code == 0, again.err
    assert again.last_line["figures"]["deviation"]["rms_um"] == pytest.approx(rms["after"], rel=1e-9)


def test_sensor_with_other_images_cannot_interpret() -> None:
    other = SensorDescription.default().replace({"camera[1].width_px": 640})
    with scancell.Scanner() as scanner, pytest.raises(DescriptionError, match="expected 1280 x 1024, 1280 x 1024 px"):
        scanner.scan(PART, estimated_sensor=other)


def test_peaks_of_a_file_give_the_same_calibration(folder, peaks, tmp_path) -> None:
    pyarrow.csv.write_csv(peaks, tmp_path / "peaks.csv")
    first = json.loads((folder / "out/calibration.json").read_text())
    for file in (folder / "out/peaks.parquet", tmp_path / "peaks.csv"):
        report = scancell.calibrate_sensor(SensorCalibrationRequest(from_points=file))
        assert report.range_error is None
        values = [row["value"] for row in first["parameters"]]
        assert report.result.values == pytest.approx(values, abs=1e-7)
        assert report.result.used == first["residuals_used"]


def test_peaks_of_an_artefact_and_rejected_ones(peaks, tmp_path) -> None:
    """A ball as an artefact file; of every exposure the camera of number 1 is flagged as rejected."""
    (tmp_path / "ball.toml").write_text(
        'name = "ball"\n[[shape]]\nname = "ball"\nkind = "sphere"\ndiameter_mm = 25.0\n'
    )
    named = peaks.set_column(peaks.column_names.index("target"), "target", [["ball.toml"] * len(peaks)])
    flags = np.where(np.asarray(peaks.column("camera")) == 1, "saturated multiple", "multiple")
    pyarrow.parquet.write_table(named.append_column("flags", [flags]), tmp_path / "peaks.parquet")
    nominal = SensorDescription.default()
    measured = read_exposures(tmp_path / "peaks.parquet", nominal)
    assert [file.name for file in measured.files] == ["peaks.parquet", "ball.toml"]
    assert sum(len(one.stripe.row) for one in measured.exposures) == np.count_nonzero(flags == "multiple")
    assert not any((one.stripe.camera == 1).any() for one in measured.exposures)


def test_neighbouring_peaks_are_thinned(peaks, tmp_path) -> None:
    columns = {name: np.repeat(np.asarray(peaks.column(name)), 4) for name in peaks.column_names}
    columns["column_px"] = columns["column_px"] + np.tile(np.arange(4), len(peaks))
    inside = columns["column_px"] < 1280
    pyarrow.parquet.write_table(
        pyarrow.table({name: values[inside] for name, values in columns.items()}), tmp_path / "peaks.parquet"
    )
    measured = read_exposures(tmp_path / "peaks.parquet", SensorDescription.default())
    assert sum(len(one.stripe.row) for one in measured.exposures) == len(peaks)


GOOD = {
    **{"exposure": 1, "camera": 0, "column_px": 640, "row_px": 500, "row_sigma_px": 0.1, "target": "ball"},
    **{"x_mm": 0, "y_mm": 0, "z_mm": 130, "rx_deg": 0, "ry_deg": 0, "rz_deg": 0},
}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"camera": 2}, "column 'camera', row 2 = 2: expected a number from 0 to 1"),
        ({"column_px": 1300}, "column 'column_px', row 2 = 1300: expected a pixel of the image, 0 to 1279"),
        ({"row_px": ""}, "column 'row_px', row 2: is empty; expected a finite number"),
        ({"row_px": "left"}, "column 'row_px', row 2 = 'left': expected a number"),
        ({"row_sigma_px": 0}, "column 'row_sigma_px', row 2 = 0.0: expected a positive standard deviation"),
        ({"target": "cube"}, "column 'target', row 2 = 'cube': expected ball, step, checkered, or the file"),
        ({"z_mm": 140, "exposure": 1}, "column 'z_mm', row 2 = 140: expected the value of row 1"),
        ({"rx_deg": ""}, "column 'rx_deg', row 2: is empty; expected a finite number"),
    ],
)
def test_wrong_peaks_are_refused(tmp_path, changes, message) -> None:
    rows = [GOOD, {**GOOD, "exposure": 2, **changes}]
    lines = [",".join(GOOD), *(",".join(str(value) for value in row.values()) for row in rows)]
    (tmp_path / "peaks.csv").write_text("\n".join(lines) + "\n")
    with pytest.raises(DescriptionError) as error:
        read_exposures(tmp_path / "peaks.csv", SensorDescription.default())
    assert str(tmp_path / "peaks.csv") in str(error.value)
    assert message in str(error.value)


def test_missing_columns_and_too_few_peaks_are_refused(tmp_path) -> None:
    file = tmp_path / "peaks.csv"
    with pytest.raises(DescriptionError, match="no such file"):
        scancell.calibrate_sensor(SensorCalibrationRequest(from_points=file))
    file.write_text(",".join(GOOD) + "\n" + ",".join(str(value) for value in GOOD.values()) + "\n")
    with pytest.raises(CalibrationError, match="do not determine"):
        scancell.calibrate_sensor(SensorCalibrationRequest(from_points=file))
    file.write_text("exposure,camera\n1,0\n")
    with pytest.raises(DescriptionError, match="column 'row_sigma_px': is missing"):
        scancell.calibrate_sensor(SensorCalibrationRequest(from_points=file))


def test_stage_mounted_anywhere_and_unknown_radius() -> None:
    """The sensor frame is free then; the sheet is as described, so that true values are comparable."""
    request = SensorCalibrationRequest(("ball",), is_pose_known=False, is_size_known=False)
    report = scancell.calibrate_sensor(request, as_built=MISALIGNED[1:2], seed=3)
    rows = {row.name: row for row in report.rows}
    assert rows["target.radius_offset_mm"].value == pytest.approx(0.0, abs=1e-3)
    assert rows["sensor.camera[2].roll_deg"].error == pytest.approx(0.0, abs=2e-3)
    assert report.range_error.aligned
    assert report.range_error.after < 1e-6 < report.range_error.before
    # A turned sheet takes the sensor frame with it.
    request = SensorCalibrationRequest(("ball",), is_pose_known=False)
    turned = scancell.calibrate_sensor(request, as_built=MISALIGNED, seed=3)
    assert {row.true for row in turned.rows} == {None}
    assert "true values are not listed" in turned.warnings[0]
    assert turned.range_error.after < 1e-6


def test_views_of_a_board_are_written_and_read(tmp_path) -> None:
    camera = np.repeat(np.arange(2, dtype=np.int32), 30)
    pixels = np.random.default_rng(1).uniform(100.0, 900.0, (2, 60))
    on_board = np.column_stack([np.tile(np.arange(30) * 1e-3, 2), np.full(60, 4e-3), np.zeros(60)])
    corners = Corners(camera, pixels.T, on_board, 0.05)
    columns = np.tile(np.arange(30.0) * PEAK_SPACING, 2)
    stripe = StripePeaks(camera, columns, pixels[0], np.full(60, 0.1))
    views = [TargetExposure(surface_of("checkered"), np.eye(4), stripe, corners, 5)] * 2
    write_exposures(views, tmp_path / "views.csv")
    again = read_exposures(tmp_path / "views.csv", SensorDescription.default()).exposures
    assert len({one.mounting for one in again}) == 2  # each view is held by hand
    for read in again:
        assert read.target.source == "checkered board"
        for name in ("camera", "pixels", "points_in_target", "sigma"):
            np.testing.assert_allclose(getattr(read.corners, name), getattr(corners, name), rtol=0, atol=1e-12)
        for name in ("camera", "column", "row", "sigma"):
            np.testing.assert_allclose(getattr(read.stripe, name), getattr(stripe, name), rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (("sensor", "--poses", "3"), 2, "No such option: --poses"),
        (("sensor", "--engine", "ray-traced"), 2, "No such option: --engine"),
        (("sensor", "--target", "cube"), 1, "targets[0] = 'cube': expected 'ball', 'step', 'checkered'"),
        (("sensor", "--as-built", "tool.x_mm=1"), 1, "expected a key of the sensor"),
        (("sensor", "--also", "sensor.camera[1].f_number"), 1, "expected one of the keys"),
        (
            ("sensor", "--from-points", "p.csv", "--pose", "unknown"),
            1,
            "--pose: does not apply to calibrate sensor --from",
        ),
        (("tool", "--target", "ball"), 2, "No such option: --target"),
        (("tool", "--wobble"), 2, "No such option: --wobble"),
        (("sensor", "--from-images", "recorded", "--board", "7x6x10", "--seed", "1"), 2, "No such option: --seed"),
        (("board", "--board", "7x6x10"), 2, "Missing option '--from-images'"),
    ],
)
def test_options_that_do_not_apply_are_refused(tmp_path, words, code, message) -> None:
    done = scancell_here("calibrate", *words, "--out", "out", cwd=tmp_path)
    assert done.code == code
    assert message in done.err
    assert not list(tmp_path.iterdir())
