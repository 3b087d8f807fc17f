"""Calibration of the tool by a sphere whose profiles have systematic errors: wrong radii, and pose errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from benchmarks.sphere_cell import (
    CENTRE,
    RADIUS,
    OneSurface,
    RobotErrors,
    SphereCase,
    default_kinematics,
    observations_along_z,
    sphere_views,
)
from scancell.calibration.cell.kinematics import TOOL, AxisReadings
from scancell.calibration.cell.problem import Artefact, CalibrationProblem, CalibrationResult, Observations
from scancell.calibration.cell.solve import Circles, circles_of, solve, sphere_start
from scancell.errors import CalibrationError
from scancell.geometry import pose
from scancell.geometry.shapes import Sphere

Array = np.ndarray
EXPOSURES = 15
POSE_ERRORS = RobotErrors(position=50e-6, orientation=float(np.radians(0.01)))
RADIUS_ERROR = 80e-6  # m, standard deviation from exposure to exposure
TOOL_ERROR = {"tool.x": 2e-3, "tool.y": -1e-3, "tool.z": 3e-3, "tool.rx": 0.02, "tool.ry": -0.01, "tool.rz": 0.03}


def profiles_with_wrong_radii(seed: int) -> Observations:
    """Profiles with flange poses; no direction of the points' errors is stated."""
    rng, cell = np.random.default_rng([seed, 20]), default_kinematics()
    readings = AxisReadings.at_rest(sphere_views(rng, EXPOSURES, turn_table=False))
    observed = SphereCase(TOOL_ERROR, POSE_ERRORS).observe(readings, rng)
    points = observed.points_in_sensor.copy()
    true = pose.inverse(cell.poses(observed.readings, TOOL_ERROR).platter_from_sensor)
    for exposure, platter in enumerate(true):
        rows = observed.frame == exposure
        centre = platter[:3, :3] @ np.asarray(CENTRE) + platter[:3, 3]
        away = (points[rows] - centre)[:, 1:]
        points[rows, 1:] += RADIUS_ERROR * rng.normal() * away / np.linalg.norm(away, axis=1, keepdims=True)
    readings = AxisReadings.of_flange(pose.inverse(cell.arm.world_from_base) @ cell.arm.fk(readings.q), readings.table)
    return replace(observed, readings=readings, points_in_sensor=points, direction=None)


def some(observed: Observations, exposures: Array) -> Observations:
    """Those of some exposures, numbered anew."""
    number = np.full(len(observed.readings), -1)
    number[exposures] = np.arange(len(exposures))
    kept = observed.chosen(number[observed.frame] >= 0)
    return replace(kept, readings=observed.readings.rows(exposures), frame=number[kept.frame])


def calibrated(observed: Observations) -> tuple[CalibrationResult, Circles, Array]:
    """The calibration from its circles, these, and the sphere's centres (n, 3) in the sensor that it predicts."""
    cell, circles = default_kinematics(), circles_of(observed, RADIUS)
    start = sphere_start(cell, observed.readings, circles, np.asarray(CENTRE))
    assert start is not None
    artefact = Artefact(OneSurface(Sphere(RADIUS)), pose.translation(start.centre))
    result = solve(CalibrationProblem(cell, observed, artefact, TOOL, start=start.deviations))
    sensor = cell.poses(observed.readings, result.deviations).platter_from_sensor
    centre = np.broadcast_to(result.platter_from_artefact[:3, 3], (len(sensor), 3))
    return result, circles, pose.transform_each(pose.inverse(sensor), centre)


def in_plane_misfit(circles: Circles, centres: Array) -> float:
    return float(np.sqrt(np.mean(np.sum((circles.centre - centres[circles.frame, 1:]) ** 2, axis=1))))


def plain_least_squares(observed: Observations) -> Array:
    """Centres (n, 3) of the sphere in the sensor by the least sum of squared distances of all points."""
    cell = default_kinematics()

    def centres(x: Array) -> Array:
        deviations = dict(zip(TOOL, x[:6], strict=True))
        sensor = pose.inverse(cell.poses(observed.readings, deviations).platter_from_sensor)
        return pose.transform_each(sensor, np.broadcast_to(x[6:], (len(sensor), 3)))

    def distances(x: Array) -> Array:
        return np.asarray(np.linalg.norm(observed.points_in_sensor - centres(x)[observed.frame], axis=1) - RADIUS)

    true = np.array([*TOOL_ERROR.values(), *CENTRE])
    return centres(least_squares(distances, true, x_scale="jac", xtol=1e-12, ftol=1e-12).x)


def test_centres_fit_better_than_by_plain_least_squares() -> None:
    ratios = []
    for seed in range(4):
        observed = profiles_with_wrong_radii(seed)
        _, circles, centres = calibrated(observed)
        ratios.append(in_plane_misfit(circles, centres) / in_plane_misfit(circles, plain_least_squares(observed)))
    assert max(ratios) < 1.05
    assert np.mean(ratios) < 1.0


def test_intervals_contain_left_out_centres_and_the_tool() -> None:
    inside, tools = [], []
    for seed in range(6):
        observed = profiles_with_wrong_radii(seed)
        result, circles, centres = calibrated(observed)
        left_out = result.left_out
        inside.append(np.abs(left_out.displacement) <= left_out.half_widths())
        tools.append(np.abs(result.values - list(TOOL_ERROR.values())) <= result.half_widths())
        assert result.noise_of_surface == pytest.approx(RADIUS_ERROR, rel=0.7)
        # The residual of a profile without the others is larger than its residual in the fit of all.
        kept = float(np.sqrt(np.mean(np.sum(left_out.displacement**2, axis=1))))
        assert kept > in_plane_misfit(circles, centres)
    # 180 intervals of 95 %, not independent.
    assert 0.88 <= np.mean(inside) <= 0.995
    assert np.mean(tools) >= 0.85


def test_left_out_residuals_are_those_of_fits_without_the_exposure() -> None:
    observed = profiles_with_wrong_radii(1)
    result, circles, _ = calibrated(observed)
    for exposure in (0, 7):
        rest, _, _ = calibrated(some(observed, np.delete(np.arange(EXPOSURES), exposure)))
        sensor = default_kinematics().poses(observed.readings, rest.deviations).platter_from_sensor[[exposure]]
        predicted = pose.transform_each(pose.inverse(sensor), rest.platter_from_artefact[None, :3, 3])[0, 1:]
        # The fit without it estimates other sizes of the errors, too.
        expected = circles.centre[circles.frame == exposure][0] - predicted
        row = np.flatnonzero(result.left_out.exposure == exposure)[0]
        assert np.abs(result.left_out.displacement[row] - expected).max() < result.left_out.half_widths()[row].max() / 3


def test_result_does_not_depend_on_the_origin_and_direction_of_z() -> None:
    observed = profiles_with_wrong_radii(2)
    expected = calibrated(observed)[2]
    points = observed.points_in_sensor
    shifted = calibrated(replace(observed, points_in_sensor=points + np.array([0.0, 0.0, 1.0])))[2]
    assert np.abs(shifted - [0.0, 0.0, 1.0] - expected).max() < 1e-6
    flipped = calibrated(replace(observed, points_in_sensor=points * [1.0, 1.0, -1.0] + [0.0, 0.0, 0.4]))[2]
    # The other direction of z mirrors the frame: a right-handed one has the sphere on the other side of the plane.
    assert np.abs(flipped * [-1.0, 1.0, -1.0] + [0.0, 0.0, 0.4] - expected).max() < 1e-6


def test_half_sets_are_solved() -> None:
    observed = profiles_with_wrong_radii(3)
    for exposures in (np.arange(0, 15, 2), np.arange(1, 15, 2), np.arange(8), np.arange(7, 15)):
        result, circles, centres = calibrated(some(observed, exposures))
        assert in_plane_misfit(circles, centres) < 0.2e-3
        assert np.all(np.abs(result.values - list(TOOL_ERROR.values())) < result.half_widths(0.9999))


def test_rotations_about_one_axis_are_refused() -> None:
    """Along the axis, the pose of the sensor cannot be distinguished from the place of the sphere."""
    rng, cell = np.random.default_rng(5), default_kinematics()
    q = sphere_views(rng, 1, turn_table=False)[:, :-1]
    world_from_flange = cell.arm.fk(q)[0]
    middle = world_from_flange @ cell.carrier_from_sensor @ pose.translation([0.0, 0.0, 0.12])
    turns = [
        middle @ pose.from_rotation(pose.rotation_about(0, angle)) @ pose.inverse(middle)
        for angle in np.radians([-12.0, -8.0, -4.0, 0.0, 4.0, 8.0, 12.0, 15.0])
    ]
    flange = pose.inverse(cell.arm.world_from_base) @ np.array(turns) @ world_from_flange
    shifted = flange.copy()
    shifted[:, :3, 3] += 2e-3 * rng.normal(size=(8, 3))
    readings = AxisReadings.of_flange(shifted, np.zeros(8))
    centre = (pose.inverse(cell.world_from_table) @ middle)[:3, 3]
    observed = SphereCase({}, RobotErrors(), centre=centre)
    sensor = cell.poses(readings, {}).platter_from_sensor
    points, frames = [], []
    for number, local in enumerate(pose.inverse(sensor)):
        at = local[:3, :3] @ centre + local[:3, 3]
        y = np.linspace(-0.8, 0.8, 200) * RADIUS + at[1]
        square = RADIUS**2 - at[0] ** 2 - (y - at[1]) ** 2
        z = at[2] - np.sqrt(np.maximum(square, 0.0)) + observed.noise * rng.normal(size=len(y))
        points.append(np.column_stack([np.zeros_like(y), y, z])[square > 0])
        frames.append(np.full(int((square > 0).sum()), number))
    every = np.concatenate(points)
    data = observations_along_z(readings, every, np.full(len(every), 10e-6), np.concatenate(frames))
    artefact = Artefact(OneSurface(Sphere(RADIUS)), pose.translation(centre))
    with pytest.raises(CalibrationError, match="do not determine: tool"):
        solve(CalibrationProblem(cell, data, artefact, TOOL))
