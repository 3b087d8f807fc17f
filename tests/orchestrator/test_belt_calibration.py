"""Calibration of the direction and the encoder of a belt by a known part that it carries past the sensor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import scancell
from belt_profiles import BELT, calibrated, part_on_belt, problem_of
from scancell import CalibrationRequest, Scanner
from scancell.calibration.cell.scan import kinematics_of
from scancell.calibration.cell.solve import solve
from scancell.config.cell import EstimatedDescription
from scancell.config.loading import assets_dir, load_setup
from scancell.errors import CalibrationError, DescriptionError
from scancell.geometry import pose
from scancell.nominal.cell import estimated_cell

CELL = assets_dir() / "cells/belt_post.toml"
COARSE = {"scan.belt": {"pitch_mm": 3.0, "speed_mm_s": 100.0}}
SMALL, LARGE = (np.radians(0.1), np.radians(-0.1), 0.001), (np.radians(-1.0), np.radians(1.0), -0.01)


def planted(values: tuple[float, ...]) -> dict[str, float]:
    return dict(zip(BELT, map(float, values), strict=True))


@pytest.mark.parametrize("name", [*BELT, "tool.x", "trigger.latency"])
def test_screws_are_derivatives_of_points(name: str) -> None:
    problem = problem_of(planted(LARGE), 1)
    kinematics, readings, at = problem.kinematics, problem.observations.readings, planted(SMALL)
    readings = replace(readings, rates=np.full_like(readings.rates, 0.1))

    def points(change: float) -> np.ndarray:
        deviations = {**at, name: at.get(name, 0.0) + change}
        return pose.transform_points(kinematics.poses(readings, deviations).platter_from_sensor, np.ones((1, 3)))[:, 0]

    step, screw = 1e-6, kinematics.poses(readings, at).deviations[name]
    by_screw = screw[:, :3] + np.cross(screw[:, 3:], points(0.0))
    assert by_screw == pytest.approx((points(step) - points(-step)) / (2 * step), abs=1e-7)


def test_calibration_and_reconstruction_share_one_geometry() -> None:
    problem, nominal = problem_of(planted(SMALL), 2), part_on_belt().nominal
    deviations = planted(LARGE)
    estimated, axes = estimated_cell(nominal, deviations), problem.observations.readings.axes
    expected = pose.inverse(estimated.world_from("conveyor[1]", axes)) @ estimated.world_from("sensor", axes)
    assert problem.kinematics.poses(problem.observations.readings, deviations).platter_from_sensor == pytest.approx(
        expected, abs=1e-12
    )


@pytest.mark.parametrize("values", [(0.0, 0.0, 0.0), SMALL, LARGE], ids=["as described", "small", "large"])
def test_planted_direction_and_scale_are_found(values: tuple[float, ...]) -> None:
    result = calibrated(planted(values), 3, encoder=0.0)
    error = np.abs(result.values - values)
    assert (error <= result.half_widths(0.9999)).all()
    assert np.degrees(error[:2]).max() < 0.003 and error[2] < 3e-5
    assert result.noise_of_points == pytest.approx(1.0, abs=0.1)


def test_noise_of_the_encoder_is_estimated_and_enters_the_intervals() -> None:
    quiet, noisy = (calibrated(planted(SMALL), 4, encoder=encoder) for encoder in (0.0, 50e-6))
    assert noisy.noise_of_robot[0] == pytest.approx(50e-6, rel=0.5)
    assert noisy.half_widths()[2] > 5 * quiet.half_widths()[2]


def test_exposures_with_large_errors_of_the_encoder_are_no_outliers() -> None:
    """On slopes they move all points of a profile far; implausible errors are none of the encoder."""
    problem = problem_of(planted(SMALL), 148)
    observed = problem.observations
    counts = np.bincount(observed.frame)
    assert set(solve(problem).frame) >= set(np.flatnonzero(counts >= 5))
    axes, jumped = observed.readings.axes.copy(), np.flatnonzero(counts)[-3]
    axes[jumped, -1] += 2e-3
    readings = replace(observed.readings, axes=axes)
    result = solve(replace(problem, observations=replace(observed, readings=readings)))
    assert jumped not in result.frame
    assert (np.abs(result.values - SMALL) <= result.half_widths(0.9999)).all()


def test_parts_that_do_not_determine_a_belt_are_refused() -> None:
    """Faces without slopes, and faces that are mistaken for others."""
    with pytest.raises(CalibrationError, match=r"not determine:.*conveyor\[1\]\.encoder_scale.*slopes or curved"):
        solve(problem_of(planted(SMALL), 1, part="parts/step_block.stl"))
    problem = problem_of(planted(SMALL), 6)
    points = problem.observations.points_in_sensor.copy()
    points[::6, 2] += 1e-3
    observed = replace(problem.observations, points_in_sensor=points)
    with pytest.raises(CalibrationError, match=r"8\d% of the points near the part agree with it.*mistaken"):
        solve(replace(problem, observations=observed))


def test_position_of_the_belt_along_its_travel_is_no_deviation() -> None:
    problem = replace(problem_of(planted(SMALL), 5), free=(*BELT, "conveyor[1].x"))
    with pytest.raises(CalibrationError, match=r"also = 'conveyor\[1\]\.x'.*one of .*conveyor\[1\]\.encoder"):
        solve(problem)


def test_estimated_deviations_of_belts_are_kept() -> None:
    stated = EstimatedDescription.of({"conveyor[2].rz": 0.01, "conveyor[2].encoder_scale": -0.005}, 6)
    assert len(stated.conveyor) == 2
    kept = {name: value for name, value in stated.deviations().items() if value}
    assert kept == pytest.approx({"conveyor[2].rz": 0.01, "conveyor[2].encoder_scale": -0.005})
    with pytest.raises(DescriptionError, match=r"estimated\.conveyor has 2 rows: expected at most 1, one per belt"):
        load_setup(CELL, settings={"cell.estimated.conveyor": [{}, {"rz_deg": 0.1}]})
    with pytest.raises(DescriptionError, match="expected names of as-built parameters"):
        EstimatedDescription.of({"conveyor[1].x": 0.01}, 6)


def test_belt_as_built_is_calibrated_and_the_scan_is_mended(tmp_path) -> None:
    """The direction is planted by another description of the true cell, the scale as built."""
    built, part = {"belt.encoder_scale": 0.008}, assets_dir() / "parts/free_form.stl"
    turned = {"cell.conveyor[1].pose.rz_deg": 90.4}
    with Scanner(CELL, settings={**COARSE, **turned}, threads=1) as scanner:
        report = scanner.calibrate("belt", as_built=built, seed=1)
        report.save(tmp_path / "measured")
    assert [row.name for row in report.rows] == list(BELT)
    assert [row.true for row in report.rows] == pytest.approx([0.0, 0.0, 8000.0])
    with Scanner(CELL, settings=COARSE, threads=1) as scanner:
        found = scanner.calibrate("belt", from_points=tmp_path / "measured/points.parquet")
        found.save(tmp_path / "found")
        for what in ("tool", "table", "latency", "all", "grasp"):
            with pytest.raises(CalibrationError, match=f"what = '{what}': a belt carries the part.*expected belt"):
                scanner.calibrate(what)
    for row, true in zip(found.rows, (0.0, 0.4, 8000.0), strict=True):
        assert abs(row.value - true) <= 2 * row.half_width < {"deg": 0.01, "ppm": 50.0}[row.unit]
    points, scan = tmp_path / "measured/points.parquet", tmp_path / "scan.toml"
    scan.write_text("[belt]\npitch_mm = 3.0\n")
    described = scancell.reconstruct(points, cell=CELL, scan=scan, part=part, locate=True)
    mended = scancell.reconstruct(points, calibration=tmp_path / "found", scan=scan, part=part, locate=True)
    assert mended.deviation.rms < 3e-6
    assert described.deviation.rms > 1e-5
    with Scanner(CELL, settings={**COARSE, **turned}, threads=1) as scanner:
        result = scanner.scan(part, engine="geometric", as_built=built, estimated=report.estimated)
        assert result.deviation.rms < 3e-6
        assert scanner.scan(part, engine="geometric", as_built=built).deviation.rms > 1e-5


def test_belt_needs_a_part_that_arrives_on_one() -> None:
    with Scanner(threads=1) as scanner, pytest.raises(DescriptionError, match="needs a part that starts on a conveyor"):
        scanner.calibrate("belt")
    assert CalibrationRequest("belt").free("conveyor[1]") == BELT
    assert kinematics_of(part_on_belt().nominal).belt == "conveyor[1]"
