"""The profile of one instant."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scancell.cell.recording import Recording
from scancell.config.choices import Engine
from scancell.geometry import pose
from scancell.reconstruction.reconstruct import ProfilePoints
from scancell.scanning.exposures import exposures_from_truth, readout_time
from scancell.scanning.pipeline import LoadedCell
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
