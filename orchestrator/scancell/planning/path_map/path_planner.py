"""Plans sensor paths: a motion of the table by Ray Shooting for each arm branch, and the joints that follow from it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from scancell.arrays import Array
from scancell.config.description import si_value
from scancell.config.scan import QualityDescription
from scancell.errors import DescriptionError, PlanningError
from scancell.planning.model import PATH_POSE, PlanningCell, WorkLimitError, describe
from scancell.planning.motion import trajectory
from scancell.planning.motion.trajectory import axis_name, slowdown
from scancell.planning.options import by_pair
from scancell.planning.path_map import configuration_map
from scancell.planning.path_map.configuration_map import ConfigurationMap, Drive, QualityFactor, StaticConstraints
from scancell.planning.path_map.ray_shooting import shoot, why_blocked
from scancell.planning.path_map.table_motion import Lattice, TableMotion
from scancell.planning.views.placement import LIMIT_FRACTION, PATH_ACCELERATION
from scancell.values import Value

if TYPE_CHECKING:
    from scancell.planning.views.sensor_paths import SensorPath


_ROWS = 360  # table angles of a map in a turn
_SAMPLES = 4  # poses in a step of the table's motion
_STEP = 0.2  # s, about the duration of a step
_MOST_STEPS = 240
_SLOWER = (1.0, 0.5, 0.25)  # shares of the speed that are tried
_PROBES = 24  # columns and rows at which a branch is tried before its map is
_COARSE = 8  # of branches without names, whose inverse kinematics takes longer
_MOST_HELD = 12  # table angles at which the motion of another axis is looked for
_ROUNDS = 3  # in which two axes are improved in turns
_ROUNDING = 1e-6  # of a step between set-points
_LEAST_GAIN = 0.01  # of the cost, below which the turns end


@dataclass(frozen=True, eq=False, repr=False)
class PlacedPath(Value):
    """A path with its motion.

    Attributes
    ----------
    view
        The path.
    run
        Distance along the path by time.
    at
        Joints and table angle (n, axes), rad, at times (n,), s; with further axes, where one of them moves along it.
    axes
        (n, axes) set-points of each cycle, of the same axes.
    exposures
        (m, axes) positions at each exposure, of the same axes.
    branch_names
        Names of all arm branches.
    lattice, motion
        The lattice on the configuration map where the motion was found, and the motion.
    note
        Why it is slower than asked for.
    further
        Positions of the axes beside joints and table at its start, rad or m, if there are any.
    """

    view: SensorPath
    run: trajectory.Run
    at: Callable[[Array], Array]
    axes: Array
    exposures: Array
    branch_names: tuple[str, ...]
    lattice: Lattice
    motion: TableMotion
    note: str = ""
    further: tuple[float, ...] = ()

    @property
    def cost(self) -> float:
        """Cost of the motion, with the terms of all axes that move along it."""
        return self.motion.cost + self.lattice.map.drive.effort

    @property
    def branch_name(self) -> str:
        """Name of the arm branch."""
        return self.branch_names[self.lattice.map.branch]


@dataclass(frozen=True)
class _Timing:
    """A run with `count` exposures, and the sensor's poses at the columns of a map, every `period` s."""

    run: trajectory.Run
    count: int
    period: float
    columns: Array


class PathPlanner:
    """Finds motions of arm and table for sensor paths.

    Parameters
    ----------
    cell
        Nominal cell.
    clearance
        Smallest allowed distance between bodies, m.
    quality_factors
        Further constraints.
    """

    def __init__(self, cell: PlanningCell, clearance: float, quality_factors: Sequence[QualityFactor] = ()) -> None:
        self._quality_factors = quality_factors
        self._cell = cell
        self._clearance = clearance
        self._motions = cell.motion_check(clearance)

    def place(self, path: SensorPath) -> PlacedPath | str:
        """The path at the speed and in the branch that its weights require; or why there is no motion.

        Raises `DescriptionError` if its quality names a body that the cell does not have, or another number of joints.
        """
        found: list[tuple[float, PlacedPath]] = []
        reason = ""
        shortest = self._timing(path, path.speed).run.duration
        for share in _SLOWER:
            timing = self._timing(path, share * path.speed)
            placed = self._placed_at(path, timing)
            if isinstance(placed, str):
                reason = reason or placed
            elif path.weights.scanning_time is None:
                return placed
            else:
                time = placed.run.duration / shortest
                found.append((placed.motion.cost + path.weights.scanning_time * time, placed))
        return min(found, key=lambda item: item[0])[1] if found else f"{path.name}: {reason}"

    def place_along(self, path: SensorPath, axis: str, rest: Sequence[Array]) -> PlacedPath | str:
        """The path while one of the axes beside joints and table moves; or why there is no motion.

        Table and further axes rest at one of `rest`, (1 + further axes,) each, rad or m, of which the entry of the axis
        has no effect: at those first where the arm's joints are, on average, nearest to the middle of their ranges.
        """
        reason = ""
        for share in _SLOWER:
            timing = self._timing(path, share * path.speed)
            drives = [self._drive(axis, _resting(row), timing) for row in rest]
            probed = [(score, drive, branch) for drive in drives for branch, score in self._branches(timing, drive)]
            for _, drive, branch in sorted(probed, key=lambda item: -item[0])[:_MOST_HELD]:
                placed = self._placed_at(path, timing, drive, [branch])
                if isinstance(placed, PlacedPath):
                    return placed
                reason = reason or placed
            reason = reason or self._obstacle(timing, drives[0])
        return f"{path.name}: {reason}"

    def place_by_two(self, path: SensorPath, axis: str, rest: Sequence[Array]) -> PlacedPath | str:
        """The path while the table and another axis move; or why there is no motion.

        Coordinate by coordinate: the table moves while the other axes rest at each of `rest`, see `place_along`, and
        the motion of least cost is improved by moving one axis along the motion of the other, in turns, as long as the
        cost falls by a hundredth.
        """
        reason = ""
        for share in _SLOWER:
            timing = self._timing(path, share * path.speed)
            found: list[PlacedPath] = []
            for row in rest:
                placed = self._placed_at(path, timing, self._drive("table", _resting(row), timing))
                if isinstance(placed, PlacedPath):
                    found.append(placed)
                else:
                    reason = reason or placed
            if found:
                return self._improved(path, timing, min(found, key=lambda one: one.cost), axis)
        return f"{path.name}: {reason}"

    def _improved(self, path: SensorPath, timing: _Timing, best: PlacedPath, axis: str) -> PlacedPath:
        efforts = {"table": best.lattice.effort(best.motion), axis: 0.0}
        for _ in range(_ROUNDS):
            before = best.cost
            for moving, still in ((axis, "table"), ("table", axis)):
                others, window = self._along(best)
                drive = self._drive(moving, others, timing, window, efforts[still])
                # Numbers of branches without names are those of one map.
                is_named = self._cell.nominal.arm.has_named_branches
                placed = self._placed_at(path, timing, drive, [best.lattice.map.branch] if is_named else None)
                if isinstance(placed, PlacedPath) and placed.cost < best.cost:
                    best, efforts[moving] = placed, placed.lattice.effort(placed.motion)
            if best.cost > (1 - _LEAST_GAIN) * before:
                break
        return best

    def _along(self, placed: PlacedPath) -> tuple[Callable[[Array], Array], float]:
        """Positions of table and further axes by time from the start of a motion, and by how much it begins before."""
        lattice, motion, drive, nominal = placed.lattice, placed.motion, placed.lattice.map.drive, self._cell.nominal
        window = self._window(lattice)

        def positions(time: Array) -> Array:
            return drive.positions(nominal, time, lattice.angle_at(motion, time, window))

        return positions, max(window, drive.window)

    def _window(self, lattice: Lattice) -> float:
        jerk = self._cell.axis_limits.jerk[self._cell.nominal.axes.index(lattice.map.drive.name)]
        return lattice.window(LIMIT_FRACTION * jerk)

    def _drive(
        self,
        name: str,
        others: Callable[[Array], Array],
        timing: _Timing,
        window: float = 0.0,
        effort: float = 0.0,
    ) -> Drive:
        """The table or another axis as the one that moves.

        Rows are rounded positions: those of an axis with limits stay half a row away from them, and as far as it gets
        beyond the poses of the map. In one step it does not cross the gap between the limits.
        """
        if name == "table":
            return Drive(others=others, window=window, effort=effort)
        axis = next(axis for axis in self._cell.nominal.further_axes if axis.name == name)
        range_, step = axis.max - axis.min, _SAMPLES * timing.period
        span = max(range_ + 2 * axis.max_speed * step, range_ * _ROWS / (_ROWS - 4))
        margin = span / _ROWS / 2 + axis.max_acceleration * timing.period**2 / 8
        shown = ("mm", 1e-3) if axis.joint.kind == "prismatic" else ("deg", np.pi / 180)
        return Drive(name, axis.min + margin, span, axis.max - margin, others, window, effort, *shown)

    def _placed_at(
        self, path: SensorPath, timing: _Timing, drive: Drive | None = None, branches: Sequence[int] | None = None
    ) -> PlacedPath | str:
        """The path with one timing in the first of the branches that is possible; or why none is."""
        reason, drive = "", drive or Drive()
        for lattice in self._lattices(path, timing, drive, branches):
            motion = shoot(lattice)
            if motion is None:
                branch = self._cell.nominal.arm.branch_names[lattice.map.branch]
                reason = reason or f"no motion in branch {branch}: {why_blocked(lattice)}"
                continue
            try:
                placed = self._followed(path, timing, lattice, motion)
            except WorkLimitError:
                raise
            except PlanningError as error:  # too slow
                placed = str(error)
            if isinstance(placed, PlacedPath):
                return placed
            reason = reason or placed
        return reason or self._obstacle(timing, drive)

    def lattices(self, path: SensorPath) -> Iterator[Lattice]:
        """Lattices on the maps of all arm branches that may follow a path at its speed, in the order of `place`."""
        return self._lattices(path, self._timing(path, path.speed))

    def _lattices(
        self, path: SensorPath, timing: _Timing, drive: Drive | None = None, branches: Sequence[int] | None = None
    ) -> Iterator[Lattice]:
        static, nominal, drive = self._static(path.quality), self._cell.nominal, drive or Drive()
        number = nominal.axes.index(drive.name)
        speed, acceleration = nominal.axis_max_speed[number], nominal.axis_max_acceleration[number]
        first = ConfigurationMap(self._cell, timing.columns, timing.period, 0, _ROWS, static, drive)
        for map_ in self._maps(timing, first) if branches is None else map(first.of_branch, branches):
            yield Lattice(
                map_, _SAMPLES, timing.period, LIMIT_FRACTION * speed, LIMIT_FRACTION * acceleration, path.weights
            )

    def _static(self, quality: QualityDescription) -> StaticConstraints:
        joints, powers = len(self._cell.nominal.arm.joints), quality.joint_range_power
        if isinstance(powers, tuple) and len(powers) != joints:
            raise DescriptionError(
                key="path.quality.joint_range_power",
                value=list(powers),
                expected=f"one value, or {joints}: one per joint",
            )
        own = by_pair(quality.pair, "path.quality.pair", self._cell.nominal)
        high = {key: 1e-3 * pair.full_clearance_mm for key, pair in own.items() if pair.full_clearance_mm is not None}
        power = {key: pair.clearance_power for key, pair in own.items() if pair.clearance_power is not None}
        full, arm_full = si_value(quality, "full_clearance_mm"), si_value(quality, "arm_full_clearance_mm")
        return StaticConstraints(
            quality.singularity,
            self._cell.clearance_ranges(self._clearance, full, arm_full, high),
            powers,
            self._cell.of_pairs(quality.clearance_power, power) if power else quality.clearance_power,
            quality.equations == "printed",
            self._quality_factors,
        )

    def _timing(self, path: SensorPath, speed: float) -> _Timing:
        count = path.count
        run = trajectory.run(count, path.length / (count - 1), speed, PATH_ACCELERATION, self._cell.cycle)
        steps = int(np.clip(np.ceil(run.duration / _STEP), 2, _MOST_STEPS))
        columns = steps * _SAMPLES + 1
        at = run.at(np.linspace(0.0, run.duration, columns))
        return _Timing(run, count, run.duration / (columns - 1), path.at(at))

    def _maps(self, timing: _Timing, first: ConfigurationMap) -> Iterator[ConfigurationMap]:
        """The maps of all branches that may follow a path."""
        arm = self._cell.nominal.arm
        if arm.has_named_branches:
            yield from (first.of_branch(branch) for branch, _ in self._branches(timing, first.drive))
            return
        for branch in range(len(arm.branch_names)):
            map_ = first.of_branch(branch)
            if not map_.is_found:
                return
            yield map_

    def _branches(self, timing: _Timing, drive: Drive) -> list[tuple[int, float]]:
        """Branches that reach every probed column at some position, by their mean joint range, which follows each.

        Of branches without names the first, which is found on the map of the drive, if there is any solution.
        """
        is_named = self._cell.nominal.arm.has_named_branches
        columns = np.unique(np.linspace(0, len(timing.columns) - 1, _PROBES if is_named else _COARSE).astype(int))
        angle = _probed(drive)[:: 1 if is_named else _PROBES // _COARSE]
        targets = np.stack([self._targets(timing, drive, column, angle) for column in columns])
        q = self._cell.ik(targets.reshape(-1, 4, 4)).reshape(
            len(columns), len(angle), -1, len(self._cell.nominal.arm.joints)
        )
        best = configuration_map.arm_metric(self._cell.nominal.arm, q).max(1)
        best = best if is_named else best.max(1, keepdims=True)
        score = best.mean(0)
        return [(int(b), float(score[b])) for b in np.argsort(-score, kind="stable") if best[:, b].all()]

    def _targets(self, timing: _Timing, drive: Drive, column: int, angle: Array) -> Array:
        """Poses (k, 4, 4) for the inverse kinematics at a column and positions of the axis (k,)."""
        nominal = self._cell.nominal
        positions = drive.positions(nominal, np.full(len(angle), timing.period * column), angle)
        return np.asarray(drive.carried(nominal, positions) @ timing.columns[column])

    def _followed(self, path: SensorPath, timing: _Timing, lattice: Lattice, motion: TableMotion) -> PlacedPath | str:
        """Set-points of every cycle, if joints are within reach and all bodies provably keep their clearances."""
        nominal, cycle, drive = self._cell.nominal, self._cell.cycle, lattice.map.drive
        window = self._window(lattice)
        run = timing.run.rested(max(window, drive.window) / 2)
        reference = lattice.map.joints([0], [lattice.map.angle(lattice.row(motion.start))])[0]

        def positions(time: Array) -> Array:
            moving = lattice.angle_at(motion, time - run.rest, window)
            others = drive.positions(nominal, time - run.rest, moving)
            self._cell.work.spend(PATH_POSE * len(moving))
            targets = drive.carried(nominal, others) @ path.at(run.at(time))
            q = lattice.map.joints_for(time - run.rest, moving, targets, reference)
            return np.column_stack([q, others])

        needed = slowdown(self._cell, positions, run.duration)
        if isinstance(needed, str):
            return needed
        slow = run.slowed(needed.factor)

        def slow_positions(time: Array, factor: float = needed.factor) -> Array:
            return positions(time / factor)

        setpoints = slow_positions(trajectory.cycle_times(slow.duration, cycle))
        # A solution that jumps to another one does so at any speed.
        jump = np.abs(np.diff(setpoints, axis=0)) / (cycle * nominal.axis_max_speed[: setpoints.shape[1]])
        if jump.max(initial=0.0) > 1 + _ROUNDING:
            return f"{axis_name(self._cell, int(jump.max(0).argmax()))} would jump"
        beyond = self._beyond_limits(setpoints)
        if beyond:
            return f"{beyond} would leave its limits"
        clash = self._motions.clash_along(setpoints)
        if clash is not None:
            return describe(clash)
        pitch = path.length / (timing.count - 1)
        exposures = positions(np.asarray(run.trigger_from + np.arange(timing.count) * pitch / run.speed))
        names = nominal.arm.branch_names
        note = f"{path.name}: {needed}" if needed.factor > 1 else ""
        further = tuple(setpoints[0, len(nominal.home) + 1 :].tolist())
        return PlacedPath(path, slow, slow_positions, setpoints, exposures, names, lattice, motion, note, further)

    def _beyond_limits(self, setpoints: Array) -> str:
        """Name of an axis beside joints and table that set-points (n, axes) lead beyond its limits, if there is one."""
        axes = zip(self._cell.nominal.further_axes, setpoints[:, len(self._cell.nominal.home) + 1 :].T, strict=True)
        return next((axis.name for axis, at in axes if at.min() < axis.min or at.max() > axis.max), "")

    def _obstacle(self, timing: _Timing, drive: Drive) -> str:
        columns = np.linspace(0, len(timing.columns) - 1, _PROBES).astype(int)
        for number, column in enumerate(columns.tolist()):
            targets = self._targets(timing, drive, column, _probed(drive))
            if not np.isfinite(self._cell.ik(targets)).all(-1).any():
                where = f"at {100 * number / (len(columns) - 1):.0f} % of the way"
                return f"{where} the pose is out of the arm's reach at every {drive.in_words}"
        return "no arm branch reaches the whole path"


def _resting(row: Array) -> Callable[[Array], Array]:
    """Positions (n, k) at times (n,) that are always `row` (k,)."""
    return lambda time: np.tile(row, (len(time), 1))


def _probed(drive: Drive) -> Array:
    """Positions (k,) of an axis at which a branch is tried."""
    if np.isfinite(drive.high):
        return np.linspace(drive.low, drive.high, _PROBES)
    return np.linspace(0.0, 2 * np.pi, _PROBES, endpoint=False)
