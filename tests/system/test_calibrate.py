"""Calibration in the simulated cell: what it finds, what clouds gain, its files, and points of a real cell."""

from __future__ import annotations

import json
import re

import numpy as np
import pyarrow.compute
import pyarrow.csv
import pyarrow.parquet
import pytest
import trimesh
from commands import scancell_here

import scancell
from bench.calibration_cloud import AS_BUILT as MISALIGNED
from scancell.calibration.cell.kinematics import LATENCY
from scancell.calibration.cell.scan import CalibrationRequest
from scancell.config.cell import CellDescription
from scancell.config.loading import assets_dir
from scancell.errors import CalibrationError, DescriptionError

PART = assets_dir() / "parts" / "sphere_on_foot.stl"


def errors_in_half_widths(report) -> np.ndarray:
    return np.array([row.error / row.half_width for row in report.rows])


@pytest.fixture(scope="module")
def scanner():
    with scancell.Scanner(settings={"scan.max_profiles": 200}) as opened:
        yield opened


@pytest.fixture(scope="module")
def everything(scanner):
    return scanner.calibrate("all", as_built=MISALIGNED, seed=1)


def test_all_deviations_are_found(everything) -> None:
    assert len(everything.rows) == 13
    assert np.abs(errors_in_half_widths(everything)).max() < 3
    assert everything.result.noise_of_points == pytest.approx(1.0, abs=0.3)
    assert not everything.warnings


@pytest.mark.parametrize("artefact", ["plane", "v_groove", "ridge"])
def test_tool_from_other_artefacts(scanner, artefact, tmp_path) -> None:
    """One plane, a groove, and the two faces along a straight edge; where they stand is found, too."""
    path = assets_dir() / "artefacts" / f"{artefact}.toml"
    if artefact == "ridge":
        path = tmp_path / "ridge.stl"
        bottom = [[-40, -40, 0], [40, -40, 0], [40, 40, 0], [-40, 40, 0]]
        faces = [[0, 2, 1], [0, 3, 2], [0, 1, 5], [0, 5, 4], [2, 3, 4], [2, 4, 5], [1, 2, 5], [3, 0, 4]]
        trimesh.Trimesh([*bottom, [-40, 0, 30], [40, 0, 30]], faces).export(path)
    built = {"tool.x_mm": 1.0, "tool.y_mm": -0.6, "tool.rx_deg": 0.5, "tool.rz_deg": 0.3}
    report = scanner.calibrate("tool", path, as_built=built, seed=1)
    for row in report.rows:
        assert abs(row.error) < (0.005 if row.unit == "mm" else 0.001), row
    assert np.abs(errors_in_half_widths(report)).max() < 3


def test_cloud_after_calibration_is_nearly_the_ideal_one(scanner, everything) -> None:
    options = {"engine": "geometric", "seed": 2, "normals": False, "samples": False}
    before = scanner.scan(PART, as_built=MISALIGNED, **options).deviation.figures.rms
    after = scanner.scan(PART, as_built=MISALIGNED, estimated=everything.estimated, **options).deviation.figures.rms
    ideal = scanner.scan(PART, **options).deviation.figures.rms
    assert before > 200e-6
    assert np.sqrt(max(after**2 - ideal**2, 0.0)) < 15e-6


def test_calibrated_cell_is_a_description_that_scans_use(scanner, everything, tmp_path) -> None:
    everything.save(tmp_path / "out")
    written = CellDescription.from_toml(tmp_path / "out/calibrated.toml")
    assert written.estimated == everything.estimated
    options = {"engine": "geometric", "seed": 2, "normals": False, "samples": False, "as_built": MISALIGNED}
    with scancell.Scanner(tmp_path / "out/calibrated.toml", settings={"scan.max_profiles": 200}) as other:
        by_file = other.scan(PART, **options)
        profile = other.plan(PART)
    by_argument = scanner.scan(PART, **options, estimated=everything.estimated)
    assert by_file.cloud.points_in_part == pytest.approx(by_argument.cloud.points_in_part, abs=1e-9)
    # Planning and the simulated cell go by the description, not by the estimates.
    assert profile.q == pytest.approx(scanner.plan(PART).q, abs=1e-12)
    figures = json.loads((tmp_path / "out/calibration.json").read_text())
    assert {row["name"] for row in figures["deviations"]} == set(everything.result.names)
    assert np.array(figures["covariance_si"]).shape == (13, 13)


def test_live_profiles_and_lines_use_the_estimates(tmp_path) -> None:
    described = CellDescription.default().replace({"estimated.tool.z_mm": 1.0})
    points = {}
    for name, cell in {"nominal": None, "estimated": described}.items():
        with scancell.Scanner(cell) as opened, opened.session(PART) as session:
            points[name] = session.profile("geometric").points_in_base
            axis = session.nominal.world_from_sensor(session.joints)[:3, 2]
    assert points["estimated"] - points["nominal"] == pytest.approx(np.tile(1e-3 * axis, (len(points["nominal"]), 1)))


def test_tool_from_rendered_images(scanner) -> None:
    as_built = {"tool.x_mm": 0.5, "tool.ry_deg": 0.2}
    report = scanner.calibrate(CalibrationRequest("tool", poses=10), as_built=as_built, engine="ray-traced", seed=3)
    by_name = {row.name: row for row in report.rows}
    assert by_name["tool.x"].value == pytest.approx(0.5, abs=0.01)
    assert by_name["tool.ry"].value == pytest.approx(0.2, abs=0.01)


def test_encoder_noise_is_found_as_noise_of_the_robot() -> None:
    noise = {f"cell.robot.joint[{joint}].encoder_noise_deg": 0.003 for joint in range(1, 7)}
    with scancell.Scanner(settings=noise) as noisy:
        report = noisy.calibrate(CalibrationRequest("tool", robot_noise="joints"), as_built={"tool.y_mm": 0.5}, seed=4)
    assert np.degrees(report.result.noise_of_robot[0]) == pytest.approx(0.003, rel=0.4)
    assert np.abs(errors_in_half_widths(report)).max() < 2


def test_tool_far_from_its_description_is_found_from_a_sphere(scanner) -> None:
    as_built = {"tool.x_mm": 4.0, "tool.z_mm": -3.0, "tool.ry_deg": 2.0, "tool.rz_deg": 1.5}
    report = scanner.calibrate("tool", as_built=as_built, seed=8)
    assert np.abs(errors_in_half_widths(report)).max() < 3
    assert max(row.half_width for row in report.rows) < 0.02


def test_wobble_of_the_table_is_found(scanner) -> None:
    as_built = {"table.wobble_amplitude_deg": 0.05, "table.wobble_phase_deg": 30.0, "table.wobble_direction_deg": 70.0}
    report = scanner.calibrate(CalibrationRequest("table", wobble=True), as_built=as_built, seed=5)
    assert max(abs(row.true) for row in report.rows if "wobble" in row.name) > 0.01
    assert np.abs(errors_in_half_widths(report)).max() < 3


def test_table_axis_from_the_mesh_of_a_part(scanner) -> None:
    request = CalibrationRequest("table", is_pose_known=False)
    part = assets_dir() / "parts" / "free_form.stl"
    report = scanner.calibrate(request, part, as_built={"table.x_mm": 0.3, "table.ry_deg": 0.15}, seed=9)
    assert np.abs(errors_in_half_widths(report)).max() < 3
    assert max(row.half_width for row in report.rows) < 0.01


def test_latency_from_the_mesh_of_a_part(scanner) -> None:
    request = CalibrationRequest("latency", passes=6)
    report = scanner.calibrate(request, PART, as_built={"trigger.latency_ms": 3.0}, seed=6)
    assert report.result.deviations[LATENCY] == pytest.approx(3e-3, abs=0.05e-3)


def test_points_of_a_file_give_the_same_calibration(scanner, tmp_path) -> None:
    first = scanner.calibrate("tool", as_built={"tool.x_mm": 0.5}, seed=7)
    first.save(tmp_path)
    table = pyarrow.parquet.read_table(tmp_path / "points.parquet")
    pyarrow.csv.write_csv(table, tmp_path / "points.csv")
    for name in ("points.parquet", "points.csv"):
        again = scanner.calibrate("tool", from_points=tmp_path / name)
        assert again.true is None
        assert again.result.values == pytest.approx(first.result.values, abs=1e-8)
        assert again.result.standard_deviations == pytest.approx(first.result.standard_deviations, rel=1e-3)
    # Points beside the artefact are counted, not used.
    off = table.to_pydict()
    away = {name: [*values, *values[:40]] for name, values in off.items()}
    away["z_mm"][-40:] = [value - 30 for value in away["z_mm"][-40:]]
    pyarrow.csv.write_csv(pyarrow.table(away), tmp_path / "more.csv")
    more = scanner.calibrate("tool", from_points=tmp_path / "more.csv")
    assert more.figures["points"] == len(table) + 40
    assert more.figures["points_on_artefact"] <= len(table)
    assert more.summary().startswith(f"{len(more.result.residuals)} of {len(table) + 40} points")


@pytest.fixture(scope="module")
def plate_points(everything, tmp_path_factory):
    """A third of the points of the ball plate in a file."""
    folder = tmp_path_factory.mktemp("everything")
    everything.save(folder)
    points = pyarrow.parquet.read_table(folder / "points.parquet")
    pyarrow.parquet.write_table(points.take(np.arange(0, len(points), 3)), folder / "third.parquet")
    return folder / "third.parquet"


def altered_plate(folder, *replacements: tuple[str, str]):
    text = (assets_dir() / "artefacts" / "ball_plate.toml").read_text()
    for old, new in replacements:
        assert old in text
        text = text.replace(old, new)
    path = folder / "altered.toml"
    path.write_text(text)
    return path


@pytest.mark.parametrize(("described", "difference"), [(14.98, "+0.020"), (15.06, "-0.060")])
def test_wrong_diameter_is_named(scanner, plate_points, tmp_path, described, difference) -> None:
    """Some errors of the size pass as pose errors of the robot, others determine nothing: both must name the size."""
    artefact = altered_plate(tmp_path, ("diameter_mm = 15.0", f"diameter_mm = {described}"))
    expected = rf"differs from the described one, of 'ball1' by {re.escape(difference)} mm"
    try:
        said = " ".join(scanner.calibrate("all", artefact, from_points=plate_points).warnings)
    except CalibrationError as error:
        said = str(error)
    assert re.search(expected, said), said
    sized = CalibrationRequest("all", is_size_known=False)
    report = scanner.calibrate(sized, artefact, from_points=plate_points)
    seen = report.result.size_standard_deviations > 0
    assert seen.sum() >= 4, "without points on it, a ball keeps its size"
    assert 2e3 * report.result.sizes[seen] == pytest.approx(15.0 - described, abs=2e-3)
    assert (report.result.size_standard_deviations < 0.5e-6).all()
    assert not report.warnings


def mirrored(points, folder):
    table = pyarrow.parquet.read_table(points)
    number = table.column_names.index("y_mm")
    path = folder / "mirrored.parquet"
    y = pyarrow.compute.negate(table.column("y_mm"))
    pyarrow.parquet.write_table(table.set_column(number, "y_mm", y), path)
    return path


def test_mirrored_profiles_are_asked_about(scanner, plate_points, tmp_path) -> None:
    """Profiles of one sphere do not tell a mirrored sensor from one that is mounted the other way round."""
    with pytest.raises(CalibrationError, match=r"with the sign of y_mm changed the points agree .*: is y mirrored\?"):
        scanner.calibrate("all", from_points=mirrored(plate_points, tmp_path))
    scanner.calibrate("tool", seed=7).save(tmp_path)
    report = scanner.calibrate("tool", from_points=mirrored(tmp_path / "points.parquet", tmp_path))
    (warning,) = report.warnings
    assert re.match(r"tool.rz = -?180 deg is implausibly large: is y mirrored", warning)


def test_opposite_sign_of_the_table_is_asked_about(scanner, plate_points, tmp_path) -> None:
    table = pyarrow.parquet.read_table(plate_points)
    number = table.column_names.index("table_deg")
    opposite = table.set_column(number, "table_deg", pyarrow.compute.negate(table.column("table_deg")))
    pyarrow.parquet.write_table(opposite, tmp_path / "opposite.parquet")
    with pytest.raises(CalibrationError, match="with the sign of table_deg changed the points agree with the artefact"):
        scanner.calibrate("all", from_points=tmp_path / "opposite.parquet")


def test_shift_of_an_artefact_without_its_supports_is_stated(scanner, plate_points, tmp_path) -> None:
    """Balls of the plate without plate and stems come to stand on the table, 32.5 mm below where they were measured."""
    text = (assets_dir() / "artefacts" / "ball_plate.toml").read_text()
    head, *shapes = text.split("[[shape]]")
    artefact = tmp_path / "balls.toml"
    artefact.write_text("[[shape]]".join([head, *(one for one in shapes if '"support"' not in one)]))
    with pytest.raises(CalibrationError) as refused:
        scanner.calibrate("all", artefact, from_points=plate_points)
    said = str(refused.value)
    assert "0 exposures show the artefact with 5 points or more" in said
    distance = float(re.search(r"median distance of these others is ([\d.]+) mm", said)[1])
    assert 15 < distance < 40
    assert "coordinates are shifted by (0.0, 0.0, -32.5) mm" in said
    report = scanner.calibrate(CalibrationRequest("all", passes=2, poses=12), artefact)
    assert any("shifted by (0.0, 0.0, -32.5) mm" in warning for warning in report.warnings)
    assert "origin of the artefact's coordinates on the table: (0.000, 0.000, -32.500) mm" in report.summary()


def test_wrong_points_are_refused(scanner, tmp_path) -> None:
    good = "exposure,q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,table_deg,y_mm,z_mm\n1,0,0,0,0,0,0,0,1,100\n"
    cases = {
        "missing": (good.replace("table_deg", "turn"), "column 'table_deg': is missing"),
        "words": (good.replace(",1,100", ",left,100"), "column 'y_mm', row 1 = 'left': expected a number"),
        "unequal": (good + "1,5,0,0,0,0,0,0,1,100\n", "row 2: q differs from that in the first row of exposure 1"),
        "few": (good, "does not determine 9 unknowns, its centre included: .* 5 exposures or more are needed"),
    }
    for name, (text, message) in cases.items():
        file = tmp_path / f"{name}.csv"
        file.write_text(text)
        with pytest.raises((DescriptionError, CalibrationError), match=message):
            scanner.calibrate("tool", from_points=file)
    with pytest.raises(DescriptionError, match="no such file"):
        scanner.calibrate("tool", from_points=tmp_path / "none.csv")


def test_command_writes_a_calibrated_cell(tmp_path) -> None:
    out = tmp_path / "calibration"
    done = scancell_here(
        "calibrate", "tool", "--as-built", "tool.x_mm=0.4", "--poses", "8", "--out", out, "--json", cwd=tmp_path
    )
    assert done.code == 0, done.err
    assert done.last_line["ok"] and len(done.last_line["figures"]["deviations"]) == 6
    assert {item.name for item in out.iterdir()} == {
        *(
            "calibrated.toml",
            "calibration.json",
            "manifest.json",
            "plan.json",
            "points.parquet",
            "residuals.png",
            "resolved.toml",
        )
    }
    assert CellDescription.from_toml(out / "calibrated.toml").estimated.tool.x_mm == pytest.approx(0.4, abs=0.01)


def test_two_poses_are_refused_with_a_message(tmp_path) -> None:
    done = scancell_here("calibrate", "tool", "--poses", "2", "--out", tmp_path / "out", cwd=tmp_path)
    assert done.code == 1
    assert "2 exposure(s) does not determine 9 unknowns" in done.err
    assert not (tmp_path / "out").exists()
