"""From recorded exposures to profiles: images, peaks, triangulation, a batch at a time."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

import sensor_rt
from orchestrator.cell.nominal import Body, Lamp
from orchestrator.cell.recording import Recording
from orchestrator.config.loading import as_built_sensor, sensor_words
from orchestrator.config.resolved import sensor_json
from orchestrator.config.scan import Engine
from orchestrator.config.sensor import SensorDescription
from orchestrator.errors import SensorError
from orchestrator.progress import Progress
from orchestrator.reconstruction.reconstruct import ProfilePoints
from orchestrator.scanning.exposures import build_scene, exposures_from_truth, readout_time

# Large enough to keep all cores busy, small enough that Ctrl-C and the progress bar feel prompt.
_BATCH = 64


# Takes the trigger index and the images (cameras, height, width) of one exposure.
OnImages = Callable[[int, NDArray[np.uint16]], None]


@dataclass(frozen=True)
class Sensed:
    """Points of all exposures in the sensor frame, and seconds of processor time by station."""

    points: ProfilePoints
    timings: dict[str, float]


@dataclass(frozen=True)
class Sensors:
    """The sensor that images are read by, and the one that makes them; the same unless perturbed."""

    believed: sensor_rt.Sensor
    as_built: sensor_rt.Sensor


def make_sensor(description: SensorDescription, seed: int) -> sensor_rt.Sensor:
    """The native sensor.

    Raises
    ------
    SensorError
        If the library refuses the description.
    """
    try:
        return sensor_rt.Sensor(json.dumps(sensor_json(description, seed)))
    except (ValueError, RuntimeError) as error:
        raise SensorError(f"sensor '{description.name}': {error}") from error


def make_sensors(nominal: SensorDescription, as_built: Sequence[str], seed: int) -> Sensors:
    """The native sensors of a description and of the ``--as-built`` words about it.

    Raises
    ------
    DescriptionError
        If a word is wrong.
    SensorError
        If the library refuses a description.
    """
    believed = make_sensor(nominal, seed)
    if not sensor_words(as_built):
        return Sensors(believed, believed)
    return Sensors(believed, make_sensor(as_built_sensor(nominal, as_built), seed))


def sense(
    recording: Recording,
    bodies: tuple[Body | Lamp, ...],
    sensor: sensor_rt.Sensor,
    engine: Engine,
    threads: int,
    progress: Progress,
    on_images: OnImages | None = None,
    as_built: sensor_rt.Sensor | None = None,
    scene: sensor_rt.Scene | None = None,
    on_unlit: OnImages | None = None,
) -> Sensed:
    """Profiles of every exposure; frames count the rows of the recording.

    `as_built` is the sensor as it truly is, which makes the images; `sensor` is what their extraction believes.

    `on_images` gets the camera images of each exposure, where the engine makes any, and `on_unlit` those with the laser
    off, where the sensor takes such. `scene` is that of `bodies`, where the caller has built it already.

    Raises
    ------
    SensorError
        If the library reports an error.
    """
    truth, index = recording.truth_for_rows(readout_time(as_built or sensor)), recording.measured.index
    timings: Counter[str] = Counter()
    batches = []
    progress.stage("sensing", len(recording), "profiles")
    try:
        scene = scene or build_scene(bodies)
        for start in range(0, len(recording), _BATCH):
            rows = slice(start, min(start + _BATCH, len(recording)))
            exposures = exposures_from_truth(truth, index, bodies, rows)
            keep = on_images is not None or on_unlit is not None
            result = sensor_rt.scan(scene, sensor, exposures, engine, threads, keep_images=keep, as_built=as_built)
            for take, taken in ((on_images, result.images), (on_unlit, result.unlit)):
                if take is not None and taken is not None:
                    for trigger, images in zip(index[rows], taken, strict=True):
                        take(int(trigger), images)
            batches.append(_points(result.profiles, sensor, engine))
            timings.update(result.timings)
            progress.advance(rows.stop - rows.start)
    except (ValueError, RuntimeError) as error:
        raise SensorError(str(error)) from error
    points = ProfilePoints.concatenate(batches)
    # The library calls an exposure by its trigger index, which keys the noise; reconstruction counts rows.
    return Sensed(replace(points, frame=np.searchsorted(index, points.frame)), dict(timings))


def _points(profiles: sensor_rt.Profiles, sensor: sensor_rt.Sensor, engine: Engine) -> ProfilePoints:
    """Points with the time at which the row that saw them was exposed, as far as `sensor` is believed."""
    lapse = np.zeros(len(profiles))
    if engine == "ray-traced" and sensor.row_readout > 0.0:
        middle = np.array([(camera.height_px - 1) / 2 for camera in sensor.cameras])
        lapse = sensor.row_readout * (profiles.row - middle[profiles.camera])
    return ProfilePoints(
        points_in_sensor=profiles.points_in_sensor,
        sigma=profiles.sigma,
        intensity=profiles.intensity,
        camera=profiles.camera,
        column=profiles.column,
        frame=profiles.frame,
        flags=profiles.flags,
        lapse=lapse,
    )


def sample_rows(count: int, wanted: int) -> list[int]:
    """Rows of `wanted` exposures spread over `count`."""
    return sorted({int(row) for row in np.linspace(0, count - 1, min(wanted, count)).round()})
