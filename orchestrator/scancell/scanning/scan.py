"""A scan: plan, drive, sense, reconstruct; and its data, before evaluation.

Nothing else composes these steps: `Scanner`, studies, calibration and the live cell scan by `Scan`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from scancell.arguments import checked_arguments
from scancell.arrays import Array
from scancell.cell.recording import Recording
from scancell.config.choices import CloudFrame, Engine
from scancell.config.loading import Setup
from scancell.config.sensor import ignored_by_geometric_engine
from scancell.errors import DescriptionError, EmptyScanError
from scancell.geometry import pose
from scancell.nominal.cell import NominalCell
from scancell.nominal.parts import Body
from scancell.nominal.plausibility import payload_warnings
from scancell.planning.path_map.configuration_map import QualityFactor
from scancell.planning.plan import Plan
from scancell.progress import Progress, Stopwatch
from scancell.reconstruction.cloud import Cloud
from scancell.reconstruction.reconstruct import Dropped, ProfilePoints, table_warnings, why_empty
from scancell.scanning.pipeline import PreScanHook, ScanPipeline, envelope_of, measured_motion
from scancell.scanning.sense import ExposureImages, OnImages, SensedProfiles, sample_rows
from scancell.scanning.world import ExposureControl, World
from scancell.values import Value

SAMPLE_IMAGES = 4


@dataclass(frozen=True, eq=False, repr=False)
class ScanData(Value):
    """World, recording and cloud of a scan; see `ScanResult` for the attributes."""

    world: World
    engine: Engine
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
    threads: int = 0

    @property
    def part(self) -> str:
        """Name of the part: its file, or the name of its mesh."""
        return self.world.part

    @property
    def setup(self) -> Setup:
        """Nominal descriptions."""
        return self.world.setup

    @property
    def nominal(self) -> NominalCell:
        """The nominal cell."""
        return self.world.nominal

    @property
    def as_built(self) -> tuple[str, ...]:
        """Deviations of the true cell as ``key=value`` words."""
        return self.world.as_built

    @property
    def seed(self) -> int:
        """Random seed."""
        return self.world.seed

    @property
    def segment_names(self) -> dict[int, str]:
        """Names of the segments by id; the ids as text when an existing recording was rendered."""
        if self.plan is not None:
            return self.plan.program.names
        return {int(number): str(number) for number in np.unique(self.recording.measured.segment)}

    @property
    def camera_names(self) -> list[str]:
        """Names of the cameras of the main sensor, by camera index."""
        return [camera.name for camera in self.world.sensor.cameras]

    @property
    def sensor_names(self) -> tuple[str, ...]:
        """Names of the sensors, of which the cloud holds the numbers, from 1."""
        return self.setup.sensor_names

    @checked_arguments
    def frame_from_part(self, frame: CloudFrame, table_angle: float = 0.0) -> Array:
        """Estimated pose (4, 4) of the part in a frame, with the table at `table_angle` (rad).

        In a scan on a belt the part moves with the frame ``belt``, whose origin is that of the belt's frame at the
        start; world and base are those where the part started.

        A part that the arm holds is that of the home position.

        Raises `DescriptionError` if `frame` is not part, world, base, or what carries the part: table, belt or flange.
        """
        cell = self.world.estimated
        support = cell.support_kind
        if frame in ("table", "belt", "flange") and frame != support:
            raise DescriptionError(key="frame", value=frame, expected=f"part, {support}, base or world")
        at = cell.with_further_axes([*cell.home, table_angle])
        world_from_part = cell.world_from("part", at)
        match frame:
            case "part":
                return np.eye(4)
            case "table" | "belt" | "flange":
                return cell.support_from_part
            case "world":
                return world_from_part
            case "base":
                return np.asarray(pose.inverse(cell.world_from("base", at)) @ world_from_part)

    @property
    def part_from_sensor(self) -> Array:
        """Nominal pose (n, 4, 4) of the sensor in the frame of the part at the measurements of each exposure."""
        return self.nominal.part_from_sensor(measured_motion(self.nominal, self.recording).axes)

    @checked_arguments
    def points_in(self, frame: CloudFrame, table_angle: float = 0.0) -> Array:
        """Points (n, 3) of the cloud in a frame, m, with the table at `table_angle` rad; see `frame_from_part`."""
        return pose.transform_points(self.frame_from_part(frame, table_angle), self.cloud.points_in_part)


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

    def measure(self, plan: Plan, progress: Progress) -> tuple[Recording, SensedProfiles]:
        """Drive and sense a plan by the main sensor alone; no cloud is wanted."""
        recording = self.pipeline.drive(self.world, plan, progress)
        return recording, self.sense(recording, progress, alone=True)

    def of_recording(self, recording: Recording, plan: Plan | None, progress: Progress, watch: Stopwatch) -> ScanData:
        """Sense and reconstruct a recording, whose `plan` may be unknown.

        Raises `EmptyScanError` when no point of the part is found.
        """
        with watch.measure("sense"):
            sensed = self.sense(recording, progress, sample_rows(len(recording), SAMPLE_IMAGES) if self.samples else [])
        return self.of_profiles(recording, sensed, plan, progress, watch)

    def of_profiles(
        self,
        recording: Recording,
        sensed: SensedProfiles,
        plan: Plan | None,
        progress: Progress,
        watch: Stopwatch,
        parts: tuple[Cloud, Dropped] | None = None,
    ) -> ScanData:
        """Reconstruct a recording that is sensed; see `of_recording`.

        `parts` are the cloud and what was dropped, where `points_of` gave them part by part.
        """
        world = self.world
        with watch.measure("reconstruct"):
            progress.stage("reconstructing", 1, "cloud")
            cloud, dropped = parts or self.points_of(recording, sensed.points, self.normals)
            if parts is not None:
                cloud = self.pipeline.with_normals(world.estimated, recording, cloud)
            progress.advance(1)
        if not len(cloud):
            reasons = why_empty(dropped, envelope_of(world.estimated, world.setup))
            raise EmptyScanError(f"the scan gave no point: {'; '.join(reasons)}", file=world.part)
        return ScanData(
            world=world,
            engine=self.engine,
            plan=plan,
            recording=recording,
            profiles=sensed.points,
            cloud=cloud,
            dropped=dropped,
            sample_images=sensed.images,
            render_seconds=sensed.timings,
            timings=watch.seconds,
            warnings=(*self._warnings(plan), *table_warnings(dropped, world.setup.scan.table_margin_mm)),
            fmu_token="" if plan is None else self.pipeline.runner.token,
            threads=self.pipeline.threads,
        )

    def points_of(self, recording: Recording, points: ProfilePoints, normals: bool = False) -> tuple[Cloud, Dropped]:
        """The cloud, or the part of it, that some exposures give, and what was dropped."""
        return self.pipeline.reconstruct(self.world.estimated, recording, points, self.world.setup, normals)

    def sense(
        self,
        recording: Recording,
        progress: Progress,
        rows: Sequence[int] = (),
        controls: Sequence[ExposureControl] | None = None,
        alone: bool = False,
    ) -> SensedProfiles:
        """Profiles, with the images of those in `rows`; `on_images` receives the images of all, see `World.sense`."""
        if self.on_images is not None and self.engine == "geometric":
            raise DescriptionError("makes no images to keep", key="engine", value="geometric", expected="ray-traced")
        return self.world.sense(
            recording,
            self.engine,
            progress,
            on_images=self.on_images,
            kept=rows,
            controls=controls,
            alone=alone,
            threads=self.pipeline.threads,
        )

    def _translucent(self) -> list[str]:
        """Names of the translucent bodies."""
        bodies = [body for body in self.world.bodies if isinstance(body, Body)]
        return [body.name for body in bodies if any(m.scattering_per_mm for m in body.materials)]

    def _warnings(self, plan: Plan | None) -> tuple[str, ...]:
        """Warnings about descriptions, mesh and plan."""
        ignored = []
        if self.engine == "geometric":
            of_sensors = (ignored_by_geometric_engine(world.setup.sensor) for world in self.world.sensors)
            ignored = [*dict.fromkeys(key for keys in of_sensors for key in keys)]
            ignored += [f"scattering_per_mm of {name}" for name in self._translucent()]
        unused = (f"the geometric engine ignores {', '.join(ignored)}",) if ignored else ()
        planned = plan.warnings if plan is not None else ()
        nominal = self.world.nominal
        loads = payload_warnings(self.world.setup.cell, nominal)
        return (*self.setup_warnings, *loads, *unused, *nominal.part.warnings, *planned)
