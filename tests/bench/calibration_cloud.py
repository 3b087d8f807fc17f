"""Clouds of a misaligned cell before and after calibration: ``PYTHONPATH=tests python -m bench.calibration_cloud``.

The cell is calibrated in the simulator with several seeds of noise. One scan of a part is reconstructed with what each
calibration found, and with the true deviations; the difference is compared with what the covariance predicts.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import scancell
from scancell import sensor as sensor_rt
from scancell.calibration.cell.problem import CalibrationResult
from scancell.calibration.cell.scan import CalibrationRequest, kinematics_of, readings_of
from scancell.config.loading import assets_dir
from scancell.geometry import pose
from scancell.nominal.cell import estimated_cell
from scancell.reconstruction.reconstruct import points_in_part
from scancell.results import ScanResult

Array = NDArray[np.float64]

PART = assets_dir() / "parts" / "free_form.stl"
# 1 mm and 0.5 deg of the tool, 0.5 mm eccentricity, 0.2 deg tilt of the table axis, 2 ms latency.
AS_BUILT = {
    "tool.x_mm": 0.6,
    "tool.y_mm": -0.6,
    "tool.z_mm": 0.53,
    "tool.rx_deg": 0.3,
    "tool.ry_deg": 0.3,
    "tool.rz_deg": 0.265,
    "platter.x_mm": 0.4,
    "platter.y_mm": 0.3,
    "table.rx_deg": 0.16,
    "table.ry_deg": 0.12,
    "trigger.latency_ms": 2.0,
}
ENCODER_NOISE = {f"cell.robot.joint[{joint}].encoder_noise_deg": 0.003 for joint in range(1, 7)}
_ON_PART = 1e-3  # m
_THINNING = 20  # points of the scan per point that is compared


@dataclass(frozen=True)
class Robot:
    """A robot, the noise model of its calibration, and a name for people."""

    name: str
    settings: dict[str, float]
    noise: str


ROBOTS = (Robot("perfect", {}, "flange"), Robot("joint noise 0.003 deg", ENCODER_NOISE, "joints"))


@dataclass(frozen=True)
class Comparison:
    """RMS deviations, um, of clouds, and of the difference to the cloud by the true deviations."""

    before: float
    ideal: float
    after: Array
    excess: Array
    predicted: Array


class Reconstruction:
    """Points of one scan on its part, by any deviations of the cell."""

    def __init__(self, scan: ScanResult, true: dict[str, float]) -> None:
        self._scan = scan
        part = scan.nominal.part
        self._surface = sensor_rt.MeshSurface(part.vertices, part.faces)
        measured = scan.recording.measured
        self._readings = readings_of(measured)
        self._rows = np.arange(0, len(scan.profiles.frame), _THINNING)
        on_part = np.abs(self.distances(true)) < _ON_PART
        lowest = pose.transform_points(scan.nominal.table_from_part, self.points(true))[:, 2]
        self._rows = self._rows[on_part & (lowest > 0.5e-3)]

    def points(self, deviations: dict[str, float]) -> Array:
        """Points (m, 3) in the part frame."""
        cell = estimated_cell(self._scan.nominal, deviations)
        late = self._scan.recording.measured.after(cell.trigger_latency)
        poses, profiles = cell.part_from_sensor(late.axes), self._scan.profiles
        return points_in_part(profiles.points_in_sensor[self._rows], profiles.frame[self._rows], poses)

    def distances(self, deviations: dict[str, float]) -> Array:
        """Signed distance (m,) to the mesh of the part."""
        return self._surface.signed_distances(self.points(deviations))[0]

    def predicted(self, true: dict[str, float], result: CalibrationResult) -> float:
        """RMS distance from the cloud by the true deviations that the covariance lets expect."""
        nominal, frame = self._scan.nominal, self._scan.profiles.frame[self._rows]
        points = self.points(true)
        face = self._surface.signed_distances(points)[1]
        rotation = nominal.table_from_part[:3, :3]
        normal = nominal.part.normals[face] @ rotation.T
        platter = pose.transform_points(nominal.table_from_part, points)
        screws = kinematics_of(nominal).poses(self._readings, true).deviations
        wrench = np.hstack([normal, np.cross(platter, normal)])
        effect = np.column_stack([np.einsum("mi,mi->m", wrench, screws[name][frame]) for name in result.names])
        return float(np.sqrt(np.mean(np.einsum("mp,pq,mq->m", effect, result.covariance, effect))))


def compare(robot: Robot, seeds: int) -> Comparison:
    """Calibrate with each seed, and compare the clouds."""
    request = CalibrationRequest("all", robot_noise=robot.noise)
    with scancell.Scanner(settings=robot.settings) as scanner:
        reports = [scanner.calibrate(request, as_built=AS_BUILT, seed=seed) for seed in range(seeds)]
        true = {name: float(value) for name, value in (reports[0].true or {}).items()}
        scan = scanner.scan(PART, engine="geometric", as_built=AS_BUILT, seed=1000, normals=False, samples=False)
        made = Reconstruction(scan, true)
        ideal = made.distances(true)
        found = [made.distances(report.result.deviations) for report in reports]

        def rms(values: Array) -> float:
            return 1e6 * float(np.sqrt(np.mean(values**2)))

        return Comparison(
            before=rms(made.distances({})),
            ideal=rms(ideal),
            after=np.array([rms(one) for one in found]),
            excess=np.array([rms(one - ideal) for one in found]),
            predicted=np.array([1e6 * made.predicted(true, report.result) for report in reports]),
        )


def rows(seeds: int) -> Iterator[str]:
    """Lines of a table."""
    yield "| robot | before | after | ideal | excess | predicted | excess / predicted |"
    yield "|---|---|---|---|---|---|---|"
    for robot in ROBOTS:
        found = compare(robot, seeds)
        excess, predicted = (float(np.sqrt(np.mean(one**2))) for one in (found.excess, found.predicted))
        yield (
            f"| {robot.name} | {found.before:.0f} um | {np.median(found.after):.3f} um | {found.ideal:.3f} um"
            f" | {excess:.3f} um | {predicted:.3f} um | {excess / predicted:.2f} |"
        )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    for row in rows(parser.parse_args().seeds):
        print(row, flush=True)


if __name__ == "__main__":
    main()
