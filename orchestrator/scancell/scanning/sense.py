"""Sensing: from exposures to profiles by rendering, peak extraction and triangulation."""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import IO, Any, Generic, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.config.choices import Engine
from scancell.errors import OutputError, SensorError
from scancell.reconstruction.reconstruct import ProfilePoints, is_saturated
from scancell.values import Value

_AT_LATCH = np.zeros(1)

T = TypeVar("T")


@dataclass(frozen=True, eq=False, repr=False)
class ExposureImages(Value):
    """Camera images of one exposure.

    Attributes
    ----------
    trigger
        Index of the trigger record.
    sensor
        Number of the sensor, from 1: that of the tool.
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
    sensor: int = 1

    @property
    def pixel_type(self) -> type[np.uint8] | type[np.uint16]:
        """The smallest integer type that holds the digital numbers."""
        return np.uint8 if self.bit_depth <= 8 else np.uint16


OnImages = Callable[[ExposureImages], None]


@dataclass(frozen=True, eq=False)
class SensedProfiles:
    """Profiles (n) of successive exposures.

    Attributes
    ----------
    points
        Points (m) in the sensor frame; `frame` counts the profiles from 0.
    count
        Number of profiles.
    timings
        Processor time by step of the ray tracer, s.
    images
        Those that were requested, of the first exposure of a profile.
    row
        (m,) image rows of the points, px; None of batches that are joined.
    covariance
        (m, 3, 3), m², where it was requested.
    """

    points: ProfilePoints
    count: int
    timings: dict[str, float]
    images: tuple[ExposureImages, ...] = ()
    row: NDArray[np.float64] | None = None
    covariance: NDArray[np.float64] | None = None

    @classmethod
    def joined(cls, batches: Iterable[Self]) -> Self:
        """The profiles of batches that follow one another; each is released before the next is taken."""
        count, images = 0, list[ExposureImages]()
        timings: Counter[str] = Counter()

        def points() -> Iterator[ProfilePoints]:
            nonlocal count
            for batch in batches:
                images.extend(batch.images)
                timings.update(batch.timings)
                yield replace(batch.points, frame=(batch.points.frame + count).astype(np.int32))
                count += batch.count

        found = ProfilePoints.concatenate(points())
        return cls(found, count, dict(timings), tuple(images))

    @classmethod
    def beside(cls, sensors: Sequence[Self]) -> Self:
        """The profiles of the same exposures by several sensors: exposure by exposure, one sensor after another."""
        points = ProfilePoints.concatenate(one.points for one in sensors)
        points = points[np.argsort(points.frame, kind="stable")]
        timings = sum((Counter(one.timings) for one in sensors), Counter[str]())
        images = tuple(images for one in sensors for images in one.images)
        return cls(points, sensors[0].count, dict(timings), images)

    def of_sensor(self, number: int) -> Self:
        """The profiles as those of a sensor by its number."""
        points = replace(self.points, sensor=np.full(len(self.points.frame), number, np.uint8))
        return replace(self, points=points, images=tuple(replace(one, sensor=number) for one in self.images))

    def signals(self, black_level: float) -> list[NDArray[np.float64]]:
        """Brightest digital number of each column of the images, by profile; without images, of the stripe."""
        if self.images:
            return [one.images.max(1).ravel().astype(float) for one in self.images]
        heights = black_level + np.asarray(self.points.intensity, float)
        ends = np.searchsorted(self.points.frame, np.arange(self.count + 1))
        return [heights[a:b] for a, b in pairwise(ends)]


def expose(
    scene: sensor_rt.Scene,
    sensor: sensor_rt.Sensor,
    sensor_true: sensor_rt.Sensor,
    exposures: sensor_rt.Exposures,
    index: NDArray[np.int64],
    engine: Engine,
    *,
    offsets: NDArray[np.float64] = _AT_LATCH,
    bit_depth: int | None = None,
    covariance: bool = False,
    threads: int = 0,
) -> SensedProfiles:
    """Profiles (n,) of a scene by `sensor` from what `sensor_true` sees; nothing else exposes.

    Raises `SensorError` if the library reports an error.

    Parameters
    ----------
    exposures
        k of each profile, one after another, of `sub_indices`.
    index
        Trigger indices (n,), ascending.
    offsets
        Times (k,) from the latch to the middles of the exposures of a profile, s.
    bit_depth
        Bit depth of the images, which are kept if the engine renders them; None keeps none.
    """
    several = offsets.size > 1
    try:
        keep = bit_depth is not None and engine == "ray-traced"
        result = sensor_rt.scan(scene, sensor, exposures, engine, threads, keep, sensor_true, several)
    except (ValueError, RuntimeError) as error:
        raise SensorError(str(error)) from error
    points, row = _points_of(result.profiles, sensor, engine), np.asarray(result.profiles.row)
    spread = np.array(result.profiles.covariance, float) if covariance else None
    if several:
        points, number = replace(points, frame=points.frame // offsets.size), points.frame % offsets.size
        chosen = surest(points, number)
        points, row, spread = points[chosen], row[chosen], None if spread is None else spread[chosen]
        late = (points.time_offset + offsets[number[chosen]]).astype(np.float32)
        points = replace(points, time_offset=late)
    elif offsets.any():
        points = replace(points, time_offset=(points.time_offset + offsets).astype(np.float32))
    # The library numbers profiles by trigger index, which selects their noise.
    points = replace(points, frame=np.searchsorted(index, points.frame).astype(np.int32))
    images = tuple(_images(result, offsets.size, index, bit_depth or 0))
    return SensedProfiles(points, len(index), dict(result.timings), images, row, spread)


def _images(
    result: sensor_rt.ScanResult, each: int, index: NDArray[np.int64], bit_depth: int
) -> Iterator[ExposureImages]:
    """Images of the first exposure of each profile, of `each`; none unless they were kept."""
    if result.images is not None:
        for row, trigger in enumerate(index):
            background = None if result.background is None else result.background[row * each]
            yield ExposureImages(int(trigger), result.images[row * each], background, bit_depth)


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


def _points_of(profiles: sensor_rt.Profiles, sensor: sensor_rt.Sensor, engine: Engine) -> ProfilePoints:
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


class StoredColumns(Generic[T]):
    """Joins dataclasses of arrays, whose rows are points, in temporary files that vanish with the arrays.

    Parameters
    ----------
    kind
        The dataclass.
    """

    def __init__(self, kind: type[T]) -> None:
        self._kind = kind
        self._files: dict[str, IO[bytes]] = {}
        self._shapes: dict[str, tuple[np.dtype[Any], tuple[int, ...]]] = {}

    def append(self, part: T) -> None:
        """Append rows.

        Raises
        ------
        OutputError
            If they cannot be written.
        """
        try:
            self._append(part)
        except OSError as error:
            raise OutputError(
                f"points of the scan cannot be stored: {error.strerror or error}", file=tempfile.gettempdir()
            ) from error

    def _append(self, part: T) -> None:
        for field in fields(self._kind):  # type: ignore[arg-type]
            values = np.ascontiguousarray(getattr(part, field.name))
            if field.name not in self._files:
                self._files[field.name] = tempfile.TemporaryFile(prefix="scancell-")  # noqa: SIM115
                self._shapes[field.name] = values.dtype, values.shape[1:]
            self._files[field.name].write(values.data)

    def joined(self) -> T:
        """All rows, read from the files where they are used; nothing may be appended afterwards."""
        return self._kind(**{name: self._column(name) for name in self._files})

    def _column(self, name: str) -> np.ndarray[Any, Any]:
        file, (dtype, shape) = self._files[name], self._shapes[name]
        file.flush()
        size = dtype.itemsize * int(np.prod(shape))
        rows = file.tell() // size
        if rows == 0:  # nothing to map
            return np.zeros((0, *shape), dtype)
        # Private: what is changed is not written.
        return np.asarray(np.memmap(file, dtype, "c", shape=(rows, *shape)))
