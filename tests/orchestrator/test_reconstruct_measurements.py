"""Reconstruction of real measurements: synthetic twins of every format give the cloud of their scan; wrong inputs."""

from __future__ import annotations

import json
import re
from dataclasses import fields
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow.parquet
import pytest
from orientations import ORIENTATIONS, USUAL
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

import scancell
from scancell.calibration.measured_table import MeasuredTable, write_measured_table
from scancell.cell.recording import slopes
from scancell.cli import app
from scancell.config.loading import assets_dir
from scancell.errors import CalibrationError, DescriptionError, EmptyScanError, ImageError
from scancell.geometry import pose
from scancell.geometry.orientation import CONVENTIONS
from scancell.views.pictures import write_page
from scancell.views.recorded_run import open_run

PART = assets_dir() / "parts" / "sphere_on_foot.stl"
# Exact images: extraction is the same, and no noise hides a difference.
SETTINGS = {"scan.max_profiles": 60, "sensor.geometric.rays": 256}


@pytest.fixture(scope="module")
def scanned() -> scancell.ScanResult:
    """A scan in which arm and table move."""
    return scancell.scan(PART, engine="geometric", settings=SETTINGS, as_built={"tool.x_mm": 0.2}, seed=2)


def joint_columns(result: scancell.ScanResult) -> dict[str, np.ndarray]:
    """Readings by exposure."""
    measured = result.recording.measured
    found: dict[str, np.ndarray] = {"exposure": measured.index, "time_s": measured.time}
    for of_joints, of_table, values, unit in (
        ("q", "table", measured.axes, "deg"),
        ("qd", "table_rate", measured.rates, "deg_s"),
        ("qdd", "table_acceleration", slopes(measured.rates, measured.time, measured.segment), "deg_s2"),
    ):
        *joints, table = np.degrees(values).T
        found |= {f"{of_joints}{i}_{unit}": column for i, column in enumerate(joints, 1)}
        found[f"{of_table}_{unit}"] = table
    return found


def flange_columns_of(
    result: scancell.ScanResult, convention: str, length: str = "mm", angle: str = "deg"
) -> dict[str, np.ndarray]:
    """Poses of the flange by exposure, in a convention."""
    arm, measured = result.nominal.arm, result.recording.measured
    flange = pose.inverse(arm.world_from_base) @ arm.fk(measured.q)
    scale = 1e3 if length == "mm" else 1.0
    found = {f"flange_{axis}_{length}": scale * flange[:, i, 3] for i, axis in enumerate("xyz")}
    numbers, unit = ORIENTATIONS[convention](Rotation.from_matrix(flange[:, :3, :3])), ""
    if CONVENTIONS[convention].is_angle:
        numbers, unit = (np.degrees(numbers) if angle == "deg" else numbers), f"_{angle}"
    found |= {f"flange_{convention}_{i}{unit}": column for i, column in enumerate(numbers.T, 1)}
    return found | {"exposure": measured.index, "table_deg": np.degrees(measured.table)}


def write_table(result: scancell.ScanResult, path: Path, columns: dict[str, np.ndarray]) -> Path:
    """The profiles of a scan with readings or poses as a table of points."""
    profiles = result.profiles
    points = 1e3 * np.asarray(profiles.points_in_sensor, float)
    write_measured_table(
        path,
        {
            **{name: values[profiles.frame] for name, values in columns.items()},
            **{f"{axis}_mm": points[:, i] for i, axis in enumerate("xyz")},
            "sigma_um": 1e6 * np.asarray(profiles.sigma, float),
            "camera": np.maximum(np.asarray(profiles.camera, np.int64), 0),
            "column_px": np.asarray(profiles.column, np.int64),
            "intensity_dn": np.asarray(profiles.intensity, float),
            "flags": np.asarray(profiles.flags, np.int64),
        },
    )
    return path


def require_same(found: scancell.Cloud, scanned: scancell.Cloud, distance: float) -> None:
    assert len(found) == len(scanned)
    assert np.abs(found.points_in_part - scanned.points_in_part).max() < distance
    assert np.asarray(found.sigma) == pytest.approx(np.asarray(scanned.sigma), rel=1e-6)
    assert np.array_equal(found.profile, scanned.profile) and np.array_equal(found.column, scanned.column)
    assert np.asarray(found.quality) == pytest.approx(np.asarray(scanned.quality), rel=1e-6)


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_table_with_joints_gives_the_cloud_of_the_scan(scanned, tmp_path, suffix) -> None:
    table = write_table(scanned, tmp_path / f"points.{suffix}", joint_columns(scanned))
    found = scancell.reconstruct(table, part=PART)
    require_same(found.cloud, scanned.cloud, 1e-9)
    same = np.isclose(found.cloud.normals, scanned.cloud.normals, atol=1e-6, equal_nan=True)
    assert same.all() and found.cloud.time == pytest.approx(scanned.cloud.time)
    assert found.deviation.rms == pytest.approx(scanned.deviation.rms, rel=1e-4)
    assert found.data.made.dropped.as_json() == scanned.dropped.as_json()


@pytest.mark.parametrize(
    ("separator", "decimal", "encoding", "above"),
    [
        (";", ",", "utf-8", ""),
        ("\t", ".", "utf-16", ""),
        (";", ".", "utf-8-sig", "Device;LLT\nPoints;9\n\n"),
        (" ", ".", "ascii", ""),
    ],
)
def test_tables_of_other_programs_give_the_same_cloud(scanned, tmp_path, separator, decimal, encoding, above) -> None:
    table = write_table(scanned, tmp_path / "points.csv", joint_columns(scanned))
    text = table.read_text().replace(".", decimal).replace(",", separator) if decimal == "." else None
    if text is None:
        text = table.read_text().replace(",", separator).replace(".", decimal)
    other = tmp_path / "points.txt"
    other.write_bytes((above + text.replace('"', "")).encode(encoding))
    expected, found = (scancell.reconstruct(path).cloud for path in (table, other))
    np.testing.assert_allclose(found.points_in_part, expected.points_in_part, atol=1e-12)


@pytest.mark.parametrize("value", [-98.304, 0.0, -99999.99])
def test_values_of_missing_points_are_left_out_and_counted(scanned, tmp_path, value) -> None:
    table = write_table(scanned, tmp_path / "points.parquet", joint_columns(scanned))
    columns = {name: np.array(column) for name, column in pyarrow.parquet.read_table(table).to_pydict().items()}
    missing = np.arange(len(columns["z_mm"])) % 5 == 3
    write_measured_table(tmp_path / "holes.csv", columns | {"z_mm": np.where(missing, value, columns["z_mm"])})
    write_measured_table(tmp_path / "rest.csv", {name: column[~missing] for name, column in columns.items()})
    found, expected = (scancell.reconstruct(tmp_path / f"{name}.csv", part=PART) for name in ("holes", "rest"))
    np.testing.assert_array_equal(found.cloud.points_in_part, expected.cloud.points_in_part)
    assert f"{int(missing.sum())} of {len(missing)} points are left out: their z_mm = {value:.10g}" in found.warnings[0]


def test_surface_without_poses_is_a_cloud_in_the_base_frame(tmp_path) -> None:
    (tmp_path / "surface.csv").write_text("Info\n1,2\nY\\X,0.0,10.0,20.0\n0.0,1.0,2.0,3.0\n5.0,4.0,,6.0\nEnd\n")
    result = scancell.reconstruct(tmp_path / "surface.csv")
    expected = np.array([[0, 0, 1], [10, 0, 2], [20, 0, 3], [0, 5, 4], [20, 5, 6]]) * 1e-3
    np.testing.assert_allclose(result.cloud.points_in_part, expected, atol=1e-9)
    assert "states no poses" in result.warnings[0]
    assert "1 of 6 records" in result.warnings[1]
    result.save(tmp_path / "out")


def test_belt_needs_a_part_that_arrives_on_it(scanned, tmp_path) -> None:
    table = write_table(scanned, tmp_path / "points.csv", joint_columns(scanned))
    with pytest.raises(DescriptionError, match=r"cell\.part\.arrival"):
        scancell.reconstruct(table, part=PART, settings={"scan.belt.pose.z_mm": 100.0})


def test_yaml_table_gives_the_same_cloud(scanned, tmp_path) -> None:
    import yaml  # noqa: PLC0415

    columns, profiles = joint_columns(scanned), scanned.profiles
    entries = []
    for row in np.unique(profiles.frame):
        points = (1e3 * profiles.points_in_sensor[profiles.frame == row]).tolist()
        entry: dict[str, Any] = {name: values[row].item() for name, values in columns.items()}
        entries.append(entry | {f"{axis}_mm": [point[i] for point in points] for i, axis in enumerate("xyz")})
    (tmp_path / "points.yaml").write_text(yaml.safe_dump(entries))
    found = scancell.reconstruct(tmp_path / "points.yaml", part=PART)
    assert np.abs(found.cloud.points_in_part - scanned.cloud.points_in_part).max() < 1e-9


@pytest.mark.parametrize(
    ("convention", "length", "angle"),
    [(name, *(("mm", "deg"), ("m", "rad"))[number % 2]) for number, name in enumerate(USUAL)],
)
def test_flange_poses_of_every_convention_give_the_cloud_of_the_scan(
    scanned, tmp_path, convention, length, angle
) -> None:
    columns = flange_columns_of(scanned, convention, length, angle)
    found = scancell.reconstruct(write_table(scanned, tmp_path / "points.parquet", columns), part=PART)
    require_same(found.cloud, scanned.cloud, 1e-7)


def test_calibrated_cell_is_used(scanned, tmp_path) -> None:
    """Deviations and latency of the estimated cell take part as in a scan."""
    estimated = scancell.EstimatedDescription.of({"tool.x": 2e-4, "trigger.latency": 3e-3}, joints=6)
    cell = scanned.setup.cell.model_copy(update={"estimated": estimated})
    with scancell.Scanner(cell=cell, settings=SETTINGS) as scanner:
        again = scanner.scan(PART, engine="geometric", as_built={"tool.x_mm": 0.2}, seed=2, plan=scanned.plan)
    table = write_table(scanned, tmp_path / "points.parquet", joint_columns(scanned))
    found = scancell.reconstruct(table, cell=cell, part=PART)
    require_same(found.cloud, again.cloud, 1e-9)
    at_zero = scancell.reconstruct(table, cell=cell, part=PART, latency_ms=0.0)
    assert np.abs(at_zero.cloud.points_in_part[:100] - found.cloud.points_in_part[:100]).max() > 1e-6


def test_without_a_part_the_cloud_is_in_the_frame_of_the_base(scanned, tmp_path) -> None:
    found = scancell.reconstruct(write_table(scanned, tmp_path / "p.parquet", flange_columns_of(scanned, "matrix")))
    assert len(found.cloud) == len(scanned.profiles.frame)
    base_from_part = scanned.frame_from_part("base")
    part = pose.transform_points(pose.inverse(base_from_part), found.cloud.points_in_part)
    kept = np.flatnonzero(np.isin(scanned.profiles.frame, np.arange(len(scanned.recording))))
    in_part = np.array([np.abs(part - point).max(1).min() for point in scanned.cloud.points_in_part[::500]])
    assert len(kept) == len(part) and in_part.max() < 1e-7
    assert found.deviation is None and found.picture() is None


@pytest.fixture(scope="module")
def imaged(tmp_path_factory) -> tuple[scancell.ScanResult, Path]:
    """A ray-traced scan with its images, and their poses as a table."""
    folder = tmp_path_factory.mktemp("imaged")
    settings = {
        **{"scan.max_profiles": 10, "sensor.detector.laser_off_frame": False, "scan.sweep.enabled": False},
        **{
            f"sensor.camera[{i}].{key}": value for i in (1, 2) for key, value in (("width_px", 320), ("height_px", 256))
        },
    }
    names, images = [], []

    def keep(one: scancell.ExposureImages) -> None:
        for name, image in zip(("plus", "minus"), one.images, strict=True):
            assert cv2.imwrite(str(folder / f"raw_{one.trigger:05d}_{name}.png"), image)
        names.append(f"raw_{one.trigger:05d}")
        images.append(one)

    with scancell.Scanner(settings=settings) as scanner:
        result = scanner.scan(PART, on_images=keep, seed=3)
        scanner.setup.sensor.to_toml(folder / "sensor.toml")
    write_measured_table(folder / "poses.csv", {"image": names, **joint_columns(result)})
    return result, folder


def test_images_give_the_points_and_covariance_of_the_scan(imaged) -> None:
    result, folder = imaged
    found = scancell.reconstruct(folder, sensor=folder / "sensor.toml", part=PART)
    measured, scan = found.data.found.profiles, result.profiles
    assert np.array_equal(measured.frame, scan.frame) and np.array_equal(measured.column, scan.column)
    assert measured.points_in_sensor == pytest.approx(scan.points_in_sensor, abs=1e-12)
    assert np.array_equal(measured.sigma, scan.sigma) and np.array_equal(measured.flags, scan.flags)
    require = {one.name for one in fields(found.cloud)} - {"profile", "segment"}
    for name in require:
        own, other = (np.asarray(getattr(cloud, name), float) for cloud in (found.cloud, result.cloud))
        assert np.allclose(own, other, atol=1e-9, equal_nan=True), name
    largest = np.sqrt(np.linalg.eigvalsh(found.covariance)[:, -1])
    assert largest == pytest.approx(np.asarray(result.cloud.sigma, float), rel=1e-4)


def test_turned_images_are_turned_back(imaged, tmp_path) -> None:
    result, folder = imaged
    for file in folder.glob("*.png"):
        cv2.imwrite(str(tmp_path / file.name), np.rot90(cv2.imread(str(file), cv2.IMREAD_UNCHANGED), -1))
    (tmp_path / "poses.csv").write_bytes((folder / "poses.csv").read_bytes())
    found = scancell.reconstruct(tmp_path, sensor=folder / "sensor.toml", part=PART, quarter_turns=1)
    assert np.abs(found.cloud.points_in_part - result.cloud.points_in_part).max() < 1e-9
    with pytest.raises(ImageError, match="256 x 320 pixels"):
        scancell.reconstruct(tmp_path, sensor=folder / "sensor.toml", part=PART)


def test_run_folder_is_an_input_again(scanned, tmp_path) -> None:
    table = write_table(scanned, tmp_path / "points.parquet", flange_columns_of(scanned, "xyzwpr"))
    found = scancell.reconstruct(table, part=PART)
    files = {path.name for path in found.save(tmp_path / "run", ["ply", "npz"])}
    assert files == {
        *("cloud.ply", "cloud.npz", "covariance.parquet", "profiles.parquet", "points.parquet", "recording.parquet"),
        *("deviation.json", "deviation.png", "deviation.html", "reconstruction.json", "resolved.toml", "manifest.json"),
    }
    again = scancell.reconstruct(
        tmp_path / "run" / "points.parquet", cell=tmp_path / "run" / "resolved.toml", part=PART
    )
    require_same(again.cloud, found.cloud, 1e-9)
    assert again.covariance == pytest.approx(found.covariance, abs=1e-18)
    assert pyarrow.parquet.read_table(tmp_path / "run" / "covariance.parquet").num_rows == len(found.cloud)
    # What reads run folders takes it.
    assert scancell.evaluate(tmp_path / "run", mesh=PART).statistics.rms == pytest.approx(found.deviation.rms, rel=1e-3)
    run = open_run(tmp_path / "run")
    flange = run.motion.frames(float(scanned.recording.measured.time[3]))
    assert set(flange) >= {"sensor", "table", "part"}
    json.loads((tmp_path / "run" / "manifest.json").read_text())["inputs"][str(table)]


def test_recording_of_a_run_holds_its_readings(scanned, tmp_path) -> None:
    """Joints with their rates as measured; joints found from poses of the flange, which state no rates, with 0."""
    measured = scanned.recording.measured
    of_joints = measured.rates[:, :6]
    assert np.abs(of_joints).max() > 0.01
    for columns, rates in (
        (joint_columns(scanned), of_joints),
        (flange_columns_of(scanned, "wxyz"), np.zeros_like(of_joints)),
    ):
        run = tmp_path / f"{len(columns)}"
        table = write_table(scanned, tmp_path / f"{len(columns)}.parquet", columns)
        scancell.reconstruct(table, part=PART).save(run)
        found = pyarrow.parquet.read_table(run / "recording.parquet")
        row = np.searchsorted(measured.index, found["trigger.index"].to_numpy())
        for i in range(1, 7):
            assert found[f"trigger.measured.qd[{i}]"].to_numpy() == pytest.approx(rates[row, i - 1], abs=1e-9)
        table_angle = found["trigger.measured.table"].to_numpy()
        assert table_angle == pytest.approx(measured.table[row], abs=1e-9)


def test_mesh_animate_and_export_take_the_run_folder(scanned, tmp_path) -> None:
    table = write_table(scanned, tmp_path / "points.parquet", flange_columns_of(scanned, "xyzwpr"))
    scancell.reconstruct(table, part=PART).save(tmp_path / "run")
    surface = scancell.mesh(tmp_path / "run", tmp_path / "surface.ply", spacing_mm=1.0)
    assert len(surface.faces) > 1000
    size = ("--size", "160x120", "--seconds", "0.2", "--fps", "10", "--view", "part")
    for words in (("animate", *size, "--out", tmp_path / "run.webp"), ("export", "--out", tmp_path / "run.mcap")):
        done = CliRunner().invoke(app, [words[0], str(tmp_path / "run"), *map(str, words[1:]), "--json"])
        assert done.exit_code == 0, done.output
    assert cv2.imread(str(tmp_path / "run.webp")) is not None
    figures = json.loads(done.stdout.splitlines()[-1])["figures"]
    assert figures["points"] > 1000 and figures["messages"] > len(scanned.recording.measured.index)


def test_run_without_a_part_is_drawn(scanned, tmp_path) -> None:
    table = write_table(scanned, tmp_path / "points.parquet", flange_columns_of(scanned, "wxyz"))
    scancell.reconstruct(table).save(tmp_path / "run")
    run = open_run(tmp_path / "run")
    assert run.part is None and run.cloud is not None
    in_world = pose.transform_points(run.cell.world_from("part"), run.cloud.points_in_part)
    assert np.abs(in_world[:, 2]).max() < 1.0
    assert scancell.picture(tmp_path / "run", tmp_path / "picture.png", size=(160, 120)) >= 0
    assert write_page(run, tmp_path / "page.html") > 0


def test_latency_is_estimated(tmp_path) -> None:
    """Points of motions in different directions agree with the part at one delay."""
    with scancell.Scanner(settings={"scan.max_profiles": 200}) as scanner:
        result = scanner.scan(PART, engine="geometric", as_built={"trigger.latency_ms": 2.0}, seed=5)
    table = write_table(result, tmp_path / "points.parquet", joint_columns(result))
    found = scancell.reconstruct(table, part=PART, latency_ms="estimate")
    assert found.data.latency.half_width is not None
    assert abs(1e3 * found.data.latency.value - 2.0) < max(2e3 * found.data.latency.half_width, 0.02)
    assert found.deviation.rms < 0.5 * scancell.reconstruct(table, part=PART).deviation.rms


def test_latency_without_rates_is_refused(scanned, tmp_path) -> None:
    flange = write_table(scanned, tmp_path / "flange.parquet", flange_columns_of(scanned, "xyz"))
    with pytest.raises(CalibrationError, match="flange poses state no rates"):
        scancell.reconstruct(flange, part=PART, latency_ms="estimate")
    with pytest.raises(CalibrationError, match="flange poses state no rates"):
        scancell.reconstruct(flange, part=PART, latency_ms=1.0)
    still = {name: values for name, values in joint_columns(scanned).items() if "_s" not in name.removesuffix("time_s")}
    table = write_table(scanned, tmp_path / "still.parquet", still)
    with pytest.raises(CalibrationError, match="all rates are 0"):
        scancell.reconstruct(table, part=PART, latency_ms="estimate")
    moving = write_table(scanned, tmp_path / "moving.parquet", joint_columns(scanned))
    with pytest.raises(CalibrationError, match="part"):
        scancell.reconstruct(moving, latency_ms="estimate")


def changed(scanned, path: Path, columns: dict[str, np.ndarray], **other: np.ndarray) -> Path:
    return write_table(scanned, path, {**columns, **other})


def test_wrong_convention_is_named(scanned, tmp_path) -> None:
    columns = flange_columns_of(scanned, "xyzwpr")
    wrong = {name.replace("xyzwpr", "zyz"): values for name, values in columns.items()}
    with pytest.raises(CalibrationError, match=r"do not fit the part as zyz .* they fit .* as xyzwpr"):
        scancell.reconstruct(changed(scanned, tmp_path / "p.parquet", wrong), part=PART)
    quaternion = {n.replace("xyzw", "wxyz"): v for n, v in flange_columns_of(scanned, "xyzw").items()}
    with pytest.raises(CalibrationError, match="as xyzw "):
        scancell.reconstruct(changed(scanned, tmp_path / "p.parquet", quaternion), part=PART)


def test_swapped_and_mirrored_columns_are_named(scanned, tmp_path) -> None:
    table = write_table(scanned, tmp_path / "p.parquet", joint_columns(scanned))
    read = pyarrow.parquet.read_table(table)
    names = {"y_mm": "z_mm", "z_mm": "y_mm"}
    pyarrow.parquet.write_table(read.rename_columns([names.get(n, n) for n in read.column_names]), table)
    with pytest.raises(CalibrationError, match="with y_mm and z_mm swapped"):
        scancell.reconstruct(table, part=PART)
    swapped = flange_columns_of(scanned, "matrix")
    swapped["flange_x_mm"], swapped["flange_y_mm"] = swapped["flange_y_mm"], swapped["flange_x_mm"]
    with pytest.raises(CalibrationError, match="position in the order y, x, z"):
        scancell.reconstruct(changed(scanned, tmp_path / "q.parquet", swapped), part=PART)


def test_degrees_and_radians_are_told_apart(scanned, tmp_path) -> None:
    columns = joint_columns(scanned)
    radians = {n: np.radians(v) if re.fullmatch(r"q\d_deg", n) else v for n, v in columns.items()}
    with pytest.raises(CalibrationError, match="with angles of the joints in rad in place of deg"):
        scancell.reconstruct(changed(scanned, tmp_path / "p.parquet", radians), part=PART)
    flange = flange_columns_of(scanned, "xyz", "m", "rad")
    degrees = {n: np.degrees(v) if n.endswith("_rad") else v for n, v in flange.items()}
    with pytest.raises(DescriptionError, match=r"angles of the flange in rad, row \d+.*degrees\?"):
        scancell.reconstruct(changed(scanned, tmp_path / "q.parquet", degrees), part=PART)


@pytest.mark.parametrize("kind", ["joints", "flange"])
def test_single_wrong_pose_is_named(scanned, tmp_path, kind) -> None:
    columns = joint_columns(scanned) if kind == "joints" else flange_columns_of(scanned, "rotvec")
    number = int(scanned.cloud.profile[len(scanned.cloud) // 2])
    row = int(np.flatnonzero(columns["exposure"] == number)[0])
    key, amount = ("q2_deg", 2.0) if kind == "joints" else ("flange_z_mm", 20.0)
    wrong = columns[key].copy()
    wrong[row] += amount
    with pytest.raises(CalibrationError, match=rf"1 of \d+ exposures disagree .*exposure {number} by"):
        scancell.reconstruct(changed(scanned, tmp_path / "p.parquet", columns, **{key: wrong}), part=PART)


def test_results_of_a_calibration_are_used(scanned, imaged, tmp_path) -> None:
    """The calibrated sensor, its pose on the flange and the quarter turns; each is given once."""
    result, folder = imaged
    moved = pose.from_euler_xyz((1e-3, -2e-3, 5e-4), (0.01, 0.0, -0.02))
    found = {
        "quarter_turns": 0,
        "flange_from_sensor_m": (result.nominal.flange_from_sensor @ moved).tolist(),
    }
    (tmp_path / "calibration.json").write_text(json.dumps(found))
    (tmp_path / "calibrated_sensor.toml").write_bytes((folder / "sensor.toml").read_bytes())
    there = scancell.reconstruct(folder, calibration=tmp_path)
    here = scancell.reconstruct(folder, sensor=folder / "sensor.toml")
    first = int(there.data.found.profiles.frame[0])
    base_from_sensor = here.data.made.part_from_sensor[first]
    sensor = pose.transform_points(pose.inverse(base_from_sensor @ moved), there.cloud.points_in_part[:1])
    expected = pose.transform_points(pose.inverse(base_from_sensor), here.cloud.points_in_part[:1])
    assert sensor == pytest.approx(expected, abs=1e-9)
    with pytest.raises(DescriptionError, match=r"conflicts with .* of the calibration"):
        scancell.reconstruct(folder, calibration=tmp_path, sensor=folder / "sensor.toml")
    (tmp_path / "calibration.json").write_text(json.dumps({**found, "flange_from_sensor_m": np.ones((4, 4)).tolist()}))
    with pytest.raises(DescriptionError, match="flange_from_sensor_m"):
        scancell.reconstruct(folder, calibration=tmp_path)


def test_mixed_and_missing_poses_are_refused(scanned, imaged, tmp_path) -> None:
    both = {**joint_columns(scanned), **flange_columns_of(scanned, "wxyz")}
    with pytest.raises(DescriptionError, match="states joints and flange poses"):
        scancell.reconstruct(write_table(scanned, tmp_path / "both.csv", both))
    neither = {name: values for name, values in joint_columns(scanned).items() if not name.startswith("q")}
    with pytest.raises(DescriptionError, match="neither joints nor flange poses"):
        scancell.reconstruct(write_table(scanned, tmp_path / "neither.csv", neither))
    two = {**flange_columns_of(scanned, "wxyz"), **flange_columns_of(scanned, "xyz")}
    with pytest.raises(DescriptionError, match="given twice"):
        scancell.reconstruct(write_table(scanned, tmp_path / "two.csv", two))
    _, folder = imaged
    for file in folder.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    table = (folder / "poses.csv").read_text().splitlines()
    (tmp_path / "poses.csv").write_text("\n".join(table[:-1]) + "\n")
    with pytest.raises(DescriptionError, match=r"holds no pose of 1 of the \d+ exposures"):
        scancell.reconstruct(tmp_path, sensor=folder / "sensor.toml")
    (tmp_path / "poses.csv").write_text("\n".join([*table, table[-1]]) + "\n")
    with pytest.raises(DescriptionError, match="one row for each exposure"):
        scancell.reconstruct(tmp_path, sensor=folder / "sensor.toml")


def test_nothing_half_written(scanned, tmp_path) -> None:
    columns = joint_columns(scanned)
    table = write_table(scanned, tmp_path / "p.parquet", columns)
    found = scancell.reconstruct(table, part=PART)
    with pytest.raises(DescriptionError):
        found.save(tmp_path / "run", ["obj"])
    assert not (tmp_path / "run").exists()
    high = {**columns, "table_deg": columns["table_deg"]}
    far = write_table(scanned, tmp_path / "far.parquet", high)
    with pytest.raises((EmptyScanError, CalibrationError)):
        scancell.reconstruct(far, part=PART, settings={"cell.table.pose.z_mm": 900})
    assert MeasuredTable(far).names
