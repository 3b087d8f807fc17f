"""`python -m bench.sensor_calibration` (in tests/): how often 95 % regions of calibrated sensors hold the true values.

Stripe peaks are exact but for row noise of 0.07 px, on every sixteenth column. The bias of the points is that of the
calibrated sensor at pixels of the whole range; where the poses are unknown, after alignment of the sensor frames.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from scancell.calibration.sensor import targets as sensor_targets
from scancell.calibration.sensor.problem import SensorParameters, SensorProblem, TargetExposure, free_parameters
from scancell.calibration.sensor.simulated import calibrate_from, measure, range_error
from scancell.calibration.sensor.solve import SensorCalibration, solve
from scancell.config.choices import SensorTarget
from scancell.config.loading import as_built_sensor
from scancell.config.sensor import SensorDescription

sys.path.append(str(Path(__file__).resolve().parents[1] / "orchestrator"))

from synthetic_stripes import exact_exposure, native, noisy

Array = NDArray[np.float64]

SIGMA_PX = 0.07
# The cameras and the shape of the sheet; the sensor frame is where the sheet and the first camera say it is.
CAMERAS = (
    "sensor.camera[1].tilt_deg=29.4",
    "sensor.camera[1].roll_deg=0.15",
    "sensor.camera[2].baseline_mm=60.2",
    "sensor.camera[2].pan_deg=-0.1",
    "sensor.camera[1].distortion=[-0.05,0,0,0,0]",
    "sensor.camera[2].distortion=[0.03,0,0,0,0]",
    "sensor.laser.straightness_mrad=[0,0,0.5]",
)
SHEET = ("sensor.laser.turn_y_deg=0.2", "sensor.laser.turn_z_deg=-0.1", "sensor.laser.offset_x_mm=0.1")


@dataclass(frozen=True)
class Case:
    """A target and what is known of its poses."""

    target: str
    poses_known: bool

    def __str__(self) -> str:
        return f"{self.target}, {'known poses' if self.poses_known else 'unknown mounting'}"


TARGETS = ("ball", "step block")
CASES = tuple(Case(target, known) for target in TARGETS for known in (True, False))


@cache
def exact(case: Case) -> tuple[SensorDescription, tuple[TargetExposure, ...]]:
    """The sensor as built, and its exposures without noise."""
    nominal = SensorDescription.default()
    as_built = as_built_sensor(nominal, CAMERAS + SHEET if case.poses_known else CAMERAS)
    if case.target == "ball":
        target, poses = sensor_targets.ball(), sensor_targets.ball_poses(nominal)
    else:
        target, poses = sensor_targets.step_block(), sensor_targets.step_poses(nominal)
    sensor, mounting = native(as_built), None if case.poses_known else 1
    return as_built, tuple(exact_exposure(sensor, target, one, SIGMA_PX, mounting=mounting) for one in poses)


def calibrated(case: Case, seed: int) -> SensorCalibration:
    """The sensor calibrated from noisy peaks; the nominal description is the start."""
    rng = np.random.default_rng(seed)
    nominal = SensorDescription.default()
    free = free_parameters(nominal, case.poses_known, checkered=False)
    return solve(SensorProblem(nominal, tuple(noisy(one, rng) for one in exact(case)[1]), free))


def errors(case: Case, result: SensorCalibration) -> tuple[NDArray[np.bool_], bool, float]:
    """Per parameter whether its 95 % interval holds the true value, whether the joint region does, and the bias RMS."""
    as_built = exact(case)[0]
    error = result.values - SensorParameters(as_built, result.names).start_values
    joint = float(error @ np.linalg.solve(result.covariance, error))
    bias = range_error(as_built, result.sensor, align=not case.poses_known)
    return np.abs(error) < 1.96 * result.sigma, joint < chi2.ppf(0.95, len(error)), bias


def trial(case: Case, seed: int) -> tuple[NDArray[np.bool_], bool, float]:
    """`errors` of one seed."""
    return errors(case, calibrated(case, seed))


def rendered_trial(target: SensorTarget, seed: int) -> tuple[Array, float, float]:
    """By ray-traced images: errors in standard deviations, bias RMS (m), and the scale of the covariance."""
    nominal, words = SensorDescription.default(), CAMERAS + SHEET
    built = as_built_sensor(nominal, words)
    result = calibrate_from(nominal, measure(nominal, words, (target,), None, seed))
    error = result.values - SensorParameters(built, result.names).start_values
    return error / result.sigma, range_error(built, result.sensor, align=False), result.covariance_scale


def rendered_table(seeds: int, jobs: int) -> Iterator[str]:
    """Rows of Markdown for targets at known poses by ray-traced images."""
    yield f"{seeds} seeds, from 101"
    yield ""
    yield "| target | 95 % intervals that hold | error / deviation, RMS | RMS error of points | covariance scale |"
    yield "|---|---|---|---|---|"
    targets: tuple[SensorTarget, ...] = ("ball", "step")
    with ProcessPoolExecutor(jobs) as pool:
        for target in targets:
            found = list(pool.map(partial(rendered_trial, target), range(101, 101 + seeds)))
            ratio = np.array([one[0] for one in found])
            bias, scale = 1e6 * np.array([one[1] for one in found]), np.array([one[2] for one in found])
            share = f"{100 * np.mean(np.abs(ratio) < 1.96):.1f} %"
            rms = f"{np.sqrt(np.mean(ratio**2)):.2f}"
            worst = f"median {np.median(bias):.2f} µm, largest {bias.max():.2f} µm"
            yield f"| {target} | {share} | {rms} | {worst} | {scale.min():.1f} … {scale.max():.1f} |"


def table(seeds: int, jobs: int, targets: Sequence[str]) -> Iterator[str]:
    """Rows of Markdown for the cases of the targets."""
    yield f"{seeds} seeds"
    yield ""
    yield "| target | parameters | 95 % intervals that hold | 95 % regions that hold | RMS error of points |"
    yield "|---|---|---|---|---|"
    with ProcessPoolExecutor(jobs) as pool:
        for case in (one for one in CASES if one.target in targets):
            found = list(pool.map(partial(trial, case), range(seeds), chunksize=5))
            intervals = 100 * np.mean([one[0] for one in found], axis=0)
            joint = 100 * np.mean([one[1] for one in found])
            bias = 1e6 * np.array([one[2] for one in found])
            share = f"{intervals.min():.1f} … {intervals.max():.1f} %, mean {intervals.mean():.1f} %"
            worst = f"median {np.median(bias):.2f} µm, 95 % below {np.quantile(bias, 0.95):.2f} µm"
            yield f"| {case} | {len(intervals)} | {share} | {joint:.1f} % | {worst} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m bench.sensor_calibration", description=__doc__)
    parser.add_argument("--seeds", type=int, default=1000)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--target", choices=TARGETS, help="only this one")
    parser.add_argument("--rendered", action="store_true", help="by ray-traced images, instead of exact peaks")
    options = parser.parse_args()
    targets = [options.target] if options.target else TARGETS
    rows = rendered_table if options.rendered else partial(table, targets=targets)
    for line in rows(options.seeds, options.jobs):
        print(line, flush=True)


if __name__ == "__main__":
    main()
