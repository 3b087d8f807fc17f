"""Images of a real sensor, or of a rendered one, to profiles: stripe, triangulation, files."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import sensor_rt
from orchestrator.config.sensor import SensorDescription
from orchestrator.errors import SensorError
from orchestrator.evaluation.frame_index import INDEX
from orchestrator.evaluation.image_files import ImageSet, read_images
from orchestrator.evaluation.request import ScanReport
from orchestrator.evaluation.run_folder import RunFolder, run_into
from orchestrator.evaluation.sheet_check import off_sheet
from orchestrator.evaluation.stopwatch import Stopwatch
from orchestrator.reconstruction.cloud import Cloud
from orchestrator.reconstruction.cloud_files import write_ply
from orchestrator.reconstruction.reconstruct import quality_of
from orchestrator.scanning.sense import make_sensor

_BATCH = 16  # frames in memory at a time
_MM = 1e3
_TOLD = 3  # files left aside that are named


@dataclass(frozen=True)
class ExtractionRequest:
    """What a person asks for."""

    images: Sequence[Path]
    sensor: SensorDescription
    peaks: bool
    threads: int
    laser_off: Sequence[Path] = ()
    sheet_um: float | None = None  # how far off the laser's sheet a point may be; None: not looked at


@dataclass(frozen=True)
class _Batch:
    """Results of a few frames; frames count from `first`."""

    first: int
    peaks: Any
    profiles: Any
    off_sheet: NDArray[np.float64] | None


# Profiles or peaks, the numbers (n, k) of each, and its flags in words.
_Found = tuple[Any, NDArray[Any], list[str]]


def extract_to_folder(request: ExtractionRequest, out: Path) -> ScanReport:
    """Leave ``profiles.csv`` and ``profiles.ply`` (sensor frame) in `out`, on request ``peaks.csv`` with every peak.

    Raises
    ------
    ScancellError
        With a message for people, whatever is wrong.
    """

    def work(folder: RunFolder, watch: Stopwatch) -> ScanReport:
        with watch.measure("load"):
            sensor = make_sensor(request.sensor, 0)
            names = [camera.name for camera in sensor.cameras]
            sets = ImageSet.from_files(request.images, names)
            unlit = sets.partners(ImageSet.from_files(request.laser_off, names, "off")) if request.laser_off else None
        with watch.measure("extract"):
            batches = list(_extract(sets, unlit, sensor, request))
        with watch.measure("write"):
            _write_profiles(folder.path("profiles.csv"), batches, sets, request.sheet_um)
            cloud = _cloud(batches)
            write_ply(folder.path("profiles.ply"), cloud, ("points in the sensor frame, profile counts the exposures",))
            if request.peaks:
                _write_peaks(folder.path("peaks.csv"), batches, sets)
        figures = _figures(batches, sets, len(sensor.cameras))
        if request.sheet_um is not None:
            figures["off_sheet"] = _sheet_figures(batches, request.sheet_um)
        lines = [f"{len(sets)} exposures: {len(cloud)} points", *_aside(sets), f"  results    {out}"]
        return ScanReport(figures, lines, _warnings(figures))

    return run_into(out, work)


def _warnings(figures: Mapping[str, Any]) -> list[str]:
    if figures["points"] == 0:
        return ["no stripe was found in any image"]
    said = []
    if figures["frames_without_points"]:
        said.append(f"{figures['frames_without_points']} of {figures['exposures']} exposures give no point")
    sheet = figures.get("off_sheet")
    if sheet and not sheet["compared"]:
        said.append("no point is seen by two cameras: nothing tells how far off the laser's sheet they are")
    elif sheet and sheet["beyond"]:
        said.append(
            f"{sheet['beyond']} of {sheet['compared']} points that two cameras see are more than"
            f" {sheet['limit_um']:g} um off the laser's sheet (median {sheet['median_um']:+.1f} um):"
            " is the sensor file this sensor's?"
        )
    return said


def _sheet_figures(batches: Sequence[_Batch], limit_um: float) -> dict[str, Any]:
    """Of the points that two cameras see: their number, how far off the sheet in the middle, and how many too far."""
    all_um = np.concatenate([batch.off_sheet for batch in batches if batch.off_sheet is not None]) * 1e6
    known = all_um[~np.isnan(all_um)]
    return {
        "limit_um": limit_um,
        "compared": len(known),
        "median_um": float(np.median(known)) if len(known) else None,
        "beyond": int((np.abs(known) > limit_um).sum()),
    }


def _aside(sets: ImageSet) -> list[str]:
    """What a folder's index does not list, for people."""
    some = ", ".join(file.name for file in sets.left_aside[:_TOLD])
    more = ", …" if len(sets.left_aside) > _TOLD else ""
    return (
        [f"  left aside {len(sets.left_aside)} files that {INDEX} does not list with the laser on: {some}{more}"]
        if some
        else []
    )


def _extract(
    sets: ImageSet, unlit_sets: ImageSet | None, sensor: sensor_rt.Sensor, request: ExtractionRequest
) -> Iterator[_Batch]:
    depth = request.sensor.detector.bit_depth
    for first in range(0, len(sets), _BATCH):
        rows = range(first, min(first + _BATCH, len(sets)))
        images = read_images(sets, rows, sensor, depth)
        unlit = None if unlit_sets is None else read_images(unlit_sets, rows, sensor, depth)
        try:
            peaks = sensor_rt.extract(images, sensor, request.threads, request.peaks, unlit)
            profiles = sensor_rt.triangulate(peaks, sensor)
            yield _Batch(first, peaks, profiles, None if request.sheet_um is None else off_sheet(profiles, sensor))
        except (ValueError, RuntimeError) as error:
            raise SensorError(str(error)) from error


def _write_profiles(path: Path, batches: Sequence[_Batch], sets: ImageSet, sheet_um: float | None) -> None:
    """Columns in millimetres, pixels and digital numbers; x is 0 on the laser sheet."""

    def found(batch: _Batch) -> _Found:
        p, off = batch.profiles, batch.off_sheet
        numbers = [p.row, np.asarray(p.points_in_sensor)[:, 1:] * _MM, p.sigma * _MM, p.intensity]
        words = [_flag_names(flags) for flags in p.flags]
        if off is not None and sheet_um is not None:
            numbers.append(off * _MM)
            far = np.abs(off) * 1e6 > sheet_um
            words = [f"{word} off_sheet".lstrip() if beyond else word for word, beyond in zip(words, far, strict=True)]
        return p, np.column_stack(numbers), words

    header = "row_px y_mm z_mm sigma_mm intensity_dn" + ("" if sheet_um is None else " off_sheet_mm")
    _write_table(path, header, found, batches, sets)


def _write_peaks(path: Path, batches: Sequence[_Batch], sets: ImageSet) -> None:
    """Every peak that was found, with what was made of it."""
    shape = ("row", "amplitude", "width", "row_sigma", "asymmetry", "residual")

    def found(batch: _Batch) -> _Found:
        p = batch.peaks
        numbers = np.stack([np.asarray(getattr(p, name), float) for name in shape], axis=1)
        return p, numbers, [_flag_names(flags) for flags in p.flags]

    _write_table(path, "row_px amplitude_dn width_px row_sigma_px asymmetry residual", found, batches, sets)


def _write_table(
    path: Path,
    header: str,
    found: Callable[[_Batch], _Found],
    batches: Sequence[_Batch],
    sets: ImageSet,
) -> None:
    """A row for each thing found in a batch, by exposure, camera and column: its numbers (n, k), its flags in words."""
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["exposure", "name", "camera", "column_px", *header.split(), "flags"])
        for batch in batches:
            things, numbers, words = found(batch)
            rows = zip(things.frame, things.camera, things.column, numbers, words, strict=True)
            for frame, camera, column, values, flags in rows:
                exposure = batch.first + int(frame)
                shown = ["" if np.isnan(value) else f"{value:.6f}" for value in values]
                writer.writerow([exposure, sets.names[exposure], camera, column, *shown, flags])


def _flag_names(flags: int) -> str:
    return " ".join(name for name, bit in sensor_rt.PEAK_FLAGS.items() if flags & bit)


def _cloud(batches: Sequence[_Batch]) -> Cloud:
    """All points in the sensor frame; without poses there are no normals and no times."""

    def join(name: str) -> NDArray[Any]:
        return np.concatenate([np.asarray(getattr(batch.profiles, name)) for batch in batches])

    sigma = join("sigma").astype(float)
    profile = np.concatenate([np.asarray(batch.profiles.frame) + batch.first for batch in batches])
    return Cloud(
        points_in_part=join("points_in_sensor"),
        normals=np.full((len(sigma), 3), np.nan),
        sigma=sigma,
        intensity=join("intensity").astype(float),
        quality=quality_of(sigma, join("flags")),
        camera=join("camera"),
        column=join("column"),
        profile=profile,
        segment=np.zeros(len(sigma), np.int32),
        time=np.zeros(len(sigma)),
    )


def _figures(batches: Sequence[_Batch], sets: ImageSet, cameras: int) -> dict[str, Any]:
    camera = np.concatenate([np.asarray(batch.profiles.camera) for batch in batches])
    profile = np.concatenate([np.asarray(batch.profiles.frame) + batch.first for batch in batches])
    flags = np.concatenate([np.asarray(batch.peaks.flags) for batch in batches])
    return {
        "exposures": len(sets),
        "points": len(camera),
        "by_camera": [int((camera == k).sum()) for k in range(cameras)],
        "peaks": len(flags),
        "peaks_by_flag": {name: int(((flags & bit) != 0).sum()) for name, bit in sensor_rt.PEAK_FLAGS.items()},
        "frames_without_points": len(sets) - len(np.unique(profile)),
        "left_aside": [str(file) for file in sets.left_aside],
    }
