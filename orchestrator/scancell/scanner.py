"""`Scanner`: scans of parts with the simulated cell."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell import sensor as sensor_rt
from scancell.cell.recording import Recording, read_recording
from scancell.closing import Closing
from scancell.config.cell import CellDescription
from scancell.config.choices import Engine
from scancell.config.loading import Setup, load_setup, require_sensor_words
from scancell.config.scan import ScanDescription
from scancell.config.sensor import SensorDescription, ignored_by_geometric_engine
from scancell.config.units import si_value
from scancell.errors import DescriptionError, EmptyScanError, MeshError, SensorError
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh, load_mesh
from scancell.nominal.plausibility import setup_warnings
from scancell.planning.configuration_map import Judge
from scancell.planning.model import PlanningCell
from scancell.planning.options import scan_options
from scancell.planning.placement import PlacedPose, Placer
from scancell.planning.plan import Plan
from scancell.planning.plan_file import read_plan
from scancell.planning.setups import SetUpPlanner, SetUps
from scancell.progress import Progress, ProgressCallback, as_progress
from scancell.reconstruction.reconstruct import why_empty
from scancell.results import ScanResult, ShotResult
from scancell.scanning.drive import DriveRequest, FmuRunner, PreScanHook
from scancell.scanning.exposures import still_exposure
from scancell.scanning.pipeline import LoadedCell, ScanPipeline, envelope_of
from scancell.scanning.sense import ExposureImages, OnImages, SensingResult, make_sensors, sample_rows
from scancell.scanning.sensor_range import sensor_range
from scancell.scanning.session import ScanSession
from scancell.scanning.survey import Survey, SurveyRegion, SurveyResult
from scancell.stopwatch import Stopwatch

Array = NDArray[np.float64]

AsBuilt = Mapping[str, float | int | str | bool] | Sequence[str]
_SAMPLE_IMAGES = 4


class Scanner(Closing):
    """Scans parts with one simulated cell; a context manager.

    The FMU instance, the ray tracing scene and the plan are kept between calls, so that a second scan of the same part
    starts at once. Results do not depend on what was scanned before.

    Parameters
    ----------
    cell, sensor, scan
        Descriptions or their TOML files; the shipped ones by default.
    settings
        Changes of the nominal descriptions, ``{"cell.part.x_mm": 20}`` or ``["cell.part.x_mm=20"]``.
    ideal
        Switch off all noise of sensor and encoders.
    threads
        Threads of the ray tracer and the evaluation; 0 uses all cores.
    setup
        Checked descriptions in place of `cell`, `sensor`, `scan`, `settings` and `ideal`.

    Raises
    ------
    DescriptionError
        Naming file, key, value and what was expected.

    Examples
    --------
    >>> with Scanner() as scanner:
    ...     result = scanner.scan("part.stl", engine="geometric", as_built={"tool.x_mm": 0.1}, seed=3)
    >>> result.deviation.figures.rms
    """

    def __init__(
        self,
        cell: str | Path | CellDescription | None = None,
        sensor: str | Path | SensorDescription | None = None,
        scan: str | Path | ScanDescription | None = None,
        *,
        settings: AsBuilt = (),
        ideal: bool = False,
        threads: int = 0,
        setup: Setup | None = None,
    ) -> None:
        self.setup = setup or load_setup(cell, sensor, scan, assignments(settings), ideal)
        self.pipeline = ScanPipeline(threads)
        self._meshes: dict[tuple[str, str, int, int], Mesh] = {}

    @classmethod
    def from_setup(cls, setup: Setup, threads: int = 0) -> Self:
        """A scanner for checked descriptions."""
        return cls(threads=threads, setup=setup)

    def scan(
        self,
        part: str | Path | Mesh,
        *,
        unit: str = "mm",
        engine: Engine = "ray-traced",
        as_built: AsBuilt = (),
        seed: int = 0,
        setup: Setup | None = None,
        plan: Plan | str | Path | None = None,
        estimated_cell: CellDescription | None = None,
        estimated_sensor: SensorDescription | None = None,
        normals: bool = True,
        samples: bool = True,
        on_images: OnImages | None = None,
        hook: PreScanHook | None = None,
        progress: Progress | ProgressCallback | None = None,
    ) -> ScanResult:
        """Plan, drive, sense and reconstruct.

        Parameters
        ----------
        part
            Mesh file (STL, OBJ, PLY) in `unit`, or a mesh in metres.
        engine
            ``ray-traced`` renders the camera images and finds the stripe in them; ``geometric`` intersects the laser
            rays with the surfaces.
        as_built
            Deviations of the true cell, ``{"tool.x_mm": 0.1, "sensor.laser.turn_y_deg": 0.1}``.
        seed
            Random seed; the same seed gives the same result.
        setup
            Descriptions of this scan in place of the scanner's.
        plan
            A plan, or its file, in place of a new one; it is checked again in this cell.
        estimated_cell, estimated_sensor
            Calibrated descriptions that reconstruction uses in place of the nominal ones.
        normals
            Whether to estimate normals.
        samples
            Whether to keep the images of a few exposures for the pictures.
        on_images
            Receives the images of every exposure.
        hook
            Commands the running cell before the scan.
        progress
            Receives (stage, done, total); returning False cancels.

        Raises
        ------
        ScancellError
            Naming what is wrong and what was expected; `EmptyScanError` when no point of the part is found, and
            `CancelledError` when `progress` cancels.
        """
        heard = as_progress(progress)
        setup = setup or self.setup
        watch = Stopwatch()
        with watch.measure("load"):
            heard.stage("loading", 1, "cell")
            mesh = self.mesh(part, unit)
            words = tuple(assignments(as_built))
            loaded = self.pipeline.load(setup.cell, mesh)
            sensors = make_sensors(setup.sensor, words, seed, estimated_sensor)
            heard.advance(1)
        with watch.measure("plan"):
            heard.stage("planning", 1, "plan")
            saved = read_plan(Path(plan)) if isinstance(plan, str | Path) else plan
            made = self.pipeline.plan(loaded, setup, sensors.nominal, saved)
            heard.advance(1)
        with watch.measure("drive"):
            request = DriveRequest(setup, loaded.nominal, loaded.for_fmu(seed, hook is not None), words)
            recording = self.pipeline.drive(request, made, heard, hook)
        inputs = (Path(part),) if isinstance(part, str | Path) else ()
        draft = _Draft(setup, engine, seed, words, loaded, made, recording, sensors, estimated_cell, inputs, unit)
        return self._finish(draft, normals, samples, on_images, heard, watch)

    def render(
        self,
        recording: str | Path | Recording,
        part: str | Path | Mesh,
        *,
        unit: str = "mm",
        engine: Engine = "ray-traced",
        as_built: AsBuilt = (),
        seed: int = 0,
        estimated_cell: CellDescription | None = None,
        estimated_sensor: SensorDescription | None = None,
        on_images: OnImages | None = None,
        progress: Progress | ProgressCallback | None = None,
    ) -> ScanResult:
        """Images and a cloud from trigger records that any FMI tool wrote; see `scan` for the parameters.

        Raises
        ------
        ScancellError
            Naming what is wrong and what was expected; deviations of the cell are refused, because the recording states
            what the cell did.
        """
        heard, watch, words = as_progress(progress), Stopwatch(), tuple(assignments(as_built))
        require_sensor_words(words, "the recording states what the cell did")
        with watch.measure("load"):
            loaded = self.pipeline.load(self.setup.cell, self.mesh(part, unit))
            sensors = make_sensors(self.setup.sensor, words, seed, estimated_sensor)
            records = recording if isinstance(recording, Recording) else read_recording(Path(recording))
        inputs = tuple(Path(item) for item in (part, recording) if isinstance(item, str | Path))
        draft = _Draft(self.setup, engine, seed, words, loaded, None, records, sensors, estimated_cell, inputs, unit)
        return self._finish(draft, True, True, on_images, heard, watch)

    def plan(
        self,
        part: str | Path | Mesh,
        *,
        unit: str = "mm",
        setup: Setup | None = None,
        judges: Sequence[Judge] = (),
    ) -> Plan:
        """The checked program of the scan of a part, which `scan` takes.

        Parameters
        ----------
        judges
            Constraints of your own for motions along sensor paths: functions of joints (n, joints) and table angles
            (n,), rad, that return factors (n,) in [0, 1], by which the quality is multiplied; 0 forbids.

        Raises
        ------
        PlanningError
            Naming the poses that cannot be reached, or which bodies collide.
        """
        setup = setup or self.setup
        loaded = self.pipeline.load(setup.cell, self.mesh(part, unit))
        return self.pipeline.plan(loaded, setup, make_sensors(setup.sensor, (), 0).nominal, judges=judges)

    def survey(
        self,
        part: str | Path | Mesh,
        *,
        unit: str = "mm",
        radius: float | None = None,
        height: float = 0.2,
        voxel: float = 0.01,
        pitch: float = 0.005,
        inflation: float = 0.002,
        as_built: AsBuilt = (),
        seed: int = 0,
        progress: Progress | ProgressCallback | None = None,
    ) -> SurveyResult:
        """Find what stands around the table beside the known bodies, by the geometric engine.

        Parameters
        ----------
        part
            The part on the table, as in `scan`.
        radius, height
            Of the surveyed cylinder on the table, m; default radius: 50 mm more than the table's. Space above it is
            taken as free.
        voxel
            Edge of the voxels, m.
        pitch
            Distance between exposures, m. What is thinner may be missed.
        inflation
            Distance from measured voxels up to which space counts as occupied, m.

        Raises
        ------
        ScancellError
            Naming what is wrong and what was expected.
        """
        words, setup = tuple(assignments(as_built)), self.setup
        loaded = self.pipeline.load(setup.cell, self.mesh(part, unit))
        radius = loaded.nominal.table_radius + 0.05 if radius is None else radius
        region = SurveyRegion(radius, height, voxel, pitch, inflation)
        sensors = make_sensors(setup.sensor, words, seed)
        return Survey(setup, loaded, sensors, self.pipeline, region, seed, words).run(as_progress(progress))

    def place(
        self,
        part: str | Path | Mesh,
        share: float = 0.99,
        *,
        unit: str = "mm",
        progress: Progress | ProgressCallback | None = None,
    ) -> SetUps:
        """How a free part is best set up: resting pose, position on the table and height; two set-ups where needed.

        Parameters
        ----------
        share
            Share of the surface measurable in any resting pose that is to be scanned.

        Raises
        ------
        PlanningError
            If no resting pose is stable, fits on the table and can be scanned.
        """
        setup, mesh = self.setup, self.mesh(part, unit)
        range_ = sensor_range(make_sensors(setup.sensor, (), 0).nominal)
        cycle = setup.cell.world.controller_cycle_us * 1e-6
        planner = SetUpPlanner(setup.cell, setup.sensor, range_, scan_options(setup.scan), cycle, self.pipeline.threads)
        return planner.propose(mesh, share, as_progress(progress))

    @contextmanager
    def session(
        self, part: str | Path | Mesh, *, unit: str = "mm", as_built: AsBuilt = (), seed: int = 0
    ) -> Iterator[ScanSession]:
        """The running cell with a part: commands to its controller, and profiles at any time.

        Raises
        ------
        ScancellError
            Naming what is wrong and what was expected.

        Examples
        --------
        >>> with scanner.session("part.stl") as session:
        ...     session.move_joints(q)
        ...     points = session.profile("geometric").points_in_base
        """
        words, setup = tuple(assignments(as_built)), self.setup
        loaded = self.pipeline.load(setup.cell, self.mesh(part, unit))
        sensors = make_sensors(setup.sensor, words, seed)
        request = DriveRequest(setup, loaded.nominal, loaded.for_fmu(seed, collision_outputs=True), words)
        with FmuRunner() as runner:
            yield ScanSession(runner.start(request), loaded, setup, sensors, self.pipeline)

    def shot(
        self,
        part: str | Path | Mesh,
        pose: Sequence[float],
        *,
        unit: str = "mm",
        engine: Engine = "ray-traced",
        as_built: AsBuilt = (),
        seed: int = 0,
    ) -> ShotResult:
        """One exposure of the whole cell from a pose.

        Parameters
        ----------
        pose
            ``part_from_sensor``: x, y, z in mm and the XYZ' angles in degrees. The table turns the part so that the arm
            reaches it; where it cannot, the arm is left out, and a warning says why.

        Raises
        ------
        ScancellError
            Naming what is wrong and what was expected; only deviations of the sensor are accepted.
        """
        words = tuple(assignments(as_built))
        require_sensor_words(words, "a shot is taken from a given pose, without the robot's errors")
        loaded = self.pipeline.load(self.setup.cell, self.mesh(part, unit))
        sensors = make_sensors(self.setup.sensor, words, seed)
        part_from_sensor = _pose_of(pose)
        cell = PlanningCell(loaded.nominal, sensor_range(sensors.nominal), 1.0, threads=self.pipeline.threads)
        exposure, warnings = _posture(cell, loaded, part_from_sensor, self.setup)
        try:
            keep = engine == "ray-traced"
            result = sensor_rt.scan(
                loaded.scene, sensors.nominal, exposure, engine, self.pipeline.threads, keep, as_built=sensors.true
            )
        except (ValueError, RuntimeError) as error:
            raise SensorError(str(error)) from error
        images = None
        if result.images is not None:
            images = ExposureImages(1, result.images[0], None if result.background is None else result.background[0])
        points = _transformed(part_from_sensor, result.profiles.points_in_sensor)
        if not len(points):
            warnings = (*warnings, "the sensor sees nothing from this pose")
        return ShotResult(loaded.nominal.part.source, result.profiles, points, images, sensors.nominal, warnings)

    def mesh(self, part: str | Path | Mesh, unit: str = "mm") -> Mesh:
        """The mesh of a part in metres; a file is read again only when it has changed.

        Raises
        ------
        MeshError
            If the file is missing, unreadable, empty or broken.
        """
        if isinstance(part, Mesh):
            if not len(part.faces):
                raise MeshError(f"{part.source or 'mesh'}: has no faces")
            return part
        path = Path(part)
        status = path.stat() if path.is_file() else None
        key = (str(path.absolute()), unit, status.st_mtime_ns if status else 0, status.st_size if status else 0)
        if key not in self._meshes:
            mesh = load_mesh(path, unit)
            while len(self._meshes) >= 2:
                del self._meshes[next(iter(self._meshes))]
            self._meshes[key] = mesh
        return self._meshes[key]

    def _finish(
        self,
        draft: _Draft,
        normals: bool,
        samples: bool,
        on_images: OnImages | None,
        progress: Progress,
        watch: Stopwatch,
    ) -> ScanResult:
        """Sense, reconstruct and refuse an empty scan."""
        with watch.measure("sense"):
            sensed, kept = self._sense(draft, _SAMPLE_IMAGES if samples else 0, on_images, progress)
        loaded, setup = draft.loaded, draft.setup
        estimated = loaded.nominal
        with watch.measure("reconstruct"):
            progress.stage("reconstructing", 1, "cloud")
            if draft.estimated_cell is not None:
                estimated = self.pipeline.load(draft.estimated_cell, loaded.nominal.part).nominal
            cloud, dropped = self.pipeline.reconstruct(estimated, draft.recording, sensed.profiles, setup, normals)
            progress.advance(1)
        part = draft.inputs[0].name if draft.inputs else loaded.nominal.part.source
        if not len(cloud):
            reasons = why_empty(dropped, envelope_of(estimated, setup))
            raise EmptyScanError(f"{part}: the scan gave no point: {'; '.join(reasons)}")
        return ScanResult(
            part=part,
            setup=setup,
            engine=draft.engine,
            seed=draft.seed,
            as_built=draft.as_built,
            nominal=loaded.nominal,
            estimated=estimated,
            sensors=draft.sensors,
            plan=draft.plan,
            recording=draft.recording,
            profiles=sensed.profiles,
            cloud=cloud,
            sample_images=kept,
            render_seconds=sensed.timings,
            timings=watch.seconds,
            dropped=dropped,
            warnings=self._warnings(draft),
            fmu_token=self.pipeline.runner.token if draft.plan is not None else "",
            inputs=draft.inputs,
            unit=draft.unit,
            threads=self.pipeline.threads,
            part_surface=loaded.part_surface,
        )

    def _sense(
        self, draft: _Draft, samples: int, on_images: OnImages | None, progress: Progress
    ) -> tuple[SensingResult, tuple[ExposureImages, ...]]:
        """Profiles, and the images of some exposures; `on_images` receives the images of all."""
        if on_images is not None and draft.engine == "geometric":
            raise DescriptionError("engine = geometric: makes no images to keep; expected ray-traced")
        rows = sample_rows(len(draft.recording), samples) if samples else []
        chosen = set(draft.recording.measured.index[rows].tolist())
        kept: list[ExposureImages] = []

        def keep(images: ExposureImages) -> None:
            if on_images is not None:
                on_images(images)
            if images.trigger in chosen:
                kept.append(images)

        wanted = rows if on_images is None else None
        sensed = self.pipeline.sense(draft.loaded, draft.recording, draft.sensors, draft.engine, progress, keep, wanted)
        return sensed, tuple(kept)

    def _warnings(self, draft: _Draft) -> tuple[str, ...]:
        """What is doubtful about descriptions, mesh and plan; other descriptions than the scanner's are not checked."""
        own = self.setup_warnings if draft.setup is self.setup else ()
        ignored = ignored_by_geometric_engine(draft.setup.sensor) if draft.engine == "geometric" else []
        unused = (f"the geometric engine ignores {', '.join(ignored)}",) if ignored else ()
        planned = draft.plan.warnings if draft.plan is not None else ()
        return (*own, *unused, *draft.loaded.nominal.part.warnings, *planned)

    @cached_property
    def setup_warnings(self) -> tuple[str, ...]:
        """What is doubtful about the descriptions, in sentences."""
        return tuple(setup_warnings(self.setup))

    def close(self) -> None:
        """Free the FMU, its files and the scenes."""
        self.pipeline.close()
        self._meshes.clear()


@dataclass(frozen=True)
class _Draft:
    """A scan between driving and sensing."""

    setup: Setup
    engine: Engine
    seed: int
    as_built: tuple[str, ...]
    loaded: LoadedCell
    plan: Plan | None
    recording: Recording
    sensors: Any
    estimated_cell: CellDescription | None
    inputs: tuple[Path, ...]
    unit: str


def assignments(given: AsBuilt) -> list[str]:
    """``key=value`` words of a mapping, or the words themselves."""
    if isinstance(given, str):
        raise DescriptionError(f"'{given}': expected a mapping or a list of key=value words")
    if isinstance(given, Mapping):
        return [f"{key}={_toml_value(value)}" for key, value in given.items()]
    return list(given)


def _toml_value(value: float | str | bool) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return repr(value) if isinstance(value, int | float) else f'"{value}"'


def _pose_of(values: Sequence[float]) -> Array:
    numbers = np.asarray(values, float)
    if numbers.shape != (6,) or not np.isfinite(numbers).all():
        raise DescriptionError(
            f"pose = {list(values)}: expected 6 finite numbers: x, y, z in mm, rx, ry, rz in degrees"
        )
    return pose.from_euler_xyz(numbers[:3] * 1e-3, np.radians(numbers[3:]))


def _transformed(target_from_source: Array, points: ArrayLike) -> Array:
    return pose.transform_points(target_from_source, np.asarray(points, float))


def _posture(
    cell: PlanningCell, loaded: LoadedCell, part_from_sensor: Array, setup: Setup
) -> tuple[sensor_rt.Exposures, tuple[str, ...]]:
    """One exposure with the arm where it holds the sensor at the pose; far away where it cannot."""
    nominal = cell.nominal
    azimuth = si_value(setup.scan.sweep, "azimuth_deg")
    placed = Placer(cell, azimuth, 0.0).poses(part_from_sensor[None])[0]
    warnings: tuple[str, ...] = ()
    if isinstance(placed, PlacedPose):
        frames = nominal.frame_poses(placed.q, np.array(placed.table))
    else:
        frames = nominal.frame_poses(nominal.home, np.array(0.0))
        away = pose.translation((0.0, 0.0, -900.0))
        frames = {name: away @ value if _moves_with_arm(name) else value for name, value in frames.items()}
        warnings = (f"the arm is left out: {placed.reason}",)
    world_from_body = np.stack([frames[body.moves_with] for body in loaded.bodies])
    duration = si_value(setup.sensor.detector, "exposure_ms")
    return still_exposure(frames["part"] @ part_from_sensor, world_from_body, duration), warnings


def _moves_with_arm(frame: str) -> bool:
    return frame.startswith(("link[", "finger[", "sensor"))
