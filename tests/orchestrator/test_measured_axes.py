"""Further axes in tables of measurements, and deviations of axes in calibrations, against the simulated cell."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow.csv
import pyarrow.parquet
import pytest

from scancell import (
    CalibrationError,
    CalibrationRequest,
    DescriptionError,
    EstimatedDescription,
    Scanner,
    assets_dir,
    load_setup,
    nominal_cell,
    reconstruct,
)
from scancell.calibration.cell.kinematics import AxisReadings, axis_deviations
from scancell.calibration.cell.scan import kinematics_of
from scancell.geometry import pose
from scancell.nominal.cell import estimated_cell

CONE = assets_dir() / "artefacts/cone.toml"
STARTS = {"track": "cell.axis[1].start_mm=-220", "tilt_turn": "cell.axis[1].start_deg=20"}


def table_of(result, name: str, unit: str) -> dict[str, np.ndarray]:
    """Columns of a table of points of a scan, from its recording and profiles."""
    measured, profiles = result.recording.measured, result.profiles
    frame = np.asarray(profiles.frame)
    degrees, slides = np.degrees(measured.axes), unit == "mm"
    columns = {"exposure": measured.index[frame], "time_s": measured.time[frame]}
    columns |= {f"q{i + 1}_deg": degrees[frame, i] for i in range(6)} | {"table_deg": degrees[frame, 6]}
    columns |= {f"qd{i + 1}_deg_s": np.degrees(measured.rates)[frame, i] for i in range(6)}
    columns["table_rate_deg_s"] = np.degrees(measured.rates)[frame, 6]
    columns[f"{name}_{unit}"] = 1e3 * measured.axes[frame, 7] if slides else degrees[frame, 7]
    columns |= {f"{axis}_mm": 1e3 * np.asarray(profiles.points_in_sensor)[:, i] for i, axis in enumerate("xyz")}
    return columns | {"flags": np.asarray(profiles.flags).astype(np.int64)}


@pytest.mark.parametrize(("cell", "name", "unit"), [("track", "track", "mm"), ("tilt_turn", "tilt", "deg")])
def test_tables_of_measurements_hold_the_axes(tmp_path: Path, cell: str, name: str, unit: str) -> None:
    file = assets_dir() / f"cells/{cell}.toml"
    setup = load_setup(file, settings=[STARTS[cell], "scan.max_profiles=40"], ideal=True)
    with Scanner(setup=setup) as scanner:
        result = scanner.scan(CONE, engine="geometric")
    columns = table_of(result, name, unit)
    pyarrow.csv.write_csv(pyarrow.table(columns), tmp_path / "points.csv")
    # The cell starts elsewhere than where the axis was.
    made = reconstruct(tmp_path / "points.csv", cell=file, part=CONE)
    assert len(made.cloud) == len(result.cloud)
    assert np.abs(made.cloud.points_in_part - result.cloud.points_in_part).max() < 1e-9
    made.save(tmp_path / "made")
    assert f"{name}_{unit}" in pyarrow.parquet.read_table(tmp_path / "made/points.parquet").column_names
    again = reconstruct(tmp_path / "made/points.parquet", cell=file, part=CONE)
    assert np.abs(again.cloud.points_in_part - made.cloud.points_in_part).max() < 1e-9
    del columns[f"{name}_{unit}"]
    pyarrow.csv.write_csv(pyarrow.table(columns), tmp_path / "without.csv")
    with pytest.raises(DescriptionError, match=rf"column '{name}_{unit}': is missing; expected the measured position"):
        reconstruct(tmp_path / "without.csv", cell=file, part=CONE)


def test_flange_poses_are_of_the_base_where_the_axis_carries_it(tmp_path: Path) -> None:
    file = assets_dir() / "cells/track.toml"
    setup = load_setup(file, settings=[STARTS["track"], "scan.max_profiles=30"], ideal=True)
    with Scanner(setup=setup) as scanner:
        result = scanner.scan(CONE, engine="geometric")
    columns = {name: c for name, c in table_of(result, "track", "mm").items() if not name.startswith("q")}
    del columns["table_rate_deg_s"]
    measured, frame = result.recording.measured, np.asarray(result.profiles.frame)
    nominal = nominal_cell(setup.cell, None)
    placed = nominal.tree.place(measured.axes, ["base", nominal.arm.flange])
    flange = (pose.inverse(placed["base"]) @ placed[nominal.arm.flange])[frame]
    columns |= {f"flange_{axis}_mm": 1e3 * flange[:, i, 3] for i, axis in enumerate("xyz")}
    numbers = flange[:, :3, :3].reshape(-1, 9).T
    columns |= {f"flange_matrix_{i}": column for i, column in enumerate(numbers, 1)}
    pyarrow.csv.write_csv(pyarrow.table(columns), tmp_path / "points.csv")
    made = reconstruct(tmp_path / "points.csv", cell=file, part=CONE)
    assert np.abs(made.cloud.points_in_part - result.cloud.points_in_part).max() < 1e-8
    # The same from a table of its own for poses and axis.
    first = np.unique(frame, return_index=True)[1]
    robot = {name: c[first] for name, c in columns.items() if name.startswith(("exposure", "flange", "track"))}
    pyarrow.csv.write_csv(pyarrow.table(robot), tmp_path / "poses.csv")
    sensor = {name: c for name, c in columns.items() if name == "exposure" or not name.startswith(("flange", "track"))}
    pyarrow.csv.write_csv(pyarrow.table(sensor), tmp_path / "profiles.csv")
    again = reconstruct(tmp_path / "profiles.csv", cell=file, part=CONE, flange=tmp_path / "poses.csv")
    assert again.cloud.points_in_part == pytest.approx(made.cloud.points_in_part, abs=1e-12)


@pytest.mark.parametrize("cell", ["track", "tilt_turn"])
def test_deviations_of_axes_in_calibration_are_those_of_the_tree(cell: str) -> None:
    rng = np.random.default_rng(5)
    nominal = nominal_cell(load_setup(assets_dir() / f"cells/{cell}.toml").cell, None)
    kinematics = kinematics_of(nominal)
    (axis,) = nominal.further_axes
    names = [name for name in kinematics.names if name.startswith(("axis.", "tool.", "table.r", "table.x"))]
    assert set(axis_deviations(axis.name)) <= set(names)
    names = [name for name in names if "wobble" not in name]
    deviations = dict(zip(names, rng.normal(size=len(names)) * 1e-2, strict=True))
    axes = np.hstack([rng.uniform(-1, 1, (6, 7)), rng.uniform(axis.min, axis.max, (6, 1))])
    readings = AxisReadings.at_rest(axes, kinematics.further)
    found = kinematics.poses(readings, deviations).platter_from_sensor
    expected = estimated_cell(nominal, deviations).tree.place(axes, ["table", "sensor"])
    assert found == pytest.approx(pose.inverse(expected["table"]) @ expected["sensor"], abs=1e-12)
    # The screws are derivatives, those of the latency too.
    moving = AxisReadings(axes, rng.normal(size=axes.shape), np.zeros_like(axes), further=kinematics.further)
    made, h = kinematics.poses(moving, deviations), 1e-6
    for name in (*axis_deviations(axis.name), "trigger.latency"):
        ends = [
            kinematics.poses(moving, {**deviations, name: deviations.get(name, 0.0) + by}).platter_from_sensor
            for by in (h, -h)
        ]
        turn = pose.log_rotation(ends[0][:, :3, :3] @ np.swapaxes(ends[1][:, :3, :3], 1, 2)) / (2 * h)
        moved = (ends[0][:, :3, 3] - ends[1][:, :3, 3]) / (2 * h)
        screw = made.deviations[name]
        assert screw[:, 3:] == pytest.approx(turn, abs=1e-6), name
        at = made.platter_from_sensor[:, :3, 3]
        assert screw[:, :3] + np.cross(screw[:, 3:], at) == pytest.approx(moved, abs=1e-6), name


def test_estimated_deviations_of_axes_are_read_back(tmp_path: Path) -> None:
    setup = load_setup(assets_dir() / "cells/track.toml")
    values = {"axis.track.x": 1e-3, "axis.track.rz": 2e-3, "tool.z": -1e-4}
    estimated = EstimatedDescription.of(values, 6)
    setup.cell.model_copy(update={"estimated": estimated}).to_toml(tmp_path / "cell.toml")
    read = load_setup(tmp_path / "cell.toml").cell.estimated.deviations()
    assert {name: value for name, value in read.items() if value} == pytest.approx(values, abs=1e-12)
    with pytest.raises(DescriptionError, match=r"estimated\.axis\.rail: expected an axis of the cell: track"):
        load_setup(tmp_path / "cell.toml", settings=["cell.estimated.axis.rail.x_mm=1"])
    with pytest.raises(DescriptionError, match="names of as-built parameters"):
        EstimatedDescription.of({"axis.track.q": 1.0}, 6)


@pytest.mark.parametrize(("cell", "name"), [("track", "track"), ("tilt_turn", "tilt")])
def test_calibration_finds_the_deviations_of_an_axis(tmp_path: Path, cell: str, name: str) -> None:
    by = {"x_mm": 0.3, "y_mm": -0.2, "z_mm": 0.25, "rx_deg": 0.05, "ry_deg": -0.08, "rz_deg": 0.04}
    as_built = {f"axis.{name}.{key}": value for key, value in by.items()} | {"tool.x_mm": 0.2, "tool.ry_deg": 0.1}
    setup = load_setup(assets_dir() / f"cells/{cell}.toml", settings=["scan.max_profiles=40"])
    with Scanner(setup=setup) as scanner:
        report = scanner.calibrate(CalibrationRequest("tool", also=(f"axis.{name}",), poses=32), as_built=as_built)
        positions = np.unique(report.calibration.problem.observations.readings.axes[:, 7].round(9))
        assert len(positions) >= 3
        for row in report.rows:
            assert row.value == pytest.approx(row.true, abs=2 * row.half_width), row.name
            assert row.half_width < (0.02 if row.unit == "mm" else 0.005), row.name
        assert {row.name for row in report.rows} > set(axis_deviations(name))
        report.save(tmp_path)
        assert (tmp_path / "plan2.json").is_file()
        start = f"cell.axis[1].start_{'mm' if name == 'track' else 'deg'}=30"
        found = load_setup(tmp_path / "calibrated.toml", settings=[start, "scan.max_profiles=40"])
    with Scanner(setup=found) as scanner:
        result = scanner.scan(CONE, engine="geometric", as_built=as_built)
    assert result.evaluate().deviation.rms < 12e-6
    # The same from the points in the file, and not from a cell without the axis' column.
    with Scanner(setup=setup) as scanner:
        again = scanner.calibrate(
            CalibrationRequest("tool", also=(f"axis.{name}",)), from_points=tmp_path / "points.parquet"
        )
    assert [row.value for row in again.rows] == pytest.approx([row.value for row in report.rows], abs=1e-6)


def test_what_exposures_do_not_determine_of_an_axis_is_named() -> None:
    """Along and about itself, its x, a tilt moves the table as the table's own deviations do."""
    setup = load_setup(assets_dir() / "cells/tilt_turn.toml")
    request = CalibrationRequest("table", also=("axis.tilt",), poses=24, axis_positions=3)
    with Scanner(setup=setup) as scanner, pytest.raises(CalibrationError, match="do not determine") as error:
        scanner.calibrate(request)
    assert "axis.tilt.x - table.x" in str(error.value)
    assert "hold deviations of the table, or of the axis" in str(error.value)
    with (
        Scanner() as scanner,
        pytest.raises(CalibrationError, match=r"also = 'axis\.rail\.x': is not a deviation of the cell"),
    ):
        scanner.calibrate(CalibrationRequest("tool", also=("axis.rail",)))
