"""The world of a scan: a part in the cell with its sensors, as it is known, and as it is."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.cell.fmu_file import cell_json
from scancell.cell.recording import Recording
from scancell.config.choices import Engine
from scancell.config.exposure_times import exposure_windows
from scancell.config.loading import Setup, as_built_sensor
from scancell.config.sensor import SensorDescription, read_out, sensor_json
from scancell.errors import DescriptionError, SensorError
from scancell.geometry.shapes import PartSurface
from scancell.nominal.cell import Body, Lamp, NominalCell
from scancell.nominal.estimated import as_estimated
from scancell.progress import Progress
from scancell.scanning.exposure_control import AutomaticExposure, ExposureControl, SameExposures
from scancell.scanning.exposures import build_scene, exposures_from_truth, readout_time, still_exposures, sub_indices
from scancell.scanning.sense import OnImages, SensedProfiles, expose

Array = NDArray[np.float64]

# Exposures per call: enough to use all cores, few enough for responsive interrupts and progress.
_BATCH = 64


def make_sensor(description: SensorDescription, seed: int) -> sensor_rt.Sensor:
    """Native sensor model of a description.

    Raises `SensorError` if the library rejects the description.
    """
    try:
        return sensor_rt.Sensor(json.dumps(sensor_json(description, seed)))
    except (ValueError, RuntimeError) as error:
        raise SensorError(f"sensor '{description.name}': {error}") from error


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
    """A part in the cell, and its sensor; it can be pickled.

    Attributes
    ----------
    nominal, true
        The nominal cell, and the one with the obstacles that planning and reconstruction do not know.
    bodies, scene
        What light can meet, in the order of the ray-tracing scene.
    part_surface
        The surface of the part, prepared for distance queries.
    as_built
        Perturbations of cell and sensor as ``key=value`` words.
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
    scene: sensor_rt.Scene = field(compare=False)
    part_surface: PartSurface = field(compare=False)
    as_built: tuple[str, ...] = ()
    seed: int = 0
    part_file: Path | None = None
    unit: str = "mm"
    recording_file: Path | None = None
    estimated_sensor: SensorDescription | None = None

    def __getstate__(self) -> dict[str, Any]:
        return {one.name: getattr(self, one.name) for one in fields(self) if one.name != "scene"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state, scene=build_scene(state["bodies"]))

    @cached_property
    def estimated(self) -> NominalCell:
        """The nominal cell with what calibration found, which reconstruction assumes."""
        return as_estimated(self.nominal, self.setup.cell)

    @cached_property
    def sensor(self) -> sensor_rt.Sensor:
        """The nominal or calibrated sensor, which interprets the images.

        Raises `DescriptionError` if the images of the calibrated sensor are of other sizes; `SensorError` if the
        library rejects the description.
        """
        nominal, estimated = self.setup.sensor, self.estimated_sensor
        if estimated is not None:
            _require_same_images(nominal, estimated)
        return make_sensor(estimated or nominal, self.seed)

    @cached_property
    def sensor_true(self) -> sensor_rt.Sensor:
        """The sensor as built, which makes the images; the object `sensor` if they are equal. Errors as of `sensor`."""
        true = self.sensor_true_description
        same = true is self.setup.sensor and self.estimated_sensor is None
        return self.sensor if same else make_sensor(true, self.seed)

    @cached_property
    def sensor_true_description(self) -> SensorDescription:
        """Description of the sensor as built, which chooses its exposures.

        Raises `DescriptionError` if a perturbation is invalid.
        """
        return as_built_sensor(self.setup.sensor, self.as_built)

    @property
    def part(self) -> str:
        """Name of the part: its file, or the name of its mesh."""
        return self.part_file.name if self.part_file else self.nominal.part.source

    def for_fmu(self, collision_outputs: bool = False) -> dict[str, Any]:
        """The cell as the FMU reads it; collision outputs cost most of a run, and no scan reads them."""
        return cell_json(self.setup.cell, self.true, self.seed, collision_outputs=collision_outputs)

    @property
    def windows(self) -> Array:
        """Middle (s after that of all) and duration (s) of the exposures of a profile (k, 2); of automatic ones, of the
        first."""
        return exposure_windows(self.sensor_true_description)

    def control(self) -> ExposureControl:
        """A new choice of the exposure times of the profiles of a recording."""
        described = self.sensor_true_description
        if described.exposure.mode == "automatic":
            return AutomaticExposure(described)
        as_recorded = np.array_equal(self.windows, exposure_windows(self.setup.sensor))
        return SameExposures(None if as_recorded and described.exposure.mode == "fixed" else self.windows)

    def sense(
        self,
        recording: Recording,
        engine: Engine,
        progress: Progress,
        *,
        on_images: OnImages | None = None,
        kept: Collection[int] = (),
        control: ExposureControl | None = None,
        threads: int = 0,
    ) -> SensedProfiles:
        """Profiles of a recording, with the images of those in the rows `kept`; no images with the geometric engine.

        Raises `SensorError` if the library reports an error.

        Parameters
        ----------
        on_images
            Called with the images of each profile, in order.
        control
            Chooses the exposure times. Recordings of one scan that are sensed one after another share it; by default a
            new one.
        """
        control, kept = control or self.control(), () if engine == "geometric" else kept
        progress.stage("sensing", len(recording), "profiles")

        def sensed() -> Iterator[SensedProfiles]:
            for batch, wanted in _batches(len(recording), kept, on_images is not None):
                first = batch.start
                while first < batch.stop:
                    rows = recording[first : batch.stop]
                    some = self.expose(rows, engine, control=control, images=wanted, threads=threads)
                    if on_images is not None:
                        for images in some.images:
                            on_images(images)
                    chosen = [images for row, images in enumerate(some.images, first) if row in kept]
                    yield replace(some, images=tuple(chosen))
                    progress.advance(some.count)
                    first += some.count

        return SensedProfiles.joined(sensed())

    def expose(
        self,
        recording: Recording,
        engine: Engine,
        *,
        control: ExposureControl | None = None,
        images: bool = False,
        threads: int = 0,
    ) -> SensedProfiles:
        """The first profiles of a recording: as many as `control` knows the exposure times of; see `sense`."""
        control = control or self.control()
        windows = control.next(len(recording))
        windows = recording.windows if windows is None else windows
        recording, detector = recording[: len(windows)], self.sensor_true_description.detector
        index = recording.measured.index
        truth = recording.truth_for_rows(readout_time(self.sensor_true), windows)
        exposures = exposures_from_truth(truth, sub_indices(index, windows.shape[1]), self.bodies)
        found = self._expose(exposures, index, windows[0], engine, images or control.looks, threads)
        if control.looks:
            control.learn(found.signals(detector.black_level_dn))
        return found if images else replace(found, images=())

    def expose_at_rest(
        self,
        frames: Mapping[str, Array],
        index: NDArray[np.int64],
        windows: Array,
        engine: Engine,
        *,
        images: bool = False,
        threads: int = 0,
    ) -> SensedProfiles:
        """Profiles (n,) of trigger indices `index` with the frames at poses (n, 4, 4), each of exposures (k, 2).

        `windows` are as the property. Raises `SensorError` if the library reports an error.
        """
        exposures = still_exposures(frames, self.bodies, index, windows[:, 1])
        return self._expose(exposures, index, windows, engine, images, threads)

    def _expose(
        self,
        exposures: sensor_rt.Exposures,
        index: NDArray[np.int64],
        windows: Array,
        engine: Engine,
        images: bool,
        threads: int,
    ) -> SensedProfiles:
        depth = self.sensor_true_description.detector.bit_depth if images else None
        sensors = self.sensor, self.sensor_true
        return expose(
            self.scene, *sensors, exposures, index, engine, offsets=windows[:, 0], bit_depth=depth, threads=threads
        )


def _batches(count: int, kept: Collection[int], all_images: bool) -> Iterator[tuple[slice, bool]]:
    """Batches of exposures and whether to keep their images; without `all_images` each row `kept` is one by itself."""
    start = 0
    for stop, single in [*((row, True) for row in (() if all_images else sorted(kept))), (count, False)]:
        for first in range(start, stop, _BATCH):
            yield slice(first, min(first + _BATCH, stop)), all_images
        if single:
            yield slice(stop, stop + 1), True
        start = stop + single
