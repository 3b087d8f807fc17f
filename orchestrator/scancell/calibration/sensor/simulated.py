"""Calibration of a sensor in the simulator: targets at rest before the sensor as built, images, peaks, solution."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from scancell import sensor as sensor_rt
from scancell.arrays import Array
from scancell.calibration.sensor import targets as sensor_targets
from scancell.calibration.sensor.problem import Corners, SensorProblem, StripePeaks, TargetExposure, free_parameters
from scancell.calibration.sensor.solve import SensorCalibration, solve
from scancell.calibration.sensor.targets import CheckeredBoard, start_from_corners
from scancell.config.choices import SensorTarget
from scancell.config.description import si_value
from scancell.config.loading import as_built_sensor
from scancell.config.material import PRESETS
from scancell.config.sensor import SensorDescription, read_out
from scancell.geometry import pose
from scancell.geometry.shapes import ShapeGroup
from scancell.nominal.cell import Lamp
from scancell.nominal.parts import Body
from scancell.progress import NullProgress, Progress
from scancell.scanning.world import build_scene, make_sensor

_BATCH = 8  # exposures in memory at a time
_LAMP = Lamp("lamp", "world", "disc", pose.translation((0.0, 0.0, -0.05)), (0.08, 0.08), 1.0, 1.0, None)
_BRIGHTNESS = 0.6  # of the full well, of white squares under the lamp


@dataclass(frozen=True)
class _Placed:
    """A target at its poses (n, 4, 4) in the sensor frame, as stated."""

    body: Body
    surface: ShapeGroup
    poses: Array
    board: CheckeredBoard | None = None


def calibrate_from(
    sensor: SensorDescription, exposures: Sequence[TargetExposure], also: Sequence[str] = ()
) -> SensorCalibration:
    """Calibrate a sensor from measurements, simulated or real.

    Views of a checkered board need no start for their poses and the cameras' intrinsics: `start_from_corners` finds it.

    Raises `CalibrationError` if the measurements do not determine the free parameters.

    Parameters
    ----------
    sensor
        Nominal description: the start.
    also
        Free parameters beside `free_parameters`.
    """
    views = [one for one in exposures if one.corners is not None]
    start, placed = start_from_corners(sensor, views)
    remaining = iter(placed)
    started = tuple(one if one.corners is None else next(remaining) for one in exposures)
    free = free_parameters(sensor, poses_known(exposures), checkered=bool(views))
    return solve(SensorProblem(start, started, tuple(dict.fromkeys((*free, *also)))))


def poses_known(exposures: Sequence[TargetExposure]) -> bool:
    """Whether any exposure determines the sensor frame."""
    return any(one.mounting is None for one in exposures)


def measure(
    sensor: SensorDescription,
    as_built: Sequence[str],
    targets: Sequence[SensorTarget],
    displacement_as_built: Array | None,
    seed: int,
    threads: int = 0,
    progress: Progress | None = None,
) -> tuple[TargetExposure, ...]:
    """Measurements of the targets in ray-traced images of the sensor as built.

    Raises `DescriptionError` or `SensorError` if a perturbation or a description is invalid.

    Parameters
    ----------
    sensor
        Nominal description, with which the images are extracted.
    as_built
        Perturbations as ``key=value`` words; those of ``sensor.`` count.
    targets
        ``ball``: 25 mm, at 45 places; ``step``: three treads of 4 mm rise at 25 poses; ``checkered``: a ChArUco board
        in 10 views of unknown poses, under a lamp and by the laser.
    displacement_as_built
        Mounting error (4, 4) of the stage of ball and step block, which is unknown to the solution; None: their poses
        in the sensor frame are known.
    """
    built = as_built_sensor(sensor, as_built)
    # Cameras that are not calibrated yet cannot confirm each other's peaks.
    extracting = sensor.replace({"extraction.peak": "brightest"} if sensor.extraction.peak == "agreement" else {})
    found: list[TargetExposure] = []
    reporter = progress or NullProgress()
    for name in targets:
        placed = _placed(name, sensor)
        reporter.stage(f"measuring {name}", len(placed.poses) * (1 if placed.board is None else 2), "exposures")
        away = np.eye(4) if displacement_as_built is None or placed.board else displacement_as_built
        poses = away @ placed.poses
        stripes = _stripes(built, extracting, placed.body, poses, seed, threads, reporter)
        corners = _corners(built, placed, poses, seed, threads, reporter)
        mounting = None if displacement_as_built is None else 0
        for one, stripe, seen in zip(placed.poses, stripes, corners, strict=True):
            if placed.board is None:
                found.append(TargetExposure(placed.surface, one, stripe, None, mounting))
            elif seen is not None:
                # The views of the board are held by hand: only their corners tell the pose.
                found.append(TargetExposure(placed.surface, np.eye(4), stripe, seen, 1 + len(found)))
    return tuple(found)


def range_error(as_built: SensorDescription, used: SensorDescription, align: bool) -> float:
    """RMS distance, m, between the points of a sensor as described and as built, over images and range.

    Parameters
    ----------
    align
        Move the points rigidly on one another first: the tool transform takes up where the sensor frame lies.
    """
    found, expected = [], []
    built, own = make_sensor(as_built, 0), make_sensor(used, 0)
    for camera, one in enumerate(read_out(used).camera):
        axes = [np.linspace(0.02, 0.98, 41) * (size - 1) for size in (one.width_px, one.height_px)]
        pixels = np.stack(np.meshgrid(*axes), -1).reshape(-1, 2)
        points = sensor_rt.triangulate_pixels(pixels, built, camera, "sheet")
        inside = (points[:, 2] > si_value(as_built.range, "near_mm")) & (
            points[:, 2] < si_value(as_built.range, "far_mm")
        )
        form = used.extraction.triangulation
        expected.append(points[inside])
        found.append(sensor_rt.triangulate_pixels(pixels[inside], own, camera, form))
    a, b = np.concatenate(found), np.concatenate(expected)
    if align:
        a, b = a - a.mean(0), b - b.mean(0)
        a = a @ pose.nearest_rotation(a.T @ b)
    return float(np.sqrt(np.mean(np.sum((a - b) ** 2, 1))))


def _placed(name: SensorTarget, sensor: SensorDescription) -> _Placed:
    surface = sensor_targets.surface_of(name)
    if name == "checkered":
        board = CheckeredBoard()
        return _Placed(sensor_targets.board_body(board), surface, sensor_targets.board_poses(sensor), board)
    poses = sensor_targets.ball_poses(sensor) if name == "ball" else sensor_targets.step_poses(sensor)
    return _Placed(Body("target", "part", surface.mesh(), PRESETS["matt_white"]), surface, poses)


def _stripes(
    built: SensorDescription,
    nominal: SensorDescription,
    body: Body,
    poses: Array,
    seed: int,
    threads: int,
    progress: Progress,
) -> list[StripePeaks]:
    """Peaks of every exposure with the laser on."""
    scene, true, extracting = build_scene([body]), make_sensor(built, seed), make_sensor(nominal, seed)
    found = []
    for exposures in _batches(poses[:, None], si_value(built.detector, "exposure_ms")):
        images = sensor_rt.render(scene, true, exposures, threads)
        off = sensor_rt.render(scene, true, exposures, threads, laser_on=False) if true.laser_off_frame else None
        peaks = sensor_rt.extract(images, extracting, threads, background=off)
        found += [StripePeaks.of(peaks, frame) for frame in range(len(exposures))]
        progress.advance(len(exposures))
    return found


def _corners(
    built: SensorDescription, placed: _Placed, poses: Array, seed: int, threads: int, progress: Progress
) -> list[Corners | None]:
    """Corners of the board in every view under the lamp; None without a board, and where too few are seen."""
    if placed.board is None:
        return [None] * len(poses)
    duration = si_value(built.detector, "exposure_ms")
    with_lamp = np.stack([poses, np.broadcast_to(np.eye(4), poses.shape)], 1)
    # The fast mode takes one ray per pixel of lamp light, which is enough for its amount.
    dark = make_sensor(built.replace({"render.mode": "fast", "laser.power_mw": 0.0}), seed)
    probe, *_ = _batches(with_lamp[:1], duration)
    dim = sensor_rt.expected_electrons(build_scene([placed.body, _LAMP]), dark, probe, threads=threads)
    power = _BRIGHTNESS * read_out(built).detector.full_well_e / max(float(np.quantile(dim, 0.999)), 1e-9)
    scene = build_scene([placed.body, replace(_LAMP, power=power)])
    sensor = make_sensor(built.replace({"render.mode": "path", "render.samples_per_pixel": 16}), seed)
    found = []
    # Lamp light takes seconds in each, between which progress may cancel.
    for exposures in _batches(with_lamp, duration, 1):
        images = sensor_rt.render(scene, sensor, exposures, threads, laser_on=False)
        found += [placed.board.detect(one, built.detector.bit_depth) for one in images]
        progress.advance(len(exposures))
    return found


def _batches(poses: Array, duration: float, most: int = _BATCH) -> Iterator[sensor_rt.Exposures]:
    """Exposures at rest, numbered from 1, of bodies at `poses` (n, bodies, 4, 4) in the sensor frame."""
    for first in range(0, len(poses), most):
        some = poses[first : first + most]
        count = len(some)
        still = np.broadcast_to(np.eye(4), (count, 1, 4, 4))
        index = np.arange(first + 1, first + count + 1, dtype=np.int64)
        yield sensor_rt.Exposures(still, some[:, :, None], np.full(count, duration), index)
