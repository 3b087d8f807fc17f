"""What all work of a scanner starts from: a part in the cell, with sensors and perturbations."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from scancell.config.loading import Setup
from scancell.config.sensor import SensorDescription
from scancell.scanning.drive import DriveRequest
from scancell.scanning.pipeline import LoadedCell
from scancell.scanning.sense import Sensors


@dataclass(frozen=True)
class Job:
    """A part in the cell.

    Attributes
    ----------
    as_built
        Perturbations as ``key=value`` words.
    part_file, recording_file
        Files of the part and of a recording, where these are from files.
    unit
        Of the part's file.
    estimated_sensor
        Calibrated sensor that interprets the images in place of the nominal one.
    """

    setup: Setup
    loaded: LoadedCell
    sensors: Sensors
    as_built: tuple[str, ...]
    seed: int
    part_file: Path | None
    unit: str
    recording_file: Path | None = None
    estimated_sensor: SensorDescription | None = None

    @property
    def part(self) -> str:
        """Name of the part: its file, or the name of its mesh."""
        return self.part_file.name if self.part_file else self.loaded.nominal.part.source

    def drive_request(self, collision_outputs: bool = False) -> DriveRequest:
        """The cell for the FMU; collision outputs cost most of a run."""
        description = self.loaded.for_fmu(self.seed, collision_outputs)
        return DriveRequest(self.setup, self.loaded.nominal, description, self.as_built)
