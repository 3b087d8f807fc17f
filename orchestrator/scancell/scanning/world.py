"""The world of a scan: a part in the cell with its sensors, as it is known, and as it is."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.cell.fmu_file import cell_json
from scancell.config.exposure_times import exposure_windows
from scancell.config.loading import Setup, as_built_sensor
from scancell.config.sensor import SensorDescription, read_out, sensor_json
from scancell.errors import DescriptionError, SensorError
from scancell.geometry.shapes import PartSurface
from scancell.nominal.cell import Body, Lamp, NominalCell
from scancell.nominal.estimated import as_estimated
from scancell.scanning.exposure_control import AutomaticExposure, ExposureControl, SameExposures


@dataclass(frozen=True)
class Sensors:
    """Sensor models: `nominal` (or calibrated) interprets the images, `true` renders them; one object if equal.

    `description` is that of the true sensor, which chooses its exposures; `as_recorded` says whether fixed ones are
    those of a recording.
    """

    nominal: sensor_rt.Sensor
    true: sensor_rt.Sensor
    description: SensorDescription
    as_recorded: bool = True

    @property
    def windows(self) -> NDArray[np.float64]:
        """Middle (s after that of all) and duration (s) of the exposures of a profile (k, 2); of automatic ones, of the
        first."""
        return exposure_windows(self.description)

    def control(self) -> ExposureControl:
        """A new choice of the exposure times of the profiles of a recording."""
        if self.description.exposure.mode == "automatic":
            return AutomaticExposure(self.description)
        as_recorded = self.as_recorded and self.description.exposure.mode == "fixed"
        return SameExposures(None if as_recorded else self.windows)


def make_sensor(description: SensorDescription, seed: int) -> sensor_rt.Sensor:
    """Native sensor model of a description.

    Raises `SensorError` if the library rejects the description.
    """
    try:
        return sensor_rt.Sensor(json.dumps(sensor_json(description, seed)))
    except (ValueError, RuntimeError) as error:
        raise SensorError(f"sensor '{description.name}': {error}") from error


def make_sensors(
    nominal: SensorDescription, as_built: Sequence[str], seed: int, estimated: SensorDescription | None = None
) -> Sensors:
    """Native sensor models of a nominal description and its perturbations.

    Raises `DescriptionError` if a perturbation is invalid, or the images of the calibrated sensor are of other sizes;
    `SensorError` if the library rejects a description.

    Parameters
    ----------
    as_built
        Perturbations as ``key=value`` words; those of the cell are ignored.
    estimated
        Calibrated description; interprets the images instead of `nominal`.
    """
    if estimated is not None:
        _require_same_images(nominal, estimated)
    interpreting = make_sensor(nominal if estimated is None else estimated, seed)
    true = as_built_sensor(nominal, as_built)
    same = estimated is None and true is nominal
    as_recorded = np.array_equal(exposure_windows(true), exposure_windows(nominal))
    return Sensors(interpreting, interpreting if same else make_sensor(true, seed), true, as_recorded)


def _require_same_images(nominal: SensorDescription, estimated: SensorDescription) -> None:
    sizes, expected = (
        [f"{one.width_px} x {one.height_px}" for one in read_out(each).camera] for each in (estimated, nominal)
    )
    if sizes != expected:
        raise DescriptionError(
            f"cameras of {', '.join(sizes)} px cannot interpret the images of '{nominal.name}'",
            key="estimated_sensor",
            value=estimated.name,
            expected=f"{', '.join(expected)} px",
        )


@dataclass(frozen=True, eq=False)
class World:
    """A part in the cell, and its sensors.

    Attributes
    ----------
    nominal, true
        The nominal cell, and the one with the obstacles that planning and reconstruction do not know.
    bodies, scene
        What light can meet, in the order of the ray-tracing scene.
    part_surface
        The surface of the part, prepared for distance queries.
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
    nominal: NominalCell
    true: NominalCell
    bodies: tuple[Body | Lamp, ...]
    scene: sensor_rt.Scene
    part_surface: PartSurface
    sensors: Sensors
    as_built: tuple[str, ...] = ()
    seed: int = 0
    part_file: Path | None = None
    unit: str = "mm"
    recording_file: Path | None = None
    estimated_sensor: SensorDescription | None = None

    @cached_property
    def estimated(self) -> NominalCell:
        """The nominal cell with what calibration found, which reconstruction assumes."""
        return as_estimated(self.nominal, self.setup.cell)

    @property
    def part(self) -> str:
        """Name of the part: its file, or the name of its mesh."""
        return self.part_file.name if self.part_file else self.nominal.part.source

    def for_fmu(self, collision_outputs: bool = False) -> dict[str, Any]:
        """The cell as the FMU reads it; collision outputs cost most of a run, and no scan reads them."""
        return cell_json(self.setup.cell, self.true, self.seed, collision_outputs=collision_outputs)
