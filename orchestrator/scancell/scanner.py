"""`Scanner`: scans of parts with the simulated cell."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from scancell.arguments import Length, Pose, Seed, Share, checked_arguments
from scancell.cell.recording import Recording, read_recording
from scancell.config.choices import Engine
from scancell.config.estimated import EstimatedDescription
from scancell.config.keys import Assignments, assignments
from scancell.config.loading import Setup, require_sensor_words
from scancell.config.sensor import SensorDescription
from scancell.geometry.mesh import Mesh
from scancell.jobs.calibrating_cell import CalibratingCell
from scancell.jobs.finishing import Finishing
from scancell.jobs.guard_job import guard_of
from scancell.jobs.single_exposure import expose
from scancell.planning.configuration_map import QualityFactor
from scancell.planning.options import scan_options
from scancell.planning.plan import Plan
from scancell.planning.plan_file import read_plan
from scancell.planning.setups import SetUpPlanner, SetUps
from scancell.planning.work import Work
from scancell.progress import Progress, ProgressCallback, as_progress
from scancell.results import ScanResult, ShotResult
from scancell.scanning.drive import FmuRunner, PreScanHook
from scancell.scanning.sense import OnImages, make_sensors
from scancell.scanning.sensor_range import sensor_range
from scancell.scanning.session import ScanSession
from scancell.scanning.survey import Survey, SurveyRegion, SurveyResult
from scancell.stopwatch import Stopwatch


class Scanner(CalibratingCell):
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
    >>> with scancell.Scanner() as scanner:
    ...     ideal = scanner.scan("part.stl", engine="geometric")
    ...     tilted = scanner.scan("part.stl", engine="geometric", as_built={"tool.rx_deg": 0.1})
    >>> tilted.deviation.rms > 10 * ideal.deviation.rms
    True
    """

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
            Mesh file (STL, OBJ, PLY) in `unit`, artefact file (TOML), or a mesh in metres.
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
        heard, watch = as_progress(progress), Stopwatch()
        with watch.measure("load"):
            heard.stage("loading", 1, "cell")
            job = self._job(part, unit, as_built, seed, setup, estimated_sensor)
            heard.advance(1)
        with watch.measure("plan"):
            heard.stage("planning", 1, "plan")
            saved = read_plan(Path(plan)) if isinstance(plan, str | Path) else plan
            made = self.pipeline.plan(job.loaded, job.setup, job.sensors.nominal, saved, progress=heard)
            heard.advance(1)
        with watch.measure("drive"):
            recording = self.pipeline.drive(job.drive_request(hook is not None), made, heard, hook)
        # Descriptions of this scan alone are not checked again.
        doubts = self.setup_warnings if job.setup is self.setup else ()
        finishing = Finishing(self.pipeline, job, engine, estimated, on_images, doubts, normals, samples)
        return finishing.result(recording, made, heard, watch)

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
        heard, watch = as_progress(progress), Stopwatch()
        with watch.measure("load"):
            job = self._job(part, unit, as_built, seed, None, estimated_sensor)
            if not isinstance(recording, Recording):
                job = replace(job, recording_file=Path(recording))
                recording = read_recording(Path(recording))
        finishing = Finishing(self.pipeline, job, engine, estimated, on_images, self.setup_warnings)
        return finishing.result(recording, None, heard, watch)

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
        """The checked program of the scan of a part, which `scan` takes; other parameters as of `Scanner.scan`.

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
        heard = as_progress(progress)
        heard.stage("planning", 1, "plan")
        job = self._job(part, unit, setup=setup)
        made = self.pipeline.plan(
            job.loaded, job.setup, job.sensors.nominal, quality_factors=quality_factors, progress=heard
        )
        heard.advance(1)
        return made

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
        """Find what stands around the table beside the known bodies, by the geometric engine.

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
        job = self._job(part, unit, as_built, seed)
        radius = job.loaded.nominal.table_radius + 0.05 if radius is None else radius
        region = SurveyRegion(radius, height, voxel, pitch, inflation)
        survey = Survey(job.setup, job.loaded, job.sensors, self.pipeline, region, seed, job.as_built)
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
        """How a free part is best set up: resting pose, position on the table and height; two set-ups where needed.

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
        range_ = sensor_range(make_sensors(setup.sensor, (), 0).nominal)
        cycle = setup.cell.world.controller_cycle_us * 1e-6
        heard = as_progress(progress)
        work = Work(setup.scan.max_planning_work, heard)
        options, threads = scan_options(setup.scan), self.pipeline.threads
        planner = SetUpPlanner(setup.cell, setup.sensor, range_, options, cycle, threads, work)
        return planner.propose(mesh, share, heard)

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
        job = self._job(part, unit, as_built, seed)
        mesh = None if part is None else job.loaded.nominal.part
        guard = guard_of(job.setup.cell, mesh, job.setup.scan) if guarded else None
        with FmuRunner() as runner:
            instance = runner.start(job.drive_request(collision_outputs=True))
            yield ScanSession(instance, job, self.pipeline, guard)

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
            where it cannot, the arm is left out, and a warning says why.

        Raises
        ------
        ScancellError
            Naming what is wrong and what was expected; only deviations of the sensor are accepted.
        """
        require_sensor_words(assignments(as_built), "a shot is taken from a given pose, without the robot's errors")
        job = self._job(part, unit, as_built, seed)
        return expose(job, part_from_sensor, engine, self.pipeline.threads)
