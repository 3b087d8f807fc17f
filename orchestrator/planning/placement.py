"""Where the arm stands for each view: side, roll and branch, chosen by reach, joint limits and clashes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from orchestrator.geometry import pose
from orchestrator.planning import constraints, trajectory
from orchestrator.planning.model import PlanningCell
from orchestrator.planning.paths import Pass, Sweep
from orchestrator.planning.reasons import describe, out_of_reach

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

# Fraction of the joints' and the table's abilities that planned motions use: the controller keeps the rest.
LIMIT_SHARE = 0.8
PATH_ACCELERATION = 0.5  # m/s² along straight passes
_SIDE_STEP = np.radians(15.0)
_MIN_METRIC = 1e-3  # an Eq. 7 product below this is as good as at a limit
_TURN_CHECKS = 120  # table angles of a full turn at which clashes are looked for
_MAX_TRIES = 24


@dataclass(frozen=True)
class PlacedSweep:
    """A sweep with the joints (6,) at which the sensor stands."""

    view: Sweep
    q: Array
    branch: int


@dataclass(frozen=True)
class PlacedPass:
    """A pass with its table angle, its run, the joints (n, 6) at each cycle of the run and (m, 6) at exposures."""

    view: Pass
    table: float
    run: trajectory.Run
    q: Array
    exposures: Array
    branch: int


@dataclass(frozen=True)
class PlacedPose:
    """One exposure with joints (6,) and table angle."""

    name: str
    q: Array
    table: float


@dataclass(frozen=True)
class Refusal:
    """Why a view cannot be taken; `by_view` when the sensor itself is in the way, wherever the arm stands."""

    reason: str
    by_view: bool = False


_T = TypeVar("_T", PlacedSweep, PlacedPass, PlacedPose)


def azimuths(preferred: float) -> Array:
    """Sides to try: the preferred one, then every 15 degrees alternately to both sides of it."""
    steps = np.array([0, *(s * k for k in range(1, 12) for s in (-1, 1)), 12])
    return np.asarray(preferred + steps * _SIDE_STEP)


class Placer:
    """Places views in one cell, keeping `clearance` (m) between bodies and near the preferred `azimuth` (rad)."""

    def __init__(self, cell: PlanningCell, azimuth: float, clearance: float) -> None:
        self._cell = cell
        self._azimuth = azimuth
        self._clearance = clearance

    def sweeps(self, views: Sequence[Sweep]) -> list[PlacedSweep | Refusal]:
        """Place sweeps, as many as possible on one side and in one branch."""
        if not views:
            return []
        sides = [(a, roll) for a in azimuths(self._azimuth) for roll in (0.0, np.pi)]
        targets = np.array([[view.at(a, roll) for a, roll in sides] for view in views])
        q = self._cell.ik(targets.reshape(-1, 4, 4)).reshape(len(views), -1, 6)
        metric = constraints.arm_metric(self._cell.nominal.arm, q)
        usable = metric > _MIN_METRIC
        # A choice is a side in a branch, numbered side * 8 + branch; the best serves most views from nearby.
        away = np.repeat([abs(a - self._azimuth) for a, _ in sides], 8)
        order = np.lexsort((-metric.mean(0), away.round(6), -usable.sum(0)))
        table = np.linspace(0.0, 2 * np.pi, _TURN_CHECKS, endpoint=False)
        result: list[PlacedSweep | Refusal] = []
        for i, view in enumerate(views):

            def attempt(choice: int, i: int = i, view: Sweep = view) -> PlacedSweep | Refusal:
                standing = np.repeat(q[i, choice][None], len(table), 0)
                # Most clashes show at any table angle: look at one before all.
                refusal = self._clear(standing[:1], table[:1]) or self._clear(standing, table)
                return refusal or PlacedSweep(view, q[i, choice], choice % 8)

            choices = order[usable[i][order]]
            # Choices of one roll hold the sensor to the part alike.
            result.append(self._first(view.name, choices, choices // 8 % 2, attempt, targets[i]))
        return result

    def passes(
        self, views: Sequence[Pass], counts: Sequence[int], speed: float, branch: int | None
    ) -> list[PlacedPass | Refusal]:
        """Place straight passes by turning table and sensor together, preferably in the given branch."""
        if not views:
            return []
        cell = self._cell
        runs = [
            trajectory.run(count, view.length / (count - 1), speed, PATH_ACCELERATION, cell.cycle)
            for view, count in zip(views, counts, strict=True)
        ]
        headings = np.radians(np.arange(0.0, 360.0, 15.0))
        turns = pose.from_rotation(pose.rotation_about(2, headings))
        ends = np.array([view.at(run.path[[0, -1]]) for view, run in zip(views, runs, strict=True)])
        targets = turns[None, :, None] @ ends[:, None]
        q = cell.ik(targets.reshape(-1, 4, 4)).reshape(len(views), len(headings), 2, 8, 6)
        metric = constraints.arm_metric(cell.nominal.arm, q).min(2).reshape(len(views), -1)
        usable = metric > _MIN_METRIC
        other_branch = np.tile(np.arange(8) != branch, len(headings))
        order = np.lexsort((-metric.mean(0), other_branch, -usable.sum(0)))
        result: list[PlacedPass | Refusal] = []
        for i, view in enumerate(views):

            def attempt(choice: int, i: int = i, view: Pass = view) -> PlacedPass | Refusal:
                return self._try_pass(view, runs[i], counts[i], float(headings[choice // 8]), choice % 8)

            choices = order[usable[i][order]]
            result.append(self._first(view.name, choices, 0 * choices, attempt, targets[i].reshape(-1, 4, 4)))
        return result

    def poses(self, part_from_sensor: Array) -> list[PlacedPose | Refusal]:
        """Place single exposures (n, 4, 4) given in the part frame; the table turns the part to a side that works."""
        sides = azimuths(self._azimuth)
        table_from_sensor = self._cell.nominal.table_from_part @ part_from_sensor
        origin = table_from_sensor[:, :2, 3]
        angle = sides - np.arctan2(origin[:, 1], origin[:, 0])[:, None]
        targets = pose.from_rotation(pose.rotation_about(2, angle)) @ table_from_sensor[:, None]
        q = self._cell.ik(targets.reshape(-1, 4, 4)).reshape(len(targets), -1, 6)
        metric = constraints.arm_metric(self._cell.nominal.arm, q)
        # The preferred side's neighbourhood wins over a slightly better metric elsewhere.
        score = metric / (1 + np.repeat(np.abs(sides - self._azimuth), 8))
        order = np.argsort(-score, axis=1, kind="stable")
        result: list[PlacedPose | Refusal] = []
        for i in range(len(targets)):
            name = f"pose {i + 1}"

            def attempt(choice: int, i: int = i, name: str = name) -> PlacedPose | Refusal:
                table = float(angle[i, choice // 8])
                return self._clear(q[i, choice][None], np.array([table])) or PlacedPose(name, q[i, choice], table)

            choices = order[i][metric[i][order[i]] > _MIN_METRIC]
            result.append(self._first(name, choices, 0 * choices, attempt, targets[i]))
        return result

    def _first(
        self, name: str, choices: Indices, alike: Indices, attempt: Callable[[int], _T | Refusal], targets: Array
    ) -> _T | Refusal:
        """The first choice that works; else the refusal of the first, or why there is no choice at all.

        Choices with the same number in `alike` are not tried any more after a refusal `by_view` of one of them.
        """
        first: Refusal | None = None
        hopeless: set[int] = set()
        for choice, group in zip(choices[:_MAX_TRIES].tolist(), alike.tolist(), strict=False):
            if group in hopeless:
                continue
            placed = attempt(choice)
            if not isinstance(placed, Refusal):
                return placed
            first = first or placed
            if placed.by_view:
                hopeless.add(group)
        return Refusal(f"{name}: {first.reason if first else out_of_reach(self._cell, targets)}")

    def _clear(self, q: Array, table: Array) -> Refusal | None:
        """None when all bodies keep apart at joints (n, 6) and table angles (n,)."""
        near = self._cell.too_near(q, table, self._clearance)
        if not near:
            return None
        by_view = any({c.body_a, c.body_b} <= {"sensor", "part", "table", "table_base"} for c in near)
        return Refusal(describe(min(near, key=lambda c: c.distance), self._clearance), by_view)

    def _try_pass(
        self, view: Pass, run: trajectory.Run, count: int, heading: float, branch: int
    ) -> PlacedPass | Refusal:
        """The pass at one heading and in one branch."""
        cell, arm = self._cell, self._cell.nominal.arm
        turn = pose.from_rotation(pose.rotation_about(2, heading))
        middle = cell.ik(turn @ view.at(np.array([view.length / 2])))[0, branch]
        path = np.concatenate([run.path, np.linspace(0.0, view.length, count)])
        q = cell.ik(turn @ view.at(path), reference=middle)[:, branch]
        if not np.isfinite(q).all():
            return Refusal("leaves the joint limits on the way")
        moving = q[: len(run.path)]
        used = np.maximum(*trajectory.share_of_limits(moving, arm.max_speed, arm.max_acceleration, cell.cycle))
        if used.max() > 1.0:
            return Refusal(f"joint {int(np.argmax(used)) + 1} cannot follow at this speed")
        table = heading - view.direction
        refusal = self._clear(moving[::4], np.full(len(moving[::4]), table))
        return refusal or PlacedPass(view, table, run, moving, q[len(run.path) :], branch)
