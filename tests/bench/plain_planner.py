"""A judge and a plain planner on python-fcl, which share no list of pairs and no distance with the planner.

They compare all bodies whose relative poses change, except those that touch each other at the home position. The plain
planner samples: it draws azimuths and table angles for views, and grows the two trees of RRT-Connect for motions.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import fcl
import numpy as np
from numpy.typing import NDArray

from benchmarks.planning_cases import dense_poses
from scancell.geometry import pose
from scancell.nominal.cell import NominalCell
from scancell.planning.model import SensorRange
from scancell.planning.plan import Plan
from scancell.planning.views.views import Pass, Sweep
from scancell.proximity.judge import Judge

Array = NDArray[np.float64]

_BLOCK = 2000
_TURN_ANGLES = 120  # of a sweep
_TURN_STEP = np.radians(0.5)  # of a table that turns alone
_PASS_POSES = 41
_STEP = np.radians(1.0)  # of an edge while it is grown
_FINE_STEP = np.radians(0.1)  # of a path that was found


@dataclass(frozen=True)
class Judgement:
    """Number of judged poses, what is in contact, and the smallest margin beyond the stated errors, m."""

    poses: int
    contact: str
    margin: float


class Cell:
    """Distances of a cell's bodies by python-fcl.

    Parameters
    ----------
    nominal
        Kinematics and bodies.
    start
        Poses (bodies, 4, 4) at which bodies that touch do so by construction; None: those at home.
    """

    def __init__(self, nominal: NominalCell, start: Array | None = None) -> None:
        self.nominal = nominal
        self.names = [body.name for body in nominal.bodies]
        meshes = {body.name: body.mesh for body in nominal.bodies}
        self._judge = Judge(meshes, self.names, nominal.body_poses(nominal.home) if start is None else start)
        self.corners = [
            body.mesh.bounds[np.indices((2, 2, 2)).reshape(3, 8), np.arange(3)[:, None]].T for body in nominal.bodies
        ]
        self.pairs = self._judge._index

    def within_reach(self, poses: Array, margin: float) -> NDArray[np.int64]:
        """Pairs (k, 2) whose bounding spheres are nearer than `margin`, m, at one of the poses (n, bodies, 4, 4)."""
        return np.asarray(self.pairs[self._judge._within_reach(poses, margin)])

    def near(self, poses: Array, pairs: NDArray[np.int64], margin: float) -> NDArray[np.bool_]:
        """Whether the oriented boxes of pairs (k, 2) are nearer than `margin`, m, at poses (n, bodies, 4, 4): (n, k).

        Pairs whose relative pose is that of the pose before are left out.
        """
        return self._judge._overlapping(poses, pairs, margin)

    def distance(self, poses: Array, a: int, b: int) -> float:
        """Distance (m) of two bodies at poses (bodies, 4, 4)."""
        return float(fcl.distance(*self._judge._placed(poses, (a, b)), fcl.DistanceRequest(), fcl.DistanceResult()))

    def hits(self, poses: Array, a: int, b: int) -> bool:
        """Whether two bodies intersect at poses (bodies, 4, 4): much faster than their distance."""
        return bool(fcl.collide(*self._judge._placed(poses, (a, b)), fcl.CollisionRequest(), fcl.CollisionResult()))


def judged(nominal: NominalCell, made: Plan, step: float, errors: dict[str, float]) -> Judgement:
    """Judge a plan at poses between which no two points approach by more than `step`, m.

    `errors` (m) of bodies by name shift each towards the other body of every pair, which is the worst direction. A
    distance excludes contact at the next poses until the corners of one body have moved by it relative to the other.
    """
    cell, count, margin = Cell(nominal), 0, np.inf
    off = np.array([errors.get(name, 0.0) for name in cell.names])
    for segment in made.program.segments:
        axes = segment.axes
        poses = nominal.body_poses(axes)
        at = np.stack([pose.transform_points(poses[:, i], corner[None]) for i, corner in enumerate(cell.corners)], 1)
        moved = np.linalg.norm(np.diff(at, axis=0), axis=-1).max((1, 2), initial=0.0)
        # Two bodies may move towards each other.
        parts = np.maximum(1, np.ceil(2 * moved / step).astype(int))
        pieces = [
            a + np.linspace(0, 1, n, endpoint=False)[:, None] * (b - a)
            for a, b, n in zip(axes, axes[1:], parts, strict=False)
        ]
        dense = np.concatenate([*pieces, axes[-1:]])
        for first in range(0, len(dense), _BLOCK):
            block = dense[first : first + _BLOCK]
            clash, least = _judge_block(cell, nominal.body_poses(block), off)
            margin = min(margin, least)
            if clash:
                return Judgement(count, f"{clash} in {segment.name}", margin)
            count += len(block)
    return Judgement(count, "", margin)


def _judge_block(cell: Cell, poses: Array, off: Array) -> tuple[str, float]:
    """Name the bodies in contact at one of the poses (n, bodies, 4, 4), and return the smallest margin (m)."""
    margin, largest = np.inf, 2 * float(off.max()) + 1e-4
    pairs = cell.within_reach(poses, largest)
    near = cell.near(poses, pairs, largest)
    for number in np.flatnonzero(near.any(0)).tolist():
        a, b = pairs[number]
        required = off[a] + off[b]
        if required == 0:
            if any(cell.hits(poses[i], a, b) for i in np.flatnonzero(near[:, number])):
                return f"{cell.names[a]} hits {cell.names[b]}", 0.0
            continue
        relative = pose.inverse(poses[:, a]) @ poses[:, b]
        at = np.einsum("nij,kj->nki", relative[:, :3, :3], cell.corners[b]) + relative[:, None, :3, 3]
        travel = np.append(0.0, np.linalg.norm(np.diff(at, axis=0), axis=-1).max(-1).cumsum())
        clear_until = -1.0
        for i in np.flatnonzero(near[:, number]).tolist():
            if travel[i] < clear_until:
                continue
            distance = cell.distance(poses[i], a, b)
            margin = min(margin, distance - required)
            if distance <= required:
                return f"{cell.names[a]} hits {cell.names[b]}", margin
            clear_until = travel[i] + 0.99 * (distance - required)
    return "", margin


@dataclass
class PlainPlanner:
    """Samples views and motions; finds no more than a motion that exists.

    Attributes
    ----------
    nominal
        Kinematics and bodies.
    clearance, motion_clearance
        Distances that poses of views and motions have to keep, m.
    """

    nominal: NominalCell
    range: SensorRange
    clearance: float
    motion_clearance: float
    _cell: Cell = field(init=False)

    def __post_init__(self) -> None:
        self._cell = Cell(self.nominal)
        names, arm = self._cell.names, ("base", "link", "sensor", "gripper", "finger")
        of_arm = np.array([name.startswith(arm) for name in names])
        moves_with = [body.moves_with for body in self.nominal.bodies]
        # The platter is nearer to its bearing than any clearance.
        bearing = {names.index("table"), names.index("table_base")}
        self._pairs = np.array([(a, b) for a, b in self._cell.pairs if moves_with[a] != moves_with[b]
                                and {a, b} != bearing])  # fmt: skip
        self._within_arm = of_arm[self._pairs].all(1)
        moved = of_arm & np.array([name != "base" for name in names])
        self._around = ~moved[self._pairs].any(1)

    def is_free(self, axes: Array, clearance: float, only_around: bool = False) -> bool:
        """Whether all bodies (or those around the arm) keep a clearance (m) at joints and table angle (axes,), rad.

        Bodies of the arm have to be free of contact only.
        """
        poses = self.nominal.body_poses(axes)
        near = self._cell.near(poses[None], self._pairs, clearance)[0]
        if only_around:
            near &= self._around
        return all(
            not self._cell.hits(poses, a, b)
            and (within_arm or self._cell.distance(poses, a, b) >= max(clearance, 1e-6))
            for (a, b), within_arm in zip(self._pairs[near], self._within_arm[near], strict=True)
        )

    def turns(self, table: float = 2 * np.pi) -> bool:
        """Whether the table turns from 0 to an angle, either way, with no regard to the arm."""
        ways = (table, table - 2 * np.pi) if abs(table) < 2 * np.pi else (table,)
        for end in ways:
            angles = np.linspace(0.0, end, max(2, int(abs(end) / _TURN_STEP)))
            if all(self.is_free(np.append(self.nominal.home, a), self.motion_clearance, True) for a in angles):
                return True
        return False

    def finds_sweep(self, view: Sweep, seconds: float) -> bool:
        """Whether some azimuth has joints that keep the clearance during a full turn of the table."""
        rng, until = np.random.default_rng(0), time.process_time() + seconds
        angles = rng.permutation(np.linspace(0.0, 2 * np.pi, _TURN_ANGLES, endpoint=False))
        while time.process_time() < until:
            for q in self._joints(view.at(rng.uniform(0, 2 * np.pi), rng.choice([0.0, np.pi]))[None])[:, 0]:
                if all(self.is_free(np.append(q, angle), self.clearance) for angle in angles):
                    return True
        return False

    def finds_pass(self, view: Pass, seconds: float) -> bool:
        """Whether some table angle has joints that keep the clearance along the pass."""
        rng, until = np.random.default_rng(0), time.process_time() + seconds
        along = view.at(np.linspace(-0.01, view.length + 0.01, _PASS_POSES))
        while time.process_time() < until:
            angle = float(rng.uniform(0, 2 * np.pi))
            branches = self._joints(pose.from_rotation(pose.rotation_about(2, angle)) @ along)
            for q in branches:
                poses = np.column_stack([q, np.full(len(q), angle)])
                order = rng.permutation(len(poses))
                if all(self.is_free(at, self.clearance) for at in poses[order]) and self.turns(angle):
                    return True
        return False

    def _joints(self, table_from_sensor: Array) -> Array:
        """Branches (k, n, joints) of the arm along poses of the sensor (n, 4, 4), within the joint limits."""
        nominal = self.nominal
        targets = nominal.world_from_table @ table_from_sensor @ pose.inverse(nominal.flange_from_sensor)
        q = np.swapaxes(nominal.arm.ik_along(targets[None])[0], 0, 1)
        return np.asarray(q[np.isfinite(q).all((1, 2))])

    def finds_motion(self, start: Array, goal: Array, seconds: float) -> list[Array] | None:
        """Configurations of a path that RRT-Connect finds in a processor time."""
        if not (self.is_free(start, self.motion_clearance) and self.is_free(goal, self.motion_clearance)):
            return None
        rng, until = np.random.default_rng(0), time.process_time() + seconds
        lower, upper = self.nominal.arm.limits
        table = np.sort([start[-1], goal[-1]])
        low, high = np.append(lower, table[0]), np.append(upper, table[1])
        nodes, parents, growing, target = [[start], [goal]], [[0], [0]], 0, goal
        while time.process_time() < until:
            for tree in (growing, 1 - growing):
                near = int(np.argmin(np.linalg.norm(np.array(nodes[tree]) - target, axis=1)))
                ways = dense_poses(np.stack([nodes[tree][near], target]), _STEP)[1:]
                free = 0
                while free < len(ways) and self.is_free(ways[free], self.motion_clearance):
                    free += 1
                if free == 0:
                    break
                for i in [*range(9, free - 1, 10), free - 1]:
                    nodes[tree].append(ways[i])
                    parents[tree].append(near)
                    near = len(nodes[tree]) - 1
                if tree != growing and free == len(ways):
                    path = _joined(nodes, parents)
                    fine = dense_poses(np.array(path), _FINE_STEP)
                    return path if all(self.is_free(at, self.motion_clearance) for at in fine) else None
                target = ways[free - 1]
            growing, target = 1 - growing, rng.uniform(low, high)
        return None


def _joined(nodes: list[list[Array]], parents: list[list[int]]) -> list[Array]:
    """The path from the root of the first tree to that of the second, through the last nodes of both."""
    halves = []
    for tree in (0, 1):
        number = len(nodes[tree]) - 1
        half = [nodes[tree][number]]
        while number:
            number = parents[tree][number]
            half.append(nodes[tree][number])
        halves.append(half)
    return [*halves[0][::-1], *halves[1]]
