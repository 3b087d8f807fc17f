"""The steps of scans, which `scan` composes: load, plan, drive, sense, reconstruct.

Nominal cells with their ray-tracing scenes, plans and the FMU instance are cached between scans.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass, replace
from functools import partial
from pathlib import Path
from threading import Lock
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.cell.driver import Driver
from scancell.cell.fmu_file import ReusableCell
from scancell.cell.instance import CellInstance
from scancell.cell.program import Program
from scancell.cell.recording import Recording, TriggerRecords
from scancell.cell.session import CellSession
from scancell.config.description import si_value
from scancell.config.files import file_entries, plain_data
from scancell.config.loading import Setup
from scancell.config.scan import CoverageDescription
from scancell.config.sensor import SensorDescription, exposure_span, exposure_windows
from scancell.errors import DescriptionError, MeshError, SensorError
from scancell.files import file_state
from scancell.geometry import pose
from scancell.geometry.cad import CadMesh, find_faces
from scancell.geometry.mesh import Mesh
from scancell.geometry.shapes import PartSurface
from scancell.nominal.cell import NominalCell, nominal_cell, with_unknown_obstacles
from scancell.planning.model import PlanningCell, SensorRange, Work
from scancell.planning.motion.assembly import approach, recheck
from scancell.planning.motion.trajectory import TorqueLimits
from scancell.planning.options import pair_clearances, scan_options
from scancell.planning.path_map.configuration_map import QualityFactor
from scancell.planning.plan import Plan
from scancell.planning.planner import plan
from scancell.planning.space_map import with_occupied_space
from scancell.planning.views.coverage import Sight
from scancell.planning.views.features import PointNoise
from scancell.planning.views.placement import with_passing_part
from scancell.progress import Progress
from scancell.proximity.judge import check_cell
from scancell.proximity.motion_check import MotionCheck
from scancell.reconstruction.cloud import Cloud
from scancell.reconstruction.foreign import footprint_of, neighbours_of
from scancell.reconstruction.reconstruct import (
    Dropped,
    Envelope,
    PosesAfter,
    ProfilePoints,
    poses_by_axes,
    reconstruct_sensors,
    with_normals,
)
from scancell.scanning.sense import expose
from scancell.scanning.world import Encoder, World, encoder_sigma, native_material, scenes_of
from scancell.values import Closing
from scancell.visibility import MeasurableSurface, cache_folder, measurable_surface

FOLDER_PREFIX = "scancell-fmu-"


# Commands to the cell before the program starts, such as loading the part.
PreScanHook = Callable[[CellSession], None]

_AT_START = 1e-4  # rad or m, beyond the noise of encoders: farther from its start an axis has moved
_MAX_CELLS = 2
_MAX_PLANS = 16
_CLEARANCE_STEP = 4  # set-points from one look at the clearance of a plan to the next
_ENVELOPE_HEIGHT = 0.5  # m above the table: beyond the reach of the sensor
_ROOM = 5e-3  # m around a held part

T = TypeVar("T")

_LEAST_ON_PLANE = 10  # points that tell the noise of a sensor
_SAMPLES_OF_FACE = 100  # by which a face is judged that is to be seen


class FmuRunner(Closing):
    """Runs programs on one FMU instance, which is reset for each run."""

    def __init__(self) -> None:
        self._folder: Path | None = None
        self._cell: ReusableCell | None = None
        self.token = ""

    def start(self, world: World, collision_outputs: bool = False) -> CellInstance:
        """The initialised instance at time 0, with the cell and its perturbations.

        Raises `DescriptionError` if a perturbation is unknown; `CellError` if the FMU cannot be built or reports an
        error.
        """
        if self._cell is None:
            # The process id in the name lets others remove what a killed process leaves.
            self._folder = Path(tempfile.mkdtemp(prefix=f"{FOLDER_PREFIX}{os.getpid()}-"))
            self._cell = ReusableCell(self._folder)
        instance = self._cell.start(world.for_fmu(collision_outputs), world.as_built)
        self.token = instance.token
        return instance

    def units(self, world: World) -> dict[str, str | None]:
        """Units of the deviations of the cell; raises the same errors as `start`."""
        return self.start(world).units()

    def run(self, world: World, program: Program, progress: Progress, hook: PreScanHook | None = None) -> Recording:
        """Recording of `program`, executed after the commands of `hook`, which may read collision outputs.

        Raises `DescriptionError` if a perturbation is unknown; `CellError` if the FMU cannot be built or reports an
        error, or its controller rejects a command of `hook`.
        """
        progress.stage("driving", program.duration, "s")
        cycle_us = world.setup.cell.world.controller_cycle_us
        try:
            cell = self.start(world, collision_outputs=hook is not None)
            if hook is not None:
                session = CellSession(cell, world.nominal, cycle_us)
                hook(session)
                session.check_start(program)
            return Driver(cell, cycle_us, exposure_span(world.setup.sensor)).run(program, progress.advance)
        except BaseException:
            if self._cell is not None:
                self._cell.discard()  # the state of the instance is unknown
            raise

    def close(self) -> None:
        """Free the instance and its files."""
        cell, self._cell = self._cell, None
        if cell is not None:
            cell.close()
        folder, self._folder = self._folder, None
        if folder is not None:
            shutil.rmtree(folder, ignore_errors=True)


class ScanPipeline(Closing):
    """Runs the steps of scans with cached objects; a context manager that releases them.

    Parameters
    ----------
    threads
        Threads of the ray tracer; 0 uses all cores. Results do not depend on it.

    Attributes
    ----------
    builds
        Number of nominal cells built so far.
    """

    def __init__(self, threads: int = 0) -> None:
        self.threads = threads
        self._cells: OrderedDict[str, tuple[Mesh | None, World]] = OrderedDict()
        self._plans: OrderedDict[str, Plan] = OrderedDict()
        self._planning = Lock()
        self.runner = FmuRunner()
        self.builds = 0

    def load(
        self,
        setup: Setup,
        part: Mesh | None,
        *,
        as_built: Sequence[str] = (),
        seed: int = 0,
        part_file: Path | None = None,
        unit: str = "mm",
        recording_file: Path | None = None,
        estimated_sensor: SensorDescription | None = None,
    ) -> World:
        """The world of a setup with `part` or an empty table; the cells and scenes of the two used last are cached.

        Raises `MeshError` if a mesh of the description cannot be used; `CellError` if the description of the cell is
        inconsistent; `DescriptionError` or `SensorError` as `World.sensor` and `World.sensor_true`.
        """
        cell, words = setup.cell, tuple(as_built)

        def make() -> World:
            self.builds += 1
            nominal = nominal_cell(cell, part)
            if setup.scan.belt is not None:
                nominal = nominal.on_belt()
            true = with_unknown_obstacles(nominal, cell)
            check_cell(true)
            own, *beside = scenes_of(true)
            return World(setup, nominal, true, *own, PartSurface(nominal.part), beside=tuple(beside))

        described = cell.model_dump_json(exclude={"estimated"})
        files = [file_state(Path(table[key])) for table, key, _ in file_entries(plain_data(cell))]
        # The cached reference to the mesh prevents reuse of its id.
        key = f"{id(part)} {setup.scan.belt is None} {described} {files}"
        _, world = _kept(self._cells, key, _MAX_CELLS, lambda: (part, make()))
        world = replace(
            world,
            setup=setup,
            as_built=words,
            seed=seed,
            part_file=part_file,
            unit=unit,
            recording_file=recording_file,
            estimated_sensor=estimated_sensor,
        )
        for one in world.sensors:
            _ = one.sensor, one.sensor_true, one.delays  # wrong ones are found before anything moves
        return world

    def plan(
        self,
        world: World,
        saved: Plan | None = None,
        quality_factors: Sequence[QualityFactor] = (),
        progress: Progress | None = None,
    ) -> Plan:
        """The plan of the scan description, or a `saved` one checked again.

        It is cached by a digest of all inputs, unless there are `quality_factors`, see `planner.plan`. Any thread may
        call; one that requests the same plan meanwhile waits for it. `progress` may cancel; its steps are not counted.

        Raises `DescriptionError` if a file of occupied space cannot be used, or a pair with its own clearance does not
        exist; `PlanningError` naming the poses that cannot be reached, or the bodies that collide.
        """
        setup = world.setup
        work = Work(setup.scan.max_planning_work, progress)
        cell = replace(self._planning_cell(world), work=work)
        is_dynamic = setup.cell.robot.drive == "dynamic"
        options = scan_options(setup.scan, setup.sensor, setup.profile_time)
        if setup.scan.belt is not None:
            cell = replace(cell, nominal=with_passing_part(cell.nominal, setup.scan.belt, cell.cycle))
        cell.nominal.require_scanned()
        nominal, at_start = cell.nominal, tuple(axis.start for axis in world.nominal.further_axes)
        _require_fixed_parts(setup, nominal)
        if saved is not None and saved.program.further != at_start:
            raise DescriptionError(
                file=saved.source or None,
                key="further",
                value=list(saved.program.further),
                expected=f"{list(at_start)}, where the further axes of the cell start",
            )
        sight = self.sight(world, nominal, work)
        # Only what this plan depends on: a study of other values plans once.
        described: list[Any] = [
            setup.scan.model_dump_json(),
            options.spacing,
            [path.pitch_mm for path in options.scan.path],
        ]
        if setup.scan.coverage.enabled:
            further = setup.cell.further_sensor
            described += [setup.sensor.model_dump_json(), *(one.model_dump_json() for one in further)]
        described += [setup.cell.model_dump_json()] if is_dynamic else []
        key = _digest([_without_optics(nominal), cell.range, cell.cycle, *described])
        key += "" if saved is None else _digest([saved.program])

        def make() -> Plan:
            here = _with_torques(cell, setup)
            if saved is not None:
                return recheck(here, saved, options)
            return plan(here, options, sight, quality_factors)

        if quality_factors:
            return make()

        with self._planning:
            return _kept(self._plans, key, _MAX_PLANS, make)

    def sight(self, world: World, nominal: NominalCell | None = None, work: Work | None = None) -> Sight:
        """What views of the part see in a nominal cell, by default that of the world; see `Sight`."""
        setup, nominal, work = world.setup, nominal or world.nominal, work or Work()
        beside = [(one.sensor or setup.sensor) if one.every == 1 else None for one in setup.cell.further_sensor]
        find = partial(self._measurable, work, _faces_to_see(setup.scan.coverage, nominal.part))
        noise = point_noise(world) if setup.scan.coverage.feature else None
        return Sight(nominal.with_axes_held(), setup.sensor, find, self.threads, work, beside=beside, noise=noise)

    def approach(
        self,
        world: World,
        start: NDArray[np.float64],
        goal: NDArray[np.float64],
        purpose: str,
    ) -> Program | None:
        """Motions between joints and table angles (joints + 1,), rad; None if both are the same.

        Axes beyond the table rest where `start` (axes,) has them, or where they start.

        Raises `PlanningError` if no path free of collision is found, naming the bodies that collide on the direct one.
        """
        setup = world.setup
        joints_and_table = len(world.nominal.home) + 1
        start, further = np.split(world.nominal.with_further_axes(start), [joints_and_table])
        cell = _with_torques(self._planning_cell(world), setup).held(tuple(further.tolist()))
        clearance = scan_options(setup.scan, setup.sensor).clearance
        return approach(cell, clearance, start, goal[:joints_and_table], purpose)

    def clearance(self, world: World, plan: Plan, bound: float) -> float:
        """Smallest distance of a plan between bodies, m, at most `bound`, m; see `PlanningCell.least_distance`."""
        axes = np.concatenate([segment.all_axes for segment in plan.program.segments])[::_CLEARANCE_STEP]
        cell, joints_and_table = self._planning_cell(world), len(world.nominal.home) + 1
        if not np.ptp(axes[:, joints_and_table:], axis=0).any():  # what no axis moves may touch
            cell, axes = cell.held(), axes[:, :joints_and_table]
        return cell.least_distance(axes, bound)

    def motion_check(self, world: World) -> MotionCheck:
        """Proof that motions of joints and table keep the clearances of plans; other axes rest where they start."""
        setup = world.setup
        cell = self._planning_cell(world).held()
        return cell.motion_check(scan_options(setup.scan, setup.sensor).clearance)

    def _planning_cell(self, world: World) -> PlanningCell:
        setup = world.setup
        cycle = setup.cell.world.controller_cycle
        nominal, held = world.nominal, world.nominal.with_axes_held()
        # Measured space was measured where the axes start.
        measured = with_occupied_space(held, setup.scan.occupied).bodies[len(held.bodies) :]
        nominal = replace(nominal, bodies=(*nominal.bodies, *measured)) if measured else nominal
        own, range_ = pair_clearances(setup.scan, nominal), SensorRange.of(world.sensor)
        return PlanningCell(nominal, range_, cycle, threads=self.threads, pair_clearance=own)

    def _measurable(
        self, work: Work, faces: Sequence[int], nominal: NominalCell, sensor: SensorDescription
    ) -> MeasurableSurface:
        """Measurable surface, of a CAD part only that of some faces (numbers from 0), all if there are none."""
        found = measurable_surface(nominal, sensor, progress=work, cache=cache_folder(), threads=self.threads)
        if not faces:
            return found
        assert isinstance(nominal.part, CadMesh)
        triangle = PartSurface(nominal.part).distances(found.samples, self.threads)[1]
        own = np.where(found.measurable, nominal.part.cad_face[triangle], -1)
        wanted = np.zeros(len(own), bool)
        for face in faces:  # a small face counts as much as a large one
            rows = np.flatnonzero(own == face)
            wanted[rows[:: max(1, len(rows) // _SAMPLES_OF_FACE)]] = True
        return found.only(wanted)

    def drive(
        self,
        world: World,
        plan: Plan,
        progress: Progress,
        hook: PreScanHook | None = None,
    ) -> Recording:
        """Recording of the planned program on the simulated cell with its perturbations.

        Raises `DescriptionError` if a perturbation is unknown; `CellError` if the FMU reports an error, or its
        controller rejects a command of `hook`.
        """
        return self.runner.run(world, plan.program, progress, hook)

    def reconstruct(
        self, nominal: NominalCell, recording: Recording, profiles: ProfilePoints, setup: Setup, normals: bool = True
    ) -> tuple[Cloud, Dropped]:
        """Cloud from measured joints and nominal geometry alone, and the points that are not the part's.

        `nominal` may be an estimated (calibrated) cell, see `World.estimated`.
        """
        measured = measured_motion(nominal, recording)
        made = reconstruct_sensors(
            profiles,
            measured,
            sensor_poses(nominal, measured),
            nominal.support_from_part,
            envelope_of(nominal, setup),
            normals,
            neighbours_of(nominal, _moved_axes(nominal, measured)),
            self.threads,
        )
        return made.cloud, made.dropped

    def with_normals(self, nominal: NominalCell, recording: Recording, cloud: Cloud) -> Cloud:
        """A cloud that was reconstructed in parts, without normals, with its normals; `nominal` as of `reconstruct`."""
        measured = measured_motion(nominal, recording)
        return with_normals(cloud, measured, sensor_poses(nominal, measured), self.threads)

    def close(self) -> None:
        """Release the FMU, its files and the cached scenes."""
        self.runner.close()
        self._cells.clear()
        self._plans.clear()


def _with_torques(cell: PlanningCell, setup: Setup) -> PlanningCell:
    if setup.cell.robot.drive != "dynamic":
        return cell
    return replace(cell, torques=TorqueLimits(setup.cell, cell.nominal))


def sensor_poses(nominal: NominalCell, measured: TriggerRecords) -> list[PosesAfter]:
    """Poses of each sensor of a cell in the frame of the part, by measurements."""
    numbers = range(1, len(nominal.further_sensors) + 2)
    return [poses_by_axes(measured, partial(nominal.part_from_sensor, number=number)) for number in numbers]


def _faces_to_see(coverage: CoverageDescription, part: Mesh) -> list[int]:
    """Numbers of the faces that coverage asks for; none: all."""
    found: dict[int, None] = {}
    for number, goal in enumerate(coverage.feature, 1):
        key = f"scan.coverage.feature[{number}].faces"
        if not isinstance(part, CadMesh):
            raise DescriptionError(key=key, value=goal.faces, expected=f"none: {part.source} is no CAD file")
        try:
            found |= dict.fromkeys(find_faces(part, goal.faces))
        except MeshError as error:
            raise DescriptionError(str(error), key=key) from None
    return list(found)


def point_noise(world: World) -> PointNoise:
    """Noise of points by encoders, and by the sensor on a plane of the part's material in the middle of its range.

    Raises `SensorError` if the sensor sees no such plane.
    """
    setup, nominal, sensor = world.setup, world.nominal, world.sensor
    middle = 0.5e-3 * (setup.sensor.range.near_mm + setup.sensor.range.far_mm)
    scene, still = sensor_rt.Scene(), np.eye(4)[None, None]
    material = next(body.material for body in nominal.bodies if body.name == "part")
    scene.add_plane("plane", pose.translation([0.0, 0.0, middle]), [1.0, 1.0], native_material(material))
    exposures = sensor_rt.Exposures(still, still[:, None], exposure_windows(setup.sensor)[:1, 1], np.arange(1))
    found = expose(scene, sensor, sensor, exposures, np.arange(1), "ray-traced", threads=1).points
    if len(found.sigma) < _LEAST_ON_PLANE:
        raise SensorError(f"sensor '{setup.sensor.name}' measures no plane of the part's material amid its range")
    encoders: list[Encoder] = [*setup.cell.robot.joint, setup.cell.table]
    tree, start = nominal.with_axes_held().tree, [*nominal.home, 0.0]
    part_from_sensor, jacobian = tree.relative("sensor", "part", start[: len(tree.axes)])
    moved = jacobian[:3] + np.cross(jacobian[3:].T, part_from_sensor[:3, 2] * middle).T
    sigmas = [encoder_sigma(one) for one in encoders][: len(tree.axes)]
    common = np.linalg.norm(moved * sigmas) / 3**0.5  # in any one direction
    pitch = float(np.ptp(found.points_in_sensor[:, 1])) / len(found.sigma) * len(sensor.cameras)
    return PointNoise(float(np.median(found.sigma)), float(common), pitch)


def _require_fixed_parts(setup: Setup, nominal: NominalCell) -> None:
    """Raise `DescriptionError` where an axis is to move that carries a part that friction alone holds."""
    further = enumerate(setup.cell.further_part, 1)
    fixtures = [("part", "part", setup.cell.part.fixture)]
    fixtures += [(f"further_part[{n}]", f"part[{n + 1}]", one.fixture) for n, one in further]
    moving = [(f"scan.axis[{n}].name", one.name) for n, one in enumerate(setup.scan.axis, 1)]
    moving += [("path.axis", name) for path in setup.scan.path for name in path.axis if name != "table"]
    for moved, name in moving:
        for key, frame, fixture in fixtures:
            if fixture == "free" and name in nominal.tree.axes_of(frame):
                raise DescriptionError(
                    f"carries cell.{key}, which friction alone holds",
                    key=moved,
                    value=name,
                    expected=f'cell.{key}.fixture = "clamped"',
                )


def _moved_axes(nominal: NominalCell, measured: TriggerRecords) -> list[str]:
    """Names of the axes beside joints and table that are not always where they start."""
    at = {axis.name: measured.axes[:, measured.names.index(axis.name)] - axis.start for axis in nominal.further_axes}
    return [name for name, away in at.items() if np.abs(away).max(initial=0.0) > _AT_START]


def measured_motion(nominal: NominalCell, recording: Recording) -> TriggerRecords:
    """Measured positions of the axes at the light of each exposure.

    Raises `DescriptionError` if the recording does not state the axis that moves the part.
    """
    measured = recording.measured
    measured.require_axes(nominal.tree.axes_of("part"))
    return measured.after(nominal.trigger_latency)


def envelope_of(nominal: NominalCell, setup: Setup) -> Envelope:
    """Room above the nominal table, or the belt or flange that carries the part, in which points are kept.

    A held part comes near to other bodies, so that its room ends `_ROOM` beyond its nominal extent.
    """
    lowest, support_from_part = si_value(setup.scan, "table_margin_mm"), nominal.support_from_part
    footprint = footprint_of(nominal.part, support_from_part, lowest)
    corners = np.stack(np.meshgrid(*nominal.part.bounds.T), -1).reshape(-1, 3)
    placed = pose.transform_points(support_from_part, corners)[:, :2]
    outline = np.stack([placed.min(0), placed.max(0)])
    if nominal.support_kind == "belt":
        half_width = si_value(nominal.required_belt().description, "width_mm") / 2
        return Envelope(lowest, _ENVELOPE_HEIGHT, np.inf, footprint, outline, half_width, "belt")
    if nominal.support_kind == "flange":
        held = pose.transform_points(support_from_part, nominal.part.vertices[np.unique(nominal.part.faces)])
        radius, highest = float(np.hypot(held[:, 0], held[:, 1]).max()) + _ROOM, float(held[:, 2].max()) + _ROOM
        return Envelope(lowest, highest, radius, footprint, outline, support="flange")
    return Envelope(lowest, _ENVELOPE_HEIGHT, nominal.table_radius, footprint, outline)


def _kept(store: OrderedDict[str, T], key: str, limit: int, make: Callable[[], T]) -> T:
    """The value for `key`, made when missing; the least recently used value is dropped beyond `limit`."""
    if key not in store:
        store[key] = make()
    store.move_to_end(key)
    while len(store) > limit:
        store.popitem(last=False)
    return store[key]


def _without_optics(nominal: NominalCell) -> list[Any]:
    """The inputs of planning from a nominal cell: all fields but lamps and materials."""
    values = [getattr(nominal, field.name) for field in fields(nominal) if field.name not in {"bodies", "lamps"}]
    return [*values, [(body.name, body.moves_with, body.mesh, body.clearance) for body in nominal.bodies]]


def _digest(value: Any) -> str:
    """Hexadecimal digest of nested dataclasses, sequences, arrays and plain values."""
    digest = hashlib.blake2b(digest_size=16)
    _update(digest, value)
    return digest.hexdigest()


def _update(digest: Any, value: Any) -> None:
    if isinstance(value, np.ndarray):
        digest.update(f"{value.dtype}{value.shape}".encode())
        digest.update(np.ascontiguousarray(value).data)
    elif is_dataclass(value):
        digest.update(type(value).__name__.encode())
        _update(digest, [getattr(value, field.name) for field in fields(value)])
    elif isinstance(value, list | tuple):
        digest.update(f"[{len(value)},".encode())
        for item in value:
            _update(digest, item)
    else:
        digest.update(f"{value!r},".encode())
