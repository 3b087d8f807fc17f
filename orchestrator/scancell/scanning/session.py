"""A running cell with its sensor: commands to the controller, and profiles at any time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from scancell.arguments import Count, Duration, Length, Share, checked_arguments
from scancell.arrays import Array
from scancell.cell.driver import Operation, Tool, WorldFromTool
from scancell.cell.instance import CellInstance, RecordBatches
from scancell.cell.recording import Recording
from scancell.cell.session import CellSession
from scancell.config.cell import (
    CellDescription,
    PrismaticAxisDescription,
)
from scancell.config.choices import Engine
from scancell.config.description import si_value
from scancell.config.loading import load_setup
from scancell.config.scan import ScanDescription
from scancell.config.sensor import exposure_span
from scancell.errors import CommandError
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh
from scancell.guard.guard import Guard, GuardedCell, GuardSettings
from scancell.guard.parts import PartTracker, movable_parts
from scancell.guard.transport import InProcess, Link
from scancell.nominal.cell import NominalCell, nominal_cell
from scancell.nominal.parts import finger_travel_mesh, load_part
from scancell.planning.model import PlanningCell, SensorRange
from scancell.planning.space_map import with_occupied_space
from scancell.planning.views.placement import PlacedPose, Placer
from scancell.progress import NullProgress, Progress
from scancell.reconstruction.cloud import Cloud
from scancell.reconstruction.reconstruct import ProfilePoints
from scancell.scanning.pipeline import ScanPipeline, measured_motion
from scancell.scanning.sense import ExposureImages, SensedProfiles
from scancell.scanning.tracking import BeltMotion, BeltTracking
from scancell.scanning.world import Encoder, ExposureControl, World, encoder_sigma
from scancell.values import Value

_ANSWER_TIME = 0.003  # s of simulated time that the guard needs for an answer
_TIMEOUT = 60.0  # s, of a scan at full speed
_BATCH = 16  # profiles of a line that are sensed together
_PATIENCE = 0.02  # s, period at which a wait for them checks whether it has to end
SEEN = 0.1  # s, in which a guard surely gets a state and answers it

_MOST_STARTS = 4  # of a motion on a belt, until the time from its plan to its start is known
_MOST_LATE = 3  # cycles by which it may fall behind the belt
_EVEN, _LEAST_BELT_SPEED = 1e-3, 0.01  # share of the belt's speed that may change in a cycle, at least of this, m/s

_LEAST_NOISE = np.radians(0.005)
_LEAST_NOISE_M = 1e-5  # of prismatic axes: that of a rack whose position repeats within 0.05 mm
_SIGMAS = 5.0  # of the largest error of a position


@dataclass(frozen=True, eq=False, repr=False)
class Profile(Value):
    """The profile of one instant, or of one exposure from a given pose.

    Attributes
    ----------
    profile
        Points in the sensor frame with camera, column, sigma and intensity.
    rows
        (m,) image rows of the points, px.
    points_in_base, points_in_part
        (m, 3) the same points by measured joints and nominal or estimated geometry, or by the given pose, m.
    images
        Camera images, ray-traced engine only.

    Examples
    --------
    >>> with scancell.Scanner() as scanner, scanner.session("part.stl") as session:
    ...     profile = session.profile("geometric")
    >>> profile.points_in_part.shape == profile.points_in_base.shape
    True
    """

    profile: ProfilePoints
    rows: Array
    points_in_base: Array
    points_in_part: Array
    images: ExposureImages | None


def measure_profile(
    world: World,
    recording: Recording,
    engine: Engine,
    threads: int,
    control: ExposureControl | None = None,
) -> Profile:
    """The profile of a recording of one profile by the sensor of a world; `control` chooses its exposure time.

    Raises `SensorError` if the sensor library reports an error.
    """
    cell = world.estimated
    measured = measured_motion(cell, recording)
    part_from_sensor = cell.part_from_sensor(measured.axes[0], world.number)
    sensed = world.expose(recording, engine, control=control, images=True, threads=threads)
    frames = cell.tree.place(measured.axes[0], ["base", world.frame])
    return _profile(sensed, pose.inverse(frames["base"]) @ frames[world.frame], part_from_sensor)


def take_shot(world: World, part_from_sensor: Array, engine: Engine, threads: int) -> tuple[Profile, tuple[str, ...]]:
    """The exposure from a pose (4, 4), see `Scanner.shot`, and warnings.

    Raises `SensorError` if the sensor library reports an error.
    """
    frames, warnings = _posture(world, part_from_sensor, threads)
    index = np.array([1])
    sensed = world.expose_at_rest(frames, index, world.windows, engine, images=True, threads=threads)
    base_from_world = pose.inverse(world.nominal.with_axes_held().arm.world_from_base)
    shot = _profile(sensed, base_from_world @ frames["sensor"][0], part_from_sensor)
    if not len(shot.points_in_part):
        warnings = (*warnings, "the sensor sees nothing from this pose")
    return shot, warnings


def _profile(sensed: SensedProfiles, base_from_sensor: Array, part_from_sensor: Array) -> Profile:
    """One profile that was sensed at poses (4, 4) of the sensor."""
    assert sensed.row is not None
    points = np.array(sensed.points.points_in_sensor, float)
    in_base, in_part = (pose.transform_points(one, points) for one in (base_from_sensor, part_from_sensor))
    return Profile(sensed.points, sensed.row, in_base, in_part, next(iter(sensed.images), None))


def _posture(world: World, part_from_sensor: Array, threads: int) -> tuple[dict[str, Array], tuple[str, ...]]:
    """Poses (1, 4, 4) of the frames with the arm where it holds the sensor at the pose; far away where it cannot."""
    nominal = world.nominal
    cell = PlanningCell(nominal.with_axes_held(), SensorRange.of(world.sensor), 1.0, threads=threads)
    azimuth = si_value(world.setup.scan.sweep, "azimuth_deg")
    placed = Placer(cell, azimuth, 0.0).poses(part_from_sensor[None])[0]
    warnings: tuple[str, ...] = ()
    if isinstance(placed, PlacedPose):
        frames = nominal.frame_poses(nominal.with_further_axes(placed.axes))
    else:
        frames = nominal.frame_poses(nominal.start)
        away, moving = pose.translation((0.0, 0.0, -900.0)), ("link[", "finger[", "sensor")
        is_away = {name: nominal.carrier(name).startswith(moving) for name in frames}
        frames = {name: away @ value if is_away[name] else value for name, value in frames.items()}
        warnings = (f"the arm is left out: {placed.reason}",)
    frames = {**frames, "sensor": frames["part"] @ part_from_sensor}
    return {name: value[None] for name, value in frames.items()}, warnings


class _OtherStart(Exception):  # noqa: N818  (ends a motion, which is planned anew)
    """A motion on a belt starts at another time than planned."""


class ScanSession(CellSession):
    """A `CellSession` that also measures, and that a guard may watch in every cycle; made by `Scanner.session`.

    Parameters
    ----------
    instance
        Running instance of the cell.
    world, pipeline
        The part in the cell with its sensors, and what measures.
    guard
        Watches the robot; None: no guard.

    Attributes
    ----------
    world, pipeline
        The parameters of the same names.
    progress
        Receives what is measured, and may end it by raising.
    on_exposures
        Receives the recording of every `scan_line` and `profile`, and the cloud of the former (None of the latter).
    on_points
        Receives points of a `scan_line` while it is measured, without normals, in another thread; None: nothing does.

    Examples
    --------
    >>> with scancell.Scanner() as scanner, scanner.session("part.stl") as session:
    ...     session.move_tool(scancell.location(0.45, 0.0, 0.23, rx=np.pi))
    ...     profile = session.profile("geometric")
    >>> print(f"The part is {1e3 * profile.points_in_part[:, 2].max():.1f} mm high here.")
    The part is 15.0 mm high here.
    """

    @checked_arguments
    def __init__(
        self,
        instance: CellInstance,
        world: World,
        pipeline: ScanPipeline,
        guard: Guard | None = None,
    ) -> None:
        cycle_us = world.setup.cell.world.controller_cycle_us
        super().__init__(instance, world.nominal, cycle_us)
        self.world, self.pipeline = world, pipeline
        self.progress: Progress = NullProgress()
        self.on_exposures: Callable[[Recording, Cloud | None], object] = lambda _recording, _cloud: None
        self.on_points: Callable[[Cloud], object] | None = None
        self._start_delay = self.cycle  # from the plan of a motion on a belt to its start, s
        self._guarded: GuardedCell | None = None
        if guard is not None:
            max_age = guard.settings.max_age
            link = Link(InProcess(guard, _ANSWER_TIME), max_age)
            parts = PartTracker(world.setup.cell, world.nominal)
            self._guarded = GuardedCell(instance, cycle_us, link, max_age, parts=parts)
            self._guarded.attach()

    @property
    def nominal(self) -> NominalCell:
        """The nominal cell, which planning uses."""
        return self.world.nominal

    @property
    def true(self) -> NominalCell:
        """The cell with unknown obstacles, too; its bodies in the order in which the FMU numbers them from 1."""
        return self.world.true

    @property
    def line_speed(self) -> float:
        """Full speed of the tool in straight lines, m/s."""
        return si_value(self.world.setup.cell.robot.motion, "line_speed_mm_s")

    @property
    def monitor_speed(self) -> float:
        """Monitor speed of the operator, 0 to 1; a guard may allow less."""
        return self.value("command.monitor_speed") if self._guarded is None else self._guarded.monitor_speed

    def set_monitor_speed(self, share: float) -> None:
        """Scale the speed of moves by `share` (0 to 1), see `CellSession`; a guard limits it to what it allows."""
        if self._guarded is None:
            super().set_monitor_speed(share)
        else:
            self._guarded.set_monitor_speed(share)

    def press_emergency_stop(self) -> None:
        """Press the button, see `CellSession`; the answers of a guard do not release it."""
        super().press_emergency_stop()
        if self._guarded is not None:
            self._guarded.stop_pressed = True

    def release_emergency_stop(self) -> None:
        """Release the button and reset the controller, see `CellSession`."""
        if self._guarded is not None:
            self._guarded.stop_pressed = False
        super().release_emergency_stop()

    def set_operation(self, operation: Operation) -> None:
        """Change `operation`, see `CellSession`; a guard sees the robot at rest before it moves again."""
        super().set_operation(operation)
        if self._guarded is not None:
            self.wait(SEEN)

    @checked_arguments
    def follow_conveyor(
        self,
        conveyor: Count,
        poses: Sequence[WorldFromTool],
        *,
        dwell: Duration = 0.0,
        tool: Tool = "sensor",
        speed: Share = 1.0,
        on_pose: Callable[[int], object] = lambda _: None,
    ) -> None:
        """Move a tool relative to a belt that runs at a constant speed: onto it, through `poses`, and to rest.

        From pose to pose the tool moves straight in the frame of the belt, turning evenly, and rests there relative to
        it. The speed of the belt is that of its encoder.

        Parameters
        ----------
        conveyor
            Its number, from 1.
        poses
            ``world_from_tool`` (4, 4) each, where the belt has them now; they move on with it.
        dwell
            Time at each pose, s.
        tool
            See `flange_from_tool`.
        speed
            Share of the limits of joints and of straight lines.
        on_pose
            Called with the number of each pose, from 0, when the tool is there; it may start commands that take effect
            in the next cycles, such as `start_close_gripper`.

        Raises
        ------
        CommandError
            If the belt does not run evenly, the arm does not reach a pose while the belt carries it, or not follow
            within its limits; or the guard or a lower monitor speed let it fall behind the belt: it is then stopped.
        DescriptionError
            If an argument is out of its range.
        """
        count = len(self.nominal.world_from_conveyors)
        if conveyor > count:
            raise CommandError(f"follow_conveyor: conveyor = {conveyor}: expected 1 to {count}")
        if not poses:
            raise CommandError("follow_conveyor: poses = []: expected at least one")
        if self.monitor_speed < 1.0:
            raise CommandError("follow_conveyor: the monitor speed is below 1: the belt does not wait for the arm")
        along, travel = self.nominal.world_from_conveyors[conveyor - 1][:3, 0], self.conveyor_travel(conveyor)
        robot, flange_from_tool = self.world.setup.cell.robot, self.flange_from_tool(tool)
        for _ in range(_MOST_STARTS):
            velocity = self._even_speed(conveyor)
            moved = self.conveyor_travel(conveyor) - travel + velocity * self._start_delay
            tracking = BeltTracking(self.nominal, robot.motion, self.cycle, velocity * along, flange_from_tool, speed)
            shift = pose.translation(moved * along)
            motion = tracking.plan(self.commanded, [shift @ np.asarray(one, float) for one in poses], dwell)
            if self._run_on_belt(motion, on_pose):
                return
            self.come_to_rest()
        raise CommandError("follow_conveyor: the controller does not start motions after the same time")

    def _even_speed(self, conveyor: int) -> float:
        """Speed of a belt by its encoder, m/s; `CommandError` if it changes."""
        name = f"measured.conveyor[{conveyor}].speed"
        before = self.value(name)
        self.wait(0.0)
        now = self.value(name)
        if abs(now - before) > _EVEN * max(abs(now), _LEAST_BELT_SPEED):
            raise CommandError(f"follow_conveyor: the belt accelerates ({1e3 * before:.1f} to {1e3 * now:.1f} mm/s)")
        return now

    def _run_on_belt(self, motion: BeltMotion, on_pose: Callable[[int], object]) -> bool:
        """Run a motion relative to a belt; False if it starts at another time than planned, which is then known.

        A guard lets a motion start only when it has seen it.
        """
        pending, began, due = list(enumerate(motion.reached)), -1.0, self.time + self._start_delay
        old, late, duration = self.value("controller.clock"), _MOST_LATE * self.cycle, motion.program.duration

        def look() -> None:
            nonlocal began
            clock = self.value("controller.clock")
            if began < 0.0:
                if clock == old or not 0.0 < clock <= late:
                    return
                began = self.time - clock
                if abs(began - due) > self.cycle / 2:
                    self._start_delay += began - due
                    raise _OtherStart
            if clock < duration - self.cycle and self.time - began - clock > late:
                why = self._guard_text() or f"monitor speed {self.value('command.monitor_speed'):g}"
                raise CommandError(f"follow_conveyor: the tool falls behind the belt: {why}")
            while pending and clock >= pending[0][1]:
                on_pose(pending.pop(0)[0])

        end = self.cell.on_step(look)
        try:
            self.run_program(motion.program, self.exposure)
        except _OtherStart:
            return False
        except BaseException:
            self.hold()
            raise
        finally:
            end()
        return True

    @checked_arguments
    def scan_line(
        self, world_from_sensor: WorldFromTool, spacing: Length, *, speed: Share = 1.0, engine: Engine = "ray-traced"
    ) -> Cloud:
        """Move the sensor straight to a pose, and measure profiles on the way.

        Parameters
        ----------
        world_from_sensor
            Pose (4, 4) at the end.
        spacing
            Length of the sensor's path from one profile to the next, m.
        speed
            Share of the line speed of the robot's description.
        engine
            ``ray-traced`` renders images, ``geometric`` intersects rays with surfaces.

        Returns
        -------
        Cloud
            In the frame of the part. It has no point where the sensor saw nothing of the part. On an empty table it
            holds what stands in the place of a part, in the frame that ``cell.part`` states.

        Raises
        ------
        CommandError
            If the motion fails as in `record_line`.
        SensorError
            If the sensor library reports an error.
        """
        return self._scan(
            lambda batches: self.record_line(
                world_from_sensor, spacing, self.exposure, speed=speed, timeout=_TIMEOUT / speed, batches=batches
            ),
            engine,
        )

    @checked_arguments
    def scan_table(
        self, table_angle: float, spacing: Length, *, speed: Share = 1.0, engine: Engine = "ray-traced"
    ) -> Cloud:
        """Turn the table to `table_angle` (not wrapped), rad, and measure a profile every `spacing`, rad, on the way.

        `speed` is the share of the full speed of the table; `engine`, result and errors are those of `scan_line`.
        """
        return self._scan(
            lambda batches: self.record_table(
                table_angle, spacing, self.exposure, speed=speed, timeout=_TIMEOUT / speed, batches=batches
            ),
            engine,
        )

    def _scan(self, record: Callable[[RecordBatches], Recording], engine: Engine) -> Cloud:
        """Sense the exposures of a motion while it runs."""
        world = self.world
        controls, taken, sensing = world.controls(), [], ThreadPoolExecutor(1, "sense")

        def take(batch: Recording) -> None:
            taken.append((len(batch), sensing.submit(self._sense, batch, engine, controls)))

        try:
            recording = record(RecordBatches(_BATCH, take))
            self.progress.stage("sensing", len(recording), "profiles")
            sensed = SensedProfiles.joined(self._sensed(count, batch) for count, batch in taken)
        finally:
            sensing.shutdown(cancel_futures=True)
        cloud = self.pipeline.reconstruct(world.estimated, recording, sensed.points, world.setup)[0]
        self.on_exposures(recording, cloud)
        return cloud

    def _sense(self, batch: Recording, engine: Engine, controls: Sequence[ExposureControl]) -> SensedProfiles:
        world, pipeline = self.world, self.pipeline
        sensed = world.sense(batch, engine, NullProgress(), controls=controls, threads=pipeline.threads)
        if self.on_points is not None:
            points = sensed.points
            self.on_points(pipeline.reconstruct(world.estimated, batch, points, world.setup, normals=False)[0])
        return sensed

    def _sensed(self, count: int, batch: Future[SensedProfiles]) -> SensedProfiles:
        """Wait for a batch of `count` profiles; `progress` may end the wait."""
        while not wait([batch], _PATIENCE).done:
            self.progress.advance(0.0)
        self.progress.advance(count)
        return batch.result()

    @property
    def exposure(self) -> float:
        """Duration of the exposures of a profile of the description, s."""
        return exposure_span(self.world.setup.sensor)

    def profile(self, engine: Engine = "ray-traced") -> Profile:
        """Profile at the present pose, by the `engine`, see `scan_line`; the cell is not stepped, and may be moving.

        Raises
        ------
        SensorError
            If the sensor library reports an error.
        """
        world = self.world
        self.progress.advance(0.0)
        recording = self.snapshot(self.exposure)
        profile = measure_profile(world, recording, engine, self.pipeline.threads)
        self.on_exposures(recording, None)
        return profile


def settings_of(cell: CellDescription) -> GuardSettings:
    """The worst case of a described cell: its controller's cycle, its encoders, and the gears of its drives.

    A gear is twisted by at most the torque of its motor over its stiffness, and turns in its backlash; the encoder on
    the motor sees neither.
    """
    encoders: list[Encoder] = [*cell.robot.joint, cell.table, *cell.axis]
    slides = np.array([isinstance(one, PrismaticAxisDescription) for one in encoders])
    sigma = np.array([encoder_sigma(one) for one in encoders])
    noise = max(_LEAST_NOISE, float(sigma[~slides].max()))
    of_axes = np.where(slides, np.maximum(sigma, _LEAST_NOISE_M), noise)
    twist = np.zeros(len(encoders))
    if cell.robot.drive == "dynamic":
        drives = [joint.drive for joint in cell.robot.joint if joint.drive is not None]
        twist[: len(cell.robot.joint)] = [
            drive.max_torque_n_m / drive.gear_stiffness_n_m_rad + np.radians(drive.backlash_deg) for drive in drives
        ]
    return GuardSettings(
        cycle=cell.world.controller_cycle,
        noise=tuple(of_axes.tolist()) if slides.any() else noise,
        angle_error=tuple(float(error) for error in _SIGMAS * of_axes + twist),
        latency=1e-3 * max(one.encoder_latency_ms for one in encoders),
    )


@checked_arguments
def guard_of(
    cell: str | Path | CellDescription | None = None,
    part: str | Path | Mesh | None = None,
    scan: str | Path | ScanDescription | None = None,
    *,
    unit: str = "mm",
    settings: GuardSettings | None = None,
    max_age: float | None = None,
) -> Guard:
    """Make a guard of a cell's bodies, the part on its table, and the occupied space of a scan description.

    It considers fingers at all widths, and free parts that a belt or a gripper can move where the states place them
    (`GuardedCell`). Fingers may touch parts, and parts that can be moved may touch the table and belts.

    Parameters
    ----------
    cell, scan
        Descriptions or their files; None: the shipped default.
    part
        Mesh (m), mesh file or artefact; None: the table is empty.
    unit
        Unit of a mesh file: ``mm``, ``m`` or ``inch``.
    settings
        The worst case; None: that of the description.
    max_age
        Longest age of an answered state, s, in place of that of the settings.

    Raises
    ------
    ScancellError
        Naming what is wrong and what was expected.

    Examples
    --------
    A motion of joints and table to a pose of the sensor in the part:

    >>> guard = scancell.guard_of(part="part.stl")
    >>> home = np.radians([35, -60, 185, 0, 55, 0, 0])
    >>> clash = guard.check([home, [0.0, -0.73, 3.57, 0.0, 0.3, -3.14, 0.0]])
    >>> clash.body_a, clash.body_b
    ('sensor', 'part')
    """
    setup = load_setup(cell, None, scan)
    mesh = load_part(part, unit) if isinstance(part, str | Path) else part
    nominal = with_finger_travel(nominal_cell(setup.cell, mesh), setup.cell)
    nominal = with_occupied_space(nominal, setup.scan.occupied)
    settings = settings or settings_of(setup.cell)
    if max_age is not None:
        settings = replace(settings, max_age=max_age)
    movable = movable_parts(setup.cell)
    return Guard(nominal, setup.cell.robot, settings, touching(nominal, setup.cell), movable)


def with_finger_travel(nominal: NominalCell, cell: CellDescription) -> NominalCell:
    """The nominal cell with the space of the fingers at all widths, because they move independently of the axes."""
    gripper = cell.gripper
    if gripper is None:
        return nominal
    bodies = tuple(
        replace(body, mesh=finger_travel_mesh(gripper, body.mesh), patches=())
        if body.moves_with.startswith("finger[")
        else body
        for body in nominal.bodies
    )
    return replace(nominal, bodies=bodies)


def touching(nominal: NominalCell, cell: CellDescription) -> list[tuple[str, str]]:
    """Pairs that may touch: fingers and parts, and parts that can be moved and what they are put down on."""
    bodies = nominal.bodies
    fingers, parts = (
        [body.name for body in bodies if body.moves_with.startswith(frame)] for frame in ("finger[", "part")
    )
    frames = {"part" if number == 1 else f"part[{number}]" for number in movable_parts(cell)}
    moved = [body.name for body in bodies if body.moves_with in frames]
    supports = ["table", *(belt.name for belt in cell.conveyor)]
    return [(finger, part) for finger in fingers for part in parts] + [(one, on) for one in moved for on in supports]
