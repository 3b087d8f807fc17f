"""The result of the reconstruction of real measurements: figures, pictures, a run folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from scancell.arguments import LatencyMs, QuarterTurns, Threads, checked_arguments
from scancell.arrays import Array
from scancell.calibration.board.views import TABLES
from scancell.calibration.cell.points import belt_axes, stated_axes
from scancell.cell.recording import Recording, RecordLayout, write_recording
from scancell.config.cell import CellDescription
from scancell.config.choices import FlangeConvention, LatencyWord, LengthUnit
from scancell.config.files import Assignments, assignments
from scancell.config.loading import Setup, load_setup
from scancell.config.scan import ScanDescription
from scancell.config.sensor import SensorDescription, camera_label
from scancell.config.table_format import read_format, recognised_format
from scancell.errors import DescriptionError
from scancell.evaluation.alignment import PartPlacement
from scancell.evaluation.deviation import (
    Deviation,
    UnseenSurface,
    coverage,
    deviation_from_mesh,
    profile_spacing,
    unseen_surface,
)
from scancell.files import arrow_table
from scancell.geometry.mesh import Mesh
from scancell.nominal.cell import NominalCell
from scancell.nominal.parts import load_part
from scancell.output.deviation_report import DeviationReport, deviation_picture
from scancell.output.run_folder import (
    OPTIONAL_FILES,
    RunFolder,
    build_version,
    command_words,
    covariance_columns,
    manifest,
    resolved_toml,
    write_json,
    write_profiles,
)
from scancell.output.sheet import Sheet
from scancell.progress import Progress, ProgressCallback, as_progress
from scancell.reconstruction.cloud import Cloud
from scancell.reconstruction.cloud_files import parse_formats, write_cloud
from scancell.reconstruction.cloud_files.read import holds_cloud
from scancell.recorded.measurements import read_cloud_of, read_measurements
from scancell.recorded.reconstruct import (
    MeasuredCell,
    ReconstructedData,
    ValueCovariance,
    read_calibration,
    reconstruct_measurements,
    records_of,
    with_part_at,
    with_sensor_at,
)
from scancell.values import Result
from scancell.visibility import unknown_surface


@dataclass(frozen=True, eq=False, repr=False)
class ReconstructionResult(Result):
    """Cloud of real measurements.

    Attributes
    ----------
    data
        Cloud, readings and measurements.
    setup
        Descriptions, calibrated where a calibration was given.
    part
        Nominal part; None where none was given.
    inputs, run
        Files and settings for the manifest.
    camera_names
        By camera index.
    threads
        Number of threads of the evaluation.

    Examples
    --------
    >>> try:
    ...     result = scancell.reconstruct("profiles.csv", cell="calibrated.toml", sensor="sensor.toml")
    ...     print(result.cloud, result.covariance.shape)
    ... except scancell.DescriptionError as error:
    ...     print(error)
    calibrated.toml: no such file
    """

    data: ReconstructedData
    setup: Setup
    part: Mesh | None
    inputs: Sequence[Path]
    run: Mapping[str, Any]
    camera_names: tuple[str, ...]
    threads: int = field(default=0, compare=False)

    @property
    def cloud(self) -> Cloud:
        """Points in the frame of the part; without a part in that of the robot's base, with the table at 0."""
        return self.data.made.cloud

    @property
    def placement(self) -> PartPlacement | None:
        """Pose of the part on what carries it, where it was found from the points; None by the description."""
        return self.data.placement

    @property
    def covariance(self) -> Array:
        """Covariance (n, 3, 3) of the points of the cloud in its frame by the noise of the sensor alone, m²."""
        return self.data.covariance

    @property
    def systematic_covariance(self) -> Array | None:
        """Covariance (n, 3, 3) of the points by the uncertainty of calibrated values, m²; None without one.

        It adds to `covariance`. Points share its errors, so that means over points do not reduce it.
        """
        return self.data.systematic

    @property
    def warnings(self) -> list[str]:
        """Warnings about the result."""
        return list(self.data.warnings)

    @cached_property
    def deviation(self) -> Deviation | None:
        """Signed distances of the points from the part, m; None without one."""
        return None if self.part is None else deviation_from_mesh(self.cloud, self.part, self.threads)

    @property
    def figures(self) -> dict[str, Any]:
        """Plain figures, in the units that their names state."""
        data = self.data
        latency, systematic = data.latency, None
        if data.systematic is not None:
            # Standard deviations along the directions of largest uncertainty.
            largest = np.sqrt(np.maximum(np.linalg.eigvalsh(data.systematic)[:, -1], 0.0))
            systematic = 1e6 * float(np.median(largest))
        return {
            "exposures": len(data.found.index),
            "points": len(self.cloud),
            "frame": data.measured_cell.frame,
            "part_placement": None if self.placement is None else self.placement.as_json(),
            "dropped": data.made.dropped.as_json(),
            "sigma_median_um": 1e6 * float(np.median(np.asarray(self.cloud.sigma, float))),
            "systematic_sigma_median_um": systematic,
            "latency_ms": 1e3 * latency.value,
            "latency_half_width_ms": None if latency.half_width is None else 1e3 * latency.half_width,
            "deviation": None if self.deviation is None else self.deviation.figures.as_um(),
        }

    def summary(self) -> str:
        """The figures as lines of text."""
        figures, deviation, latency = self.figures, self.deviation, self.data.latency
        placement, support = self.placement, self.data.measured_cell.cell.support_kind
        where = "of the part" if self.data.measured_cell.has_part else "of the robot's base"
        lines = [f"{figures['exposures']} exposures: {len(self.cloud)} points in the frame {where}"]
        if placement is not None:
            lines.append(f"  {placement.text()}")
        if deviation is not None:
            lines.append(f"  deviation{deviation.figures.text()[1:]}")
            lines.append(f"  dropped    {self.data.made.dropped.low} points on the {support}")
        if figures["systematic_sigma_median_um"] is not None:
            lines.append(
                f"  systematic {figures['systematic_sigma_median_um']:.2f} um standard deviation, of all points"
            )
        if latency.half_width is not None:
            lines.append(f"  latency    {1e3 * latency.value:.4f} +- {1e3 * latency.half_width:.4f} ms (95 %)")
        elif latency.value:
            lines.append(f"  latency    {1e3 * latency.value:.4f} ms")
        return "\n".join(lines)

    def picture(self) -> bytes | None:
        """The deviation picture as PNG; None without a part."""
        return None if self.part is None or self.deviation is None else self._sheet(self.part, self.deviation).png()

    def _sheet(self, part: Mesh, deviation: Deviation) -> Sheet:
        return deviation_picture(self.cloud.points_in_part, deviation, part, name=Path(part.source).name)

    def _deviation_figures(self, deviation: Deviation) -> dict[str, Any]:
        return deviation.as_json(self.setup.camera_names, {1: "measured"}, self.setup.sensor_names)

    def _report(self, part: Mesh, deviation: Deviation) -> DeviationReport:
        """The page of the deviations; the measurable surface is not searched: any surface might be seen."""
        cell, sensor, cloud = self.data.measured_cell.cell, self.setup.sensor, self.cloud
        names = self.setup.camera_names
        poses = self.data.made.part_from_sensor
        surface = unknown_surface(cell, sensor, threads=self.threads)
        surface = replace(surface, measurable=np.ones(len(surface.samples), bool))
        spacing = profile_spacing(surface.samples, poses, np.ones(len(poses), np.int64))
        covered = coverage(cloud.points_in_part, surface, spacing, cloud.normals)
        if cell.support_kind == "belt":
            unseen = UnseenSurface.without_reason(
                surface.samples, covered.covered, surface.area, covered.tolerance,
                "reasons are determined only for a part that is turned",
            )  # fmt: skip
        elif len(poses) > 1:
            margin = 1e-3 * self.setup.scan.table_margin_mm
            unseen = unseen_surface(covered, surface, cell, sensor, poses, margin, self.threads)
        else:
            unseen = UnseenSurface.without_reason(
                surface.samples, covered.covered, surface.area, covered.tolerance, "a cloud without poses has no reason"
            )
        cameras = self._deviation_figures(deviation)["by_camera"].items()
        return DeviationReport(
            Path(part.source).name,
            cloud.points_in_part,
            deviation,
            part,
            unseen,
            (covered.surface_fraction, "surface"),
            {"By camera": [{"camera": name, **own} for name, own in cameras]},
            lambda row: (
                f"{names[camera_label(int(cloud.sensor[row]), int(cloud.camera[row]))]}, exposure {cloud.profile[row]}"
            ),
            self.warnings,
            {"scancell": build_version(), "part": Path(part.source).name},
        )

    @checked_arguments
    def save(
        self, folder: str | Path, formats: Sequence[str] = ("ply",), *, command_line: Sequence[str] | None = None
    ) -> list[Path]:
        """Write the run folder atomically, and return its files.

        Parameters
        ----------
        formats
            Formats of the cloud: ply, npz, laz, e57, pcd, xyz.
        command_line
            Words that the manifest keeps; by default those of this process.

        Raises
        ------
        OutputError
            If the folder cannot be written.
        DescriptionError
            If a format is unknown.
        """
        data, chosen = self.data, parse_formats(",".join(formats), "formats")
        run = {**self.run, "command_line": command_words(command_line)}
        with RunFolder(Path(folder), OPTIONAL_FILES) as files:
            comments = ("scancell reconstruct", f"frame {data.measured_cell.frame}{data.measured_cell.moving}")
            for suffix in chosen:
                write_cloud(files.path(f"cloud.{suffix}"), self.cloud, comments)
            self._write_covariance(files.path("covariance.parquet"))
            profiles = files.path("profiles.parquet")
            write_profiles(data.found.profiles, data.found.index, self.setup, profiles, data.found.covariance)
            data.found.write(files.path("points.parquet"))
            recording = self._recording()
            if recording is not None:
                write_recording(recording, files.path("recording.parquet"))
            if self.part is not None and self.deviation is not None:
                write_json(files.path("deviation.json"), self._deviation_figures(self.deviation))
                self._sheet(self.part, self.deviation).write(files.path("deviation.png"))
                self._report(self.part, self.deviation).write(files.path("deviation.html"))
            write_json(files.path("reconstruction.json"), self.figures)
            files.path("resolved.toml").write_text(resolved_toml(self.setup, run))
            entries = {**run, "warnings": self.warnings, "points": data.made.dropped.as_json()}
            write_json(files.path("manifest.json"), manifest(self.setup, self.inputs, entries))
        return files.paths

    def _write_covariance(self, path: Path) -> None:
        """Covariances of the points of the cloud, in its order and frame."""
        import pyarrow.parquet  # noqa: PLC0415  (takes 0.1 s to import)

        columns = covariance_columns(self.covariance)
        if self.data.systematic is not None:
            columns |= covariance_columns(self.data.systematic, "systematic")
        pyarrow.parquet.write_table(arrow_table(columns), path)

    def _recording(self) -> Recording | None:
        """Readings as trigger records for pictures; None where the described arm does not reach poses of the flange."""
        data = self.data
        records = records_of(data.measured_cell, data.found, data.readings)
        axes, flange = records.axes, data.readings.flange
        if flange is not None:
            reached = _joints_of_flange(data.measured_cell.cell, flange)
            if reached is None:
                return None
            axes = np.hstack([reached, axes[:, reached.shape[1] :]])
        columns: dict[str, Any] = {
            "trigger.index": records.index,
            "trigger.segment": records.segment,
            "trigger.time": records.time,
            "trigger.exposure": records.exposure,
        }
        cell = data.measured_cell.cell
        further = tuple(axis.name for axis in cell.further_axes)
        layout = RecordLayout(records.q.shape[1], further=further, conveyors=len(belt_axes(cell))).axes
        for names, position, rate in zip(layout.values(), axes.T, records.rates.T, strict=True):
            columns |= dict(zip(names, (position, rate), strict=True))
        return Recording(columns)

    def __repr__(self) -> str:
        return f"ReconstructionResult({len(self.data.found.index)} exposures, {len(self.cloud)} points)"


def calibrated_setup(
    cell: str | Path | CellDescription | None,
    sensor: str | Path | SensorDescription | None,
    calibration: str | Path | None,
    settings: list[str],
    scan: str | Path | ScanDescription | None = None,
) -> tuple[Setup, int, tuple[ValueCovariance, ...], list[Path]]:
    """Descriptions with what a calibration has found, quarter turns, uncertainty, and the files that were read.

    Raises `DescriptionError` if a file is wrong, or cell or sensor are given and calibrated.
    """
    if calibration is None:
        return load_setup(cell, sensor, scan, settings), 0, (), _files(cell, sensor, scan)
    calibration = Path(calibration)
    found = read_calibration(calibration)
    for key, given, own in (("cell", cell, found.cell), ("sensor", sensor, found.sensor)):
        if given is not None and own is not None:
            raise DescriptionError(
                f"conflicts with {own} of the calibration", key=key, value=str(given), expected="one of them"
            )
    setup = load_setup(cell or found.cell, sensor or found.sensor, scan, settings)
    if found.flange_from_sensor is not None:
        setup = Setup(with_sensor_at(setup.cell, found.flange_from_sensor), setup.sensor, setup.scan)
    file = calibration / "calibration.json" if calibration.is_dir() else calibration
    files = [*_files(cell or found.cell, sensor or found.sensor, scan), file]
    return setup, found.quarter_turns, found.uncertainty, files


def _files(*given: object) -> list[Path]:
    return [Path(item) for item in given if isinstance(item, str | Path)]


@checked_arguments
def reconstruct(
    data: str | Path,
    *,
    cell: str | Path | CellDescription | None = None,
    sensor: str | Path | SensorDescription | None = None,
    scan: str | Path | ScanDescription | None = None,
    settings: Assignments = (),
    part: str | Path | Mesh | None = None,
    unit: str = "mm",
    cloud_unit: LengthUnit | None = None,
    calibration: str | Path | None = None,
    flange: str | Path | None = None,
    table_format: str | Path | None = None,
    convention: FlangeConvention | None = None,
    laser_off: str | Path | None = None,
    quarter_turns: QuarterTurns | None = None,
    latency_ms: LatencyMs | LatencyWord | None = None,
    keep_all: bool = False,
    locate: bool = False,
    threads: Threads = 0,
    progress: Progress | ProgressCallback | None = None,
) -> ReconstructionResult:
    """Make a cloud with covariance from measurements of a real sensor on a robot (docs/measurements.md).

    The other parameters are those of `Scanner` and `Scanner.scan`.

    Parameters
    ----------
    data
        Table of profile points, profiles as a sensor writes them, or folder of images with a table of poses; with
        joints or poses of the flange. Or a cloud, surface or profiles without poses, whose frame is taken as that of
        the robot's base.
    part
        Nominal part, in whose frame the cloud is; without it the cloud is in the frame of the robot's base.
    cloud_unit
        Unit of a cloud: mm, m or inch; by default what the file states, or else mm.
    calibration
        Folder of results of a calibration: its cell, its sensor, and the pose of the sensor on the flange.
    flange
        Table of the flange poses of the exposures, if they are not in that of the points; or a program or list of a
        robot controller, whose poses are those of exposures 1, 2 and so on.
    table_format
        Format of the profiles: the name of a shipped one, or a file; by default by the content.
    convention
        Convention of orientations whose columns do not state it.
    laser_off
        Folder of background images to subtract.
    quarter_turns
        Counter-clockwise, from the images to those of the described camera; by default those of the calibration.
    latency_ms
        Delay of the exposures after the joints, or ``estimate`` to find it from the part; by default that of the cell.
    keep_all
        With a part: keep points of the table and of its neighbours.
    locate
        Find the pose of the part on what carries it by the best fit of its mesh to the points, from any turn about the
        support's z; by default it is where the description places it.

    Raises
    ------
    ScancellError
        Naming what is wrong and what was expected; `CalibrationError` where the measurements disagree with the part or
        do not determine the delay, `EmptyScanError` where no point is left.

    Examples
    --------
    >>> try:
    ...     result = scancell.reconstruct("profiles.csv", part="part.stl")
    ... except scancell.DescriptionError as error:
    ...     print(error)
    profiles.csv: no such file
    """
    reporter, data = as_progress(progress), Path(data)
    setup, turns, uncertainty, inputs = calibrated_setup(cell, sensor, calibration, assignments(settings), scan)
    mesh = part.usable if isinstance(part, Mesh) else None if part is None else load_part(part, unit)
    form = None if table_format is None else read_format(table_format)
    is_cloud = form is None and data.is_file() and holds_cloud(data)
    has_poses = any((data / name).is_file() for name in TABLES)  # of images
    if form is None and not is_cloud and not has_poses and data.exists():
        form = recognised_format(data)
    further, missing = stated_axes(setup)
    needs_arm = "q1_deg" not in missing(np.zeros(0))
    if is_cloud or (form is not None and form.layout != "ros_bag" and flange is None and needs_arm):
        if setup.scan.belt is not None:
            raise DescriptionError(
                "a cloud without poses states no travel of the belt", file=data, key="scan.belt",
                expected="profiles with joints, poses of the flange, or a sensor that the arm does not carry",
            )  # fmt: skip
        needless = {"flange": flange, "convention": convention, "laser_off": laser_off, "quarter_turns": quarter_turns}
        for key, value in needless.items():
            if value is not None:
                raise DescriptionError("does not apply to a cloud without poses", key=key, value=str(value))
        if form is not None and cloud_unit is not None:
            raise DescriptionError("applies to a cloud; the format states its units", key="cloud_unit")
        found = read_cloud_of(data, cloud_unit, MeasuredCell.of(setup, mesh).cell, form)
    elif cloud_unit is not None:
        raise DescriptionError(
            "applies to a cloud; the names of columns of a table state their units", key="cloud_unit", value=cloud_unit
        )
    else:
        found = read_measurements(
            data,
            setup.sensor,
            len(setup.cell.robot.joint),
            further,
            flange=None if flange is None else Path(flange),
            convention=convention,
            laser_off=None if laser_off is None else Path(laser_off),
            quarter_turns=(turns if data.is_dir() and form is None else 0) if quarter_turns is None else quarter_turns,
            threads=threads,
            progress=reporter,
            form=form,
            missing=missing,
        )
    reporter.stage("reconstructing", 1, "cloud")
    latency = latency_ms if latency_ms is None or isinstance(latency_ms, str) else 1e-3 * latency_ms
    made = reconstruct_measurements(found, setup, mesh, latency, keep_all, threads, uncertainty, locate)
    if made.placement is not None and mesh is not None:
        setup = with_part_at(setup, mesh, made.placement.support_from_part)
    reporter.advance(1)
    file = None if part is None or isinstance(part, Mesh) else Path(part)
    run = {
        "part": str(file.absolute()) if file is not None else "" if mesh is None else mesh.source,
        "unit": unit,
        "measured": str(data.absolute()),
        "latency_ms": 1e3 * made.latency.value,
        "keep_all": keep_all,
        "locate": locate,
    }
    names = tuple(camera.name for camera in setup.sensor.camera)
    files = [*inputs, *found.files, *([] if file is None else [file])]
    return ReconstructionResult(made, setup, mesh, tuple(files), run, names, threads)


def _joints_of_flange(cell: NominalCell, flange: Array) -> Array | None:
    """Joints (n, joints), rad, at which the arm holds its flange at poses (n, 4, 4) of the base; None if it cannot.

    The solution nearest to the joints before is chosen.
    """
    branches = cell.arm.ik(cell.arm.world_from_base @ flange, reference=cell.home)
    found, at = np.empty((len(flange), len(cell.home))), cell.home
    for row, choices in enumerate(branches):
        travel = np.nan_to_num(np.abs(choices - at).max(1), nan=np.inf)
        if not np.isfinite(travel.min()):
            return None
        at = found[row] = choices[travel.argmin()]
    return found
