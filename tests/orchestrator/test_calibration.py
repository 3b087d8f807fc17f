"""Calibration of tool, table, joints and trigger from synthetic profiles with known deviations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.sphere_cell import (
    CENTRE,
    LARGE,
    RADIUS,
    REALISTIC,
    OneSurface,
    RobotErrors,
    SphereCase,
    default_kinematics,
    joined,
    misaligned,
    observations_along_z,
    passing_sphere,
    sphere_views,
)
from scancell import sensor as sensor_rt
from scancell.calibration.cell.kinematics import LATENCY, PLATTER, TABLE, TOOL, WOBBLE, AxisReadings, written_unit
from scancell.calibration.cell.problem import Artefact, CalibrationProblem, Observations
from scancell.calibration.cell.scan import observations_of, readings_of
from scancell.calibration.cell.solve import circles_of, solve, sphere_start
from scancell.calibration.cell.views import design_poses
from scancell.cell.recording import TriggerRecords
from scancell.config.cell import EstimatedDescription
from scancell.config.loading import load_setup
from scancell.errors import CalibrationError
from scancell.geometry import pose
from scancell.geometry.shapes import Plane
from scancell.nominal.cell import estimated_cell, nominal_cell
from scancell.reconstruction.reconstruct import ProfilePoints
from scancell.scanning.world import make_sensor


def some_readings(rng: np.random.Generator, count: int) -> AxisReadings:
    return AxisReadings(*rng.normal(size=(3, count, 7)))


def at_rest(rng: np.random.Generator, count: int, turn_table: bool = True) -> AxisReadings:
    return AxisReadings.at_rest(sphere_views(rng, count, turn_table=turn_table))


@pytest.mark.parametrize("name", default_kinematics().names)
def test_screws_are_derivatives_of_points(name: str) -> None:
    cell, rng = default_kinematics(), np.random.default_rng(1)
    readings, points = some_readings(rng, 5), 0.1 * rng.normal(size=(5, 3))
    at = {other: 0.01 * rng.normal() for other in cell.names}
    step = 1e-6

    def moved(change: float) -> np.ndarray:
        poses = cell.poses(readings, {**at, name: at[name] + change})
        return pose.transform_each(poses.platter_from_sensor, points)

    poses = cell.poses(readings, at)
    screw = poses.deviations[name]
    by_screw = screw[:, :3] + np.cross(screw[:, 3:], pose.transform_each(poses.platter_from_sensor, points))
    assert by_screw == pytest.approx((moved(step) - moved(-step)) / (2 * step), abs=1e-7)


def test_calibration_and_reconstruction_share_one_geometry() -> None:
    rng = np.random.default_rng(2)
    cell, nominal = default_kinematics(), nominal_cell(load_setup().cell, None)
    deviations = {name: 0.01 * rng.normal() for name in cell.names}
    made, number = some_readings(rng, 6), np.arange(6)
    measured = TriggerRecords(
        *(number, number // 4, 0.02 * number, np.full(6, 1e-3)),
        *(nominal.axes, made.axes, made.rates),
    )
    estimated = estimated_cell(nominal, deviations)
    late = measured.after(estimated.trigger_latency)
    expected = pose.inverse(estimated.world_from("table", late.axes)) @ estimated.world_from("sensor", late.axes)
    assert cell.poses(readings_of(measured), deviations).platter_from_sensor == pytest.approx(expected, abs=1e-12)


def test_estimated_description_keeps_deviations() -> None:
    deviations = misaligned(
        np.random.default_rng(3), *TOOL, *TABLE, *PLATTER, *WOBBLE, LATENCY, "dh[3].theta", "dh[2].a"
    )
    kept = EstimatedDescription.of(deviations, 6).deviations()
    assert {name: value for name, value in kept.items() if value} == pytest.approx(deviations, abs=1e-11)
    with pytest.raises(ValueError, match=r"deviations = .*arm.*expected names of as-built parameters"):
        EstimatedDescription.of({"arm.x": 1.0}, 6)


@pytest.mark.parametrize("robot", [RobotErrors(), REALISTIC], ids=["perfect robot", "realistic robot"])
def test_tool_and_table_are_found_within_their_intervals(robot: RobotErrors) -> None:
    rng, free = np.random.default_rng(4), TOOL + TABLE
    case = SphereCase(misaligned(rng, *free), robot)
    result = solve(case.problem(case.observe(at_rest(rng, 24), rng), free))
    true = np.array([case.deviations[name] for name in free])
    assert np.all(np.abs(result.values - true) < result.half_widths(0.9999))
    assert result.contains(true, 0.9999)
    tool, turn = np.linalg.norm((result.values - true)[:3]), np.linalg.norm((result.values - true)[3:6])
    if robot is REALISTIC:
        assert tool < 0.15e-3 and np.degrees(turn) < 0.2
        assert result.noise_of_robot[0] == pytest.approx(REALISTIC.position, rel=0.6)
    else:
        assert tool < 10e-6 and np.degrees(turn) < 0.01
        assert 0.5 * case.noise < result.rms < case.noise  # noise is along z, at up to 60 deg from the surface normal
    assert result.noise_of_points == pytest.approx(1.0, abs=0.05)
    # The directions are those of the covariance, worst first.
    deviations = [one.standard_deviation for one in result.directions]
    assert deviations == sorted(deviations, reverse=True)
    vectors = np.array([one.vector for one in result.directions]) * np.array(deviations)[:, None]
    assert 1e-6 * vectors.T @ vectors == pytest.approx(result.covariance, rel=1e-6, abs=1e-20)


def test_large_deviations_and_latency_are_found_exactly_without_noise() -> None:
    """The path goes on straight during the latency, its joints do not go on at their latched rates."""
    rng = np.random.default_rng(12)
    free = (*TOOL, *TABLE, *PLATTER, LATENCY)
    case = SphereCase(misaligned(rng, *free, sizes=LARGE) | {LATENCY: 12e-3}, noise=0.0)
    readings = joined(at_rest(rng, 24), passing_sphere(rng, 6, 15, 0.05))
    result = solve(case.problem(case.observe(readings, rng), free, is_pose_known=True))
    error = {name: value - case.deviations[name] for name, value in zip(free, result.values, strict=True)}
    for name in free:
        assert abs(error[name]) < {"mm": 0.02e-6, "deg": np.radians(2e-5), "ms": 0.1e-6}[written_unit(name)[0]], name


def test_sphere_on_the_axis_of_the_platter_converges() -> None:
    """Its rotation about the axis changes nothing, and no rounding may take it for an unknown."""
    rng = np.random.default_rng(17)
    case = SphereCase({LATENCY: 2e-3}, centre=(0.0, 0.0, 0.06))
    observed = case.observe(passing_sphere(rng, 6, 15, 0.05, case.centre), rng)
    result = solve(case.problem(observed, (LATENCY,)))
    assert result.deviations[LATENCY] == pytest.approx(2e-3, abs=0.05e-3)


def test_circles_of_a_sphere_start_a_calibration_far_from_nominal() -> None:
    rng = np.random.default_rng(18)
    true = {"tool.x": 8e-3, "tool.y": -5e-3, "tool.z": 6e-3, "tool.rx": 0.06, "tool.ry": -0.05, "tool.rz": 0.08}
    observed = SphereCase(true).observe(at_rest(rng, 24, turn_table=False), rng)
    # A second surface in every profile: a line below the sphere.
    count, frames = 150, len(observed.readings)
    y = np.tile(np.linspace(-0.03, 0.03, count), frames)
    line = np.column_stack([np.zeros_like(y), y, np.full_like(y, 0.16)])
    points = np.concatenate([observed.points_in_sensor, line])
    frame = np.concatenate([observed.frame, np.repeat(np.arange(frames), count)])
    cluttered = observations_along_z(observed.readings, points, np.full(len(points), 10e-6), frame)
    circles = circles_of(cluttered, RADIUS)
    start = sphere_start(default_kinematics(), cluttered.readings, circles, np.asarray(CENTRE) + 5e-3)
    assert start is not None and start.exposures >= 12
    errors = np.array([start.deviations[name] - true[name] for name in TOOL])
    assert np.abs(errors[:3]).max() < 0.1e-3 and np.degrees(np.abs(errors[3:]).max()) < 0.1
    assert start.centre == pytest.approx(CENTRE, abs=0.1e-3)


def test_profiles_without_circles_give_no_start() -> None:
    rng = np.random.default_rng(19)
    readings = at_rest(rng, 5, turn_table=False)
    y = np.tile(np.linspace(-0.03, 0.03, 100), 5)
    points = np.column_stack([np.zeros_like(y), y, 0.12 + 5e-6 * rng.normal(size=len(y))])
    flat = observations_along_z(readings, points, np.full(len(y), 5e-6), np.repeat(np.arange(5), 100))
    assert sphere_start(default_kinematics(), readings, circles_of(flat, RADIUS), np.asarray(CENTRE)) is None


def test_joint_zeros_lengths_and_wobble() -> None:
    rng, free = np.random.default_rng(6), (*TOOL, *TABLE, *WOBBLE, "dh[3].theta", "dh[5].theta", "dh[2].a")
    case = SphereCase(misaligned(rng, *free))
    result = solve(case.problem(case.observe(at_rest(rng, 80), rng), free, is_pose_known=True))
    true = np.array([case.deviations[name] for name in free])
    assert np.all(np.abs(result.values - true) < result.half_widths(0.9999))
    written = [half / written_unit(name)[1] for half, name in zip(result.half_widths(), free, strict=True)]
    assert max(written) < 0.1


def test_unknown_radius_is_found() -> None:
    rng = np.random.default_rng(7)
    case = SphereCase(misaligned(rng, *TOOL), radius=0.0125 + 30e-6)
    observed = case.observe(at_rest(rng, 30, turn_table=False), rng)
    result = solve(case.problem(observed, TOOL, unknown_sizes=(0,)))
    assert result.sizes[0] == pytest.approx(30e-6, abs=3e-6)
    assert abs(result.sizes[0] - 30e-6) < 4 * result.size_standard_deviations[0] < 12e-6


def test_outliers_are_left_out() -> None:
    rng = np.random.default_rng(8)
    case = SphereCase(misaligned(rng, *TOOL))
    observed = case.observe(at_rest(rng, 24, turn_table=False), rng)
    bad = rng.uniform(size=len(observed.sigma)) < 0.05
    points = observed.points_in_sensor.copy()
    points[bad, 2] += rng.choice([-1, 1], bad.sum()) * rng.uniform(0.2e-3, 3e-3, bad.sum())
    result = solve(case.problem(replace(observed, points_in_sensor=points), TOOL))
    true = np.array([case.deviations[name] for name in TOOL])
    assert np.all(np.abs(result.values - true) < result.half_widths(0.9999))
    assert len(result.residuals) == pytest.approx(result.points - bad.sum(), abs=0.002 * result.points)


def test_sheet_that_triangulation_neglects_enters_the_intervals() -> None:
    """As a standard deviation: by how much the result changes once the points are where the sheet is."""
    rng = np.random.default_rng(9)
    case = SphereCase(misaligned(rng, *TOOL))
    observed = case.observe(at_rest(rng, 24, turn_table=False), rng)
    points = observed.points_in_sensor
    off_sheet = np.outer(2e-6 * (points[:, 1] / 0.02) ** 2, [1.0, 0.0, 1.5])
    plane, curved = (
        solve(case.problem(each, TOOL)) for each in (observed, replace(observed, points_in_sensor=points + off_sheet))
    )
    stated = solve(case.problem(replace(observed, off_sheet=off_sheet), TOOL))
    assert not plane.neglected.any()
    assert stated.values == pytest.approx(plane.values, abs=1e-12)
    change = curved.values - plane.values
    assert stated.neglected == pytest.approx(change, abs=0.1 * np.abs(change).max())
    assert stated.covariance - plane.covariance == pytest.approx(np.outer(stated.neglected, stated.neglected))
    assert (stated.half_widths() >= 1.9 * np.abs(stated.neglected)).all()


@pytest.mark.parametrize("bends", [(), (0.0, 0.1, 0.4)], ids=["plane", "curved"])
@pytest.mark.parametrize("triangulation", ["exact", "sheet"])
def test_points_off_the_described_sheet_are_known(bends: tuple[float, ...], triangulation: str) -> None:
    setup = load_setup(
        settings={"sensor.laser.straightness_mrad": bends, "sensor.extraction.triangulation": triangulation}
    )
    sensor, count = make_sensor(setup.sensor, 0), 5
    pixels = np.column_stack([np.linspace(100.0, 900.0, count), np.full(count, 300.0)])
    where, on_sheet = (sensor_rt.triangulate_pixels(pixels, sensor, 0, form) for form in (triangulation, "sheet"))
    zeros = np.zeros(count)
    columns = (zeros + 1e-6, zeros, zeros.astype(np.int32), zeros.astype(np.int32), zeros.astype(int))
    profiles = ProfilePoints(where, *columns, zeros.astype(np.uint32), zeros)
    off = observations_of(profiles, AxisReadings.at_rest(np.zeros((1, 7))), sensor).off_sheet
    assert (off is None) == (not bends or triangulation == "sheet")
    if off is not None:
        assert where + off == pytest.approx(on_sheet, abs=1e-10)
        assert np.abs(off).max() > 1e-6


def plane_observations(
    deviations: dict[str, float], planes: list[np.ndarray], rng: np.random.Generator, count: int
) -> Observations:
    """Profiles of planes (poses (4, 4) on the platter), one plane per exposure."""
    cell = default_kinematics()
    readings = AxisReadings.at_rest(sphere_views(rng, count, turn_table=False))
    sensor = cell.poses(readings, deviations).platter_from_sensor
    points, frames, which = [], [], []
    for frame, platter_from_sensor in enumerate(sensor):
        number = int(np.argmax([-(plane[:3, 2] @ platter_from_sensor[:3, 2]) for plane in planes]))
        local = pose.inverse(planes[number]) @ platter_from_sensor
        y = np.linspace(-0.015, 0.015, 200)
        # On the plane: third row of local @ (0, y, z, 1) is 0.
        z = -(local[2, 1] * y + local[2, 3]) / local[2, 2] + 10e-6 * rng.normal(size=len(y))
        points.append(np.column_stack([np.zeros_like(y), y, z]))
        frames.append(np.full(len(y), frame))
        which.append(np.full(len(y), number))
    every = np.concatenate(points)
    observed = observations_along_z(readings, every, np.full(len(every), 10e-6), np.concatenate(frames))
    return replace(observed, shape=np.concatenate(which))


class Corner:
    """Planes of one rigid artefact, by number."""

    def __init__(self, planes: list[np.ndarray]) -> None:
        self._planes = [OneSurface(Plane(1.0, 1.0), plane) for plane in planes]

    def assign(self, points: np.ndarray) -> np.ndarray:
        return np.argmin([np.abs(plane.distance(points, points)[0]) for plane in self._planes], axis=0)

    def distance(self, points: np.ndarray, shape: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        signed, normal = np.empty(len(points)), np.empty((len(points), 3))
        for number, plane in enumerate(self._planes):
            rows = shape == number
            signed[rows], normal[rows] = plane.distance(points[rows], shape[rows])
        return signed, normal


def corner(angle: float) -> list[np.ndarray]:
    """Three planes like the sides of a pyramid, tilted by `angle` from the horizontal, rad."""
    turns = [pose.rotation_about(2, turn) @ pose.rotation_about(1, angle) for turn in (0.0, 2.1, 4.2)]
    return [pose.from_rotation(turn, (*CENTRE[:2], CENTRE[2])) for turn in turns]


def test_tool_from_three_planes() -> None:
    rng = np.random.default_rng(9)
    true = misaligned(rng, *TOOL)
    planes = corner(0.6)
    observed = plane_observations(true, planes, rng, 40)
    artefact = Artefact(Corner(planes), pose.translation((0.2e-3, 0.1e-3, -0.3e-3)))
    result = solve(CalibrationProblem(default_kinematics(), observed, artefact, TOOL, robot_noise="none"))
    found = np.array([true[name] for name in TOOL])
    assert np.all(np.abs(result.values - found) < result.half_widths(0.9999))


def near_one_pose(rng: np.random.Generator) -> AxisReadings:
    off = np.column_stack([np.radians(0.01) * rng.normal(size=(20, 6)), np.zeros(20)])
    return AxisReadings.at_rest(sphere_views(rng, 1, turn_table=False) + off)


@pytest.mark.parametrize(
    ("readings", "free", "message"),
    [
        (near_one_pose, TOOL, r"do not determine: .*tool.*turn the sensor about two axes"),
        (
            lambda rng: at_rest(rng, 24, turn_table=False),
            TOOL + TABLE,
            r"do not determine: .*table.*three or more table angles",
        ),
        (lambda rng: at_rest(rng, 24), (LATENCY,), r"do not determine: trigger\.latency\. Nothing moves"),
        (lambda rng: at_rest(rng, 2), TOOL, r"2 exposures show the artefact .* need 3 at least"),
        (
            lambda rng: at_rest(rng, 12),
            ("tool.yaw",),
            r"also = 'tool\.yaw': is not a deviation of the cell; expected one of tool\.x",
        ),
    ],
    ids=["equal orientations", "table does not turn", "latency without motion", "too few exposures", "unknown name"],
)
def test_exposures_that_determine_too_little_are_rejected(readings, free: tuple[str, ...], message: str) -> None:
    rng, case = np.random.default_rng(10), SphereCase()
    observed = case.observe(readings(rng), rng)
    with pytest.raises(CalibrationError, match=message):
        solve(case.problem(observed, free, is_pose_known=free == (LATENCY,)))


def test_collinear_sphere_centres_are_rejected() -> None:
    """A sphere on the axis of the table stays where it is: a tilt of the axis looks like a shift."""
    rng = np.random.default_rng(14)
    case = SphereCase(centre=(0.0, 0.0, 0.06))
    observed = case.observe(AxisReadings.at_rest(sphere_views(rng, 24, case.centre)), rng)
    with pytest.raises(CalibrationError, match=r"do not determine: table\.r. .*off the axis"):
        solve(case.problem(observed, TABLE, is_pose_known=True))


def test_designed_poses_are_better_than_random_ones() -> None:
    rng, free = np.random.default_rng(16), TOOL + TABLE
    case = SphereCase(noise=0.0)
    candidates = case.problem(case.observe(at_rest(rng, 200), rng), free, placed_off=(0.0, 0.0, 0.0))
    noise = np.log([1.0, REALISTIC.position**2, REALISTIC.orientation**2])
    designed = design_poses(candidates, noise, 200)
    assert len(set(designed.rows.tolist())) == 200
    # With each pose the covariance shrinks, and all poses together are as good in any order.
    assert np.all(np.diff(designed.expected, axis=0) < 1e-12)
    at_random = design_poses(replace(candidates, observations=_first(candidates.observations, 24)), noise, 24).expected[
        -1
    ]
    assert np.linalg.norm(designed.expected[23][:3]) < 0.8 * np.linalg.norm(at_random[:3])


def _first(data: Observations, count: int) -> Observations:
    rows = np.arange(count)
    return replace(data.chosen(data.frame < count), readings=data.readings.rows(rows))
