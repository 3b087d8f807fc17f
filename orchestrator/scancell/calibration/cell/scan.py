"""Calibration in the simulated cell: design of the poses, scan of the artefact, solution."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from scancell import sensor as sensor_rt
from scancell.arguments import Seed, checked_fields
from scancell.arrays import Array
from scancell.calibration.cell.kinematics import (
    GRASP,
    LATENCY,
    PLATTER,
    TABLE,
    TOOL,
    WOBBLE,
    AxisReadings,
    CellKinematics,
    axis_deviations,
)
from scancell.calibration.cell.points import (
    ABOVE_TABLE,
    AGREED,
    MeasuredPoints,
    belt_axes,
    check_flange,
    mirrored,
    opposite_table,
    shift_of,
    shift_text,
    where_points_lie,
    wrong_sizes,
    wrong_sphere,
)
from scancell.calibration.cell.problem import (
    Artefact,
    CalibrationProblem,
    CalibrationResult,
    Observations,
    RobotNoise,
    points_on_platter,
    surface_of,
)
from scancell.calibration.cell.solve import circles_of, require_known, solve, sphere_start
from scancell.calibration.cell.views import candidates, design_poses, passes, plan_views, turned_tables
from scancell.cell.recording import TriggerRecords, slopes
from scancell.config.cell import CellDescription
from scancell.config.choices import CalibrationTarget, Engine
from scancell.config.study import CalibrateDescription
from scancell.errors import CalibrationError, PlanningError
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh
from scancell.geometry.shapes import ShapeMesh, Sphere
from scancell.geometry.tree import Joint
from scancell.nominal.cell import NominalCell
from scancell.planning.model import PlanningCell, SensorRange, Work
from scancell.planning.options import scan_options
from scancell.planning.plan import Plan
from scancell.progress import Progress
from scancell.reconstruction.reconstruct import ProfilePoints
from scancell.scanning.pipeline import ScanPipeline
from scancell.scanning.scan import Scan
from scancell.scanning.world import World

_LEAST_SIGMA = 1e-7  # m: standard deviation of points of a sensor without noise, whose weights are finite, too
_ON_SHEET = 1e-9  # m
_POSES, _PASSES = 24, 8  # unless stated
_PER_POSE = 20  # candidates per wanted pose
_LEAST_CANDIDATES = 400
_DOUBTFUL_SHARE = 0.01  # of the radius: profiles of a sphere with larger offsets may be those of another size
_SHARES = (1.0, 1.003, 1.01, 1.03)  # radius of a sphere of unknown size in terms of that of its largest circle
_LEAST_POINTS = 30  # of a candidate, on the artefact
_GRID = 3  # positions of a further axis that are tried, for each that is wanted
_SEED_STEP = 7919  # between the seeds of the simulated cell at different positions of its axes
# Expected pose errors of the robot: position (m) and orientation (rad) of the flange.
_EXPECTED = np.log([1.0, 20e-6**2, np.radians(0.003) ** 2])


@checked_fields
@dataclass(frozen=True)
class CalibrationRequest:
    """Quantities and options of a calibration; None selects the default for `what`.

    Attributes
    ----------
    what
        tool: pose of the sensor on the flange or on its post, with the table at rest; where the arm moves neither
        sensor nor artefact, the table turns. grasp: pose of a part on the flange before a sensor on a post, by the
        tool as it is. table: its axis, and the eccentricity of the platter if the artefact's pose is known, by the tool
        as it is. belt: direction of the belt and scale of its encoder, by a scan of a part that it carries past the
        sensor. latency: of the trigger. all: tool, table and latency together.
    also
        Further deviations to find, such as ``dh[3].theta``, by the names of as-built parameters; ``axis.NAME`` means
        all six of a further axis.
    axis_positions
        Number of positions of the further axes at which the artefact is measured, where deviations of one are to be
        found; else they rest where they start.
    poses, passes
        Number of exposures at rest, and of passes in motion.
    is_pose_known, is_size_known
        Whether pose and size of the artefact are exact; else they are found, too. A table that turns about one axis
        does not determine the pose, which is exact by default where the arm rests.
    designed
        Whether poses are chosen for the information that they give; else at random.
    robot_noise
        Where random errors of the robot are expected: none, joints, or flange. Where the arm rests, these are errors of
        the table's angle.
    wobble
        Whether to find the wobble of the table axis, too.
    pose_seed
        Random seed of the views among which poses are chosen.
    further_sensor
        Name of a further sensor on the flange, in the world or on an axis that is calibrated in place of the main one.

    Examples
    --------
    >>> request = scancell.CalibrationRequest("tool", also=("dh[3].theta",))
    >>> report = scancell.calibrate(request, as_built={"dh[3].theta_deg": 0.05})
    >>> [row.name for row in report.rows][-1]
    'dh[3].theta'
    """

    what: CalibrationTarget = "all"
    also: tuple[str, ...] = ()
    wobble: bool = False
    poses: int | None = None
    passes: int | None = None
    is_pose_known: bool | None = None
    is_size_known: bool = True
    designed: bool = True
    robot_noise: RobotNoise = "flange"
    pose_seed: Seed = 0
    further_sensor: str | None = None
    axis_positions: Annotated[int, Field(ge=1, le=100)] = 4

    @classmethod
    def of(cls, described: CalibrateDescription) -> Self:
        """The request that a study has `described`."""
        plain = described.model_dump(exclude={"artefact", "pose"})
        return cls(**plain, is_pose_known=None if described.pose is None else described.pose == "described")

    def artefact_in(self, cell: CellDescription) -> str:
        """Default artefact in a `cell`, a shipped one: a tilt of the table axis needs spheres in different places.

        So do the pose of a held part, and that of a sensor past which the table alone moves the artefact.
        """
        arm_rests = cell.tool.moves_with != "flange" and cell.part.moves_with == "table"
        if self.what == "belt":
            return "parts/free_form.stl"  # slopes in all directions, and it lies still on the belt
        needs_several = self.turns_table or self.what == "grasp" or arm_rests
        return "artefacts/ball_plate.toml" if needs_several else "artefacts/sphere.toml"

    @property
    def turns_table(self) -> bool:
        """Whether exposures are at different angles of the table."""
        return self.what in {"table", "all"} or self.moves_axes

    @property
    def moves_axes(self) -> bool:
        """Whether deviations of a further axis are to be found, by exposures at several of its positions."""
        return any(name.startswith("axis.") for name in self.also)

    @property
    def trusts_pose(self) -> bool:
        """Whether the described pose of the artefact counts as exact; else it is found, too.

        A grasp is the deviation from it.
        """
        return self.turns_table or self.what == "grasp" if self.is_pose_known is None else self.is_pose_known

    def free(self, belt: str | None = None) -> tuple[str, ...]:
        """Deviations to find, see `scancell.calibration.cell.kinematics`; `belt` names that which carries the part."""
        if self.what == "belt" and belt is not None:
            return tuple(dict.fromkeys((*axis_deviations(belt), *self.also)))
        table = TABLE + (PLATTER if self.trusts_pose else ()) + (WOBBLE if self.wobble else ())
        free = {"tool": TOOL, "grasp": GRASP, "table": table, "latency": (LATENCY,), "all": (*TOOL, *table, LATENCY)}[
            self.what
        ]
        also = [
            one
            for name in self.also
            for one in (axis_deviations(name[5:]) if re.fullmatch(r"axis\.\w+", name) else (name,))
        ]
        return tuple(dict.fromkeys((*free, *also)))

    @property
    def pose_count(self) -> int:
        """Number of exposures at rest."""
        return (0 if self.what == "latency" else _POSES) if self.poses is None else self.poses

    @property
    def pass_count(self) -> int:
        """Number of passes in motion."""
        return (_PASSES if self.what in {"latency", "all"} else 0) if self.passes is None else self.passes


@dataclass(frozen=True)
class Calibration:
    """A calibration with its inputs; without plans if the points came from a file.

    There is a plan for each position of the further axes. `measured` is the number of points, those beside the artefact
    included, which are no part of the problem. `shift` (3,) is that of the artefact's coordinates on the table, see
    `shift_of`.
    """

    problem: CalibrationProblem
    result: CalibrationResult
    measured: int
    plans: tuple[Plan, ...]
    shift: Array


def kinematics_of(nominal: NominalCell) -> CellKinematics:
    """Kinematics of the nominal cell for calibration."""
    if not nominal.arm_rests:
        nominal.require_scanned()
    part = nominal.table_from_part if nominal.holds_part else None
    further = tuple(axis.joint for axis in nominal.further_axes)
    carriers = nominal.arm_on, nominal.table_on, None if nominal.carries_sensor else nominal.sensor.parent
    sensor = nominal.sensor.parent_from_joint
    belt = nominal.support if nominal.support_kind == "belt" else None
    further += tuple(nominal.tree[name] for name in belt_axes(nominal))
    return CellKinematics(nominal.arm, sensor, nominal.world_from_table, part, further, *carriers, belt)


def _require_possible(request: CalibrationRequest, nominal: NominalCell) -> None:
    """Raise `CalibrationError` if the cell does not have what is to be found, or that is to stay unknown."""
    possible: tuple[CalibrationTarget, ...] = ("tool", "table", "latency", "all")
    holds = "the part is not on the flange"
    if nominal.holds_part:
        possible, holds = ("tool", "grasp", "latency"), "the arm holds the part"
    elif nominal.support_kind == "belt":
        possible, holds = ("belt",), "a belt carries the part"
    elif nominal.arm_rests:
        possible, holds = ("tool",), "the arm moves neither sensor nor part"
    if request.what not in possible:
        raise CalibrationError(holds, key="what", value=request.what, expected=", ".join(possible))
    if request.what == "grasp" and not request.trusts_pose:
        raise CalibrationError(
            "is what a calibration of the grasp finds", key="pose", value="unknown", expected="described"
        )
    if nominal.arm_rests and request.pass_count:
        raise CalibrationError(
            "the arm moves neither sensor nor part", key="passes", value=request.passes, expected="0"
        )


def readings_of(measured: TriggerRecords, further: Sequence[Joint] = ()) -> AxisReadings:
    """Readings of joints, table and `further` axes at every trigger, with the accelerations between triggers."""
    moved = [*range(measured.names.index("table") + 1), *(measured.names.index(joint.axis) for joint in further)]
    rates = measured.rates[:, moved]
    accelerations = slopes(rates, measured.time, measured.segment)
    return AxisReadings(measured.axes[:, moved], rates, accelerations, further=tuple(further))


def observations_of(profiles: ProfilePoints, readings: AxisReadings, sensor: sensor_rt.Sensor) -> Observations:
    """Points without warning flags, with the direction in which an error of the row of their peak moves them."""
    good = profiles.flags == 0
    points = profiles.points_in_sensor[good]
    # Lines of constant column in the laser sheet meet along the camera's rows from its centre.
    centre, along = (np.stack([one.sensor_from_camera[:3, i] for one in sensor.cameras]) for i in (3, 1))
    meeting = centre - along * centre[:, :1] / along[:, :1]
    direction = points - meeting[np.clip(profiles.camera[good], 0, None)]
    return Observations(
        readings=readings,
        points_in_sensor=points,
        sigma=np.maximum(profiles.sigma[good], _LEAST_SIGMA),
        direction=direction / np.linalg.norm(direction, axis=1, keepdims=True),
        frame=np.asarray(profiles.frame[good], np.intp),
        time_offset=profiles.time_offset[good],
        off_sheet=_off_sheet(points, profiles.camera[good], sensor),
    )


def _off_sheet(points: Array, camera: NDArray[np.int32], sensor: sensor_rt.Sensor) -> Array | None:
    """From points (m, 3) to the described sheet, on the lines of sight of their cameras; None if they are on it."""
    found = np.zeros_like(points)
    for number, one in enumerate(sensor.cameras):
        rows = camera == number
        seen = sensor_rt.triangulate_pixels(one.project(points[rows]), sensor, number, "sheet")
        found[rows] = np.nan_to_num(seen - points[rows])
    return found if np.abs(found).max(initial=0.0) > _ON_SHEET else None


def artefact_of(nominal: NominalCell, request: CalibrationRequest) -> Artefact:
    """The artefact at its described pose.

    Raises `CalibrationError` if the sizes of a mesh are asked for.
    """
    part = nominal.part
    sizes: tuple[int, ...] = ()
    if not request.is_size_known:
        if not isinstance(part, ShapeMesh):
            raise CalibrationError("a mesh has no unknown size", file=part.source, expected="an artefact description")
        sizes = tuple(number for number, one in enumerate(part.shapes.shapes) if one.role == "measured")
    return Artefact(surface_of(part), nominal.support_from_part, request.trusts_pose, sizes)


class CalibrationScan:
    """Measures an artefact in the cell, and calibrates it.

    Parameters
    ----------
    world
        The artefact in the nominal cell.
    start
        Deviations to start from, SI, by name; those that are not free stay.

    Raises `DescriptionError` if the arm moves both artefact and sensor; `CalibrationError` if the request is impossible
    in the cell.
    """

    def __init__(
        self,
        pipeline: ScanPipeline,
        world: World,
        request: CalibrationRequest,
        start: Mapping[str, float],
    ) -> None:
        nominal = world.nominal
        if not nominal.arm_rests:
            nominal.require_scanned()
        elif request.is_pose_known is None:
            request = replace(request, is_pose_known=True)
        if not (nominal.carries_sensor or nominal.holds_part or request.robot_noise == "none"):
            request = replace(request, robot_noise="joints")
        _require_possible(request, nominal)
        self.pipeline, self.world = pipeline, world
        self.request, self._start = request, start
        self._part, self._scan = world.nominal.part, scan_options(world.setup.scan, world.setup.sensor)
        cycle = world.setup.cell.world.controller_cycle
        range_ = SensorRange.of(world.sensor)
        self._cell = PlanningCell(world.nominal.with_axes_held(), range_, cycle, threads=pipeline.threads)

    @cached_property
    def plan(self) -> Plan:
        """Collision-free program of the poses and passes, or of the scan on the belt.

        Raises `CalibrationError` if too few views of the artefact are feasible; `PlanningError` if no collision-free
        path is found.
        """
        if self.request.what == "belt":
            return self.pipeline.plan(self.world)
        rng, count = np.random.default_rng(self.request.pose_seed), self.request.pass_count
        still = self.still_poses(rng)
        moving = passes(self._cell, count, rng, self._scan) if count else []
        return plan_views(self._cell, self._scan, still, moving)

    def run(self, world: World, engine: Engine, progress: Progress) -> Calibration:
        """Drive, sense and solve; `world` is that of the nominal cell with as-built deviations and a seed of its own.

        Raises `CalibrationError` if the artefact cannot be measured, or what was measured does not determine the
        unknowns.
        """
        stations = self._stations(progress)
        measured = []
        for number, (position, station) in enumerate(stations):
            seed = (world.seed + _SEED_STEP * number) % 2**31 if number else None
            measured.append(station.measure(world.with_axes_at(position, seed), engine, progress))
        progress.stage("solving", 1, "solution")
        found = self.solve(joined(measured), tuple(station.plan for _, station in stations))
        progress.advance(1)
        return found

    def measure(self, world: World, engine: Engine, progress: Progress) -> Observations:
        """Drive the plan, and sense; `world` as of `run`."""
        recording, sensed = Scan(self.pipeline, world, engine).measure(self.plan, progress)
        readings = readings_of(recording.measured, kinematics_of(self.world.nominal).further)
        return observations_of(sensed.points, readings, world.sensor)

    def _stations(self, progress: Progress) -> list[tuple[Array, CalibrationScan]]:
        """Positions (k,) of the further axes, and the planned exposures at each.

        They start where the cell does; each next one is far from those before. Positions from which too few views of
        the artefact are feasible are left out.
        """
        progress.stage("planning", 1, "plan")
        self._cell = replace(self._cell, work=Work(self.world.setup.scan.max_planning_work, progress))
        kinematics = kinematics_of(self.world.nominal)
        require_known(self.request.free(kinematics.belt), kinematics)
        nominal, request = self.world.nominal, self.request
        start = nominal.start[len(nominal.home) + 1 :]
        wanted = request.axis_positions if request.moves_axes and len(start) else 1
        own = self if wanted == 1 else self._at(start, wanted, is_first=True)
        own.plan  # noqa: B018  (its errors are those of the cell as described)
        found = [(start, own)]
        for position in _spread(nominal, start, _GRID * wanted):
            if len(found) == wanted:
                break
            station = self._at(position, wanted, is_first=False)
            with suppress(CalibrationError, PlanningError):
                station.plan  # noqa: B018
                found.append((position, station))
        progress.advance(1)
        return found

    def _at(self, position: Array, stations: int, *, is_first: bool) -> CalibrationScan:
        """A share of the exposures with the further axes at positions (k,); passes where they start alone."""
        request = self.request
        poses = -(-request.pose_count // stations)
        shared = replace(request, poses=poses, passes=request.pass_count if is_first else 0)
        station = CalibrationScan(self.pipeline, self.world.with_axes_at(position), shared, self._start)
        station._cell = replace(station._cell, work=self._cell.work)
        return station

    def solve(self, measured: Observations, plans: tuple[Plan, ...] = ()) -> Calibration:
        """Calibrate by measured profiles of the artefact.

        Raises `CalibrationError` if they do not determine the unknowns; the message names what is likely to be the
        cause.
        """
        problem = self.problem(measured)
        try:
            result = solve(problem)
        except CalibrationError as error:
            said = self._too_few(measured) or "; ".join([str(error), *filter(None, self._causes(measured, problem))])
            raise CalibrationError(said) from None
        whole = self._problem(measured)
        sphere = None if whole.artefact.unknown_sizes else single_sphere(whole, self._part)
        # A wrong size would pass as an offset of each profile.
        if sphere is not None and result.noise_of_surface > _DOUBTFUL_SHARE * sphere[0]:
            wrong = wrong_sphere(whole, *sphere)
            if wrong:
                raise CalibrationError(wrong)
        shift = shift_of(self.world.nominal, self.world.setup.cell.part)
        return Calibration(problem, result, len(measured.sigma), plans, shift)

    def solve_measured(self, measured: MeasuredPoints) -> Calibration:
        """Calibrate by points of a file.

        Raises `CalibrationError` as `solve`, or if flange poses disagree with profiles of a sphere.
        """
        problem = self._problem(measured.observations)
        sphere = single_sphere(problem, self._part)
        if sphere is not None and measured.flange is not None:
            check_flange(measured, problem, *sphere)
        return self.solve(measured.observations)

    def _too_few(self, measured: Observations) -> str:
        """How many exposures of a sphere are needed, as a sentence; empty if there are enough."""
        problem = self._problem(measured)
        unknowns = len(problem.free) + (0 if problem.artefact.is_pose_known else 3)
        exposures, wanted = len(np.unique(measured.frame)), -(-unknowns // 2)
        if exposures >= wanted or single_sphere(problem, self._part) is None:
            return ""
        return (
            f"a sphere in {exposures} exposure(s) does not determine {unknowns} unknowns, its centre included: the"
            f" circle in a profile gives two coordinates of the centre, so that {wanted} exposures or more are needed,"
            " at orientations of the sensor that differ by 20 deg or more about two axes"
        )

    def _causes(self, measured: Observations, problem: CalibrationProblem) -> Iterator[str]:
        """Likely causes of unusable points; a cause that explains all of them is returned alone."""
        whole = self._problem(measured)
        sphere = single_sphere(whole, self._part)
        cause = (
            (sphere is not None and wrong_sphere(whole, *sphere))
            or wrong_sizes(problem, self._part)
            or mirrored(self.problem, measured)
            or opposite_table(self.problem, measured)
        )
        if cause:
            yield cause
            return
        if measured.readings.flange is not None and sphere is not None:
            return  # where the sphere is, its profiles tell; there may be no table
        yield where_points_lie(replace(problem, observations=measured), self._part)
        yield shift_text(shift_of(self.world.nominal, self.world.setup.cell.part))

    def problem(self, measured: Observations) -> CalibrationProblem:
        """The problem that measured profiles of the artefact pose."""
        problem = with_sphere_start(self._problem(measured), self._part)
        return replace(problem, observations=measured.chosen(on_artefact(problem)))

    def _problem(self, observed: Observations) -> CalibrationProblem:
        nominal, request = self.world.nominal, self.request
        kinematics = kinematics_of(nominal)
        return CalibrationProblem(
            kinematics=kinematics,
            observations=observed,
            artefact=artefact_of(nominal, request),
            free=request.free(kinematics.belt),
            start=self._start,
            robot_noise=request.robot_noise,
        )

    def still_poses(self, rng: np.random.Generator) -> Array:
        """Positions (n, axes), rad, of the exposures at rest, chosen among random ones of the generator.

        Raises `CalibrationError` if too few of them show the artefact.
        """
        count = self.request.pose_count
        if not count:
            return np.empty((0, len(self._cell.start)))
        wanted = max(_PER_POSE * count, _LEAST_CANDIDATES)
        clearance, most = self._scan.clearance, -1
        views: Iterable[Array] = (
            turned_tables(self._cell, wanted, rng, clearance)
            if self.world.nominal.arm_rests
            else [candidates(self._cell, wanted, rng, clearance, self.request.turns_table)]
        )
        for axes in views:
            posed = self._problem(self._expected_observations(axes))
            posed = replace(posed, observations=posed.observations.chosen(on_artefact(posed)))
            frame = posed.observations.frame
            showing = np.flatnonzero(np.bincount(frame, minlength=len(axes)) >= _LEAST_POINTS)
            if len(showing) > most:
                found, problem, seen, most = axes, posed, showing, len(showing)
            if most >= count:
                break
        if most < count:
            raise CalibrationError(
                f"{len(seen)} of {len(found)} random views show {_LEAST_POINTS} points of it, {count} poses"
                " were requested: place it where the sensor sees more of it",
                file=self._part.source,
            )
        if not self.request.designed:
            return found[seen[:count]]
        problem = replace(_of_exposures(problem, seen), robot_noise="flange")
        return found[seen[design_poses(problem, _EXPECTED, count).rows]]

    def _expected_observations(self, axes: Array) -> Observations:
        """Observations of the nominal sensor at positions (n, axes) in the nominal cell, by ideal rays."""
        sensor, index = self.world.sensor, np.arange(len(axes), dtype=np.int64)
        nominal, once = self.world.nominal, np.array([[0.0, sensor.exposure]])
        axes = nominal.with_further_axes(axes)
        sensed = self.world.expose_at_rest(
            nominal.frame_poses(axes), index, once, "geometric", threads=self.pipeline.threads
        )
        return observations_of(sensed.points, AxisReadings.at_rest(axes, kinematics_of(nominal).further), sensor)


def joined(parts: Sequence[Observations]) -> Observations:
    """Observations one after the other; all have directions, and none has shapes."""
    if len(parts) == 1:
        return parts[0]
    counts = np.cumsum([0, *(len(part.readings) for part in parts)])
    axes, rates, accelerations = (
        np.concatenate([getattr(part.readings, name) for part in parts]) for name in ("axes", "rates", "accelerations")
    )
    directions = [part.direction for part in parts if part.direction is not None]
    off_sheet = [part.off_sheet for part in parts if part.off_sheet is not None]
    return Observations(
        AxisReadings(axes, rates, accelerations, further=parts[0].readings.further),
        np.concatenate([part.points_in_sensor for part in parts]),
        np.concatenate([part.sigma for part in parts]),
        np.concatenate(directions) if directions else None,
        np.concatenate([part.frame + first for part, first in zip(parts, counts[:-1], strict=True)]),
        np.concatenate([part.time_offset for part in parts]),
        off_sheet=np.concatenate(off_sheet) if len(off_sheet) == len(parts) else None,
    )


def _spread(nominal: NominalCell, start: Array, count: int) -> Iterator[Array]:
    """Positions (k,) within the limits of the further axes, each as far as possible from those before and `start`.

    Distances count in terms of the ranges of the axes.
    """
    low, high = np.array([[axis.min, axis.max] for axis in nominal.further_axes]).reshape(-1, 2).T
    if not len(low):
        return
    shares = np.linspace(0.0, 1.0, count)
    # Every axis takes every position of its own once: rows of a lattice.
    left = np.column_stack([shares[(np.arange(count) * step) % count] for step in (1, 5, 7)[: len(low)]])
    done = [(start - low) / (high - low)]
    while len(left):
        nearest = np.min([np.abs(left - one).max(1) for one in done], axis=0)
        number = int(nearest.argmax())
        done.append(left[number])
        left = np.delete(left, number, 0)
        yield low + done[-1] * (high - low)


def with_sphere_start(problem: CalibrationProblem, part: Mesh) -> CalibrationProblem:
    """The problem started from circles in its profiles, where the artefact is one sphere and the tool is unknown."""
    sphere, artefact, data = single_sphere(problem, part), problem.artefact, problem.observations
    if sphere is None:
        return problem
    radius, centre = sphere
    circles = circles_of(data, radius)
    radii = [radius]
    if artefact.unknown_sizes and len(circles):
        radii += [share * float(circles.radius.max()) for share in _SHARES]
    starts = [sphere_start(problem.kinematics, data.readings, circles.of_sphere(one), centre) for one in radii]
    found = min(filter(None, starts), key=lambda one: one.rms, default=None)
    if found is None or found.rms > AGREED:
        return problem
    if not artefact.is_pose_known:
        shift = pose.translation(found.centre - centre)
        artefact = replace(artefact, platter_from_artefact=shift @ artefact.platter_from_artefact)
    return replace(problem, start={**problem.start, **found.deviations}, artefact=artefact)


def single_sphere(problem: CalibrationProblem, part: Mesh) -> tuple[float, Array] | None:
    """Radius, and nominal centre (3,) on the platter, of an artefact that is one sphere; None if the tool is known."""
    measured = part.shapes.measured if isinstance(part, ShapeMesh) else ()
    if len(measured) != 1 or not set(TOOL) <= set(problem.free) or not isinstance(measured[0].shape, Sphere):
        return None
    in_artefact = measured[0].frame_from_shape[None, :3, 3]
    return measured[0].shape.radius, pose.transform_points(problem.artefact.platter_from_artefact, in_artefact)[0]


def on_artefact(problem: CalibrationProblem) -> NDArray[np.bool_]:
    """Flags (m,) of the points on the artefact, within its reach and above the table, by the start of the problem.

    Points by flange poses need not be above the table: a cell that is described for its poses alone may have none.
    """
    data, artefact = problem.observations, problem.artefact
    poses = problem.kinematics.poses(data.readings, problem.start)
    points = points_on_platter(data, poses)
    local = pose.transform_points(pose.inverse(artefact.platter_from_artefact), points)
    above = points[:, 2] > ABOVE_TABLE if data.readings.flange is None else True
    return np.asarray((artefact.surface.assign(local) >= 0) & above)


def _of_exposures(problem: CalibrationProblem, rows: NDArray[np.intp]) -> CalibrationProblem:
    """The problem of some of its exposures alone, numbered anew."""
    data = problem.observations
    number = np.full(len(data.readings), -1)
    number[rows] = np.arange(len(rows))
    kept = data.chosen(number[data.frame] >= 0)
    return replace(problem, observations=replace(kept, readings=data.readings.rows(rows), frame=number[kept.frame]))
