"""Calibration of the tool from flange poses of a real robot: conventions, files, wrong inputs."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
import pyarrow.parquet
import pytest
import yaml
from orientations import ORIENTATIONS
from scipy.spatial.transform import Rotation

import scancell
from benchmarks.sphere_cell import (
    RADIUS,
    REALISTIC,
    SphereCase,
    default_kinematics,
    sphere_views,
)
from scancell.calibration.cell.kinematics import TOOL, AxisReadings
from scancell.calibration.cell.scan import CalibrationRequest
from scancell.calibration.measured_table import write_measured_table
from scancell.config.choices import FlangeConvention
from scancell.config.files import assets_dir
from scancell.errors import CalibrationError, DescriptionError
from scancell.geometry import pose
from scancell.geometry.orientation import CONVENTIONS, PoseReading, StatedPoses

COUNT = 16
# The flange of the real robot is another frame than that of the described one.
DESCRIBED_FROM_REAL = pose.from_euler_xyz((-0.12, 0.07, 0.03), (1.1, -0.5, 2.0))


@pytest.fixture(scope="module")
def scanner():
    with scancell.Scanner() as scanner:
        yield scanner


# Centre of a ball in the sensor, mm, in 15 poses: those of a public recording (docs/reality.md), rounded.
ONE_SIDED = (
    (-7, -17, -34, -7, -7, -7, -7, -7, -7, -13, -11, -11, -13, -21, -15),
    (57, 57, 57, 57, 93, 6, 46, 54, 39, 57, 57, 57, 65, 67, 58),
    (425, 425, 425, 444, 443, 445, 421, 428, 425, 428, 423, 419, 425, 425, 425),
)


class Recording:
    """Profiles of a sphere with flange poses (n, 4, 4), and the pose of the sensor on that flange."""

    def __init__(self, seed: int = 5, count: int = COUNT) -> None:
        cell, rng = default_kinematics(), np.random.default_rng(seed)
        readings = AxisReadings.at_rest(sphere_views(rng, count, turn_table=False))
        self.observed = SphereCase(robot=REALISTIC).observe(readings, rng)
        self.flange = pose.inverse(cell.arm.world_from_base) @ cell.arm.fk(readings.q) @ DESCRIBED_FROM_REAL
        self.flange_from_sensor = pose.inverse(DESCRIBED_FROM_REAL) @ cell.carrier_from_sensor

    def columns(
        self, convention: str, length: str = "mm", angle: str = "deg", named: str = ""
    ) -> dict[str, np.ndarray]:
        """Columns of the poses by exposure."""
        scale = 1e3 if length == "mm" else 1.0
        found = {f"flange_{axis}_{length}": scale * self.flange[:, i, 3] for i, axis in enumerate("xyz")}
        numbers = ORIENTATIONS[convention](Rotation.from_matrix(self.flange[:, :3, :3]))
        unit = ""
        if CONVENTIONS[convention].is_angle:
            numbers, unit = (np.degrees(numbers) if angle == "deg" else numbers), f"_{angle}"
        return found | {f"flange_{named or convention}_{i}{unit}": values for i, values in enumerate(numbers.T, 1)}

    def points(self) -> dict[str, np.ndarray]:
        """Columns of the points."""
        return {
            "exposure": self.observed.frame + 1,
            "x_mm": 1e3 * self.observed.points_in_sensor[:, 1],
            "z_mm": 1e3 * self.observed.points_in_sensor[:, 2],
        }

    def write(self, path: Path, columns: dict[str, np.ndarray]) -> Path:
        """One table, the poses in every row."""
        per_point = {name: values[self.observed.frame] for name, values in columns.items()}
        write_measured_table(path, self.points() | per_point)
        return path


@pytest.fixture(scope="module")
def recording() -> Recording:
    return Recording()


def test_conventions_have_one_list() -> None:
    assert set(get_args(FlangeConvention)) == set(CONVENTIONS) == set(ORIENTATIONS)


@pytest.mark.parametrize("convention", CONVENTIONS)
@pytest.mark.parametrize(("length", "angle"), [("mm", "deg"), ("m", "rad")])
def test_poses_of_every_convention_are_read(recording: Recording, convention: str, length: str, angle: str) -> None:
    columns = [*recording.columns(convention, length, angle).values()]
    stated = StatedPoses(np.array(columns[:3]).T, np.array(columns[3:]).T, PoseReading(convention, length, angle))
    assert stated.matrices() == pytest.approx(recording.flange, abs=1e-12)
    assert stated.wrong_row() is None


def test_convention_of_robot_controllers() -> None:
    """XYZWPR turns about the fixed axes x, y, z in this order; ZYZ' about the moving ones."""
    w, p, r = np.radians([10.0, 20.0, 30.0])
    fixed = pose.rotation_about(2, r) @ pose.rotation_about(1, p) @ pose.rotation_about(0, w)
    assert CONVENTIONS["xyzwpr"].rotations(np.array([[w, p, r]])).as_matrix()[0] == pytest.approx(fixed)
    assert CONVENTIONS["zyz"].rotations(np.array([[w, p, r]])).as_matrix()[0] == pytest.approx(
        pose.rotation_from_euler_zyz([w, p, r])
    )
    assert CONVENTIONS["xyz"].rotations(np.array([[w, p, r]])).as_matrix()[0] == pytest.approx(
        pose.rotation_from_euler_xyz([w, p, r])
    )


def test_tool_is_found_without_a_description_of_it(scanner, recording, tmp_path) -> None:
    """Neither the described tool nor the described arm is that of the robot."""
    report = scanner.calibrate("tool", from_points=recording.write(tmp_path / "p.csv", recording.columns("xyzw", "m")))
    error = pose.inverse(recording.flange_from_sensor) @ report.flange_from_sensor
    assert np.linalg.norm(error[:3, 3]) < 0.2e-3
    assert np.degrees(np.linalg.norm(pose.log_rotation(error[:3, :3]))) < 0.2
    assert report.result.noise_of_robot[0] == pytest.approx(REALISTIC.position, rel=0.6)
    x, y, z = 1e3 * report.flange_from_sensor[:3, 3]
    assert f"sensor on the flange: ({x:.3f}, {y:.3f}, {z:.3f}) mm" in report.summary()
    # The points that it leaves are an input again.
    report.save(tmp_path / "out")
    again = scanner.calibrate("tool", from_points=tmp_path / "out" / "points.parquet")
    assert again.flange_from_sensor == pytest.approx(report.flange_from_sensor, abs=1e-7)


def one_sided_recording(path: Path, rng: np.random.Generator) -> np.ndarray:
    """Profiles of a ball that is always on one side of the laser's plane, in poses that turn by 13° about one axis.

    Returns the pose (4, 4) of the sensor on the flange, which carries it 0.7 m beside it.
    """
    tool = pose.from_euler_xyz((-0.15, 0.715, 0.083), (0.0, 0.01, np.pi))
    radius, ball = 0.04, np.array([-0.04, 2.02, 0.02])
    turns = np.zeros((15, 3))
    for axis in range(3):
        turns[6 + 3 * axis : 9 + 3 * axis, axis] = np.radians([4.0, 8.0, 13.0])
    columns: dict[str, list[np.ndarray]] = {}
    for exposure, turn in enumerate(turns, 1):
        rotation = Rotation.from_euler("xyz", np.add([np.pi, 0.0, np.pi], turn)).as_matrix()
        centre = 1e-3 * np.array([ONE_SIDED[0][exposure - 1], ONE_SIDED[1][exposure - 1], ONE_SIDED[2][exposure - 1]])
        position = ball - rotation @ pose.transform_points(tool, centre[None])[0] + rng.normal(scale=0.2e-3, size=3)
        angle = np.linspace(-1.0, 1.0, 100)
        circle = np.sqrt(radius**2 - centre[0] ** 2) + rng.normal(scale=10e-6, size=100)
        values = {
            "exposure": np.full(100, exposure),
            "y_mm": 1e3 * (centre[1] + circle * np.sin(angle)),
            "z_mm": 1e3 * (centre[2] - circle * np.cos(angle)),
            **{f"flange_{axis}_mm": np.full(100, 1e3 * position[i]) for i, axis in enumerate("xyz")},
            **{f"flange_matrix_{i}": np.full(100, value) for i, value in enumerate(rotation.ravel(), 1)},
        }
        for name, column in values.items():
            columns.setdefault(name, []).append(column)
    joined = {name: np.concatenate(parts) for name, parts in columns.items()}
    write_measured_table(path, joined | {"x_mm": np.zeros(len(joined["y_mm"]))})
    return tool


@pytest.mark.parametrize("seed", [0, 2])
def test_ball_that_is_always_on_one_side_of_the_laser(scanner, tmp_path, seed: int) -> None:
    """As in recordings of a real robot, where the side of each circle alone led to a wrong tool."""
    tool = one_sided_recording(tmp_path / "p.parquet", np.random.default_rng(seed))
    ball = tmp_path / "ball.toml"
    ball.write_text('name = "ball"\n[[shape]]\nname = "ball"\nkind = "sphere"\ndiameter_mm = 80.0\n')
    report = scanner.calibrate("tool", ball, from_points=tmp_path / "p.parquet")
    error = pose.inverse(tool) @ report.flange_from_sensor
    assert np.degrees(np.linalg.norm(pose.log_rotation(error[:3, :3]))) < 1.0
    assert np.linalg.norm(error[:3, 3]) < 5e-3


def test_intervals_contain_the_truth(scanner, tmp_path) -> None:
    """Of 6 unknowns in 8 recordings: 95 % with the tolerance of a binomial distribution."""
    inside = []
    for seed in range(8):
        one = Recording(seed + 20)
        report = scanner.calibrate("tool", from_points=one.write(tmp_path / "p.parquet", one.columns("matrix")))
        delta = pose.inverse(default_kinematics().carrier_from_sensor) @ one.flange_from_sensor
        true = np.array([*delta[:3, 3], *pose.euler_xyz_from_rotation(delta[:3, :3])])
        inside.extend(np.abs(report.result.values - true) < report.result.half_widths())
    assert len(inside) == 48 and sum(inside) >= 41  # 1e-3 of the binomial distribution


def test_files_of_every_kind_give_the_same_calibration(scanner, recording, tmp_path) -> None:
    first = scanner.calibrate("tool", from_points=recording.write(tmp_path / "p.parquet", recording.columns("wxyz")))
    poses = recording.columns("xyz", "m", "rad", named="orientation")
    write_measured_table(tmp_path / "points.csv", recording.points())
    write_measured_table(tmp_path / "poses.csv", {"exposure": np.arange(COUNT) + 1, **poses})
    points = {name: values for name, values in recording.points().items() if name != "exposure"}
    entries = [
        {
            "exposure": number + 1,
            **{name: float(values[number]) for name, values in poses.items()},
            **{name: values[recording.observed.frame == number].tolist() for name, values in points.items()},
        }
        for number in range(COUNT)
    ]
    (tmp_path / "all.yaml").write_text(yaml.safe_dump(entries))
    split = scanner.calibrate(
        "tool", from_points=tmp_path / "points.csv", flange=tmp_path / "poses.csv", convention="xyz"
    )
    listed = scanner.calibrate("tool", from_points=tmp_path / "all.yaml", convention="xyz")
    for report in (split, listed):
        assert report.flange_from_sensor == pytest.approx(first.flange_from_sensor, abs=1e-6)


WRONG = {
    "zyz for xyz": ("zyz", {}, "xyz", "zyz"),
    "xyzwpr for zyz": ("xyzwpr", {}, "zyz", "xyzwpr"),
    "wxyz for xyzw": ("wxyz", {}, "xyzw", "wxyz"),
    "metres for mm": ("xyzw", {"length": "m"}, "xyzw", "position in m,|position in m$"),
    "degrees for radians": ("xyz", {"angle": "deg"}, "xyz", "angles in deg"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_convention_is_recognised(scanner, recording, tmp_path, case: str) -> None:
    true, units, said, expected = WRONG[case]
    columns = recording.columns(true, **units, named=said)
    if case == "metres for mm":
        columns = {name.replace("_m", "_mm"): values for name, values in columns.items()}
    if case == "degrees for radians":
        columns = {name.replace("_deg", "_rad"): values for name, values in columns.items()}
    with pytest.raises(CalibrationError, match=r"the flange poses do not fit .* as (\w+) .*; they fit to") as refused:
        scanner.calibrate("tool", from_points=recording.write(tmp_path / "p.parquet", columns))
    assert re.search(expected, str(refused.value).split("they fit to")[1]), str(refused.value)
    assert "p.parquet" in str(refused.value)
    stated = re.search(r"is (\S+) mm; they fit to (\S+) mm", str(refused.value))
    assert stated is not None
    as_said, as_true = map(float, stated.groups())
    assert as_true < 0.5 < as_said, str(refused.value)


@pytest.mark.parametrize("wrong", ["inverse", "swapped axes"])
def test_inverted_poses_and_swapped_axes_are_recognised(scanner, recording, tmp_path, wrong: str) -> None:
    one = Recording()
    if wrong == "inverse":
        one.flange = pose.inverse(one.flange)
        expected = r"of the base in the flange \(inverted\)"
    else:
        one.flange[:, [0, 1], 3] = one.flange[:, [1, 0], 3]
        expected = "position in the order y, x, z"
    with pytest.raises(CalibrationError, match=expected):
        scanner.calibrate("tool", from_points=one.write(tmp_path / "p.parquet", one.columns("wxyz")))


@pytest.mark.parametrize(("rows", "named"), [(1, "after"), (-1, "before")])
def test_poses_of_the_neighbouring_exposures_are_recognised(scanner, tmp_path, rows: int, named: str) -> None:
    one = Recording()
    one.flange = np.roll(one.flange, rows, axis=0)
    expected = rf"do not belong to the profiles: .* shifted by one exposure, .* the exposure {named} it"
    with pytest.raises(CalibrationError, match=expected):
        scanner.calibrate("tool", from_points=one.write(tmp_path / "p.parquet", one.columns("wxyz")))


@pytest.mark.parametrize("size", [1.02, 0.5], ids=["too large", "radius"])
def test_wrong_diameter_of_the_sphere_is_named(scanner, recording, tmp_path, size: float) -> None:
    text = (assets_dir() / "artefacts" / "sphere.toml").read_text()
    diameter = float(re.search(r"diameter_mm = ([\d.]+)", text)[1])  # type: ignore[index]
    artefact = tmp_path / "ball.toml"
    artefact.write_text(text.replace(f"diameter_mm = {diameter}", f"diameter_mm = {size * diameter}", 1))
    points = recording.write(tmp_path / "p.parquet", recording.columns("wxyz"))
    with pytest.raises(CalibrationError, match="correct diameter_mm") as refused:
        scanner.calibrate("tool", artefact, from_points=points)
    found = float(re.search(r"for a diameter of about ([\d.]+) mm", str(refused.value))[1])  # type: ignore[index]
    assert found == pytest.approx(diameter, rel=0.02)
    assert ("which seems to hold the radius" in str(refused.value)) == (size == 0.5)


@pytest.mark.parametrize("error", [0.6, -0.4])
def test_unknown_diameter_is_found_from_a_wrong_one(scanner, recording, tmp_path, error: float) -> None:
    text = (assets_dir() / "artefacts" / "sphere.toml").read_text()
    diameter = float(re.search(r"diameter_mm = ([\d.]+)", text)[1])  # type: ignore[index]
    artefact = tmp_path / "ball.toml"
    artefact.write_text(text.replace(f"diameter_mm = {diameter}", f"diameter_mm = {diameter + error}", 1))
    points = recording.write(tmp_path / "p.parquet", recording.columns("wxyz"))
    sized = CalibrationRequest("tool", is_size_known=False)
    result = scanner.calibrate(sized, artefact, from_points=points).result
    (size,) = 2e3 * result.sizes
    assert size == pytest.approx(-error, abs=max(0.005, 8e3 * float(result.size_standard_deviations[0])))


def test_three_poses_are_too_few(scanner, tmp_path) -> None:
    one = Recording(count=3)
    with pytest.raises(CalibrationError, match=r"in 3 exposure\(s\) does not determine 9 .* 5 exposures or more"):
        scanner.calibrate("tool", from_points=one.write(tmp_path / "p.parquet", one.columns("wxyz")))


def test_one_wrong_pose_is_named(scanner, tmp_path) -> None:
    one = Recording()
    one.flange[6, :3, 3] += [0.012, -0.016, 0.0]
    with pytest.raises(CalibrationError, match=r"1 of 16 exposures disagree .*: exposure 7 by (\d+\.\d) mm") as refused:
        scanner.calibrate("tool", from_points=one.write(tmp_path / "p.parquet", one.columns("wxyz")))
    away = re.search(r"exposure 7 by ([\d.]+) mm", str(refused.value))
    assert away is not None and float(away[1]) == pytest.approx(20.0, abs=2.0)


def test_wrong_tables_are_refused(scanner, recording, tmp_path) -> None:
    def refused(columns: dict[str, np.ndarray], message: str, **options: str) -> None:
        path = recording.write(tmp_path / "p.csv", columns)
        with pytest.raises(DescriptionError, match=message) as error:
            scanner.calibrate("tool", from_points=path, **options)
        assert "p.csv" in str(error.value)

    good = recording.columns("wxyz")
    position = {name: values for name, values in good.items() if "wxyz" not in name}
    missing = {**good, "flange_x_mm": np.where(np.arange(COUNT) == 3, np.nan, good["flange_x_mm"])}
    refused(missing, r"column 'flange_x_mm', row \d+: is empty; expected a finite number")
    refused({**good, "flange_wxyz_1": 2 * good["flange_wxyz_1"]}, "expected a quaternion of length 1")
    refused(position, "the orientation of the flange is missing; expected flange_CONVENTION_1")
    refused(position | recording.columns("xyz", named="orientation"), "needs a `convention`; expected one of matrix")
    refused(good, "state another convention; expected wxyz", convention="xyzw")
    turned = recording.columns("matrix")
    turned["flange_matrix_9"] = -turned["flange_matrix_9"]
    refused(turned, "expected a right-handed orthonormal matrix")
    degrees = recording.columns("wxyz") | {"flange_wxyz_1_deg": good["flange_wxyz_1"]}
    refused(degrees, "the orientation of the flange is given twice")
    refused({name: values for name, values in good.items() if name != "flange_wxyz_4"}, "'flange_wxyz_4': is missing")

    write_measured_table(tmp_path / "p.csv", recording.points())
    rows = np.flatnonzero(np.arange(COUNT) != 4)
    some = {name: values[rows] for name, values in good.items()}
    write_measured_table(tmp_path / "some.csv", {"exposure": rows + 1, **some})
    with pytest.raises(
        DescriptionError, match=r"some.csv: .*no flange pose of 1 of the 16 .*expected a row with exposure 5"
    ):
        scanner.calibrate("tool", from_points=tmp_path / "p.csv", flange=tmp_path / "some.csv")
    for name, value in {"flange": "some.csv", "convention": "xyz", "table_format": "gocator_csv"}.items():
        with pytest.raises(DescriptionError, match="applies to `from_points` alone"):
            scanner.calibrate("tool", **{name: value})


def test_profiles_as_sensors_write_them_are_calibrated(scanner, recording, tmp_path) -> None:
    """A folder with a file for each exposure, as OpenCV writes it; its format is recognised, or stated."""
    points, folder = recording.points(), tmp_path / "profiles"
    folder.mkdir()
    for exposure in range(1, COUNT + 1):
        own = points["exposure"] == exposure
        words = [f"{x:.6f}, 0., {z:.6f}" for x, z in zip(points["x_mm"][own], points["z_mm"][own], strict=True)]
        (folder / f"p{exposure}.yml").write_text("%YAML:1.0\n---\nscan_line: [ " + ",\n    ".join(words) + " ]\n")
    poses = recording.columns("xyzwpr")
    write_measured_table(tmp_path / "poses.csv", {"exposure": np.arange(1, COUNT + 1), **poses})
    expected = scanner.calibrate("tool", from_points=recording.write(tmp_path / "p.csv", poses)).flange_from_sensor
    found = scanner.calibrate("tool", from_points=folder, flange=tmp_path / "poses.csv")
    assert found.flange_from_sensor == pytest.approx(expected, abs=1e-6)
    assert sum(path.suffix == ".yml" for path in found.inputs) == COUNT
    with pytest.raises(DescriptionError, match="table_format"):
        scanner.calibrate("tool", from_points=folder, flange=tmp_path / "poses.csv", table_format="none")


def test_latency_needs_joints(scanner, recording, tmp_path) -> None:
    path = recording.write(tmp_path / "p.parquet", recording.columns("wxyz"))
    with pytest.raises(CalibrationError, match=r"flange poses do not determine trigger.latency; expected joints"):
        scanner.calibrate("latency", from_points=path)


def test_profiles_of_an_unequal_pose_are_refused(scanner, recording, tmp_path) -> None:
    path = recording.write(tmp_path / "p.parquet", recording.columns("wxyz"))
    table = pyarrow.parquet.read_table(path).to_pydict()
    table["flange_x_mm"][1] += 1.0
    write_measured_table(path, table)
    with pytest.raises(
        DescriptionError, match=r"row 2: flange position differs from that in the first row of exposure 1"
    ):
        scanner.calibrate("tool", from_points=path)
    (tmp_path / "bad.yaml").write_text("[{exposure: 1, y_mm: [1, 2], z_mm: [1]}]")
    with pytest.raises(DescriptionError, match=r"entry 1 .*expected lists of equal length"):
        scanner.calibrate("tool", from_points=tmp_path / "bad.yaml")
    (tmp_path / "bad.yaml").write_text("exposure: 1")
    with pytest.raises(DescriptionError, match="is not a list of entries"):
        scanner.calibrate("tool", from_points=tmp_path / "bad.yaml")


def test_screws_of_flange_poses_are_derivatives_of_points() -> None:
    cell, rng = default_kinematics(), np.random.default_rng(1)
    flange = pose.from_euler_xyz(rng.normal(size=(4, 3)), rng.normal(size=(4, 3)))
    readings, points, step = AxisReadings.of_flange(flange, np.zeros(4)), 0.1 * rng.normal(size=(4, 3)), 1e-6
    for name in TOOL:

        def moved(change: float, name: str = name) -> np.ndarray:
            return pose.transform_each(cell.poses(readings, {name: change}).platter_from_sensor, points)

        screw = cell.poses(readings, {}).deviations[name]
        by_screw = screw[:, :3] + np.cross(screw[:, 3:], moved(0.0))
        assert by_screw == pytest.approx((moved(step) - moved(-step)) / (2 * step), abs=1e-7)


def test_poses_by_joints_and_by_flange_agree() -> None:
    cell, rng = default_kinematics(), np.random.default_rng(2)
    joints = AxisReadings.at_rest(rng.normal(size=(5, 7)))
    flange = AxisReadings.of_flange(pose.inverse(cell.arm.world_from_base) @ cell.arm.fk(joints.q), joints.table)
    deviations = {"tool.x": 0.01, "table.rx": 0.02, "platter.y": 0.003}
    one, other = (cell.poses(readings, deviations) for readings in (joints, flange))
    assert one.platter_from_sensor == pytest.approx(other.platter_from_sensor, abs=1e-12)
    assert one.flange == pytest.approx(other.flange, abs=1e-12)
    assert replace(flange).rows(np.array([2])).flange.shape == (1, 4, 4)


def test_command_takes_flange_poses(recording, tmp_path) -> None:
    from typer.testing import CliRunner  # noqa: PLC0415

    from scancell.cli import app  # noqa: PLC0415

    write_measured_table(tmp_path / "points.csv", recording.points())
    poses = recording.columns("zyz", named="orientation")
    write_measured_table(tmp_path / "poses.csv", {"exposure": np.arange(COUNT) + 1, **poses})
    words = [
        "calibrate",
        "tool",
        "--from-points",
        str(tmp_path / "points.csv"),
        "--flange",
        str(tmp_path / "poses.csv"),
    ]
    done = CliRunner().invoke(app, [*words, "--convention", "zyz", "--out", str(tmp_path / "out"), "--json"])
    assert done.exit_code == 0, done.output
    figures = json.loads((tmp_path / "out" / "calibration.json").read_text())
    assert figures["exposures"] == COUNT and figures["rms_um"] < 1e6 * 0.02 * RADIUS
    assert (tmp_path / "out" / "calibrated.toml").exists()
