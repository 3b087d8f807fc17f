"""Images of a real sensor, or of a rendered one, to profiles: stripe, triangulation, files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.config.sensor import SensorDescription
from scancell.errors import SensorError
from scancell.evaluation.sheet_check import sheet_deviation
from scancell.output.frame_index import INDEX
from scancell.output.image_files import ImageSet, read_images
from scancell.output.run_folder import RunFolder, RunReport, run_into
from scancell.output.tables import write_csv
from scancell.reconstruction.cloud import Cloud
from scancell.reconstruction.cloud_files import write_ply
from scancell.reconstruction.reconstruct import quality_of
from scancell.scanning.sense import make_sensor
from scancell.stopwatch import Stopwatch

_BATCH = 16  # frames in memory at a time
_MM = 1e3
_MAX_LISTED = 3  # ignored files listed by name


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
    sheet_deviation: NDArray[np.float64] | None


def extract_to_folder(request: ExtractionRequest, out: Path) -> RunReport:
    """Leave ``profiles.csv`` and ``profiles.ply`` (sensor frame) in `out`, on request ``peaks.csv`` with every peak.

    Raises
    ------
    ScancellError
        With a message for people, whatever is wrong.
    """

    def work(folder: RunFolder, watch: Stopwatch) -> RunReport:
        with watch.measure("load"):
            sensor = make_sensor(request.sensor, 0)
            names = [camera.name for camera in sensor.cameras]
            sets = ImageSet.from_files(request.images, names)
            background = (
                sets.matching(ImageSet.from_files(request.laser_off, names, "off")) if request.laser_off else None
            )
        with watch.measure("extract"):
            batches = list(_extract(sets, background, sensor, request))
        with watch.measure("write"):
            _write_profiles(folder.path("profiles.csv"), batches, sets, request.sheet_um)
            cloud = _cloud(batches)
            write_ply(folder.path("profiles.ply"), cloud, ("points in the sensor frame, profile counts the exposures",))
            if request.peaks:
                _write_peaks(folder.path("peaks.csv"), batches, sets)
        figures = _figures(batches, sets, len(sensor.cameras))
        if request.sheet_um is not None:
            figures["sheet_deviation"] = _sheet_figures(batches, request.sheet_um)
        lines = [f"{len(sets)} exposures: {len(cloud)} points", *_ignored_line(sets), f"  results    {out}"]
        return RunReport(figures, lines, _warnings(figures))

    return run_into(out, work)


def _warnings(figures: Mapping[str, Any]) -> list[str]:
    if figures["points"] == 0:
        return ["no stripe was found in any image"]
    said = []
    if figures["frames_without_points"]:
        said.append(f"{figures['frames_without_points']} of {figures['exposures']} exposures give no point")
    sheet = figures.get("sheet_deviation")
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
    all_um = np.concatenate([batch.sheet_deviation for batch in batches if batch.sheet_deviation is not None]) * 1e6
    known = all_um[~np.isnan(all_um)]
    return {
        "limit_um": limit_um,
        "compared": len(known),
        "median_um": float(np.median(known)) if len(known) else None,
        "beyond": int((np.abs(known) > limit_um).sum()),
    }


def _ignored_line(sets: ImageSet) -> list[str]:
    """Report line on the files that the index of their folder does not list."""
    some = ", ".join(file.name for file in sets.ignored_files[:_MAX_LISTED])
    more = ", …" if len(sets.ignored_files) > _MAX_LISTED else ""
    return (
        [f"  ignored {len(sets.ignored_files)} files that {INDEX} does not list with the laser on: {some}{more}"]
        if some
        else []
    )


def _extract(
    sets: ImageSet, background_sets: ImageSet | None, sensor: sensor_rt.Sensor, request: ExtractionRequest
) -> Iterator[_Batch]:
    depth = request.sensor.detector.bit_depth
    for first in range(0, len(sets), _BATCH):
        rows = range(first, min(first + _BATCH, len(sets)))
        images = read_images(sets, rows, sensor, depth)
        background = None if background_sets is None else read_images(background_sets, rows, sensor, depth)
        try:
            peaks = sensor_rt.extract(images, sensor, request.threads, request.peaks, background)
            profiles = sensor_rt.triangulate(peaks, sensor)
            yield _Batch(
                first, peaks, profiles, None if request.sheet_um is None else sheet_deviation(profiles, sensor)
            )
        except (ValueError, RuntimeError) as error:
            raise SensorError(str(error)) from error


def _write_profiles(path: Path, batches: Sequence[_Batch], sets: ImageSet, sheet_um: float | None) -> None:
    """Columns in millimetres, pixels and digital numbers; x is 0 unless triangulation is on the described sheet."""
    points = _joined([batch.profiles.points_in_sensor for batch in batches]) * _MM
    flags = _joined([batch.profiles.flags for batch in batches])
    columns = {
        "row_px": _joined([batch.profiles.row for batch in batches]).astype(float),
        "x_mm": points[:, 0],
        "y_mm": points[:, 1],
        "z_mm": points[:, 2],
        "sigma_mm": _joined([batch.profiles.sigma for batch in batches]) * _MM,
        "intensity_dn": _joined([batch.profiles.intensity for batch in batches]).astype(float),
    }
    far = np.zeros(len(flags), bool)
    if sheet_um is not None:
        off = _joined([batch.sheet_deviation for batch in batches if batch.sheet_deviation is not None])
        columns["sheet_deviation_mm"] = off * _MM
        far = np.abs(off) * 1e6 > sheet_um
    _write_table(path, [(batch.first, batch.profiles) for batch in batches], sets, columns, _flag_words(flags, far))


def _write_peaks(path: Path, batches: Sequence[_Batch], sets: ImageSet) -> None:
    """Every peak that was found, with what was made of it."""
    columns = {
        name + unit: _joined([getattr(batch.peaks, name) for batch in batches]).astype(float)
        for name, unit in (
            ("row", "_px"),
            ("amplitude", "_dn"),
            ("width", "_px"),
            ("row_sigma", "_px"),
            ("asymmetry", ""),
            ("residual", ""),
        )
    }
    flags = _joined([batch.peaks.flags for batch in batches])
    found = [(batch.first, batch.peaks) for batch in batches]
    _write_table(path, found, sets, columns, _flag_words(flags, np.zeros(len(flags), bool)))


def _write_table(
    path: Path,
    found: Sequence[tuple[int, Any]],
    sets: ImageSet,
    columns: Mapping[str, NDArray[Any]],
    flags: NDArray[Any],
) -> None:
    """A row for each thing found, by exposure, camera and column; `found` has the first exposure of each batch."""
    exposure = _joined([np.asarray(things.frame, np.int64) + first for first, things in found])
    write_csv(
        path,
        {
            "exposure": exposure,
            "name": np.array(sets.names)[exposure],
            "camera": _joined([things.camera for _, things in found]),
            "column_px": _joined([things.column for _, things in found]),
            **columns,
            "flags": flags,
        },
    )


def _joined(arrays: Sequence[Any]) -> NDArray[Any]:
    return np.concatenate([np.asarray(array) for array in arrays])


def _flag_words(flags: NDArray[Any], far: NDArray[np.bool_]) -> NDArray[Any]:
    """Flags (n,) in words; points `far` (n,) from the sheet get the word `sheet_deviation`."""
    cases, number = np.unique(np.stack([flags.astype(np.int64), far], 1), axis=0, return_inverse=True)
    words = [
        " ".join(
            [*(name for name, bit in sensor_rt.PEAK_FLAGS.items() if case & bit), *["sheet_deviation"] * int(beyond)]
        )
        for case, beyond in cases.tolist()
    ]
    return np.array(words or [""])[number.reshape(-1)]


def _cloud(batches: Sequence[_Batch]) -> Cloud:
    """All points in the sensor frame; without poses there are no normals and no times."""

    def join(name: str) -> NDArray[Any]:
        return _joined([getattr(batch.profiles, name) for batch in batches])

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
        "ignored_files": [str(file) for file in sets.ignored_files],
    }
