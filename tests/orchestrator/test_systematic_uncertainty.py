"""Systematic covariance of reconstructed clouds against the scatter of many sensors and cells with known errors."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet
import pytest
from numpy.typing import NDArray

import scancell
from scancell import sensor as sensor_rt
from scancell.calibration.cell.kinematics import AxisReadings
from scancell.calibration.cell.scan import kinematics_of
from scancell.calibration.measured_table import write_measured_table
from scancell.calibration.sensor.problem import SensorParameters
from scancell.config.loading import load_setup
from scancell.config.sensor import sensor_json
from scancell.errors import CalibrationError, DescriptionError
from scancell.geometry import pose
from scancell.nominal.cell import nominal_cell

Array = NDArray[np.float64]

PLANE = pose.from_euler_xyz((0.0, 0.0, 0.12), (0.15, 0.1, 0.0))  # in the sensor frame
MIDDLE = 0.004  # m: half the length of the region on the laser line
OF_SENSOR = {  # standard deviations in the units of the keys
    "sensor.camera[1].tilt_deg": 0.01,
    "sensor.camera[1].baseline_mm": 0.01,
    "sensor.camera[1].distortion[1]": 0.02,
    "sensor.laser.turn_y_deg": 0.005,
}
OF_CELL = {  # m, rad, s
    "tool.x": 2e-5,
    "tool.z": 3e-5,
    "tool.ry": 2e-4,
    "dh[2].theta": 1e-4,
    "table.y": 4e-5,
    "table.rx": 2e-4,
    "platter.x": 3e-5,
    "trigger.latency": 5e-4,
}


def correlated(std: dict[str, float]) -> Array:
    """A covariance with these standard deviations and correlations of both signs."""
    factor = np.random.default_rng(4).normal(size=(len(std), len(std))) + 2.0 * np.eye(len(std))
    matrix = factor @ factor.T
    scale = np.array(list(std.values())) / np.sqrt(np.diag(matrix))
    return np.asarray(matrix * np.outer(scale, scale))


def table_of(path: Path, points: Array, sigma: Array, **columns: Array) -> Path:
    """One exposure of the default robot at its home pose, without motion unless `columns` state one."""
    ones = np.ones(len(points))
    home = np.degrees(nominal_cell(load_setup().cell, None).home)
    write_measured_table(
        path,
        {
            "exposure": ones,
            **{f"q{i}_deg": angle * ones for i, angle in enumerate(home, 1)},
            **{f"{axis}_mm": 1e3 * points[:, i] for i, axis in enumerate("xyz")},
            "sigma_um": 1e6 * sigma,
            "table_deg": 0.0 * ones,
            **columns,
        },
    )
    return path


def calibration_of(folder: Path, rows: str, key: str, std: dict[str, float]) -> Path:
    content = {rows: [{"name": name} for name in std], key: correlated(std).tolist()}
    (folder / "calibration.json").write_text(json.dumps(content))
    return folder


def profile(sensor: sensor_rt.Sensor, as_built: sensor_rt.Sensor, number: int) -> tuple[Array, Array, Array]:
    """Points (n, 3) of the first camera in the region, their sigma (n,) and columns (n,)."""
    scene = sensor_rt.Scene()
    scene.add_plane("plane", np.eye(4), (1.0, 1.0), 0.5)
    exposures = sensor_rt.Exposures(
        np.eye(4)[None, None], PLANE[None, None, None], np.array([5e-4]), np.array([number], np.int64)
    )
    found = sensor_rt.scan(scene, sensor, exposures, "geometric", 1, as_built=as_built).profiles
    rows = (found.camera == 0) & (np.abs(found.points_in_sensor[:, 1]) < MIDDLE)
    return found.points_in_sensor[rows], np.asarray(found.sigma[rows], float), np.asarray(found.column[rows], float)


def test_sensors_with_errors_of_the_calibration_scatter_as_stated(tmp_path: Path) -> None:
    """Means over a region by 250 sensors, and points of one cloud: the two parts of the uncertainty."""
    setup = load_setup(settings=("sensor.geometric.rays=640", "sensor.extraction.triangulation=sheet"))
    parameters = SensorParameters(setup.sensor, tuple(OF_SENSOR))
    values = parameters.start_values
    sensor = sensor_rt.Sensor(json.dumps(sensor_json(setup.sensor, 0)))
    normal, origin = PLANE[:3, 2], PLANE[:3, 3]
    rng, means = np.random.default_rng(7), []
    for number, error in enumerate(rng.multivariate_normal(np.zeros(len(values)), correlated(OF_SENSOR), 250)):
        points = profile(sensor, parameters.sensor(values + error), number)[0]
        means.append(((points - origin) @ normal).mean())
    points, sigma, column = profile(sensor, sensor, 0)
    (tmp_path / "run").mkdir()
    setup.sensor.to_toml(tmp_path / "run" / "calibrated_sensor.toml")
    table = table_of(tmp_path / "points.csv", points, sigma, column_px=column)
    found = scancell.reconstruct(
        table, calibration=calibration_of(tmp_path / "run", "parameters", "covariance", OF_SENSOR)
    )
    assert found.systematic_covariance is not None
    in_base = found.data.made.part_from_sensor[0, :3, :3] @ normal
    stated = float(np.sqrt(np.mean(in_base @ found.systematic_covariance @ in_base)))
    print(f"systematic {1e6 * stated:.2f} um stated, {1e6 * np.std(means):.2f} um found")
    assert np.std(means) == pytest.approx(stated, rel=0.15)
    assert stated > 3.0 * sigma.mean()
    # Within a cloud points scatter by the noise alone; neighbours share the systematic error.
    many = [profile(sensor, parameters.sensor(values + np.array(list(OF_SENSOR.values()))), k)[0] for k in range(20)]
    within = np.concatenate([np.diff((points - origin) @ normal) for points in many]) / np.sqrt(2.0)
    random = float(np.sqrt(np.mean(in_base @ found.covariance @ in_base)))
    print(f"random {1e6 * random:.2f} um stated, {1e6 * within.std():.2f} um found")
    assert within.std() == pytest.approx(random, rel=0.1)


def moving_points() -> tuple[Array, dict[str, Array]]:
    """Points around the middle of the measuring range, and an exposure in motion, with the table turned."""
    points = np.random.default_rng(2).uniform((0.0, 0.009, 0.119), (0.0, 0.011, 0.121), (200, 3))
    ones = np.ones(len(points))
    rates = {f"qd{i}_deg_s": rate * ones for i, rate in enumerate((2.0, -1.0, 3.0, 0.0, 5.0, 1.0), 1)}
    return points, {**rates, "table_deg": 40.0 * ones, "table_rate_deg_s": -4.0 * ones}


@pytest.mark.parametrize("has_part", [False, True])
def test_cells_with_errors_of_the_calibration_scatter_as_stated(tmp_path: Path, has_part: bool) -> None:
    """True positions of the same readings in other cells, by the kinematics of the calibration.

    The errors of the cells are points whose covariance is exactly that of the calibration.
    """
    points, columns = moving_points()
    table = table_of(tmp_path / "points.csv", points, np.full(len(points), 1e-6), **columns)
    nominal = nominal_cell(load_setup().cell, None)
    kinematics = kinematics_of(nominal)

    rates = np.radians([[columns[f"qd{i}_deg_s"][0] for i in range(1, 7)]])
    turn, turn_rate = np.radians([columns["table_deg"][:1], columns["table_rate_deg_s"][:1]])

    def at(deviations: dict[str, float], share: float) -> Array:
        """Pose of the sensor on the platter, with a share of the motion and of the table's angle."""
        axes, moving = [[*nominal.home, *(share * turn)]], [[*(share * rates[0]), *(share * turn_rate)]]
        readings = AxisReadings(np.array(axes), np.array(moving), np.zeros((1, 7)))
        return np.asarray(kinematics.poses(readings, deviations).platter_from_sensor[0])

    part: Any = None
    if has_part:  # a plate where the points are, since points far from their part are refused
        in_part = pose.transform_points(
            pose.inverse(nominal.table_from_part) @ at({}, 1.0), points.mean(0, keepdims=True)
        )[0]
        corners = 1e-2 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) + in_part
        part = scancell.Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]]))
    folder = calibration_of(tmp_path, "deviations", "covariance_si", OF_CELL)
    found = scancell.reconstruct(table, calibration=folder, part=part, keep_all=has_part)
    plain = scancell.reconstruct(table, part=part, keep_all=has_part)
    assert np.array_equal(found.covariance, plain.covariance) and plain.systematic_covariance is None
    assert np.array_equal(found.cloud.points_in_part, plain.cloud.points_in_part)

    platter_from_base = pose.inverse(nominal.world_from("table")) @ nominal.arm.world_from_base
    root, means = np.sqrt(len(OF_CELL)) * np.linalg.cholesky(correlated(OF_CELL)).T, []
    for error in np.concatenate([root, -root]):
        deviations = dict(zip(OF_CELL, error.tolist(), strict=True))
        frame_from_platter = pose.inverse(nominal.table_from_part)
        if not has_part:  # the frame of the base, with the table at 0
            of_arm = {name: value for name, value in deviations.items() if name.startswith(("tool", "dh"))}
            at_zero = pose.inverse(platter_from_base) @ at(of_arm, 0.0)
            frame_from_platter = at_zero @ pose.inverse(at(deviations, 0.0))
        means.append(pose.transform_points(frame_from_platter @ at(deviations, 1.0), points).mean(0))
    scatter = np.cov(np.transpose(means), bias=True)
    assert found.systematic_covariance is not None
    stated = found.systematic_covariance.mean(0)
    print(f"has_part {has_part}: stated {1e6 * np.sqrt(np.diag(stated))} um")
    assert scatter == pytest.approx(stated, abs=1e-3 * np.trace(stated))


def test_covariances_of_cell_and_sensor_add_up(tmp_path: Path) -> None:
    points, columns = moving_points()
    table = table_of(tmp_path / "points.csv", points, np.full(len(points), 1e-6), **columns)
    cell = {"deviations": [{"name": "tool.z"}], "covariance_si": [[4e-10]]}
    sensor = {"parameters": [{"name": "sensor.laser.turn_y_deg"}], "covariance": [[1e-4]]}
    found = []
    for content in (cell, sensor, cell | sensor):
        (tmp_path / "calibration.json").write_text(json.dumps(content))
        found.append(scancell.reconstruct(table, calibration=tmp_path).systematic_covariance)
    assert found[2] == pytest.approx(found[0] + found[1], rel=1e-12, abs=0.0)


def test_covariance_file_holds_both_parts(tmp_path: Path) -> None:
    points, columns = moving_points()
    table = table_of(tmp_path / "points.csv", points, np.full(len(points), 1e-6), **columns)
    found = scancell.reconstruct(
        table, calibration=calibration_of(tmp_path, "deviations", "covariance_si", {"tool.z": 2e-5})
    )
    found.save(tmp_path / "run")
    written = pyarrow.parquet.read_table(tmp_path / "run" / "covariance.parquet")
    pairs = ("xx", "xy", "xz", "yy", "yz", "zz")
    assert written.column_names == [f"{part}_{pair}_mm2" for part in ("covariance", "systematic") for pair in pairs]
    # A tool displaced along its z moves every point by as much.
    along = found.data.made.part_from_sensor[0, :3, 2]
    assert found.systematic_covariance == pytest.approx(np.broadcast_to(4e-10 * np.outer(along, along), (200, 3, 3)))
    assert np.array_equal(written["systematic_xz_mm2"].to_numpy(), 1e6 * found.systematic_covariance[:, 0, 2])
    assert found.figures["systematic_sigma_median_um"] == pytest.approx(20.0)
    assert "systematic 20.00 um" in found.summary()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"deviations": [{"name": "tool.x"}], "covariance_si": [[1.0, 0.0]]}, "covariance_si .* 1 x 1"),
        ({"deviations": [{"name": "tool.x"}], "covariance_si": [[-1.0]]}, "covariance_si"),
        ({"deviations": [{"name": "tool.x"}], "covariance_si": "wide"}, "covariance_si"),
        ({"deviations": [{"name": "tool.q"}], "covariance_si": [[1.0]]}, r"tool\.q"),
        ({"deviations": [{"names": "tool.x"}], "covariance_si": [[1.0]]}, "covariance_si"),
        ({"parameters": [{"name": "sensor.camera[3].tilt_deg"}], "covariance": [[1.0]]}, r"camera\[3\]"),
    ],
)
def test_wrong_covariances_are_refused(tmp_path: Path, content: dict[str, Any], message: str) -> None:
    points, columns = moving_points()
    table = table_of(tmp_path / "points.csv", points, np.full(len(points), 1e-6), **columns)
    (tmp_path / "calibration.json").write_text(json.dumps(content))
    with pytest.raises((DescriptionError, CalibrationError), match=message):
        scancell.reconstruct(table, calibration=tmp_path)
