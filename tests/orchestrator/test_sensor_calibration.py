"""Calibration of cameras and laser sheet from exact stripe peaks with noise, and what it refuses."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic_stripes import board_corners, exact_exposure, native, noisy

from bench.sensor_calibration import CAMERAS, CASES, SHEET, Case, calibrated, exact, trial
from scancell.calibration.sensor.problem import (
    RADIUS_OFFSET,
    SensorParameters,
    SensorProblem,
    StripePeaks,
    TargetExposure,
    free_parameters,
)
from scancell.calibration.sensor.simulated import range_error
from scancell.calibration.sensor.solve import solve
from scancell.calibration.sensor.targets import ball, ball_poses, step_block, step_poses
from scancell.config.loading import as_built_sensor
from scancell.config.sensor import SensorDescription
from scancell.errors import CalibrationError
from scancell.geometry import pose

NOMINAL = SensorDescription.default()
KNOWN = free_parameters(NOMINAL, poses_known=True, checkered=False)
SIGMA = 0.07


def exposures(as_built, target, poses, mounting=None):
    sensor = native(as_built)
    return tuple(exact_exposure(sensor, target, one, SIGMA, 32, mounting) for one in poses)


@pytest.mark.parametrize("treads", [1, 3, 4])
def test_step_block_is_centred_at_the_origin(treads: int) -> None:
    places = np.array([placed.frame_from_shape[:3, 3] for placed in step_block(treads, 0.01, 0.005).shapes])
    np.testing.assert_allclose(places.mean(0), 0.0, atol=1e-15)
    np.testing.assert_allclose(np.diff(places, axis=0), np.tile([0.0, 0.01, 0.005], (treads - 1, 1)), atol=1e-15)


@pytest.mark.parametrize("half_angle", [12.0, 60.0])
def test_ball_stays_within_the_laser_line_that_cameras_see(half_angle: float) -> None:
    laser = NOMINAL.laser.model_copy(update={"fan_half_angle_deg": half_angle})
    position = ball_poses(NOMINAL.model_copy(update={"laser": laser}))[:, :3, 3]
    line = (position[:, 2] - 0.0125 - 1e-3 * laser.source_z_mm) * np.tan(np.radians(half_angle))
    reached = np.abs(position[:, 1]) + 0.0125
    assert (reached <= line + 1e-12).all()
    assert (np.abs(reached - line).min() < 1e-9) == (half_angle == 12.0)  # cameras see less of a wide fan


@pytest.mark.parametrize("case", CASES, ids=str)
def test_exact_peaks_give_exact_parameters(case: Case) -> None:
    as_built, measured = exact(case)
    result = solve(SensorProblem(NOMINAL, measured, free_parameters(NOMINAL, case.poses_known, checkered=False)))
    error = result.values - SensorParameters(as_built, result.names).start_values
    assert np.abs(error / result.sigma).max() < 1e-3
    assert range_error(as_built, result.sensor, align=False) < 1e-9
    assert range_error(as_built, NOMINAL, align=True) > 50e-6  # the start is far off
    assert result.sensor.extraction.triangulation == "sheet"
    assert result.discarded == 0


def test_regions_of_95_percent_hold_true_values_and_points_are_unbiased() -> None:
    """6 seeds of each case; the binomial deviation of the joint share is 4.4 % of 24, and 8.9 % of 6."""
    joint = []
    for case in CASES:
        intervals, own, bias = zip(*(trial(case, seed) for seed in range(6)), strict=True)
        joint += own
        assert np.mean(intervals) == pytest.approx(0.95, abs=0.05)
        assert np.sum(own) >= 4  # fewer has a probability of 0.2 %
        assert np.median(bias) < (1.5e-6 if case.target == "ball" else 5e-6)
    assert np.mean(joint) > 0.83


def test_stated_noise_is_that_of_residuals() -> None:
    result = calibrated(CASES[0], 1)
    assert result.chi_square == pytest.approx(1.0, abs=0.1)
    assert 1.0 <= result.covariance_scale < 1.2
    assert (np.diff(result.directions) <= 0).all()


def test_more_noise_than_stated_widens_covariance() -> None:
    rng = np.random.default_rng(2)
    measured = exact(CASES[0])[1]
    twice = tuple(
        TargetExposure(
            one.target,
            one.sensor_from_target,
            StripePeaks(
                one.stripe.camera,
                one.stripe.column,
                one.stripe.row + 2.0 * SIGMA * rng.standard_normal(len(one.stripe.row)),
                one.stripe.sigma,
            ),
        )
        for one in measured
    )
    result = solve(SensorProblem(NOMINAL, twice, KNOWN))
    assert result.chi_square == pytest.approx(4.0, rel=0.1)
    assert result.covariance_scale == pytest.approx(4.0, rel=0.2)
    np.testing.assert_allclose(result.sigma, 2.0 * calibrated(CASES[0], 1).sigma, rtol=0.1)


def test_outliers_are_discarded() -> None:
    rng = np.random.default_rng(3)
    measured = [noisy(one, rng) for one in exact(CASES[0])[1]]
    wrong = measured[0].stripe
    row = wrong.row.copy()
    row[::10] += 40.0
    spoilt = StripePeaks(wrong.camera, wrong.column, row, wrong.sigma)
    measured[0] = TargetExposure(measured[0].target, measured[0].sensor_from_target, spoilt)
    result = solve(SensorProblem(NOMINAL, tuple(measured), KNOWN))
    assert result.discarded >= len(row[::10])
    error = result.values - SensorParameters(exact(CASES[0])[0], KNOWN).start_values
    assert np.abs(error / result.sigma).max() < 4.0


def test_unknown_radius_of_ball_is_found_with_sensor() -> None:
    as_built = as_built_sensor(NOMINAL, CAMERAS + SHEET)
    measured = exposures(as_built, ball(0.02504), ball_poses(NOMINAL))
    stated = tuple(TargetExposure(ball(), one.sensor_from_target, one.stripe) for one in measured)
    result = solve(SensorProblem(NOMINAL, stated, (*KNOWN, RADIUS_OFFSET)))
    assert result.values[-1] == pytest.approx(0.02, abs=1e-5)
    assert range_error(as_built, result.sensor, align=False) < 1e-8


def test_ball_on_stage_mounted_anywhere_gives_mounting() -> None:
    """The stage is 1 mm and 1 degree away from where it is said to be; its travel is known."""
    as_built = as_built_sensor(NOMINAL, CAMERAS)
    away = pose.from_euler_xyz((1e-3, -5e-4, 8e-4), np.radians([1.0, -0.5, 0.3]))
    measured = exposures(as_built, ball(), [away @ one for one in ball_poses(NOMINAL)], mounting=1)
    stated = tuple(
        TargetExposure(one.target, start, one.stripe, mounting=1)
        for one, start in zip(measured, ball_poses(NOMINAL), strict=True)
    )
    result = solve(SensorProblem(NOMINAL, stated, free_parameters(NOMINAL, poses_known=False, checkered=False)))
    np.testing.assert_allclose(result.displacement[1], away, atol=1e-7)
    assert range_error(as_built, result.sensor, align=False) < 1e-8


def corner_exposures(as_built, poses, mountings):
    """Corners of a board and the stripe on it, in the images of all cameras."""
    sensor, board = native(as_built), step_block(1, width=0.04)
    stripes = [exact_exposure(sensor, board, one, SIGMA, 32).stripe for one in poses]
    return tuple(
        TargetExposure(board, one, stripe, board_corners(sensor, one), mounting)
        for one, stripe, mounting in zip(poses, stripes, mountings, strict=True)
    )


def test_checkered_target_gives_principal_point_too() -> None:
    """Every view of the board has an unknown pose; corners and the stripe on the board are solved together."""
    words = (*CAMERAS, "sensor.camera[1].cx_px=645", "sensor.camera[1].cy_px=507", "sensor.camera[2].cx_px=636")
    as_built = as_built_sensor(NOMINAL, words)
    poses = [one @ pose.from_euler_xyz((0, 0, 0), (0, 0, 0.3 * k)) for k, one in enumerate(step_poses(NOMINAL, 3))]
    free = free_parameters(NOMINAL, poses_known=False, checkered=True)
    result = solve(SensorProblem(NOMINAL, corner_exposures(as_built, poses, range(1, len(poses) + 1)), free))
    error = result.values - SensorParameters(as_built, free).start_values
    assert np.abs(error / result.sigma).max() < 1e-2
    assert range_error(as_built, result.sensor, align=False) < 1e-8


def refused(measured, free=KNOWN) -> str:
    with pytest.raises(CalibrationError) as error:
        solve(SensorProblem(NOMINAL, tuple(measured), free))
    return str(error.value)


def at_one_height():
    poses = step_poses(NOMINAL)
    return exposures(NOMINAL, step_block(1), [one for one in poses if abs(one[2, 3] - poses[10][2, 3]) < 1e-6])


def of_few_peaks():
    one = exposures(NOMINAL, ball(), ball_poses(NOMINAL)[:1])[0]
    few = StripePeaks(*(getattr(one.stripe, key)[:5] for key in ("camera", "column", "row", "sigma")))
    return [TargetExposure(one.target, one.sensor_from_target, few)]


def of_steps():
    return exposures(NOMINAL, step_block(), step_poses(NOMINAL))


@pytest.mark.parametrize(
    ("measured", "free", "said"),
    [
        (at_one_height, KNOWN, ["do not determine", "heights: all points lie at z ="]),
        (
            lambda: exposures(NOMINAL, ball(), [ball_poses(NOMINAL)[20]] * 30),
            KNOWN,
            ["heights: all points lie at z ="],
        ),
        # Heights alone do not show errors along the line: the plane is the same everywhere.
        (
            lambda: exposures(NOMINAL, step_block(1, width=0.06), step_poses(NOMINAL, 9)[::5]),
            KNOWN,
            ["directions: all surfaces face the same way", "camera[1].offset_y_mm"],
        ),
        (of_steps, free_parameters(NOMINAL, poses_known=True, checkered=True), ["cy_px", "checkered target"]),
        (of_steps, (*KNOWN, RADIUS_OFFSET), ["target.radius_offset_mm", "a ball: no target has a radius to find"]),
        (of_few_peaks, KNOWN, ["do not determine"]),
    ],
    ids=["one height", "equal exposures", "level plane", "principal point", "radius without ball", "few peaks"],
)
def test_exposures_that_determine_too_little_are_refused(measured, free: tuple[str, ...], said: list[str]) -> None:
    text = refused(measured(), free)
    assert all(part in text for part in said)


def test_frame_of_sensor_is_refused_without_known_poses() -> None:
    measured = exposures(NOMINAL, ball(), ball_poses(NOMINAL), mounting=1)
    text = refused(measured)
    assert "unknown poses of the targets take up these directions" in text
    assert text.count("standard deviation of the first") == 6  # the rigid motions


def test_no_measurements_are_refused() -> None:
    assert "no measurements" in refused([])
    none = StripePeaks(np.zeros(0, np.int32), *np.zeros((3, 0)))
    assert "hold none" in refused([TargetExposure(ball(), ball_poses(NOMINAL)[0], none)])


def test_exposure_without_stripe_changes_nothing() -> None:
    """The target may leave the field of view."""
    measured = exact(CASES[1])[1]
    none = TargetExposure(
        ball(), ball_poses(NOMINAL)[0], StripePeaks(np.zeros(0, np.int32), *np.zeros((3, 0))), None, 7
    )
    free = free_parameters(NOMINAL, poses_known=False, checkered=False)
    with_it, without = (solve(SensorProblem(NOMINAL, one, free)) for one in ((*measured, none), measured))
    np.testing.assert_allclose(with_it.values, without.values, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (("sensor.camera[3].tilt_deg",), r"sensor.camera\[3\].tilt_deg"),
        (("sensor.camera[1].f_number",), "expected one of the keys"),
        (("sensor.laser.turn_y_deg", "sensor.laser.turn_y_deg"), "twice"),
    ],
)
def test_wrong_names_of_parameters_are_refused(names, message) -> None:
    with pytest.raises(CalibrationError, match=message):
        SensorParameters(NOMINAL, names).start_values  # noqa: B018


@pytest.mark.parametrize("target", ["ball", "step block"])
def test_sensor_far_from_its_start_is_found(target) -> None:
    """Deviations of 0.5 to 1 mm and degree; treads of 4 mm rise are seen 5 mm off at the start."""
    words = (
        "sensor.camera[1].tilt_deg=30.3",
        "sensor.camera[1].pan_deg=0.7",
        "sensor.camera[2].roll_deg=-0.8",
        "sensor.camera[2].height_mm=-1",
        "sensor.laser.turn_y_deg=-0.6",
        "sensor.laser.turn_z_deg=0.5",
        "sensor.laser.offset_x_mm=0.5",
    )
    as_built = as_built_sensor(NOMINAL, words)
    shape, poses = (ball(), ball_poses(NOMINAL)) if target == "ball" else (step_block(), step_poses(NOMINAL))
    assert range_error(as_built, NOMINAL, align=False) > 2e-3
    result = solve(SensorProblem(NOMINAL, exposures(as_built, shape, poses), KNOWN))
    assert range_error(as_built, result.sensor, align=False) < 1e-8
