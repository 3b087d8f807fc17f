"""Motions between views, proved free of collision: direct, by retreat points or home, or by a search of joint space.

Axes beside joints and table rest at a stand while views are taken, and move between stands while the arm is at home. A
view is placed where these axes start, if it is feasible there. Of the other candidates (`scan.axis`), the one at which
most of the remaining views are feasible comes next, and so on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise, permutations, product
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from scancell.arrays import Array
from scancell.config.scan import ScanAxisDescription
from scancell.errors import DescriptionError, PlanningError
from scancell.geometry import pose
from scancell.nominal.cell import NominalCell
from scancell.planning.model import PlanningCell, describe, join_reasons
from scancell.planning.motion import trajectory
from scancell.planning.motion.trajectory import weak_motor
from scancell.planning.options import ScanOptions
from scancell.planning.views.placement import (
    LIMIT_FRACTION,
    Infeasible,
    PlacedPass,
    PlacedPose,
    PlacedSweep,
    Placer,
)
from scancell.planning.views.views import Pass, Sweep
from scancell.proximity.motion_check import MotionCheck
from scancell.proximity.scene import Clash

if TYPE_CHECKING:
    from scancell.planning.views.sensor_paths import SensorPath

_PIECE = 0.25  # rad: edges are proved and kept in pieces that move no axis by more
_FARTHEST = 6  # pieces by which a tree grows towards a random configuration
_MARGIN = 1.6  # rad beyond start and goal within which configurations are drawn
_SHORTCUTS = 30  # attempts to shorten the path

_RETREAT_DISTANCES = (0.06, 0.12, 0.2)  # m
_MOST_CANDIDATES = 500
_SAME = 1e-9  # rad or m: positions that differ by less are one
_MAX_BRANCH_CHANGE = np.radians(60)  # joint travel to a retreat point; more means another inverse-kinematics branch


class RrtConnect:
    """Path planner for arm and table.

    Parameters
    ----------
    motions
        Proof that a motion keeps its clearances.
    lower, upper
        (axes,) limits of joints and table, rad.
    iterations
        Random configurations before giving up.
    seed
        Random seed.
    """

    def __init__(self, motions: MotionCheck, lower: Array, upper: Array, iterations: int = 150, seed: int = 0) -> None:
        self._motions, self._lower, self._upper = motions, lower, upper
        self._iterations, self._seed = iterations, seed

    def path(self, start: Array, goal: Array) -> list[Array] | None:
        """Configurations (axes,), rad, from `start` to `goal` by free straight motions; None if none is found."""
        rng = np.random.default_rng(self._seed)
        low = np.maximum(np.minimum(start, goal) - _MARGIN, self._lower)
        high = np.minimum(np.maximum(start, goal) + _MARGIN, self._upper)
        trees = [_Tree(start), _Tree(goal)]
        for number in range(self._iterations):
            growing, other = trees[number % 2], trees[1 - number % 2]
            new = self._grow(growing, rng.uniform(low, high), _FARTHEST)
            if new is None:
                continue
            end = self._grow(other, growing.nodes[new], None)
            if end is not None and np.array_equal(other.nodes[end], growing.nodes[new]):
                halves = [growing.branch(new), other.branch(end)]
                first, second = halves if number % 2 == 0 else halves[::-1]
                return self._shortened([*first, *second[-2::-1]], rng)
        return None

    def _grow(self, tree: _Tree, target: Array, pieces: int | None) -> int | None:
        """Grow a tree straight towards `target` by at most `pieces` pieces; number of the last new node, if any."""
        near = tree.nearest(target)
        count = max(1, int(np.ceil(np.abs(target - tree.nodes[near]).max() / _PIECE)))
        steps = np.linspace(0.0, 1.0, count + 1)[1:, None]
        ends = tree.nodes[near] + steps * (target - tree.nodes[near])
        ends[-1] = target
        ends = ends[:pieces]
        clashes = self._motions.first_clashes(np.vstack([tree.nodes[near], ends[:-1]]), ends)
        free = next((i for i, clash in enumerate(clashes) if clash is not None), len(clashes))
        number = None
        for node in ends[:free]:
            number = near = tree.add(node, near)
        return number

    def _shortened(self, path: list[Array], rng: np.random.Generator) -> list[Array]:
        """The path with free straight motions in place of detours, the direct way past every corner tried last."""
        for _ in range(_SHORTCUTS):
            if len(path) < 3:
                return path
            first, last = sorted(rng.choice(len(path), 2, replace=False))
            path = self._cut(path, int(first), int(last))
        corner = 1
        while corner < len(path) - 1:
            shorter = self._cut(path, corner - 1, corner + 1)
            corner += len(shorter) == len(path)
            path = shorter
        return path

    def _cut(self, path: list[Array], first: int, last: int) -> list[Array]:
        if last - first < 2 or self._motions.first_clashes(path[first], path[last])[0] is not None:
            return path
        return [*path[: first + 1], *path[last:]]


class _Tree:
    """Configurations, each joined to a parent; the first one is the root."""

    def __init__(self, root: Array) -> None:
        self.nodes = [root]
        self._parents = [0]

    def nearest(self, to: Array) -> int:
        return int(np.argmin(np.linalg.norm(np.array(self.nodes) - to, axis=1)))

    def add(self, node: Array, parent: int) -> int:
        self.nodes.append(node)
        self._parents.append(parent)
        return len(self.nodes) - 1

    def branch(self, number: int) -> list[Array]:
        """Configurations from the root to node `number`."""
        found = [self.nodes[number]]
        while number:
            number = self._parents[number]
            found.append(self.nodes[number])
        return found[::-1]


class AxisMotions:
    """Finds collision-free motions of the axes beside joints and table, while the arm rests at home.

    Parameters
    ----------
    cell
        Nominal cell with all axes.
    clearance
        Distance (m) between bodies, of which motions keep `MOTION_SHARE`.
    """

    def __init__(self, cell: PlanningCell, clearance: float) -> None:
        self._cell, self._motions = cell, cell.motion_check(clearance)
        self._limits = cell.axis_limits.scaled(LIMIT_FRACTION)
        self._first = len(cell.nominal.home) + 1

    def path(self, start: Array, end: Array) -> list[Array] | Clash:
        """Configurations (axes,) from `start` to `end` by free straight motions, or a clash of the direct one.

        Tried are the direct motion, one axis after another in every order, and both by way of the start of the cell.
        """
        direct: Clash | None = None
        for way in self._ways(start, end):
            clashes = self._motions.first_clashes(np.array(way[:-1]), np.array(way[1:]))
            found = next((clash for clash in clashes if clash is not None), None)
            if found is None:
                return way
            direct = direct or found
        assert direct is not None  # the direct motion is the first
        return direct

    def move(self, start: Array, end: Array) -> Array:
        """Set-points (n, axes) of the straight motion from `start` to `end` (axes,), without collision check."""
        return trajectory.move(start, end, self._limits, self._cell.cycle)

    def require_free(self, points: Array, purpose: str) -> None:
        """Raise `PlanningError` unless the straight motions between points (n, axes) are proved free."""
        clashes = self._motions.first_clashes(points[:-1], points[1:])
        found = next((clash for clash in clashes if clash is not None), None)
        if found is not None:
            raise PlanningError(f"no collision-free motion between the exposures of {purpose}: {describe(found)}")

    def time(self, start: Array, end: Array) -> float:
        """Time (s) of the direct motion."""
        return (len(self.move(start, end)) - 1) * self._cell.cycle

    def _ways(self, start: Array, end: Array) -> Iterator[list[Array]]:
        yield from self._without_detour(start, end)
        between = start.copy()
        between[self._first :] = self._cell.start[self._first :]
        for before, after in product(self._without_detour(start, between), self._without_detour(between, end)):
            yield [*before, *after[1:]]

    @staticmethod
    def _without_detour(start: Array, end: Array) -> Iterator[list[Array]]:
        """Direct, and one axis after another in every order."""
        yield [start, end]
        moving = np.flatnonzero(start != end)
        for order in permutations(moving.tolist()) if len(moving) > 1 else ():
            way = [start]
            for axis in order:
                following = way[-1].copy()
                following[axis] = end[axis]
                way.append(following)
            yield way


class Connector:
    """Finds collision-free motions of joints and table.

    Parameters
    ----------
    cell
        Nominal cell.
    clearance
        Distance (m) between bodies to which views were checked; connections keep `MOTION_SHARE` of it.
    """

    def __init__(self, cell: PlanningCell, clearance: float) -> None:
        self._cell = cell
        self._motions = cell.motion_check(clearance)
        self._of_table = cell.table_clearances(clearance)
        self._limits = cell.axis_limits.scaled(LIMIT_FRACTION)

    def are_free(self, start: Array, end: Array) -> list[bool]:
        """Whether each of the straight motions from `start` to `end` (n, axes), rad, is proved free of collision."""
        return [clash is None for clash in self._motions.first_clashes(start, end)]

    def is_table_free(self, at: Array, table: float) -> bool:
        """Whether the table is free to turn from the axes `at` (axes,), rad, to an angle, without regard to the arm."""
        (clash,) = self._motions.first_clashes(at, np.append(at[:-1], table), clearance=self._of_table)
        return clash is None

    def move(self, start: Array, end: Array) -> Array:
        """Set-points (n, axes), rad, of the straight motion from `start` to `end` (axes,), without collision check.

        Raises `PlanningError` if a motor cannot hold the arm somewhere on the way.
        """
        setpoints = trajectory.move(start, end, self._limits, self._cell.cycle)
        if self._cell.torques is None:
            return setpoints
        factor, joint = self._cell.torques.needed_slowdown(setpoints[:, :-1], self._cell.cycle)
        if not np.isfinite(factor):
            raise PlanningError(weak_motor(joint))
        return trajectory.move(start, end, self._limits, self._cell.cycle, max(1.0, factor))

    def connect(self, start: Array, end: Array, purpose: str) -> list[Array]:
        """Set-points of a collision-free path as rest-to-rest motions.

        Raises `PlanningError` if every candidate path collides and the search finds none, naming `purpose` and the
        bodies that collide on the direct path.

        Parameters
        ----------
        start, end
            (axes,) joints and table angle, rad.
        purpose
            Name of the goal for error messages.

        Returns
        -------
        list of (n, axes) arrays
            One per motion, rad; empty when `start` and `end` coincide.
        """
        if np.abs(end - start).max() < 1e-9:
            return []
        checked: dict[tuple[bytes, bytes], Clash | None] = {}
        direct: Clash | None = None
        for path in self._candidate_paths(start, end):
            legs = [(a, b) for a, b in pairwise(path) if np.abs(b - a).max() > 0]
            for a, b in legs:
                key = (a.tobytes(), b.tobytes())
                if key not in checked:
                    (checked[key],) = self._motions.first_clashes(a, b)
                if checked[key] is not None:
                    direct = direct or checked[key]
                    break
            else:
                return [self.move(a, b) for a, b in legs]
        assert direct is not None  # the direct path is the first candidate
        found = self._search(start, end)
        if found is not None:
            return [self.move(a, b) for a, b in pairwise(found)]
        (at_start,) = self._motions.first_clashes(start, start)
        reason = f"{describe(direct)} on the direct path"
        if at_start is not None:
            reason = f"{describe(at_start)} at the start; move away first"
        raise PlanningError(f"no collision-free path to {purpose}: {reason}")

    def _search(self, start: Array, end: Array) -> list[Array] | None:
        """Waypoints (axes,) by RRT-Connect, from either end; the table turns no farther than from start to end."""
        lower, upper = self._cell.nominal.arm.limits
        table = np.sort([start[-1], end[-1]])
        limits = np.append(lower, table[0]), np.append(upper, table[1])
        search = RrtConnect(self._motions, *limits)
        found = search.path(start, end)
        if found is None:  # other samples grow other trees
            found = search.path(end, start)
            return None if found is None else found[::-1]
        return found

    def _candidate_paths(self, start: Array, end: Array) -> Iterator[list[Array]]:
        """Lists of waypoints (axes,), simplest first: direct, through retreat points at either end, through home."""
        yield [start, end]
        starts, ends = self._retreat_points(start), self._retreat_points(end)
        pairs = sorted(product(range(len(starts)), range(len(ends))), key=sum)
        yield from ([start, starts[i], ends[k], end] for i, k in pairs)
        home = self._cell.nominal.home
        for i, k in pairs:
            yield [start, starts[i], np.append(home, start[-1]), np.append(home, end[-1]), ends[k], end]

    def _retreat_points(self, at: Array) -> list[Array]:
        """`at` (axes,) itself, then points with the sensor retracted along its Z or raised along the table's axis.

        A part on the flange is retracted from the sensor.
        """
        table_from_sensor = self._cell.support_from_sensor(at[:-1])
        targets = []
        for distance in _RETREAT_DISTANCES:
            targets.append(table_from_sensor @ pose.translation((0.0, 0.0, -distance)))
            targets.append(pose.translation((0.0, 0.0, distance)) @ table_from_sensor)
        q = self._cell.ik(np.array(targets), reference=at[:-1])
        travel = np.nan_to_num(np.abs(q - at[:-1]).max(-1), nan=np.inf)
        best = np.argmin(travel, axis=1)
        near = [q[i, k] for i, k in enumerate(best) if travel[i, k] < _MAX_BRANCH_CHANGE]
        return [at, *(np.append(joints, at[-1]) for joints in near)]


_T = TypeVar("_T", PlacedSweep, PlacedPass, PlacedPose)


def candidate_positions(nominal: NominalCell, described: Sequence[ScanAxisDescription]) -> list[tuple[float, ...]]:
    """Positions (k,) of the axes beside joints and table, rad or m, at which a scan may hold them; the start first.

    Of an axis that is described, in steps from its start to its limits, and the limits; others stay at their start.
    All combinations follow the start by the time that the slowest of the axes needs to get there.

    Raises `DescriptionError` if an axis does not exist, is named twice or has a step of the wrong unit, or there are
    more than 500 combinations.
    """
    axes = nominal.further_axes
    values = {axis.name: [axis.start] for axis in axes}
    for number, item in enumerate(described, start=1):
        key = f"scan.axis[{number}]"
        axis = next((axis for axis in axes if axis.name == item.name), None)
        if axis is None or item.name in [one.name for one in described[: number - 1]]:
            names = ", ".join(one.name for one in axes)
            expected = f"one of {names}, each once" if names else "a cell with [[axis]]"
            raise DescriptionError(key=f"{key}.name", value=item.name, expected=expected)
        step = np.radians(item.step_deg or 0.0) if axis.joint.kind == "revolute" else 1e-3 * (item.step_mm or 0.0)
        if not step:
            unit = "step_deg" if axis.joint.kind == "revolute" else "step_mm"
            raise DescriptionError(key=key, value=item.name, expected=f"{unit}, as the axis is {axis.joint.kind}")
        inside = axis.start + step * np.arange(np.ceil((axis.min - axis.start) / step), (axis.max - axis.start) / step)
        others = np.clip([axis.min, *inside, axis.max], axis.min, axis.max)
        apart = np.diff(others, prepend=-np.inf) > _SAME
        values[item.name] += others[apart & (np.abs(others - axis.start) > _SAME)].tolist()
    count = int(np.prod([len(one) for one in values.values()]))
    if count > _MOST_CANDIDATES:
        raise DescriptionError(
            f"{count} positions of the axes", key="scan.axis", expected=f"larger steps: at most {_MOST_CANDIDATES}"
        )
    start = tuple(axis.start for axis in axes)
    speed = np.array([axis.max_speed for axis in axes])

    def time(positions: tuple[float, ...]) -> float:
        return float((np.abs(np.subtract(positions, start)) / speed).max(initial=0.0))

    return [start, *sorted((one for one in product(*values.values()) if one != start), key=time)]


@dataclass(frozen=True)
class Stand:
    """A cell in which the axes beside joints and table rest at `positions` (k,), rad or m."""

    positions: tuple[float, ...]
    cell: PlanningCell
    options: ScanOptions

    @cached_property
    def placer(self) -> Placer:
        """Places views there."""
        return Placer(self.cell, self.options.azimuth, self.options.clearance)

    @cached_property
    def connector(self) -> Connector:
        """Finds motions of joints and table there."""
        return Connector(self.cell, self.options.clearance)


class Stands:
    """The stands of a scan, and the placement of views at one of them.

    Parameters
    ----------
    cell
        Nominal cell with all axes.
    options
        Clearance, preferred azimuth, and the candidates.
    """

    def __init__(self, cell: PlanningCell, options: ScanOptions) -> None:
        self.cell, self._options = cell, options
        self._made: dict[tuple[float, ...], Stand] = {}
        self._refused: list[str] = []

    def at(self, positions: tuple[float, ...]) -> Stand:
        """The stand at positions (k,), rad or m."""
        if positions not in self._made:
            held = self.cell.held(positions) if positions else self.cell
            self._made[positions] = Stand(positions, held, self._options)
        return self._made[positions]

    @cached_property
    def motions(self) -> AxisMotions:
        """Finds motions between stands."""
        return AxisMotions(self.cell, self._options.clearance)

    @cached_property
    def start(self) -> Stand:
        """The stand at which programs start and end."""
        nominal = self.cell.nominal
        return self.at(tuple(axis.start for axis in nominal.further_axes) or nominal.held_at)

    @cached_property
    def candidates(self) -> tuple[Stand, ...]:
        """The stands to which a motion from the start is proved free, with arm and table where they start.

        Raises `DescriptionError` as `candidate_positions`.
        """
        found, at = [self.start], self.cell.start
        others = candidate_positions(self.cell.nominal, self._options.scan.axis)[1:]
        for positions in others:
            self.cell.work.spend(0.0)
            way = self.motions.path(at, self.along(at, positions))
            if isinstance(way, Clash):
                self._refused.append(f"{self.in_words(positions)}: {describe(way)}")
            else:
                found.append(self.at(positions))
        return tuple(found)

    @property
    def warnings(self) -> list[str]:
        """Candidates that the axes do not reach."""
        total = len(self.candidates) - 1 + len(self._refused)
        title = f"{len(self._refused)} of {total} positions of the axes are not reached with the arm at home"
        return [join_reasons(title, self._refused)] if self._refused else []

    def along(self, axes: Array, positions: tuple[float, ...]) -> Array:
        """The positions (axes,) of joints and table, with further axes at others (k,)."""
        return np.array([*axes[: len(self.cell.nominal.home) + 1], *positions])

    def in_words(self, positions: tuple[float, ...]) -> str:
        """Positions (k,) of the axes for messages."""
        pairs = zip(self.cell.nominal.further_axes, positions, strict=True)
        return ", ".join(
            f"{axis.name} at {np.degrees(at):g} deg"
            if axis.joint.kind == "revolute"
            else f"{axis.name} at {1e3 * at:g} mm"
            for axis, at in pairs
        )

    def sweeps(self, views: Sequence[Sweep]) -> list[PlacedSweep | Infeasible]:
        """See `Placer.sweeps`."""
        return self._placed(len(views), lambda stand, rows: stand.placer.sweeps([views[i] for i in rows]))

    def passes(
        self, views: Sequence[Pass | SensorPath], counts: Sequence[int], speed: float, branch: int | None
    ) -> list[PlacedPass | Infeasible]:
        """See `Placer.passes`."""

        def place(stand: Stand, rows: Sequence[int]) -> list[PlacedPass | Infeasible]:
            return stand.placer.passes([views[i] for i in rows], [counts[i] for i in rows], speed, branch)

        return self._placed(len(views), place)

    def poses(self, part_from_sensor: Array) -> list[PlacedPose | Infeasible]:
        """See `Placer.poses`; the names count all poses."""

        def place(stand: Stand, rows: Sequence[int]) -> list[PlacedPose | Infeasible]:
            found = stand.placer.poses(part_from_sensor[list(rows)])
            return [
                replace(item, name=f"pose {i + 1}") if isinstance(item, PlacedPose) else item
                for i, item in zip(rows, found, strict=True)
            ]

        return self._placed(len(part_from_sensor), place)

    def still(self, name: str, world_from_sensor: Array) -> PlacedPose | Infeasible:
        """The pose (4, 4) of the sensor in the world with the table where it starts, or why it is infeasible."""

        def place(stand: Stand, _: Sequence[int]) -> list[PlacedPose | Infeasible]:
            return [stand.placer.still(name, pose.inverse(stand.cell.nominal.world_from_table) @ world_from_sensor)]

        return self._placed(1, place)[0]

    def _placed(
        self, count: int, place: Callable[[Stand, Sequence[int]], list[_T | Infeasible]]
    ) -> list[_T | Infeasible]:
        """Views by number, each at the first of the stands in the order of the module's description."""

        def at(stand: Stand, rows: list[int]) -> dict[int, _T | Infeasible]:
            found = place(stand, rows)
            placed = [one if isinstance(one, Infeasible) else replace(one, further=stand.positions) for one in found]
            return dict(zip(rows, placed, strict=True))

        first, *others = self.candidates
        found = at(first, list(range(count)))
        left = [i for i, item in found.items() if isinstance(item, Infeasible)]
        elsewhere = [at(stand, left) for stand in others] if left else []
        while left and elsewhere:
            best = max(elsewhere, key=lambda items: sum(not isinstance(items[i], Infeasible) for i in left))
            served = [i for i in left if not isinstance(best[i], Infeasible)]
            if not served:
                break
            found |= {i: best[i] for i in served}
            left = [i for i in left if i not in served]
        for i in left if others else ():
            item = found[i]
            assert isinstance(item, Infeasible)
            found[i] = replace(item, reason=f"{item.reason}; nor is it feasible elsewhere ({len(others)} positions)")
        return list(found.values())
