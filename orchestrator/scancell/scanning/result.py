"""Data of a scan, before evaluation."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scancell.arguments import checked_arguments
from scancell.cell.recording import Recording
from scancell.config.choices import CloudFrame, Engine
from scancell.config.loading import Setup
from scancell.config.sensor import SensorDescription
from scancell.geometry import pose
from scancell.geometry.shapes import PartSurface
from scancell.nominal.cell import NominalCell
from scancell.planning.plan import Plan
from scancell.reconstruction.cloud import Cloud
from scancell.reconstruction.reconstruct import Dropped, ProfilePoints
from scancell.scanning.sense import ExposureImages, Sensors
from scancell.values import Value

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class ScanData(Value):
    """Inputs, recording and cloud of a scan; see `ScanResult` for the attributes."""

    part: str
    setup: Setup
    engine: Engine
    seed: int
    as_built: tuple[str, ...]
    nominal: NominalCell
    estimated: NominalCell
    sensors: Sensors
    plan: Plan | None
    recording: Recording
    profiles: ProfilePoints
    cloud: Cloud
    dropped: Dropped
    sample_images: tuple[ExposureImages, ...] = ()
    render_seconds: dict[str, float] = field(default_factory=dict, compare=False)
    timings: dict[str, float] = field(default_factory=dict, compare=False)
    warnings: tuple[str, ...] = ()
    fmu_token: str = ""
    part_file: Path | None = None
    recording_file: Path | None = None
    unit: str = "mm"
    threads: int = 0
    part_surface: PartSurface | None = field(default=None, compare=False)
    estimated_sensor: SensorDescription | None = None

    @property
    def segment_names(self) -> dict[int, str]:
        """Names of the segments by id; the ids as text when an existing recording was rendered."""
        if self.plan is not None:
            return self.plan.program.names
        return {int(number): str(number) for number in np.unique(self.recording.measured.segment)}

    @property
    def camera_names(self) -> list[str]:
        """Names of the cameras, by camera index."""
        return [camera.name for camera in self.sensors.nominal.cameras]

    @checked_arguments
    def frame_from_part(self, frame: CloudFrame, table_angle: float = 0.0) -> Array:
        """Estimated pose (4, 4) of the part in a frame, with the table at `table_angle` (rad).

        Raises `DescriptionError` if `frame` is not part, table, base or world.
        """
        cell = self.estimated
        match frame:
            case "part":
                return np.eye(4)
            case "table":
                return cell.table_from_part
            case "world":
                return cell.world_from_part(table_angle)
            case "base":
                return np.asarray(pose.inverse(cell.arm.world_from_base) @ cell.world_from_part(table_angle))

    @checked_arguments
    def points_in(self, frame: CloudFrame, table_angle: float = 0.0) -> Array:
        """Points (n, 3) of the cloud in a frame, m, with the table at `table_angle` rad; see `frame_from_part`."""
        return pose.transform_points(self.frame_from_part(frame, table_angle), self.cloud.points_in_part)
