"""Placement of views: azimuth, roll and inverse-kinematics branch, chosen by reach, joint limits and collisions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from scancell.arrays import Array, Flags, Indices
from scancell.cell.program import BeltRun
from scancell.config.description import si_value
from scancell.config.scan import BeltDescription
from scancell.errors import DescriptionError, PlanningError
from scancell.geometry import pose
from scancell.geometry.mesh import box_mesh
from scancell.nominal.cell import NominalCell, with_table
from scancell.nominal.parts import pose_matrix
from scancell.planning.model import PlanningCell, SensorRange, describe, out_of_reach
from scancell.planning.motion import trajectory
from scancell.planning.motion.trajectory import slowdown
from scancell.planning.path_map import configuration_map
from scancell.planning.views.views import Pass, Sweep
from scancell.proximity.motion_check import MotionClash

if TYPE_CHECKING:
    from scancell.planning.views.sensor_paths import SensorPath

# Fraction of the speed and acceleration limits of joints and table that planned motions use.
LIMIT_FRACTION = 0.8
PATH_ACCELERATION = 0.5  # m/s² along straight passes
_AZIMUTH_STEP = np.radians(15.0)
_SLOWEST = 100.0  # factor by which a pass may be slowed: near a singular position its proof would take minutes
MIN_METRIC = 1e-3  # product of Eq. 7 below which a pose counts as infeasible: too near to a joint limit
_TURN_CHECKS = 120  # table angles per turn at which collisions are checked
_TURN_STEPS = 24  # parts of a turn of the table that are free or not
_MAX_TRIES = 24  # choices that keep the clearance where it is checked first

_MARGIN = 5e-3  # m of travel before and after the part that is scanned, too
_LEAST_CROSSING = 0.2  # component along the belt of the unit normal of the laser sheet


@dataclass(frozen=True)
class PlacedSweep:
    """A sweep with the joints and table angle at its start (axes,), rad, and its inverse-kinematics branch.

    `axis` is the column of the axis that makes the full turn: the table, or the last joint of an arm that holds the
    part. Axes beside joints and table, if any, rest at `further`.
    """

    view: Sweep
    start: Array
    axis: int
    branch: int
    further: tuple[float, ...] = ()

    @property
    def is_of_table(self) -> bool:
        """Whether the table turns."""
        return self.axis == len(self.start) - 1

    @property
    def ends(self) -> tuple[Array, Array]:
        """Joints and table angle (axes,), rad, where it starts and ends; the table ends where it started."""
        return self.start, self.start if self.is_of_table else turned(self.start, self.axis, np.array([2 * np.pi]))[0]


@dataclass(frozen=True)
class PlacedPass:
    """A pass with its run, the positions (n, axes) of joints and table, rad, of each cycle and at its `exposures`.

    `note` is the reason why it is slower than requested; further axes, if any, rest at `further`, rad or m.
    """

    view: Pass | SensorPath
    run: trajectory.Run
    axes: Array
    exposures: Array
    branch: int
    note: str = ""
    further: tuple[float, ...] = ()

    @property
    def ends(self) -> tuple[Array, Array]:
        """Joints and table angle (axes,), rad, where it starts and ends."""
        return self.axes[0], self.axes[-1]


@dataclass(frozen=True)
class PlacedPose:
    """One exposure at rest with positions (axes,) of joints and table, rad, and those of further axes, if any."""

    name: str
    axes: Array
    further: tuple[float, ...] = ()


@dataclass(frozen=True)
class Infeasible:
    """Why a view is infeasible; `sensor_collides`: the sensor itself does, for any configuration of the arm."""

    reason: str
    sensor_collides: bool = False


Placed = PlacedSweep | PlacedPass
_T = TypeVar("_T", PlacedSweep, PlacedPass, PlacedPose)


def turned(start: Array, axis: int, angles: Array) -> Array:
    """Positions (n, axes), rad: those of the start (axes,), with one axis further by angles (n,)."""
    axes = np.repeat(start[None], len(angles), 0)
    axes[:, axis] += angles
    return axes


def sweep_run(cell: PlanningCell, count: int, speed: float) -> trajectory.Run:
    """A full turn of the part with `count` exposures at a speed, rad/s, or the highest that is planned."""
    axis = cell.turning_axis
    fastest, acceleration, jerk = cell.axis_limits.scaled(LIMIT_FRACTION).of_axis(
        len(cell.nominal.home) if axis is None else axis
    )
    return trajectory.run(count, 2 * np.pi / count, min(speed, fastest), acceleration, cell.cycle, jerk)


def azimuths(preferred: float) -> Array:
    """Candidate azimuths (24,), rad: the preferred one, then every 15 degrees alternately on both sides of it."""
    steps = np.array([0, *(s * k for k in range(1, 12) for s in (-1, 1)), 12])
    return np.asarray(preferred + steps * _AZIMUTH_STEP)


@dataclass(frozen=True)
class _Sides:
    """Ways (k,) to put the sensor at a view: `turn @ view @ roll`, poses (k, 4, 4), with the table at `table`, rad."""

    table: Array
    turn: Array
    roll: Array

    def of(self, views: Array) -> Array:
        """Poses (..., k, m, 4, 4) of the sensor at views (..., m, 4, 4)."""
        return np.asarray(self.turn[:, None] @ views[..., None, :, :, :] @ self.roll[:, None])


class Placer:
    """Finds collision-free configurations of arm and table for views.

    The table turns the part to a suitable azimuth. Where the arm holds the part, whose flange takes the place of the
    table, the table rests, and the last joint makes the full turns of sweeps.

    Parameters
    ----------
    cell
        Nominal cell.
    azimuth
        Preferred azimuth of the sensor in the frame of the table at angle 0, rad.
    clearance
        Smallest allowed distance between bodies, m.
    """

    def __init__(self, cell: PlanningCell, azimuth: float, clearance: float) -> None:
        self._cell = cell
        self._azimuth = azimuth
        self._clearance = clearance
        self._motions = cell.motion_check(clearance)

    def sweeps(self, views: Sequence[Sweep]) -> list[PlacedSweep | Infeasible]:
        """Placed sweeps or why they are infeasible; as many as possible at one azimuth and in one branch."""
        if not views:
            return []
        if blocked := self._blocked_turn():
            return [Infeasible(f"{view.name}: {blocked}") for view in views]
        cell, arm, axis = self._cell, self._cell.nominal.arm, self._cell.turning_axis
        assert axis is not None
        # The last joint takes any azimuth.
        sides = [(a, roll) for a in (azimuths(self._azimuth) if self._turns_table else (0.0,)) for roll in (0.0, np.pi)]
        targets = np.array([[view.at(a, roll) for a, roll in sides] for view in views])
        found = cell.ik(targets.reshape(-1, 4, 4))
        branches = found.shape[1]
        q = found.reshape(len(views), -1, found.shape[-1])
        if self._turns_table:
            metric = configuration_map.arm_metric(arm, q)
        else:
            middle = float(np.mean([limit[axis] for limit in arm.limits]))
            q[..., axis] = np.where(np.isnan(q[..., axis]), np.nan, middle - np.pi)
            metric = configuration_map.arm_metric(arm, q)  # that at the end of the turn is the same
        usable = metric > MIN_METRIC
        # A choice is a side (azimuth and roll) and a branch, numbered side * branches + branch. Choices that serve most
        # views come first, then those near the preferred azimuth.
        offset = np.repeat([abs(a - self._azimuth) for a, _ in sides], branches)
        order = np.lexsort((-metric.mean(0), offset.round(6), -usable.sum(0)))
        table = np.linspace(0.0, 2 * np.pi, _TURN_CHECKS, endpoint=False)
        result: list[PlacedSweep | Infeasible] = []
        for i, view in enumerate(views):

            def start(choice: int, i: int = i) -> Array:
                return np.append(q[i, choice], 0.0 if self._turns_table else cell.table_start)

            def check(choice: int, start: Callable[[int], Array] = start) -> Infeasible | None:
                # Most collisions occur at every angle: check one first.
                axes = turned(start(choice), axis, table)
                return self._collision(axes[:1]) or self._collision(axes)

            def place(
                choice: int, view: Sweep = view, start: Callable[[int], Array] = start
            ) -> PlacedSweep | Infeasible:
                at = start(choice)
                return self._collision_of_turn(at) or PlacedSweep(view, at, axis, choice % branches)

            choices = order[usable[i][order]]
            # Choices of equal roll have the same pose of the sensor relative to the part.
            result.append(self._first_feasible(view.name, choices, choices // branches % 2, check, place, targets[i]))
        return result

    def passes(
        self, views: Sequence[Pass | SensorPath], counts: Sequence[int], speed: float, branch: int | None
    ) -> list[PlacedPass | Infeasible]:
        """Placed passes or why they are infeasible; table and sensor are turned together by a suitable angle.

        A part that the arm holds may move past the sensor in either direction.

        Parameters
        ----------
        counts
            Number of exposures of each view.
        speed
            Speed of the sensor, m/s.
        branch
            Preferred inverse-kinematics branch.
        """
        if not views:
            return []
        cell = self._cell
        runs = [
            trajectory.run(count, view.length / (count - 1), speed, PATH_ACCELERATION, cell.cycle)
            for view, count in zip(views, counts, strict=True)
        ]
        sides = self._sides
        angles = sides.table
        knots = [
            view.at(np.array([*run.at([0.0]), view.length / 2, *run.at([run.duration])]))
            for view, run in zip(views, runs, strict=True)
        ]
        targets = sides.of(np.array(knots))
        found = cell.ik_along(targets.reshape(-1, 3, 4, 4))
        branches = found.shape[2]
        q = found.reshape(len(views), len(angles), *found.shape[1:])
        metric = configuration_map.arm_metric(cell.nominal.arm, q[:, :, ::2]).min(2)
        # The arm may reach both ends of a pass and not its middle.
        metric = np.where(np.isfinite(q[:, :, 1]).all(-1), metric, 0.0).reshape(len(views), -1)
        within = np.repeat(self._is_within_turn(angles), branches)
        usable = (metric > MIN_METRIC) & within
        other_branch = np.tile(np.arange(branches) != branch, len(angles))
        order = np.lexsort((-metric.mean(0), other_branch, -usable.sum(0)))
        result: list[PlacedPass | Infeasible] = []
        for i, view in enumerate(views):

            def check(choice: int, i: int = i) -> Infeasible | None:
                side, number = divmod(choice, branches)
                # Most collisions occur at one of these poses: inverse kinematics along the pass takes much longer.
                return self._collision(with_table(q[i, side, :, number], angles[side]))

            def place(choice: int, i: int = i, view: Pass | SensorPath = view) -> PlacedPass | Infeasible:
                side, number = divmod(choice, branches)
                middle = q[i, side, 1, number]
                return self._try_pass(view, runs[i], counts[i], side, middle, number)

            choices = order[usable[i][order]]
            if not len(choices) and (metric[i] > MIN_METRIC).any():
                result.append(Infeasible(f"{view.name}: {self._blocked_turn()}"))
                continue
            ends = targets[i, :, ::2].reshape(-1, 4, 4)
            result.append(self._first_feasible(view.name, choices, 0 * choices, check, place, ends))
        return result

    def poses(self, part_from_sensor: Array) -> list[PlacedPose | Infeasible]:
        """Placed exposures or why they are infeasible; the table turns the part to a suitable azimuth.

        `part_from_sensor` (n, 4, 4), m.
        """
        table_from_sensor = self._cell.nominal.table_from_part @ part_from_sensor
        origin = table_from_sensor[:, :2, 3]
        if self._turns_table:
            sides = azimuths(self._azimuth)
            angle = sides - np.arctan2(origin[:, 1], origin[:, 0])[:, None]
        else:
            sides, angle = np.array([self._azimuth]), np.full((len(origin), 1), self._cell.table_start)
        turns = angle if self._turns_table else np.zeros_like(angle)
        targets = pose.from_rotation(pose.rotation_about(2, turns)) @ table_from_sensor[:, None]
        found = self._cell.ik(targets.reshape(-1, 4, 4))
        branches = found.shape[1]
        q = found.reshape(len(targets), -1, found.shape[-1])
        metric = configuration_map.arm_metric(self._cell.nominal.arm, q)
        metric = np.where(np.repeat(self._is_within_turn(angle), branches, axis=1), metric, 0.0)
        # Azimuths near the preferred one win over a slightly better metric elsewhere.
        score = metric / (1 + np.repeat(np.abs(sides - self._azimuth), branches))
        order = np.argsort(-score, axis=1, kind="stable")
        result: list[PlacedPose | Infeasible] = []

        def axes(choice: int, i: int) -> Array:
            return np.append(q[i, choice], angle[i, choice // branches])

        for i in range(len(targets)):
            name = f"pose {i + 1}"

            def check(choice: int, i: int = i) -> Infeasible | None:
                return self._collision(axes(choice, i)[None])

            def place(choice: int, i: int = i, name: str = name) -> PlacedPose:
                return PlacedPose(name, axes(choice, i))

            choices = order[i][metric[i][order[i]] > MIN_METRIC]
            result.append(self._first_feasible(name, choices, 0 * choices, check, place, targets[i]))
        return result

    def still(self, name: str, table_from_sensor: Array) -> PlacedPose | Infeasible:
        """The pose (4, 4) of the sensor with the table where it starts, or why it is infeasible."""
        q = self._cell.ik(table_from_sensor[None])[0]
        axes = with_table(q, self._cell.table_start)
        metric = configuration_map.arm_metric(self._cell.nominal.arm, q)
        order = np.argsort(-metric, kind="stable")

        def check(choice: int) -> Infeasible | None:
            return self._collision(axes[choice][None])

        def place(choice: int) -> PlacedPose:
            return PlacedPose(name, axes[choice])

        choices = order[metric[order] > MIN_METRIC]
        return self._first_feasible(name, choices, 0 * choices, check, place, table_from_sensor[None])

    def _first_feasible(
        self,
        name: str,
        choices: Indices,
        groups: Indices,
        check: Callable[[int], Infeasible | None],
        place: Callable[[int], _T | Infeasible],
        targets: Array,
    ) -> _T | Infeasible:
        """The first feasible choice; else why the first is infeasible, or why there is no choice at all.

        All choices are checked, but of those that the `check` does not refuse no more than `_MAX_TRIES` are placed.
        Once the sensor itself collides for one choice, the others of the same number in `groups` are skipped.
        """
        first: Infeasible | None = None
        excluded: set[int] = set()
        tries = 0
        for choice, group in zip(choices.tolist(), groups.tolist(), strict=True):
            if group in excluded:
                continue
            refused = check(choice)
            if refused is None:
                placed = place(choice)
                if not isinstance(placed, Infeasible):
                    return placed
                refused, tries = placed, tries + 1
            first = first or refused
            if refused.sensor_collides:
                excluded.add(group)
            if tries == _MAX_TRIES:
                break
        return Infeasible(f"{name}: {first.reason if first else out_of_reach(self._cell, targets)}")

    @cached_property
    def _turn_clashes(self) -> list[MotionClash | None]:
        """Clashes of the table and its parts in equal steps of a full turn from where it starts, without the arm."""
        cell, angles = self._cell, self._cell.table_start + np.linspace(0.0, 2 * np.pi, _TURN_STEPS + 1)
        axes = with_table(cell.nominal.home, angles)
        return self._motions.first_clashes(axes[:-1], axes[1:], clearance=cell.table_clearances(self._clearance))

    @property
    def _turns_table(self) -> bool:
        """Whether a table turns the part, which the arm does not hold."""
        return not self._cell.nominal.holds_part and self._cell.nominal.table_turns

    @cached_property
    def _sides(self) -> _Sides:
        """Azimuths of the table; with a part on the flange, both directions of the sensor's travel past it."""
        if self._turns_table:
            table = np.radians(np.arange(0.0, 360.0, 15.0))
            turns = pose.from_rotation(pose.rotation_about(2, table))
            return _Sides(table, turns, np.tile(np.eye(4), (len(table), 1, 1)))
        rolls = pose.from_rotation(pose.rotation_about(2, np.array([0.0, np.pi])))
        return _Sides(np.full(2, self._cell.table_start), np.tile(np.eye(4), (2, 1, 1)), rolls)

    def _blocked_turn(self) -> str:
        """Reason why the part cannot make a full turn, whatever the arm does; empty if it can."""
        if not self._turns_table:
            if self._cell.turning_axis is not None:
                return ""
            held = self._cell.nominal.holds_part
            return "no joint turns the part about the axis of the flange" if held else "the table does not turn"
        return next((f"the table cannot turn: {describe(clash)}" for clash in self._turn_clashes if clash), "")

    def _is_within_turn(self, angles: Array) -> Flags:
        """Whether the table gets to `angles` (...,), rad, from where it starts, either way, without the arm."""
        if not self._turns_table:
            return np.ones(angles.shape, bool)
        blocked = np.array([clash is not None for clash in self._turn_clashes])
        step = np.mod(angles - self._cell.table_start, 2 * np.pi) / (2 * np.pi) * _TURN_STEPS
        first, last = (np.argmax(blocked), np.argmax(blocked[::-1])) if blocked.any() else (_TURN_STEPS, _TURN_STEPS)
        return np.asarray((step <= first + 1e-9) | (step >= _TURN_STEPS - last - 1e-9))

    def _collision_of_turn(self, start: Array) -> Infeasible | None:
        """Clash during a full turn of the part from `start` (axes,), rad, with the other axes at rest, or None."""
        axis = self._cell.turning_axis
        assert axis is not None
        (clash,) = self._motions.first_clashes(start, turned(start, axis, np.array([2 * np.pi]))[0])
        return None if clash is None else Infeasible(describe(clash))

    def _collision(self, axes: Array) -> Infeasible | None:
        """The smallest distance below the clearance at positions (n, axes) of joints and table, or None."""
        near = self._cell.clearance_violations(axes, self._clearance)
        if not near:
            return None
        together = {"sensor", "part", *(() if self._cell.nominal.holds_part else ("table", "table_base"))}
        of_sensor = any({c.body_a, c.body_b} <= together for c in near)
        return Infeasible(describe(min(near, key=lambda c: c.distance - c.clearance)), of_sensor)

    def _try_pass(
        self, view: Pass | SensorPath, run: trajectory.Run, count: int, side: int, middle: Array, branch: int
    ) -> PlacedPass | Infeasible:
        """The pass from one side, in one branch, as slow as the limits require; checks reach and collisions.

        The joints (joints,) in its middle determine the turn of joints with several.
        """
        cell, table = self._cell, float(self._sides.table[side])
        turn, roll = self._sides.turn[side], self._sides.roll[side]

        def positions(path: Array) -> Array:
            # All start with the same pose, by which branches without names are numbered.
            along = np.concatenate([run.at([0.0]), path])
            q = cell.ik_along(turn @ view.at(along)[None] @ roll, reference=middle)[0, 1:, branch]
            return with_table(q, table)

        needed = slowdown(cell, lambda time: positions(run.at(time)), run.duration)
        if isinstance(needed, str):
            return Infeasible(needed)
        if needed.factor > _SLOWEST:
            return Infeasible(f"{needed}: the arm is near a singular position")
        exposures = positions(np.linspace(0.0, view.length, count))
        slow = run.slowed(needed.factor)
        moving = positions(slow.at(trajectory.cycle_times(slow.duration, cell.cycle)))
        collision = self._collision(moving[::4])
        if collision is None:
            clash = self._motions.clash_along(moving)
            collision = None if clash is None else Infeasible(describe(clash))
        note = f"{view.name}: {needed}" if needed.factor > 1 else ""
        return collision or PlacedPass(view, slow, moving, exposures, branch, note)


def sensor_over_belt(nominal: NominalCell, scan: BeltDescription) -> Array:
    """Pose (4, 4) of the sensor in the frame of the belt at rest, in a scan of a part that the belt carries past it.

    Raises `DescriptionError` where the arm carries the sensor and its pose is not stated, or the cell places the sensor
    and it is.
    """
    if nominal.carries_sensor != (scan.pose is not None):
        raise DescriptionError(
            f"the sensor is {'on' if nominal.carries_sensor else 'not on'} the arm",
            key="scan.belt.pose",
            value=None if scan.pose is None else scan.pose.model_dump(exclude_defaults=True),
            expected="a pose" if nominal.carries_sensor else "none: the cell places the sensor",
        )
    if scan.pose is not None:
        return pose_matrix(scan.pose)
    world_from_sensor = nominal.with_axes_held().world_from_sensor(())
    return np.asarray(pose.inverse(nominal.required_belt().world_from_belt) @ world_from_sensor)


def crossings(nominal: NominalCell, belt_from_sensor: Array) -> Array:
    """Travel (n,) of the belt, m, at which each vertex of the part lies in the laser sheet, the plane x = 0 of the
    sensor.

    Raises `PlanningError` if the sheet is nearly parallel to the travel.
    """
    normal, origin = belt_from_sensor[:3, 0], belt_from_sensor[:3, 3]
    if abs(normal[0]) < _LEAST_CROSSING:
        angle = np.degrees(np.arcsin(abs(normal[0])))
        raise PlanningError(
            f"the laser sheet is {angle:.1f} deg from the direction of travel",
            key="scan.belt.pose",
            expected=f"at least {np.degrees(np.arcsin(_LEAST_CROSSING)):.1f} deg: the sheet across the belt",
        )
    return np.asarray((origin - _vertices(nominal)) @ normal / normal[0])


def _vertices(nominal: NominalCell) -> Array:
    """Positions (n, 3) of the vertices of the part's faces in the frame of the belt at travel 0, m."""
    used = nominal.part.vertices[np.unique(nominal.part.faces)]
    return pose.transform_points(nominal.required_belt().belt_from_part, used)


def belt_run(nominal: NominalCell, scan: BeltDescription, cycle: float) -> BeltRun:
    """Travel of the belt that brings the whole part through the laser sheet; `cycle` is the controller's, s.

    Raises `PlanningError` if the belt cannot run so fast, or the part is beyond the sensor or leaves the belt.
    """
    belt, speed = nominal.required_belt(), si_value(scan, "speed_mm_s")
    highest, length = si_value(belt.description, "max_speed_mm_s"), si_value(belt.description, "length_mm")
    if abs(speed) > highest:
        raise PlanningError(
            key="scan.belt.speed_mm_s", value=1e3 * speed, expected=f"at most {1e3 * highest:g}, its conveyor's"
        )
    direction = np.copysign(1.0, speed)
    travel = direction * crossings(nominal, sensor_over_belt(nominal, scan))
    if travel.min() <= 0.0:
        raise PlanningError(
            f"the part starts {-1e3 * travel.min():.1f} mm beyond the laser sheet",
            key="scan.belt.pose",
            expected="a sensor that the part reaches later: move it along the belt, or reverse speed_mm_s",
        )
    last = travel.max() + _MARGIN
    x = pose.transform_points(belt.belt_from_part, nominal.part.vertices)[:, 0]
    reached = (x.min() + x.max()) / 2 + direction * (last + _stopping(nominal, scan, cycle, last))
    if abs(reached) > length / 2:
        raise PlanningError(
            f"the part leaves the belt: its centre stops {1e3 * abs(reached):.1f} mm from the middle, its end is at"
            f" {5e2 * length:g} mm",
            key="scan.belt.pose",
            expected="a sensor nearer to the start of the part, or a lower speed_mm_s",
        )
    # Exposures begin in the first controller cycle beyond `trigger_from`.
    first = max(0.0, travel.min() - _MARGIN - abs(speed) * cycle)
    return BeltRun(belt.conveyor, speed, direction * first, direction * last)


def _stopping(nominal: NominalCell, scan: BeltDescription, cycle: float, last: float) -> float:
    """Travel until the belt is at rest, m, after the last exposure at a travel of `last`, m."""
    acceleration = si_value(nominal.required_belt().description, "max_acceleration_mm_s2")
    speed = abs(si_value(scan, "speed_mm_s"))
    reached = min(speed, np.sqrt(2 * acceleration * last))  # from rest
    return float(2 * cycle * speed + reached**2 / (2 * acceleration))


def with_passing_part(nominal: NominalCell, scan: BeltDescription, cycle: float) -> NominalCell:
    """The cell for planning: in place of the part, the box that it sweeps on the belt until it is at rest again."""
    belt, run = nominal.required_belt(), belt_run(nominal, scan, cycle)
    points = pose.transform_points(belt.belt_from_part, nominal.part.vertices)
    ends = np.array(
        [0.0, run.trigger_to + np.copysign(_stopping(nominal, scan, cycle, abs(run.trigger_to)), run.speed)]
    )
    low, high = points.min(0), points.max(0)
    low[0] += ends.min()
    high[0] += ends.max()
    swept = box_mesh(high - low, nominal.part.source).transformed(
        belt.world_from_belt @ pose.translation((low + high) / 2)
    )
    bodies = [
        replace(body, moves_with="world", mesh=swept, patches=()) if body.moves_with == "part" else body
        for body in nominal.bodies
    ]
    return replace(nominal, bodies=tuple(bodies))


def spacing_and_count(run: BeltRun, scan: BeltDescription, max_profiles: int) -> tuple[float, int, list[str]]:
    """Travel between exposures (m) and their number, at most `max_profiles`, with a warning if it is larger."""
    length = abs(run.trigger_to - run.trigger_from)
    requested = si_value(scan, "pitch_mm")
    pitch = max(requested, length / max(1, max_profiles - 1))
    warnings = []
    if pitch > requested:
        warnings.append(
            f"scan.belt.pitch_mm is increased from {1e3 * requested:g} to {1e3 * pitch:.3f} to stay within "
            f"scan.max_profiles = {max_profiles}"
        )
    return pitch, int(length / pitch) + 1, warnings


def range_warnings(nominal: NominalCell, scan: BeltDescription, range_: SensorRange) -> list[str]:
    """Warning about the share of the part that passes outside the measuring range."""
    points, at = _vertices(nominal), sensor_over_belt(nominal, scan)
    points[:, 0] += crossings(nominal, at)
    _, y, z = pose.transform_points(pose.inverse(at), points).T
    outside = ~range_.contains(y, z)
    if not outside.any():
        return []
    place = "scan.belt.pose" if nominal.carries_sensor else "cell.tool.pose"
    return [f"{outside.mean():.0%} of the part's vertices pass outside the measuring range: move {place}"]
