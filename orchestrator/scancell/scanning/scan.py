"""A scan: plan, drive, sense, reconstruct.

Nothing else composes these steps: `Scanner`, studies, calibration and the live cell scan by `Scan`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from scancell.cell.recording import Recording
from scancell.config.choices import Engine
from scancell.config.estimated import EstimatedDescription
from scancell.config.sensor import ignored_by_geometric_engine
from scancell.errors import DescriptionError, EmptyScanError
from scancell.nominal.estimated import estimated_cell
from scancell.planning.path_map.configuration_map import QualityFactor
from scancell.planning.plan import Plan
from scancell.progress import Progress
from scancell.reconstruction.cloud import Cloud
from scancell.reconstruction.reconstruct import table_warnings, why_empty
from scancell.scanning.drive import PreScanHook
from scancell.scanning.job import Job
from scancell.scanning.pipeline import ScanPipeline, envelope_of
from scancell.scanning.result import ScanData
from scancell.scanning.sense import ExposureImages, OnImages, SensingResult, sample_rows
from scancell.stopwatch import Stopwatch

SAMPLE_IMAGES = 4


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
    estimated
        Deviations of the cell that reconstruction assumes, in place of those of its description.
    on_images
        Receives the images of every exposure.
    setup_warnings
        What is doubtful about the descriptions.
    normals, samples
        Whether to estimate normals, and to keep the images of a few exposures.
    """

    pipeline: ScanPipeline
    job: Job
    engine: Engine
    estimated: EstimatedDescription | None = None
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
            recording = self.pipeline.drive(self.job.drive_request(hook is not None), plan, progress, hook)
        return self.of_recording(recording, plan, progress, watch)

    def plan(
        self, progress: Progress, saved: Plan | None = None, quality_factors: Sequence[QualityFactor] = ()
    ) -> Plan:
        """The plan, or the `saved` one checked again, see `ScanPipeline.plan`."""
        job = self.job
        progress.stage("planning", 1, "plan")
        plan = self.pipeline.plan(job.loaded, job.setup, job.sensors.nominal, saved, quality_factors, progress)
        progress.advance(1)
        return plan

    def measure(self, plan: Plan, progress: Progress) -> tuple[Recording, SensingResult]:
        """Drive and sense a plan of which no cloud is wanted."""
        recording = self.pipeline.drive(self.job.drive_request(), plan, progress)
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
        job, loaded = self.job, self.job.loaded
        recording, sensed = exposed.recording, exposed.sensed
        estimated = loaded.estimated
        with watch.measure("reconstruct"):
            progress.stage("reconstructing", 1, "cloud")
            if self.estimated is not None:
                estimated = estimated_cell(loaded.nominal, self.estimated.deviations())
            cloud, dropped = self.pipeline.reconstruct(estimated, recording, sensed.profiles, job.setup, self.normals)
            progress.advance(1)
        if not len(cloud):
            reasons = why_empty(dropped, envelope_of(estimated, job.setup))
            raise EmptyScanError(f"the scan gave no point: {'; '.join(reasons)}", file=job.part)
        return ScanData(
            part=job.part,
            setup=job.setup,
            engine=self.engine,
            seed=job.seed,
            as_built=job.as_built,
            nominal=loaded.nominal,
            estimated=estimated,
            sensors=job.sensors,
            plan=plan,
            recording=recording,
            profiles=sensed.profiles,
            cloud=cloud,
            sample_images=exposed.images,
            render_seconds=sensed.timings,
            timings=watch.seconds,
            dropped=dropped,
            warnings=(*self._warnings(plan), *table_warnings(dropped, job.setup.scan.table_margin_mm)),
            fmu_token=exposed.fmu_token if plan is not None else "",
            part_file=job.part_file,
            recording_file=job.recording_file,
            unit=job.unit,
            threads=self.pipeline.threads,
            part_surface=loaded.part_surface,
            estimated_sensor=job.estimated_sensor,
        )

    def points_of(self, recording: Recording, sensed: SensingResult) -> Cloud:
        """The part of the cloud that some of the exposures give, without normals."""
        job = self.job
        return self.pipeline.reconstruct(job.loaded.estimated, recording, sensed.profiles, job.setup, normals=False)[0]

    def sense(
        self, recording: Recording, progress: Progress, rows: Sequence[int]
    ) -> tuple[SensingResult, tuple[ExposureImages, ...]]:
        """Profiles, and the images of the exposures in `rows`; `on_images` receives the images of all."""
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

        wanted, job = rows if on_images is None else None, self.job
        sensed = self.pipeline.sense(job.loaded, recording, job.sensors, self.engine, progress, keep, wanted)
        return sensed, tuple(kept)

    def _warnings(self, plan: Plan | None) -> tuple[str, ...]:
        """What is doubtful about descriptions, mesh and plan."""
        ignored = ignored_by_geometric_engine(self.job.setup.sensor) if self.engine == "geometric" else []
        unused = (f"the geometric engine ignores {', '.join(ignored)}",) if ignored else ()
        planned = plan.warnings if plan is not None else ()
        return (*self.setup_warnings, *unused, *self.job.loaded.nominal.part.warnings, *planned)
