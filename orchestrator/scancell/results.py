"""Results of scans and shots: evaluation, files, pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np

from scancell.arguments import Count, checked_arguments, checked_fields
from scancell.cell.recording import write_recording
from scancell.config.choices import CloudFrame
from scancell.config.files import plain_data
from scancell.config.sensor import camera_label
from scancell.evaluation.deviation import (
    Coverage,
    Deviation,
    DeviationFigures,
    UnseenSurface,
    coverage,
    deviation_from_mesh,
    profile_spacing,
    unseen_surface,
)
from scancell.output.deviation_report import DeviationReport, deviation_picture
from scancell.output.image_files import FrameFiles
from scancell.output.pictures import exposure_picture
from scancell.output.run_folder import (
    OPTIONAL_FILES,
    RunFolder,
    SavedResult,
    build_version,
    command_words,
    manifest,
    resolved_toml,
    write_json,
    write_profiles,
)
from scancell.output.sheet import Sheet
from scancell.output.tables import write_profile_csv
from scancell.planning.plan import plan_json
from scancell.progress import NullProgress, Progress, ProgressCallback, Stopwatch, as_progress
from scancell.reconstruction.cloud_files import parse_formats, write_cloud
from scancell.scanning.scan import ScanData
from scancell.scanning.session import Profile
from scancell.scanning.world import World
from scancell.values import Result
from scancell.visibility import (
    COVERAGE_SAMPLES,
    MeasurableSurface,
    cache_folder,
    measurable_surface,
    unknown_surface,
)


@checked_fields
@dataclass(frozen=True, eq=False, repr=False)
class ScanResult(ScanData, Result):
    """A scan with its evaluation, which is computed on first access.

    Attributes
    ----------
    world
        The part in the cell, and its sensor: descriptions, nominal and calibrated cell, deviations, seed, files.
    part, setup, nominal, as_built, seed
        Name of the part, nominal descriptions and cell, deviations of the true cell and random seed; of the world.
    engine
        That sensed the exposures.
    plan
        None when an existing recording was rendered.
    recording
        Trigger records, measured and, apart from these, true.
    profiles
        All points in the sensor frame.
    cloud
        Points of the part in the part frame, m.
    dropped
        Counts of the measured points that are not the part's: table, neighbours, beyond the envelope.
    sample_images
        Images of a few exposures; ray-traced engine only.
    render_seconds, timings
        Processor time of the ray tracer and wall time, by step, s.
    warnings
        About descriptions, meshes and the plan.
    fmu_token
        Instantiation token of the FMU; empty when an existing recording was rendered.
    threads
        Number of threads of the evaluation.

    Examples
    --------
    >>> result = scancell.scan("part.stl", engine="geometric", settings={"scan.max_profiles": 40})
    >>> print(result)
    part.stl: 34 profiles, ... points...
      deviation  mean ... um, RMS ... um, ...
    >>> files = result.save("run", formats=["ply", "e57"])
    """

    @cached_property
    def deviation(self) -> Deviation:
        """Signed distance of every point of the cloud to the surface of the part, with figures in metres."""
        with Stopwatch(self.timings).measure("evaluate"):
            return deviation_from_mesh(self.cloud, self.world.part_surface, self.threads)

    @cached_property
    def coverage(self) -> Coverage:
        """Share of the measurable surface that the cloud covers."""
        return self.coverage_of(COVERAGE_SAMPLES)

    @checked_arguments
    def coverage_of(self, samples: Count, surface: MeasurableSurface | None = None) -> Coverage:
        """Coverage by a number of surface samples, at most 20 000.

        Parameters
        ----------
        surface
            Measurable surface of the part in another cell, such as the cell that a study starts from.
        """
        measured, surface = self.recording.measured, surface or self.measurable
        with Stopwatch(self.timings).measure("evaluate"):
            spacing = profile_spacing(surface.samples, self.part_from_sensor, measured.segment)
            return coverage(self.cloud.points_in_part, surface.thinned(samples), spacing, self.cloud.normals)

    @cached_property
    def measurable(self) -> MeasurableSurface:
        """Surface that the sensor can measure from at least one pose that the arm reaches; cached on disk.

        Of a part on a belt or on a fixed table it is unknown: nothing counts as measurable.
        """
        return self._find_measurable(NullProgress())

    @property
    def _turns_part(self) -> bool:
        """Whether what carries the part turns it, as the search for measurable surface assumes."""
        return self.setup.scan.belt is None and (self.nominal.holds_part or self.nominal.table_turns)

    def _find_measurable(self, progress: Progress) -> MeasurableSurface:
        if not self._turns_part:
            return unknown_surface(self.nominal, self.setup.sensor, COVERAGE_SAMPLES, self.threads)
        with Stopwatch(self.timings).measure("measurable surface"):
            return measurable_surface(
                self.nominal, self.setup.sensor, COVERAGE_SAMPLES, progress, cache_folder(), self.threads
            )

    @checked_arguments
    def evaluate(self, progress: Progress | ProgressCallback | None = None) -> Self:
        """Compute deviation and coverage now, with progress; without this call, on first access.

        Raises
        ------
        CancelledError
            When `progress` cancels.
        """
        reporter = as_progress(progress)
        if "measurable" not in self.__dict__:
            self.__dict__["measurable"] = self._find_measurable(reporter)
        reporter.stage("evaluating", 2, "steps")
        _ = self.deviation
        reporter.advance(1)
        _ = self.coverage
        reporter.advance(1)
        return self

    @cached_property
    def unseen(self) -> UnseenSurface:
        """Surface that no point of the cloud covers, by the reason; on a belt or a fixed table without reasons."""
        covered = self.coverage
        if not self._turns_part:
            why = "reasons are determined only for a part that is turned"
            area, tolerance = covered.surface_area, covered.tolerance
            return UnseenSurface.without_reason(covered.samples_in_part, covered.covered, area, tolerance, why)
        with Stopwatch(self.timings).measure("evaluate"):
            margin, sensor = 1e-3 * self.setup.scan.table_margin_mm, self.setup.sensor
            poses = self.part_from_sensor
            return unseen_surface(covered, self.measurable, self.nominal, sensor, poses, margin, self.threads)

    @property
    def points_without_normal(self) -> int:
        """Number of points whose normal could not be estimated."""
        return int(np.isnan(self.cloud.normals[:, 0]).sum())

    @property
    def figures(self) -> dict[str, Any]:
        """Counts, deviation and coverage; see `Result.figures`."""
        covered, by_sensor = self.coverage, self.by_sensor
        return {
            "profiles": len(self.recording),
            "points": len(self.cloud),
            "points_without_normal": self.points_without_normal,
            "points_on_table": self.dropped.low,
            "points_on_neighbours": dict(self.dropped.foreign),
            "deviation": self.deviation.figures.as_um(),
            **({"sensors": {name: own.as_um() for name, own in by_sensor.items()}} if len(by_sensor) > 1 else {}),
            "coverage": None if np.isnan(covered.fraction) else covered.fraction,
            "stations_s": self.render_seconds,
        }

    @property
    def by_sensor(self) -> dict[str, DeviationFigures]:
        """Figures of the distances of the points of each sensor, by its name, m."""
        own = self.deviation.by_sensor or {1: self.deviation.figures}
        nothing = DeviationFigures.of(np.zeros(0))
        return {name: own.get(number, nothing) for number, name in enumerate(self.sensor_names, 1)}

    def summary(self) -> str:
        """The figures as lines of text."""
        figures, bare, covered = self.deviation.figures, self.points_without_normal, self.coverage
        support, share = self.nominal.support_kind, f"{covered.surface_fraction:.1%} of the whole surface"
        if self._turns_part:
            share = f"{covered.fraction:.1%} of the measurable surface, {covered.surface_fraction:.1%} of the whole"
        signed = "" if self.deviation.is_signed else " (unsigned: the mesh is not closed)"
        um = 1e6
        lines = [
            f"{self.part}: {len(self.recording)} profiles, {len(self.cloud)} points"
            + (f", {bare} of them without a normal (isolated, or seen at grazing incidence)" if bare else ""),
            f"  deviation  mean {figures.mean * um:+.2f} um, RMS {figures.rms * um:.2f} um, "
            f"95 % within {figures.d95 * um:.1f} um, 99.9 % within {figures.d99_9 * um:.1f} um, "
            f"max {figures.max_abs * um:.1f} um{signed}",
            *(
                f"  sensor     {name}: {one.count} points" + (f", RMS {one.rms * um:.2f} um" if one.count else "")
                for name, one in self.by_sensor.items()
                if len(self.sensor_names) > 1
            ),
            f"  dropped    {self.dropped.low} points on the {support}{self._kept_low}",
            *(f"  dropped    {count} points on '{name}'" for name, count in self.dropped.foreign.items()),
            f"  coverage   {share}",
        ]
        return "\n".join(lines)

    @property
    def _kept_low(self) -> str:
        low, raised = self.dropped.kept_low, self.dropped.raised
        kept = f"; {low} as low are on the part by its nominal outline" if low else ""
        margin = f"scan.table_margin_mm = {self.setup.scan.table_margin_mm:g}"
        above = f"; {raised} of them lie above the noise of the table, lower than {margin}" if raised else ""
        return kept + above

    @checked_arguments
    def save(
        self,
        folder: str | Path,
        formats: Sequence[str] = ("ply",),
        *,
        frame: CloudFrame = "part",
        command_line: Sequence[str] | None = None,
    ) -> list[Path]:
        """Write the run folder atomically, and return its files.

        Parameters
        ----------
        formats
            Formats of the cloud: ply, npz, laz, e57, pcd, xyz.
        frame
            Frame of the points in the cloud files: part, table, base or world (with the table at 0); in a scan on a
            belt: part, belt, base or world (with the belt at the start).
        command_line
            Words that the manifest keeps; by default those of this process.

        Raises
        ------
        OutputError
            If the folder cannot be written.
        DescriptionError
            If a format or frame is unknown.
        """
        with RunFolder(Path(folder), OPTIONAL_FILES) as run:
            self.save_into(run, formats, frame=frame, command_line=command_line)
        return run.paths

    def save_into(
        self,
        folder: RunFolder,
        formats: Sequence[str],
        *,
        frame: CloudFrame = "part",
        command_line: Sequence[str] | None = None,
    ) -> None:
        """Write the files of `ScanResult.save` into an open `folder`, and leave it open."""
        formats = parse_formats(",".join(formats), "formats")
        deviation, coverage, unseen = self.deviation, self.coverage, self.unseen
        run, watch, world = self._run(formats, frame, command_line), Stopwatch(self.timings), self.world
        with watch.measure("write"):
            belt = self.setup.cell.part.arrival if self.setup.scan.belt else None
            moving = f" (moves with {belt.stands_on})" if belt and frame in ("part", "belt") else ""
            comments = [f"scancell scan of {self.part}", f"frame {frame}{moving}"]
            if len(self.sensor_names) > 1:
                comments.append(f"sensors {', '.join(self.sensor_names)}")
            pose = self.frame_from_part(frame)
            for suffix in formats:
                write_cloud(folder.path(f"cloud.{suffix}"), self.cloud, comments, pose)
            write_recording(self.recording, folder.path("recording.parquet"))
            index = self.recording.measured.index
            write_profiles(self.profiles, index, self.setup, folder.path("profiles.parquet"))
            if self.plan is not None:
                write_json(folder.path("plan.json"), plan_json(self.plan))
            figures = deviation.as_json(self.setup.camera_names, self.segment_names, self.sensor_names)
            covered = {**coverage.as_json(), "unseen": unseen.shares}
            write_json(folder.path("deviation.json"), {**figures, "coverage": covered})
            folder.path("resolved.toml").write_text(resolved_toml(self.setup, run))
            files = [file for file in (world.part_file, world.recording_file) if file is not None]
            run |= {"fmu_token": self.fmu_token, "warnings": list(self.warnings), "points": self.dropped.as_json()}
            write_json(folder.path("manifest.json"), manifest(self.setup, files, run))
        with watch.measure("draw"):
            self._sheet().write(folder.path("deviation.png"))
            for sample in self.sample_images:
                title, own = f"profile {sample.trigger}", world.sensors[sample.sensor - 1]
                title, place = (title, "") if sample.sensor == 1 else (f"{title}, {own.name}", f"{own.name}/")
                sheet = exposure_picture(sample.images, own.sensor, title, sample.background)
                sheet.write(folder.path(f"images/{place}profile_{sample.trigger:05d}.png"))
            self._report(figures).write(folder.path("deviation.html"))

    def _run(self, formats: Sequence[str], frame: CloudFrame, command_line: Sequence[str] | None) -> dict[str, Any]:
        """The inputs and options of the scan, from which the run can be repeated."""
        world = self.world
        run: dict[str, Any] = {
            "part": str(world.part_file.absolute()) if world.part_file else world.part,
            "unit": world.unit,
            "engine": self.engine,
            "as_built": list(world.as_built),
            "seed": world.seed,
            "formats": list(formats),
            "frame": frame,
            "command_line": command_words(command_line),
        }
        if world.recording_file is not None:
            run["recording"] = str(world.recording_file.absolute())
        if self.plan is not None and self.plan.source:
            run["plan"] = self.plan.source
        if world.estimated_sensor is not None:
            run["estimated_sensor"] = plain_data(world.estimated_sensor)
        return run

    def _report(self, figures: Mapping[str, Any]) -> DeviationReport:
        """The page of the deviations, with the `figures` of ``deviation.json`` by camera and view."""
        cloud, names = self.cloud, self.setup.camera_names
        share = (self.coverage.surface_fraction, "surface")
        if self.coverage.measurable.any():
            share = (self.coverage.fraction, "measurable surface")
        tables = {
            "By camera": [{"camera": name, **own} for name, own in figures["by_camera"].items()],
            "By view": figures["by_segment"],
        }
        if "by_sensor" in figures:
            tables = {"By sensor": [{"sensor": name, **own} for name, own in figures["by_sensor"].items()], **tables}
        about = {
            "scancell": build_version(),
            "part": self.part,
            "engine": self.engine,
            "deviations of the true cell": ", ".join(self.as_built) or "none",
            "seed": str(self.seed),
        }
        return DeviationReport(
            self.part,
            self.cloud.points_in_part,
            self.deviation,
            self.nominal.part,
            self.unseen,
            share,
            tables,
            lambda row: (
                f"{names[camera_label(int(cloud.sensor[row]), int(cloud.camera[row]))]}, view {cloud.segment[row]}"
            ),
            self.warnings,
            about,
        )

    def _sheet(self) -> Sheet:
        part, share = self.nominal.part, self.coverage.fraction
        return deviation_picture(
            self.cloud.points_in_part, self.deviation, part, name=self.part, coverage_fraction=share
        )

    def picture(self) -> bytes:
        """The deviation picture as PNG."""
        return self._sheet().png()

    def __repr__(self) -> str:
        return (
            f"ScanResult({self.part!r}, engine={self.engine!r}, seed={self.seed}: {len(self.recording)} profiles, "
            f"{len(self.cloud)} points)"
        )


@checked_fields
@dataclass(frozen=True, eq=False, repr=False)
class ShotResult(Profile, SavedResult):
    """One exposure from a given pose; `save` writes ``profile.csv`` and the images.

    Attributes
    ----------
    profile
        Points in the sensor frame with camera, column, sigma and intensity.
    rows
        (m,) image rows of the points, px.
    points_in_base, points_in_part
        (m, 3) the same points in the frames of base and part, m.
    images
        Camera images, ray-traced engine only.
    world
        The part in the cell, and its sensor.
    warnings
        Why the arm is left out, or nothing is seen.

    Examples
    --------
    >>> shot = scancell.shot("part.stl", scancell.location(0, 0, 0.1, rx=180 * scancell.deg), engine="geometric")
    >>> shot.camera_counts
    {'plus': ..., 'minus': ...}
    """

    world: World
    warnings: tuple[str, ...]

    @property
    def figures(self) -> dict[str, Any]:
        """Numbers of points."""
        return {"points": len(self.points_in_part), "by_camera": self.camera_counts}

    def summary(self) -> str:
        """The number of points as a line of text."""
        return f"{Path(self.world.part).name}: {len(self.points_in_part)} points"

    @property
    def camera_counts(self) -> dict[str, int]:
        """Number of points by camera name."""
        camera = self.profile.camera
        return {one.name: int((camera == k).sum()) for k, one in enumerate(self.world.sensor.cameras)}

    def picture(self) -> bytes | None:
        """The images with the stripe that was found, as PNG; None of the geometric engine."""
        images = self.images
        if images is None:
            return None
        return exposure_picture(images.images, self.world.sensor, "shot", images.background).png()

    def _write(self, folder: RunFolder, command_line: list[str]) -> None:
        sensor, images = self.world.sensor, self.images
        write_profile_csv(folder.path("profile.csv"), self.profile, self.rows, self.points_in_part)
        if images is None:
            return
        files = FrameFiles(folder, "", [camera.name for camera in sensor.cameras])
        files.add("image", images.images)
        if images.background is not None:
            files.add("image", images.background, "off", "laser_off")
        files.finish()
        exposure_picture(images.images, sensor, "shot", images.background).write(folder.path("stripes.png"))
