"""`Scanner`: scans of parts with the simulated cell."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Self

from scancell.arguments import Length, Pose, Seed, Share, Threads, checked_arguments
from scancell.calibration.cell.report import (
    CalibrationReport,
    ExchangedSensor,
    calibrate_from_points,
    calibrate_in_cell,
    start_of,
)
from scancell.calibration.cell.scan import CalibrationRequest, CalibrationScan
from scancell.calibration.sensor.report import SensorCalibrationReport, SensorCalibrationRequest, calibrate_described
from scancell.cell.recording import Recording, read_recording
from scancell.config.cell import CellDescription, EstimatedDescription
from scancell.config.choices import CalibrationTarget, Engine, FlangeConvention, SensorTarget
from scancell.config.files import Assignments, assets_dir, assignments
from scancell.config.loading import Setup, load_setup, require_sensor_words
from scancell.config.scan import BeltDescription, ScanDescription
from scancell.config.sensor import SensorDescription
from scancell.errors import DescriptionError, ScancellError
from scancell.geometry.mesh import Mesh
from scancell.nominal.parts import PartCache
from scancell.nominal.plausibility import setup_warnings
from scancell.planning.layout import (
    MOST_CLEARANCE,
    LayoutPlanner,
    Layouts,
    Plans,
    Ranges,
    Samples,
    layout_bounds,
)
from scancell.planning.model import SensorRange, Work
from scancell.planning.options import scan_options
from scancell.planning.path_map.configuration_map import QualityFactor
from scancell.planning.plan import Plan
from scancell.planning.setups import SetUpPlanner, SetUps
from scancell.planning.views.coverage import Sight
from scancell.progress import Progress, ProgressCallback, Stopwatch, as_progress
from scancell.results import ScanResult, ShotResult
from scancell.scanning.pipeline import FmuRunner, PreScanHook, ScanPipeline
from scancell.scanning.scan import Scan
from scancell.scanning.sense import OnImages
from scancell.scanning.session import ScanSession, guard_of, take_shot
from scancell.scanning.survey import Survey, SurveyRegion, SurveyResult
from scancell.scanning.world import World, make_sensor
from scancell.values import Closing


class Scanner(Closing):
    """Scans parts with one simulated cell; a context manager.

    The FMU instance, the ray tracing scene and the plan are kept between calls, so that a second scan of the same part
    starts immediately. Results do not depend on what was scanned before.

    Parameters
    ----------
    cell, sensor, scan
        Descriptions or their TOML files; the shipped ones by default.
    settings
        Changes of the nominal descriptions, ``{"cell.part.x_mm": 20}`` or ``["cell.part.x_mm=20"]``.
    ideal
        Switch off all noise of images and encoders; speckle is light, and stays.
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
    >>> with scancell.Scanner(settings={"scan.max_profiles": 100}) as scanner:
    ...     ideal = scanner.scan("part.stl", engine="geometric")
    ...     tilted = scanner.scan("part.stl", engine="geometric", as_built={"tool.rx_deg": 0.1})
    >>> tilted.deviation.rms > 10 * ideal.deviation.rms
    True
    """

    @checked_arguments
    def __init__(
        self,
        cell: str | Path | CellDescription | None = None,
        sensor: str | Path | SensorDescription | None = None,
        scan: str | Path | ScanDescription | None = None,
        *,
        settings: Assignments = (),
        ideal: bool = False,
        threads: Threads = 0,
        setup: Setup | None = None,
    ) -> None:
        if setup is not None and not (cell is sensor is scan is None and not settings and not ideal):
            raise DescriptionError("setup: expected no cell, sensor, scan, settings or ideal beside it")
        self.setup = setup or load_setup(cell, sensor, scan, assignments(settings), ideal)
        self._pipeline: ScanPipeline | None = ScanPipeline(threads)
        self._parts = PartCache()
        self._calibration: CalibrationScan | None = None  # the last one, whose plan is kept

    @property
    def pipeline(self) -> ScanPipeline:
        """The steps of scans and what they keep; `ScancellError` after `close`."""
        if self._pipeline is None:
            raise ScancellError(
                "the scanner is closed", expected="a new one, or calls before the end of its `with` block"
            )
        return self._pipeline

    def __enter__(self) -> Self:
        _ = self.pipeline
        return self

    @checked_arguments
    def load_part(self, part: str | Path | Mesh, unit: str = "mm") -> Mesh:
        """The mesh of a part in metres, see `load_part`: a file in `unit` is read again only when it has changed.

        Raises
        ------
        ScancellError
            If the file is missing, unreadable, empty or broken.
        """
        _ = self.pipeline
        return self._parts.part(part, unit)

    @checked_arguments
    def scan(
        self,
        part: str | Path | Mesh,
        *,
        unit: str = "mm",
        engine: Engine = "ray-traced",
        as_built: Assignments = (),
        seed: Seed = 0,
        setup: Setup | None = None,
        plan: Plan | str | Path | None = None,
        estimated: EstimatedDescription | None = None,
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
            Mesh file (STL, OBJ, PLY) in `unit`, CAD file (STEP, IGES, BREP), artefact file (TOML), or a mesh in metres.
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
        estimated
            Deviations of the cell that reconstruction assumes, in place of those of its description.
        estimated_sensor
            Calibrated sensor that reconstruction uses in place of the nominal one.
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
        reporter, watch = as_progress(progress), Stopwatch()
        with watch.measure("load"):
            reporter.stage("loading", 1, "cell")
            world = self._world(part, unit, as_built, seed, setup, estimated_sensor, estimated)
            reporter.advance(1)
        saved = Plan.load(plan) if isinstance(plan, str | Path) else plan
        # Descriptions of this scan alone are not checked again.
        warnings = self.setup_warnings if setup is None else ()
        scan = Scan(self.pipeline, world, engine, on_images, warnings, normals, samples)
        return ScanResult.of(scan.run(saved, reporter, watch, hook))

    @checked_arguments
    def render(
        self,
        recording: str | Path | Recording,
        part: str | Path | Mesh,
        *,
        unit: str = "mm",
        engine: Engine = "ray-traced",
        as_built: Assignments = (),
        seed: Seed = 0,
        estimated: EstimatedDescription | None = None,
        estimated_sensor: SensorDescription | None = None,
        on_images: OnImages | None = None,
        progress: Progress | ProgressCallback | None = None,
    ) -> ScanResult:
        """Images and a cloud from trigger records that any FMI tool wrote; parameters as of `Scanner.scan`.

        Raises
        ------
        ScancellError
            Naming what is wrong and what was expected; deviations of the cell are refused, because the recording states
            what the cell did.
        """
        require_sensor_words(assignments(as_built), "the recording states what the cell did")
        watch = Stopwatch()
        with watch.measure("load"):
            file = None if isinstance(recording, Recording) else Path(recording)
            world = self._world(part, unit, as_built, seed, None, estimated_sensor, estimated, file)
            recording = recording if isinstance(recording, Recording) else read_recording(Path(recording))
            recording.measured.require_joints(len(world.setup.cell.robot.joint))
        scan = Scan(self.pipeline, world, engine, on_images, self.setup_warnings)
        return ScanResult.of(scan.of_recording(recording, None, as_progress(progress), watch))

    @checked_arguments
    def plan(
        self,
        part: str | Path | Mesh,
        *,
        unit: str = "mm",
        setup: Setup | None = None,
        quality_factors: Sequence[QualityFactor] = (),
        progress: Progress | ProgressCallback | None = None,
    ) -> Plan:
        """Plan and check the scan of a part, for `scan`; other parameters as of `Scanner.scan`.

        Parameters
        ----------
        quality_factors
            Constraints of your own for motions along sensor paths: functions of joints (n, joints) and table angles
            (n,), rad, that return factors (n,) in [0, 1], by which the quality is multiplied; 0 forbids.
        progress
            Receives (stage, done, total); returning False cancels.

        Raises
        ------
        PlanningError
            Naming the poses that cannot be reached, which bodies collide, or what was reached when
            ``scan.max_planning_work`` was used up.
        """
        scan = Scan(self.pipeline, self._world(part, unit, setup=setup), "geometric")
        return scan.plan(as_progress(progress), quality_factors=quality_factors)

    @checked_arguments
    def survey(
        self,
        part: str | Path | Mesh,
        *,
        unit: str = "mm",
        radius: Length | None = None,
        height: Length = 0.2,
        voxel: Length = 0.01,
        pitch: Length = 0.005,
        inflation: float = 0.002,
        as_built: Assignments = (),
        seed: Seed = 0,
        progress: Progress | ProgressCallback | None = None,
    ) -> SurveyResult:
        """Find occupied and unseen space around the table beside the known bodies, by the geometric engine.

        The other parameters are those of `Scanner.scan`.

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
        world = self._world(part, unit, as_built, seed)
        radius = world.nominal.table_radius + 0.05 if radius is None else radius
        region = SurveyRegion(radius, height, voxel, pitch, inflation)
        survey = Survey(world, self.pipeline, region)
        return survey.run(as_progress(progress))

    @checked_arguments
    def place(
        self,
        part: str | Path | Mesh,
        share: Share = 0.99,
        *,
        unit: str = "mm",
        progress: Progress | ProgressCallback | None = None,
    ) -> SetUps:
        """Propose the set-up of a free part: resting pose, position on the table and height; two set-ups if needed.

        The other parameters are those of `Scanner.scan`.

        Parameters
        ----------
        share
            Share of the surface measurable in any resting pose that is to be scanned.

        Raises
        ------
        PlanningError
            If no resting pose is stable, fits on the table and can be scanned.
        """
        setup, mesh = self.setup, self.load_part(part, unit)
        range_ = SensorRange.of(make_sensor(setup.sensor, 0))
        reporter = as_progress(progress)
        work = Work(setup.scan.max_planning_work, reporter)
        options, threads = scan_options(setup.scan, setup.sensor), self.pipeline.threads
        planner = SetUpPlanner(setup.cell, setup.sensor, range_, options, threads, work)
        return planner.propose(mesh, share, reporter)

    @checked_arguments
    def layout(
        self,
        parts: str | Path | Mesh | Sequence[str | Path | Mesh],
        vary: Ranges = (),
        *,
        samples: Samples = 128,
        plans: Plans = 4,
        seed: Seed = 0,
        unit: str = "mm",
        progress: Progress | ProgressCallback | None = None,
    ) -> Layouts:
        """Propose where table, base of the arm and sensor should stand for the shortest scan of one or several parts.

        The other parameters are those of `Scanner.scan`; views are chosen by coverage (``scan.coverage``).

        Parameters
        ----------
        parts
            All that the cell is to scan: the time is that of all together, coverage that of the worst.
        vary
            Bounds of keys of the cell, in their units: ``{"table.pose.x_mm": (300, 700)}`` or
            ``["table.pose.x_mm=300:700"]``; default: of table, rotation of the arm's base, and sensor on the flange.
        samples
            Number of layouts that are screened: planned from views that are searched once for all.
        plans
            Number of layouts that are planned in full, the best ones of these.
        seed
            Random seed of the layouts; the same seed gives the same result.

        Raises
        ------
        DescriptionError
            If a key is unknown, a range empty, or the cell not valid within the bounds.
        PlanningError
            If no layout can scan all parts, naming what limits it.
        """
        given = [parts] if isinstance(parts, str | Path | Mesh) else [*parts]
        if not given:
            raise DescriptionError(key="parts", value=[], expected="at least one part")
        bounds, reporter = layout_bounds(self.setup.cell, vary), as_progress(progress)
        planner = self._layout_planner([self.load_part(part, unit) for part in given], reporter)
        return planner.propose(bounds, samples, plans, seed)

    @contextmanager
    @checked_arguments
    def session(
        self,
        part: str | Path | Mesh | None = None,
        *,
        unit: str = "mm",
        as_built: Assignments = (),
        seed: Seed = 0,
        guarded: bool = False,
    ) -> Iterator[ScanSession]:
        """The running cell with a part, or an empty table: commands to its controller, and profiles at any time.

        A `guarded` one has a collision guard in force (docs/guard.md) in every cycle. The other parameters are those of
        `Scanner.scan`.

        Raises
        ------
        ScancellError
            Naming what is wrong and what was expected.

        Examples
        --------
        >>> with scancell.Scanner() as scanner, scanner.session("part.stl") as session:
        ...     session.turn_table(30 * scancell.deg)
        ...     profile = session.profile("geometric")
        >>> profile.points_in_base.shape[1]
        3
        """
        world = self._world(part, unit, as_built, seed)
        mesh = None if part is None else world.nominal.part
        guard = guard_of(world.setup.cell, mesh, world.setup.scan) if guarded else None
        with FmuRunner() as runner:
            instance = runner.start(world, collision_outputs=True)
            yield ScanSession(instance, world, self.pipeline, guard)

    @checked_arguments
    def shot(
        self,
        part: str | Path | Mesh,
        part_from_sensor: Pose,
        *,
        unit: str = "mm",
        engine: Engine = "ray-traced",
        as_built: Assignments = (),
        seed: Seed = 0,
    ) -> ShotResult:
        """One exposure of the whole cell from a pose; the other parameters are those of `Scanner.scan`.

        Parameters
        ----------
        part_from_sensor
            Pose (4, 4) of the sensor, see `scancell.location`. The table turns the part so that the arm reaches it;
            if it cannot, the arm is left out, and a warning states the reason.

        Raises
        ------
        ScancellError
            Naming what is wrong and what was expected; only deviations of the sensor are accepted.
        """
        require_sensor_words(assignments(as_built), "a shot is taken from a given pose, without the robot's errors")
        world = self._world(part, unit, as_built, seed)
        shot, warnings = take_shot(world, part_from_sensor, engine, self.pipeline.threads)
        return ShotResult(**vars(shot), world=world, warnings=warnings)

    @checked_arguments
    def calibrate(
        self,
        request: CalibrationRequest | CalibrationTarget = "all",
        artefact: str | Path | Mesh | None = None,
        *,
        unit: str = "mm",
        engine: Engine = "geometric",
        as_built: Assignments = (),
        seed: Seed = 0,
        setup: Setup | None = None,
        from_points: str | Path | None = None,
        flange: str | Path | None = None,
        convention: FlangeConvention | None = None,
        table_format: str | Path | None = None,
        progress: Progress | ProgressCallback | None = None,
    ) -> CalibrationReport:
        """Scan an artefact and find the deviations of the cell from its description.

        The other parameters are those of `Scanner.scan`.

        Parameters
        ----------
        request
            What to calibrate, and how.
        artefact
            Artefact description or mesh of any part, placed by ``cell.part``; default: a sphere or ball plate.
        setup
            Descriptions of this calibration in place of the scanner's.
        from_points
            Table of measured points and joints, or flange poses, of a real cell (docs/calibration.md), in place of a
            simulated scan.
        flange
            Table of the flange poses of its exposures, if they are not in that of the points.
        convention
            Convention of orientations whose columns do not state it.
        table_format
            Format of profiles of a sensor in `from_points`: a shipped one, or a TOML file; default: by the content.

        Raises
        ------
        ScancellError
            Naming what is wrong and what was expected; `CalibrationError` where the data do not determine the unknowns.

        Examples
        --------
        >>> with scancell.Scanner(settings={"scan.max_profiles": 100}) as scanner:
        ...     report = scanner.calibrate("tool", as_built={"tool.x_mm": 1.0})
        ...     result = scanner.scan(
        ...         "part.stl", engine="geometric", as_built={"tool.x_mm": 1.0}, estimated=report.estimated
        ...     )
        >>> result.deviation.rms < 5e-6
        True
        """
        wanted = CalibrationRequest(request) if isinstance(request, str) else request
        described, name = setup or self.setup, wanted.further_sensor
        if name is not None:
            exchanged = ExchangedSensor.of(described, name)
            words = [exchanged.word(word) for word in assignments(as_built)]
            report = self.calibrate(
                replace(wanted, further_sensor=None), artefact, unit=unit, engine=engine, as_built=words, seed=seed,
                setup=exchanged.exchanged, from_points=from_points, flange=flange, convention=convention,
                table_format=table_format, progress=progress,
            )  # fmt: skip
            return replace(report, exchanged=exchanged)
        if wanted.what == "belt" and described.scan.belt is None:
            described = replace(described, scan=described.scan.model_copy(update={"belt": BeltDescription()}))
            setup = described
        part = assets_dir() / wanted.artefact_in(described.cell) if artefact is None else artefact
        world = self._world(part, unit, as_built, seed, setup)
        scan = self._calibration_scan(self._world(part, unit, setup=setup), wanted)
        if from_points is not None:
            poses = None if flange is None else Path(flange)
            return calibrate_from_points(scan, world, wanted, Path(from_points), poses, convention, table_format)
        for key, given in (("flange", flange), ("convention", convention), ("table_format", table_format)):
            if given is not None:
                raise DescriptionError("applies to `from_points` alone", key=key)
        return calibrate_in_cell(scan, world, wanted, engine, as_progress(progress))

    @checked_arguments
    def calibrate_sensor(
        self,
        request: SensorCalibrationRequest | SensorTarget = "ball",
        *,
        as_built: Assignments = (),
        seed: Seed = 0,
        progress: Progress | ProgressCallback | None = None,
    ) -> SensorCalibrationReport:
        """Find the deviations of the sensor's cameras and laser sheet from its description.

        The other parameters are those of `Scanner.scan`.

        Parameters
        ----------
        request
            Simulated targets, or measurements of a real sensor, and assumptions about them.

        Raises
        ------
        ScancellError
            Naming what is wrong and what was expected; `CalibrationError` where the data do not determine the unknowns.

        Examples
        --------
        >>> bent = {"sensor.camera[1].tilt_deg": 29.4}
        >>> with scancell.Scanner(settings={"scan.max_profiles": 100}) as scanner:
        ...     report = scanner.calibrate_sensor("ball", as_built=bent)
        ...     result = scanner.scan("part.stl", engine="geometric", as_built=bent, estimated_sensor=report.sensor)
        >>> result.deviation.rms < 5e-6
        True
        """
        wanted = SensorCalibrationRequest((request,)) if isinstance(request, str) else request
        words = assignments(as_built)
        return calibrate_described(self.setup, wanted, words, seed, self.pipeline.threads, as_progress(progress))

    @cached_property
    def setup_warnings(self) -> tuple[str, ...]:
        """Warnings about the descriptions, as sentences."""
        return tuple(setup_warnings(self.setup))

    def close(self) -> None:
        """Free the FMU, its files and the scenes; the scanner rejects further calls."""
        if self._pipeline is not None:
            self._pipeline.close()
        self._pipeline = None
        self._parts.clear()

    def _world(
        self,
        part: str | Path | Mesh | None,
        unit: str,
        as_built: Assignments = (),
        seed: int = 0,
        setup: Setup | None = None,
        estimated_sensor: SensorDescription | None = None,
        estimated: EstimatedDescription | None = None,
        recording_file: Path | None = None,
    ) -> World:
        """The part, or an empty table, in the scanner's cell or in that of `setup`, as it is `estimated`."""
        setup, words = setup or self.setup, tuple(assignments(as_built))
        if estimated is not None:
            setup = replace(setup, cell=setup.cell.model_copy(update={"estimated": estimated}))
        if part is None and setup.cell.part.fixture == "free":
            raise DescriptionError(
                "there is no part", key="part.fixture", value="free", expected='its mesh, or "clamped"'
            )
        mesh = None if part is None else self.load_part(part, unit)
        file = Path(part) if isinstance(part, str | Path) else None
        return self.pipeline.load(
            setup,
            mesh,
            as_built=words,
            seed=seed,
            part_file=file,
            unit=unit,
            recording_file=recording_file,
            estimated_sensor=estimated_sensor,
        )

    def _layout_planner(self, parts: Sequence[Mesh], progress: Progress) -> LayoutPlanner:
        """Planner of layouts for some parts, which are scanned by coverage."""
        setup = self.setup
        given = {key: getattr(setup.scan, key) for key in ("pose", "belt", "path")}
        for key, value in {**given, "coverage.feature": setup.scan.coverage.feature}.items():
            if value:
                problem = "a layout is judged by views that are chosen by coverage of the surface"
                raise DescriptionError(problem, key=f"scan.{key}", expected="none")
        scan = setup.scan.replace({"coverage.enabled": True})

        def world_of(cell: CellDescription, part: Mesh) -> World:
            return self._world(part, "mm", setup=replace(setup, cell=cell, scan=scan))

        def sight(part: Mesh) -> Sight:
            return self.pipeline.sight(world_of(setup.cell, part), work=Work(progress=progress))

        def planned(cell: CellDescription, part: Mesh) -> tuple[Plan, float]:
            world = world_of(cell, part)
            plan = self.pipeline.plan(world, progress=progress)
            return plan, self.pipeline.clearance(world, plan, MOST_CLEARANCE)

        options, threads = scan_options(scan, setup.sensor), self.pipeline.threads
        range_ = SensorRange.of(make_sensor(setup.sensor, 0))
        return LayoutPlanner(setup.cell, setup.sensor, range_, options, sight, planned, parts, progress, threads)

    def _calibration_scan(self, nominal: World, request: CalibrationRequest) -> CalibrationScan:
        """The one made last, whose plan is kept, where it is for the same cell and request."""
        kept = self._calibration
        if (
            kept is None
            or kept.world.scene is not nominal.scene
            or (kept.world.setup, kept.request) != (nominal.setup, request)
        ):
            kept = self._calibration = CalibrationScan(self.pipeline, nominal, request, start_of(nominal.setup))
        return kept
