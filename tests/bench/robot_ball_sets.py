"""Tool by profiles of a ball on a robot, against plain least squares: misfit, frames, half sets, left-out profiles.

``PYTHONPATH=tests python -m bench.robot_ball_sets --data FOLDER``, with ``data/ScanData`` of the set that
docs/reality.md names. Prints the table of docs/calibration.md.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from bench.robot_ball import RADIUS, Recording, calibrated, read_recording
from scancell.calibration.cell.report import CalibrationReport
from scancell.calibration.cell.solve import Circles, circles_of
from scancell.errors import CalibrationError
from scancell.geometry import pose

Array = NDArray[np.float64]

_EVERY = 5  # points are 30 µm apart
_OF_JUDGE = 20  # points of the plain fit
SETS = (".", "tmp/10.30")


def centres(report: CalibrationReport) -> Array:
    """The ball's centre in the sensor (n, 3) as the calibration predicts it."""
    problem = report.calibration.problem
    sensor = problem.kinematics.poses(problem.observations.readings, report.result.deviations).platter_from_sensor
    centre = 1e-3 * np.array(report.figures["artefact_centre_mm"])
    return np.asarray(pose.transform_each(pose.inverse(sensor), np.broadcast_to(centre, (len(sensor), 3))))


def plain_centres(data: Recording, circles: Circles, start: CalibrationReport) -> Array:
    """The same by the least sum of squared distances of the points on the circles, from the same start."""
    tool = start.flange_from_sensor
    about = start.calibration.problem.kinematics
    points = []
    for frame, profile in enumerate(data.profiles):
        own = circles.frame == frame
        away = np.abs(np.linalg.norm(profile[:, 1:] - circles.centre[own], axis=1) - circles.radius[own])
        points.append(profile[away < 0.3e-3][:: _OF_JUDGE // _EVERY])
    row = np.repeat(np.arange(len(points)), [len(one) for one in points])
    every = np.concatenate(points)
    base = pose.inverse(about.arm.world_from_base) @ about.world_from_table
    ball = pose.transform_points(base, 1e-3 * np.array(start.figures["artefact_centre_mm"])[None])[0]

    def predicted(x: Array) -> Array:
        moved = tool @ pose.from_rotation(pose.exp_rotation(x[:3]), x[3:6])
        return pose.transform_each(
            pose.inverse(data.flange @ moved), np.broadcast_to(ball + x[6:], (len(data.flange), 3))
        )

    def distances(x: Array) -> Array:
        return np.asarray(np.linalg.norm(every - predicted(x)[row], axis=1) - RADIUS)

    return predicted(least_squares(distances, np.zeros(9), x_scale="jac", xtol=1e-13, ftol=1e-13, gtol=1e-13).x)


def misfit(circles: Circles, predicted: Array) -> float:
    """RMS distance of the circles' centres from the predicted ones in the laser's plane, mm."""
    return 1e3 * float(np.sqrt(np.mean(np.sum((circles.centre - predicted[circles.frame, 1:]) ** 2, axis=1))))


def lines(data: Path) -> Iterator[str]:
    """The table, a line for each set."""
    yield "| set | misfit, plain least squares (mm) | ratio | frames agree to (um) | half sets | all but one | inside |"
    yield "|---|---|---|---|---|---|---|"
    for name in SETS:
        own = read_recording(data / name, _EVERY)
        report = calibrated(own)
        found = centres(report)
        circles = circles_of(report.calibration.problem.observations, RADIUS)
        values = misfit(circles, found), misfit(circles, plain_centres(own, circles, report))
        flipped = centres(calibrated(own.in_frame(-1.0, 0.4))) * [-1.0, 1.0, -1.0] + [0.0, 0.0, 0.4]
        shifted = centres(calibrated(own.in_frame(1.0, 1.0))) - [0.0, 0.0, 1.0]
        apart = 1e6 * max(np.abs(flipped - found).max(), np.abs(shifted - found).max())
        count = len(own.flange)
        halves = [range(0, count, 2), range(1, count, 2), range(8), range(7, count)]
        folds = [[k for k in range(count) if k != i] for i in range(count)]
        solved = [[_solves(own.rows(list(rows))) for rows in sets] for sets in (halves, folds)]
        left_out = report.result.left_out
        inside: NDArray[np.bool_] = np.all(np.abs(left_out.displacement) <= left_out.half_widths(), axis=1)
        yield (
            f"| `{name}` | {values[0]:.3f}, {values[1]:.3f} | {values[0] / values[1]:.2f} | {apart:.3f} |"
            f" {sum(solved[0])} of {len(halves)} | {sum(solved[1])} of {count} | {inside.sum()} of {len(inside)} |"
        )


def _solves(data: Recording) -> bool:
    try:
        calibrated(data)
    except CalibrationError as error:
        print(error)
        return False
    return True


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True)
    for line in lines(parser.parse_args().data):
        print(line, flush=True)


if __name__ == "__main__":
    main()
