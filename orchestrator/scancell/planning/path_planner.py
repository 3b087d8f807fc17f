"""Plans sensor paths: a motion of the table by Ray Shooting for each arm branch, and the joints that follow from it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from scancell.geometry import pose
from scancell.planning import constraints, trajectory
from scancell.planning.configuration_map import CAUSES, ConfigurationMap, StaticConstraints
from scancell.planning.model import PlanningCell
from scancell.planning.placement import LIMIT_FRACTION, PATH_ACCELERATION
from scancell.planning.ray_shooting import shoot
from scancell.planning.reasons import describe
from scancell.planning.table_motion import CostWeights, Lattice, TableMotion

if TYPE_CHECKING:
    from scancell.planning.sensor_paths import SensorPath

Array = NDArray[np.float64]

_ROWS = 360  # table angles of a map in a turn
_SAMPLES = 4  # poses in a step of the table's motion
_STEP = 0.2  # s, about the duration of a step
_MOST_STEPS = 240
_HIGH = 0.05  # m: distance from which the clearance no longer counts
_ARM_HIGH = 0.01  # m: the same between bodies of the arm
_SINGULARITY = (0.01, 0.1)
_SLOWER = (1.0, 0.5, 0.25)  # shares of the speed that are tried
_PROBES = 24  # columns and rows at which a branch is tried before its map is


@dataclass(frozen=True)
class PlacedPath:
    """A path with its motion.

    Attributes
    ----------
    path
        The path.
    run
        Times and distances along the path, one per controller cycle.
    q, table
        (n, joints), (n,) set-points of each cycle, rad.
    exposures
        (m, joints + 1) joints and table angle of each exposure, rad.
    branch_name
        Arm branch.
    lattice, motion
        The lattice on the configuration map where the motion was found, and the motion.
    """

    path: SensorPath
    run: trajectory.Run
    q: Array
    table: Array
    exposures: Array
    branch_name: str
    lattice: Lattice
    motion: TableMotion


@dataclass(frozen=True)
class _Timing:
    """Times of a run with `count` exposures at a speed (m/s), and the sensor's poses at the columns of a map."""

    run: trajectory.Run
    count: int
    speed: float
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
    weights
        Weights of the cost of a motion of the table.
    """

    def __init__(self, cell: PlanningCell, clearance: float, weights: CostWeights | None = None) -> None:
        self._cell, self._clearance = cell, clearance
        self._weights = weights or CostWeights()
        self._constraints = StaticConstraints(_SINGULARITY, cell.clearance_ranges(clearance, _HIGH, _ARM_HIGH))
        self._motions = cell.motion_check(clearance)

    def place(self, path: SensorPath) -> PlacedPath | str:
        """The path at the highest speed and in the best branch that is possible; or why there is none."""
        if not self._cell.nominal.arm.has_named_branches:
            return f"{path.name}: paths need an arm whose branches have names, that is a closed form"
        reason = ""
        for share in _SLOWER:
            timing = self._timing(path, share * path.speed)
            for lattice in self._lattices(timing):
                motion = shoot(lattice)
                placed = self._blocked(lattice.map) if motion is None else self._followed(path, timing, lattice, motion)
                if isinstance(placed, PlacedPath):
                    return placed
                reason = reason or placed
            if not reason:
                return f"{path.name}: {self._obstacle(timing)}"
        return f"{path.name}: {reason}"

    def lattices(self, path: SensorPath) -> Iterator[Lattice]:
        """Lattices on the maps of all arm branches that may follow a path at its speed, in the order of `place`."""
        return self._lattices(self._timing(path, path.speed))

    def _lattices(self, timing: _Timing) -> Iterator[Lattice]:
        for branch in self._branches(timing):
            map_ = ConfigurationMap(self._cell, timing.columns, timing.period, branch, _ROWS, self._constraints)
            yield self._lattice(map_, timing)

    def _timing(self, path: SensorPath, speed: float) -> _Timing:
        count = int(path.length / path.pitch + 1e-9) + 1
        run = trajectory.run(count, path.length / (count - 1), speed, PATH_ACCELERATION, self._cell.cycle)
        duration = float(run.times[-1])
        steps = int(np.clip(np.ceil(duration / _STEP), 2, _MOST_STEPS))
        columns = steps * _SAMPLES + 1
        at = np.interp(np.linspace(0.0, duration, columns), run.times, run.path)
        return _Timing(run, count, speed, duration / (columns - 1), path.at(at))

    def _lattice(self, map_: ConfigurationMap, timing: _Timing) -> Lattice:
        nominal = self._cell.nominal
        return Lattice(
            map_,
            _SAMPLES,
            timing.period,
            LIMIT_FRACTION * nominal.table_max_speed,
            LIMIT_FRACTION * nominal.table_max_acceleration,
            self._weights,
        )

    def _branches(self, timing: _Timing) -> list[int]:
        """Branches that reach every probed column at some table angle, those with the best joint range first."""
        columns = np.unique(np.linspace(0, len(timing.columns) - 1, _PROBES).astype(int))
        angle = np.linspace(0.0, 2 * np.pi, _PROBES, endpoint=False)
        turns = pose.from_rotation(pose.rotation_about(2, angle))
        targets = turns[None] @ timing.columns[columns][:, None]
        q = self._cell.ik(targets.reshape(-1, 4, 4)).reshape(
            len(columns), len(angle), -1, len(self._cell.nominal.arm.joints)
        )
        best = constraints.arm_metric(self._cell.nominal.arm, q).max(1)
        return [int(b) for b in np.argsort(-best.mean(0), kind="stable") if best[:, b].all()]

    def _followed(self, path: SensorPath, timing: _Timing, lattice: Lattice, motion: TableMotion) -> PlacedPath | str:
        """Set-points of every cycle, if all axes keep their limits and all bodies provably their clearances."""
        run, arm, nominal = timing.run, self._cell.nominal.arm, self._cell.nominal
        table = lattice.angle_at(motion, run.times)
        exposed = run.trigger_from + np.arange(timing.count) * (path.length / (timing.count - 1)) / timing.speed
        at_exposure = lattice.angle_at(motion, exposed)
        turns = pose.from_rotation(pose.rotation_about(2, np.concatenate([table, at_exposure])))
        distance = np.concatenate([run.path, np.linspace(0.0, path.length, timing.count)])
        q = self._cell.ik(turns @ path.at(distance), reference=lattice.map.joints([0], [table[0]])[0])
        q = q[:, lattice.map.branch]
        if not np.isfinite(q).all():
            return "the path leaves the reach or the joint limits between the cells of the map"
        setpoints = np.column_stack([q[: len(table)], table])
        limits = (
            np.append(arm.max_speed, nominal.table_max_speed),
            np.append(arm.max_acceleration, nominal.table_max_acceleration),
        )
        used = np.maximum(*trajectory.limit_fractions(setpoints, *limits, self._cell.cycle))
        if used.max() > 1.0:
            axis = int(np.argmax(used))
            name = "the table" if axis == len(arm.joints) else f"joint {axis + 1}"
            return f"{name} would exceed its speed or acceleration limit by {100 * (used.max() - 1):.0f} %"
        # The controller interpolates set-points by cubics: they leave the straight line by less than this.
        deviation = np.abs(np.diff(setpoints, n=2, axis=0)).max(0, initial=0.0) / 4
        clashes = [c for c in self._motions.first_clashes(setpoints[:-1], setpoints[1:], deviation) if c is not None]
        if clashes:
            return describe(min(clashes, key=lambda c: c.distance - c.clearance))
        exposures = np.column_stack([q[len(table) :], at_exposure])
        return PlacedPath(
            path, run, q[: len(table)], table, exposures, arm.branch_names[lattice.map.branch], lattice, motion
        )

    def _blocked(self, map_: ConfigurationMap) -> str:
        """Where a map is blocked: the first column without a free cell, or the one with the fewest."""
        free = np.nansum(map_.quality > 0, axis=1)
        known = np.isfinite(map_.quality).sum(1)
        column = int(np.argmin(np.where(known > 0, free / np.maximum(known, 1), np.inf)))
        causes = np.bincount(map_.cause[column], minlength=len(CAUSES))
        causes[0] = 0
        worst = CAUSES[int(np.argmax(causes))] if causes.any() else "the table's speed"
        share = column / max(map_.columns - 1, 1)
        where = f"{100 * share:.0f} % of the way"
        blocked = (
            "no table angle is" if not free[column] else f"few table angles ({free[column]} of {known[column]}) are"
        )
        name = self._cell.nominal.arm.branch_names[map_.branch]
        return f"no motion in branch {name}: at {where} {blocked} free, mostly because of {worst}"

    def _obstacle(self, timing: _Timing) -> str:
        columns = timing.columns[np.linspace(0, len(timing.columns) - 1, _PROBES).astype(int)]
        angle = np.linspace(0.0, 2 * np.pi, _PROBES, endpoint=False)
        for number, at in enumerate(columns):
            targets = pose.from_rotation(pose.rotation_about(2, angle)) @ at
            if not np.isfinite(self._cell.ik(targets)).all(-1).any():
                where = f"at {100 * number / (len(columns) - 1):.0f} % of the way"
                return f"{where} the pose is out of the arm's reach at every table angle"
        return "no arm branch reaches the whole path"
