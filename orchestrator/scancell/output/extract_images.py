"""Images of a real sensor, or of a rendered one, to profiles: stripe, triangulation, files."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.arguments import Length, Threads, checked_arguments
from scancell.config.files import Assignments, assignments
from scancell.config.loading import load_setup
from scancell.config.sensor import SensorDescription
from scancell.errors import DescriptionError, SensorError
from scancell.evaluation.plane_trial import sheet_deviation
from scancell.output.image_files import INDEX, ImageSet, holds_colours, laser_channel, read_images
from scancell.output.run_folder import RunFolder, RunReport, run_into
from scancell.output.tables import write_csv
from scancell.progress import Stopwatch
from scancell.reconstruction.cloud import Cloud
from scancell.reconstruction.cloud_files import write_ply
from scancell.reconstruction.reconstruct import is_saturated, quality_of
from scancell.scanning.world import make_sensor

_BATCH = 16  # frames in memory at a time
_MM = 1e3
_MAX_LISTED = 3  # ignored files listed by name
_NEARLY_ALL = 0.95  # share of the rejected peaks that a proposed limit accepts
# Flags of rejected peaks: key of the limit, column of the value, and whether the limit is the least value.
_LIMITS = {
    "asymmetric": ("max_asymmetry", "asymmetry", False),
    "wide": ("max_sigma_px", "width", False),
    "narrow": ("min_sigma_px", "width", True),
    "weak": ("min_amplitude_dn", "amplitude", True),
    "residual": ("max_residual", "residual", False),
}
_LARGEST_LIMITS = {"max_sigma_px": 8.0, "max_asymmetry": 1.0, "max_residual": 1.0}  # that can be meant
_OTHER_KEYS = {
    "step": ("max_row_jump_px", "max_amplitude_jump", "max_width_jump"),
    "end": ("end_columns", "min_run_columns"),
    "passed_over": ("peak",),
    "unconfirmed": ("peak", "agreement_px"),
}
# Columns of peaks and profiles; those of peaks alone with their units.
_OF_BOTH = ("frame", "camera", "column", "flags")
_PROFILE_COLUMNS = (*_OF_BOTH, "row", "points_in_sensor", "sigma", "intensity")
_PEAK_COLUMNS = {
    "row": "_px",
    "amplitude": "_dn",
    "width": "_px",
    "row_sigma": "_px",
    "asymmetry": "",
    "residual": "",
}


@dataclass(frozen=True)
class Extraction:
    """Peaks and profile points of all exposures by column; `frame` is the number of the exposure."""

    peaks: dict[str, NDArray[Any]]
    profiles: dict[str, NDArray[Any]]


@checked_arguments
def extract(
    images: Sequence[str | Path],
    out: str | Path,
    *,
    sensor: str | Path | SensorDescription | None = None,
    settings: Assignments = (),
    laser_off: Sequence[str | Path] = (),
    sheet_um: Length | None = None,
    peaks: bool = False,
    threads: Threads = 0,
) -> RunReport:
    """Measure the stripe in images of a sensor, real or simulated, and write profiles into the folder `out`.

    The other parameters are those of `Scanner`.

    Parameters
    ----------
    images, laser_off
        Image files or folders, and laser-off (background) frames to subtract.
    sheet_um
        Flag points that, by two cameras, are farther than this off the laser sheet.
    peaks
        Also write every peak that was found.

    Raises
    ------
    ScancellError
        Naming what is wrong and what was expected.

    Examples
    --------
    >>> shot = scancell.shot("part.stl", scancell.location(0, 0, 0.1, rx=180 * scancell.deg))
    >>> files = shot.save("shot")
    >>> report = scancell.extract(["shot/image_plus.png", "shot/image_minus.png"], "profiles")
    >>> report.figures["exposures"]
    1
    """
    if not images:
        raise DescriptionError("images: expected at least one image file or folder")
    description = load_setup(None, sensor, None, assignments(settings)).sensor
    files, dark_files = ([Path(item) for item in items] for items in (images, laser_off))
    out = Path(out)

    def work(folder: RunFolder, watch: Stopwatch) -> RunReport:
        with watch.measure("load"):
            names = [camera.name for camera in description.camera]
            sets = ImageSet.from_files(files, names)
            background = sets.matching(ImageSet.from_files(dark_files, names, "off")) if dark_files else None
        with watch.measure("extract"):
            found = extract_profiles(sets, background, description, threads, sheet=sheet_um is not None)
        with watch.measure("write"):
            _write_profiles(folder.path("profiles.csv"), found.profiles, sets, sheet_um)
            cloud = _cloud(found.profiles)
            write_ply(folder.path("profiles.ply"), cloud, ("points in the sensor frame, profile counts the exposures",))
            if peaks:
                columns = {name + unit: found.peaks[name].astype(float) for name, unit in _PEAK_COLUMNS.items()}
                near = np.zeros(len(found.peaks["flags"]), bool)
                _write_table(folder.path("peaks.csv"), found.peaks, sets, columns, near)
        figures = _figures(found, sets, len(names))
        if sheet_um is not None:
            figures["sheet_deviation"] = _sheet_figures(found.profiles["sheet_deviation"], sheet_um)
        rejected = rejection_text(found.peaks, description)
        lines = [f"{len(sets)} exposures: {len(cloud)} points", *_ignored_line(sets)]
        lines += [f"  {rejected}"] if rejected and len(cloud) else []
        if holds_colours(sets.files[0][0]):
            wavelength = description.laser.wavelength_nm
            lines.append(
                f"  colours: the {laser_channel(wavelength)} channel is used (laser.wavelength_nm = {wavelength:g})"
            )
        return RunReport(figures, [*lines, f"  results    {out}"], _warnings(figures, rejected))

    return run_into(out, work)


def rejection_text(peaks: Mapping[str, NDArray[Any]], sensor: SensorDescription) -> str:
    """Columns whose peaks were all rejected, by reason, with the keys and the values that would accept them.

    Empty if there are none. A column counts once for each reason for which its highest peak was rejected.
    """
    place = np.stack([peaks[name].astype(np.int64) for name in ("frame", "camera", "column")])
    order = np.lexsort((-peaks["amplitude"], *place[::-1]))
    first = np.ones(len(order), bool)
    first[1:] = (np.diff(place[:, order], axis=1) != 0).any(0)
    flags = peaks["flags"].astype(np.int64)
    column = np.cumsum(first) - 1
    is_used = (
        np.bincount(column, (flags[order] & sensor_rt.PEAK_REJECTED) == 0) > 0 if len(order) else np.zeros(0, bool)
    )
    highest = order[first][~is_used]
    if not len(highest):
        return ""
    reasons = []
    for name, bit in sensor_rt.PEAK_FLAGS.items():
        rows = highest[(flags[highest] & bit & sensor_rt.PEAK_REJECTED) != 0]
        if len(rows):
            reasons.append((len(rows), _reason(name, peaks, rows, sensor)))
    reasons.sort(key=lambda one: -one[0])
    texts = "; ".join(f"{count} {text}" for count, text in reasons)
    return f"{len(highest)} of {len(is_used)} columns with a peak give no point, rejected as: {texts}"


def _reason(name: str, peaks: Mapping[str, NDArray[Any]], rows: NDArray[Any], sensor: SensorDescription) -> str:
    """A reason of rejection with its key, the value of the key, and the one that accepts nearly all of the peaks."""
    limits = sensor.extraction
    if name in _LIMITS:
        key, column, is_least = _LIMITS[name]
        values = np.abs(peaks[column][rows].astype(float))
        values = values[np.isfinite(values)]
        text = f"{name} (sensor.extraction.{key} = {getattr(limits, key):g}"
        if not len(values):
            return f"{text})"
        limit = float(np.quantile(values, 1.0 - _NEARLY_ALL if is_least else _NEARLY_ALL))
        if limit > _LARGEST_LIMITS.get(key, np.inf):  # no stripe, or one wider than the extraction measures
            return f"{text}, largest value {_LARGEST_LIMITS[key]:g})"
        return f"{text}; {_rounded(limit, up=not is_least):g} accepts {100 * _NEARLY_ALL:.0f} %)"
    keys = ", ".join(f"sensor.extraction.{key} = {getattr(limits, key)}" for key in _OTHER_KEYS.get(name, ()))
    return f"{name} ({keys})" if keys else name


def _rounded(value: float, *, up: bool) -> float:
    """The number of two digits next to a positive value, above or below it."""
    step = 10.0 ** (np.floor(np.log10(value)) - 1) if value > 0 else 1.0
    return float((np.ceil if up else np.floor)(value / step) * step)


def _warnings(figures: Mapping[str, Any], rejected: str) -> list[str]:
    if figures["points"] == 0:
        return [f"no point: {rejected}" if rejected else "no stripe was found in any image"]
    warnings = []
    if figures["frames_without_points"]:
        warnings.append(f"{figures['frames_without_points']} of {figures['exposures']} exposures give no point")
    sheet = figures.get("sheet_deviation")
    if sheet and not sheet["compared"]:
        warnings.append("no point is seen by two cameras: the distance from the laser's sheet is unknown")
    elif sheet and sheet["beyond"]:
        warnings.append(
            f"{sheet['beyond']} of {sheet['compared']} points that two cameras see are more than"
            f" {sheet['limit_um']:g} um off the laser's sheet (median {sheet['median_um']:+.1f} um):"
            " is the sensor file this sensor's?"
        )
    return warnings


def _sheet_figures(deviation: NDArray[np.float64], limit_um: float) -> dict[str, Any]:
    """Number of points that two cameras see, their median distance from the sheet, and how many exceed the limit."""
    known = 1e6 * deviation[~np.isnan(deviation)]
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


def extract_profiles(
    sets: ImageSet,
    background_sets: ImageSet | None,
    description: SensorDescription,
    threads: int,
    further: Sequence[str] = (),
    quarter_turns: int = 0,
    sheet: bool = False,
) -> Extraction:
    """Peaks and points of all exposures.

    `further` are columns of points such as ``covariance``; with `sheet` there is a column ``sheet_deviation``, see
    `sheet_deviation`. `quarter_turns` turn the files counter-clockwise into the images of the described cameras.

    Raises `ImageError` if an image does not fit the camera; `SensorError` if the library reports an error.
    """
    sensor = make_sensor(description, 0)
    all_peaks, all_profiles = [], []
    for first in range(0, len(sets), _BATCH):
        rows = range(first, min(first + _BATCH, len(sets)))
        images = read_images(sets, rows, sensor, description, quarter_turns)
        background = (
            None if background_sets is None else read_images(background_sets, rows, sensor, description, quarter_turns)
        )
        try:
            peaks = sensor_rt.extract(images, sensor, threads, True, background)
            profiles = sensor_rt.triangulate(peaks, sensor)
            columns = _columns(profiles, (*_PROFILE_COLUMNS, *further), first)
            if sheet:
                columns["sheet_deviation"] = sheet_deviation(profiles, sensor)
        except (ValueError, RuntimeError) as error:
            raise SensorError(str(error)) from error
        all_peaks.append(_columns(peaks, [*_OF_BOTH, *_PEAK_COLUMNS], first))
        all_profiles.append(columns)
    return Extraction(_joined(all_peaks), _joined(all_profiles))


def _columns(found: Any, names: Iterable[str], first: int) -> dict[str, NDArray[Any]]:
    """Arrays of peaks or profiles of a batch of frames that begins with exposure `first`."""
    columns = {name: np.asarray(getattr(found, name)) for name in names}
    return {**columns, "frame": columns["frame"].astype(np.int64) + first}


def _joined(tables: Sequence[dict[str, NDArray[Any]]]) -> dict[str, NDArray[Any]]:
    return {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}


def _write_profiles(path: Path, profiles: Mapping[str, NDArray[Any]], sets: ImageSet, sheet_um: float | None) -> None:
    """Columns in millimetres, pixels and digital numbers; x is 0 unless triangulation is on the described sheet."""
    points = profiles["points_in_sensor"] * _MM
    columns = {
        "row_px": profiles["row"].astype(float),
        **{f"{axis}_mm": points[:, i] for i, axis in enumerate("xyz")},
        "sigma_mm": profiles["sigma"] * _MM,
        "intensity_dn": profiles["intensity"].astype(float),
    }
    far = np.zeros(len(points), bool)
    if sheet_um is not None:
        columns["sheet_deviation_mm"] = profiles["sheet_deviation"] * _MM
        far = np.abs(profiles["sheet_deviation"]) * 1e6 > sheet_um
    _write_table(path, profiles, sets, columns, far)


def _write_table(
    path: Path,
    found: Mapping[str, NDArray[Any]],
    sets: ImageSet,
    columns: Mapping[str, NDArray[Any]],
    far: NDArray[np.bool_],
) -> None:
    """A row for each peak or point: exposure, camera and column, then `columns` and the flags as words."""
    write_csv(
        path,
        {
            "exposure": found["frame"],
            "name": np.array(sets.names)[found["frame"]],
            "camera": found["camera"],
            "column_px": found["column"],
            **columns,
            "flags": _flag_words(found["flags"], far),
        },
    )


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


def _cloud(profiles: Mapping[str, NDArray[Any]]) -> Cloud:
    """All points in the sensor frame; without poses there are no normals and no times."""
    sigma = profiles["sigma"].astype(float)
    return Cloud(
        points_in_part=profiles["points_in_sensor"],
        normals=np.full((len(sigma), 3), np.nan),
        sigma=sigma,
        intensity=profiles["intensity"].astype(float),
        quality=quality_of(sigma, profiles["flags"]),
        camera=profiles["camera"],
        column=profiles["column"],
        profile=profiles["frame"],
        segment=np.zeros(len(sigma), np.int32),
        time=np.zeros(len(sigma)),
        saturated=is_saturated(profiles["flags"]),
    )


def _figures(found: Extraction, sets: ImageSet, cameras: int) -> dict[str, Any]:
    profiles, flags = found.profiles, found.peaks["flags"]
    return {
        "exposures": len(sets),
        "points": len(profiles["camera"]),
        "by_camera": [int((profiles["camera"] == k).sum()) for k in range(cameras)],
        "peaks": len(flags),
        "peaks_by_flag": {name: int(((flags & bit) != 0).sum()) for name, bit in sensor_rt.PEAK_FLAGS.items()},
        "frames_without_points": len(sets) - len(np.unique(profiles["frame"])),
        "ignored_files": [str(file) for file in sets.ignored_files],
    }
