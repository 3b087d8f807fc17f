"""Files of a scan in its run folder, and of a single exposure."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.cell.recording import write_recording
from scancell.config.choices import CloudFrame
from scancell.config.files import plain_data
from scancell.evaluation.deviation import Coverage, Deviation, UnseenSurface
from scancell.files import arrow_table
from scancell.geometry.mesh import Mesh
from scancell.output.deviation_report import DeviationReport, deviation_picture
from scancell.output.image_files import FrameFiles
from scancell.output.run_folder import RunFolder, build_version, command_words, manifest, resolved_toml
from scancell.output.stripe_picture import exposure_picture
from scancell.output.tables import write_profile_csv
from scancell.planning.plan import plan_json
from scancell.progress import Stopwatch
from scancell.reconstruction.cloud_files import FORMATS, write_cloud
from scancell.reconstruction.reconstruct import ProfilePoints
from scancell.scanning.scan import ScanData
from scancell.scanning.sense import ExposureImages

# Files that scans and reconstructions write into the folder of their run, each some of them.
OPTIONAL_FILES = (
    *(f"cloud.{suffix}" for suffix in FORMATS),
    *("profiles.parquet", "recording.parquet", "points.parquet", "covariance.parquet"),
    *("plan.json", "deviation.json", "deviation.png", "deviation.html", "reconstruction.json", "images", "laser_off"),
)
_ROWS = 1 << 18  # of a table written at a time, which bounds the memory


def write_run(
    data: ScanData,
    deviation: Deviation,
    coverage: Coverage,
    unseen: UnseenSurface,
    folder: RunFolder,
    watch: Stopwatch,
    formats: Sequence[str],
    frame: CloudFrame,
    command_line: Sequence[str] | None,
) -> None:
    """Write all files of a scan: cloud, profiles, plan, recording, figures, report, pictures, descriptions, manifest.

    `formats`, `frame` and `command_line` are as of `ScanResult.save`.

    Raises
    ------
    OutputError
        If a file cannot be written.
    """
    run = _run_of(data, formats, frame, command_line)
    with watch.measure("write"):
        belt = data.setup.cell.part.arrival if data.setup.scan.belt else None
        moving = f" (moves with {belt.stands_on})" if belt and frame in ("part", "belt") else ""
        comments = (f"scancell scan of {data.part}", f"frame {frame}{moving}")
        pose = data.frame_from_part(frame)
        for suffix in formats:
            write_cloud(folder.path(f"cloud.{suffix}"), data.cloud, comments, pose)
        write_recording(data.recording, folder.path("recording.parquet"))
        index = data.recording.measured.index
        write_profiles(data.profiles, index, data.camera_names, folder.path("profiles.parquet"))
        if data.plan is not None:
            write_json(folder.path("plan.json"), plan_json(data.plan))
        figures = deviation.as_json(data.camera_names, data.segment_names)
        covered = {**coverage.as_json(), "unseen": unseen.shares}
        write_json(folder.path("deviation.json"), {**figures, "coverage": covered})
        folder.path("resolved.toml").write_text(resolved_toml(data.setup, run))
        files = [file for file in (data.world.part_file, data.world.recording_file) if file is not None]
        run |= {"fmu_token": data.fmu_token, "warnings": list(data.warnings), "points": data.dropped.as_json()}
        write_json(folder.path("manifest.json"), manifest(data.setup, files, run))
    with watch.measure("draw"):
        write_pictures(data, data.nominal.part, deviation, coverage, folder)
        scan_report(data, deviation, coverage, unseen, figures).write(folder.path("deviation.html"))


def _run_of(
    data: ScanData, formats: Sequence[str], frame: CloudFrame, command_line: Sequence[str] | None
) -> dict[str, Any]:
    """The inputs and options of a scan, from which the run can be repeated."""
    world = data.world
    run: dict[str, Any] = {
        "part": str(world.part_file.absolute()) if world.part_file else world.part,
        "unit": world.unit,
        "engine": data.engine,
        "as_built": list(world.as_built),
        "seed": world.seed,
        "formats": list(formats),
        "frame": frame,
        "command_line": command_words(command_line),
    }
    if world.recording_file is not None:
        run["recording"] = str(world.recording_file.absolute())
    if data.plan is not None and data.plan.source:
        run["plan"] = data.plan.source
    if world.estimated_sensor is not None:
        run["estimated_sensor"] = plain_data(world.estimated_sensor)
    return run


def scan_report(
    data: ScanData,
    deviation: Deviation,
    coverage: Coverage,
    unseen: UnseenSurface,
    figures: Mapping[str, Any],
) -> DeviationReport:
    """The page of a scan, with the `figures` of ``deviation.json`` by camera and view."""
    camera, segment, names = data.cloud.camera, data.cloud.segment, data.camera_names
    share = (coverage.surface_fraction, "surface")
    if coverage.measurable.any():
        share = (coverage.fraction, "measurable surface")
    tables = {
        "By camera": [{"camera": name, **own} for name, own in figures["by_camera"].items()],
        "By view": figures["by_segment"],
    }
    about = {
        "scancell": build_version(),
        "part": data.part,
        "engine": data.engine,
        "deviations of the true cell": ", ".join(data.as_built) or "none",
        "seed": str(data.seed),
    }
    return DeviationReport(
        data.part,
        data.cloud.points_in_part,
        deviation,
        data.nominal.part,
        unseen,
        share,
        tables,
        lambda row: f"{names[camera[row]]}, view {segment[row]}",
        data.warnings,
        about,
    )


def write_pictures(data: ScanData, part: Mesh, deviation: Deviation, coverage: Coverage, folder: RunFolder) -> None:
    """Write ``deviation.png`` and the sample images with the extracted stripe."""
    points, share = data.cloud.points_in_part, coverage.fraction
    picture = deviation_picture(points, deviation, part, name=data.part, coverage_fraction=share)
    picture.write(folder.path("deviation.png"))
    for sample in data.sample_images:
        picture = exposure_picture(sample.images, data.world.sensor, f"profile {sample.trigger}", sample.background)
        picture.write(folder.path(f"images/profile_{sample.trigger:05d}.png"))


def write_profiles(
    profiles: ProfilePoints,
    index: NDArray[np.int64],
    cameras: Sequence[str],
    path: Path,
    covariance: NDArray[np.float64] | None = None,
) -> None:
    """Write all points in the sensor frame as Parquet: lengths in mm; `profile` is the trigger index of (n,) `index`.

    With `covariance` (m, 3, 3), m², also its columns, see `covariance_columns`.
    """
    import pyarrow.parquet  # noqa: PLC0415  (takes 0.1 s to import)

    index = index.astype(np.int32)
    few_values = ["profile", "camera", "x_mm", "flags", "time_offset_s"]
    writer = None
    try:
        for start in range(0, max(len(profiles.frame), 1), _ROWS):
            rows = slice(start, start + _ROWS)
            points = 1e3 * np.asarray(profiles.points_in_sensor[rows], float)
            columns = {
                "profile": index[profiles.frame[rows]],
                "camera": np.asarray(profiles.camera[rows], np.uint8),
                "column": np.asarray(profiles.column[rows], np.int32),
                **{f"{axis}_mm": np.ascontiguousarray(points[:, i]) for i, axis in enumerate("xyz")},
                "sigma_mm": 1e3 * np.asarray(profiles.sigma[rows], np.float32),
                "intensity_dn": np.asarray(profiles.intensity[rows], np.float32),
                "flags": np.asarray(profiles.flags[rows], np.uint32),
                "time_offset_s": np.asarray(profiles.time_offset[rows], np.float32),
                **({} if covariance is None else covariance_columns(covariance[rows])),
            }
            table = arrow_table(columns)
            table = table.replace_schema_metadata({"frame": "sensor", "cameras": ",".join(cameras)})
            writer = writer or pyarrow.parquet.ParquetWriter(
                path, table.schema, compression="none", use_dictionary=few_values, write_statistics=False
            )
            writer.write_table(table)
    finally:
        if writer is not None:
            writer.close()


def covariance_columns(covariance: NDArray[np.float64], name: str = "covariance") -> dict[str, NDArray[np.float64]]:
    """Columns ``covariance_xx_mm2`` … of covariances (m, 3, 3), m²; `name` is their first word."""
    pairs = [(i, j) for i in range(3) for j in range(i, 3)]
    return {f"{name}_{'xyz'[i]}{'xyz'[j]}_mm2": np.ascontiguousarray(1e6 * covariance[:, i, j]) for i, j in pairs}


def write_json(path: Path, content: Any) -> None:
    """Write plain data as JSON, indented up to 100 000 characters."""
    text = json.dumps(content, indent=1)
    path.write_text((text if len(text) < 100_000 else json.dumps(content)) + "\n")


def write_shot(
    folder: RunFolder,
    profile: ProfilePoints,
    rows: NDArray[np.float64],
    points_in_part: NDArray[np.float64],
    images: ExposureImages | None,
    sensor: sensor_rt.Sensor,
) -> None:
    """Write ``profile.csv`` and, with images, one PNG per camera and ``stripes.png``.

    `rows` (n,) are the image rows of the points, px, and `points_in_part` (n, 3) the points in the part frame, m.

    Raises
    ------
    OutputError
        If a file cannot be written.
    """
    write_profile_csv(folder.path("profile.csv"), profile, rows, points_in_part)
    if images is None:
        return
    files = FrameFiles(folder, "", [camera.name for camera in sensor.cameras])
    files.add("image", images.images)
    if images.background is not None:
        files.add("image", images.background, "off", "laser_off")
    files.finish()
    exposure_picture(images.images, sensor, "shot", images.background).write(folder.path("stripes.png"))
