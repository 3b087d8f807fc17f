"""Planning model: the nominal cell with the sensor's measuring range, clearance queries, and the limit of the work."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell import sensor as sensor_rt
from scancell.arrays import Array
from scancell.errors import PlanningError
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh, ReducedMesh, reduced
from scancell.nominal.cell import OCCUPIED, NominalCell
from scancell.planning.motion.trajectory import Limits, TorqueLimits
from scancell.progress import NullProgress, Progress
from scancell.proximity.motion_check import MotionCheck
from scancell.proximity.scene import Clash, ProximityScene, arm_chain, cell_scene

# Units of work, about seconds of one core of 2020.
POSE = 5e-6  # inverse kinematics of a pose in closed form
NUMERICAL_POSE = 1.5e-3  # and by continuation
NUMERICAL_STEP, NUMERICAL_ROW = 5e-4, 5e-5  # of a step along paths, and of each solution in it
CONFIGURATION = 3e-5  # distances of all bodies
CELL = 2e-4  # of a configuration map
QUERY = 2e-3  # of cells of one, with the ranking of the ways over them
PATH_POSE = 1e-5  # pose on a sensor path
SIGHT = 1e-6  # judgement of a sample from a pose

_SELF_CLEARANCE = 2e-3  # m between links of the arm
_TOUCHING = 1e-4  # m
_SAME_AXIS = 1e-9  # m, and sine
# Of the clearance, for motions: views are checked at discrete poses, between which bodies may come slightly nearer.
MOTION_SHARE = 0.8
_MAX_FACES = 5000  # meshes with more are reduced
_MAX_ERROR = 0.5e-3  # m: what a reduced mesh may leave out, which is added to the clearance
_BLOCK = 512  # poses of inverse kinematics between two looks at the work
_NUMERICAL_BLOCK = 96  # of an arm without closed form
_MAX_JUDGED_FACES = 100_000  # python-fcl takes 3 s to prepare a million

MAX_LISTED = 8


class WorkLimitError(PlanningError):
    """The limit of the work of planning is reached; the message states the current step and result."""


class Work:
    """Counts work and passes the time for cancelling; a `Progress` of parts, whose stages are not displayed.

    Parameters
    ----------
    limit
        Largest work; ``scan.max_planning_work``.
    progress
        Told of every piece of work, so that it may cancel.
    """

    def __init__(self, limit: float = math.inf, progress: Progress | None = None) -> None:
        self.limit, self.spent, self.doing = limit, 0.0, "preparing the cell"
        self._progress = progress or NullProgress()

    def spend(self, amount: float) -> None:
        """Count work that is about to be done.

        Raises `WorkLimitError` naming what was being done, when the limit is exceeded; `CancelledError` when the
        progress cancels.
        """
        self.spent += amount
        self._progress.advance(0.0)
        if self.spent > self.limit:
            raise WorkLimitError(
                f"planning reached its limit of work while {self.doing}",
                key="scan.max_planning_work",
                value=self.limit,
                expected="a larger limit, or a scan with fewer views",
            )

    def stage(self, name: str, total: float, unit: str) -> None:
        """Begin a part."""
        self.spend(0.0)

    def advance(self, steps: float) -> None:
        """Count steps of a part, which are no work by themselves."""
        self.spend(0.0)


@dataclass(frozen=True)
class SensorRange:
    """Measuring range of the sensor: a trapezoid in the laser sheet (sensor frame, m).

    Attributes
    ----------
    near, far
        Limits of z.
    half_near, half_far
        Half-widths of the visible laser line at `near` and `far`; linear in z between.
    cameras
        (k, 3) centres of projection.
    """

    near: float
    far: float
    half_near: float
    half_far: float
    cameras: Array

    @classmethod
    def of(cls, sensor: sensor_rt.Sensor) -> SensorRange:
        """Range in which all cameras see the laser line, within the limits of the description."""
        near, far = sensor.range
        corners = np.array([sensor.trapezoid(k) for k in range(len(sensor.cameras))])
        by_range = [camera[np.argsort(camera[:, 1])] for camera in corners]
        seen_near = max(near, *(camera[0, 1] for camera in by_range))
        seen_far = min(far, *(camera[-1, 1] for camera in by_range))
        halves = [
            min(float(np.interp(z, camera[[0, 2], 1], np.abs(camera[[0, 2], 0]))) for camera in by_range)
            for z in (seen_near, seen_far)
        ]
        centres = np.array([camera.sensor_from_camera[:3, 3] for camera in sensor.cameras])
        return cls(float(seen_near), float(seen_far), halves[0], halves[1], centres)

    def half_line(self, z: ArrayLike) -> Array:
        """Half-width (...,), m, of the visible laser line at ranges `z` (...,), m."""
        slope = (self.half_far - self.half_near) / (self.far - self.near)
        return np.asarray(self.half_near + slope * (np.asarray(z, float) - self.near))

    def contains(self, y: ArrayLike, z: ArrayLike) -> NDArray[np.bool_]:
        """Whether points (y, z) of the laser sheet (m, any shape) lie in the trapezoid."""
        y, z = np.asarray(y, float), np.asarray(z, float)
        return np.asarray((z >= self.near) & (z <= self.far) & (np.abs(y) <= self.half_line(z)))


@dataclass(frozen=True)
class PlanningCell:
    """Nominal cell, measuring range and controller cycle.

    Attributes
    ----------
    nominal
        Kinematics and bodies; every program starts and ends at its `home`. Where it has axes beside joints and table,
        most of planning takes place in a cell in which they are `held`.
    range
        Measuring range of the sensor.
    cycle
        Controller cycle: time between set-points, s.
    table_start
        Table angle at the start, rad.
    threads
        Threads of the clearance queries, which do not change them; 0 uses all cores.
    torques
        Torque limits of the joints, where the arm has dynamic drives.
    pair_clearance
        Clearances (m) of pairs of bodies by their names, in place of all other values for them.
    work
        Counts the work done with the cell, and ends it beyond a limit.
    """

    nominal: NominalCell
    range: SensorRange
    cycle: float
    table_start: float = 0.0
    threads: int = 0
    torques: TorqueLimits | None = None
    pair_clearance: Mapping[frozenset[str], float] = field(default_factory=dict)
    work: Work = field(default_factory=Work)

    @property
    def start(self) -> Array:
        """Positions (axes,) at which every program starts, rad."""
        start = self.nominal.start
        start[len(self.nominal.home)] = self.table_start
        return start

    def held(self, positions: tuple[float, ...] | None = None) -> PlanningCell:
        """The cell in which axes beside joints and table rest at positions (k,), rad or m; by default at the start.

        It counts work together with this one. Itself where it has no such axes.
        """
        if not self.nominal.further_axes:
            return self
        nominal = self.nominal.with_axes_held(positions)
        cell = replace(self, nominal=nominal, torques=self.torques and self.torques.standing(nominal))
        frames = self.nominal.tree.place([*self.start[: len(self.nominal.home) + 1], *cell.nominal.held_at])
        meshes = {
            one.name: self.reduced_meshes[one.name]
            if one.mesh is body.mesh
            else self.reduced_meshes[one.name].transformed(frames[one.moves_with])
            for one, body in zip(self.nominal.bodies, cell.nominal.bodies, strict=True)
        }
        cell.__dict__["reduced_meshes"] = meshes  # the cached property: reducing takes seconds
        return cell

    @cached_property
    def axis_limits(self) -> Limits:
        """Limits of the axes, (axes,): joints, the table, further axes."""
        nominal = self.nominal
        jerk = np.append([joint.max_jerk for joint in nominal.arm.joints], nominal.table_max_jerk)
        further = [axis.max_jerk for axis in nominal.further_axes]
        return Limits(nominal.axis_max_speed, nominal.axis_max_acceleration, np.append(jerk, further))

    @cached_property
    def _chain(self) -> list[str]:
        return arm_chain(self.nominal)

    @cached_property
    def proximity(self) -> ProximityScene:
        """Bodies of the cell, reduced, and the pairs to check for collision."""
        meshes = {name: found.mesh for name, found in self.reduced_meshes.items()}
        self.work.spend(0.0)
        return cell_scene(self.nominal, meshes)

    @cached_property
    def reduced_meshes(self) -> dict[str, ReducedMesh]:
        """Mesh of each body by name with few faces; measured space as it is."""
        found = {}
        for body in self.nominal.bodies:
            self.work.spend(0.0)
            is_kept = body.name.startswith(OCCUPIED)
            found[body.name] = (
                ReducedMesh(body.mesh, len(body.mesh.faces)) if is_kept else reduced(body.mesh, _MAX_FACES, _MAX_ERROR)
            )
        return found

    @property
    def judged_meshes(self) -> dict[str, Mesh]:
        """Mesh of each body by name for an independent check: the original, unless it has very many faces."""
        return {
            body.name: body.mesh if len(body.mesh.faces) <= _MAX_JUDGED_FACES else self.reduced_meshes[body.name].mesh
            for body in self.nominal.bodies
        }

    @cached_property
    def _errors(self) -> Array:
        """Distance (pairs,), m, by which the bodies of each pair can be nearer than their reduced meshes."""
        meshes = self.reduced_meshes
        return np.array([meshes[a].error + meshes[b].error for a, b in self.proximity.pairs], float)

    def motion_check(self, clearance: float) -> MotionCheck:
        """Check that motions keep `MOTION_SHARE` of the clearance of every pair, see `clearances`."""
        required = MOTION_SHARE * self.clearances(clearance) + self._errors
        self.work.spend(0.0)
        return MotionCheck(self.nominal, self.proximity, required, self.threads, spend=self.work.spend)

    def table_clearances(self, clearance: float) -> Array:
        """Clearances (pairs,), m, of motions of the table, see `motion_check`; ``-inf`` for pairs with the arm."""
        arm = set(self._chain) - {"base"}
        of_arm = np.array([not arm.isdisjoint(pair) for pair in self.proximity.pairs], bool)
        return np.where(of_arm, -np.inf, MOTION_SHARE * self.clearances(clearance) + self._errors)

    def clearances(self, clearance: float) -> Array:
        """Distance (pairs,), m, that the bodies of each pair of `proximity` have to keep.

        It is that of `pair_clearance`, else that of the body if it has its own, else `clearance` (m). Links of the
        arm are close to each other by design: 2 mm are enough.
        """
        own = {body.name: body.clearance for body in self.nominal.bodies if body.clearance is not None}
        required = []
        for pair, inner in zip(self.proximity.pairs, self._of_arm, strict=True):
            usual = min(clearance, _SELF_CLEARANCE) if inner else clearance
            of_bodies = max((own[name] for name in pair if name in own), default=usual)
            required.append(self.pair_clearance.get(frozenset(pair), of_bodies))
        return np.array(required, float)

    @property
    def _of_arm(self) -> NDArray[np.bool_]:
        """Whether both bodies of a pair belong to the arm, (pairs,); a part that it holds does not."""
        chain = set(self._chain) - {"part"}
        return np.array([set(pair) <= chain for pair in self.proximity.pairs], bool)

    def clearance_ranges(
        self, low: float, high: float, arm_high: float, pair_high: Mapping[frozenset[str], float] | None = None
    ) -> Array:
        """Distances (pairs, 2), m, of Eq. 8: where a pair's factor leaves 0, and where it reaches 1.

        They begin at the `clearances` for `low`, and end at `high`, between links of the arm at `arm_high`, and at
        those of `pair_high` for the pairs there; at twice the beginning where that is more.
        """
        first = self.clearances(low) + self._errors
        last = self.of_pairs(np.where(self._of_arm, arm_high, high), pair_high or {})
        return np.stack([first, np.maximum(last, 2 * first)], 1)

    def of_pairs(self, usual: ArrayLike, own: Mapping[frozenset[str], float]) -> Array:
        """Values (pairs,) of all pairs of `proximity`: the `usual` ones, except of the pairs in `own`."""
        pairs = self.proximity.pairs
        values = np.broadcast_to(np.asarray(usual, float), len(pairs)).tolist()
        return np.array([own.get(frozenset(pair), value) for pair, value in zip(pairs, values, strict=True)], float)

    def clearance_violations(self, axes: Array, clearance: float) -> list[Clash]:
        """Pairs of bodies nearer than their `clearances` at positions (n, axes) of joints and table, rad."""
        required, found = self.clearances(clearance) + self._errors, []
        for first in range(0, len(axes), _BLOCK):
            block = axes[first : first + _BLOCK]
            self.work.spend(CONFIGURATION * len(block))
            poses = self.nominal.body_poses(block)
            clashes = self.proximity.clearance_violations(poses, required, self.threads)
            found += [replace(clash, index=first + clash.index) for clash in clashes]
        return found

    def least_distance(self, axes: Array, bound: float) -> float:
        """Smallest distance, m, at positions (n, axes) of joints and table, rad; at most `bound`, m.

        It is that of the bodies as planning knows them, reduced; links of the arm are not compared with one another.
        """
        wanted, least = ~self._of_arm, bound
        for first in range(0, len(axes), _BLOCK):
            block = axes[first : first + _BLOCK]
            self.work.spend(CONFIGURATION * len(block))
            bounds = np.where(wanted, bound, 0.0)
            found = self.proximity.distances(self.nominal.body_poses(block), bounds, self.threads)
            least = float(np.minimum(least, (found - self._errors)[:, wanted].min(initial=least)))
        return max(least, 0.0)

    def contacts(self, axes: Array) -> list[Clash]:
        """Pairs of bodies that touch (0.1 mm) at positions (n, axes) of joints and table, rad."""
        self.work.spend(0.0)
        poses = self.nominal.body_poses(axes)
        return self.proximity.clearance_violations(poses, _TOUCHING + self._errors, self.threads)

    @property
    def _support(self) -> str:
        """Frame in which poses of the sensor are stated: the table at angle 0, or the flange that holds the part."""
        return self.nominal.support if self.nominal.holds_part else "table"

    @property
    def turning_axis(self) -> int | None:
        """Column of the axis that turns the part about the z of what carries it by a full turn; None without one.

        It is a table that turns, or the last joint of an arm that holds the part, if this is the axis of the flange.
        """
        joints, last = self.nominal.arm.joints, self.nominal.arm.joints[-1]
        if not self.nominal.holds_part:
            return len(joints) if self.nominal.table_turns else None
        turned = pose.rotation_about(0, last.alpha) @ pose.rotation_about(1, last.beta)
        is_axis = abs(last.a) < _SAME_AXIS and np.abs(turned - np.eye(3)).max() < _SAME_AXIS
        is_held = any(held.index == len(joints) - 1 for held in self.nominal.arm.held)
        return len(joints) - 1 if is_axis and not is_held and last.max - last.min > 2 * np.pi else None

    def support_from_sensor(self, q: ArrayLike) -> Array:
        """Sensor poses (..., 4, 4), m, in the frame of the table at angle 0, or of the flange that holds the part.

        For joints (..., joints), rad.
        """
        return np.asarray(pose.inverse(self.nominal.world_from(self._support, q)) @ self.nominal.world_from_sensor(q))

    def ik(self, table_from_sensor: ArrayLike, reference: ArrayLike | None = None, filtered: bool = True) -> Array:
        """Joints (n, branches, joints), rad, for sensor poses (n, 4, 4) in the frame of the table at angle 0.

        Where the arm holds the part, the flange takes the place of the table. Parameters as in `Arm.ik`.
        """
        targets = self.world_from_flange(table_from_sensor).reshape(-1, 4, 4)
        shape = (len(targets), len(self.nominal.arm.joints))
        near = None if reference is None else np.broadcast_to(np.asarray(reference, float), shape)
        found = []
        for rows in self._blocks(len(targets)):
            self.work.spend(self._pose_work * len(targets[rows]))
            found.append(self.nominal.arm.ik(targets[rows], None if near is None else near[rows], filtered))
        return np.concatenate(found)

    def ik_along(self, table_from_sensor: ArrayLike, reference: ArrayLike | None = None) -> Array:
        """Joints (n, k, branches, joints), rad, along paths of sensor poses (n, k, 4, 4), see `Arm.ik_along`."""
        targets = self.world_from_flange(table_from_sensor)

        def step(solutions: int) -> None:
            self.work.spend(NUMERICAL_STEP + NUMERICAL_ROW * solutions)

        shape = (len(targets), len(self.nominal.arm.joints))
        near = None if reference is None else np.broadcast_to(np.asarray(reference, float), shape)
        found = []
        for rows in self._blocks(len(targets)):
            self.work.spend(
                self._pose_work * (targets[rows, 0, 0, 0] if self._is_numerical else targets[rows, ..., 0, 0]).size
            )
            found.append(self.nominal.arm.ik_along(targets[rows], None if near is None else near[rows], on_step=step))
        return np.concatenate(found)

    def near(self, table_from_sensor: Array, seeds: Array, reference: Array | None = None) -> Array:
        """Joints (n, joints), rad, for sensor poses (n, 4, 4) from seeds (n, joints), see `ik` and `Arm.near`."""
        self.work.spend(NUMERICAL_STEP + NUMERICAL_ROW * len(seeds))
        return self.nominal.arm.near(self.world_from_flange(table_from_sensor), seeds, reference)

    def _blocks(self, count: int) -> list[slice]:
        """Rows of inverse kinematics between two looks at the work."""
        size = _NUMERICAL_BLOCK if self._is_numerical else _BLOCK
        return [slice(start, start + size) for start in range(0, max(1, count), size)]

    @cached_property
    def _is_numerical(self) -> bool:
        return not self.nominal.arm.has_named_branches

    @property
    def _pose_work(self) -> float:
        return NUMERICAL_POSE if self._is_numerical else POSE

    def world_from_flange(self, table_from_sensor: ArrayLike) -> Array:
        """Poses (..., 4, 4) of the flange for sensor poses in the frame of the table at angle 0, as in `ik`."""
        return self.nominal.world_from_flange(np.asarray(table_from_sensor, float), frame=self._support)


def describe(clash: Clash) -> str:
    """Message that names the two bodies and, unless they intersect, their distance and the required clearance."""
    if clash.distance <= 0:
        return f"{clash.body_a} hits {clash.body_b}"
    distance, required = 1e3 * clash.distance, 1e3 * clash.clearance
    return f"{clash.body_a} comes within {distance:.1f} mm of {clash.body_b} (required clearance {required:g} mm)"


def out_of_reach(cell: PlanningCell, table_from_sensor: Array, branches: slice = slice(None)) -> str:
    """Message why none of several sensor poses (n, 4, 4) is feasible, with the smallest violation among them.

    Poses are in the frame of the table at angle 0. The violation is the distance to the reach of the arm, or the
    angle by which a joint exceeds its limits; in some of the arm's `branches`.
    """
    arm = cell.nominal.arm
    q = cell.ik(table_from_sensor, filtered=False)[:, branches]
    exists = np.asarray(np.isfinite(q).all(axis=-1))
    if not exists.any():
        missing = float(np.min(arm.distance_outside_reach(cell.world_from_flange(table_from_sensor))))
        return f"out of the arm's reach by {1e3 * missing:.0f} mm" if missing > 0 else "out of the arm's reach"
    violation = np.where(exists[..., None], arm.limit_violation(np.nan_to_num(q)), np.inf)
    best = violation.reshape(-1, violation.shape[-1])[int(np.argmin(violation.max(-1)))]
    joint = int(np.argmax(best))
    if best[joint] <= 0:
        return "reachable only with a joint at its limit"
    return f"joint {joint + 1} would be {np.degrees(best[joint]):.1f} deg outside its limits"


def join_reasons(title: str, reasons: list[str]) -> str:
    """Message of a title and the first `MAX_LISTED` of several reasons."""
    more = [f"and {len(reasons) - MAX_LISTED} more"] if len(reasons) > MAX_LISTED else []
    return f"{title}: " + "; ".join([*reasons[:MAX_LISTED], *more])
