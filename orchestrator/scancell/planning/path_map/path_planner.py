"""Plans sensor paths: a motion of the table by Ray Shooting for each arm branch, and the joints that follow from it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from scancell.arrays import Array
from scancell.config.description import si_value
from scancell.config.scan import QualityDescription
from scancell.errors import DescriptionError
from scancell.geometry import pose
from scancell.nominal.cell import with_table
from scancell.planning.model import PATH_POSE, PlanningCell, describe
from scancell.planning.motion import trajectory
from scancell.planning.motion.timing import slowdown
from scancell.planning.options import by_pair
from scancell.planning.path_map import configuration_map
from scancell.planning.path_map.configuration_map import ConfigurationMap, QualityFactor, StaticConstraints
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
        Joints and table angle (n, axes), rad, at times (n,), s.
    axes
        (n, axes) set-points of joints and table of each cycle, rad.
    exposures
        (m, axes) joints and table angle of each exposure, rad.
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
        if not self._cell.nominal.arm.has_named_branches:
            return f"{path.name}: paths need an arm whose branches have names, that is a closed form"
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

    def _placed_at(self, path: SensorPath, timing: _Timing) -> PlacedPath | str:
        """The path with one timing in the first branch that is possible; or why none is."""
        reason = ""
        for lattice in self._lattices(path, timing):
            motion = shoot(lattice)
            if motion is None:
                branch = self._cell.nominal.arm.branch_names[lattice.map.branch]
                reason = reason or f"no motion in branch {branch}: {why_blocked(lattice)}"
                continue
            placed = self._followed(path, timing, lattice, motion)
            if isinstance(placed, PlacedPath):
                return placed
            reason = reason or placed
        return reason or self._obstacle(timing)

    def lattices(self, path: SensorPath) -> Iterator[Lattice]:
        """Lattices on the maps of all arm branches that may follow a path at its speed, in the order of `place`."""
        return self._lattices(path, self._timing(path, path.speed))

    def _lattices(self, path: SensorPath, timing: _Timing) -> Iterator[Lattice]:
        static, nominal = self._static(path.quality), self._cell.nominal
        for branch in self._branches(timing):
            map_ = ConfigurationMap(self._cell, timing.columns, timing.period, branch, _ROWS, static)
            speed, acceleration = nominal.table_max_speed, nominal.table_max_acceleration
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

    def _branches(self, timing: _Timing) -> list[int]:
        """Branches that reach every probed column at some table angle, those with the best joint range first."""
        columns = np.unique(np.linspace(0, len(timing.columns) - 1, _PROBES).astype(int))
        angle = np.linspace(0.0, 2 * np.pi, _PROBES, endpoint=False)
        turns = pose.from_rotation(pose.rotation_about(2, angle))
        targets = turns[None] @ timing.columns[columns][:, None]
        q = self._cell.ik(targets.reshape(-1, 4, 4)).reshape(
            len(columns), len(angle), -1, len(self._cell.nominal.arm.joints)
        )
        best = configuration_map.arm_metric(self._cell.nominal.arm, q).max(1)
        return [int(b) for b in np.argsort(-best.mean(0), kind="stable") if best[:, b].all()]

    def _followed(self, path: SensorPath, timing: _Timing, lattice: Lattice, motion: TableMotion) -> PlacedPath | str:
        """Set-points of every cycle, if joints are within reach and all bodies provably keep their clearances."""
        nominal, cycle = self._cell.nominal, self._cell.cycle
        window = lattice.window(LIMIT_FRACTION * nominal.table_max_jerk)
        run = timing.run.rested(window / 2)
        reference = lattice.map.joints([0], [lattice.map.angle(lattice.row(motion.start))])[0]

        def positions(time: Array) -> Array:
            table = lattice.angle_at(motion, time - run.rest, window)
            turns = pose.from_rotation(pose.rotation_about(2, table))
            self._cell.work.spend(PATH_POSE * len(table))
            q = self._cell.ik(turns @ path.at(run.at(time)), reference)[:, lattice.map.branch]
            return with_table(q, table)

        needed = slowdown(self._cell, positions, run.duration)
        if isinstance(needed, str):
            return needed
        slow = run.slowed(needed.factor)

        def slow_positions(time: Array, factor: float = needed.factor) -> Array:
            return positions(time / factor)

        setpoints = slow_positions(trajectory.cycle_times(slow.duration, cycle))
        clash = self._motions.clash_along(setpoints)
        if clash is not None:
            return describe(clash)
        pitch = path.length / (timing.count - 1)
        exposures = positions(np.asarray(run.trigger_from + np.arange(timing.count) * pitch / run.speed))
        names = nominal.arm.branch_names
        note = f"{path.name}: {needed}" if needed.factor > 1 else ""
        return PlacedPath(path, slow, slow_positions, setpoints, exposures, names, lattice, motion, note)

    def _obstacle(self, timing: _Timing) -> str:
        columns = timing.columns[np.linspace(0, len(timing.columns) - 1, _PROBES).astype(int)]
        angle = np.linspace(0.0, 2 * np.pi, _PROBES, endpoint=False)
        for number, at in enumerate(columns):
            targets = pose.from_rotation(pose.rotation_about(2, angle)) @ at
            if not np.isfinite(self._cell.ik(targets)).all(-1).any():
                where = f"at {100 * number / (len(columns) - 1):.0f} % of the way"
                return f"{where} the pose is out of the arm's reach at every table angle"
        return "no arm branch reaches the whole path"
