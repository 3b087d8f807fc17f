"""A running cell with its sensor: commands to the controller, and profiles at any time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scancell.cell.instance import CellInstance
from scancell.cell.session import CellSession
from scancell.config.choices import Engine
from scancell.config.loading import Setup
from scancell.config.units import si_value
from scancell.geometry import pose
from scancell.progress import NullProgress
from scancell.reconstruction.reconstruct import ProfilePoints
from scancell.scanning.pipeline import LoadedCell, ScanPipeline
from scancell.scanning.sense import ExposureImages, Sensors

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ProfileResult:
    """The profile of one instant.

    Attributes
    ----------
    profile
        Points in the sensor frame with camera, column, sigma and intensity.
    points_in_base, points_in_part
        (m, 3) the same points by measured joints and nominal geometry, m.
    images
        Camera images, ray-traced engine only.
    """

    profile: ProfilePoints
    points_in_base: Array
    points_in_part: Array
    images: ExposureImages | None


class ScanSession(CellSession):
    """A `CellSession` that also measures."""

    def __init__(
        self, instance: CellInstance, loaded: LoadedCell, setup: Setup, sensors: Sensors, pipeline: ScanPipeline
    ) -> None:
        super().__init__(instance, loaded.nominal, setup.cell.world.controller_cycle_us)
        self._loaded, self._setup, self._sensors, self._pipeline = loaded, setup, sensors, pipeline

    def profile(self, engine: Engine = "ray-traced") -> ProfileResult:
        """What the sensor measures now; the cell is not stepped, and may be moving.

        Raises
        ------
        SensorError
            If the sensor library reports an error.
        """
        recording = self.snapshot(si_value(self._setup.sensor.detector, "exposure_ms"))
        kept: list[ExposureImages] = []
        result = self._pipeline.sense(self._loaded, recording, self._sensors, engine, NullProgress(), kept.append)
        nominal, measured = self._loaded.nominal, recording.measured
        points = np.asarray(result.profiles.points_in_sensor, float)
        base_from_world = pose.inverse(nominal.arm.world_from_base)
        return ProfileResult(
            result.profiles,
            pose.transform_points(base_from_world @ nominal.world_from_sensor(measured.q[0]), points),
            pose.transform_points(nominal.part_from_sensor(measured.q[0], measured.table[0]), points),
            kept[0] if kept else None,
        )
