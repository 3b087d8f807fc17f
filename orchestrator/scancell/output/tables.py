"""Tables as CSV files."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.cell.recording import Recording
from scancell.config.sensor import SensorDescription, sensor_json
from scancell.errors import OutputError, require
from scancell.evaluation.ground_truth import CloudTruth, Stripe, Surface, TrueWorld
from scancell.nominal.cell import Lamp
from scancell.nominal.parts import Body
from scancell.reconstruction.reconstruct import ProfilePoints
from scancell.scanning.scan import ScanData
from scancell.scanning.sense import ExposureImages
from scancell.scanning.world import build_scene, exposures_from_truth, make_sensor, readout_time

if TYPE_CHECKING:
    import h5py


_ROWS = 1 << 16  # formatted at a time
_MM = 1e3

_COMPRESSED = {"compression": "gzip", "compression_opts": 1, "shuffle": True}
_MASK_ELECTRONS = 1.0


def write_csv(path: Path, columns: Mapping[str, NDArray[Any]]) -> None:
    """Write columns (n,) under their names: integers as they are, other numbers with six decimals, NaN as empty."""
    count = len(next(iter(columns.values())))
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(columns)
        for start in range(0, count, _ROWS):
            writer.writerows(
                zip(*(_written(values[start : start + _ROWS]) for values in columns.values()), strict=True)
            )


def _written(values: NDArray[Any]) -> list[Any]:
    if np.issubdtype(values.dtype, np.floating):
        return [f"{number:.6f}" if number == number else "" for number in values.tolist()]  # noqa: PLR0124 (NaN)
    return list(values.tolist())


def columns_of(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Columns for `write_csv` of rows that may lack some of the keys."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    return {name: _column([row.get(name) for row in rows]) for name in names}


def _column(values: Sequence[Any]) -> Any:
    if any(isinstance(value, str) for value in values):
        return np.array([value or "" for value in values])
    if all(isinstance(value, int) for value in values):
        return np.array([int(value) for value in values])
    return np.array([np.nan if value is None else float(value) for value in values])


def write_profile_csv(
    path: Path, profile: ProfilePoints, rows: NDArray[np.float64], points_in_part: NDArray[np.float64]
) -> None:
    """Points of one exposure in pixels, with image rows (m,), and in mm in the frames of sensor and part.

    `points_in_part` is (m, 3), m.
    """
    in_sensor, in_part = np.asarray(profile.points_in_sensor) * _MM, points_in_part * _MM
    write_csv(
        path,
        {
            "camera": np.asarray(profile.camera),
            "column_px": np.asarray(profile.column),
            "row_px": np.asarray(rows, float),
            **{f"{axis}_sensor_mm": in_sensor[:, i] for i, axis in enumerate("xyz")},
            **{f"{axis}_part_mm": in_part[:, i] for i, axis in enumerate("xyz")},
            "sigma_mm": np.asarray(profile.sigma, float) * _MM,
            "intensity_dn": np.asarray(profile.intensity, float),
        },
    )


@contextmanager
def dataset_file(path: Path) -> Iterator[h5py.File]:
    """A new HDF5 file for `write_measured` and `ImageStack`.

    Raises
    ------
    OutputError
        If the file cannot be written.
    MissingExtraError
        If h5py is not installed.
    """
    h5py = require("h5py", "formats")
    try:
        # Newer versions of the format store creation times: files of equal scans would differ.
        with h5py.File(path, "w", libver="earliest") as file:
            yield file
    except OSError as error:
        raise OutputError(f"cannot be written: {error.strerror or error}", file=path) from error


class ImageStack:
    """Images (n, cameras, height, width) in an open file, one chunk per image, appended in order of the exposures."""

    def __init__(self, file: h5py.Group) -> None:
        self._file = file
        self._images: h5py.Dataset | None = None

    def add(self, exposure: ExposureImages) -> None:
        """Append the images of an exposure."""
        images = exposure.images
        if self._images is None:
            shape = images.shape
            self._images = self._file.create_dataset(
                "images",
                (0, *shape),
                exposure.pixel_type,
                chunks=(1, 1, *shape[1:]),
                maxshape=(None, *shape),
                **_COMPRESSED,
            )
            self._images.attrs["axes"] = "exposure, camera, row, column"
            self._images.attrs["unit"] = "digital numbers"
        self._images.resize(len(self._images) + 1, axis=0)
        self._images[-1] = images


def write_measured(file: h5py.Group, scan: ScanData) -> None:
    """Write the measured data of a scan; `file` may hold its images already."""
    measured, sensor = scan.recording.measured, scan.setup.sensor
    _put_sensor(file, sensor, scan.seed)
    file.attrs["what"] = "measured joints, and poses derived from them by nominal geometry"
    if "images" in file:
        file["images"].attrs["cameras"] = scan.camera_names
    for name in ("index", "segment"):
        file[name] = getattr(measured, name)
    for name, unit in (("time", "s"), ("exposure", "s"), ("q", "rad"), ("table", "rad")):
        file[f"{name}_{unit}"] = getattr(measured, name)
    for axis in scan.nominal.further_axes:
        unit = "m" if axis.joint.kind == "prismatic" else "rad"
        file[f"axis.{axis.name}_{unit}"] = measured.axes[:, measured.names.index(axis.name)]
    file["part_from_sensor"] = scan.nominal.part_from_sensor(measured.axes)


@dataclass(frozen=True)
class Truth:
    """Ground truth of a scan; with images also `stripe` and `masks` (cameras, height, width), one per exposure."""

    world: TrueWorld
    cloud: CloudTruth
    stripe: Stripe | None = None
    masks: Iterable[NDArray[np.bool_]] | None = None


def write_truth(path: Path, truth: Truth, sensor: SensorDescription, seed: int) -> None:
    """Write the ground truth to the new file `path`; `sensor` is the description as built.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    world, cloud, stripe = truth.world, truth.cloud, truth.stripe
    with dataset_file(path) as file:
        group = file.create_group("truth")
        _put_sensor(group, sensor, seed)
        group.attrs["bodies"] = world.body_names
        for name in ("world_from_sensor", "world_from_part", "part_from_sensor"):
            group[f"exposures/{name}"] = getattr(world, name)
        _put(group.create_group("cloud"), {"row_px": cloud.row, "row_measured_px": cloud.row_measured}, cloud.surface)
        if stripe is not None:
            indices = {name: getattr(stripe, name).astype(np.int32) for name in ("exposure", "camera", "column")}
            _put(group.create_group("stripe"), {**indices, "row_px": stripe.row}, stripe.surface)
        if truth.masks is not None:
            _put_masks(group, len(world.world_from_sensor), truth.masks)


def _put_sensor(group: h5py.Group, sensor: SensorDescription, seed: int) -> None:
    """Write the complete description of the sensor, and names and poses of its cameras."""
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
        group.create_dataset(name, data=values, **(_COMPRESSED if len(values) else {}))


def _put_masks(truth: h5py.Group, count: int, masks: Iterable[NDArray[np.bool_]]) -> None:
    data = None
    for row, mask in enumerate(masks):
        if data is None:
            chunks = (1, 1, *mask.shape[1:])
            data = truth.create_dataset("mask", (count, *mask.shape), np.uint8, chunks=chunks, **_COMPRESSED)
            data.attrs["what"] = f"1: {_MASK_ELECTRONS:g} photo-electron or more of direct laser light is expected"
        data[row] = mask


def stripe_masks(
    recording: Recording, bodies: Sequence[Body | Lamp], sensor: SensorDescription, seed: int, threads: int
) -> Iterator[NDArray[np.bool_]]:
    """Masks (cameras, height, width) of every exposure: the pixels that receive direct laser light.

    Rendered without interreflections, ambient light, speckle and noise.

    Parameters
    ----------
    recording
        Recording of the scan, with its truth.
    bodies
        Visible bodies; lamps are ignored.
    sensor
        Description of the sensor as built.
    threads
        Number of threads; 0 uses all cores.
    """
    laser_only = sensor.model_dump(mode="json")
    laser_only["ambient"]["irradiance_w_m2"] = laser_only["speckle"]["contrast"] = 0.0
    laser_only["detector"]["dark_current_e_per_s"] = 0.0
    laser_only["render"].update(mode="fast", bounces=0)
    solid = [body for body in bodies if isinstance(body, Body)]
    scene, native = build_scene(solid), make_sensor(SensorDescription.model_validate(laser_only), seed)
    truth, index = recording.truth_for_rows(readout_time(native)), recording.measured.index
    for row in range(len(recording)):
        exposure = exposures_from_truth(truth, index, solid, slice(row, row + 1))
        electrons = sensor_rt.expected_electrons(scene, native, exposure, threads=threads)
        yield np.asarray(electrons[0] >= _MASK_ELECTRONS)
