"""A scan: plan, drive, sense, reconstruct; and its data, before evaluation.

Nothing else composes these steps: `Scanner`, studies, calibration and the live cell scan by `Scan`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scancell.arguments import checked_arguments
from scancell.cell.recording import Recording
from scancell.config.choices import CloudFrame, Engine
from scancell.config.loading import Setup
from scancell.config.sensor import SensorDescription, ignored_by_geometric_engine
from scancell.errors import DescriptionError, EmptyScanError
from scancell.geometry import pose
from scancell.geometry.shapes import PartSurface
from scancell.nominal.cell import Body, NominalCell
from scancell.planning.path_map.configuration_map import QualityFactor
from scancell.planning.plan import Plan
from scancell.progress import Progress
from scancell.reconstruction.cloud import Cloud
from scancell.reconstruction.reconstruct import Dropped, ProfilePoints, table_warnings, why_empty
from scancell.scanning.drive import PreScanHook
from scancell.scanning.exposure_control import ExposureControl
from scancell.scanning.pipeline import ScanPipeline, envelope_of, measured_motion
from scancell.scanning.sense import ExposureImages, OnImages, SensingResult, sample_rows
from scancell.scanning.world import Sensors, World
from scancell.stopwatch import Stopwatch
from scancell.values import Value

Array = NDArray[np.float64]

SAMPLE_IMAGES = 4


@dataclass(frozen=True, eq=False, repr=False)
class ScanData(Value):
    """Inputs, recording and cloud of a scan; see `ScanResult` for the attributes."""

    part: str
    setup: Setup
    engine: Engine
    seed: int
    as_built: tuple[str, ...]
    nominal: NominalCell
    estimated: NominalCell
    sensors: Sensors
    plan: Plan | None
    recording: Recording
    profiles: ProfilePoints
    cloud: Cloud
    dropped: Dropped
    sample_images: tuple[ExposureImages, ...] = ()
    render_seconds: dict[str, float] = field(default_factory=dict, compare=False)
    timings: dict[str, float] = field(default_factory=dict, compare=False)
    warnings: tuple[str, ...] = ()
    fmu_token: str = ""
    part_file: Path | None = None
    recording_file: Path | None = None
    unit: str = "mm"
    threads: int = 0
    part_surface: PartSurface | None = field(default=None, compare=False)
    estimated_sensor: SensorDescription | None = None

    @property
    def segment_names(self) -> dict[int, str]:
        """Names of the segments by id; the ids as text when an existing recording was rendered."""
        if self.plan is not None:
            return self.plan.program.names
        return {int(number): str(number) for number in np.unique(self.recording.measured.segment)}

    @property
    def camera_names(self) -> list[str]:
        """Names of the cameras, by camera index."""
        return [camera.name for camera in self.sensors.nominal.cameras]

    @checked_arguments
    def frame_from_part(self, frame: CloudFrame, table_angle: float = 0.0) -> Array:
        """Estimated pose (4, 4) of the part in a frame, with the table at `table_angle` (rad).

        In a scan on a belt the part moves with the frame ``belt``, whose origin is that of the belt's frame at the
        start; world and base are those where the part started.

        Raises `DescriptionError` if `frame` is not part, world, base, or what carries the part: table or belt.
        """
        cell = self.estimated
        support = "table" if cell.support == "table" else "belt"
        if frame in ("table", "belt") and frame != support:
            raise DescriptionError(key="frame", value=frame, expected=f"part, {support}, base or world")
        world_from_part = cell.world_from("part", [*cell.home, table_angle])
        match frame:
            case "part":
                return np.eye(4)
            case "table" | "belt":
                return cell.support_from_part
            case "world":
                return world_from_part
            case "base":
                return np.asarray(pose.inverse(cell.arm.world_from_base) @ world_from_part)

    @property
    def part_from_sensor(self) -> Array:
        """Nominal pose (n, 4, 4) of the sensor in the frame of the part at the measurements of each exposure."""
        return self.nominal.part_from_sensor(measured_motion(self.nominal, self.recording).axes)

    @checked_arguments
    def points_in(self, frame: CloudFrame, table_angle: float = 0.0) -> Array:
        """Points (n, 3) of the cloud in a frame, m, with the table at `table_angle` rad; see `frame_from_part`."""
        return pose.transform_points(self.frame_from_part(frame, table_angle), self.cloud.points_in_part)


@dataclass(frozen=True)
class Exposed:
    """A recording with its profiles, the images of a few exposures, and the token of the FMU that made it."""

    recording: Recording
    sensed: SensingResult
    images: tuple[ExposureImages, ...]
    fmu_token: str


@dataclass(frozen=True)
class Scan:
    """A scan of a part in the cell.

    Attributes
    ----------
    on_images
        Receives the images of every exposure.
    setup_warnings
        What is doubtful about the descriptions.
    normals, samples
        Whether to estimate normals, and to keep the images of a few exposures.
    """

    pipeline: ScanPipeline
    world: World
    engine: Engine
    on_images: OnImages | None = None
    setup_warnings: tuple[str, ...] = ()
    normals: bool = True
    samples: bool = True

    def run(
        self, saved: Plan | None, progress: Progress, watch: Stopwatch, hook: PreScanHook | None = None
    ) -> ScanData:
        """Plan, or check the `saved` plan again, drive, sense and reconstruct; see `Scanner.scan` for errors."""
        with watch.measure("plan"):
            plan = self.plan(progress, saved)
        with watch.measure("drive"):
            recording = self.pipeline.drive(self.world, plan, progress, hook)
        return self.of_recording(recording, plan, progress, watch)

    def plan(
        self, progress: Progress, saved: Plan | None = None, quality_factors: Sequence[QualityFactor] = ()
    ) -> Plan:
        """The plan, or the `saved` one checked again, see `ScanPipeline.plan`."""
        progress.stage("planning", 1, "plan")
        plan = self.pipeline.plan(self.world, saved, quality_factors, progress)
        progress.advance(1)
        return plan

    def measure(self, plan: Plan, progress: Progress) -> tuple[Recording, SensingResult]:
        """Drive and sense a plan of which no cloud is wanted."""
        recording = self.pipeline.drive(self.world, plan, progress)
        return recording, self.sense(recording, progress, [])[0]

    def of_recording(self, recording: Recording, plan: Plan | None, progress: Progress, watch: Stopwatch) -> ScanData:
        """Sense and reconstruct a recording, whose `plan` may be unknown.

        Raises `EmptyScanError` when no point of the part is found.
        """
        rows = sample_rows(len(recording), SAMPLE_IMAGES) if self.samples else []
        with watch.measure("sense"):
            sensed, kept = self.sense(recording, progress, rows)
        return self.of_profiles(Exposed(recording, sensed, kept, self.pipeline.runner.token), plan, progress, watch)

    def of_profiles(self, exposed: Exposed, plan: Plan | None, progress: Progress, watch: Stopwatch) -> ScanData:
        """Reconstruct exposures that are sensed; see `of_recording`."""
        with watch.measure("reconstruct"):
            progress.stage("reconstructing", 1, "cloud")
            profiles = exposed.sensed.profiles
            cloud, dropped = self._reconstruct(exposed.recording, profiles, self.normals)
            progress.advance(1)
        return self._data(exposed, cloud, dropped, plan, watch)

    def of_parts(self, exposed: Exposed, cloud: Cloud, dropped: Dropped, plan: Plan, watch: Stopwatch) -> ScanData:
        """As `of_profiles`, of exposures of which `points_of` gave the cloud and what was dropped, part by part."""
        with watch.measure("reconstruct"):
            cloud = self.pipeline.with_normals(self.world.estimated, exposed.recording, cloud)
        return self._data(exposed, cloud, dropped, plan, watch)

    def _reconstruct(self, recording: Recording, profiles: ProfilePoints, normals: bool) -> tuple[Cloud, Dropped]:
        return self.pipeline.reconstruct(self.world.estimated, recording, profiles, self.world.setup, normals)

    def _data(self, exposed: Exposed, cloud: Cloud, dropped: Dropped, plan: Plan | None, watch: Stopwatch) -> ScanData:
        world, sensed = self.world, exposed.sensed
        if not len(cloud):
            reasons = why_empty(dropped, envelope_of(world.estimated, world.setup))
            raise EmptyScanError(f"the scan gave no point: {'; '.join(reasons)}", file=world.part)
        return ScanData(
            part=world.part,
            setup=world.setup,
            engine=self.engine,
            seed=world.seed,
            as_built=world.as_built,
            nominal=world.nominal,
            estimated=world.estimated,
            sensors=world.sensors,
            plan=plan,
            recording=exposed.recording,
            profiles=sensed.profiles,
            cloud=cloud,
            sample_images=exposed.images,
            render_seconds=sensed.timings,
            timings=watch.seconds,
            dropped=dropped,
            warnings=(*self._warnings(plan), *table_warnings(dropped, world.setup.scan.table_margin_mm)),
            fmu_token=exposed.fmu_token if plan is not None else "",
            part_file=world.part_file,
            recording_file=world.recording_file,
            unit=world.unit,
            threads=self.pipeline.threads,
            part_surface=world.part_surface,
            estimated_sensor=world.estimated_sensor,
        )

    def points_of(self, recording: Recording, sensed: SensingResult) -> tuple[Cloud, Dropped]:
        """The part of the cloud that some of the exposures give, without normals, and what was dropped."""
        return self._reconstruct(recording, sensed.profiles, normals=False)

    def sense(
        self, recording: Recording, progress: Progress, rows: Sequence[int], control: ExposureControl | None = None
    ) -> tuple[SensingResult, tuple[ExposureImages, ...]]:
        """Profiles, and the images of those in `rows`; `on_images` receives the images of all.

        `control` is that of `scancell.scanning.sense.sense`.
        """
        on_images = self.on_images
        if on_images is not None and self.engine == "geometric":
            raise DescriptionError("makes no images to keep", key="engine", value="geometric", expected="ray-traced")
        chosen = set(recording.measured.index[rows].tolist())
        kept: list[ExposureImages] = []

        def keep(images: ExposureImages) -> None:
            if on_images is not None:
                on_images(images)
            if images.trigger in chosen:
                kept.append(images)

        wanted = rows if on_images is None else None
        sensed = self.pipeline.sense(self.world, recording, self.engine, progress, keep, wanted, control)
        return sensed, tuple(kept)

    def _translucent(self) -> list[str]:
        """Names of the translucent bodies."""
        bodies = [body for body in self.world.bodies if isinstance(body, Body)]
        return [body.name for body in bodies if any(m.scattering_per_mm for m in body.materials)]

    def _warnings(self, plan: Plan | None) -> tuple[str, ...]:
        """Warnings about descriptions, mesh and plan."""
        ignored = []
        if self.engine == "geometric":
            ignored = ignored_by_geometric_engine(self.world.setup.sensor)
            ignored += [f"scattering_per_mm of {name}" for name in self._translucent()]
        unused = (f"the geometric engine ignores {', '.join(ignored)}",) if ignored else ()
        planned = plan.warnings if plan is not None else ()
        return (*self.setup_warnings, *unused, *self.world.nominal.part.warnings, *planned)
