"""Sensing: from recorded exposures to profiles by rendering, peak extraction and triangulation, in batches."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.cell.recording import Recording
from scancell.config.choices import Engine
from scancell.config.sensor import DetectorDescription
from scancell.errors import SensorError
from scancell.progress import Progress
from scancell.reconstruction.reconstruct import ProfilePoints, is_saturated
from scancell.scanning.exposure_control import ExposureControl
from scancell.scanning.exposures import exposures_from_truth, readout_time, sub_indices
from scancell.scanning.world import Sensors, World
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
        (cameras, height, width) digital numbers; of several exposures of a profile, those of the first.
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
    """Points of all profiles in the sensor frame, and processor time (s) by step of the ray tracer."""

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


def sense(
    world: World,
    recording: Recording,
    engine: Engine,
    progress: Progress,
    on_images: OnImages | None = None,
    image_rows: Collection[int] | None = None,
    control: ExposureControl | None = None,
    threads: int = 0,
) -> SensingResult:
    """Profiles of a recording; `frame` is its row.

    Raises `SensorError` if the library reports an error.

    Parameters
    ----------
    on_images
        Called with the camera images of each profile, in order; never with the geometric engine.
    image_rows
        Rows of the recording whose images are passed on; None for all.
    control
        Chooses the exposure times. Recordings of one scan that are sensed one after another share it; by default a new
        one.
    """
    control = control or world.sensors.control()
    wants = on_images is not None and engine != "geometric"
    batches = _batches(len(recording), image_rows if wants else None, wants)
    timings: Counter[str] = Counter()

    def sensed() -> Iterator[ProfilePoints]:
        for batch, wanted in batches:
            first = batch.start
            while first < batch.stop:
                windows = control.next(batch.stop - first)
                rows = slice(first, batch.stop if windows is None else first + len(windows))
                taken = profiles_of(world, recording[rows], engine, windows, wanted or control.looks, threads)
                if on_images is not None and wanted:
                    for images in taken.images():
                        on_images(images)
                yield taken.points
                if control.looks:
                    control.learn(taken.signals())
                timings.update(taken.result.timings)
                progress.advance(rows.stop - rows.start)
                first = rows.stop

    progress.stage("sensing", len(recording), "profiles")
    profiles = ProfilePoints.concatenate(sensed())
    # The library numbers exposures by trigger index, which selects their noise; reconstruction by row.
    frame = np.searchsorted(recording.measured.index, profiles.frame).astype(np.int32)
    return SensingResult(replace(profiles, frame=frame), dict(timings))


def expose(
    scene: sensor_rt.Scene,
    sensors: Sensors,
    exposures: sensor_rt.Exposures,
    engine: Engine,
    threads: int,
    images: bool,
    keep_rejected: bool = False,
) -> sensor_rt.ScanResult:
    """Measurements of exposures, with their images if requested and rendered by the engine; see `scancell.sensor.scan`.

    Raises `SensorError` if the library reports an error.
    """
    try:
        keep = images and engine == "ray-traced"
        return sensor_rt.scan(scene, sensors.nominal, exposures, engine, threads, keep, sensors.true, keep_rejected)
    except (ValueError, RuntimeError) as error:
        raise SensorError(str(error)) from error


@dataclass(frozen=True)
class Taken:
    """Profiles (n,) of one call of the library: their points (`frame`: trigger index), and the image row of each, px.

    `result` holds all exposures, k for each profile one after another, with middles and durations `windows` (n, k, 2).
    """

    points: ProfilePoints
    row: NDArray[np.float64]
    result: sensor_rt.ScanResult
    windows: NDArray[np.float64]
    index: NDArray[np.int64]
    detector: DetectorDescription

    def images(self) -> Iterator[ExposureImages]:
        """Images of the first exposure of each profile; none unless they were kept."""
        for number, trigger in enumerate(self.index):
            images = ExposureImages.of(
                self.result, number * self.windows.shape[1], int(trigger), self.detector.bit_depth
            )
            if images is not None:
                yield images

    def signals(self) -> list[NDArray[np.float64]]:
        """Brightest digital number of each column of the images, by profile; without images, of the stripe."""
        if self.result.images is not None:
            return [images.images.max(1).ravel().astype(float) for images in self.images()]
        first, last = (np.searchsorted(self.points.frame, self.index, side) for side in ("left", "right"))
        heights = self.detector.black_level_dn + np.asarray(self.points.intensity, float)
        return [heights[a:b] for a, b in zip(first, last, strict=True)]


def take(
    world: World,
    exposures: sensor_rt.Exposures,
    engine: Engine,
    index: NDArray[np.int64],
    windows: NDArray[np.float64],
    images: bool,
    threads: int,
) -> Taken:
    """Profiles (n,) of the trigger indices `index`, with the images of all exposures if requested.

    Raises `SensorError` if the library reports an error.

    Parameters
    ----------
    exposures
        k of each profile, one after another, of `sub_indices`.
    windows
        (n, k, 2) times from the latch to their middles, the same for all profiles, and durations, s.
    """
    offsets = windows[0, :, 0]
    sensors = world.sensors
    several = offsets.size > 1
    result = expose(world.scene, sensors, exposures, engine, threads, images, keep_rejected=several)
    points, row = points_of(result.profiles, sensors.nominal, engine), np.asarray(result.profiles.row)
    if several:
        points, number = replace(points, frame=points.frame // offsets.size), points.frame % offsets.size
        chosen = surest(points, number)
        points, row = points[chosen], row[chosen]
        late = (points.time_offset + offsets[number[chosen]]).astype(np.float32)
        points = replace(points, time_offset=late)
    return Taken(points, row, result, windows, index, sensors.description.detector)


def surest(points: ProfilePoints, number: NDArray[np.integer[Any]]) -> NDArray[np.intp]:
    """Rows (k,) of the points, ordered by profile, camera and column, that are kept of several exposures (m,) of each.

    A column of a camera keeps the points of one exposure: of one without saturated pixels, if there is one, that with
    the peak of the smallest standard deviation. Where this peak is rejected, the column keeps no point: the noise of
    the others may hide what it shows, such as the border of a dark and a bright region.
    """
    flags = np.asarray(points.flags)
    saturated = is_saturated(flags)
    order = np.lexsort((number, points.sigma, saturated, points.column, points.camera, points.frame))
    begins = _changes(*(np.asarray(part)[order] for part in (points.frame, points.camera, points.column)))
    best = number[order[begins]][np.cumsum(begins) - 1]
    return np.asarray(order[(number[order] == best) & ((flags[order] & sensor_rt.PEAK_REJECTED) == 0)])


def _changes(*values: NDArray[Any]) -> NDArray[np.bool_]:
    """Whether any of the values (m,) differs from that before it; True for the first."""
    differs = np.ones(len(values[0]), bool)
    differs[1:] = np.any([one[1:] != one[:-1] for one in values], axis=0)
    return differs


def profiles_of(
    world: World,
    recording: Recording,
    engine: Engine,
    windows: NDArray[np.float64] | None,
    images: bool,
    threads: int,
) -> Taken:
    """Profiles of a recording, each of the exposures `windows` (n, k, 2), see `Recording.truth_for_rows`; None: of one,
    as recorded.

    Raises `SensorError` if the library reports an error.
    """
    index = recording.measured.index
    windows = recording.windows if windows is None else windows
    truth = recording.truth_for_rows(readout_time(world.sensors.true), windows)
    exposures = exposures_from_truth(truth, sub_indices(index, windows.shape[1]), world.bodies)
    return take(world, exposures, engine, index, windows, images, threads)


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
    time_offset = (
        row_time_offset(sensor, profiles.row, profiles.camera) if rolls else np.zeros(len(profiles), np.float32)
    )
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
) -> NDArray[np.float32]:
    """Time (m,) from the latch to the exposure of image rows (m,) of the cameras (m,), s; 0 of a global shutter."""
    middle = np.array([(one.height_px - 1) / 2 for one in sensor.cameras])
    return np.asarray(sensor.row_readout * (row - middle[camera]), np.float32)


def sample_rows(count: int, samples: int) -> list[int]:
    """At most `samples` equally spaced rows of `count`, ascending."""
    return sorted({int(row) for row in np.linspace(0, count - 1, min(samples, count)).round()})
