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
from scancell.scanning.exposure_control import ExposureControl
from scancell.scanning.exposures import still_exposures
from scancell.scanning.pipeline import measured_motion
from scancell.scanning.sense import ExposureImages, profiles_of, take
from scancell.scanning.world import World
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
    world: World,
    recording: Recording,
    engine: Engine,
    threads: int,
    control: ExposureControl | None = None,
) -> Profile:
    """The profile of a recording of one profile; `control` is that of `scancell.scanning.sense.sense`.

    Raises `SensorError` if the sensor library reports an error.
    """
    cell = world.estimated
    measured = measured_motion(cell, recording)
    part_from_sensor = cell.part_from_sensor(measured.axes[0])
    control = control or world.sensors.control()
    taken = profiles_of(world, recording, engine, control.next(1), images=True, threads=threads)
    if control.looks:
        control.learn(taken.signals())
    profile = taken.points
    points = np.array(profile.points_in_sensor, float)
    base_from_world = pose.inverse(cell.arm.world_from_base)
    return Profile(
        replace(profile, frame=np.zeros(len(points), np.int32)),
        np.array(taken.row),
        pose.transform_points(base_from_world @ cell.world_from_sensor(measured.q[0]), points),
        pose.transform_points(part_from_sensor, points),
        next(taken.images(), None),
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


def take_shot(world: World, part_from_sensor: Array, engine: Engine, threads: int) -> ShotData:
    """The exposure from a pose (4, 4), see `Scanner.shot`.

    Raises `SensorError` if the sensor library reports an error.
    """
    sensors = world.sensors
    cell = PlanningCell(world.nominal, SensorRange.of(sensors.nominal), 1.0, threads=threads)
    exposures, warnings = _posture(cell, world, part_from_sensor)
    taken = take(world, exposures, engine, np.array([1]), sensors.windows[None], images=True, threads=threads)
    profile = taken.points
    points = pose.transform_points(part_from_sensor, np.array(profile.points_in_sensor, float))
    if not len(points):
        warnings = (*warnings, "the sensor sees nothing from this pose")
    images = next(taken.images(), None)
    return ShotData(world.nominal.part.source, profile, taken.row, points, images, sensors.nominal, warnings)


def _posture(cell: PlanningCell, world: World, part_from_sensor: Array) -> tuple[sensor_rt.Exposures, tuple[str, ...]]:
    """The exposures with the arm where it holds the sensor at the pose; far away where it cannot."""
    nominal = cell.nominal
    azimuth = si_value(world.setup.scan.sweep, "azimuth_deg")
    placed = Placer(cell, azimuth, 0.0).poses(part_from_sensor[None])[0]
    warnings: tuple[str, ...] = ()
    if isinstance(placed, PlacedPose):
        frames = nominal.frame_poses([*placed.q, placed.table])
    else:
        frames = nominal.frame_poses(nominal.home)
        away = pose.translation((0.0, 0.0, -900.0))
        frames = {name: away @ value if _moves_with_arm(name) else value for name, value in frames.items()}
        warnings = (f"the arm is left out: {placed.reason}",)
    world_from_body = np.stack([frames[body.moves_with] for body in world.bodies])
    durations = world.sensors.windows[:, 1]
    return still_exposures(frames["part"] @ part_from_sensor, world_from_body, durations), warnings


def _moves_with_arm(frame: str) -> bool:
    return frame.startswith(("link[", "finger[", "sensor"))
