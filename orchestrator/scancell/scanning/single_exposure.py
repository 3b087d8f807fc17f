"""One exposure: of the running cell, or of the whole cell at rest from a given pose of the sensor."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.cell.recording import Recording
from scancell.config.choices import Engine
from scancell.config.units import si_value
from scancell.geometry import pose
from scancell.planning.model import PlanningCell, SensorRange
from scancell.planning.views.placement import PlacedPose, Placer
from scancell.reconstruction.reconstruct import ProfilePoints
from scancell.scanning.exposures import exposures_from_truth, readout_time, still_exposure
from scancell.scanning.pipeline import Job, LoadedCell
from scancell.scanning.sense import ExposureImages, Sensors, expose, points_of
from scancell.values import Value

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class Profile(Value):
    """The profile of one instant.

    Attributes
    ----------
    profile
        Points in the sensor frame with camera, column, sigma and intensity.
    rows
        (m,) image rows of the points, px.
    points_in_base, points_in_part
        (m, 3) the same points by measured joints and nominal or estimated geometry, m.
    images
        Camera images, ray-traced engine only.

    Examples
    --------
    >>> with scancell.Scanner() as scanner, scanner.session("part.stl") as session:
    ...     profile = session.profile("geometric")
    >>> profile.points_in_part.shape == profile.points_in_base.shape
    True
    """

    profile: ProfilePoints
    rows: Array
    points_in_base: Array
    points_in_part: Array
    images: ExposureImages | None


def measure_profile(
    loaded: LoadedCell, recording: Recording, sensors: Sensors, engine: Engine, threads: int
) -> Profile:
    """The profile of a recording of one exposure.

    Raises `SensorError` if the sensor library reports an error.
    """
    cell = loaded.estimated
    measured = recording.measured.after(cell.trigger_latency)
    truth = recording.truth_for_rows(readout_time(sensors.true))
    exposures = exposures_from_truth(truth, measured.index, loaded.bodies)
    result = expose(loaded.scene, sensors, exposures, engine, threads, images=True)
    profile = points_of(result.profiles, sensors.nominal, engine)
    points = np.array(profile.points_in_sensor, float)
    base_from_world = pose.inverse(cell.arm.world_from_base)
    return Profile(
        replace(profile, frame=np.zeros(len(points), np.int32)),
        np.array(result.profiles.row),
        pose.transform_points(base_from_world @ cell.world_from_sensor(measured.q[0]), points),
        pose.transform_points(cell.part_from_sensor(measured.q[0], measured.table[0]), points),
        ExposureImages.of(result, 0, int(measured.index[0]), sensors.bit_depth),
    )


@dataclass(frozen=True, eq=False, repr=False)
class ShotData(Value):
    """Measurements of one exposure from a given pose; see `ShotResult` for the attributes."""

    part: str
    profile: ProfilePoints
    rows: Array
    points_in_part: Array
    images: ExposureImages | None
    sensor: sensor_rt.Sensor
    warnings: tuple[str, ...]


def take_shot(job: Job, part_from_sensor: Array, engine: Engine, threads: int) -> ShotData:
    """The exposure from a pose (4, 4), see `Scanner.shot`.

    Raises `SensorError` if the sensor library reports an error.
    """
    loaded, sensors = job.loaded, job.sensors
    cell = PlanningCell(loaded.nominal, SensorRange.of(sensors.nominal), 1.0, threads=threads)
    exposure, warnings = _posture(cell, job, part_from_sensor)
    result = expose(loaded.scene, sensors, exposure, engine, threads, images=True)
    images = ExposureImages.of(result, 0, trigger=1)
    profile = points_of(result.profiles, sensors.nominal, engine)
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
