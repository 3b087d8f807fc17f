"""Sensing: from recorded exposures to profiles by rendering, peak extraction and triangulation, in batches."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.cell.recording import Recording
from scancell.config.choices import Engine
from scancell.config.loading import as_built_sensor
from scancell.config.sensor import SensorDescription, sensor_json
from scancell.errors import DescriptionError, SensorError
from scancell.nominal.cell import Body, Lamp
from scancell.progress import Progress
from scancell.reconstruction.reconstruct import ProfilePoints
from scancell.scanning.exposures import exposures_from_truth, readout_time
from scancell.values import Value

# Exposures per call: enough to use all cores, few enough for responsive interrupts and progress.
_BATCH = 64


@dataclass(frozen=True, eq=False, repr=False)
class ExposureImages(Value):
    """Camera images of one exposure.

    Attributes
    ----------
    trigger
        Index of the trigger record.
    images
        (cameras, height, width) digital numbers.
    background
        Laser-off images of the same shape to subtract; None unless the sensor takes them.
    bit_depth
        Bit depth of the digital numbers.

    Examples
    --------
    >>> shot = scancell.shot("part.stl", scancell.location(0, 0, 0.1, rx=180 * scancell.deg))
    >>> shot.images
    ExposureImages(trigger=1, images=<uint16 (2, 1024, 1280)>, background=None, bit_depth=...)
    """

    trigger: int
    images: NDArray[np.uint16]
    background: NDArray[np.uint16] | None
    bit_depth: int = 16

    @property
    def pixel_type(self) -> type[np.uint8] | type[np.uint16]:
        """The smallest integer type that holds the digital numbers."""
        return np.uint8 if self.bit_depth <= 8 else np.uint16

    @classmethod
    def of(cls, result: sensor_rt.ScanResult, row: int, trigger: int, bit_depth: int = 16) -> Self | None:
        """Images of row `row` of a result, of which `trigger` and `bit_depth` are known; None where it keeps none."""
        if result.images is None:
            return None
        background = None if result.background is None else result.background[row]
        return cls(trigger, result.images[row], background, bit_depth)


OnImages = Callable[[ExposureImages], None]


@dataclass(frozen=True)
class SensingResult:
    """Points of all exposures in the sensor frame, and processor time (s) by step of the ray tracer."""

    profiles: ProfilePoints
    timings: dict[str, float]

    @classmethod
    def joined(cls, parts: Sequence[SensingResult], exposures: Sequence[int]) -> Self:
        """Of recordings that follow one another, with the number of exposures of each."""
        first = np.cumsum([0, *exposures])[:-1]
        shifted = (
            replace(part.profiles, frame=(part.profiles.frame + row).astype(np.int32))
            for part, row in zip(parts, first, strict=True)
        )
        timings: Counter[str] = Counter()
        for part in parts:
            timings.update(part.timings)
        return cls(ProfilePoints.concatenate(shifted), dict(timings))


@dataclass(frozen=True)
class Sensors:
    """Sensor models: `nominal` (or calibrated) interprets the images, `true` renders them; one object if equal."""

    nominal: sensor_rt.Sensor
    true: sensor_rt.Sensor
    bit_depth: int = 16


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
    return Sensors(interpreting, interpreting if same else make_sensor(true, seed), true.detector.bit_depth)


def _require_same_images(nominal: SensorDescription, estimated: SensorDescription) -> None:
    sizes, expected = ([f"{one.width_px} x {one.height_px}" for one in each.camera] for each in (estimated, nominal))
    if sizes != expected:
        raise DescriptionError(
            f"cameras of {', '.join(sizes)} px cannot interpret the images of '{nominal.name}'",
            key="estimated_sensor",
            value=estimated.name,
            expected=f"{', '.join(expected)} px",
        )


@dataclass(frozen=True)
class Sensing:
    """Inputs of sensing: recording, bodies in the order of the scene, scene, sensors, engine and threads (0: all)."""

    recording: Recording
    bodies: tuple[Body | Lamp, ...]
    scene: sensor_rt.Scene
    sensors: Sensors
    engine: Engine = "ray-traced"
    threads: int = 0


def sense(
    task: Sensing, progress: Progress, on_images: OnImages | None = None, image_rows: Collection[int] | None = None
) -> SensingResult:
    """Profiles of all exposures; `frame` is the row of the recording.

    Raises `SensorError` if the library reports an error.

    Parameters
    ----------
    on_images
        Called with the camera images of each exposure, in order; never with the geometric engine.
    image_rows
        Rows of the recording whose images are passed on; None for all.
    """
    timings: Counter[str] = Counter()
    progress.stage("sensing", len(task.recording), "profiles")
    profiles = ProfilePoints.concatenate(_sensed(task, progress, timings, on_images, image_rows))
    # The library numbers exposures by trigger index, which selects their noise; reconstruction by row.
    frame = np.searchsorted(task.recording.measured.index, profiles.frame).astype(np.int32)
    return SensingResult(replace(profiles, frame=frame), dict(timings))


def expose(
    scene: sensor_rt.Scene,
    sensors: Sensors,
    exposures: sensor_rt.Exposures,
    engine: Engine,
    threads: int,
    images: bool,
) -> sensor_rt.ScanResult:
    """Measurements of exposures, with their images if requested and rendered by the engine.

    Raises `SensorError` if the library reports an error.
    """
    try:
        keep = images and engine == "ray-traced"
        return sensor_rt.scan(scene, sensors.nominal, exposures, engine, threads, keep, as_built=sensors.true)
    except (ValueError, RuntimeError) as error:
        raise SensorError(str(error)) from error


def _sensed(
    task: Sensing,
    progress: Progress,
    timings: Counter[str],
    on_images: OnImages | None,
    image_rows: Collection[int] | None,
) -> Iterator[ProfilePoints]:
    """Points of successive batches of exposures; adds the processor time of each to `timings`."""
    recording, sensors = task.recording, task.sensors
    truth, index = recording.truth_for_rows(readout_time(sensors.true)), recording.measured.index
    if task.engine == "geometric":
        on_images = None
    for rows, keep in _batches(len(recording), None if on_images is None else image_rows, on_images is not None):
        exposures = exposures_from_truth(truth, index, task.bodies, rows)
        result = expose(task.scene, sensors, exposures, task.engine, task.threads, keep)
        for i, trigger in enumerate(index[rows]):
            images = ExposureImages.of(result, i, int(trigger), sensors.bit_depth)
            if on_images is not None and images is not None:
                on_images(images)
        yield points_of(result.profiles, sensors.nominal, task.engine)
        timings.update(result.timings)
        progress.advance(rows.stop - rows.start)


def _batches(count: int, image_rows: Collection[int] | None, images: bool) -> Iterator[tuple[slice, bool]]:
    """Batches of exposures and whether to keep their images; each of `image_rows` is a batch by itself."""
    singles = sorted(image_rows) if image_rows is not None else []
    start = 0
    for stop, single in [*((row, True) for row in singles), (count, False)]:
        for first in range(start, stop, _BATCH):
            yield slice(first, min(first + _BATCH, stop)), images and image_rows is None
        if single:
            yield slice(stop, stop + 1), images
        start = stop + single


def points_of(profiles: sensor_rt.Profiles, sensor: sensor_rt.Sensor, engine: Engine) -> ProfilePoints:
    """Points with the time offsets of their image rows from the latch, by the nominal `sensor`."""
    rolls = engine == "ray-traced"
    time_offset = row_time_offset(sensor, profiles.row, profiles.camera) if rolls else np.zeros(len(profiles))
    return ProfilePoints(
        points_in_sensor=profiles.points_in_sensor,
        sigma=profiles.sigma,
        intensity=profiles.intensity,
        camera=profiles.camera,
        column=profiles.column,
        frame=profiles.frame,
        flags=profiles.flags,
        time_offset=time_offset,
    )


def row_time_offset(
    sensor: sensor_rt.Sensor, row: NDArray[np.float64], camera: NDArray[np.int32]
) -> NDArray[np.float64]:
    """Time (m,) from the latch to the exposure of image rows (m,) of the cameras (m,), s; 0 of a global shutter."""
    middle = np.array([(one.height_px - 1) / 2 for one in sensor.cameras])
    return np.asarray(sensor.row_readout * (row - middle[camera]))


def sample_rows(count: int, samples: int) -> list[int]:
    """At most `samples` equally spaced rows of `count`, ascending."""
    return sorted({int(row) for row in np.linspace(0, count - 1, min(samples, count)).round()})
