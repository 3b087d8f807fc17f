"""Configuration map: the quality f(t, θ) of every table angle at every pose of a sensor path, for one arm branch.

A sensor path in the frame of the table leaves one degree of freedom: the table may turn and carry the path along. A
cell of the map is a pose number t (column) and a table angle θ (row); its quality is the product of the static
constraints (Dumitrache & Borangiu, Eq. 6). Cells are evaluated when they are asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from scancell.arrays import Array, Flags, Indices
from scancell.geometry import pose
from scancell.geometry.arm import Arm
from scancell.nominal.cell import NominalCell
from scancell.planning.model import CELL, QUERY, PlanningCell, out_of_reach
from scancell.planning.path_map.numbered_branches import NumberedBranches
from scancell.proximity.scene import Clash, ProximityScene


def joint_range(q: ArrayLike, lower: ArrayLike, upper: ArrayLike, gamma: ArrayLike = 1.0) -> Array:
    """Joint-range factor of Eq. 7, ``sin(pi (q - lower) / (upper - lower)) ** gamma``, of broadcast shape.

    1 in mid-range, 0 at a limit and outside. The published sine is negative outside, so that two joints outside
    their limits would multiply to a positive score. Angles in radians.
    """
    q, lower, upper = (np.asarray(x, float) for x in (q, lower, upper))
    fraction = (q - lower) / (upper - lower)
    inside = (fraction > 0) & (fraction < 1)
    sine = np.sin(np.pi * np.where(inside, fraction, 0.5))
    return np.asarray(np.where(inside, sine ** np.asarray(gamma, float), 0.0))


def clearance(
    distance: ArrayLike, low: ArrayLike, high: ArrayLike, gamma: float | Array = 1.0, printed: bool = False
) -> Array:
    """Clearance factor of Eq. 8 with pi/2: 0 below `low`, 1 above `high` (m), a quarter period of a sine between.

    With the pi that is `printed` the factor returns to 0 at `high` and then jumps to 1.
    """
    distance, low, high = (np.asarray(x, float) for x in (distance, low, high))
    fraction = np.clip((distance - low) / (high - low), 0.0, 1.0)
    if printed:
        return np.asarray(np.where(fraction < 1, np.maximum(np.sin(np.pi * fraction), 0.0) ** gamma, 1.0))
    return np.asarray(np.sin(np.pi / 2 * fraction) ** gamma)


def product(*factors: ArrayLike) -> Array:
    """Product of all factors (Eq. 6), of broadcast shape; 0 where any factor is NaN (no inverse kinematics)."""
    result = np.prod(np.broadcast_arrays(*(np.asarray(f, float) for f in factors)), axis=0)
    return np.asarray(np.nan_to_num(result, nan=0.0))


def arm_metric(arm: Arm, q: ArrayLike, gamma: ArrayLike = 1.0) -> Array:
    """Product (...,) of the joint-range factors of q (..., joints), rad; 0 for NaN. `gamma`: one, or (joints,)."""
    lower, upper = arm.limits
    factors = joint_range(q, lower, upper, gamma)
    return product(*np.moveaxis(factors, -1, 0))


_BLOCK = 4096  # cells between two looks at the work
ROTATION_LENGTH = 0.3  # m: weighs rotations against translations in singularity distances

# Constraints of a cell, in the order of evaluation; user functions follow.
CAUSES = ("free", "reach", "joint range", "singularity", "joint speed", "clearance", "user")
FREE, REACH, JOINT_RANGE, SINGULARITY, JOINT_SPEED, CLEARANCE, USER = range(len(CAUSES))

QualityFactor = Callable[[Array, Array], Array]
"""User constraint: joints (n, joints) and table angles (n,), rad, to factors (n,) in [0, 1]."""


@dataclass(frozen=True)
class StaticConstraints:
    """Constraints of the cells of a map; their factors, each in [0, 1], multiply (Eq. 6).

    Attributes
    ----------
    joint_range_power
        Exponent of Eq. 7: one, or one for each joint.
    singularity
        Lower and upper bound of the singularity distance, between which its factor rises from 0 to 1; see
        `singularity_distance`.
    clearance
        (pairs, 2) distances of Eq. 8, m: 0 below the first, 1 above the second. In the order of the scene's pairs.
    clearance_power
        Exponent of Eq. 8: one, or (pairs,) in the order of the scene's pairs.
    printed
        Whether Eq. 8 is taken as printed, see `clearance`.
    user
        Further factors.
    """

    singularity: tuple[float, float]
    clearance: Array
    joint_range_power: float | tuple[float, ...] = 1.0
    clearance_power: float | Array = 1.0
    printed: bool = False
    user: Sequence[QualityFactor] = ()


def singularity_distance(inverse_jacobian: ArrayLike) -> Array:
    """Lower bound (...,) of the smallest singular value of Jacobians, from their inverses (..., joints, 6).

    Rotations are weighed by `ROTATION_LENGTH`. The Frobenius norm of an inverse is at least its spectral norm, which is
    the inverse of the smallest singular value, and at most sqrt(6) times as large.
    """
    weighted = np.asarray(inverse_jacobian, float) * np.array([1.0, 1.0, 1.0, *3 * (1 / ROTATION_LENGTH,)])
    return np.asarray(1 / np.linalg.norm(weighted, axis=(-2, -1)) / ROTATION_LENGTH)


@dataclass(frozen=True)
class Drive:
    """The axis that moves along a sensor path, and where table and further axes are meanwhile.

    Attributes
    ----------
    name
        Its name; a map has a row for each of its positions.
    low, span
        Position of the first row, and that of all rows, rad or m. The rows close to a circle: of a table that is a
        turn, of other axes their range and a gap of forbidden rows.
    high
        Largest position, rad or m.
    others
        Positions (n, 1 + further axes) of table and further axes at times (n,) from the start of the motion, s, in
        which that of the moving axis has no effect. None: the table moves, and is the only axis.
    window
        Time by which the motions of the others begin before 0 and end later, s.
    effort
        Mean over time of the terms for speed and acceleration of the motions of the others.
    unit, per_unit
        Unit in which positions are shown, and its size, rad or m.
    """

    name: str = "table"
    low: float = 0.0
    span: float = 2 * np.pi
    high: float = np.inf
    others: Callable[[Array], Array] | None = None
    window: float = 0.0
    effort: float = 0.0
    unit: str = "deg"
    per_unit: float = np.pi / 180

    def positions(self, nominal: NominalCell, time: Array, position: Array) -> Array:
        """Positions (n, 1 + further axes) at times (n,), s, with the moving axis at positions (n,), rad or m."""
        if self.others is None:
            return np.asarray(position, float)[:, None]
        rows = np.array(self.others(time))
        rows[:, nominal.axes.index(self.name) - len(nominal.home)] = position
        return rows

    def carried(self, nominal: NominalCell, positions: Array) -> Array:
        """Poses (n, 4, 4) by which the axes at positions (n, …) displace the table relative to the arm.

        A sensor pose in the frame of the table becomes one in that of the table with all axes at 0, as it would be if
        the arm stood in the world, as `PlanningCell.ik` takes it.
        """
        if self.others is None:
            return pose.from_rotation(pose.rotation_about(2, positions[:, 0]))
        placed = nominal.tree.place(_with_joints(nominal, positions), [nominal.arm_on, "table"])
        return np.asarray(
            pose.inverse(nominal.world_from("table")) @ pose.inverse(placed[nominal.arm_on]) @ placed["table"]
        )

    @property
    def in_words(self) -> str:
        """Name of a row in messages."""
        return "table angle" if self.name == "table" else f"position of {self.name}"


def _with_joints(nominal: NominalCell, positions: Array) -> Array:
    return np.hstack([np.zeros((len(positions), len(nominal.home))), positions])


class ConfigurationMap:
    """Lazily evaluated map of one branch.

    Parameters
    ----------
    cell
        Nominal cell.
    table_from_sensor
        (n, 4, 4) poses of the sensor along the path, in the frame of the table at angle 0, m.
    period
        Time between two poses, s.
    branch
        Number of the arm branch: of those with names, or of `NumberedBranches`.
    rows
        Number of table angles in a turn.
    static
        Constraints.
    drive
        The axis whose positions are the rows, for which `rows` is their number in its span.
    numbered
        Branches without names of the same map, where they are known; default: to be found.

    Attributes
    ----------
    quality
        (n, rows) product of all factors, NaN where not evaluated.
    cause
        (n, rows) number in `CAUSES` of the constraint that forbids a cell, 0 where it is free or not evaluated.
    lowest_rate, highest_rate
        (n, rows) table speeds between which all joints are within their speed limits, rad/s.
    """

    drive = Drive()

    def __init__(
        self,
        cell: PlanningCell,
        table_from_sensor: Array,
        period: float,
        branch: int,
        rows: int,
        static: StaticConstraints,
        drive: Drive | None = None,
        numbered: NumberedBranches | None = None,
    ) -> None:
        self._cell, self._static, self._branch = cell, static, branch
        self.drive = drive or Drive()
        self._path, self._period = np.asarray(table_from_sensor, float), period
        self._velocity = _path_twists(self._path, period)
        shape = (len(self._path), rows)
        self.quality = np.full(shape, np.nan, np.float32)
        self.cause = np.zeros(shape, np.int8)
        self.lowest_rate = np.full(shape, np.inf, np.float32)
        self.highest_rate = np.full(shape, -np.inf, np.float32)
        if numbered is None and not cell.nominal.arm.has_named_branches:
            numbered = NumberedBranches(cell, self._targets_of_rows, self.within(np.arange(rows)), len(self._path))
        self._numbered = numbered
        self._with_table, self._elsewhere = _split(cell, static)
        self._clearance_of_column = np.full(len(self._path), np.nan)

    @property
    def branch(self) -> int:
        """Number of the arm branch."""
        return self._branch

    def of_branch(self, branch: int) -> ConfigurationMap:
        """The map of the same path for another branch, not evaluated."""
        own = self._path, self._period, branch, self.rows, self._static, self.drive, self._numbered
        return ConfigurationMap(self._cell, *own)

    @property
    def is_found(self) -> bool:
        """Whether the arm has the branch; of those with names it may have all."""
        return self._numbered is None or self._numbered[self._branch] is not None

    @property
    def columns(self) -> int:
        """Number of poses."""
        return self.quality.shape[0]

    @property
    def rows(self) -> int:
        """Number of table angles in a turn."""
        return self.quality.shape[1]

    @property
    def evaluated(self) -> int:
        """Number of cells evaluated so far."""
        return int(np.isfinite(self.quality).sum())

    def angle(self, row: ArrayLike) -> Array:
        """Table angles, or positions of another axis, (...,), rad or m, of rows (...,)."""
        return np.asarray(row, float) * (self.drive.span / self.rows) + self.drive.low

    def within(self, row: ArrayLike) -> Flags:
        """Whether rows (...,) are positions within the limits of the axis."""
        return np.asarray(self.angle(row) <= self.drive.high)

    def require(self, column: ArrayLike, row: ArrayLike) -> None:
        """Evaluate those of the cells (k,) that are not yet."""
        self._cell.work.spend(QUERY)
        column, row = np.broadcast_arrays(np.asarray(column, np.int64), np.asarray(row, np.int64))
        new = np.isnan(self.quality[column, row])
        if new.any():
            # Neighbours in time follow each other, which shortens the distance queries.
            cells = np.unique(row[new] * self.columns + column[new])
            for block in np.array_split(cells, -(-len(cells) // _BLOCK)):
                self._cell.work.spend(CELL * len(block))
                self._evaluate(block % self.columns, block // self.columns)

    def require_all(self) -> None:
        """Evaluate the whole map."""
        column, row = np.meshgrid(np.arange(self.columns), np.arange(self.rows))
        self.require(column.ravel(), row.ravel())

    def joints(self, column: ArrayLike, angle: ArrayLike) -> Array:
        """Joints (k, joints), rad, at columns (k,) and table angles (k,); NaN outside reach or limits."""
        column, angle = np.asarray(column), np.asarray(angle, float)
        return self.joints_for(self._period * column, angle, self._targets(column, angle))

    def joints_for(self, time: Array, angle: Array, targets: Array, reference: Array | None = None) -> Array:
        """Joints (k, joints), rad, of the branch for sensor poses (k, 4, 4) in the frame of the table at angle 0.

        At times (k,) from the first pose, s, and table angles (k,); `reference` is as of `PlanningCell.ik`.
        """
        if self._numbered is None:
            return self._cell.ik(targets, reference)[:, self._branch]
        row = (angle - self.drive.low) * (self.rows / self.drive.span)
        return self._numbered.near(self._branch, np.asarray(time) / self._period, row, targets, reference)

    def _targets_of_rows(self, column: Indices, row: Indices) -> Array:
        return self._targets(column, self.angle(row))

    def _targets(self, column: Indices, angle: Array) -> Array:
        nominal = self._cell.nominal
        return np.asarray(self.drive.carried(nominal, self._positions(column, angle)) @ self._path[column])

    def _positions(self, column: Indices, angle: Array) -> Array:
        """Positions (k, 1 + further axes) of table and further axes at cells (k,)."""
        return self.drive.positions(self._cell.nominal, np.asarray(self._period * column, np.float64), angle)

    def worst_clashes(self, column: int, row: Indices) -> list[Clash]:
        """The pair of bodies (k,) that violates its clearance most at each of the cells (k,) of a column."""
        if not len(row):
            return []
        angle, columns = self.angle(row), np.full(len(row), column)
        axes = np.column_stack([self.joints(columns, angle), self._positions(columns, angle)])
        poses = self._cell.nominal.body_poses(axes)
        low, pairs = self._static.clearance[:, 0], self._cell.proximity.pairs
        distance = self._cell.proximity.distances(poses, low, self._cell.threads)
        worst = (low - distance).argmax(1)
        return [
            Clash(i, pairs[k][0], pairs[k][1], float(distance[i, k]), float(low[k]))
            for i, k in enumerate(worst.tolist())
        ]

    def out_of_reach(self, column: int, row: int) -> str:
        """Why the branch does not reach a cell whose cause is that."""
        if not self.within(row):
            return f"the axis {self.drive.name} is beyond its limits"
        targets = self._targets(np.array([column]), self.angle([row]))
        if self._numbered is None:
            return out_of_reach(self._cell, targets, slice(self._branch, self._branch + 1))
        if np.isfinite(self._cell.ik(targets)).all(-1).any():
            return f"the arm reaches it in other branches than {self._cell.nominal.arm.branch_names[self._branch]}"
        return out_of_reach(self._cell, targets)

    def _evaluate(self, column: Indices, row: Indices) -> None:
        angle = self.angle(row)
        q = self.joints(column, angle)
        arm = self._cell.nominal.arm
        quality = np.ones(len(q))
        cause = np.zeros(len(q), np.int8)
        # Each constraint judges the cells that all before it allow.
        judges: list[tuple[int, Callable[[Indices], Array]]] = [
            (REACH, lambda at: (np.isfinite(q[at]).all(-1) & self.within(row[at])).astype(float)),
            (JOINT_RANGE, lambda at: arm_metric(arm, q[at], self._static.joint_range_power)),
            (SINGULARITY, lambda at: self._singularity_and_rates(column[at], row[at], angle[at], q[at])),
            (JOINT_SPEED, lambda at: self._some_rate(column[at], row[at])),
            (CLEARANCE, lambda at: self._clearance(column[at], angle[at], q[at])),
            *((USER, _user_factor(user, q, self._positions(column, angle)[:, 0])) for user in self._static.user),
        ]
        for number, judge in judges:
            at = np.flatnonzero(quality > 0)
            if not len(at):
                break
            factor = np.nan_to_num(judge(at))
            quality[at] *= factor
            cause[at[factor <= 0]] = number
        self.quality[column, row] = quality
        self.cause[column, row] = np.where(quality > 0, FREE, cause)

    def _singularity_and_rates(self, column: Indices, row: Indices, angle: Array, q: Array) -> Array:
        """Factors (k,) of the singularity distance; notes the table speeds that the joints' speed limits allow."""
        arm, nominal = self._cell.nominal.arm, self._cell.nominal
        inverse = np.linalg.pinv(arm.jacobian(q)) if len(arm.joints) != 6 else _inverse(arm.jacobian(q))
        factor = clearance(singularity_distance(inverse), *self._static.singularity)
        # The flange as part of a body that moves with the table, and its velocity along the path.
        flange = arm.fk(q)[:, :3, 3]
        turn, turning, meanwhile = self._moving(column, angle, flange)
        linear = (turn @ self._velocity[column, :3, None])[..., 0]
        angular = (turn @ self._velocity[column, 3:, None])[..., 0]
        lever = flange - (nominal.world_from_sensor(q) if self.drive.others is None else self._sensor(q))[:, :3, 3]
        along = np.concatenate([linear + np.cross(angular, lever), angular], -1) + meanwhile
        by_table = (inverse @ turning[..., None])[..., 0]
        by_path = (inverse @ along[..., None])[..., 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = (np.stack([-arm.max_speed, arm.max_speed])[:, None] - by_path) / by_table
            low, high = np.nanmax(ends.min(0), -1), np.nanmin(ends.max(0), -1)
        still = (np.abs(by_path) <= arm.max_speed) | (np.abs(by_table) > 1e-12)
        self.lowest_rate[column, row] = np.where(still.all(-1), low, np.inf)
        self.highest_rate[column, row] = np.where(still.all(-1), high, -np.inf)
        return factor

    def _sensor(self, q: Array) -> Array:
        """Poses (k, 4, 4) of the sensor in the frame in which the arm stands."""
        return np.asarray(self._cell.nominal.arm.fk(q) @ self._cell.nominal.flange_from_sensor)

    def _moving(self, column: Indices, angle: Array, flange: Array) -> tuple[Array, Array, Array | float]:
        """Rotation (k, 3, 3) of the table in the frame in which the arm stands, and twists (k, 6) there.

        Those of the flange at `flange` (k, 3), as part of a body that moves with the table, per velocity of the axis,
        and by the motions of the others.
        """
        nominal = self._cell.nominal
        if self.drive.others is None:
            turn = nominal.world_from_table[:3, :3] @ pose.rotation_about(2, angle)
            axis, origin = nominal.world_from_table[:3, 2], nominal.world_from_table[:3, 3]
            turning = np.concatenate([np.cross(axis, flange - origin), np.broadcast_to(axis, flange.shape)], -1)
            return turn, turning, 0.0
        positions = _with_joints(nominal, self._positions(column, angle))
        at, jacobian = nominal.tree.relative("table", nominal.arm_on, positions)
        lever = (flange - at[:, :3, 3])[:, None]
        by_axis = np.swapaxes(jacobian[..., len(nominal.home) : len(nominal.axes)], -1, -2).copy()
        by_axis[..., :3] += np.cross(by_axis[..., 3:], lever)
        number = nominal.axes.index(self.drive.name) - len(nominal.home)
        rates = self._rates_of_others()[column]
        rates[:, number] = 0.0
        return at[:, :3, :3], by_axis[:, number], np.einsum("ka,kai->ki", rates, by_axis)

    def _rates_of_others(self) -> Array:
        """Velocities (columns, 1 + further axes) of the others, rad/s or m/s."""
        assert self.drive.others is not None
        time, half = np.arange(self.columns, dtype=np.float64) * self._period, self._period / 8
        return np.asarray((self.drive.others(time + half) - self.drive.others(time - half)) / (2 * half))

    def _some_rate(self, column: Indices, row: Indices) -> Array:
        """Whether some table speed keeps all joints within their speed limits, (k,)."""
        return (self.lowest_rate[column, row] <= self.highest_rate[column, row]).astype(float)

    def _clearance(self, column: Indices, angle: Array, q: Array) -> Array:
        """Factors (k,) of Eq. 8, the product over all pairs."""
        positions = self._positions(column, angle)
        new = np.unique(column[np.isnan(self._clearance_of_column[column])])
        if len(new):
            first = np.array([np.flatnonzero(column == c)[0] for c in new])
            self._clearance_of_column[new] = self._factor(*self._with_table, q[first], positions[first])
        factor = self._clearance_of_column[column]
        open_ = factor > 0
        factor[open_] *= self._factor(*self._elsewhere, q[open_], positions[open_])
        return factor

    def _factor(self, scene: ProximityScene, limits: Array, power: float | Array, q: Array, positions: Array) -> Array:
        if not len(q) or not len(scene.pairs):
            return np.ones(len(q))
        poses = self._cell.nominal.body_poses(np.column_stack([q, positions]))
        distance = scene.distances(poses, limits[:, 1], self._cell.threads)
        factors = clearance(distance, limits[:, 0], limits[:, 1], power, self._static.printed)
        return np.asarray(factors.prod(-1))


def _user_factor(user: QualityFactor, q: Array, angle: Array) -> Callable[[Indices], Array]:
    return lambda at: np.asarray(user(q[at], angle[at]), float)


_Pairs = tuple[ProximityScene, Array, float | Array]  # with their distances and exponents of Eq. 8


def _split(cell: PlanningCell, static: StaticConstraints) -> tuple[_Pairs, _Pairs]:
    """Pairs whose distance is the same at every table angle (sensor and table with what they carry), and the others."""
    limits, power = static.clearance, static.clearance_power
    scene, nominal = cell.proximity, cell.nominal
    axes = {body.name: nominal.tree.axes_of(body.moves_with) for body in nominal.bodies}
    on_flange = {name for name, moving in axes.items() if set(nominal.arm.tree.axes) <= set(moving)}
    on_table = {name for name, moving in axes.items() if "table" in moving}
    fixed = np.array([bool({a, b} & on_flange) and bool({a, b} & on_table) for a, b in scene.pairs], bool)
    pairs = np.array([frozenset(pair) for pair in scene.pairs], object)

    def of(chosen: Flags) -> _Pairs:
        return (
            scene.without(set(pairs[~chosen])),
            limits[chosen],
            power[chosen] if isinstance(power, np.ndarray) else power,
        )

    return of(fixed), of(~fixed)


def _path_twists(path: Array, period: float) -> Array:
    """Velocities (n, 6) of the sensor's origin and angular velocities along the path, table axes."""
    if len(path) < 2:
        return np.zeros((len(path), 6))
    linear = np.gradient(path[:, :3, 3], period, axis=0)
    before, after = path[[0, *range(len(path) - 1)]], path[[*range(1, len(path)), -1]]
    span = np.full(len(path), 2 * period)
    span[[0, -1]] = period
    rotation = pose.log_rotation(after[:, :3, :3] @ np.swapaxes(before[:, :3, :3], -1, -2))
    return np.concatenate([linear, rotation / span[:, None]], -1)


def _inverse(jacobian: Array) -> Array:
    """Inverses (n, 6, 6); infinite at singular configurations."""
    singular = np.abs(np.linalg.det(jacobian)) < 1e-12
    inverse = np.full(jacobian.shape, np.inf)
    inverse[~singular] = np.linalg.inv(jacobian[~singular])
    return inverse
