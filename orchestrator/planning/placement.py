"""Where the arm stands for each view: side, roll and branch, chosen by reach, joint limits and clashes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orchestrator.geometry import pose
from orchestrator.planning import constraints, trajectory
from orchestrator.planning.model import PlanningCell
from orchestrator.planning.paths import Pass, Sweep
from orchestrator.proximity.scene import Clash

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_SIDE_STEP = np.radians(15.0)
_MIN_METRIC = 1e-3  # an Eq. 7 product below this is as good as at a limit
_TURN_CHECKS = 120  # table angles of a full turn at which clashes are looked for
_MAX_TRIES = 24
# Fraction of the joints' and the table's abilities that planned motions use: the controller keeps the rest.
LIMIT_SHARE = 0.8
PATH_ACCELERATION = 0.5  # m/s² along straight passes: gentle, the sensor shakes otherwise


@dataclass(frozen=True)
class PlacedSweep:
    """A sweep with the joints (6,) at which the sensor stands."""

    view: Sweep
    q: Array
    branch: int


@dataclass(frozen=True)
class PlacedPass:
    """A pass with its table angle, its run along the path and the joints (n, 6) at each cycle of the run."""

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


def azimuths(preferred: float) -> Array:
    """Sides to try: the preferred one, then every 15 degrees alternately to both sides of it."""
    steps = np.array([0, *(s * k for k in range(1, 12) for s in (-1, 1)), 12])
    return np.asarray(preferred + steps * _SIDE_STEP)


def place_sweeps(
    cell: PlanningCell, views: Sequence[Sweep], azimuth: float, clearance: float
) -> tuple[list[PlacedSweep | None], list[str]]:
    """Place sweeps, as many as possible at one side and in one branch; None and a reason where nothing works."""
    options = [(a, roll) for a in azimuths(azimuth) for roll in (0.0, np.pi)]
    if not views:
        return [], []
    targets = np.array([[view.at(a, roll) for a, roll in options] for view in views])
    q = cell.ik(targets.reshape(-1, 4, 4)).reshape(len(views), len(options), 8, 6)
    metric = constraints.arm_metric(cell.nominal.arm, q)
    usable = metric > _MIN_METRIC
    # A choice is one option in one branch, numbered option * 8 + branch; the best serves most views from nearby.
    served = usable.sum(0).ravel()
    away = np.repeat([abs(a - azimuth) for a, _ in options], 8)
    order = np.lexsort((-metric.mean(0).ravel(), away.round(6), -served))
    table = np.linspace(0.0, 2 * np.pi, _TURN_CHECKS, endpoint=False)
    placed: list[PlacedSweep | None] = []
    reasons: list[str] = []
    for i, view in enumerate(views):
        choices = [c for c in order if usable[i].ravel()[c]][:_MAX_TRIES]
        first_hit: list[Clash] = []
        for choice in choices:
            option, branch = divmod(int(choice), 8)
            joints = q[i, option, branch]
            hit = cell.too_near(np.repeat(joints[None], len(table), 0), table, clearance)
            if not hit:
                placed.append(PlacedSweep(view, joints, branch))
                break
            first_hit = first_hit or hit
        else:
            placed.append(None)
            reasons.append(f"{view.name}: {_why(cell, targets[i], first_hit, clearance)}")
    return placed, reasons


def place_passes(
    cell: PlanningCell,
    views: Sequence[Pass],
    counts: Sequence[int],
    pitch: float,
    speed: float,
    clearance: float,
    preferred_branch: int | None,
) -> tuple[list[PlacedPass | None], list[str]]:
    """Place straight passes by turning table and sensor together; None and a reason where no heading works."""
    if not views:
        return [], []
    runs = [
        trajectory.run(count, view.length / (count - 1), speed, PATH_ACCELERATION, cell.cycle)
        for view, count in zip(views, counts, strict=True)
    ]
    headings = np.radians(np.arange(0.0, 360.0, 15.0))
    turns = pose.from_rotation(pose.rotation_about(2, headings))
    ends = np.array([[_on_path(view, run.path[[0, -1]]) for view, run in zip(views, runs, strict=True)]])
    q = cell.ik((turns[:, None, None] @ ends).reshape(-1, 4, 4)).reshape(len(headings), len(views), 2, 8, 6)
    metric = constraints.arm_metric(cell.nominal.arm, q).min(2)
    usable = metric > _MIN_METRIC
    served = usable.sum(1).ravel()
    other_branch = np.tile(np.arange(8) != (preferred_branch if preferred_branch is not None else -1), len(headings))
    order = np.lexsort((-metric.mean(1).ravel(), other_branch, -served))
    placed: list[PlacedPass | None] = []
    reasons: list[str] = []
    for i, (view, run) in enumerate(zip(views, runs, strict=True)):
        first_hit: list[Clash] = []
        reason = ""
        for choice in [c for c in order if usable[:, i].ravel()[c]][:_MAX_TRIES]:
            heading, branch = divmod(int(choice), 8)
            candidate, reason, hit = _try_pass(cell, view, run, counts[i], float(headings[heading]), branch, clearance)
            first_hit = first_hit or hit
            if candidate is not None:
                placed.append(candidate)
                break
        else:
            placed.append(None)
            targets = (turns[:, None] @ ends[0, i]).reshape(-1, 4, 4)
            reasons.append(f"{view.name}: {reason or _why(cell, targets, first_hit, clearance)}")
    return placed, reasons


def _on_path(view: Pass, path: Array) -> Array:
    """Sensor poses (n, 4, 4) of a pass at path coordinates (n,), extrapolated beyond both ends."""
    return pose.interpolate_straight(view.start, view.end, path / view.length)


def _try_pass(
    cell: PlanningCell, view: Pass, run: trajectory.Run, count: int, heading: float, branch: int, clearance: float
) -> tuple[PlacedPass | None, str, list[Clash]]:
    """The pass at one heading and in one branch; else why not (empty when it is a clash)."""
    arm = cell.nominal.arm
    turn = pose.from_rotation(pose.rotation_about(2, heading))
    middle = cell.ik(turn @ _on_path(view, np.array([view.length / 2])))[0, branch]
    exposures = np.linspace(0.0, view.length, count)
    path = np.concatenate([run.path, exposures])
    q = cell.ik(turn @ _on_path(view, path), reference=middle)[:, branch]
    if not np.isfinite(q).all():
        return None, "leaves the joint limits on the way", []
    joints = q[: len(run.path)]
    speed, acceleration = trajectory.excess_of_limits(joints, arm.max_speed, arm.max_acceleration, cell.cycle)
    if max(speed.max(), acceleration.max()) > 1.0:
        return None, f"joint {int(np.argmax(np.maximum(speed, acceleration))) + 1} cannot follow at this speed", []
    table = heading - view.direction
    hit = cell.too_near(joints[::4], np.full(len(joints[::4]), table), clearance)
    if hit:
        return None, "", hit
    return PlacedPass(view, table, run, joints, q[len(run.path) :], branch), "", []


def place_poses(
    cell: PlanningCell, part_from_sensor: Array, azimuth: float, clearance: float
) -> tuple[list[PlacedPose | None], list[str]]:
    """Place single exposures (n, 4, 4) given in the part frame; the table turns the part to a side that works."""
    sides = azimuths(azimuth)
    table_from_sensor = cell.nominal.table_from_part @ part_from_sensor
    origin = table_from_sensor[:, :2, 3]
    angle = sides - np.arctan2(origin[:, 1], origin[:, 0])[:, None]
    targets = pose.from_rotation(pose.rotation_about(2, angle)) @ table_from_sensor[:, None]
    q = cell.ik(targets.reshape(-1, 4, 4)).reshape(len(targets), -1, 6)
    metric = constraints.arm_metric(cell.nominal.arm, q)
    # The preferred side's neighbourhood wins over a slightly better metric elsewhere.
    away = np.repeat(np.abs(sides - azimuth), 8)
    score = np.where(metric > _MIN_METRIC, metric / (1 + away), 0.0)
    order = np.argsort(-score, axis=1, kind="stable")
    choice = np.zeros(len(targets), np.int64)
    rows = np.arange(len(targets))
    hits: dict[int, list[Clash]] = {}
    pending = rows[np.take_along_axis(score, order[:, :1], 1)[:, 0] > 0]
    placed: list[PlacedPose | None] = [None] * len(targets)
    while len(pending):
        picked = order[pending, choice[pending]]
        joints, table = q[pending, picked], angle[pending, picked // 8]
        struck = {c.index: c for c in reversed(cell.too_near(joints, table, clearance))}
        for k, row in enumerate(pending):
            if k in struck:
                hits.setdefault(int(row), [struck[k]])
            else:
                placed[row] = PlacedPose(f"pose {row + 1}", joints[k], float(table[k]))
        pending = pending[[k in struck for k in range(len(pending))]]
        choice[pending] += 1
        pending = pending[(choice[pending] < _MAX_TRIES) & (score[pending, order[pending, choice[pending]]] > 0)]
    reasons = [
        f"pose {row + 1}: {_why(cell, targets[row], hits.get(int(row), []), clearance)}"
        for row in rows
        if placed[row] is None
    ]
    return placed, reasons


def _why(cell: PlanningCell, table_from_sensor: Array, hit: list[Clash], clearance: float) -> str:
    """Why none of several sensor poses (n, 4, 4) for one view can be taken."""
    if hit:
        return describe(hit[0], clearance)
    arm = cell.nominal.arm
    q = cell.ik(table_from_sensor, filtered=False)
    exists = np.isfinite(q).all(-1)
    if not exists.any():
        world = cell.nominal.world_from_table @ table_from_sensor
        missing = np.min(arm.shortfall(world @ pose.inverse(cell.nominal.flange_from_sensor)))
        return f"out of the arm's reach by {1e3 * missing:.0f} mm" if missing > 0 else "out of the arm's reach"
    excess = np.where(exists[..., None], arm.excess(np.nan_to_num(q)), np.inf)
    best = np.unravel_index(int(np.argmin(excess.max(-1))), exists.shape)
    joint = int(np.argmax(excess[best]))
    if excess[best][joint] <= 0:
        return "only with a joint at its limit"
    return f"joint {joint + 1} would be {np.degrees(excess[best][joint]):.1f} deg outside its limits"


def describe(clash: Clash, clearance: float) -> str:
    """What comes too near what, in words."""
    if clash.distance <= 0:
        return f"{clash.body_a} hits {clash.body_b}"
    return f"{clash.body_a} comes within {1e3 * clash.distance:.1f} mm of {clash.body_b} ({1e3 * clearance:g} mm wanted)"


