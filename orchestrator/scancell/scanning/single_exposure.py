"""One exposure: of the running cell, or of the whole cell at rest from a given pose of the sensor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scancell.cell.recording import Recording
from scancell.config.description import Engine, si_value
from scancell.geometry import pose
from scancell.planning.model import PlanningCell, SensorRange
from scancell.planning.views.placement import PlacedPose, Placer
from scancell.reconstruction.reconstruct import ProfilePoints
from scancell.scanning.pipeline import measured_motion
from scancell.scanning.sense import ExposureImages, SensedProfiles
from scancell.scanning.world import ExposureControl, World
from scancell.values import Value

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class Profile(Value):
    """The profile of one instant, or of one exposure from a given pose.

    Attributes
    ----------
    profile
        Points in the sensor frame with camera, column, sigma and intensity.
    rows
        (m,) image rows of the points, px.
    points_in_base, points_in_part
        (m, 3) the same points by measured joints and nominal or estimated geometry, or by the given pose, m.
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
    """The profile of a recording of one profile; `control` is that of `World.sense`.

    Raises `SensorError` if the sensor library reports an error.
    """
    cell = world.estimated
    measured = measured_motion(cell, recording)
    part_from_sensor = cell.part_from_sensor(measured.axes[0])
    sensed = world.expose(recording, engine, control=control, images=True, threads=threads)
    base_from_world = pose.inverse(cell.arm.world_from_base)
    return _profile(sensed, base_from_world @ cell.world_from_sensor(measured.q[0]), part_from_sensor)


def take_shot(world: World, part_from_sensor: Array, engine: Engine, threads: int) -> tuple[Profile, tuple[str, ...]]:
    """The exposure from a pose (4, 4), see `Scanner.shot`, and warnings.

    Raises `SensorError` if the sensor library reports an error.
    """
    frames, warnings = _posture(world, part_from_sensor, threads)
    index = np.array([1])
    sensed = world.expose_at_rest(frames, index, world.windows, engine, images=True, threads=threads)
    base_from_world = pose.inverse(world.nominal.arm.world_from_base)
    shot = _profile(sensed, base_from_world @ frames["sensor"][0], part_from_sensor)
    if not len(shot.points_in_part):
        warnings = (*warnings, "the sensor sees nothing from this pose")
    return shot, warnings


def _profile(sensed: SensedProfiles, base_from_sensor: Array, part_from_sensor: Array) -> Profile:
    """One profile that was sensed at poses (4, 4) of the sensor."""
    assert sensed.row is not None
    points = np.array(sensed.points.points_in_sensor, float)
    in_base, in_part = (pose.transform_points(one, points) for one in (base_from_sensor, part_from_sensor))
    return Profile(sensed.points, sensed.row, in_base, in_part, next(iter(sensed.images), None))


def _posture(world: World, part_from_sensor: Array, threads: int) -> tuple[dict[str, Array], tuple[str, ...]]:
    """Poses (1, 4, 4) of the frames with the arm where it holds the sensor at the pose; far away where it cannot."""
    nominal = world.nominal
    cell = PlanningCell(nominal, SensorRange.of(world.sensor), 1.0, threads=threads)
    azimuth = si_value(world.setup.scan.sweep, "azimuth_deg")
    placed = Placer(cell, azimuth, 0.0).poses(part_from_sensor[None])[0]
    warnings: tuple[str, ...] = ()
    if isinstance(placed, PlacedPose):
        frames = nominal.frame_poses(placed.axes)
    else:
        frames = nominal.frame_poses(nominal.home)
        away = pose.translation((0.0, 0.0, -900.0))
        frames = {name: away @ value if _moves_with_arm(name) else value for name, value in frames.items()}
        warnings = (f"the arm is left out: {placed.reason}",)
    frames = {**frames, "sensor": frames["part"] @ part_from_sensor}
    return {name: value[None] for name, value in frames.items()}, warnings


def _moves_with_arm(frame: str) -> bool:
    return frame.startswith(("link[", "finger[", "sensor"))
