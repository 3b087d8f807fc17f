"""Track `planning`: motions of arm and table along a sensor path, among obstacles; the public cases, shuffled."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

from benchmarks.planning_cases import (
    CLEARANCE,
    WANTED,
    dense_poses,
    first_contact,
    judge_of,
    path_of,
    planning_cell,
    read_cases,
)
from benchmarks.track import Array, Case, Outcome, ResultError, Table, Track
from scancell.config.loading import load_setup
from scancell.geometry import pose

_STEP = 2e-3  # m, of the path between rows
_OFF_M, _OFF_RAD = 0.1e-3, np.radians(0.05)  # largest error of a pose
_CHECKED = np.radians(0.2)  # of an axis between poses that are checked for collision
_JUMP = np.radians(90.0)  # of an axis between rows
_COLUMNS = (*(f"q{joint}_deg" for joint in range(1, 7)), "table_deg")


def cases(seed: int, number: int) -> list[Case]:
    """Some of the cases, the classes in proportion as far as the number allows."""
    rng = np.random.default_rng(seed)
    every = read_cases()
    ordered = []
    for kind, count in WANTED.items():
        own = [case for case in every if case["kind"] == kind]
        ordered += [((rank + 0.5) / count, own[index]) for rank, index in enumerate(rng.permutation(len(own)))]
    ordered.sort(key=lambda item: item[0])
    cell = load_setup().cell.model_dump(mode="json")
    found = []
    for index, (_, case) in enumerate(ordered[:number]):
        path = path_of(case, planning_cell(case))
        distance = np.linspace(0.0, path.length, int(np.ceil(path.length / _STEP)) + 1)
        poses = path.at(distance)
        table = {"time_s": distance / path.speed}
        table |= {f"r{i + 1}{k + 1}": poses[:, i, k] for i in range(3) for k in range(3)}
        table |= {name: 1e3 * poses[:, axis, 3] for axis, name in enumerate(("x_mm", "y_mm", "z_mm"))}
        public = {key: case[key] for key in ("name", "part", "path", "box")}
        inputs = {"path": table, "case": public, "cell": cell, "clearance_mm": 1e3 * CLEARANCE}
        found.append(Case(f"{index:04d}", inputs, {"case": case, "poses": poses, "time": table["time_s"]}))
    return found


def check(case: Case, table: Table) -> None:
    """A row for each pose of the path, or none."""
    rows, wanted = len(table["table_deg"]), len(case.truth["poses"])
    if rows not in (0, wanted):
        raise ResultError(f"{rows} rows, expected {wanted}, one for each row of path, or none where there is no motion")


def fault(case: Case, axes: Array) -> str:
    """Why axes (n, 7), rad, are no motion along the path: off path, limits, jump or contact; "" if they are one."""
    cell = planning_cell(case.truth["case"])
    nominal = cell.nominal
    q = axes[:, :-1]
    found = pose.inverse(nominal.world_from("table", axes)) @ nominal.world_from("sensor", axes)
    away = pose.inverse(case.truth["poses"]) @ found
    turned = np.linalg.norm(pose.log_rotation(away[:, :3, :3]), axis=1)
    if np.linalg.norm(away[:, :3, 3], axis=1).max() > _OFF_M or turned.max() > _OFF_RAD:
        return "off path"
    low, high = (np.array([getattr(joint, end) for joint in nominal.arm.joints]) for end in ("min", "max"))
    if ((q < low - 1e-9) | (q > high + 1e-9)).any():
        return "limits"
    if np.abs(np.diff(axes, axis=0)).max() > _JUMP:
        return "jump"
    return "contact" if first_contact(cell, judge_of(cell), dense_poses(axes, _CHECKED)) else ""


def duration(case: Case, axes: Array) -> float:
    """Time of the motion within the speed limits of all axes, over that of the path at its speed."""
    least = np.diff(case.truth["time"])
    needed = np.abs(np.diff(axes, axis=0)) / _max_speed()
    return float(np.maximum(least, needed.max(1)).sum() / least.sum())


@cache
def _max_speed() -> Array:
    return planning_cell({"part": "free_form"}).nominal.axis_max_speed


def summary(outcomes: Sequence[Outcome]) -> dict[str, float]:
    """Shares of cases in per cent; the median of the durations of valid motions."""
    right: dict[str, list[bool]] = {kind: [] for kind in WANTED}
    faults, durations = [], []
    for case, table in outcomes:
        kind = case.truth["case"]["kind"]
        axes = None if table is None else np.radians(np.column_stack([table[name] for name in _COLUMNS]))
        moves = axes is not None and len(axes) > 0
        why = fault(case, axes) if axes is not None and moves else ""
        faults.append(why)
        right[kind].append(axes is not None and not why and moves == (kind != "blocked"))
        if axes is not None and moves and not why:
            durations.append(duration(case, axes))
    every = [one for kind in right.values() for one in kind]
    return {
        "unsolved %": 100 * (1 - float(np.mean(every))),
        **{f"{kind} %": 100 * float(np.mean(found)) if found else np.nan for kind, found in right.items()},
        **{f"{why} %": 100 * faults.count(why) / len(faults) for why in ("off path", "limits", "jump", "contact")},
        "duration": float(np.median(durations)) if durations else np.nan,
    }


TRACK = Track("planning", _COLUMNS, (), cases, check, summary, default_cases=30, limit=300.0)
