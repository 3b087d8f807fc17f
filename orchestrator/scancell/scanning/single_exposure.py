"""One exposure of the whole cell at rest, from a given pose of the sensor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.config.choices import Engine
from scancell.config.units import si_value
from scancell.geometry import pose
from scancell.planning.model import PlanningCell, SensorRange
from scancell.planning.views.placement import PlacedPose, Placer
from scancell.reconstruction.reconstruct import ProfilePoints
from scancell.scanning import sense
from scancell.scanning.exposures import still_exposure
from scancell.scanning.job import Job
from scancell.scanning.sense import ExposureImages
from scancell.values import Value

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class ShotData(Value):
    """What one exposure from a given pose has measured; see `ShotResult` for the attributes."""

    part: str
    profile: ProfilePoints
    rows: Array
    points_in_part: Array
    images: ExposureImages | None
    sensor: sensor_rt.Sensor
    warnings: tuple[str, ...]


def expose(job: Job, part_from_sensor: Array, engine: Engine, threads: int) -> ShotData:
    """The exposure from a pose (4, 4), see `Scanner.shot`.

    Raises `SensorError` if the sensor library reports an error.
    """
    loaded, sensors = job.loaded, job.sensors
    cell = PlanningCell(loaded.nominal, SensorRange.of(sensors.nominal), 1.0, threads=threads)
    exposure, warnings = _posture(cell, job, part_from_sensor)
    result = sense.expose(loaded.scene, sensors, exposure, engine, threads, images=True)
    images = ExposureImages.of(result, 0, trigger=1)
    profile = sense.points_of(result.profiles, sensors.nominal, engine)
    points = pose.transform_points(part_from_sensor, np.array(profile.points_in_sensor, float))
    if not len(points):
        warnings = (*warnings, "the sensor sees nothing from this pose")
    rows = np.array(result.profiles.row, float)
    return ShotData(loaded.nominal.part.source, profile, rows, points, images, sensors.nominal, warnings)


def _posture(cell: PlanningCell, job: Job, part_from_sensor: Array) -> tuple[sensor_rt.Exposures, tuple[str, ...]]:
    """The exposure with the arm where it holds the sensor at the pose; far away where it cannot."""
    nominal = cell.nominal
    azimuth = si_value(job.setup.scan.sweep, "azimuth_deg")
    placed = Placer(cell, azimuth, 0.0).poses(part_from_sensor[None])[0]
    warnings: tuple[str, ...] = ()
    if isinstance(placed, PlacedPose):
        frames = nominal.frame_poses(placed.q, np.array(placed.table))
    else:
        frames = nominal.frame_poses(nominal.home, np.array(0.0))
        away = pose.translation((0.0, 0.0, -900.0))
        frames = {name: away @ value if _moves_with_arm(name) else value for name, value in frames.items()}
        warnings = (f"the arm is left out: {placed.reason}",)
    world_from_body = np.stack([frames[body.moves_with] for body in job.loaded.bodies])
    duration = si_value(job.setup.sensor.detector, "exposure_ms")
    return still_exposure(frames["part"] @ part_from_sensor, world_from_body, duration), warnings


def _moves_with_arm(frame: str) -> bool:
    return frame.startswith(("link[", "finger[", "sensor"))
