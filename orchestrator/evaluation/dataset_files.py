"""HDF5 files of a scan for people who train or test algorithms: what was measured, and, apart from it, the truth.

``measured.h5`` holds what a real system would have, ``truth.h5`` what nobody knows but the simulation, all of it under
the group ``truth``. Lengths wear their unit; poses are (4, 4) matrices `target_from_source` in metres.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

import sensor_rt
from orchestrator.cell.nominal import Body, Lamp, NominalCell
from orchestrator.cell.recording import Recording
from orchestrator.config.resolved import sensor_json
from orchestrator.config.sensor import SensorDescription
from orchestrator.errors import OutputError
from orchestrator.evaluation.ground_truth import CloudTruth, Stripe, Surface, TrueWorld
from orchestrator.scanning.exposures import build_scene, exposures_from_truth, readout_time
from orchestrator.scanning.sense import make_sensor

_MM = 1e3
_PACKED = {"compression": "gzip", "compression_opts": 1, "shuffle": True}
_MASK_ELECTRONS = 1.0


@contextmanager
def _writing(path: Path) -> Iterator[h5py.File]:
    try:
        # Newer versions of the format note when a group was made: equal scans would differ.
        with h5py.File(path, "w", libver="earliest") as file:
            yield file
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from error


class ImageStack:
    """Images (n, cameras, height, width) of n exposures in an open file, one chunk per image, filled in any order."""

    def __init__(self, file: h5py.Group, index: NDArray[np.int64], sensor: SensorDescription) -> None:
        camera = sensor.camera[0]
        shape = (len(index), len(sensor.camera), camera.height_px, camera.width_px)
        kind = np.uint8 if sensor.detector.bit_depth <= 8 else np.uint16
        self._row = {int(trigger): row for row, trigger in enumerate(index)}
        self._images = file.create_dataset("images", shape, kind, chunks=(1, 1, *shape[2:]), **_PACKED)
        self._images.attrs["axes"] = "exposure, camera, row, column"
        self._images.attrs["unit"] = "digital numbers"
        self._images.attrs["cameras"] = [one.name for one in sensor.camera]

    def add(self, trigger: int, images: NDArray[np.uint16]) -> None:
        """Images (cameras, height, width) of the exposure that is called `trigger`."""
        self._images[self._row[trigger]] = images


@contextmanager
def measured_file(
    path: Path, recording: Recording, nominal: NominalCell, sensor: SensorDescription, seed: int, images: bool
) -> Iterator[ImageStack | None]:
    """Write what was measured; yields the stack that images go into, if any are to be kept.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    measured = recording.measured
    with _writing(path) as file:
        _put_sensor(file, sensor, seed)
        file.attrs["what"] = "measured joints and what follows from them by nominal geometry"
        for name in ("index", "segment"):
            file[name] = getattr(measured, name)
        for name, unit in (("time", "s"), ("exposure", "s"), ("q", "rad"), ("table", "rad")):
            file[f"{name}_{unit}"] = getattr(measured, name)
        file["part_from_sensor"] = nominal.part_from_sensor(measured.q, measured.table)
        yield ImageStack(file, measured.index, sensor) if images else None


@dataclass(frozen=True)
class Truth:
    """The truth of a scan; `stripe` and `masks`, one array (cameras, height, width) per exposure, go with images."""

    world: TrueWorld
    cloud: CloudTruth
    stripe: Stripe | None = None
    masks: Iterable[NDArray[np.bool_]] | None = None


def write_truth(path: Path, truth: Truth, sensor: SensorDescription, seed: int) -> None:
    """Write the truth; `sensor` is the one as built.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    world, cloud, stripe = truth.world, truth.cloud, truth.stripe
    with _writing(path) as file:
        group = file.create_group("truth")
        _put_sensor(group, sensor, seed)
        group.attrs["bodies"] = world.body_names
        for name in ("world_from_sensor", "world_from_part", "part_from_sensor"):
            group[f"exposures/{name}"] = getattr(world, name)
        _put(group.create_group("cloud"), {"row_px": cloud.row, "row_measured_px": cloud.row_measured}, cloud.surface)
        if stripe is not None:
            places = {name: getattr(stripe, name).astype(np.int32) for name in ("exposure", "camera", "column")}
            _put(group.create_group("stripe"), {**places, "row_px": stripe.row}, stripe.surface)
        if truth.masks is not None:
            _put_masks(group, len(world.world_from_sensor), truth.masks)


def _put_sensor(group: h5py.Group, sensor: SensorDescription, seed: int) -> None:
    """What the sensor is, complete, and where its cameras sit in it."""
    group.attrs["sensor_json"] = json.dumps(sensor_json(sensor, seed))
    group["cameras/name"] = [camera.name for camera in sensor.camera]
    cameras = make_sensor(sensor, seed).cameras
    group["cameras/sensor_from_camera"] = np.stack([camera.sensor_from_camera for camera in cameras])


def _put(group: h5py.Group, columns: dict[str, NDArray[Any]], surface: Surface) -> None:
    columns = {
        **columns,
        "points_in_part_mm": surface.points_in_part * _MM,
        "normals": surface.normals.astype(np.float32),
        "body": surface.body.astype(np.int32),
        "face": surface.face.astype(np.int32),
    }
    for name, values in columns.items():
        group.create_dataset(name, data=values, **(_PACKED if len(values) else {}))


def _put_masks(truth: h5py.Group, count: int, masks: Iterable[NDArray[np.bool_]]) -> None:
    data = None
    for row, mask in enumerate(masks):
        if data is None:
            chunks = (1, 1, *mask.shape[1:])
            data = truth.create_dataset("mask", (count, *mask.shape), np.uint8, chunks=chunks, **_PACKED)
            data.attrs["what"] = f"1: {_MASK_ELECTRONS:g} photo-electron or more of direct laser light is expected"
        data[row] = mask


def stripe_masks(
    recording: Recording, bodies: Sequence[Body | Lamp], sensor: SensorDescription, seed: int, threads: int
) -> Iterator[NDArray[np.bool_]]:
    """(cameras, height, width) of every exposure: pixels that direct laser light reaches, and none other.

    Rendered without reflections between surfaces, external light, speckle and noise.
    """
    alone = sensor.model_dump(mode="json")
    alone["ambient"]["irradiance_w_m2"] = alone["speckle"]["contrast"] = 0.0
    alone["detector"]["dark_current_e_per_s"] = 0.0
    alone["render"].update(mode="fast", bounces=0)
    dark = [body for body in bodies if isinstance(body, Body)]
    scene, native = build_scene(dark), make_sensor(SensorDescription.model_validate(alone), seed)
    truth, index = recording.truth_for_rows(readout_time(native)), recording.measured.index
    for row in range(len(recording)):
        exposure = exposures_from_truth(truth, index, dark, slice(row, row + 1))
        electrons = sensor_rt.expected_electrons(scene, native, exposure, threads=threads)
        yield np.asarray(electrons[0] >= _MASK_ELECTRONS)
