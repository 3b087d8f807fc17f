"""The static mode: one exposure from a given pose, its images and its profile."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import sensor_rt
from orchestrator.cell.nominal import Lamp, NominalCell, nominal_cell
from orchestrator.config.loading import Setup, require_sensor_words
from orchestrator.config.scan import Engine
from orchestrator.config.units import si_value
from orchestrator.errors import SensorError
from orchestrator.evaluation.images import FrameFiles, draw_stripes
from orchestrator.evaluation.request import ScanReport
from orchestrator.evaluation.run_folder import RunFolder, run_into
from orchestrator.evaluation.stopwatch import Stopwatch
from orchestrator.geometry import pose
from orchestrator.geometry.mesh import load_mesh
from orchestrator.scanning.exposures import build_scene, still_exposure, visible_bodies
from orchestrator.scanning.sense import Sensors, make_sensors

# The arm is left out: the pose is given without it.
_BODIES = frozenset({"part", "table", "table_base"})


@dataclass(frozen=True)
class ShotRequest:
    """What a person asks for; `pose` is part_from_sensor as x, y, z in mm and XYZ' angles in degrees."""

    part: Path
    unit: str
    setup: Setup
    pose: Sequence[float]
    engine: Engine
    seed: int
    threads: int
    command_line: Sequence[str]
    as_built: Sequence[str] = ()


def shoot_to_folder(request: ShotRequest, out: Path) -> ScanReport:
    """Expose once; leave ``profile.csv`` and, ray-traced, the camera images in `out`.

    Raises
    ------
    ScancellError
        With a message for people, whatever is wrong.
    """
    require_sensor_words(request.as_built, "a shot is taken from a pose, the robot takes no part in it")

    def work(folder: RunFolder, watch: Stopwatch) -> ScanReport:
        with watch.measure("load"):
            nominal = nominal_cell(request.setup.cell, load_mesh(request.part, request.unit))
            sensors = make_sensors(request.setup.sensor, request.as_built, request.seed)
        position, angles = np.asarray(request.pose[:3]) * 1e-3, np.radians(request.pose[3:])
        part_from_sensor = pose.from_euler_xyz(position, angles)
        with watch.measure("sense"):
            result = _expose(nominal, sensors, part_from_sensor, request)
            profiles = result.profiles
        with watch.measure("write"):
            points = np.asarray(profiles.points_in_sensor)
            _write_profile(folder.path("profile.csv"), profiles, pose.transform_points(part_from_sensor, points))
            _write_images(result, sensors.believed, folder)
        by_camera = _count(np.asarray(profiles.camera), len(sensors.believed.cameras))
        lines = [f"{request.part.name}: {len(points)} points", f"  results    {out}"]
        warnings = [] if len(points) else ["the sensor sees nothing from this pose"]
        return ScanReport({"points": len(points), "by_camera": by_camera}, lines, warnings)

    return run_into(out, work)


def _expose(
    nominal: NominalCell, sensors: Sensors, part_from_sensor: NDArray[np.float64], request: ShotRequest
) -> sensor_rt.ScanResult:
    bodies = tuple(body for body in visible_bodies(nominal) if isinstance(body, Lamp) or body.name in _BODIES)
    frames = nominal.frame_poses(nominal.home, np.array(0.0))
    exposure = still_exposure(
        frames["part"] @ part_from_sensor,
        np.stack([frames[body.moves_with] for body in bodies]),
        si_value(request.setup.sensor.detector, "exposure_ms"),
    )
    try:
        scene = build_scene(bodies)
        return sensor_rt.scan(
            scene, sensors.believed, exposure, request.engine, request.threads, True, as_built=sensors.as_built
        )
    except (ValueError, RuntimeError) as error:
        raise SensorError(str(error)) from error


def _write_profile(path: Path, profiles: Any, points_in_part: NDArray[np.float64]) -> None:
    """Columns in millimetres, pixels and digital numbers."""
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        header = "camera column_px row_px x_sensor_mm y_sensor_mm z_sensor_mm x_part_mm y_part_mm z_part_mm sigma_mm"
        writer.writerow([*header.split(), "intensity_dn"])
        rows = zip(
            profiles.camera,
            profiles.column,
            profiles.row,
            np.asarray(profiles.points_in_sensor) * 1e3,
            points_in_part * 1e3,
            np.asarray(profiles.sigma) * 1e3,
            profiles.intensity,
            strict=True,
        )
        for camera, column, row, in_sensor, in_part, sigma, intensity in rows:
            numbers = [row, *in_sensor, *in_part, sigma, intensity]
            writer.writerow([int(camera), int(column), *(f"{value:.6f}" for value in numbers)])


def _write_images(result: sensor_rt.ScanResult, sensor: sensor_rt.Sensor, folder: RunFolder) -> None:
    if result.images is None:
        return
    files, unlit = FrameFiles(folder, "", sensor), None if result.unlit is None else result.unlit[0]
    files.add("image", result.images[0])
    if unlit is not None:
        files.add("image", unlit, "off", "laser_off")
    files.finish()
    draw_stripes(result.images[0], sensor, folder.path("stripes.png"), "shot", unlit)


def _count(camera: NDArray[np.int32], cameras: int) -> list[int]:
    return [int((camera == k).sum()) for k in range(cameras)]
